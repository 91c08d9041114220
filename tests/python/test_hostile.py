"""Clients that mean no good: memory stays bounded, and others are served."""

import contextlib
import signal
import socket
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import palr_gym
from palr_gym import Client, errors
from palr_gym._proto.palr_gym.v1 import evaluation_service_pb2, policy_pb2
from palr_gym._proto.palr_gym.v1.environment_service_pb2 import (
    ResetRequest,
    StepRequest,
    StepStreamRequest,
)
from palr_gym.tensors import float32_tensor
from support.raw_http2 import RawClient, grpc_message
from support.server_process import ServerProcess, running_server

MIB = 1 << 20
NUM_ENVS = 128
STEP_STREAM = "/palr_gym.v1.EnvironmentService/StepStream"
EVALUATE = "/palr_gym.v1.EvaluationService/Evaluate"
LEAKAGE = "/palr_gym.v1.LeakageService/EstimateLeakage"
PROCESS = "/dm_env_rpc.v1.Environment/Process"


@pytest.fixture
def own_server() -> Generator[ServerProcess]:
    with running_server() as server:
        yield server


def resident_bytes(server: ServerProcess) -> int:
    status = Path(f"/proc/{server.pid}/status").read_text(encoding="ascii")
    [line] = [line for line in status.splitlines() if line.startswith("VmRSS:")]
    return int(line.split()[1]) * 1024


@contextlib.contextmanager
def growth_within(server: ServerProcess, limit: int) -> Generator[None]:
    """Memory grows by less than `limit` bytes, at any time in the block."""
    # What the first use of anything costs is not a growth.
    others_are_served(server)
    before = peak = resident_bytes(server)
    is_over = threading.Event()

    def watch() -> None:
        nonlocal peak
        while not is_over.wait(0.02):
            peak = max(peak, resident_bytes(server))

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield
    finally:
        is_over.set()
        watcher.join()
    grown = peak - before
    assert grown < limit, f"grew by {grown / MIB:.0f} MiB; expected less than {limit / MIB:.0f}"


def others_are_served(server: ServerProcess) -> None:
    with palr_gym.make_vec("hopper", 4, server=server.address, deadline_s=10) as envs:
        envs.reset(seed=0)
        for _ in range(50):
            envs.step(np.zeros((4, 3)))


def once_there_is_room(call: Callable[[], object]) -> None:
    """Repeats a call that is refused for lack of room, for ten seconds."""
    deadline = time.monotonic() + 10
    while True:
        try:
            call()
        except errors.ResourceExhausted:
            assert time.monotonic() < deadline, "still no room"
        else:
            return


def open_large(client: Client) -> palr_gym.Session:
    """A session whose steps are soon taken, and whose answers are large: 700 kB."""
    return client.open_session("hopper-full-w64", num_envs=NUM_ENVS)


def step_request(session_id: str) -> bytes:
    actions = float32_tensor(np.zeros((NUM_ENVS, 3), dtype=np.float32))
    step = StepRequest(session_id=session_id, actions=actions)
    return grpc_message(StepStreamRequest(step=step).SerializeToString())


def test_a_flood_of_steps_whose_answers_nobody_reads(own_server: ServerProcess) -> None:
    with contextlib.ExitStack() as stack:
        client = stack.enter_context(Client(own_server.address))
        sessions = [open_large(client) for _ in range(4)]
        for session in sessions:
            session.reset(seeds=[0])
            session.step(np.zeros((NUM_ENVS, 3)))
        with growth_within(own_server, 128 * MIB):
            for session in sessions:
                raw = stack.enter_context(RawClient(own_server.address))
                stream = raw.call(STEP_STREAM)
                assert raw.flood(stream, step_request(session.session_id)) > 1000
            others_are_served(own_server)
            # All answers together would be larger than what may be held.
            time.sleep(0.5)
            others_are_served(own_server)
        # The flood has not swept its victims' sessions away.
        for session in sessions:
            session.reset(seeds=[0])


def test_a_flood_of_calls_that_are_refused(own_server: ServerProcess) -> None:
    junk = grpc_message(b"\xff" * 1000)
    with contextlib.ExitStack() as stack, growth_within(own_server, 64 * MIB):
        for path in (STEP_STREAM, EVALUATE, PROCESS, "/nowhere/Nothing"):
            raw = stack.enter_context(RawClient(own_server.address))
            with contextlib.suppress(OSError):
                for _ in range(2000):
                    raw.send(raw.call(path), junk)
        others_are_served(own_server)


def test_messages_that_are_announced_and_never_sent(own_server: ServerProcess) -> None:
    with contextlib.ExitStack() as stack, growth_within(own_server, 128 * MIB):
        for _ in range(20):
            raw = stack.enter_context(RawClient(own_server.address))
            for _ in range(200):
                raw.send(raw.call(LEAKAGE), grpc_message(b"\n", announced=63 * MIB))
        # What others send whole is small, and is served.
        others_are_served(own_server)
        assert palr_gym.evaluate("hopper", "random", episodes=2, server=own_server.address).steps
        # What is large must wait for room.
        with pytest.raises(errors.ResourceExhausted) as caught:
            palr_gym.evaluate("hopper", bytes(20 * MIB), server=own_server.address)
        assert caught.value.reason == "TOO_MUCH_ARRIVING"
        assert caught.value.retry_after_s
    # With their senders, the claims are gone.
    with pytest.raises(errors.InvalidArgument, match="ONNX"):
        once_there_is_room(
            lambda: palr_gym.evaluate("hopper", bytes(20 * MIB), server=own_server.address)
        )


def test_half_open_connections_are_closed() -> None:
    with running_server() as server, contextlib.ExitStack() as stack:
        host, _, port = server.address.rpartition(":")
        with growth_within(server, 64 * MIB):
            mute = [
                stack.enter_context(socket.create_connection((host, int(port)), timeout=15))
                for _ in range(300)
            ]
            mute[0].sendall(b"PRI * HTTP/2")
            others_are_served(server)
        # Ten seconds are given for the first words.
        for connection in mute:
            with contextlib.suppress(ConnectionError):
                # The server's own first words come before.
                while connection.recv(1 << 10):
                    pass
        others_are_served(server)


def test_a_rollout_whose_results_nobody_reads_holds_no_place_for_ever(
    own_server: ServerProcess,
) -> None:
    request = evaluation_service_pb2.EvaluateRequest(
        env_id="hopper",
        policy=policy_pb2.Policy(random=policy_pb2.RandomPolicy()),
        episodes=10**6,
        num_envs=1,
    )
    with contextlib.ExitStack() as stack, growth_within(own_server, 64 * MIB):

        def ask_and_never_read() -> None:
            raw = stack.enter_context(RawClient(own_server.address))
            stream = raw.call(EVALUATE)
            raw.send(stream, grpc_message(request.SerializeToString()), is_last=True)

        for _ in range(8):
            ask_and_never_read()
        others_are_served(own_server)
        # A moment passes until they have their places.
        deadline = time.monotonic() + 10

        def evaluate_until_refused() -> None:
            while time.monotonic() < deadline:
                palr_gym.evaluate("hopper", "random", episodes=1, server=own_server.address)
                # This evaluation may have had the last one's place just when it came.
                ask_and_never_read()

        with pytest.raises(errors.ResourceExhausted) as caught:
            evaluate_until_refused()
        assert caught.value.reason == "TOO_MANY_ROLLOUTS"
    # With their clients, the places are free again.
    once_there_is_room(
        lambda: palr_gym.evaluate("hopper", "random", episodes=1, server=own_server.address)
    )


@pytest.mark.parametrize("num_envs", [1, 32])
def test_sessions_have_their_turn_beside_as_many_rollouts_as_there_may_be(
    own_server: ServerProcess, num_envs: int
) -> None:
    address, is_over = own_server.address, threading.Event()

    def evaluate_again_and_again() -> None:
        while not is_over.is_set():
            palr_gym.evaluate("ant", "random", episodes=50, num_envs=num_envs, server=address)

    with ThreadPoolExecutor(max_workers=8) as rollouts:
        running = [rollouts.submit(evaluate_again_and_again) for _ in range(8)]
        try:
            for _ in range(4):
                others_are_served(own_server)
        finally:
            is_over.set()
        for rollout in running:
            rollout.result()


def test_connections_beyond_the_limit_are_told_so() -> None:
    with running_server("--max-connections", "3") as server, contextlib.ExitStack() as stack:
        for _ in range(3):
            stack.enter_context(RawClient(server.address)).call(STEP_STREAM)
        with pytest.raises(errors.ResourceExhausted) as caught:
            Client(server.address).tasks()
        assert caught.value.reason == "TOO_MANY_CONNECTIONS"
        stack.close()
        once_there_is_room(lambda: Client(server.address).tasks())


def test_a_client_that_never_reads_does_not_hold_up_a_shutdown(own_server: ServerProcess) -> None:
    with Client(own_server.address) as client, RawClient(own_server.address) as raw:
        session = open_large(client)
        stream = raw.call(STEP_STREAM)
        reset = StepStreamRequest(reset=ResetRequest(session_id=session.session_id))
        raw.send(stream, grpc_message(reset.SerializeToString()))
        raw.flood(stream, step_request(session.session_id))
        start = time.monotonic()
        own_server.send(signal.SIGTERM)
        assert own_server.wait() == 0
        # The time that is given to those who are slow is ten.
        assert time.monotonic() - start < 9
        assert raw.is_closed_within(5)
