from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class GetServerInfoRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class GetServerInfoResponse(_message.Message):
    __slots__ = ("version", "mujoco_version", "limits", "simulation_threads", "opengl")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    MUJOCO_VERSION_FIELD_NUMBER: _ClassVar[int]
    LIMITS_FIELD_NUMBER: _ClassVar[int]
    SIMULATION_THREADS_FIELD_NUMBER: _ClassVar[int]
    OPENGL_FIELD_NUMBER: _ClassVar[int]
    version: str
    mujoco_version: str
    limits: ServerLimits
    simulation_threads: int
    opengl: OpenGl
    def __init__(self, version: _Optional[str] = ..., mujoco_version: _Optional[str] = ..., limits: _Optional[_Union[ServerLimits, _Mapping]] = ..., simulation_threads: _Optional[int] = ..., opengl: _Optional[_Union[OpenGl, _Mapping]] = ...) -> None: ...

class OpenGl(_message.Message):
    __slots__ = ("library", "renderer", "version")
    LIBRARY_FIELD_NUMBER: _ClassVar[int]
    RENDERER_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    library: str
    renderer: str
    version: str
    def __init__(self, library: _Optional[str] = ..., renderer: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class ServerLimits(_message.Message):
    __slots__ = ("max_sessions", "max_envs_per_session", "max_envs", "max_frame_stack", "max_message_bytes", "max_policy_bytes", "max_episodes_per_request", "session_idle_limit_s", "max_answer_bytes", "max_open_loop_steps", "max_snapshot_bytes")
    MAX_SESSIONS_FIELD_NUMBER: _ClassVar[int]
    MAX_ENVS_PER_SESSION_FIELD_NUMBER: _ClassVar[int]
    MAX_ENVS_FIELD_NUMBER: _ClassVar[int]
    MAX_FRAME_STACK_FIELD_NUMBER: _ClassVar[int]
    MAX_MESSAGE_BYTES_FIELD_NUMBER: _ClassVar[int]
    MAX_POLICY_BYTES_FIELD_NUMBER: _ClassVar[int]
    MAX_EPISODES_PER_REQUEST_FIELD_NUMBER: _ClassVar[int]
    SESSION_IDLE_LIMIT_S_FIELD_NUMBER: _ClassVar[int]
    MAX_ANSWER_BYTES_FIELD_NUMBER: _ClassVar[int]
    MAX_OPEN_LOOP_STEPS_FIELD_NUMBER: _ClassVar[int]
    MAX_SNAPSHOT_BYTES_FIELD_NUMBER: _ClassVar[int]
    max_sessions: int
    max_envs_per_session: int
    max_envs: int
    max_frame_stack: int
    max_message_bytes: int
    max_policy_bytes: int
    max_episodes_per_request: int
    session_idle_limit_s: int
    max_answer_bytes: int
    max_open_loop_steps: int
    max_snapshot_bytes: int
    def __init__(self, max_sessions: _Optional[int] = ..., max_envs_per_session: _Optional[int] = ..., max_envs: _Optional[int] = ..., max_frame_stack: _Optional[int] = ..., max_message_bytes: _Optional[int] = ..., max_policy_bytes: _Optional[int] = ..., max_episodes_per_request: _Optional[int] = ..., session_idle_limit_s: _Optional[int] = ..., max_answer_bytes: _Optional[int] = ..., max_open_loop_steps: _Optional[int] = ..., max_snapshot_bytes: _Optional[int] = ...) -> None: ...
