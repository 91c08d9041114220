from palr_gym._proto.palr_gym.v1 import environment_pb2 as _environment_pb2
from palr_gym._proto.palr_gym.v1 import policy_pb2 as _policy_pb2
from palr_gym._proto.palr_gym.v1 import server_service_pb2 as _server_service_pb2
from palr_gym._proto.palr_gym.v1 import tensor_pb2 as _tensor_pb2
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CollectRequest(_message.Message):
    __slots__ = ("env_id", "policy", "transitions", "episodes", "seed", "action_mode", "num_envs", "first_episode", "scene_options")
    ENV_ID_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    TRANSITIONS_FIELD_NUMBER: _ClassVar[int]
    EPISODES_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    ACTION_MODE_FIELD_NUMBER: _ClassVar[int]
    NUM_ENVS_FIELD_NUMBER: _ClassVar[int]
    FIRST_EPISODE_FIELD_NUMBER: _ClassVar[int]
    SCENE_OPTIONS_FIELD_NUMBER: _ClassVar[int]
    env_id: str
    policy: _policy_pb2.Policy
    transitions: int
    episodes: int
    seed: int
    action_mode: _policy_pb2.ActionMode
    num_envs: int
    first_episode: int
    scene_options: _environment_pb2.SceneOptions
    def __init__(self, env_id: _Optional[str] = ..., policy: _Optional[_Union[_policy_pb2.Policy, _Mapping]] = ..., transitions: _Optional[int] = ..., episodes: _Optional[int] = ..., seed: _Optional[int] = ..., action_mode: _Optional[_Union[_policy_pb2.ActionMode, str]] = ..., num_envs: _Optional[int] = ..., first_episode: _Optional[int] = ..., scene_options: _Optional[_Union[_environment_pb2.SceneOptions, _Mapping]] = ...) -> None: ...

class CollectResponse(_message.Message):
    __slots__ = ("started", "episode")
    STARTED_FIELD_NUMBER: _ClassVar[int]
    EPISODE_FIELD_NUMBER: _ClassVar[int]
    started: CollectionStarted
    episode: EpisodeTransitions
    def __init__(self, started: _Optional[_Union[CollectionStarted, _Mapping]] = ..., episode: _Optional[_Union[EpisodeTransitions, _Mapping]] = ...) -> None: ...

class CollectionStarted(_message.Message):
    __slots__ = ("spec", "policy_sha256", "num_envs", "opengl")
    SPEC_FIELD_NUMBER: _ClassVar[int]
    POLICY_SHA256_FIELD_NUMBER: _ClassVar[int]
    NUM_ENVS_FIELD_NUMBER: _ClassVar[int]
    OPENGL_FIELD_NUMBER: _ClassVar[int]
    spec: _environment_pb2.EnvironmentSpec
    policy_sha256: str
    num_envs: int
    opengl: _server_service_pb2.OpenGl
    def __init__(self, spec: _Optional[_Union[_environment_pb2.EnvironmentSpec, _Mapping]] = ..., policy_sha256: _Optional[str] = ..., num_envs: _Optional[int] = ..., opengl: _Optional[_Union[_server_service_pb2.OpenGl, _Mapping]] = ...) -> None: ...

class EpisodeTransitions(_message.Message):
    __slots__ = ("index", "seed", "observations", "actions", "rewards", "next_observations", "terminated", "truncated", "cut", "qpos", "qvel", "action_log_probs")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    ACTIONS_FIELD_NUMBER: _ClassVar[int]
    REWARDS_FIELD_NUMBER: _ClassVar[int]
    NEXT_OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    TERMINATED_FIELD_NUMBER: _ClassVar[int]
    TRUNCATED_FIELD_NUMBER: _ClassVar[int]
    CUT_FIELD_NUMBER: _ClassVar[int]
    QPOS_FIELD_NUMBER: _ClassVar[int]
    QVEL_FIELD_NUMBER: _ClassVar[int]
    ACTION_LOG_PROBS_FIELD_NUMBER: _ClassVar[int]
    index: int
    seed: int
    observations: _tensor_pb2.Tensor
    actions: _tensor_pb2.Tensor
    rewards: _tensor_pb2.Tensor
    next_observations: _tensor_pb2.Tensor
    terminated: bool
    truncated: bool
    cut: bool
    qpos: _tensor_pb2.Tensor
    qvel: _tensor_pb2.Tensor
    action_log_probs: _tensor_pb2.Tensor
    def __init__(self, index: _Optional[int] = ..., seed: _Optional[int] = ..., observations: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., actions: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., rewards: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., next_observations: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., terminated: _Optional[bool] = ..., truncated: _Optional[bool] = ..., cut: _Optional[bool] = ..., qpos: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., qvel: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., action_log_probs: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ...) -> None: ...
