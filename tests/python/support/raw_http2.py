"""A client that does what no gRPC library would: HTTP/2 frames by hand (RFC 9113)."""

import socket
import struct
from typing import Self

_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
_DATA, _HEADERS, _SETTINGS, _WINDOW_UPDATE = 0, 1, 4, 8
_ACK = _END_STREAM = 0x1
_END_HEADERS = 0x4
_FRAME_BYTES = 16_384
# STREAM_WINDOW_BYTES of server/src/transport.rs; to send more would be a breach of the protocol.
_SERVER_WINDOW_BYTES = 4 << 20


def _frame(kind: int, flags: int, stream: int, payload: bytes) -> bytes:
    return struct.pack(">I", len(payload))[1:] + struct.pack(">BBI", kind, flags, stream) + payload


def _literal(text: str) -> bytes:
    return bytes((len(text),)) + text.encode("ascii")


def grpc_message(payload: bytes, announced: int | None = None) -> bytes:
    """A message with its prefix, which may announce another size than it has."""
    size = len(payload) if announced is None else announced
    return b"\0" + size.to_bytes(4, "big") + payload


class RawClient:
    """A connection that never reads, unless it is told to."""

    def __init__(self, address: str) -> None:
        """Connects and says HTTP/2's opening words."""
        host, _, port = address.rpartition(":")
        self._socket = socket.create_connection((host, int(port)), timeout=5)
        self._next_stream = 1
        # As much credit as there can be: the server may send whatever it likes.
        windows = struct.pack(">HI", 4, 2**31 - 1)
        credit = (2**31 - 1 - 65_535).to_bytes(4, "big")
        self._socket.sendall(
            _PREFACE + _frame(_SETTINGS, 0, 0, windows) + _frame(_WINDOW_UPDATE, 0, 0, credit)
        )
        # The server's windows hold once its settings are acknowledged and it has given credit for
        # the connection: the only things that are ever read.
        self._read_until(_SETTINGS)
        self._socket.sendall(_frame(_SETTINGS, _ACK, 0, b""))
        self._read_until(_WINDOW_UPDATE)

    def _read_until(self, kind: int) -> None:
        """Reads frames, the first of a kind included."""
        got = -1
        while got != kind:
            header = self._socket.recv(9, socket.MSG_WAITALL)
            got = header[3]
            self._socket.recv(int.from_bytes(header[:3], "big"), socket.MSG_WAITALL)

    def call(self, path: str) -> int:
        """Begins a call; returns its stream."""
        stream, self._next_stream = self._next_stream, self._next_stream + 2
        headers = {
            ":method": "POST",
            ":scheme": "http",
            ":path": path,
            ":authority": "localhost",
            "te": "trailers",
            "content-type": "application/grpc",
        }
        block = b"".join(
            b"\0" + _literal(name) + _literal(value) for name, value in headers.items()
        )
        self._socket.sendall(_frame(_HEADERS, _END_HEADERS, stream, block))
        return stream

    def send(self, stream: int, data: bytes, *, is_last: bool = False) -> None:
        """Sends data, without regard for the server's credit."""
        for start in range(0, len(data), _FRAME_BYTES):
            end = start + _FRAME_BYTES
            flags = _END_STREAM if is_last and end >= len(data) else 0
            self._socket.sendall(_frame(_DATA, flags, stream, data[start:end]))

    def flood(self, stream: int, data: bytes) -> int:
        """Sends data over and over, as much as the server lets a stream send before it is read.

        Returns:
            How often.
        """
        count = _SERVER_WINDOW_BYTES // len(data)
        for _ in range(count):
            self.send(stream, data)
        return count

    def is_closed_within(self, seconds: float) -> bool:
        """Whether the server hangs up."""
        self._socket.settimeout(seconds)
        try:
            while self._socket.recv(1 << 16):
                pass
        except TimeoutError:
            return False
        except OSError:
            return True
        return True

    def close(self) -> None:
        """Closes the socket."""
        self._socket.close()

    def __enter__(self) -> Self:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the socket."""
        self.close()
