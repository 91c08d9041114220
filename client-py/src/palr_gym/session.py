"""A session on a server: N environments to reset and step."""

import os
import weakref
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Self, SupportsIndex, get_args

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from palr_gym._proto.palr_gym.v1 import environment_pb2, tensor_pb2
from palr_gym._proto.palr_gym.v1.environment_service_pb2 import (
    CloseSessionRequest,
    OpenSessionRequest,
    ResetRequest,
    StepRequest,
    StepResponse,
    StepStreamRequest,
)
from palr_gym.arguments import unsigned
from palr_gym.connection import CLOSE_SESSION, OPEN_SESSION, STEP, Connection
from palr_gym.errors import FailedPrecondition, InvalidArgument, PalrGymError, ServerError
from palr_gym.exchange import Exchange
from palr_gym.specs import EnvironmentSpec, environment_spec
from palr_gym.tensors import BOOL, FLOAT32, FLOAT64, columns, elements, float32_tensor, to_array

OutOfBounds = Literal["reject", "clip", "raw"]
"""What happens to an action outside the action space: the step is refused, the action is clipped
to the bounds, or it is used as it is (as Gymnasium does)."""

_OUT_OF_BOUNDS = {
    "reject": environment_pb2.OUT_OF_BOUNDS_REJECT,
    "clip": environment_pb2.OUT_OF_BOUNDS_CLIP,
    "raw": environment_pb2.OUT_OF_BOUNDS_RAW,
}
_AUTORESET_MODES = {
    AutoresetMode.NEXT_STEP: environment_pb2.AUTORESET_MODE_NEXT_STEP,
    AutoresetMode.SAME_STEP: environment_pb2.AUTORESET_MODE_SAME_STEP,
    AutoresetMode.DISABLED: environment_pb2.AUTORESET_MODE_DISABLED,
}
# A server that is gone must not keep a program from ending.
_CLOSE_TIMEOUT_S = 2.0


class StepResult(NamedTuple):
    """What a step of N environments returned. Every array is the caller's own."""

    observations: NDArray[np.float64]
    """[N, observation size]"""
    rewards: NDArray[np.float64]
    """[N]"""
    terminated: NDArray[np.bool_]
    """[N]: the task ended the episode. Can be set together with `truncated`."""
    truncated: NDArray[np.bool_]
    """[N]: the time limit ended the episode."""
    info: NDArray[np.float64]
    """[info names, N]: rows as in `EnvironmentSpec.info_names`. NaN for environments that this
    step reset (NEXT_STEP)."""
    final_observations: NDArray[np.float64] | None
    """[episodes that ended, observation size], in the order of the environments; None if no
    episode ended, or the mode is not SAME_STEP."""


class Session:
    """N environments on a server. Not thread-safe; `Client.open_session` makes them.

    The server keeps a session until it is closed or has been idle for `idle_limit_s`. A session
    that is garbage-collected, or still open when Python exits, is closed as well as may be.
    """

    def __init__(
        self,
        connection: Connection,
        env_id: str,
        *,
        num_envs: SupportsIndex = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        out_of_bounds: OutOfBounds = "reject",
    ) -> None:
        """Opens the session.

        Args:
            connection: To the server.
            env_id: TASK[-full|-paper|-strict][-gym5][-wN][-v0].
            num_envs: N.
            autoreset_mode: What happens to an environment whose episode has ended.
            out_of_bounds: What happens to an action outside the action space.

        Raises:
            PalrGymError: The kind that fits.
        """
        self.autoreset_mode = _parse_autoreset_mode(autoreset_mode)
        if out_of_bounds not in _OUT_OF_BOUNDS:
            raise InvalidArgument(
                f"out_of_bounds is {out_of_bounds!r}; expected one of {get_args(OutOfBounds)}"
            )
        response = connection.unary(
            OPEN_SESSION,
            OpenSessionRequest(
                env_id=env_id,
                num_envs=unsigned("num_envs", num_envs, 32),
                autoreset_mode=_AUTORESET_MODES[self.autoreset_mode],
                out_of_bounds=_OUT_OF_BOUNDS[out_of_bounds],
            ),
            asked=f"opening {num_envs} environment(s) of {env_id}",
        )
        self.session_id: str = response.session_id
        self.spec: EnvironmentSpec = environment_spec(response.spec)
        self.num_envs: int = response.num_envs
        self.idle_limit_s: int = response.idle_limit_s
        self._connection = connection
        self._observations_shape = (self.num_envs, *self.spec.observation_space.shape)
        self._actions_shape = (self.num_envs, *self.spec.action_space.shape)
        self._info_shape = (self.num_envs, len(self.spec.info_names))
        self._subject = f"{self.num_envs} environment(s) of {self.spec.env_id}"
        self._exchange = Exchange(connection, self._subject)
        self._step_head = self._head_of_step_requests()
        self._close = weakref.finalize(
            self, _close_session, connection, self._exchange, self.session_id, os.getpid()
        )

    def reset(
        self,
        *,
        seeds: Sequence[SupportsIndex] = (),
        env_indices: Sequence[int] | NDArray[np.integer[Any]] = (),
    ) -> NDArray[np.float64]:
        """Starts new episodes.

        Args:
            seeds: None: the environments go on with their generators. One: environment i is seeded
                with seed + i. N: one each, those that are not reset included.
            env_indices: Which environments to reset, ascending; empty: all.

        Returns:
            [N, observation size]: the current observation of every environment, reset or not.

        Raises:
            PalrGymError: The kind that fits.
        """
        if self._exchange.under_way:
            raise FailedPrecondition(f"resetting {self._subject} before step_wait()")
        request = StepStreamRequest(
            reset=ResetRequest(
                session_id=self.session_id,
                seeds=[unsigned("seed", seed, 64) for seed in seeds],
                env_indices=[unsigned("environment index", index, 32) for index in env_indices],
            )
        )
        self._exchange.send(request.SerializeToString(), "resetting")
        observations = self._exchange.receive("resetting").reset.observations
        return to_array(observations, FLOAT64, self._observations_shape)

    def step(self, actions: ArrayLike) -> StepResult:
        """Steps every environment once.

        Args:
            actions: [N, action size], converted to float32.

        Raises:
            PalrGymError: The kind that fits. After `InvalidArgument`, `FailedPrecondition` and
                the like, nothing has changed on the server.
        """
        if self._exchange.under_way:
            raise FailedPrecondition(f"stepping {self._subject} before step_wait()")
        self._exchange.send(self._step_request(actions), "stepping")
        return self._step_result(self._exchange.receive("stepping").step)

    def step_async(self, actions: ArrayLike) -> None:
        """Sends a step, and does not wait. Several may be under way; the deadline runs at once."""
        self._exchange.send(self._step_request(actions), "stepping")

    def step_wait(self) -> StepResult:
        """Waits for the oldest step that was sent; otherwise like `step`."""
        return self._step_result(self._exchange.receive("stepping").step)

    def abandon_steps(self) -> None:
        """Gives up the answers to steps that are under way; the server still takes the steps."""
        if self._exchange.under_way:
            self._exchange.close()

    def close(self) -> None:
        """Closes the session on the server, if the server is still there. May be repeated."""
        self._close()

    def __enter__(self) -> Self:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the session."""
        self.close()

    def _head_of_step_requests(self) -> bytes:
        """A serialised request to step, up to the elements of the actions.

        Fields are written in the order of their numbers, and the elements come last of all, so
        that a request is this head and the array's bytes.
        """
        data = bytes(int(np.prod(self._actions_shape)) * FLOAT32.itemsize)
        actions = tensor_pb2.Tensor(
            dtype=tensor_pb2.DATA_TYPE_FLOAT32, shape=self._actions_shape, data=data
        )
        step = StepRequest(session_id=self.session_id, actions=actions)
        request = StepStreamRequest(step=step).SerializeToString()
        return request[: len(request) - len(data)]

    def _step_request(self, actions: ArrayLike) -> bytes:
        try:
            array = np.asarray(actions, dtype=FLOAT32)
        except (TypeError, ValueError) as error:
            raise InvalidArgument(
                f"stepping {self._subject}: the actions are no array of numbers of shape "
                f"{list(self._actions_shape)} ({error})"
            ) from None
        if array.shape == self._actions_shape:
            return self._step_head + array.tobytes()
        # The server says what is wrong. By another way: a stream would end over a request that is
        # too large.
        self._connection.unary(
            STEP,
            StepRequest(session_id=self.session_id, actions=float32_tensor(array)),
            asked=f"stepping {self._subject}",
        )
        raise ServerError(
            f"stepping {self._subject}: the server took actions of shape {list(array.shape)}; "
            f"expected {list(self._actions_shape)}"
        )

    def _step_result(self, message: StepResponse) -> StepResult:
        num_envs = (self.num_envs,)
        final_observations = None
        if message.HasField("final_observations"):
            shape = (-1, *self._observations_shape[1:])
            final_observations = to_array(message.final_observations, FLOAT64, shape)
        return StepResult(
            elements(message.observations.data, FLOAT64, self._observations_shape),
            elements(message.rewards.data, FLOAT64, num_envs),
            elements(message.terminated.data, BOOL, num_envs),
            elements(message.truncated.data, BOOL, num_envs),
            columns(message.info.data, FLOAT64, self._info_shape),
            final_observations,
        )


def _parse_autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError:
        modes = [mode.value for mode in AutoresetMode]
        raise InvalidArgument(f"autoreset_mode is {mode!r}; expected one of {modes}") from None


def _close_session(
    connection: Connection, exchange: Exchange, session_id: str, opened_by: int
) -> None:
    exchange.close()
    # A forked child has a copy of the session object, but the session is its parent's.
    if connection.is_closed or os.getpid() != opened_by:
        return
    try:
        connection.unary(
            CLOSE_SESSION,
            CloseSessionRequest(session_id=session_id),
            asked="closing a session",
            timeout_s=min(connection.deadline_s, _CLOSE_TIMEOUT_S),
        )
    except PalrGymError:
        # The server is gone, and the session with it; or it will be closed for being idle.
        return
