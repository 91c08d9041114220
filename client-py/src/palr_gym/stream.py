"""One bidirectional gRPC stream on a socket of its own: messages there and back, at a high rate.

Why not grpc: of a step of one hopper over a Unix socket, which takes 200 µs this way, its Python
package makes 450 µs, nearly all of the difference in its own threads and locks; and it has no
deadline for a single message of a stream.

This is as much of HTTP/2 (RFC 9113) as one stream needs: frames, flow control, pings, settings. It
reads no headers, because they hold nothing that is needed: errors about requests come as messages,
and a stream that ends is lost, whatever its trailers say. Not here: TLS, proxies, compression.
"""

import os
import socket
import struct
import threading
import time
import weakref
from collections import deque
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

from palr_gym._version import __version__
from palr_gym.address import Address

_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
_CONNECTION = 0
_STREAM = 1


class _Frame(IntEnum):
    DATA = 0
    HEADERS = 1
    RST_STREAM = 3
    SETTINGS = 4
    PING = 6
    GOAWAY = 7
    WINDOW_UPDATE = 8


class _Setting(IntEnum):
    HEADER_TABLE_SIZE = 1
    ENABLE_PUSH = 2
    INITIAL_WINDOW_SIZE = 4
    MAX_FRAME_SIZE = 5


_ACK = 0x1  # of SETTINGS and PING
_END_STREAM = 0x1  # of DATA and HEADERS
_END_HEADERS = 0x4
_PADDED = 0x8

_FRAME_HEADER_BYTES = 9
# Of a gRPC message: one byte that says whether it is compressed, four with its length.
_PREFIX_BYTES = 5

# What holds for both sides until they say otherwise.
_DEFAULT_WINDOW_BYTES = 65_535
_DEFAULT_FRAME_BYTES = 16_384
# We read everything at once, so the server need never wait for credit.
_OUR_WINDOW_BYTES = 2**31 - 1
_OUR_FRAME_BYTES = 2**20

CREDIT_BYTES = 2**30
"""After this many received bytes the server gets new credit."""

IDLE_S = 1.0
"""After a pause of this length, a stream is idle."""
_CARE_PERIOD_S = 0.5
_CARE_TIMEOUT_S = 1.0


class StreamLost(ConnectionError):
    """The server ended the stream. What became of messages under way is unknown."""


class MessageStream:
    """A stream of messages to and from one method.

    After any exception the stream is closed. While nobody waits for a message, a thread that all
    streams share looks after them: servers ask now and then whether their clients live, and want
    to know before they shut down.
    """

    def __init__(self, address: Address, path: str, timeout_s: float) -> None:
        """Connects.

        Raises:
            OSError: As the socket has it; TimeoutError if it took too long.
        """
        # What the server allows us to send; credit can be negative after a change of settings.
        self._frame_bytes: int = _DEFAULT_FRAME_BYTES
        self._server_window: int = _DEFAULT_WINDOW_BYTES
        self._stream_credit: int = _DEFAULT_WINDOW_BYTES
        self._connection_credit: int = _DEFAULT_WINDOW_BYTES
        # Bytes of messages that the server sent since it last got credit.
        self._received = 0
        # Bytes that arrived and were not looked at yet are _view[_start:_end].
        self._view = memoryview(bytearray(1 << 16))
        self._start: int = 0
        self._end: int = 0
        # The message of which only a part has arrived, and whole ones that nobody took yet.
        self._partial = bytearray()
        self._messages: deque[bytes] = deque()
        self._lost_because: str | None = None
        self._last_used = time.monotonic()
        # Whoever holds it may use everything above, and the socket.
        self._lock = threading.RLock()
        self._socket = _connect(address, self._last_used + timeout_s)
        # Python warns of sockets that are forgotten; streams may be.
        weakref.finalize(self, self._socket.close)
        self._socket.sendall(_opening(address.authority, path))
        _carer.care_for(self)

    def send(self, message: bytes, deadline: float) -> None:
        """Sends a message.

        Args:
            message: Its bytes.
            deadline: When to give up, in `time.monotonic`'s seconds.

        Raises:
            OSError: StreamLost if the stream has ended, TimeoutError if the deadline has passed,
                others as the socket has them.
        """
        data = b"\0" + len(message).to_bytes(4, "big") + message
        with self._lock:
            try:
                while data:
                    data = data[self._send_part(data, deadline) :]
            except BaseException:
                self.close()
                raise

    def receive(self, deadline: float) -> bytes:
        """Waits for a message.

        Args:
            deadline: When to give up, in `time.monotonic`'s seconds.

        Raises:
            OSError: StreamLost if the stream has ended, TimeoutError if the deadline has passed,
                others as the socket has them.
        """
        with self._lock:
            try:
                while not self._messages:
                    self._wait_for_frames(deadline)
            except BaseException:
                self.close()
                raise
            self._last_used = time.monotonic()
            return self._messages.popleft()

    def is_alive(self) -> bool:
        """Whether the stream can still be used, as far as can be known without sending."""
        with self._lock:
            self._look_if_idle()
            return self._lost_because is None and not self.is_closed

    def care(self) -> None:
        """Answers the server's pings if nobody else is about to."""
        if self._lock.acquire(blocking=False):
            try:
                self._look_if_idle()
            finally:
                self._lock.release()

    @property
    def is_closed(self) -> bool:
        """Whether this side has ended the stream."""
        return self._socket.fileno() < 0

    def close(self) -> None:
        """Ends the stream. May be repeated."""
        with self._lock:
            self._socket.close()

    def abandon(self) -> None:
        """In a forked child: leaves the stream to the parent."""
        # A thread that only the parent has may be holding the lock.
        self._lock = threading.RLock()
        self.close()

    def _look_if_idle(self) -> None:
        """After a pause, takes in what has arrived meanwhile. Does not wait."""
        if self.is_closed or time.monotonic() - self._last_used < IDLE_S:
            return
        try:
            while self._lost_because is None:
                self._socket.setblocking(False)
                try:
                    self._read()
                except BlockingIOError:
                    return
                self._socket.settimeout(_CARE_TIMEOUT_S)
                self._take_frames()
        except OSError as error:
            self._end_because(str(error))
        # Hanging up is all the server still waits for.
        self.close()

    def _send_part(self, data: bytes, deadline: float) -> int:
        """Sends a frame with as much of `data` as is allowed; returns how much that was."""
        size = min(len(data), self._frame_bytes, self._stream_credit, self._connection_credit)
        if size <= 0:
            # The server gives credit when it has read what it got.
            self._wait_for_frames(deadline)
            return 0
        self._stream_credit -= size
        self._connection_credit -= size
        self._socket.settimeout(_remaining(deadline))
        self._socket.sendall(_frame(_Frame.DATA, 0, _STREAM, data[:size]))
        return size

    def _wait_for_frames(self, deadline: float) -> None:
        """Takes in what arrives next."""
        if self._lost_because is not None:
            raise StreamLost(self._lost_because)
        self._socket.settimeout(_remaining(deadline))
        self._read()
        self._take_frames()

    def _read(self) -> None:
        """Reads what has arrived, as much as there is room for."""
        if self._start == self._end:
            self._start = self._end = 0
        elif self._end == len(self._view):
            unread = self._view[self._start : self._end]
            # If it fills all of the buffer, it is the beginning of a frame that needs a larger one.
            factor = 2 if self._start == 0 else 1
            self._view = memoryview(bytearray(factor * len(self._view)))
            self._view[: len(unread)] = unread
            self._start, self._end = 0, len(unread)
        size = self._socket.recv_into(self._view[self._end :])
        if size == 0:
            self._end_because("the server closed the connection")
        self._end += size

    def _end_because(self, reason: str) -> None:
        """Notes why nothing more will come. What has come already can still be taken."""
        self._lost_because = self._lost_because or reason

    def _take_frames(self) -> None:
        """Takes every whole frame out of the buffer."""
        view = self._view
        while self._end - self._start >= _FRAME_HEADER_BYTES:
            start = self._start + _FRAME_HEADER_BYTES
            end = start + int.from_bytes(view[self._start : self._start + 3], "big")
            if end - start > _OUR_FRAME_BYTES:
                raise StreamLost(f"the server sent a frame of {end - start} bytes")
            if end > self._end:
                return
            kind, flags = view[self._start + 3], view[self._start + 4]
            if kind == _Frame.DATA:
                self._take_data(flags, view[start:end])
            else:
                stream = int.from_bytes(view[start - 4 : start], "big")
                self._take_control(kind, flags, stream, bytes(view[start:end]))
            self._start = end

    def _take_data(self, flags: int, payload: memoryview) -> None:
        self._received += len(payload)
        if flags & _PADDED:
            payload = payload[1 : len(payload) - payload[0]]
        if not self._partial and len(payload) == _message_bytes(payload):
            # Nearly always a frame is a message.
            self._messages.append(bytes(payload[_PREFIX_BYTES:]))
        else:
            self._partial += payload
            while len(self._partial) >= (end := _message_bytes(self._partial)):
                self._messages.append(bytes(self._partial[_PREFIX_BYTES:end]))
                del self._partial[:end]
        if flags & _END_STREAM:
            self._end_because("the server ended the stream")
        if self._received >= CREDIT_BYTES:
            credit = self._received.to_bytes(4, "big")
            self._received = 0
            for stream in (_CONNECTION, _STREAM):
                self._socket.sendall(_frame(_Frame.WINDOW_UPDATE, 0, stream, credit))

    def _take_control(self, kind: int, flags: int, stream: int, payload: bytes) -> None:
        match kind:
            case _Frame.HEADERS if flags & _END_STREAM:
                self._end_because("the server ended the stream")
            case _Frame.RST_STREAM:
                code = int.from_bytes(payload, "big")
                self._end_because(f"the server reset the stream (HTTP/2 error {code})")
            case _Frame.GOAWAY:
                last_stream, code = struct.unpack_from(">II", payload)
                if last_stream & 0x7FFFFFFF < _STREAM:
                    self._end_because(f"the server refused the stream (HTTP/2 error {code})")
            case _Frame.SETTINGS if not flags & _ACK:
                for setting, value in struct.iter_unpack(">HI", payload):
                    if setting == _Setting.INITIAL_WINDOW_SIZE:
                        self._stream_credit += value - self._server_window
                        self._server_window = value
                    elif setting == _Setting.MAX_FRAME_SIZE:
                        self._frame_bytes = value
                self._socket.sendall(_frame(_Frame.SETTINGS, _ACK, _CONNECTION, b""))
            case _Frame.PING if not flags & _ACK:
                self._socket.sendall(_frame(_Frame.PING, _ACK, _CONNECTION, payload))
            case _Frame.WINDOW_UPDATE:
                credit = int.from_bytes(payload, "big")
                if stream == _STREAM:
                    self._stream_credit += credit
                else:
                    self._connection_credit += credit
            case _:
                # Headers before the first message, and what says nothing about messages.
                pass


def _connect(address: Address, deadline: float) -> socket.socket:
    if address.unix_path is not None:
        return _connect_to(socket.AF_UNIX, address.unix_path, deadline)
    refusal = OSError(f"{address.host} has no address")
    for family, *_, place in socket.getaddrinfo(
        address.host, address.port, type=socket.SOCK_STREAM
    ):
        try:
            connected = _connect_to(family, place, deadline)
        except OSError as error:
            refusal = error
        else:
            # A request must not wait for the answer to the one before.
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return connected
    raise refusal


def _connect_to(family: int, place: Any, deadline: float) -> socket.socket:
    connected = socket.socket(family, socket.SOCK_STREAM)
    try:
        connected.settimeout(_remaining(deadline))
        connected.connect(place)
    except BaseException:
        connected.close()
        raise
    return connected


def _remaining(deadline: float) -> float:
    """Seconds until `deadline`; never 0, which would mean not to wait and not to fail."""
    remaining = deadline - time.monotonic()
    if remaining <= 0:
        raise TimeoutError
    return remaining


def _message_bytes(data: Sequence[int]) -> int:
    """Length of the message that starts with `data`, prefix included, or of the prefix."""
    if len(data) < _PREFIX_BYTES:
        return _PREFIX_BYTES
    if data[0]:
        raise StreamLost("the server sent a compressed message")
    return _PREFIX_BYTES + int.from_bytes(data[1:_PREFIX_BYTES], "big")


def _frame(kind: int, flags: int, stream: int, payload: bytes) -> bytes:
    return (
        len(payload).to_bytes(3, "big") + bytes((kind, flags)) + stream.to_bytes(4, "big") + payload
    )


def _opening(authority: str, path: str) -> bytes:
    """What a client says first: its settings, its credit, and which method it calls."""
    settings = {
        # The server's headers must not refer to earlier ones, which nobody here has read.
        _Setting.HEADER_TABLE_SIZE: 0,
        _Setting.ENABLE_PUSH: 0,
        _Setting.INITIAL_WINDOW_SIZE: _OUR_WINDOW_BYTES,
        _Setting.MAX_FRAME_SIZE: _OUR_FRAME_BYTES,
    }
    headers = {
        ":method": "POST",
        ":scheme": "http",
        ":path": path,
        ":authority": authority,
        "te": "trailers",
        "content-type": "application/grpc",
        "user-agent": f"palr-gym-python/{__version__}",
    }
    credit = (_OUR_WINDOW_BYTES - _DEFAULT_WINDOW_BYTES).to_bytes(4, "big")
    settings_payload = b"".join(struct.pack(">HI", *setting) for setting in settings.items())
    headers_payload = b"".join(
        b"\0" + _literal(name) + _literal(value) for name, value in headers.items()
    )
    return (
        _PREFACE
        + _frame(_Frame.SETTINGS, 0, _CONNECTION, settings_payload)
        + _frame(_Frame.WINDOW_UPDATE, 0, _CONNECTION, credit)
        + _frame(_Frame.HEADERS, _END_HEADERS, _STREAM, headers_payload)
    )


def _literal(text: str) -> bytes:
    """A text of at most 254 bytes in HPACK (RFC 7541), as it is, without Huffman's code."""
    encoded = text.encode("ascii")
    size = len(encoded)
    return bytes((size,) if size < 127 else (127, size - 127)) + encoded


class _Carer:
    """The thread that looks after idle streams. It lives as long as there are any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.streams: weakref.WeakSet[MessageStream] = weakref.WeakSet()
        self._is_running = False

    def care_for(self, stream: MessageStream) -> None:
        with self._lock:
            self.streams.add(stream)
            if not self._is_running:
                self._is_running = True
                threading.Thread(target=self._run, name="palr_gym-carer", daemon=True).start()

    def open_streams(self) -> list[MessageStream]:
        with self._lock:
            return [stream for stream in self.streams if not stream.is_closed]

    def _run(self) -> None:
        while True:
            time.sleep(_CARE_PERIOD_S)
            for stream in self.open_streams():
                stream.care()
            with self._lock:
                if all(stream.is_closed for stream in self.streams):
                    self._is_running = False
                    return


_carer = _Carer()


def _leave_streams_to_the_parent() -> None:
    """In a forked child: two processes cannot share a stream; the child will open its own."""
    global _carer
    forgotten, _carer = _carer, _Carer()
    for stream in list(forgotten.streams):
        stream.abandon()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_streams_to_the_parent)
