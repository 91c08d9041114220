"""A server that is not there, dies, freezes or shuts down: a typed error in bounded time."""

import contextlib
import signal
import socket
import threading
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import palr_gym
from palr_gym import Client, errors
from support.reference import assert_same_bits, random_actions
from support.server_process import ServerProcess, running_server


@pytest.fixture
def own_server() -> Generator[ServerProcess]:
    with running_server() as server:
        yield server


@contextlib.contextmanager
def within(seconds: float) -> Generator[None]:
    """The block ends in time."""
    start = time.monotonic()
    yield
    elapsed = time.monotonic() - start
    assert elapsed < seconds, f"took {elapsed:.1f} s; expected less than {seconds} s"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_nothing_listening_fails_at_once_and_says_how_to_start_a_server(tmp_path: Path) -> None:
    by_port = f"127.0.0.1:{free_port()}"
    by_path = f"unix:{tmp_path / 'nobody.sock'}"
    commands = {
        by_port: f"palr-gym serve --listen {by_port}",
        by_path: f"palr-gym serve --unix {tmp_path / 'nobody.sock'}",
    }
    for address, command in commands.items():
        for call in (
            lambda address=address: Client(address).tasks(),
            lambda address=address: palr_gym.make("hopper", server=address),
            lambda address=address: palr_gym.make_vec("hopper", 2, server=address),
            lambda address=address: palr_gym.evaluate("hopper", "random", server=address),
            lambda address=address: palr_gym.collect(
                "hopper", "random", episodes=1, server=address
            ),
        ):
            with within(5), pytest.raises(errors.ServerUnavailable) as caught:
                call()
            assert isinstance(caught.value, ConnectionError)
            assert address in str(caught.value)
            assert command in str(caught.value)


def test_a_peer_that_accepts_and_says_nothing_runs_into_the_deadline() -> None:
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        address = f"127.0.0.1:{mute.getsockname()[1]}"
        with (
            within(4),
            Client(address, deadline_s=1) as client,
            pytest.raises(errors.DeadlineExceeded, match="no answer within 1 s"),
        ):
            client.tasks()


def test_a_server_killed_in_a_rollout_is_unavailable(own_server: ServerProcess) -> None:
    env = palr_gym.make("hopper", server=own_server.address)
    envs = palr_gym.make_vec("hopper", 4, server=own_server.address)
    env.reset(seed=0)
    envs.reset(seed=0)
    env.step(np.zeros(3))
    envs.step(np.zeros((4, 3)))
    own_server.kill()
    with within(5):
        with pytest.raises(errors.ServerUnavailable, match=own_server.address):
            env.step(np.zeros(3))
        with pytest.raises(errors.ServerUnavailable, match=own_server.address):
            envs.step(np.zeros((4, 3)))
        # What became of the episode is unknown.
        with pytest.raises(errors.ResetNeeded):
            env.step(np.zeros(3))
        with pytest.raises(errors.ServerUnavailable):
            env.reset()
        env.close()
        envs.close()


def test_a_server_killed_while_a_step_is_under_way_is_unavailable(
    own_server: ServerProcess,
) -> None:
    # 4096 ants need far longer for a step than the signal takes.
    with palr_gym.make_vec("ant", 4096, server=own_server.address) as envs:
        envs.reset(seed=0)
        envs.step_async(np.zeros((4096, 8)))
        own_server.kill()
        with within(5), pytest.raises(errors.ServerUnavailable):
            envs.step_wait()


@pytest.mark.parametrize("kind", ["evaluate", "collect"])
def test_a_server_killed_in_an_evaluation_or_collection_is_unavailable(
    kind: str, own_server: ServerProcess
) -> None:
    episodes: list[object] = []

    def kill_after_two(episode: object) -> None:
        episodes.append(episode)
        if len(episodes) == 2:
            own_server.kill()

    run = palr_gym.evaluate if kind == "evaluate" else palr_gym.collect
    with within(15), pytest.raises(errors.ServerUnavailable):
        run(
            "halfcheetah",
            "random",
            episodes=100_000,
            num_envs=2,
            server=own_server.address,
            on_episode=kill_after_two,
        )
    assert len(episodes) >= 2


def test_a_server_killed_while_the_client_waits_for_a_message_is_unavailable(
    own_server: ServerProcess,
) -> None:
    timer = threading.Timer(0.5, own_server.kill)
    timer.start()
    # No episode of 4096 cheetahs ends within the half second.
    with within(5), pytest.raises(errors.ServerUnavailable):
        palr_gym.evaluate(
            "halfcheetah", "random", episodes=4096, num_envs=4096, server=own_server.address
        )
    timer.join()


def test_a_frozen_server_runs_into_the_deadline_and_recovers(own_server: ServerProcess) -> None:
    env = palr_gym.make("hopper", server=own_server.address, deadline_s=1)
    envs = palr_gym.make_vec("hopper", 4, server=own_server.address, deadline_s=1)
    first = env.reset(seed=0)[0]
    envs.reset(seed=0)
    own_server.freeze()
    for call in (
        lambda: env.step(np.zeros(3)),
        lambda: envs.step(np.zeros((4, 3))),
        lambda: palr_gym.make("hopper", server=own_server.address, deadline_s=1),
    ):
        with within(2.5), pytest.raises(errors.DeadlineExceeded, match="within 1 s") as caught:
            call()
        assert isinstance(caught.value, TimeoutError)
    own_server.thaw()
    # The step may have been taken or not: only a reset makes the state known again.
    with pytest.raises(errors.ResetNeeded, match="no answer"):
        env.step(np.zeros(3))
    assert_same_bits(env.reset(seed=0)[0], first)
    env.step(np.zeros(3))
    env.close()
    envs.close()


def test_after_a_reset_without_an_answer_another_one_is_needed(
    own_server: ServerProcess,
) -> None:
    with (
        palr_gym.make("hopper", server=own_server.address, deadline_s=1) as env,
        palr_gym.make_vec("hopper", 2, server=own_server.address, deadline_s=1) as envs,
    ):
        env.reset(seed=0)
        envs.reset(seed=0)
        own_server.freeze()
        for reset in (env.reset, envs.reset, lambda: envs.reset(seed=[1, 2])):
            with pytest.raises(errors.DeadlineExceeded):
                reset()
        own_server.thaw()
        for step in (lambda: env.step(np.zeros(3)), lambda: envs.step(np.zeros((2, 3)))):
            with pytest.raises(errors.ResetNeeded, match="no answer"):
                step()


def test_a_step_that_was_sent_to_a_frozen_server_runs_into_the_deadline(
    own_server: ServerProcess,
) -> None:
    with palr_gym.make_vec("hopper", 4, server=own_server.address, deadline_s=1) as envs:
        envs.reset(seed=0)
        own_server.freeze()
        envs.step_async(np.zeros((4, 3)))
        with within(2.5), pytest.raises(errors.DeadlineExceeded):
            envs.step_wait()


@pytest.mark.parametrize("kind", ["evaluate", "collect"])
def test_an_evaluation_or_collection_that_stalls_is_given_up(
    kind: str, own_server: ServerProcess
) -> None:
    episodes: list[object] = []

    def freeze(episode: object) -> None:
        if not episodes:
            own_server.freeze()
        episodes.append(episode)

    run = palr_gym.evaluate if kind == "evaluate" else palr_gym.collect
    with within(6), pytest.raises(errors.DeadlineExceeded, match=r"no message within 1\.5 s"):
        run(
            "hopper",
            "random",
            episodes=1_000_000,
            server=own_server.address,
            on_episode=freeze,
            stall_timeout_s=1.5,
        )
    assert episodes


def test_an_evaluation_ends_at_its_time_limit(server: str) -> None:
    with within(4), pytest.raises(errors.DeadlineExceeded, match="within 1 s"):
        palr_gym.evaluate("hopper", "random", episodes=1_000_000, server=server, timeout_s=1)


def test_the_time_that_a_callback_takes_is_no_stall(server: str) -> None:
    evaluation = palr_gym.evaluate(
        "hopper",
        "random",
        episodes=3,
        server=server,
        on_episode=lambda _: time.sleep(0.7),
        stall_timeout_s=0.5,
    )
    assert len(evaluation.episodes) == 3


def test_an_error_in_a_callback_ends_the_work_on_the_server(server: str) -> None:
    class OfMyOwnError(Exception):
        pass

    def fail(_: object) -> None:
        raise OfMyOwnError

    # More at once than a server allows at a time: each must have ended before the next begins.
    for _ in range(20):
        with within(10), pytest.raises(OfMyOwnError):
            palr_gym.evaluate(
                "hopper", "random", episodes=1_000_000, server=server, on_episode=fail
            )
    assert palr_gym.evaluate("hopper", "random", episodes=1, server=server).steps > 0


def test_sigterm_ends_the_server_with_exit_code_0_even_with_open_sessions(
    own_server: ServerProcess,
) -> None:
    env = palr_gym.make("hopper", server=own_server.address)
    env.reset(seed=0)
    env.step(np.zeros(3))
    own_server.send(signal.SIGTERM)
    with within(6):
        assert own_server.wait() == 0
    with within(5), pytest.raises(errors.ServerUnavailable):
        env.step(np.zeros(3))
    env.close()


def test_sigint_ends_the_server_with_exit_code_0(own_server: ServerProcess) -> None:
    own_server.send(signal.SIGINT)
    assert own_server.wait() == 0


def test_a_server_is_reached_over_a_unix_socket(tmp_path: Path) -> None:
    path = tmp_path / "palr-gym.sock"
    with running_server("--unix", str(path)) as server:
        assert server.ready["unix"] == str(path)
        actions = random_actions(0, 40, 3, 3)
        rollouts: list[list[NDArray[np.floating[Any]]]] = []
        for address in (server.address, f"unix:{path}"):
            with palr_gym.make_vec("hopper", 3, server=address) as envs:
                first = envs.reset(seed=0)[0]
                rollouts.append([first, *(envs.step(action)[0] for action in actions)])
    for by_port, by_path in zip(*rollouts, strict=True):
        assert_same_bits(by_path, by_port)


def test_closed_and_forgotten_environments_free_their_sessions() -> None:
    with running_server("--max-sessions", "2") as server:
        for _ in range(3):
            closed = palr_gym.make("hopper", server=server.address)
            forgotten = palr_gym.make_vec("hopper", 2, server=server.address)
            forgotten.reset(seed=0)
            with pytest.raises(errors.ResourceExhausted) as caught:
                palr_gym.make("hopper", server=server.address)
            assert caught.value.reason == "TOO_MANY_SESSIONS"
            assert caught.value.retry_after_s is not None
            closed.close()
            del forgotten


def test_a_call_that_is_running_when_its_client_is_closed_is_cancelled(server: str) -> None:
    client = Client(server)
    timer = threading.Timer(0.3, client.close)
    timer.start()
    with within(5), pytest.raises(errors.Cancelled):
        client.evaluate("hopper", "random", episodes=1_000_000)
    timer.join()
