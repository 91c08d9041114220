"""K steps in one message, float32 observations, and simulations that diverge."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import palr_gym
from palr_gym import Client, errors
from support.reference import (
    assert_same_bits,
    assert_same_infos,
    gymnasium_env,
    gymnasium_vector_env,
    random_actions,
)

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


@pytest.mark.parametrize("env_id", ["hopper", "walker2d-gym5"])
@pytest.mark.parametrize("mode", list(AutoresetMode)[:2], ids=lambda mode: mode.name)
def test_an_open_loop_equals_gymnasiums_single_steps(
    mode: AutoresetMode, env_id: str, server: str
) -> None:
    theirs = gymnasium_vector_env(env_id, 3, mode)
    with palr_gym.make_vec(env_id, 3, server=server, autoreset_mode=mode) as ours:
        ours.reset(seed=2)
        theirs.reset(seed=2)
        ends = 0
        size = ours.remote_spec.action_space.shape[0]
        # Loops that begin and end anywhere around the ends of episodes.
        for seed, steps in enumerate([1, 20, 3, 2, 40, 1, 33]):
            actions = random_actions(seed, steps, 3, size)
            got = ours.step_open_loop(actions)
            assert got.observations.shape == (steps, *(ours.observation_space.shape or ()))
            for step, action in enumerate(actions):
                expected = theirs.step(action)
                where = f"loop {seed}, step {step}"
                for array, theirs_array in zip(got[:4], expected[:4], strict=True):
                    assert_same_bits(array[step], theirs_array, where)
                assert_same_infos(got.infos[step], expected[4], where)
            ends += int(got.terminated.sum())
        assert ends > 5


def test_an_open_loop_of_one_environment_ends_with_its_episode(server: str) -> None:
    theirs = gymnasium_env("hopper-gym5")
    with palr_gym.make("hopper-gym5", server=server) as ours:
        ours.reset(seed=0)
        theirs.reset(seed=0)
        actions = random_actions(0, 500, 3)
        got = ours.step_open_loop(actions)
        steps = len(got.rewards)
        assert 1 < steps < 500
        assert got.terminated.tolist() == [False] * (steps - 1) + [True]
        for step, action in enumerate(actions[:steps]):
            expected = theirs.step(action)
            assert_same_bits(got.observations[step], expected[0])
            assert_same_bits(got.rewards[step], np.float64(expected[1]))
            assert got.infos[step] == expected[4]
        with pytest.raises(errors.ResetNeeded):
            ours.step_open_loop(actions)


def test_open_loops_that_the_server_refuses_take_no_step(client: Client, server: str) -> None:
    limits = client.server_info().limits
    with palr_gym.make_vec("hopper", 2, server=server) as envs:
        with pytest.raises(errors.ResetNeeded):
            envs.step_open_loop(np.zeros((3, 2, 3)))
        envs.reset(seed=0)
        before = envs.snapshot()
        bad = np.zeros((3, 2, 3))
        bad[2, 1, 0] = np.nan
        cases: list[tuple[Any, str]] = [
            (bad, "ACTION_NAN"),
            (np.zeros((2, 3)), "ACTION_SHAPE"),
            (np.zeros((5, 2, 4)), "ACTION_SHAPE"),
            (np.zeros((0, 2, 3)), "ACTION_SHAPE"),
            (np.zeros((limits.max_open_loop_steps + 1, 2, 3)), "OPEN_LOOP_TOO_LARGE"),
        ]
        for actions, reason in cases:
            with pytest.raises(errors.InvalidArgument) as caught:
                envs.step_open_loop(actions)
            assert caught.value.reason == reason
        assert envs.snapshot() == before
    # An answer beyond the limit; its request is too large for a stream.
    with palr_gym.make_vec("ant-full-w8", 1024, server=server) as envs:
        envs.reset(seed=0)
        with pytest.raises(errors.InvalidArgument) as caught:
            envs.step_open_loop(np.zeros((60, 1024, 8)))
        assert caught.value.reason == "OPEN_LOOP_TOO_LARGE"
        envs.step_open_loop(np.zeros((2, 1024, 8)))


@pytest.mark.parametrize("mode", list(AutoresetMode)[:2], ids=lambda mode: mode.name)
def test_float32_observations_are_the_float64_ones_rounded(
    mode: AutoresetMode, server: str
) -> None:
    with (
        palr_gym.make_vec("hopper-w2", 3, server=server, autoreset_mode=mode) as wide,
        palr_gym.make_vec(
            "hopper-w2", 3, server=server, autoreset_mode=mode, observation_dtype="float32"
        ) as narrow,
    ):
        assert narrow.observation_space.dtype == np.float32
        assert wide.observation_space.dtype == np.float64
        assert_same_bits(narrow.reset(seed=0)[0], wide.reset(seed=0)[0].astype(np.float32))
        finals = 0
        for action in random_actions(0, 60, 3, 3):
            got, expected = narrow.step(action), wide.step(action)
            assert got[0] in narrow.observation_space
            assert_same_bits(got[0], expected[0].astype(np.float32))
            for left, right in zip(got[1:4], expected[1:4], strict=True):
                assert_same_bits(left, right)
            for left, right in zip(
                got[4].pop("final_obs", ()), expected[4].pop("final_obs", ()), strict=True
            ):
                if right is not None:
                    finals += 1
                    assert_same_bits(left, right.astype(np.float32))
            assert_same_infos(got[4], expected[4])
        assert (finals > 0) == (mode is AutoresetMode.SAME_STEP)
        with narrow.fork() as fork:
            assert fork.observation_space == narrow.observation_space
    with palr_gym.make("ant", server=server, observation_dtype="float32") as env:
        assert env.reset(seed=0)[0].dtype == np.float32
        assert env.step(np.zeros(8))[0] in env.observation_space
    with pytest.raises(errors.InvalidArgument, match="observation_dtype is 'float16'"):
        palr_gym.make("ant", server=server, observation_dtype="float16")


def test_a_huge_control_truncates_its_episode_with_the_reason(server: str) -> None:
    with palr_gym.make("hopper", server=server, out_of_bounds="raw") as env:
        env.reset(seed=0)
        before = env.step(np.zeros(3))
        observation, reward, terminated, truncated, info = env.step([0, 1e20, 0])
        assert (reward, terminated, truncated) == (0.0, False, True)
        assert info["truncation_reason"] == "bad_control"
        assert_same_bits(observation, before[0])
        with pytest.raises(errors.ResetNeeded):
            env.step(np.zeros(3))
        assert "truncation_reason" not in (env.reset(seed=0)[1] | env.step(np.zeros(3))[4])


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
def test_in_a_vector_only_the_diverged_episode_ends(mode: AutoresetMode, server: str) -> None:
    with palr_gym.make_vec(
        "walker2d", 3, server=server, out_of_bounds="raw", autoreset_mode=mode
    ) as envs:
        envs.reset(seed=0)
        actions = np.zeros((4, 3, 6), dtype=np.float32)
        actions[1, 2, 0] = np.inf
        loop = envs.step_open_loop(actions)
        assert loop.truncated[1].tolist() == [False, False, True]
        assert not loop.truncated[0].any()
        infos = loop.infos[1]
        if mode is AutoresetMode.SAME_STEP:
            infos = infos["final_info"]
        assert infos["truncation_reason"].tolist() == [None, None, "bad_control"]
        assert infos["_truncation_reason"].tolist() == [False, False, True]
        for other in (0, 2, 3)[: len(loop.infos) - 1]:
            assert "truncation_reason" not in loop.infos[other]
        assert len(loop.rewards) == (2 if mode is AutoresetMode.DISABLED else 4)
        assert np.isfinite(loop.observations).all()
        assert np.isfinite(loop.rewards).all()
