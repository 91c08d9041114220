"""What can go wrong, as exceptions, and the one function that makes them from gRPC's errors."""

from collections.abc import Mapping
from typing import ClassVar

import google.rpc.error_details_pb2 as error_details
import google.rpc.status_pb2 as rpc_status
import grpc
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

# After these, what became of the request is unknown.
UNANSWERED = (DeadlineExceeded, ServerUnavailable, ServerError, Cancelled)


def from_rpc_error(
    error: grpc.RpcError, *, asked: str, server: str, timeout_s: float | None = None
) -> PalrGymError:
    """The exception for a failed call.

    Args:
        error: As grpc raised it.
        asked: What was asked, such as "opening 4 environments of hopper".
        server: Address of the server, as the user knows it.
        timeout_s: Seconds that the call had.
    """
    if not isinstance(error, grpc.Call):
        return ServerError(f"{asked} on {server}: {error}")
    code = error.code() or grpc.StatusCode.UNKNOWN
    text = error.details() or "no further details"
    info, retry_after_s = _details(error)

    # Without an ErrorInfo, these two were found out by the client, not told by the server.
    if code is grpc.StatusCode.UNAVAILABLE and not info.reason:
        text = f"no palr-gym server can be reached ({text}). {_how_to_start(server)}"
    elif code is grpc.StatusCode.DEADLINE_EXCEEDED and not info.reason:
        text = f"no answer within {timeout_s:g} s" if timeout_s is not None else text

    error_class = _CLASSES.get(code, PalrGymError)
    if info.reason == "RESET_NEEDED":
        error_class = ResetNeeded
    return error_class(
        f"{asked} on {server}: {text}",
        code=code,
        reason=info.reason,
        metadata=info.metadata,
        retry_after_s=retry_after_s,
    )


def _details(call: grpc.Call) -> tuple[error_details.ErrorInfo, float | None]:
    """ErrorInfo and the seconds of RetryInfo from the trailers; empty and None if absent."""
    info = error_details.ErrorInfo()
    retry = error_details.RetryInfo()
    retry_after_s = None
    for key, value in call.trailing_metadata() or ():
        if key != STATUS_TRAILER or not isinstance(value, bytes):
            continue
        try:
            status = rpc_status.Status.FromString(value)
            for detail in status.details:
                # Unpack is false and does nothing if the detail is something else.
                detail.Unpack(info)
                if detail.Unpack(retry):
                    retry_after_s = retry.retry_delay.seconds + retry.retry_delay.nanos * 1e-9
        except DecodeError:
            # A proxy's trailer, not ours: the status code and its text still tell what happened.
            continue
    return info, retry_after_s


def _how_to_start(server: str) -> str:
    if server.startswith("unix:"):
        return f"Start one with: palr-gym serve --unix {server.removeprefix('unix:')}"
    return f"Start one with: palr-gym serve --listen {server}"
