"""The requests of one session and their answers, in order."""

import time
from collections import deque

from google.protobuf.message import DecodeError

from palr_gym import errors
from palr_gym._proto.palr_gym.v1.environment_service_pb2 import StepStreamResponse
from palr_gym.connection import STEP_STREAM, Connection
from palr_gym.stream import MessageStream


class Exchange:
    """Sends requests, takes answers, and opens a stream for them when there is none.

    A stream that is lost while no request is under way, such as one on which nothing happened for
    so long that the server hung up, is replaced without a word. If requests were under way, what
    became of them is unknown, and that is an error.
    """

    def __init__(self, connection: Connection, subject: str) -> None:
        """Opens nothing yet.

        Args:
            connection: To the server.
            subject: What the requests are about, for errors: "4 environment(s) of hopper-v0".
        """
        self._connection = connection
        self._subject = subject
        self._stream: MessageStream | None = None
        # When to give up waiting for each request that is under way.
        self._deadlines: deque[float] = deque()
        self.has_lost_requests = False

    @property
    def under_way(self) -> int:
        """Requests that were sent and whose answers nobody took yet."""
        return len(self._deadlines)

    def send(self, request: bytes, what: str) -> None:
        """Sends a request. The connection's deadline for its answer starts to run.

        Args:
            request: A serialised StepStreamRequest.
            what: What it does, for errors: "stepping".

        Raises:
            PalrGymError: The kind that fits.
        """
        connection = self._connection
        if connection.is_closed:
            connection.refuse(self._asked(what))
        deadline = time.monotonic() + connection.deadline_s
        try:
            stream = self._stream
            if stream is None or not (self._deadlines or stream.is_alive()):
                self.close()
                stream = connection.message_stream(STEP_STREAM)
                self._stream = stream
            stream.send(request, deadline)
        except OSError as error:
            raise self._failure(error, what) from None
        self._deadlines.append(deadline)

    def receive(self, what: str) -> StepStreamResponse:
        """Waits for the answer to the oldest request that has none yet.

        Args:
            what: What the request does, for errors: "stepping".

        Raises:
            PalrGymError: The kind that fits.
        """
        if self._stream is None or not self._deadlines:
            raise errors.FailedPrecondition(f"{self._asked(what)}: no request is under way")
        try:
            message = self._stream.receive(self._deadlines[0])
            answer = StepStreamResponse.FromString(message)
        except (OSError, DecodeError) as error:
            raise self._failure(error, what) from None
        # Only now: until an answer has been taken, its request is under way.
        self._deadlines.popleft()
        if answer.HasField("error"):
            server = self._connection.server
            raise errors.from_status(answer.error, asked=self._asked(what), server=server)
        return answer

    def close(self) -> None:
        """Ends the stream; requests that are under way get no answer. May be repeated."""
        self.has_lost_requests |= bool(self._deadlines)
        self._deadlines.clear()
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _asked(self, what: str) -> str:
        return f"{what} {self._subject}"

    def _failure(self, error: OSError | DecodeError, what: str) -> errors.PalrGymError:
        self.has_lost_requests = True
        self.close()
        asked, server = self._asked(what), self._connection.server
        match error:
            case TimeoutError():
                return errors.too_late(self._connection.deadline_s, asked=asked, server=server)
            case OSError():
                text = error.strerror or str(error)
                return errors.unreachable(text, asked=asked, server=server)
            case DecodeError():
                return errors.ServerError(f"{asked} on {server}: the answer is no message")
