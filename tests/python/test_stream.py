"""The stream of steps at its edges: a peer that frames as it likes, and connections that break."""

import contextlib
import itertools
import socket
import struct
import threading
import time
from collections.abc import Callable, Generator
from typing import NoReturn

import numpy as np
import pytest

from palr_gym import Client, Session, errors, make, make_vec, stream
from palr_gym.address import parse_address
from palr_gym.exchange import Exchange
from palr_gym.stream import MessageStream, StreamLost
from support.reference import assert_same_bits, random_actions

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
DATA, HEADERS, RST_STREAM, SETTINGS, PING, GOAWAY, WINDOW_UPDATE = 0, 1, 3, 4, 6, 7, 8
END_STREAM, ACK, END_HEADERS, PADDED = 1, 1, 4, 8


def frame(kind: int, flags: int, stream_id: int, payload: bytes = b"") -> bytes:
    return (
        struct.pack(">I", len(payload))[1:]
        + bytes((kind, flags))
        + struct.pack(">I", stream_id)
        + payload
    )


def prefixed(message: bytes) -> bytes:
    """A gRPC message."""
    return b"\0" + struct.pack(">I", len(message)) + message


class Peer:
    """The server's side of a connection, by hand."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.frames: list[tuple[int, int, int, bytes]] = []

    def send(self, *parts: bytes) -> None:
        self.connection.sendall(b"".join(parts))

    def read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            more = self.connection.recv(size - len(data))
            assert more, "the client hung up"
            data += more
        return data

    def read_frame(self) -> tuple[int, int, int, bytes]:
        head = self.read(9)
        payload = self.read(int.from_bytes(head[:3], "big"))
        self.frames.append((head[3], head[4], int.from_bytes(head[5:], "big"), payload))
        return self.frames[-1]

    def read_until(self, kind: int) -> tuple[int, int, int, bytes]:
        while (last := self.read_frame())[0] != kind:
            pass
        return last

    def read_data(self, size: int) -> bytes:
        """Messages of the stream, `size` bytes of them, prefixes included."""
        data = b""
        while len(data) < size:
            data += self.read_until(DATA)[3]
        return data


@contextlib.contextmanager
def connected(script: Callable[[Peer], None]) -> Generator[MessageStream]:
    """A stream to a peer that has read the opening and then follows `script`."""
    failures: list[BaseException] = []

    def serve() -> None:
        try:
            connection, _ = listener.accept()
            with connection:
                connection.settimeout(10)
                peer = Peer(connection)
                assert peer.read(len(PREFACE)) == PREFACE
                assert peer.read_until(HEADERS)[1:3] == (END_HEADERS, 1)
                script(peer)
        except BaseException as error:  # noqa: BLE001 - it is raised in the test's own thread
            failures.append(error)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve)
        thread.start()
        address = parse_address(f"127.0.0.1:{listener.getsockname()[1]}")
        client = MessageStream(address, "/a/b", 5)
        try:
            yield client
        finally:
            client.close()
            thread.join(10)
    assert not failures, failures


def soon(seconds: float = 5) -> float:
    return time.monotonic() + seconds


def receive_all(client: MessageStream) -> NoReturn:
    while True:
        client.receive(soon())


RESPONSE_HEADERS = frame(HEADERS, END_HEADERS, 1, b"\x88")


def test_messages_may_be_framed_in_any_way() -> None:
    messages = [b"", b"x", b"y" * 200, b"z" * 70_000, b"w" * 5]
    stream_of_bytes = b"".join(map(prefixed, messages))
    cuts = [0, 1, 4, 5, 6, 9, 11, 215, 216, 40_000, 70_200, len(stream_of_bytes)]
    pieces = [stream_of_bytes[start:end] for start, end in itertools.pairwise(cuts)]

    def script(peer: Peer) -> None:
        everything = RESPONSE_HEADERS
        for index, piece in enumerate(pieces):
            if index % 2:
                padding = index * 3
                payload = bytes((padding,)) + piece + bytes(padding)
                everything += frame(DATA, PADDED, 1, payload)
            else:
                everything += frame(DATA, 0, 1, piece)
            # Between frames: an empty one, an unknown one, a priority, an acknowledgement.
            everything += frame(DATA, 0, 1) + frame(0xBE, 0xFF, 7, b"?") + frame(2, 0, 1, bytes(5))
            everything += frame(SETTINGS, ACK, 0)
        # The first thousand bytes one by one.
        for index in range(1000):
            peer.send(everything[index : index + 1])
        peer.send(everything[1000:])

    with connected(script) as client:
        assert [client.receive(soon()) for _ in messages] == messages


def test_a_frame_larger_than_the_buffer_arrives_whole() -> None:
    message = np.random.default_rng(0).bytes(900_000)

    def script(peer: Peer) -> None:
        for _ in range(3):
            peer.send(frame(DATA, 0, 1, prefixed(message)))

    with connected(script) as client:
        assert [client.receive(soon()) for _ in range(3)] == [message] * 3


def test_pings_and_settings_are_acknowledged_while_waiting() -> None:
    def script(peer: Peer) -> None:
        peer.send(frame(PING, 0, 0, b"12345678"), frame(SETTINGS, 0, 0, struct.pack(">HI", 3, 9)))
        assert peer.read_until(PING) == (PING, ACK, 0, b"12345678")
        assert peer.read_until(SETTINGS) == (SETTINGS, ACK, 0, b"")
        # An acknowledgement is not acknowledged.
        peer.send(frame(PING, ACK, 0, b"87654321"), frame(DATA, 0, 1, prefixed(b"answer")))
        assert peer.read_until(DATA)[3] == prefixed(b"goodbye")
        assert [kind for kind, *_ in peer.frames].count(PING) == 1

    with connected(script) as client:
        assert client.receive(soon()) == b"answer"
        client.send(b"goodbye", soon())


def test_what_is_sent_stays_within_the_servers_limits() -> None:
    message = np.random.default_rng(0).bytes(300_000)
    rest = len(prefixed(message)) - 65_535

    def script(peer: Peer) -> None:
        first = peer.read_data(65_535)
        # No credit is left: nothing more may come.
        peer.connection.settimeout(0.3)
        with pytest.raises(TimeoutError):
            peer.read(1)
        peer.connection.settimeout(10)
        assert max(len(payload) for *_, payload in peer.frames) <= 16_384
        # Credit for the connection alone is of no use, nor is a frame size alone.
        peer.send(
            frame(WINDOW_UPDATE, 0, 0, struct.pack(">I", 1_000_000)),
            frame(SETTINGS, 0, 0, struct.pack(">HI", 5, 50_000)),
        )
        peer.read_until(SETTINGS)
        # A larger initial window counts for the stream that is open already.
        peer.send(frame(SETTINGS, 0, 0, struct.pack(">HI", 4, 65_535 + 100_000)))
        second = peer.read_data(100_000)
        assert len(second) == 100_000
        peer.send(frame(WINDOW_UPDATE, 0, 1, struct.pack(">I", rest - 100_000)))
        third = peer.read_data(rest - 100_000)
        assert first + second + third == prefixed(message)
        assert max(len(payload) for *_, payload in peer.frames) == 50_000
        peer.send(frame(DATA, 0, 1, prefixed(b"thanks")))

    with connected(script) as client:
        client.send(message, soon())
        assert client.receive(soon()) == b"thanks"


def test_a_server_that_gives_no_credit_runs_into_the_deadline() -> None:
    released = threading.Event()

    def script(_: Peer) -> None:
        released.wait(10)

    with connected(script) as client:
        with pytest.raises(TimeoutError):
            client.send(bytes(100_000), soon(0.3))
        released.set()
        assert client.is_closed


def test_the_server_gets_new_credit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "CREDIT_BYTES", 1000)

    def script(peer: Peer) -> None:
        peer.frames.clear()
        # Padding counts as well.
        peer.send(frame(DATA, PADDED, 1, bytes((100,)) + prefixed(bytes(600)) + bytes(100)))
        peer.send(frame(DATA, 0, 1, prefixed(bytes(600))))
        for stream_id in (0, 1):
            credit = struct.pack(">I", 101 + 605 + 605)
            assert peer.read_until(WINDOW_UPDATE) == (WINDOW_UPDATE, 0, stream_id, credit)
        peer.send(frame(DATA, 0, 1, prefixed(b"last")))

    with connected(script) as client:
        assert [len(client.receive(soon())) for _ in range(3)] == [600, 600, 4]


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        (frame(HEADERS, END_HEADERS | END_STREAM, 1, b"\x88"), "ended the stream"),
        (frame(DATA, END_STREAM, 1), "ended the stream"),
        (frame(RST_STREAM, 0, 1, struct.pack(">I", 8)), "reset the stream .*error 8"),
        (frame(GOAWAY, 0, 0, struct.pack(">II", 0, 11)), "refused the stream .*error 11"),
        (b"", "closed the connection"),
        (frame(DATA, 0, 1, prefixed(b"half")[:7]), "closed the connection"),
        (b"\0\0\1", "closed the connection"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "frame of"),
        (frame(DATA, 0, 1, b"\1\0\0\0\0"), "compressed"),
    ],
)
def test_a_stream_that_ends_is_lost_after_what_came_before(end: bytes, reason: str) -> None:
    def script(peer: Peer) -> None:
        peer.send(RESPONSE_HEADERS, frame(DATA, 0, 1, prefixed(b"before")), end)

    with connected(script) as client:
        if "frame of" not in reason and "compressed" not in reason:
            assert client.receive(soon()) == b"before"
        with pytest.raises(StreamLost, match=reason):
            receive_all(client)
        assert client.is_closed
        assert not client.is_alive()


def test_a_server_about_to_go_still_answers() -> None:
    def script(peer: Peer) -> None:
        # Graceful: streams up to the last one are served.
        peer.send(frame(GOAWAY, 0, 0, struct.pack(">II", 2**31 - 1, 0)))
        peer.send(frame(DATA, 0, 1, prefixed(b"answer")))

    with connected(script) as client:
        assert client.receive(soon()) == b"answer"


def test_after_a_pause_pings_are_answered_and_ends_are_noticed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stream, "IDLE_S", 0)
    answered, may_end = threading.Event(), threading.Event()

    def script(peer: Peer) -> None:
        peer.send(frame(PING, 0, 0, b"are you?"))
        assert peer.read_until(PING)[3] == b"are you?"
        answered.set()
        may_end.wait(5)

    with connected(script) as client:
        while not answered.wait(0.01):
            assert client.is_alive()
        may_end.set()
        end = soon()
        while client.is_alive():
            assert time.monotonic() < end, "the end was never noticed"
        assert client.is_closed


class Relay:
    """Stands between client and server, and can cut or hold what passes."""

    def __init__(self, server: str) -> None:
        host, _, port = server.partition(":")
        self._server = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._sockets: list[socket.socket] = []
        self.connections = 0
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                far = socket.create_connection(self._server)
                self.connections += 1
                self._sockets += [near, far]
                for source, sink in ((near, far), (far, near)):
                    threading.Thread(target=self._pass, args=(source, sink), daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(1 << 16):
                sink.sendall(data)
            sink.shutdown(socket.SHUT_WR)

    def cut(self) -> None:
        """Ends every connection."""
        for end in self._sockets:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
        self._sockets.clear()

    def close(self) -> None:
        self._listener.close()
        self.cut()


@pytest.fixture
def relay(server: str) -> Generator[Relay]:
    relay = Relay(server)
    yield relay
    relay.close()


def test_a_connection_that_is_cut_in_a_pause_is_replaced_without_a_word(
    server: str, relay: Relay, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "IDLE_S", 0)
    with make("hopper", server=server) as whole, make("hopper", server=relay.address) as cut:
        assert_same_bits(cut.reset(seed=0)[0], whole.reset(seed=0)[0])
        for step, action in enumerate(random_actions(0, 9, 3)):
            if step % 3 == 2:
                relay.cut()
                # The end has to arrive before it can be noticed.
                time.sleep(0.1)
            assert_same_bits(cut.step(action)[0], whole.step(action)[0], f"step {step}")
    assert relay.connections >= 1 + 4


def test_a_connection_that_is_cut_under_a_step_is_an_error_and_a_reset_goes_on(
    relay: Relay,
) -> None:
    with make_vec("ant", 2000, server=relay.address) as envs:
        first, _ = envs.reset(seed=0)
        envs.step_async(np.zeros((2000, 8)))
        relay.cut()
        with pytest.raises(errors.ServerUnavailable):
            envs.step_wait()
        with pytest.raises(errors.ResetNeeded, match="no answer"):
            envs.step(np.zeros((2000, 8)))
        assert_same_bits(envs.reset(seed=0)[0], first)
        envs.step(np.zeros((2000, 8)))


@pytest.mark.parametrize("interrupted", [MessageStream, Exchange])
def test_an_interrupted_step_leaves_no_answer_behind(
    interrupted: type, server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with make_vec("hopper", 2, server=server) as envs:
        first, _ = envs.reset(seed=0)

        def interrupt(*_: object) -> bytes:
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(interrupted, "receive", interrupt)
            with pytest.raises(KeyboardInterrupt):
                envs.step(np.zeros((2, 3)))
        with pytest.raises(errors.ResetNeeded, match="no answer"):
            envs.step(np.zeros((2, 3)))
        # The answer to the step must not be taken for the answer to the reset.
        assert_same_bits(envs.reset(seed=0)[0], first)


@contextlib.contextmanager
def two_hoppers(server: str) -> Generator[Session]:
    with Client(server) as client, client.open_session("hopper", num_envs=2) as session:
        yield session


def test_several_steps_may_be_under_way_and_are_answered_in_order(server: str) -> None:
    actions = random_actions(0, 40, 2, 3)
    with two_hoppers(server) as one_by_one, two_hoppers(server) as pipelined:
        one_by_one.reset(seeds=[0])
        pipelined.reset(seeds=[0])
        expected = [one_by_one.step(action) for action in actions]
        for start in range(0, 40, 8):
            for action in actions[start : start + 8]:
                pipelined.step_async(action)
            with pytest.raises(errors.FailedPrecondition, match="before step_wait"):
                pipelined.reset()
            with pytest.raises(errors.FailedPrecondition, match="before step_wait"):
                pipelined.step(actions[0])
            for step in range(start, start + 8):
                got = pipelined.step_wait()
                assert_same_bits(got.observations, expected[step].observations, f"step {step}")
        with pytest.raises(errors.FailedPrecondition, match="no request is under way"):
            pipelined.step_wait()
