"""A session on a server: N environments to reset and step."""

import os
import weakref
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Self, SupportsIndex, get_args

import grpc
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
)
from palr_gym.arguments import unsigned
from palr_gym.connection import CLOSE_SESSION, OPEN_SESSION, RESET, STEP, Connection, closed_error
from palr_gym.errors import InvalidArgument, PalrGymError, from_rpc_error
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
            env_id: TASK[-full|-paper|-strict][-wN][-v0].
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
        self._step_call = connection.unary_bytes(STEP)
        self._step_head = self._head_of_step_requests()
        self._close = weakref.finalize(
            self, _close_session, connection, self.session_id, os.getpid()
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
        response = self._connection.unary(
            RESET,
            ResetRequest(
                session_id=self.session_id,
                seeds=[unsigned("seed", seed, 64) for seed in seeds],
                env_indices=[unsigned("environment index", index, 32) for index in env_indices],
            ),
            asked=self._asked("resetting"),
        )
        return to_array(response.observations, FLOAT64, self._observations_shape)

    def step(self, actions: ArrayLike) -> StepResult:
        """Steps every environment once.

        Args:
            actions: [N, action size], converted to float32.

        Raises:
            PalrGymError: The kind that fits. After `InvalidArgument`, `FailedPrecondition` and
                the like, nothing has changed on the server.
        """
        timeout_s = self._connection.deadline_s
        request = self._step_request(actions)
        try:
            return self._step_result(self._step_call(request, timeout=timeout_s))
        except grpc.RpcError as error:
            raise self._step_error(error) from None
        except ValueError:
            # The only ValueError of grpc itself: "Cannot invoke RPC on closed channel!"
            raise self._closed_error() from None

    def step_async(self, actions: ArrayLike) -> "grpc.Future[bytes]":
        """Sends a step. `step_wait` takes what this returns; the deadline starts to run now."""
        timeout_s = self._connection.deadline_s
        request = self._step_request(actions)
        try:
            return self._step_call.future(request, timeout=timeout_s)
        except ValueError:
            # The only ValueError of grpc itself: "Cannot invoke RPC on closed channel!"
            raise self._closed_error() from None

    def step_wait(self, pending: "grpc.Future[bytes]") -> StepResult:
        """Waits for a step that `step_async` sent; otherwise like `step`."""
        try:
            return self._step_result(pending.result())
        except grpc.FutureCancelledError:
            raise self._closed_error() from None
        except grpc.RpcError as error:
            raise self._step_error(error) from None

    def close(self) -> None:
        """Closes the session on the server, if the server is still there. May be repeated."""
        self._close()

    def __enter__(self) -> Self:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the session."""
        self.close()

    def _asked(self, what: str) -> str:
        return f"{what} {self.num_envs} environment(s) of {self.spec.env_id}"

    def _step_error(self, error: grpc.RpcError) -> PalrGymError:
        return from_rpc_error(
            error,
            asked=self._asked("stepping"),
            server=self._connection.server,
            timeout_s=self._connection.deadline_s,
        )

    def _closed_error(self) -> PalrGymError:
        return closed_error(self._asked("stepping"), self._connection.server)

    def _head_of_step_requests(self) -> bytes:
        """A serialised StepRequest up to the elements of the actions.

        Fields are written in the order of their numbers and the elements come last, so that a
        request is this head and the array's bytes.
        """
        data = bytes(int(np.prod(self._actions_shape)) * FLOAT32.itemsize)
        actions = tensor_pb2.Tensor(
            dtype=tensor_pb2.DATA_TYPE_FLOAT32, shape=self._actions_shape, data=data
        )
        request = StepRequest(session_id=self.session_id, actions=actions).SerializeToString()
        return request[: len(request) - len(data)]

    def _step_request(self, actions: ArrayLike) -> bytes:
        try:
            array = np.asarray(actions, dtype=FLOAT32)
        except (TypeError, ValueError) as error:
            raise InvalidArgument(
                f"{self._asked('stepping')}: the actions are no array of numbers of shape "
                f"{list(self._actions_shape)} ({error})"
            ) from None
        if array.shape == self._actions_shape:
            return self._step_head + array.tobytes()
        # The server says what is wrong with the shape.
        request = StepRequest(session_id=self.session_id, actions=float32_tensor(array))
        return request.SerializeToString()

    def _step_result(self, response: bytes) -> StepResult:
        message = StepResponse.FromString(response)
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


def _close_session(connection: Connection, session_id: str, opened_by: int) -> None:
    # A forked child has a copy of the session object, but the session is its parent's.
    if os.getpid() != opened_by:
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
