"""What sessions answer, as arrays."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from palr_gym._proto.palr_gym.v1 import environment_pb2
from palr_gym._proto.palr_gym.v1.environment_service_pb2 import (
    DivergedEpisode as DivergedEpisodeMessage,
)
from palr_gym._proto.palr_gym.v1.environment_service_pb2 import StepResponse
from palr_gym._proto.palr_gym.v1.snapshot_service_pb2 import (
    RestoredState as RestoredStateMessage,
)
from palr_gym.specs import EnvironmentSpec
from palr_gym.tensors import BOOL, FLOAT64, columns, elements, to_array


class DivergedEpisode(NamedTuple):
    """An episode that was truncated because the simulation is no longer one of the task."""

    step: int
    """In which step of an open loop; else 0."""
    env_index: int
    reason: str
    """Such as "bad_control" or "not_finite": the words of the protocol's `Divergence`."""


class ResetResult(NamedTuple):
    """What a reset of N environments returned. Every array is the caller's own."""

    observations: NDArray[np.floating[Any]]
    """[N, observation size], or [N, height, width, 3]: as the space says."""
    info: NDArray[np.float64]
    """[reset info names, N]: rows as in `EnvironmentSpec.reset_info_names`. NaN for environments
    that were not reset."""


class RestoredState(NamedTuple):
    """Where the environments of a restored session stand."""

    observations: NDArray[np.floating[Any]]
    """[N, observation size]"""
    is_over: NDArray[np.bool_]
    """[N]: the episode has ended; the next step resets (NEXT_STEP), or the caller has to."""
    was_reset: bool
    """False: there was no reset yet."""


class StepResult(NamedTuple):
    """What a step of N environments returned. Every array is the caller's own.

    After an open loop of K steps every array but the last two has a first dimension K (`info` a
    second one).
    """

    observations: NDArray[np.floating[Any]]
    """[N, observation size]"""
    rewards: NDArray[np.float64]
    """[N]"""
    terminated: NDArray[np.bool_]
    """[N]: the task ended the episode. Can be set together with `truncated`."""
    truncated: NDArray[np.bool_]
    """[N]: the time limit ended the episode, or its simulation diverged."""
    info: NDArray[np.float64]
    """[info names, N]: rows as in `EnvironmentSpec.info_names`. NaN for environments that diverged,
    and for those that this step reset (NEXT_STEP) but for what a reset reports."""
    final_observations: NDArray[np.floating[Any]] | None
    """[episodes that ended, observation size], in the order of steps and environments; None if no
    episode ended, or the mode is not SAME_STEP."""
    reset_info: NDArray[np.float64] | None
    """[reset info names, episodes that ended]: what the resets of SAME_STEP reported."""
    diverged: tuple[DivergedEpisode, ...]
    """Hardly ever any. Their last reward is 0, their last observation that of the step before."""


@dataclass(frozen=True)
class Shapes:
    """Types and shapes of the arrays that a session sends and receives."""

    observation_dtype: np.dtype[Any]
    observations: tuple[int, ...]
    actions: tuple[int, int]
    info: tuple[int, int]
    reset_info_size: int

    @classmethod
    def of(cls, spec: EnvironmentSpec, num_envs: int) -> Self:
        """Those of `num_envs` environments."""
        return cls(
            observation_dtype=np.dtype(spec.observation_space.dtype or np.float64),
            observations=(num_envs, *spec.observation_space.shape),
            actions=(num_envs, spec.action_space.shape[0]),
            info=(num_envs, len(spec.info_names)),
            reset_info_size=len(spec.reset_info_names),
        )


def step_result(message: StepResponse, shapes: Shapes, steps: int | None = None) -> StepResult:
    """The arrays of an answer to a step, or to `steps` steps of an open loop.

    Raises:
        ServerError: Not what was promised.
    """
    first = () if steps is None else (steps,)
    rows = (*first, shapes.actions[0])
    dtype = shapes.observation_dtype
    final_observations = reset_info = None
    if message.HasField("final_observations"):
        shape = (-1, *shapes.observations[1:])
        final_observations = to_array(message.final_observations, dtype, shape)
        if message.HasField("reset_info"):
            shape = (len(final_observations), shapes.reset_info_size)
            reset_info = columns(message.reset_info.data, FLOAT64, shape)
    return StepResult(
        elements(message.observations.data, dtype, (*first, *shapes.observations)),
        elements(message.rewards.data, FLOAT64, rows),
        elements(message.terminated.data, BOOL, rows),
        elements(message.truncated.data, BOOL, rows),
        columns(message.info.data, FLOAT64, (*first, *shapes.info)),
        final_observations,
        reset_info,
        tuple(map(_diverged, message.diverged)) if message.diverged else (),
    )


def restored_state(message: RestoredStateMessage, shapes: Shapes) -> RestoredState:
    """Where environments stand after a restore.

    Raises:
        ServerError: Not what was promised.
    """
    shape = shapes.observations
    return RestoredState(
        to_array(message.observations, shapes.observation_dtype, shape),
        to_array(message.is_over, BOOL, shape[:1]),
        message.was_reset,
    )


def _diverged(message: DivergedEpisodeMessage) -> DivergedEpisode:
    try:
        name = environment_pb2.Divergence.Name(message.reason)
    except ValueError:
        # A newer server's reason.
        name = str(int(message.reason))
    reason = name.removeprefix("DIVERGENCE_").lower()
    return DivergedEpisode(message.step, message.env_index, reason)


def single_steps(result: StepResult) -> Iterator[StepResult]:
    """The steps of an open loop, one by one; arrays of observations and flags are views."""
    ended = result.terminated | result.truncated
    begin = 0
    for step, ends in enumerate(ended.sum(axis=1).tolist()):
        rows = slice(begin, begin + ends)
        begin += ends
        final, reset_info = result.final_observations, result.reset_info
        yield StepResult(
            result.observations[step],
            result.rewards[step],
            result.terminated[step],
            result.truncated[step],
            result.info[:, step].copy(),
            final[rows].copy() if final is not None and ends else None,
            reset_info[:, rows] if reset_info is not None and ends else None,
            tuple(diverged for diverged in result.diverged if diverged.step == step),
        )
