"""What can go wrong, as exceptions, and the functions that make them from gRPC's statuses."""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import google.rpc.error_details_pb2 as error_details
import google.rpc.status_pb2 as rpc_status
import grpc
import grpc.aio
import gymnasium.error
from google.protobuf.message import DecodeError

STATUS_TRAILER = "grpc-status-details-bin"


class PalrGymError(Exception):
    """Root of every exception that this package raises about a server or a request.

    Attributes:
        code: gRPC's status code, the server's or the one that fits best.
        reason: What exactly was wrong, machine-readable, such as "UNKNOWN_TASK"; empty if the
            server did not say (or could not: it was never reached).
        metadata: Offending and expected values by name, as the server reported them.
        retry_after_s: Seconds after which a repetition may succeed, if the server said so.
    """

    DEFAULT_CODE: ClassVar[grpc.StatusCode] = grpc.StatusCode.UNKNOWN

    def __init__(
        self,
        message: str,
        *,
        code: grpc.StatusCode | None = None,
        reason: str = "",
        metadata: Mapping[str, str] | None = None,
        retry_after_s: float | None = None,
    ) -> None:
        """Everything but the message is optional, so that the exception can be pickled."""
        super().__init__(message)
        self.code = code or self.DEFAULT_CODE
        self.reason = reason
        self.metadata = dict(metadata or {})
        self.retry_after_s = retry_after_s


class InvalidArgument(PalrGymError, ValueError):
    """The request itself is wrong, whatever the state of the server."""

    DEFAULT_CODE = grpc.StatusCode.INVALID_ARGUMENT


class NotFound(PalrGymError, LookupError):
    """The task or session that was named does not exist."""

    DEFAULT_CODE = grpc.StatusCode.NOT_FOUND


class FailedPrecondition(PalrGymError, RuntimeError):
    """The request makes no sense in the present state."""

    DEFAULT_CODE = grpc.StatusCode.FAILED_PRECONDITION


class ResetNeeded(FailedPrecondition, gymnasium.error.ResetNeeded):
    """A step before the first reset, or after the end of an episode."""


class ResourceExhausted(PalrGymError, RuntimeError):
    """A limit of the server is reached."""

    DEFAULT_CODE = grpc.StatusCode.RESOURCE_EXHAUSTED


class DeadlineExceeded(PalrGymError, TimeoutError):
    """The server did not answer in time. Whether it did what was asked is unknown."""

    DEFAULT_CODE = grpc.StatusCode.DEADLINE_EXCEEDED


class ServerUnavailable(PalrGymError, ConnectionError):
    """There is no server, it went away, or it is shutting down."""

    DEFAULT_CODE = grpc.StatusCode.UNAVAILABLE


class ServerError(PalrGymError, RuntimeError):
    """The server failed, or answered something that the protocol does not allow."""

    DEFAULT_CODE = grpc.StatusCode.INTERNAL


class Unimplemented(PalrGymError, NotImplementedError):
    """This server does not know the call: it is older than this client, or no palr-gym server."""

    DEFAULT_CODE = grpc.StatusCode.UNIMPLEMENTED


class Cancelled(PalrGymError, RuntimeError):
    """The call was cancelled, for example because the client was closed meanwhile."""

    DEFAULT_CODE = grpc.StatusCode.CANCELLED


# Codes that are missing here become a plain PalrGymError.
_CLASSES: dict[grpc.StatusCode, type[PalrGymError]] = {
    grpc.StatusCode.INVALID_ARGUMENT: InvalidArgument,
    grpc.StatusCode.OUT_OF_RANGE: InvalidArgument,
    grpc.StatusCode.NOT_FOUND: NotFound,
    grpc.StatusCode.FAILED_PRECONDITION: FailedPrecondition,
    grpc.StatusCode.RESOURCE_EXHAUSTED: ResourceExhausted,
    grpc.StatusCode.DEADLINE_EXCEEDED: DeadlineExceeded,
    grpc.StatusCode.UNAVAILABLE: ServerUnavailable,
    grpc.StatusCode.INTERNAL: ServerError,
    grpc.StatusCode.UNKNOWN: ServerError,
    grpc.StatusCode.DATA_LOSS: ServerError,
    grpc.StatusCode.UNIMPLEMENTED: Unimplemented,
    grpc.StatusCode.CANCELLED: Cancelled,
}

_CODES: dict[int, grpc.StatusCode] = {code.value[0]: code for code in grpc.StatusCode}


def is_refusal(error: BaseException) -> bool:
    """Whether `error` means that nothing has changed on the server.

    After any other exception (KeyboardInterrupt, for example) nobody knows.
    """
    unanswered = (DeadlineExceeded, ServerUnavailable, ServerError, Cancelled)
    return isinstance(error, PalrGymError) and not isinstance(error, unanswered)


def from_rpc_error(
    error: grpc.RpcError, *, asked: str, server: str, timeout_s: float | None = None
) -> PalrGymError:
    """The exception for a failed call.

    Args:
        error: As grpc raised it.
        asked: What was asked, such as "opening 4 environment(s) of hopper".
        server: Address of the server, as the user knows it.
        timeout_s: Seconds that the call had.
    """
    if not isinstance(error, (grpc.Call, grpc.aio.AioRpcError)):
        return ServerError(f"{asked} on {server}: {error}")
    code = error.code() or grpc.StatusCode.UNKNOWN
    text = error.details() or "no further details"
    details = _details(_status_in_trailers(error))

    # Without an ErrorInfo, these two were found out by the client, not told by the server.
    if code is grpc.StatusCode.UNAVAILABLE and not details.info.reason:
        return unreachable(text, asked=asked, server=server)
    if code is grpc.StatusCode.DEADLINE_EXCEEDED and not details.info.reason and timeout_s:
        return too_late(timeout_s, asked=asked, server=server)
    return _exception(code, f"{asked} on {server}: {text}", details)


def from_status(status: rpc_status.Status, *, asked: str, server: str) -> PalrGymError:
    """The exception for a request on a stream that was answered with an error."""
    code = _CODES.get(status.code, grpc.StatusCode.UNKNOWN)
    return _exception(code, f"{asked} on {server}: {status.message}", _details(status))


def unreachable(text: str, *, asked: str, server: str) -> ServerUnavailable:
    """The exception for a server that is not there, or no longer."""
    if server.startswith("unix:"):
        option = f"--unix {server.removeprefix('unix:').removeprefix('//')}"
    else:
        option = f"--listen {server}"
    return ServerUnavailable(
        f"{asked} on {server}: the palr-gym server cannot be reached ({text}). "
        f"To start one: palr-gym serve {option}"
    )


def too_late(timeout_s: float, *, asked: str, server: str) -> DeadlineExceeded:
    """The exception for an answer that did not come in time."""
    return DeadlineExceeded(f"{asked} on {server}: no answer within {timeout_s:g} s")


@dataclass
class _Details:
    """What a status says beside its code and text."""

    info: error_details.ErrorInfo
    retry_after_s: float | None


def _details(status: rpc_status.Status) -> _Details:
    details = _Details(error_details.ErrorInfo(), None)
    retry = error_details.RetryInfo()
    for detail in status.details:
        # Unpack does nothing and is false if the detail is of another kind.
        detail.Unpack(details.info)
        if detail.Unpack(retry):
            details.retry_after_s = retry.retry_delay.seconds + retry.retry_delay.nanos * 1e-9
    return details


def _status_in_trailers(call: grpc.Call | grpc.aio.AioRpcError) -> rpc_status.Status:
    """The status with its details; an empty one if there is none that can be read."""
    for key, value in call.trailing_metadata() or ():
        if key == STATUS_TRAILER and isinstance(value, bytes):
            # Some proxy's trailer may be no Status; its code and text are enough then.
            with contextlib.suppress(DecodeError):
                return rpc_status.Status.FromString(value)
    return rpc_status.Status()


def _exception(code: grpc.StatusCode, message: str, details: _Details) -> PalrGymError:
    error_class = _CLASSES.get(code, PalrGymError)
    if details.info.reason == "RESET_NEEDED":
        error_class = ResetNeeded
    return error_class(
        message,
        code=code,
        reason=details.info.reason,
        metadata=details.info.metadata,
        retry_after_s=details.retry_after_s,
    )
