from palr_gym._proto.palr_gym.v1 import tensor_pb2 as _tensor_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Mask(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    MASK_UNSPECIFIED: _ClassVar[Mask]
    MASK_FULL: _ClassVar[Mask]
    MASK_PAPER: _ClassVar[Mask]
    MASK_STRICT: _ClassVar[Mask]
    MASK_PIXELS: _ClassVar[Mask]

class Fidelity(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FIDELITY_UNSPECIFIED: _ClassVar[Fidelity]
    FIDELITY_GYM4: _ClassVar[Fidelity]
    FIDELITY_GYM5: _ClassVar[Fidelity]

class Divergence(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    DIVERGENCE_UNSPECIFIED: _ClassVar[Divergence]
    DIVERGENCE_INERTIA: _ClassVar[Divergence]
    DIVERGENCE_CONTACTS_FULL: _ClassVar[Divergence]
    DIVERGENCE_CONSTRAINTS_FULL: _ClassVar[Divergence]
    DIVERGENCE_BAD_POSITION: _ClassVar[Divergence]
    DIVERGENCE_BAD_VELOCITY: _ClassVar[Divergence]
    DIVERGENCE_BAD_ACCELERATION: _ClassVar[Divergence]
    DIVERGENCE_BAD_CONTROL: _ClassVar[Divergence]
    DIVERGENCE_NOT_FINITE: _ClassVar[Divergence]
    DIVERGENCE_ENGINE_ERROR: _ClassVar[Divergence]
    DIVERGENCE_UNSEEN: _ClassVar[Divergence]

class AutoresetMode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    AUTORESET_MODE_UNSPECIFIED: _ClassVar[AutoresetMode]
    AUTORESET_MODE_NEXT_STEP: _ClassVar[AutoresetMode]
    AUTORESET_MODE_SAME_STEP: _ClassVar[AutoresetMode]
    AUTORESET_MODE_DISABLED: _ClassVar[AutoresetMode]

class OutOfBounds(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OUT_OF_BOUNDS_UNSPECIFIED: _ClassVar[OutOfBounds]
    OUT_OF_BOUNDS_REJECT: _ClassVar[OutOfBounds]
    OUT_OF_BOUNDS_CLIP: _ClassVar[OutOfBounds]
    OUT_OF_BOUNDS_RAW: _ClassVar[OutOfBounds]

class Weather(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    WEATHER_UNSPECIFIED: _ClassVar[Weather]
    WEATHER_FIXED: _ClassVar[Weather]
    WEATHER_RANDOM: _ClassVar[Weather]

class ObservationKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OBSERVATION_KIND_UNSPECIFIED: _ClassVar[ObservationKind]
    OBSERVATION_KIND_STATE: _ClassVar[ObservationKind]
    OBSERVATION_KIND_FEATURES: _ClassVar[ObservationKind]
    OBSERVATION_KIND_PIXELS: _ClassVar[ObservationKind]
MASK_UNSPECIFIED: Mask
MASK_FULL: Mask
MASK_PAPER: Mask
MASK_STRICT: Mask
MASK_PIXELS: Mask
FIDELITY_UNSPECIFIED: Fidelity
FIDELITY_GYM4: Fidelity
FIDELITY_GYM5: Fidelity
DIVERGENCE_UNSPECIFIED: Divergence
DIVERGENCE_INERTIA: Divergence
DIVERGENCE_CONTACTS_FULL: Divergence
DIVERGENCE_CONSTRAINTS_FULL: Divergence
DIVERGENCE_BAD_POSITION: Divergence
DIVERGENCE_BAD_VELOCITY: Divergence
DIVERGENCE_BAD_ACCELERATION: Divergence
DIVERGENCE_BAD_CONTROL: Divergence
DIVERGENCE_NOT_FINITE: Divergence
DIVERGENCE_ENGINE_ERROR: Divergence
DIVERGENCE_UNSEEN: Divergence
AUTORESET_MODE_UNSPECIFIED: AutoresetMode
AUTORESET_MODE_NEXT_STEP: AutoresetMode
AUTORESET_MODE_SAME_STEP: AutoresetMode
AUTORESET_MODE_DISABLED: AutoresetMode
OUT_OF_BOUNDS_UNSPECIFIED: OutOfBounds
OUT_OF_BOUNDS_REJECT: OutOfBounds
OUT_OF_BOUNDS_CLIP: OutOfBounds
OUT_OF_BOUNDS_RAW: OutOfBounds
WEATHER_UNSPECIFIED: Weather
WEATHER_FIXED: Weather
WEATHER_RANDOM: Weather
OBSERVATION_KIND_UNSPECIFIED: ObservationKind
OBSERVATION_KIND_STATE: ObservationKind
OBSERVATION_KIND_FEATURES: ObservationKind
OBSERVATION_KIND_PIXELS: ObservationKind

class SceneOptions(_message.Message):
    __slots__ = ("lead_car_probability", "weather", "vehicles")
    LEAD_CAR_PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    WEATHER_FIELD_NUMBER: _ClassVar[int]
    VEHICLES_FIELD_NUMBER: _ClassVar[int]
    lead_car_probability: float
    weather: Weather
    vehicles: int
    def __init__(self, lead_car_probability: _Optional[float] = ..., weather: _Optional[_Union[Weather, str]] = ..., vehicles: _Optional[int] = ...) -> None: ...

class FeatureExtractor(_message.Message):
    __slots__ = ("name", "sha256", "size", "height_px", "width_px")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    name: str
    sha256: str
    size: int
    height_px: int
    width_px: int
    def __init__(self, name: _Optional[str] = ..., sha256: _Optional[str] = ..., size: _Optional[int] = ..., height_px: _Optional[int] = ..., width_px: _Optional[int] = ...) -> None: ...

class BoxSpace(_message.Message):
    __slots__ = ("dtype", "shape", "low", "high", "names")
    DTYPE_FIELD_NUMBER: _ClassVar[int]
    SHAPE_FIELD_NUMBER: _ClassVar[int]
    LOW_FIELD_NUMBER: _ClassVar[int]
    HIGH_FIELD_NUMBER: _ClassVar[int]
    NAMES_FIELD_NUMBER: _ClassVar[int]
    dtype: _tensor_pb2.DataType
    shape: _containers.RepeatedScalarFieldContainer[int]
    low: _containers.RepeatedScalarFieldContainer[float]
    high: _containers.RepeatedScalarFieldContainer[float]
    names: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, dtype: _Optional[_Union[_tensor_pb2.DataType, str]] = ..., shape: _Optional[_Iterable[int]] = ..., low: _Optional[_Iterable[float]] = ..., high: _Optional[_Iterable[float]] = ..., names: _Optional[_Iterable[str]] = ...) -> None: ...

class ReferenceReturns(_message.Message):
    __slots__ = ("random", "expert")
    RANDOM_FIELD_NUMBER: _ClassVar[int]
    EXPERT_FIELD_NUMBER: _ClassVar[int]
    random: float
    expert: float
    def __init__(self, random: _Optional[float] = ..., expert: _Optional[float] = ...) -> None: ...

class Expert(_message.Message):
    __slots__ = ("sha256", "card_return", "model_card")
    SHA256_FIELD_NUMBER: _ClassVar[int]
    CARD_RETURN_FIELD_NUMBER: _ClassVar[int]
    MODEL_CARD_FIELD_NUMBER: _ClassVar[int]
    sha256: str
    card_return: float
    model_card: str
    def __init__(self, sha256: _Optional[str] = ..., card_return: _Optional[float] = ..., model_card: _Optional[str] = ...) -> None: ...

class Task(_message.Message):
    __slots__ = ("name", "description", "equals", "full_observation_size", "action_size", "max_episode_steps", "masks", "reference_returns", "expert", "fidelity_profiles")
    NAME_FIELD_NUMBER: _ClassVar[int]
    DESCRIPTION_FIELD_NUMBER: _ClassVar[int]
    EQUALS_FIELD_NUMBER: _ClassVar[int]
    FULL_OBSERVATION_SIZE_FIELD_NUMBER: _ClassVar[int]
    ACTION_SIZE_FIELD_NUMBER: _ClassVar[int]
    MAX_EPISODE_STEPS_FIELD_NUMBER: _ClassVar[int]
    MASKS_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_RETURNS_FIELD_NUMBER: _ClassVar[int]
    EXPERT_FIELD_NUMBER: _ClassVar[int]
    FIDELITY_PROFILES_FIELD_NUMBER: _ClassVar[int]
    name: str
    description: str
    equals: str
    full_observation_size: int
    action_size: int
    max_episode_steps: int
    masks: _containers.RepeatedCompositeFieldContainer[TaskMask]
    reference_returns: ReferenceReturns
    expert: Expert
    fidelity_profiles: _containers.RepeatedCompositeFieldContainer[FidelityProfile]
    def __init__(self, name: _Optional[str] = ..., description: _Optional[str] = ..., equals: _Optional[str] = ..., full_observation_size: _Optional[int] = ..., action_size: _Optional[int] = ..., max_episode_steps: _Optional[int] = ..., masks: _Optional[_Iterable[_Union[TaskMask, _Mapping]]] = ..., reference_returns: _Optional[_Union[ReferenceReturns, _Mapping]] = ..., expert: _Optional[_Union[Expert, _Mapping]] = ..., fidelity_profiles: _Optional[_Iterable[_Union[FidelityProfile, _Mapping]]] = ...) -> None: ...

class FidelityProfile(_message.Message):
    __slots__ = ("fidelity", "id_suffix", "equals", "full_observation_size")
    FIDELITY_FIELD_NUMBER: _ClassVar[int]
    ID_SUFFIX_FIELD_NUMBER: _ClassVar[int]
    EQUALS_FIELD_NUMBER: _ClassVar[int]
    FULL_OBSERVATION_SIZE_FIELD_NUMBER: _ClassVar[int]
    fidelity: Fidelity
    id_suffix: str
    equals: str
    full_observation_size: int
    def __init__(self, fidelity: _Optional[_Union[Fidelity, str]] = ..., id_suffix: _Optional[str] = ..., equals: _Optional[str] = ..., full_observation_size: _Optional[int] = ...) -> None: ...

class TaskMask(_message.Message):
    __slots__ = ("mask", "indices")
    MASK_FIELD_NUMBER: _ClassVar[int]
    INDICES_FIELD_NUMBER: _ClassVar[int]
    mask: Mask
    indices: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, mask: _Optional[_Union[Mask, str]] = ..., indices: _Optional[_Iterable[int]] = ...) -> None: ...

class EnvironmentSpec(_message.Message):
    __slots__ = ("env_id", "task", "mask", "frame_stack", "observation_space", "action_space", "max_episode_steps", "frame_skip", "physics_timestep_s", "control_timestep_s", "info_names", "reference_returns", "has_expert", "mask_indices", "fidelity", "equals", "reset_info_names", "camera_names", "observation_kind", "feature_extractor")
    ENV_ID_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    FRAME_STACK_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_SPACE_FIELD_NUMBER: _ClassVar[int]
    ACTION_SPACE_FIELD_NUMBER: _ClassVar[int]
    MAX_EPISODE_STEPS_FIELD_NUMBER: _ClassVar[int]
    FRAME_SKIP_FIELD_NUMBER: _ClassVar[int]
    PHYSICS_TIMESTEP_S_FIELD_NUMBER: _ClassVar[int]
    CONTROL_TIMESTEP_S_FIELD_NUMBER: _ClassVar[int]
    INFO_NAMES_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_RETURNS_FIELD_NUMBER: _ClassVar[int]
    HAS_EXPERT_FIELD_NUMBER: _ClassVar[int]
    MASK_INDICES_FIELD_NUMBER: _ClassVar[int]
    FIDELITY_FIELD_NUMBER: _ClassVar[int]
    EQUALS_FIELD_NUMBER: _ClassVar[int]
    RESET_INFO_NAMES_FIELD_NUMBER: _ClassVar[int]
    CAMERA_NAMES_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_KIND_FIELD_NUMBER: _ClassVar[int]
    FEATURE_EXTRACTOR_FIELD_NUMBER: _ClassVar[int]
    env_id: str
    task: str
    mask: Mask
    frame_stack: int
    observation_space: BoxSpace
    action_space: BoxSpace
    max_episode_steps: int
    frame_skip: int
    physics_timestep_s: float
    control_timestep_s: float
    info_names: _containers.RepeatedScalarFieldContainer[str]
    reference_returns: ReferenceReturns
    has_expert: bool
    mask_indices: _containers.RepeatedScalarFieldContainer[int]
    fidelity: Fidelity
    equals: str
    reset_info_names: _containers.RepeatedScalarFieldContainer[str]
    camera_names: _containers.RepeatedScalarFieldContainer[str]
    observation_kind: ObservationKind
    feature_extractor: FeatureExtractor
    def __init__(self, env_id: _Optional[str] = ..., task: _Optional[str] = ..., mask: _Optional[_Union[Mask, str]] = ..., frame_stack: _Optional[int] = ..., observation_space: _Optional[_Union[BoxSpace, _Mapping]] = ..., action_space: _Optional[_Union[BoxSpace, _Mapping]] = ..., max_episode_steps: _Optional[int] = ..., frame_skip: _Optional[int] = ..., physics_timestep_s: _Optional[float] = ..., control_timestep_s: _Optional[float] = ..., info_names: _Optional[_Iterable[str]] = ..., reference_returns: _Optional[_Union[ReferenceReturns, _Mapping]] = ..., has_expert: _Optional[bool] = ..., mask_indices: _Optional[_Iterable[int]] = ..., fidelity: _Optional[_Union[Fidelity, str]] = ..., equals: _Optional[str] = ..., reset_info_names: _Optional[_Iterable[str]] = ..., camera_names: _Optional[_Iterable[str]] = ..., observation_kind: _Optional[_Union[ObservationKind, str]] = ..., feature_extractor: _Optional[_Union[FeatureExtractor, _Mapping]] = ...) -> None: ...
