"""What a server says about itself, its tasks and its environments, as plain values."""

from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np
from gymnasium.spaces import Box

from palr_gym._proto.palr_gym.v1 import (
    environment_pb2,
    environment_service_pb2,
    server_service_pb2,
)

Real = TypeVar("Real", bound=np.floating[Any])


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


@dataclass(frozen=True)
class ServerInfo:
    """Versions and limits of a server."""

    version: str
    mujoco_version: str
    limits: ServerLimits
    simulation_threads: int


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
    """The public environment that it equals."""
    full_observation_size: int
    action_size: int
    max_episode_steps: int
    masks: dict[str, tuple[int, ...]]
    """Indices into the full observation that the agent sees, by the mask's name."""
    reference_returns: ReferenceReturns
    expert: Expert | None


@dataclass(frozen=True)
class EnvironmentSpec:
    """An environment, resolved from its id."""

    env_id: str
    """Canonical id, such as "hopper-w2-v0"."""
    task: str
    mask: str
    """What the agent sees of the full observation: "full", "paper" or "strict"."""
    frame_stack: int
    """Observations in a stack, oldest first. Steps before the first one are zeros."""
    observation_space: "Box[np.float64]"
    """Shape (observation size,), float64."""
    observation_names: tuple[str, ...]
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
        ),
        simulation_threads=message.simulation_threads,
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
        observation_space=_box(message.observation_space, np.float64),
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
    )


def _reference_returns(message: environment_pb2.ReferenceReturns) -> ReferenceReturns:
    return ReferenceReturns(random=message.random, expert=message.expert)


def _mask_name(mask: environment_pb2.Mask) -> str:
    try:
        return environment_pb2.Mask.Name(mask).removeprefix("MASK_").lower()
    except ValueError:
        # A newer server's mask.
        return str(int(mask))


def _box(message: environment_pb2.BoxSpace, dtype: type[Real]) -> "Box[Real]":
    shape = tuple(message.shape)
    low = np.array(message.low, dtype=dtype).reshape(shape)
    high = np.array(message.high, dtype=dtype).reshape(shape)
    return cast("Box[Real]", Box(low, high, dtype=dtype))
