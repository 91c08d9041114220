"""A connection to a server, for asyncio."""

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable
from typing import Self, SupportsIndex

import grpc
import grpc.aio
from gymnasium.vector import AutoresetMode

from palr_gym import errors, specs
from palr_gym._proto.palr_gym.v1 import environment_service_pb2, server_service_pb2
from palr_gym._proto.palr_gym.v1.environment_service_pb2 import (
    StepStreamRequest,
    StepStreamResponse,
)
from palr_gym._proto.palr_gym.v1.snapshot_service_pb2 import OpenSnapshotRequest
from palr_gym.address import parse_address, server_or_default
from palr_gym.aio.session import Session, StepStream
from palr_gym.arguments import seconds
from palr_gym.connection import (
    DEFAULT_DEADLINE_S,
    EVALUATE,
    GET_ENVIRONMENT_SPEC,
    GET_SERVER_INFO,
    LIST_TASKS,
    OPEN_SESSION,
    OPEN_SNAPSHOT,
    STEP_STREAM,
    Method,
    Request,
    Response,
    channel_options,
)
from palr_gym.evaluation import (
    DEFAULT_STALL_TIMEOUT_S,
    EpisodeResult,
    Evaluation,
    EvaluationResults,
    evaluation_request,
)
from palr_gym.policies import PolicySource
from palr_gym.results import RestoredState, Shapes, restored_state
from palr_gym.scene_options import SceneOptions
from palr_gym.session import (
    ObservationDtype,
    OutOfBounds,
    open_session_request,
    parse_autoreset_mode,
)


class Client:
    """A connection to one server, for asyncio. Opens no socket before the first call."""

    def __init__(
        self, server: str | None = None, *, deadline_s: float = DEFAULT_DEADLINE_S
    ) -> None:
        """See `palr_gym.Client`."""
        self.server = server_or_default(server)
        """Address of the server."""
        self.deadline_s = seconds("deadline_s", deadline_s)
        """Seconds that a call waits for its answer."""
        self._address = parse_address(self.server)
        self._channel: grpc.aio.Channel | None = None
        self._is_closed = False

    async def server_info(self) -> specs.ServerInfo:
        """Versions and limits of the server."""
        request = server_service_pb2.GetServerInfoRequest()
        asked = "asking for versions and limits"
        return specs.server_info(await self.unary(GET_SERVER_INFO, request, asked=asked))

    async def tasks(self) -> tuple[specs.Task, ...]:
        """Every task that the server hosts, in alphabetical order."""
        request = environment_service_pb2.ListTasksRequest()
        return specs.tasks(await self.unary(LIST_TASKS, request, asked="listing the tasks"))

    async def spec(self, env_id: str) -> specs.EnvironmentSpec:
        """Spaces and constants of an environment, without opening it.

        Args:
            env_id: TASK[-full|-paper|-strict|-pixels][-wN][-v0].
        """
        request = environment_service_pb2.GetEnvironmentSpecRequest(env_id=env_id)
        asked = f"describing {env_id}"
        response = await self.unary(GET_ENVIRONMENT_SPEC, request, asked=asked)
        return specs.environment_spec(response.spec)

    async def open_session(
        self,
        env_id: str,
        *,
        num_envs: SupportsIndex = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        out_of_bounds: OutOfBounds = "reject",
        observation_dtype: ObservationDtype = "float64",
        scene_options: SceneOptions | None = None,
    ) -> Session:
        """Opens environments to step. Arguments as of `palr_gym.Client.open_session`."""
        request = open_session_request(
            env_id,
            num_envs=num_envs,
            autoreset_mode=parse_autoreset_mode(autoreset_mode),
            out_of_bounds=out_of_bounds,
            observation_dtype=observation_dtype,
            scene_options=scene_options,
        )
        asked = f"opening {num_envs} environment(s) of {env_id}"
        return Session(self, await self.unary(OPEN_SESSION, request, asked=asked))

    async def open_snapshot(self, snapshot: bytes) -> tuple[Session, RestoredState]:
        """Opens a session in the state of a snapshot, which may come from another server."""
        request = OpenSnapshotRequest(snapshot=snapshot)
        asked = f"opening a session from a snapshot of {len(snapshot)} bytes"
        response = await self.unary(OPEN_SNAPSHOT, request, asked=asked)
        session = Session(self, response.session)
        return session, restored_state(response.state, Shapes.of(session.spec, session.num_envs))

    async def evaluate(
        self,
        env_id: str,
        policy: PolicySource,
        *,
        episodes: SupportsIndex = 20,
        seed: SupportsIndex = 0,
        sampled: bool = False,
        num_envs: SupportsIndex | None = None,
        scene_options: SceneOptions | None = None,
        on_episode: Callable[[EpisodeResult], None] | None = None,
        timeout_s: float | None = None,
        stall_timeout_s: float = DEFAULT_STALL_TIMEOUT_S,
    ) -> Evaluation:
        """Plays whole episodes on the server. Arguments as of `palr_gym.evaluate`."""
        request = evaluation_request(
            env_id,
            policy,
            episodes=episodes,
            seed=seed,
            sampled=sampled,
            num_envs=num_envs,
            scene_options=scene_options,
        )
        results = EvaluationResults(policy, request, self.server, on_episode)
        messages = self._server_stream(
            EVALUATE,
            request,
            asked=results.asked,
            timeout_s=timeout_s,
            stall_timeout_s=stall_timeout_s,
        )
        async with contextlib.aclosing(messages):
            async for message in messages:
                results.take(message)
        return results.evaluation()

    async def close(self) -> None:
        """Closes the connection; calls that are still running fail with `Cancelled`.

        Sessions are not closed by this. May be repeated.
        """
        self._is_closed = True
        if self._channel is not None:
            await self._channel.close()

    async def __aenter__(self) -> Self:
        """Returns itself."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Closes the connection."""
        await self.close()

    async def unary(
        self,
        method: Method[Request, Response],
        request: Request,
        *,
        asked: str,
        timeout_s: float | None = None,
    ) -> Response:
        """One request, one answer; for calls that have no method of their own here."""
        timeout_s = self.deadline_s if timeout_s is None else timeout_s
        call = self.channel(asked).unary_unary(
            method.path,
            request_serializer=method.request.SerializeToString,
            response_deserializer=method.response.FromString,
        )
        try:
            return await call(request, timeout=timeout_s)
        except grpc.RpcError as error:
            raise self._failure(error, asked, timeout_s) from None

    async def _server_stream(
        self,
        method: Method[Request, Response],
        request: Request,
        *,
        asked: str,
        timeout_s: float | None,
        stall_timeout_s: float,
    ) -> AsyncGenerator[Response]:
        stall_timeout_s = seconds("stall_timeout_s", stall_timeout_s)
        timeout_s = None if timeout_s is None else seconds("timeout_s", timeout_s)
        call: grpc.aio.UnaryStreamCall[Request, Response] = self.channel(asked).unary_stream(
            method.path,
            request_serializer=method.request.SerializeToString,
            response_deserializer=method.response.FromString,
        )(request, timeout=timeout_s)
        try:
            while True:
                async with asyncio.timeout(stall_timeout_s):
                    message = await call.read()
                if not isinstance(message, method.response):
                    return
                yield message
        except TimeoutError:
            raise errors.DeadlineExceeded(
                f"{asked} on {self.server}: no message within {stall_timeout_s:g} s"
            ) from None
        except grpc.RpcError as error:
            raise self._failure(error, asked, timeout_s) from None
        finally:
            call.cancel()

    def step_stream(self, asked: str) -> StepStream:
        """A new stream for resets and steps."""
        return self.channel(asked).stream_stream(
            STEP_STREAM.path,
            request_serializer=StepStreamRequest.SerializeToString,
            response_deserializer=StepStreamResponse.FromString,
        )()

    def channel(self, asked: str) -> grpc.aio.Channel:
        """The channel, opened when it is first needed: it belongs to the running loop."""
        if self._is_closed:
            raise errors.FailedPrecondition(
                f"{asked} on {self.server}: this client has been closed"
            )
        if self._channel is None:
            options = channel_options(self._address)
            self._channel = grpc.aio.insecure_channel(self._address.target, options=options)
        return self._channel

    def _failure(
        self, error: grpc.RpcError, asked: str, timeout_s: float | None
    ) -> errors.PalrGymError:
        return errors.from_rpc_error(error, asked=asked, server=self.server, timeout_s=timeout_s)
