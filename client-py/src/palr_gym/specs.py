"""What a server says about itself, its tasks and its environments, as plain values."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from palr_gym._proto.palr_gym.v1 import (
    environment_pb2,
    environment_service_pb2,
    server_service_pb2,
    tensor_pb2,
)

Real = TypeVar("Real", bound=np.floating[Any] | np.uint8)


@dataclass(frozen=True)
class ServerLimits:
    """What a client may ask for at most."""

    max_sessions: int
    max_envs_per_session: int
    max_envs: int
    """Environments in all sessions together."""
    max_frame_stack: int
    max_message_bytes: int
    max_policy_bytes: int
    max_episodes_per_request: int
    session_idle_limit_s: int
    """Seconds after which an idle session is closed."""
    max_answer_bytes: int
    """Bytes of arrays in the answer to an open loop."""
    max_open_loop_steps: int
    max_snapshot_bytes: int


@dataclass(frozen=True)
class OpenGl:
    """What a server draws with."""

    library: str
    """ "osmesa" or "egl"."""
    renderer: str
    version: str
    """Names Mesa's version."""


@dataclass(frozen=True)
class ServerInfo:
    """Versions and limits of a server."""

    version: str
    mujoco_version: str
    limits: ServerLimits
    simulation_threads: int
    opengl: OpenGl | None
    """None until something was drawn."""


@dataclass(frozen=True)
class ReferenceReturns:
    """Returns between which D4RL normalises: score 0 and score 100."""

    random: float
    expert: float

    def normalized_score(self, episode_return: float) -> float:
        """100 * (return - random) / (expert - random)."""
        return 100 * (episode_return - self.random) / (self.expert - self.random)


@dataclass(frozen=True)
class Expert:
    """The expert that ships with the server for a task."""

    sha256: str
    """Of its ONNX file; empty if it is a controller in the server's own code."""
    card_return: float
    """Mean return of its deterministic actions, as its model card states it."""
    model_card: str
    """Where its model card stands in the source tree."""


@dataclass(frozen=True)
class Task:
    """An environment family: dynamics, reward and termination."""

    name: str
    description: str
    equals: str
    """The public environment that it equals; empty for a task of palr-gym's own."""
    full_observation_size: int
    action_size: int
    max_episode_steps: int
    masks: dict[str, tuple[int, ...]]
    """Indices into the full observation that the agent sees, by the mask's name."""
    reference_returns: ReferenceReturns
    expert: Expert | None
    fidelity_profiles: "tuple[FidelityProfile, ...]"
    """The definitions that are hosted; all else above is said of the first one."""


@dataclass(frozen=True)
class FidelityProfile:
    """A definition of a task."""

    name: str
    """Which of Gymnasium's: "gym4" or "gym5"."""
    id_suffix: str
    """What stands for it in an environment id, after the mask: "" or "-gym5"."""
    equals: str
    """The public environment that it equals."""
    full_observation_size: int


@dataclass(frozen=True)
class EnvironmentSpec:
    """An environment, resolved from its id."""

    env_id: str
    """Canonical id, such as "hopper-w2-v0"."""
    task: str
    mask: str
    """What the agent sees of the task: "full", "paper", "strict" or "pixels"."""
    frame_stack: int
    """Observations in a stack, oldest first. Steps before the first one are zeros."""
    observation_space: "Box[np.floating[Any]]"
    """Shape (observation size,); float64, or float32 if the session was opened so. Pictures are
    uint8, shape (frame_stack * 48, 48, 3): one below the other, the oldest at the top."""
    observation_names: tuple[str, ...]
    """Of each entry; none for pictures."""
    action_space: "Box[np.float32]"
    """Shape (action size,), float32."""
    action_names: tuple[str, ...]
    max_episode_steps: int
    frame_skip: int
    physics_timestep_s: float
    control_timestep_s: float
    info_names: tuple[str, ...]
    reference_returns: ReferenceReturns
    has_expert: bool
    """True if "expert" can be named as a policy."""
    mask_indices: tuple[int, ...]
    """Indices into the full observation that the agent sees."""
    fidelity: str
    """Which of Gymnasium's definitions of the task: "gym4" or "gym5"."""
    equals: str
    """The public environment that it equals."""
    reset_info_names: tuple[str, ...]
    """What a reset reports: the first of `info_names`, or nothing."""
    camera_names: tuple[str, ...]
    """From where pictures can be drawn; the first is the default."""
    observation_kind: str
    """What the entries of observations are: "state", "features" or "pixels"."""
    feature_extractor: "FeatureExtractor | None"
    """What makes features, if the agent sees features."""


@dataclass(frozen=True)
class FeatureExtractor:
    """A network that makes features of pictures."""

    name: str
    sha256: str
    """Of its ONNX file."""
    size: int
    """Features of a picture."""
    height_px: int
    width_px: int


def server_info(message: server_service_pb2.GetServerInfoResponse) -> ServerInfo:
    """From the message of the same name."""
    limits = message.limits
    return ServerInfo(
        version=message.version,
        mujoco_version=message.mujoco_version,
        limits=ServerLimits(
            max_sessions=limits.max_sessions,
            max_envs_per_session=limits.max_envs_per_session,
            max_envs=limits.max_envs,
            max_frame_stack=limits.max_frame_stack,
            max_message_bytes=limits.max_message_bytes,
            max_policy_bytes=limits.max_policy_bytes,
            max_episodes_per_request=limits.max_episodes_per_request,
            session_idle_limit_s=limits.session_idle_limit_s,
            max_answer_bytes=limits.max_answer_bytes,
            max_open_loop_steps=limits.max_open_loop_steps,
            max_snapshot_bytes=limits.max_snapshot_bytes,
        ),
        simulation_threads=message.simulation_threads,
        opengl=OpenGl(
            library=message.opengl.library,
            renderer=message.opengl.renderer,
            version=message.opengl.version,
        )
        if message.HasField("opengl")
        else None,
    )


def tasks(message: environment_service_pb2.ListTasksResponse) -> tuple[Task, ...]:
    """From the message of the same name."""
    return tuple(_task(task) for task in message.tasks)


def environment_spec(message: environment_pb2.EnvironmentSpec) -> EnvironmentSpec:
    """From the message of the same name."""
    return EnvironmentSpec(
        env_id=message.env_id,
        task=message.task,
        mask=_mask_name(message.mask),
        frame_stack=message.frame_stack,
        observation_space=_observation_box(message.observation_space),
        observation_names=tuple(message.observation_space.names),
        action_space=_box(message.action_space, np.float32),
        action_names=tuple(message.action_space.names),
        max_episode_steps=message.max_episode_steps,
        frame_skip=message.frame_skip,
        physics_timestep_s=message.physics_timestep_s,
        control_timestep_s=message.control_timestep_s,
        info_names=tuple(message.info_names),
        reference_returns=_reference_returns(message.reference_returns),
        has_expert=message.has_expert,
        mask_indices=tuple(message.mask_indices),
        fidelity=_fidelity_name(message.fidelity),
        equals=message.equals,
        reset_info_names=tuple(message.reset_info_names),
        camera_names=tuple(message.camera_names),
        observation_kind=_kind_name(message.observation_kind),
        feature_extractor=_feature_extractor(message),
    )


def _task(message: environment_pb2.Task) -> Task:
    expert = None
    if message.HasField("expert"):
        expert = Expert(
            sha256=message.expert.sha256,
            card_return=message.expert.card_return,
            model_card=message.expert.model_card,
        )
    return Task(
        name=message.name,
        description=message.description,
        equals=message.equals,
        full_observation_size=message.full_observation_size,
        action_size=message.action_size,
        max_episode_steps=message.max_episode_steps,
        masks={_mask_name(mask.mask): tuple(mask.indices) for mask in message.masks},
        reference_returns=_reference_returns(message.reference_returns),
        expert=expert,
        fidelity_profiles=tuple(
            FidelityProfile(
                name=_fidelity_name(profile.fidelity),
                id_suffix=profile.id_suffix,
                equals=profile.equals,
                full_observation_size=profile.full_observation_size,
            )
            for profile in message.fidelity_profiles
        ),
    )


def _reference_returns(message: environment_pb2.ReferenceReturns) -> ReferenceReturns:
    return ReferenceReturns(random=message.random, expert=message.expert)


def _mask_name(mask: environment_pb2.Mask) -> str:
    try:
        return environment_pb2.Mask.Name(mask).removeprefix("MASK_").lower()
    except ValueError:
        # A newer server's mask.
        return str(int(mask))


def _kind_name(kind: environment_pb2.ObservationKind) -> str:
    try:
        return environment_pb2.ObservationKind.Name(kind).removeprefix("OBSERVATION_KIND_").lower()
    except ValueError:
        # A newer server's kind.
        return str(int(kind))


def _feature_extractor(message: environment_pb2.EnvironmentSpec) -> FeatureExtractor | None:
    if not message.HasField("feature_extractor"):
        return None
    extractor = message.feature_extractor
    return FeatureExtractor(
        name=extractor.name,
        sha256=extractor.sha256,
        size=extractor.size,
        height_px=extractor.height_px,
        width_px=extractor.width_px,
    )


def _fidelity_name(fidelity: environment_pb2.Fidelity) -> str:
    try:
        return environment_pb2.Fidelity.Name(fidelity).removeprefix("FIDELITY_").lower()
    except ValueError:
        # A newer server's definition.
        return str(int(fidelity))


def _observation_box(message: environment_pb2.BoxSpace) -> "Box[np.floating[Any]]":
    if message.dtype == tensor_pb2.DATA_TYPE_UINT8:
        return cast("Box[np.floating[Any]]", _box(message, np.uint8))
    return _box(
        message, np.float32 if message.dtype == tensor_pb2.DATA_TYPE_FLOAT32 else np.float64
    )


def _box(message: environment_pb2.BoxSpace, dtype: type[Real]) -> "Box[Real]":
    shape = tuple(message.shape)

    def bounds(values: Iterable[float]) -> "NDArray[Any]":
        # One bound may stand for all.
        array = np.array(tuple(values), dtype=dtype)
        return np.full(shape, array[0], dtype) if array.size == 1 else array.reshape(shape)

    low, high = bounds(message.low), bounds(message.high)
    return Box(low, high, dtype=dtype)
