from palr_gym._proto.palr_gym.v1 import environment_pb2 as _environment_pb2
from palr_gym._proto.palr_gym.v1 import policy_pb2 as _policy_pb2
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class EvaluateRequest(_message.Message):
    __slots__ = ("env_id", "policy", "episodes", "seed", "action_mode", "num_envs", "scene_options")
    ENV_ID_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    EPISODES_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    ACTION_MODE_FIELD_NUMBER: _ClassVar[int]
    NUM_ENVS_FIELD_NUMBER: _ClassVar[int]
    SCENE_OPTIONS_FIELD_NUMBER: _ClassVar[int]
    env_id: str
    policy: _policy_pb2.Policy
    episodes: int
    seed: int
    action_mode: _policy_pb2.ActionMode
    num_envs: int
    scene_options: _environment_pb2.SceneOptions
    def __init__(self, env_id: _Optional[str] = ..., policy: _Optional[_Union[_policy_pb2.Policy, _Mapping]] = ..., episodes: _Optional[int] = ..., seed: _Optional[int] = ..., action_mode: _Optional[_Union[_policy_pb2.ActionMode, str]] = ..., num_envs: _Optional[int] = ..., scene_options: _Optional[_Union[_environment_pb2.SceneOptions, _Mapping]] = ...) -> None: ...

class EvaluateResponse(_message.Message):
    __slots__ = ("episode", "summary")
    EPISODE_FIELD_NUMBER: _ClassVar[int]
    SUMMARY_FIELD_NUMBER: _ClassVar[int]
    episode: EpisodeResult
    summary: EvaluationSummary
    def __init__(self, episode: _Optional[_Union[EpisodeResult, _Mapping]] = ..., summary: _Optional[_Union[EvaluationSummary, _Mapping]] = ...) -> None: ...

class EpisodeResult(_message.Message):
    __slots__ = ("index", "seed", "episode_return", "normalized_score", "length", "terminated", "truncated")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    EPISODE_RETURN_FIELD_NUMBER: _ClassVar[int]
    NORMALIZED_SCORE_FIELD_NUMBER: _ClassVar[int]
    LENGTH_FIELD_NUMBER: _ClassVar[int]
    TERMINATED_FIELD_NUMBER: _ClassVar[int]
    TRUNCATED_FIELD_NUMBER: _ClassVar[int]
    index: int
    seed: int
    episode_return: float
    normalized_score: float
    length: int
    terminated: bool
    truncated: bool
    def __init__(self, index: _Optional[int] = ..., seed: _Optional[int] = ..., episode_return: _Optional[float] = ..., normalized_score: _Optional[float] = ..., length: _Optional[int] = ..., terminated: _Optional[bool] = ..., truncated: _Optional[bool] = ...) -> None: ...

class EvaluationSummary(_message.Message):
    __slots__ = ("episodes", "return_mean", "return_standard_error", "score_mean", "score_standard_error", "score_interquartile_mean", "score_interquartile_mean_low", "score_interquartile_mean_high", "length_mean", "steps", "wall_time_s", "num_envs")
    EPISODES_FIELD_NUMBER: _ClassVar[int]
    RETURN_MEAN_FIELD_NUMBER: _ClassVar[int]
    RETURN_STANDARD_ERROR_FIELD_NUMBER: _ClassVar[int]
    SCORE_MEAN_FIELD_NUMBER: _ClassVar[int]
    SCORE_STANDARD_ERROR_FIELD_NUMBER: _ClassVar[int]
    SCORE_INTERQUARTILE_MEAN_FIELD_NUMBER: _ClassVar[int]
    SCORE_INTERQUARTILE_MEAN_LOW_FIELD_NUMBER: _ClassVar[int]
    SCORE_INTERQUARTILE_MEAN_HIGH_FIELD_NUMBER: _ClassVar[int]
    LENGTH_MEAN_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    WALL_TIME_S_FIELD_NUMBER: _ClassVar[int]
    NUM_ENVS_FIELD_NUMBER: _ClassVar[int]
    episodes: int
    return_mean: float
    return_standard_error: float
    score_mean: float
    score_standard_error: float
    score_interquartile_mean: float
    score_interquartile_mean_low: float
    score_interquartile_mean_high: float
    length_mean: float
    steps: int
    wall_time_s: float
    num_envs: int
    def __init__(self, episodes: _Optional[int] = ..., return_mean: _Optional[float] = ..., return_standard_error: _Optional[float] = ..., score_mean: _Optional[float] = ..., score_standard_error: _Optional[float] = ..., score_interquartile_mean: _Optional[float] = ..., score_interquartile_mean_low: _Optional[float] = ..., score_interquartile_mean_high: _Optional[float] = ..., length_mean: _Optional[float] = ..., steps: _Optional[int] = ..., wall_time_s: _Optional[float] = ..., num_envs: _Optional[int] = ...) -> None: ...
