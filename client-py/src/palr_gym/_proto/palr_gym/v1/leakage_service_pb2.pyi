from palr_gym._proto.palr_gym.v1 import policy_pb2 as _policy_pb2
from palr_gym._proto.palr_gym.v1 import tensor_pb2 as _tensor_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class EstimateLeakageRequest(_message.Message):
    __slots__ = ("representation", "policy", "past_actions", "given_actions", "ridge", "bandwidth_sq", "episode_lengths", "resamples", "seed")
    REPRESENTATION_FIELD_NUMBER: _ClassVar[int]
    POLICY_FIELD_NUMBER: _ClassVar[int]
    PAST_ACTIONS_FIELD_NUMBER: _ClassVar[int]
    GIVEN_ACTIONS_FIELD_NUMBER: _ClassVar[int]
    RIDGE_FIELD_NUMBER: _ClassVar[int]
    BANDWIDTH_SQ_FIELD_NUMBER: _ClassVar[int]
    EPISODE_LENGTHS_FIELD_NUMBER: _ClassVar[int]
    RESAMPLES_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    representation: _tensor_pb2.Tensor
    policy: PolicyOnObservations
    past_actions: _tensor_pb2.Tensor
    given_actions: _tensor_pb2.Tensor
    ridge: float
    bandwidth_sq: float
    episode_lengths: _containers.RepeatedScalarFieldContainer[int]
    resamples: int
    seed: int
    def __init__(self, representation: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., policy: _Optional[_Union[PolicyOnObservations, _Mapping]] = ..., past_actions: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., given_actions: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., ridge: _Optional[float] = ..., bandwidth_sq: _Optional[float] = ..., episode_lengths: _Optional[_Iterable[int]] = ..., resamples: _Optional[int] = ..., seed: _Optional[int] = ...) -> None: ...

class PolicyOnObservations(_message.Message):
    __slots__ = ("policy", "env_id", "observations", "action_mode")
    POLICY_FIELD_NUMBER: _ClassVar[int]
    ENV_ID_FIELD_NUMBER: _ClassVar[int]
    OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    ACTION_MODE_FIELD_NUMBER: _ClassVar[int]
    policy: _policy_pb2.Policy
    env_id: str
    observations: _tensor_pb2.Tensor
    action_mode: _policy_pb2.ActionMode
    def __init__(self, policy: _Optional[_Union[_policy_pb2.Policy, _Mapping]] = ..., env_id: _Optional[str] = ..., observations: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., action_mode: _Optional[_Union[_policy_pb2.ActionMode, str]] = ...) -> None: ...

class EstimateLeakageResponse(_message.Message):
    __slots__ = ("hscic", "hscic_low", "hscic_high", "is_by_episode", "per_point")
    HSCIC_FIELD_NUMBER: _ClassVar[int]
    HSCIC_LOW_FIELD_NUMBER: _ClassVar[int]
    HSCIC_HIGH_FIELD_NUMBER: _ClassVar[int]
    IS_BY_EPISODE_FIELD_NUMBER: _ClassVar[int]
    PER_POINT_FIELD_NUMBER: _ClassVar[int]
    hscic: float
    hscic_low: float
    hscic_high: float
    is_by_episode: bool
    per_point: _tensor_pb2.Tensor
    def __init__(self, hscic: _Optional[float] = ..., hscic_low: _Optional[float] = ..., hscic_high: _Optional[float] = ..., is_by_episode: _Optional[bool] = ..., per_point: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ...) -> None: ...
