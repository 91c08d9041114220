from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ActionMode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ACTION_MODE_UNSPECIFIED: _ClassVar[ActionMode]
    ACTION_MODE_DETERMINISTIC: _ClassVar[ActionMode]
    ACTION_MODE_SAMPLED: _ClassVar[ActionMode]
ACTION_MODE_UNSPECIFIED: ActionMode
ACTION_MODE_DETERMINISTIC: ActionMode
ACTION_MODE_SAMPLED: ActionMode

class Policy(_message.Message):
    __slots__ = ("random", "expert", "onnx")
    RANDOM_FIELD_NUMBER: _ClassVar[int]
    EXPERT_FIELD_NUMBER: _ClassVar[int]
    ONNX_FIELD_NUMBER: _ClassVar[int]
    random: RandomPolicy
    expert: ExpertPolicy
    onnx: bytes
    def __init__(self, random: _Optional[_Union[RandomPolicy, _Mapping]] = ..., expert: _Optional[_Union[ExpertPolicy, _Mapping]] = ..., onnx: _Optional[bytes] = ...) -> None: ...

class RandomPolicy(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ExpertPolicy(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...
