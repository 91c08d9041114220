"""A session on a server: N environments to reset and step."""

import os
import weakref
from collections.abc import Sequence
from typing import Any, Literal, Self, SupportsIndex, get_args

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from palr_gym._proto.palr_gym.v1 import environment_pb2, tensor_pb2
from palr_gym._proto.palr_gym.v1.environment_service_pb2 import (
    CloseSessionRequest,
    OpenSessionRequest,
    OpenSessionResponse,
    ResetRequest,
    StepRequest,
    StepResponse,
    StepStreamRequest,
)
from palr_gym._proto.palr_gym.v1.snapshot_service_pb2 import (
    ForkSessionRequest,
    OpenSnapshotRequest,
    RestoreSnapshotRequest,
    TakeSnapshotRequest,
)
from palr_gym._proto.palr_gym.v1.snapshot_service_pb2 import (
    RestoredState as RestoredStateMessage,
)
from palr_gym.arguments import unsigned
from palr_gym.connection import (
    CLOSE_SESSION,
    FORK_SESSION,
    OPEN_SESSION,
    OPEN_SNAPSHOT,
    RESTORE_SNAPSHOT,
    STEP,
    TAKE_SNAPSHOT,
    Connection,
)
from palr_gym.errors import FailedPrecondition, InvalidArgument, PalrGymError, ServerError
from palr_gym.exchange import Exchange
from palr_gym.results import (
    ResetResult,
    RestoredState,
    Shapes,
    StepResult,
    restored_state,
    step_result,
)
from palr_gym.scene_options import SceneOptions, scene_options_message
from palr_gym.specs import EnvironmentSpec, environment_spec
from palr_gym.tensors import FLOAT32, FLOAT64, columns, float32_tensor, to_array

OutOfBounds = Literal["reject", "clip", "raw"]
"""What happens to an action outside the action space: the step is refused, the action is clipped
to the bounds, or it is used as it is (as Gymnasium does)."""

ObservationDtype = Literal["float64", "float32"]
"""Element type of observations on the wire and in arrays; the server simulates in float64."""


_OBSERVATION_DTYPES = {
    "float64": tensor_pb2.DATA_TYPE_FLOAT64,
    "float32": tensor_pb2.DATA_TYPE_FLOAT32,
}
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
# Requests of this size may be beyond what a server reads.
MAX_STREAMED_BYTES = 1 << 20
# A server that is gone must not keep a program from ending.
_CLOSE_TIMEOUT_S = 2.0


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
        observation_dtype: ObservationDtype = "float64",
        scene_options: SceneOptions | None = None,
    ) -> None:
        """Opens the session.

        Args:
            connection: To the server.
            env_id: TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0].
            num_envs: N.
            autoreset_mode: What happens to an environment whose episode has ended.
            out_of_bounds: What happens to an action outside the action space.
            observation_dtype: Element type of observations on the wire and in arrays.
            scene_options: For driving tasks.

        Raises:
            PalrGymError: The kind that fits.
        """
        mode = parse_autoreset_mode(autoreset_mode)
        request = open_session_request(
            env_id,
            num_envs=num_envs,
            autoreset_mode=mode,
            out_of_bounds=out_of_bounds,
            observation_dtype=observation_dtype,
            scene_options=scene_options,
        )
        response = connection.unary(
            OPEN_SESSION,
            request,
            asked=f"opening {num_envs} environment(s) of {env_id}",
        )
        self._attach(connection, response, mode)

    @classmethod
    def from_snapshot(
        cls, connection: Connection, snapshot: bytes
    ) -> "tuple[Session, RestoredState]":
        """Opens a session in the state of a snapshot, which may come from another server.

        Args:
            connection: To the server.
            snapshot: From `snapshot`.

        Raises:
            PalrGymError: The kind that fits.
        """
        response = connection.unary(
            OPEN_SNAPSHOT,
            OpenSnapshotRequest(snapshot=snapshot),
            asked=f"opening a session from a snapshot of {len(snapshot)} bytes",
        )
        session = cls.__new__(cls)
        return session, session._attach_restored(connection, response.session, response.state)

    def _attach_restored(
        self, connection: Connection, response: OpenSessionResponse, state: RestoredStateMessage
    ) -> RestoredState:
        modes = {number: mode for mode, number in _AUTORESET_MODES.items()}
        self._attach(connection, response, modes[state.autoreset_mode])
        return restored_state(state, self._shapes)

    def _attach(
        self, connection: Connection, response: OpenSessionResponse, autoreset_mode: AutoresetMode
    ) -> None:
        """Becomes the session that was opened."""
        self.autoreset_mode = autoreset_mode
        self.session_id: str = response.session_id
        self.spec: EnvironmentSpec = environment_spec(response.spec)
        self.num_envs: int = response.num_envs
        self.idle_limit_s: int = response.idle_limit_s
        self._connection = connection
        self._shapes = Shapes.of(self.spec, self.num_envs)
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
    ) -> NDArray[np.floating[Any]]:
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
        return self.reset_with_info(seeds=seeds, env_indices=env_indices).observations

    def reset_with_info(
        self,
        *,
        seeds: Sequence[SupportsIndex] = (),
        env_indices: Sequence[int] | NDArray[np.integer[Any]] = (),
    ) -> ResetResult:
        """Like `reset`, and says what the resets report."""
        self._refuse_if_under_way("resetting")
        request = reset_request(self.session_id, seeds, env_indices)
        self._exchange.send(request.SerializeToString(), "resetting")
        answer = self._exchange.receive("resetting").reset
        shape = (self.num_envs, len(self.spec.reset_info_names))
        return ResetResult(
            to_array(
                answer.observations, self._shapes.observation_dtype, self._shapes.observations
            ),
            columns(answer.info.data, FLOAT64, shape),
        )

    def step(self, actions: ArrayLike) -> StepResult:
        """Steps every environment once.

        Args:
            actions: [N, action size], converted to float32.

        Raises:
            PalrGymError: The kind that fits. After `InvalidArgument`, `FailedPrecondition` and
                the like, nothing has changed on the server.
        """
        self._refuse_if_under_way("stepping")
        self._exchange.send(self._step_request(actions), "stepping")
        return self._step_result(self._exchange.receive("stepping").step)

    def step_open_loop(self, actions: ArrayLike) -> StepResult:
        """Takes K steps in one message: the same as K calls of `step`, without their round trips.

        With DISABLED, the first step that ends an episode is the last one that is taken.

        Args:
            actions: [K, N, action size], converted to float32; K as `ServerLimits` allows.

        Returns:
            As by `step`, with a first dimension K in every array.

        Raises:
            PalrGymError: As by `step`; if the server refused, no step was taken.
        """
        self._refuse_if_under_way("stepping")
        array = open_loop_actions(actions, self._shapes, self._subject)
        request = StepRequest(session_id=self.session_id, actions=float32_tensor(array))
        if array.nbytes >= MAX_STREAMED_BYTES:
            # A stream would end over a request that is too large; a call is only refused.
            answer = self._connection.unary(STEP, request, asked=f"stepping {self._subject}")
            return self._step_result(answer, answer.rewards.shape[0])
        message = StepStreamRequest(step=request).SerializeToString()
        self._exchange.send(message, "stepping")
        answer = self._exchange.receive("stepping").step
        return self._step_result(answer, answer.rewards.shape[0])

    def snapshot(self) -> bytes:
        """Everything that decides what comes next, for `restore` and `from_snapshot`.

        Raises:
            PalrGymError: The kind that fits.
        """
        self._refuse_if_under_way("taking a snapshot of")
        return self._connection.unary(
            TAKE_SNAPSHOT,
            TakeSnapshotRequest(session_id=self.session_id),
            asked=f"taking a snapshot of {self._subject}",
        ).snapshot

    def restore(self, snapshot: bytes) -> RestoredState:
        """Puts the session into the state of a snapshot of its like.

        Raises:
            PalrGymError: The kind that fits; after `InvalidArgument` nothing has changed.
        """
        self._refuse_if_under_way("restoring")
        response = self._connection.unary(
            RESTORE_SNAPSHOT,
            RestoreSnapshotRequest(session_id=self.session_id, snapshot=snapshot),
            asked=f"restoring {self._subject}",
        )
        return restored_state(response.state, self._shapes)

    def fork(self, connection: Connection | None = None) -> "tuple[Session, RestoredState]":
        """A new session that goes on from where this one stands; both then go their own ways.

        Args:
            connection: What the new session uses; None: the same connection.

        Raises:
            PalrGymError: The kind that fits.
        """
        self._refuse_if_under_way("forking")
        connection = connection or self._connection
        response = connection.unary(
            FORK_SESSION,
            ForkSessionRequest(session_id=self.session_id),
            asked=f"forking {self._subject}",
        )
        session = type(self).__new__(type(self))
        return session, session._attach_restored(connection, response.session, response.state)

    def step_async(self, actions: ArrayLike) -> None:
        """Sends a step, and does not wait. Several may be under way; the deadline runs at once."""
        self._exchange.send(self._step_request(actions), "stepping")

    def step_wait(self) -> StepResult:
        """Waits for the oldest step that was sent; otherwise like `step`."""
        return self._step_result(self._exchange.receive("stepping").step)

    @property
    def has_lost_requests(self) -> bool:
        """Whether there were requests that got no answer: they may reach the server later."""
        return self._exchange.has_lost_requests

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
        data = bytes(int(np.prod(self._shapes.actions)) * FLOAT32.itemsize)
        actions = tensor_pb2.Tensor(
            dtype=tensor_pb2.DATA_TYPE_FLOAT32, shape=self._shapes.actions, data=data
        )
        step = StepRequest(session_id=self.session_id, actions=actions)
        request = StepStreamRequest(step=step).SerializeToString()
        return request[: len(request) - len(data)]

    def _refuse_if_under_way(self, what: str) -> None:
        if self._exchange.under_way:
            raise FailedPrecondition(f"{what} {self._subject} before step_wait()")

    def _step_request(self, actions: ArrayLike) -> bytes:
        array = float32_actions(actions, self._shapes, self._subject)
        if array.shape == self._shapes.actions:
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
            f"expected {list(self._shapes.actions)}"
        )

    def _step_result(self, message: StepResponse, steps: int | None = None) -> StepResult:
        return step_result(message, self._shapes, steps)


def reset_request(
    session_id: str,
    seeds: Sequence[SupportsIndex],
    env_indices: Sequence[int] | NDArray[np.integer[Any]],
) -> StepStreamRequest:
    """The message that resets environments.

    Raises:
        InvalidArgument: A seed or an index cannot be sent.
    """
    return StepStreamRequest(
        reset=ResetRequest(
            session_id=session_id,
            seeds=[unsigned("seed", seed, 64) for seed in seeds],
            env_indices=[unsigned("environment index", index, 32) for index in env_indices],
        )
    )


def float32_actions(actions: ArrayLike, shapes: Shapes, subject: str) -> NDArray[np.float32]:
    """`actions` as an array, of whatever shape.

    Raises:
        InvalidArgument: They are none.
    """
    try:
        return np.asarray(actions, dtype=FLOAT32)
    except (TypeError, ValueError) as error:
        raise InvalidArgument(
            f"stepping {subject}: the actions are no array of numbers of shape "
            f"{list(shapes.actions)} ({error})"
        ) from None


def open_loop_actions(actions: ArrayLike, shapes: Shapes, subject: str) -> NDArray[np.float32]:
    """`actions` as an array [K, N, action size].

    Raises:
        InvalidArgument: They are none.
    """
    array = float32_actions(actions, shapes, subject)
    if array.ndim != 3 or array.shape[1:] != shapes.actions:
        raise InvalidArgument(
            f"stepping {subject} in an open loop: the actions have shape "
            f"{list(array.shape)}; expected [K, {', '.join(map(str, shapes.actions))}]",
            reason="ACTION_SHAPE",
        )
    return array


def open_session_request(
    env_id: str,
    *,
    num_envs: SupportsIndex,
    autoreset_mode: AutoresetMode,
    out_of_bounds: OutOfBounds,
    observation_dtype: ObservationDtype,
    scene_options: SceneOptions | None = None,
) -> OpenSessionRequest:
    """The message that opens a session.

    Raises:
        InvalidArgument: An argument cannot be sent.
    """
    if out_of_bounds not in _OUT_OF_BOUNDS:
        raise InvalidArgument(
            f"out_of_bounds is {out_of_bounds!r}; expected one of {get_args(OutOfBounds)}"
        )
    if observation_dtype not in _OBSERVATION_DTYPES:
        raise InvalidArgument(
            f"observation_dtype is {observation_dtype!r}; expected one of "
            f"{get_args(ObservationDtype)}"
        )
    return OpenSessionRequest(
        env_id=env_id,
        num_envs=unsigned("num_envs", num_envs, 32),
        autoreset_mode=_AUTORESET_MODES[autoreset_mode],
        out_of_bounds=_OUT_OF_BOUNDS[out_of_bounds],
        observation_dtype=_OBSERVATION_DTYPES[observation_dtype],
        scene_options=scene_options_message(scene_options),
    )


def parse_autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """The mode that `mode` is or names.

    Raises:
        InvalidArgument: There is no such mode.
    """
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
