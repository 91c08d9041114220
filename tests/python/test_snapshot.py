"""Snapshots, restores and forks, and what they are for: going on after the server died."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.error import AlreadyPendingCallError, ClosedEnvironmentError
from gymnasium.vector import AutoresetMode

import palr_gym
from palr_gym import Client, RemoteEnv, RemoteVectorEnv, errors
from support.reference import assert_same_bits, assert_same_infos, random_actions
from support.server_process import running_server


def play(envs: RemoteVectorEnv, seed: int, steps: int) -> list[tuple[Any, ...]]:
    size = envs.remote_spec.action_space.shape[0]
    return [envs.step(action) for action in random_actions(seed, steps, envs.num_envs, size)]


def assert_same_steps(got: list[tuple[Any, ...]], expected: list[tuple[Any, ...]]) -> None:
    for step, (ours, theirs) in enumerate(zip(got, expected, strict=True)):
        for left, right in zip(ours[:4], theirs[:4], strict=True):
            assert_same_bits(left, right, f"step {step}")
        assert_same_infos(ours[4], theirs[4], f"step {step}")


@pytest.mark.parametrize("env_id", ["hopper-w3", "ant-gym5"])
@pytest.mark.parametrize("mode", list(AutoresetMode)[:2], ids=lambda mode: mode.name)
def test_restored_and_forked_vectors_go_on_as_the_original_did(
    mode: AutoresetMode, env_id: str, server: str
) -> None:
    with palr_gym.make_vec(env_id, 4, server=server, autoreset_mode=mode) as envs:
        envs.reset(seed=3)
        # Hoppers fall now and then: some of these moments have a reset that is due.
        for steps in (0, 18, 1, 1, 1):
            play(envs, steps, steps)
            snapshot = envs.snapshot()
            with envs.fork() as fork:
                expected = play(envs, 7, 30)
                assert_same_steps(play(fork, 7, 30), expected)
            observations = envs.restore(snapshot)
            assert observations.shape == envs.observation_space.shape
            assert_same_steps(play(envs, 7, 30), expected)
            envs.restore(snapshot)


def test_a_single_environment_can_be_restored_and_forked(server: str) -> None:
    with palr_gym.make("walker2d-w2", server=server) as env:
        first = env.reset(seed=1)[0]
        start = env.snapshot()
        actions = random_actions(0, 10, 6)
        expected = [env.step(action) for action in actions]
        with env.fork() as fork:
            # The fork is an environment like any other.
            assert fork.observation_space == env.observation_space
            assert_same_bits(fork.step(actions[0])[0], env.step(actions[0])[0])
        assert_same_bits(env.restore(start), first)
        assert [env.step(action)[1:] for action in actions] == [step[1:] for step in expected]
        # A restored end is an end.
        while not env.step(np.ones(6))[2]:
            pass
        end = env.snapshot()
        env.restore(start)
        env.step(actions[0])
        env.restore(end)
        with pytest.raises(errors.ResetNeeded):
            env.step(actions[0])


def test_a_client_whose_server_was_killed_goes_on_from_its_last_snapshot(
    tmp_path: Any,
) -> None:
    path = tmp_path / "palr-gym.sock"
    address = f"unix:{path}"
    with running_server("--unix", str(path)) as server:
        envs = palr_gym.make_vec("hopper-w2", 8, server=address)
        env = palr_gym.make("ant", server=address)
        envs.reset(seed=5)
        env.reset(seed=5)
        play(envs, 0, 50)
        env.step(np.zeros(8))
        kept, kept_single = envs.snapshot(), env.snapshot()
        expected = play(envs, 1, 60)
        expected_single = [env.step(action)[0] for action in random_actions(2, 20, 8)]
        # Some steps later the server dies of SIGKILL, in the middle of a step.
        play(envs, 2, 5)
        envs.step_async(np.zeros((8, 3)))
        server.kill()
        with pytest.raises(errors.ServerUnavailable):
            envs.step_wait()
        with pytest.raises(errors.ServerUnavailable):
            env.step(np.zeros(8))
        with pytest.raises(errors.ServerUnavailable):
            envs.restore(kept)
    with running_server("--unix", str(path)) as server:
        envs.restore(kept)
        assert_same_steps(play(envs, 1, 60), expected)
        env.restore(kept_single)
        for action, observation in zip(random_actions(2, 20, 8), expected_single, strict=True):
            assert_same_bits(env.step(action)[0], observation)
        # Another program, which only has the bytes, on another address.
        with RemoteVectorEnv.from_snapshot(kept, server=server.address) as others:
            assert others.remote_spec == envs.remote_spec
            assert_same_steps(play(others, 1, 60), expected)
        with RemoteEnv.from_snapshot(kept_single, server=server.address) as other:
            observation = other.step(random_actions(2, 20, 8)[0])[0]
            assert_same_bits(observation, expected_single[0])
        envs.close()
        env.close()


def test_bytes_that_are_no_snapshot_of_this_are_refused(server: str) -> None:
    with (
        palr_gym.make_vec("hopper", 2, server=server) as envs,
        palr_gym.make("hopper", server=server) as env,
    ):
        envs.reset(seed=0)
        good = envs.snapshot()
        damaged = bytearray(good)
        damaged[100] ^= 1
        for wrong in (b"", b"snapshot", good[:-1], good + b"x", bytes(damaged)):
            with pytest.raises(errors.InvalidArgument) as caught:
                envs.restore(wrong)
            assert caught.value.reason == "INVALID_SNAPSHOT"
            with pytest.raises(errors.InvalidArgument) as caught:
                RemoteVectorEnv.from_snapshot(wrong, server=server)
            assert caught.value.reason == "INVALID_SNAPSHOT"
        mismatches: list[Callable[[], Any]] = [
            lambda: env.restore(good),
            lambda: RemoteEnv.from_snapshot(good, server=server),
            lambda: envs.restore(env.snapshot()),
        ]
        for mismatch in mismatches:
            with pytest.raises(errors.InvalidArgument) as caught:
                mismatch()
            assert caught.value.reason == "SNAPSHOT_MISMATCH"
        # None of it has changed anything.
        assert envs.snapshot() == good
        envs.step(np.zeros((2, 3)))


def test_there_is_no_snapshot_in_the_middle_of_a_step_or_after_the_end(server: str) -> None:
    envs = palr_gym.make_vec("hopper", 2, server=server)
    never_reset = envs.snapshot()
    envs.reset(seed=0)
    envs.step_async(np.zeros((2, 3)))
    for call in (envs.snapshot, envs.fork):
        with pytest.raises(AlreadyPendingCallError):
            call()
    envs.restore(never_reset)
    with pytest.raises(errors.ResetNeeded):
        envs.step(np.zeros((2, 3)))
    envs.close()
    for call in (envs.snapshot, envs.fork, lambda: envs.restore(never_reset)):
        with pytest.raises(ClosedEnvironmentError):
            call()


def test_a_session_can_be_opened_from_a_snapshot(client: Client) -> None:
    with client.open_session("halfcheetah", num_envs=2, autoreset_mode="SameStep") as session:
        session.reset(seeds=[1])
        session.step(np.zeros((2, 6)))
        opened, state = client.open_snapshot(session.snapshot())
        with opened:
            assert (state.was_reset, state.is_over.tolist()) == (True, [False, False])
            assert opened.autoreset_mode is AutoresetMode.SAME_STEP
            ours, theirs = opened.step(np.ones((2, 6))), session.step(np.ones((2, 6)))
            assert_same_bits(ours.observations, theirs.observations)
