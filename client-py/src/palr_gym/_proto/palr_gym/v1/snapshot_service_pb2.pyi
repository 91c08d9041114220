from palr_gym._proto.palr_gym.v1 import environment_pb2 as _environment_pb2
from palr_gym._proto.palr_gym.v1 import environment_service_pb2 as _environment_service_pb2
from palr_gym._proto.palr_gym.v1 import tensor_pb2 as _tensor_pb2
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class TakeSnapshotRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class TakeSnapshotResponse(_message.Message):
    __slots__ = ("snapshot",)
    SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    snapshot: bytes
    def __init__(self, snapshot: _Optional[bytes] = ...) -> None: ...

class RestoreSnapshotRequest(_message.Message):
    __slots__ = ("session_id", "snapshot")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    snapshot: bytes
    def __init__(self, session_id: _Optional[str] = ..., snapshot: _Optional[bytes] = ...) -> None: ...

class RestoreSnapshotResponse(_message.Message):
    __slots__ = ("state",)
    STATE_FIELD_NUMBER: _ClassVar[int]
    state: RestoredState
    def __init__(self, state: _Optional[_Union[RestoredState, _Mapping]] = ...) -> None: ...

class OpenSnapshotRequest(_message.Message):
    __slots__ = ("snapshot",)
    SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    snapshot: bytes
    def __init__(self, snapshot: _Optional[bytes] = ...) -> None: ...

class OpenSnapshotResponse(_message.Message):
    __slots__ = ("session", "state")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    session: _environment_service_pb2.OpenSessionResponse
    state: RestoredState
    def __init__(self, session: _Optional[_Union[_environment_service_pb2.OpenSessionResponse, _Mapping]] = ..., state: _Optional[_Union[RestoredState, _Mapping]] = ...) -> None: ...

class ForkSessionRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class ForkSessionResponse(_message.Message):
    __slots__ = ("session", "state")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    session: _environment_service_pb2.OpenSessionResponse
    state: RestoredState
    def __init__(self, session: _Optional[_Union[_environment_service_pb2.OpenSessionResponse, _Mapping]] = ..., state: _Optional[_Union[RestoredState, _Mapping]] = ...) -> None: ...

class RestoredState(_message.Message):
    __slots__ = ("was_reset", "observations", "is_over", "autoreset_mode", "out_of_bounds")
    WAS_RESET_FIELD_NUMBER: _ClassVar[int]
    OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    IS_OVER_FIELD_NUMBER: _ClassVar[int]
    AUTORESET_MODE_FIELD_NUMBER: _ClassVar[int]
    OUT_OF_BOUNDS_FIELD_NUMBER: _ClassVar[int]
    was_reset: bool
    observations: _tensor_pb2.Tensor
    is_over: _tensor_pb2.Tensor
    autoreset_mode: _environment_pb2.AutoresetMode
    out_of_bounds: _environment_pb2.OutOfBounds
    def __init__(self, was_reset: _Optional[bool] = ..., observations: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., is_over: _Optional[_Union[_tensor_pb2.Tensor, _Mapping]] = ..., autoreset_mode: _Optional[_Union[_environment_pb2.AutoresetMode, str]] = ..., out_of_bounds: _Optional[_Union[_environment_pb2.OutOfBounds, str]] = ...) -> None: ...
