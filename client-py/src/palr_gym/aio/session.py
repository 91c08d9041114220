"""A session on a server, for asyncio."""

import asyncio
import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Self, SupportsIndex

import grpc
import grpc.aio
import numpy as np
from numpy.typing import ArrayLike, NDArray

from palr_gym import errors, specs
from palr_gym._proto.palr_gym.v1.environment_service_pb2 import (
    CloseSessionRequest,
    OpenSessionResponse,
    StepRequest,
    StepStreamRequest,
    StepStreamResponse,
)
from palr_gym._proto.palr_gym.v1.snapshot_service_pb2 import (
    ForkSessionRequest,
    RestoreSnapshotRequest,
    TakeSnapshotRequest,
)
from palr_gym.connection import (
    CLOSE_SESSION,
    FORK_SESSION,
    RENDER,
    RESTORE_SNAPSHOT,
    STEP,
    TAKE_SNAPSHOT,
)
from palr_gym.rendering import Picture, pictures, render_request
from palr_gym.results import RestoredState, Shapes, StepResult, restored_state, step_result
from palr_gym.session import (
    MAX_STREAMED_BYTES,
    float32_actions,
    open_loop_actions,
    reset_request,
)
from palr_gym.tensors import float32_tensor, to_array

if TYPE_CHECKING:
    from palr_gym.aio.client import Client

StepStream = grpc.aio.StreamStreamCall[StepStreamRequest, StepStreamResponse]

_CLOSE_TIMEOUT_S = 2.0


class Session:
    """N environments on a server; `Client.open_session` makes them.

    Several tasks may share one: their requests take turns. The server keeps a session until it is
    closed or has been idle for `idle_limit_s`.
    """

    def __init__(self, client: "Client", opened: OpenSessionResponse) -> None:
        """A session that the server has opened."""
        self.session_id: str = opened.session_id
        self.spec: specs.EnvironmentSpec = specs.environment_spec(opened.spec)
        self.num_envs: int = opened.num_envs
        self.idle_limit_s: int = opened.idle_limit_s
        self._client = client
        self._shapes = Shapes.of(self.spec, self.num_envs)
        self._subject = f"{self.num_envs} environment(s) of {self.spec.env_id}"
        self._call: StepStream | None = None
        self._turn = asyncio.Lock()
        # A step or reset got no answer; whether it was taken is unknown.
        self._is_unknown = False
        self._is_closed = False

    async def reset(
        self,
        *,
        seeds: Sequence[SupportsIndex] = (),
        env_indices: Sequence[int] | NDArray[np.integer[Any]] = (),
    ) -> NDArray[np.floating[Any]]:
        """Starts new episodes. Arguments and result as of `palr_gym.Session.reset`."""
        request = reset_request(self.session_id, seeds, env_indices)
        async with self._turn:
            answer = await self._ask(request, "resetting")
            # A part of the environments may still be where nobody knows.
            self._is_unknown = self._is_unknown and len(env_indices) > 0
        shapes = self._shapes
        return to_array(answer.reset.observations, shapes.observation_dtype, shapes.observations)

    async def step(self, actions: ArrayLike) -> StepResult:
        """Steps every environment once. Arguments and result as of `palr_gym.Session.step`.

        After a call that got no answer, nobody knows whether its step was taken: until the next
        reset, steps raise `ResetNeeded`.
        """
        array = float32_actions(actions, self._shapes, self._subject)
        if array.shape != self._shapes.actions:
            raise errors.InvalidArgument(
                f"stepping {self._subject}: actions have shape {list(array.shape)}; expected "
                f"{list(self._shapes.actions)}"
            )
        answer = await self._step(array)
        return step_result(answer.step, self._shapes)

    async def step_open_loop(self, actions: ArrayLike) -> StepResult:
        """Takes K steps in one message. Arguments and result as of `Session.step_open_loop`."""
        array = open_loop_actions(actions, self._shapes, self._subject)
        answer = await self._step(array)
        return step_result(answer.step, self._shapes, answer.step.rewards.shape[0])

    async def snapshot(self) -> bytes:
        """Everything that decides what comes next, for `restore` and `Client.open_snapshot`."""
        request = TakeSnapshotRequest(session_id=self.session_id)
        asked = f"taking a snapshot of {self._subject}"
        async with self._turn:
            self._refuse_if_unknown("taking a snapshot of")
            return (await self._client.unary(TAKE_SNAPSHOT, request, asked=asked)).snapshot

    async def restore(self, snapshot: bytes) -> RestoredState:
        """Puts the session into the state of a snapshot of its like."""
        request = RestoreSnapshotRequest(session_id=self.session_id, snapshot=snapshot)
        asked = f"restoring {self._subject}"
        async with self._turn:
            # A step that got no answer must not come after it.
            self._hang_up()
            response = await self._client.unary(RESTORE_SNAPSHOT, request, asked=asked)
            self._is_unknown = False
        return restored_state(response.state, self._shapes)

    async def fork(self) -> "tuple[Session, RestoredState]":
        """A new session that goes on from where this one stands; both then go their own ways."""
        request = ForkSessionRequest(session_id=self.session_id)
        asked = f"forking {self._subject}"
        async with self._turn:
            self._refuse_if_unknown("forking")
            response = await self._client.unary(FORK_SESSION, request, asked=asked)
        session = Session(self._client, response.session)
        return session, restored_state(response.state, Shapes.of(session.spec, session.num_envs))

    async def render(
        self,
        *,
        camera: str = "",
        size: tuple[SupportsIndex, SupportsIndex] = (480, 480),
        env_indices: Sequence[int] = (),
    ) -> NDArray[np.uint8]:
        """Draws environments as they stand.

        Args:
            camera: One of `EnvironmentSpec.camera_names`; empty: the first of them.
            size: Pixels across and down.
            env_indices: Which environments, ascending; empty: all.

        Returns:
            [environments, height, width, 3].
        """
        picture = Picture.of(camera, size)
        request = render_request(self.session_id, picture, env_indices)
        asked = f"drawing {self._subject}"
        async with self._turn:
            return pictures(await self._client.unary(RENDER, request, asked=asked), picture)

    async def close(self) -> None:
        """Closes the session on the server, if the server is still there. May be repeated."""
        if self._is_closed:
            return
        self._is_closed = True
        self._hang_up()
        request = CloseSessionRequest(session_id=self.session_id)
        timeout_s = min(self._client.deadline_s, _CLOSE_TIMEOUT_S)
        # The server may be gone, and the session with it; or it will be closed for being idle.
        with contextlib.suppress(errors.PalrGymError):
            await self._client.unary(
                CLOSE_SESSION, request, asked="closing a session", timeout_s=timeout_s
            )

    async def __aenter__(self) -> Self:
        """Returns itself."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Closes the session."""
        await self.close()

    def _refuse_if_unknown(self, what: str) -> None:
        if self._is_unknown:
            raise errors.ResetNeeded(
                f"{what} {self._subject}: a call before got no answer, so the state of the "
                "environments is unknown; reset them"
            )

    async def _step(self, actions: NDArray[np.float32]) -> StepStreamResponse:
        request = StepRequest(session_id=self.session_id, actions=float32_tensor(actions))
        async with self._turn:
            self._refuse_if_unknown("stepping")
            if actions.nbytes < MAX_STREAMED_BYTES:
                return await self._ask(StepStreamRequest(step=request), "stepping")
            # A stream would end over a request that is too large; a call is only refused.
            self._is_unknown = True
            try:
                answer = await self._client.unary(STEP, request, asked=f"stepping {self._subject}")
            except (errors.InvalidArgument, errors.FailedPrecondition):
                self._is_unknown = False
                raise
            self._is_unknown = False
            return StepStreamResponse(step=answer)

    async def _ask(self, request: StepStreamRequest, what: str) -> StepStreamResponse:
        asked, server = f"{what} {self._subject}", self._client.server
        if self._is_closed:
            raise errors.FailedPrecondition(f"{asked} on {server}: this session has been closed")
        is_answered = False
        was_unknown, self._is_unknown = self._is_unknown, True
        try:
            answer = await self._exchange(request, asked)
            is_answered = True
        except TimeoutError:
            deadline_s = self._client.deadline_s
            raise errors.too_late(deadline_s, asked=asked, server=server) from None
        except grpc.RpcError as error:
            raise errors.from_rpc_error(error, asked=asked, server=server) from None
        finally:
            # This includes a task that was cancelled while it waited.
            if not is_answered:
                self._hang_up()
        self._is_unknown = was_unknown
        if answer.HasField("error"):
            raise errors.from_status(answer.error, asked=asked, server=server)
        return answer

    async def _exchange(self, request: StepStreamRequest, asked: str) -> StepStreamResponse:
        async with asyncio.timeout(self._client.deadline_s):
            if self._call is None or self._call.done():
                self._call = self._client.step_stream(asked)
            call = self._call
            try:
                await call.write(request)
            except (grpc.RpcError, asyncio.InvalidStateError):
                # What grpc says of a stream that broke meanwhile is of no use.
                text = "the stream broke"
                raise errors.unreachable(text, asked=asked, server=self._client.server) from None
            answer = await call.read()
            if isinstance(answer, StepStreamResponse):
                return answer
            text = await call.details() or "the server ended the stream"
            raise errors.unreachable(text, asked=asked, server=self._client.server)

    def _hang_up(self) -> None:
        if self._call is not None:
            self._call.cancel()
            self._call = None
