"""Calls to one server: a channel, a deadline on every call, typed errors.

Only this module and `aio.py` call grpc. Steps go through `stream.py` instead.
"""

import threading
import time
from collections.abc import Generator
from dataclasses import dataclass
from typing import Generic, NoReturn, TypeVar

import grpc
from google.protobuf.message import Message

from palr_gym._proto.palr_gym.v1 import (
    collection_service_pb2,
    environment_service_pb2,
    evaluation_service_pb2,
    leakage_service_pb2,
    render_service_pb2,
    server_service_pb2,
    snapshot_service_pb2,
)
from palr_gym.address import Address, parse_address
from palr_gym.arguments import seconds
from palr_gym.errors import DeadlineExceeded, FailedPrecondition, from_rpc_error
from palr_gym.stream import MessageStream

DEFAULT_DEADLINE_S = 30.0
"""Seconds that a call waits for its answer."""

Request = TypeVar("Request", bound=Message)
Response = TypeVar("Response", bound=Message)

_CHANNEL_OPTIONS: tuple[tuple[str, str | int], ...] = (
    # A session of many environments, or an episode with pixels, is larger than grpc's 4 MiB.
    ("grpc.max_receive_message_length", -1),
    ("grpc.max_send_message_length", -1),
    # A client's connection is its own: a forked process cannot use what its parent opened, and
    # grpc would hand it out.
    ("grpc.use_local_subchannel_pool", 1),
    # Steps take no detour (see stream.py), so nothing else may.
    ("grpc.enable_http_proxy", 0),
    # A machine that vanishes sends nothing: ask it whether it is still there.
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.keepalive_timeout_ms", 20_000),
    # After a restart of the server, do not sit out grpc's two minutes.
    ("grpc.initial_reconnect_backoff_ms", 250),
    ("grpc.max_reconnect_backoff_ms", 2_000),
)


def channel_options(address: Address) -> list[tuple[str, str | int]]:
    """How a channel of ours behaves."""
    return [*_CHANNEL_OPTIONS, ("grpc.default_authority", address.authority)]


@dataclass(frozen=True)
class Method(Generic[Request, Response]):
    """A remote method and the types of its messages."""

    path: str
    request: type[Request]
    response: type[Response]


def _method(
    service: str, name: str, request: type[Request], response: type[Response]
) -> Method[Request, Response]:
    return Method(f"/palr_gym.v1.{service}/{name}", request, response)


_environments = environment_service_pb2
GET_SERVER_INFO = _method(
    "ServerService",
    "GetServerInfo",
    server_service_pb2.GetServerInfoRequest,
    server_service_pb2.GetServerInfoResponse,
)
LIST_TASKS = _method(
    "EnvironmentService",
    "ListTasks",
    _environments.ListTasksRequest,
    _environments.ListTasksResponse,
)
GET_ENVIRONMENT_SPEC = _method(
    "EnvironmentService",
    "GetEnvironmentSpec",
    _environments.GetEnvironmentSpecRequest,
    _environments.GetEnvironmentSpecResponse,
)
OPEN_SESSION = _method(
    "EnvironmentService",
    "OpenSession",
    _environments.OpenSessionRequest,
    _environments.OpenSessionResponse,
)
CLOSE_SESSION = _method(
    "EnvironmentService",
    "CloseSession",
    _environments.CloseSessionRequest,
    _environments.CloseSessionResponse,
)
RESET = _method(
    "EnvironmentService", "Reset", _environments.ResetRequest, _environments.ResetResponse
)
STEP = _method("EnvironmentService", "Step", _environments.StepRequest, _environments.StepResponse)
STEP_STREAM = _method(
    "EnvironmentService",
    "StepStream",
    _environments.StepStreamRequest,
    _environments.StepStreamResponse,
)
RENDER = _method(
    "RenderService",
    "Render",
    render_service_pb2.RenderRequest,
    render_service_pb2.RenderResponse,
)
TAKE_SNAPSHOT = _method(
    "SnapshotService",
    "TakeSnapshot",
    snapshot_service_pb2.TakeSnapshotRequest,
    snapshot_service_pb2.TakeSnapshotResponse,
)
RESTORE_SNAPSHOT = _method(
    "SnapshotService",
    "RestoreSnapshot",
    snapshot_service_pb2.RestoreSnapshotRequest,
    snapshot_service_pb2.RestoreSnapshotResponse,
)
OPEN_SNAPSHOT = _method(
    "SnapshotService",
    "OpenSnapshot",
    snapshot_service_pb2.OpenSnapshotRequest,
    snapshot_service_pb2.OpenSnapshotResponse,
)
FORK_SESSION = _method(
    "SnapshotService",
    "ForkSession",
    snapshot_service_pb2.ForkSessionRequest,
    snapshot_service_pb2.ForkSessionResponse,
)
EVALUATE = _method(
    "EvaluationService",
    "Evaluate",
    evaluation_service_pb2.EvaluateRequest,
    evaluation_service_pb2.EvaluateResponse,
)
ESTIMATE_LEAKAGE = _method(
    "LeakageService",
    "EstimateLeakage",
    leakage_service_pb2.EstimateLeakageRequest,
    leakage_service_pb2.EstimateLeakageResponse,
)
COLLECT = _method(
    "CollectionService",
    "Collect",
    collection_service_pb2.CollectRequest,
    collection_service_pb2.CollectResponse,
)


class Connection:
    """A channel to one server. Opens no socket before the first call. Thread-safe."""

    def __init__(self, server: str, deadline_s: float) -> None:
        """See `palr_gym.Client`."""
        self._address = parse_address(server)
        self.server = server
        self.deadline_s = seconds("deadline_s", deadline_s)
        self._channel = grpc.insecure_channel(
            self._address.target,
            options=channel_options(self._address),
        )
        self.is_closed = False

    def unary(
        self,
        method: Method[Request, Response],
        request: Request,
        *,
        asked: str,
        timeout_s: float | None = None,
    ) -> Response:
        """One request, one answer, within `timeout_s` (None: the connection's deadline).

        Raises:
            PalrGymError: The kind that fits.
        """
        timeout_s = self.deadline_s if timeout_s is None else timeout_s
        if self.is_closed:
            self.refuse(asked)
        call = self._channel.unary_unary(
            method.path,
            request_serializer=method.request.SerializeToString,
            response_deserializer=method.response.FromString,
        )
        try:
            return call(request, timeout=timeout_s)
        except grpc.RpcError as error:
            raise from_rpc_error(
                error, asked=asked, server=self.server, timeout_s=timeout_s
            ) from None

    def message_stream(self, method: Method[Request, Response]) -> MessageStream:
        """A stream of serialised messages there and back, for whoever counts microseconds.

        Raises:
            OSError: The server cannot be reached; TimeoutError if not in time.
        """
        return MessageStream(self._address, method.path, self.deadline_s)

    def server_stream(
        self,
        method: Method[Request, Response],
        request: Request,
        *,
        asked: str,
        timeout_s: float | None,
        stall_timeout_s: float,
    ) -> Generator[Response]:
        """One request, many answers. Closing the iterator cancels the call.

        Args:
            method: What to call.
            request: What to send.
            asked: What was asked, for errors.
            timeout_s: Seconds for the whole call; None: no limit.
            stall_timeout_s: Seconds to wait for each answer.

        Raises:
            PalrGymError: The kind that fits.
        """
        stall_timeout_s = seconds("stall_timeout_s", stall_timeout_s)
        timeout_s = None if timeout_s is None else seconds("timeout_s", timeout_s)
        if self.is_closed:
            self.refuse(asked)
        call = self._channel.unary_stream(
            method.path,
            request_serializer=method.request.SerializeToString,
            response_deserializer=method.response.FromString,
        )(request, timeout=timeout_s)
        watchdog = _Watchdog(call, stall_timeout_s)
        try:
            while True:
                with watchdog:
                    answer = next(call, None)
                if answer is None:
                    return
                yield answer
        except grpc.RpcError as error:
            if watchdog.has_barked:
                raise DeadlineExceeded(
                    f"{asked} on {self.server}: no message within {stall_timeout_s:g} s"
                ) from None
            raise from_rpc_error(
                error, asked=asked, server=self.server, timeout_s=timeout_s
            ) from None
        finally:
            watchdog.close()
            call.cancel()

    def close(self) -> None:
        """Closes the channel; calls that are still running fail with `Cancelled`."""
        self.is_closed = True
        self._channel.close()

    def refuse(self, asked: str) -> NoReturn:
        """Raises what a call after `close` raises."""
        raise FailedPrecondition(f"{asked} on {self.server}: this client has been closed")


class _Watchdog:
    """Cancels a call when one `with` block lasts too long. The blocks may be many, one by one.

    A grpc stream has no timeout for a single message. The time that the user of the messages
    takes between two of them does not count.
    """

    def __init__(self, call: grpc.RpcContext, timeout_s: float) -> None:
        self.has_barked = False
        self._call = call
        self._timeout_s = timeout_s
        self._barks_at: float | None = None
        self._is_closed = False
        self._condition = threading.Condition()
        self._thread = threading.Thread(target=self._watch, name="palr_gym-watchdog", daemon=True)
        self._thread.start()

    def __enter__(self) -> None:
        with self._condition:
            self._barks_at = time.monotonic() + self._timeout_s

    def __exit__(self, *_: object) -> None:
        with self._condition:
            self._barks_at = None

    def close(self) -> None:
        with self._condition:
            self._is_closed = True
            self._condition.notify()

    def _watch(self) -> None:
        with self._condition:
            while not self._is_closed:
                # Every block ends at least `timeout_s` after this moment or after its own start,
                # so there is no need to wake this thread for each of them.
                now = time.monotonic()
                if self._barks_at is not None and now >= self._barks_at:
                    self.has_barked = True
                    self._call.cancel()
                    return
                barks_at = now + self._timeout_s if self._barks_at is None else self._barks_at
                self._condition.wait(barks_at - now)
