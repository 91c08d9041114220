"""Gymnasium accepts the environments, by every way in which it makes them."""

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

import palr_gym
from palr_gym.registration import registered_env_ids
from support.reference import random_actions

# What shows pictures is in test_sight.py.
GYMNASIUM_IDS = [
    f"palr_gym/{env_id}-v0" for env_id in registered_env_ids() if not env_id.startswith("lane-")
]


def test_all_promised_ids_are_registered() -> None:
    registered = {name for name in gymnasium.registry if name.startswith("palr_gym/")}
    expected = {
        f"palr_gym/{task}{mask}{stack}-v0"
        for task in ("hopper", "walker2d", "halfcheetah", "ant", "toy")
        for mask in ("", "-strict")
        for stack in ("-w1", "-w2", "-w3", "-w4", "-w5")
    } | {
        f"palr_gym/{task}{fidelity}-v0"
        for task in ("hopper", "walker2d", "halfcheetah", "ant")
        for fidelity in ("", "-gym5")
    }
    expected |= {f"palr_gym/lane{kind}-w{w}-v0" for kind in ("", "-pixels") for w in range(1, 6)}
    assert registered == expected | {"palr_gym/lane-v0", "palr_gym/town-v0", "palr_gym/toy-v0"}


@pytest.mark.filterwarnings("ignore:.*A Box observation space m.*imum value is -?infinity")
@pytest.mark.parametrize("gymnasium_id", GYMNASIUM_IDS)
def test_gymnasiums_checker_is_content(gymnasium_id: str, server: str) -> None:
    env = gymnasium.make(gymnasium_id, server=server)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.filterwarnings("ignore:.*A Box observation space m.*imum value is -?infinity")
def test_gymnasiums_checker_is_content_with_an_environment_of_our_own_maker(server: str) -> None:
    with palr_gym.make("walker2d-full-w7", server=server) as env:
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize(
    ("env_id", "observation_size", "action_size"),
    [
        ("hopper", 11, 3),
        ("hopper-w1", 5, 3),
        ("walker2d-w3", 24, 6),
        ("halfcheetah-w2", 18, 6),
        ("halfcheetah-strict-w2", 16, 6),
        ("ant", 27, 8),
        ("ant-w4", 52, 8),
        ("ant-full-w8", 216, 8),
    ],
)
def test_spaces_have_the_documented_sizes(
    env_id: str, observation_size: int, action_size: int, server: str
) -> None:
    with (
        palr_gym.make(env_id, server=server) as env,
        palr_gym.make_vec(env_id, 3, server=server) as envs,
    ):
        assert env.observation_space.shape == (observation_size,)
        assert env.observation_space.dtype == np.float64
        assert env.action_space == Box(-1, 1, (action_size,), np.float32)
        assert envs.single_observation_space == env.observation_space
        assert envs.single_action_space == env.action_space
        assert envs.observation_space.shape == (3, observation_size)
        assert envs.action_space == Box(-1, 1, (3, action_size), np.float32)
        observation, _ = env.reset(seed=0)
        assert observation in env.observation_space
        observations, _ = envs.reset(seed=0)
        assert observations in envs.observation_space


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
def test_make_vec_opens_one_session_with_the_mode_asked_for(
    mode: AutoresetMode, server: str
) -> None:
    envs = gymnasium.make_vec(
        "palr_gym/hopper-w2-v0", num_envs=64, server=server, autoreset_mode=mode
    )
    assert isinstance(envs, palr_gym.RemoteVectorEnv)
    assert envs.metadata["autoreset_mode"] is mode
    assert envs.num_envs == 64
    envs.reset(seed=0)
    envs.action_space.seed(0)
    observations, *_ = envs.step(envs.action_space.sample())
    assert observations.shape == (64, 10)
    envs.close()
    assert envs.closed


def test_a_seeded_reset_seeds_np_random_as_well(server: str) -> None:
    with (
        palr_gym.make("hopper", server=server) as env,
        palr_gym.make_vec("hopper", 2, server=server) as envs,
    ):
        for seeded in (env, envs):
            seeded.reset(seed=3)
            assert seeded.np_random_seed == 3
            expected = np.random.default_rng(3).random()
            assert seeded.np_random.random() == expected


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_make_vec_can_also_put_single_environments_side_by_side(mode: str, server: str) -> None:
    together = palr_gym.make_vec("hopper-w2", 3, server=server)
    # "async" forks: the children must find their own way to the server.
    apart = gymnasium.make_vec(
        "palr_gym/hopper-w2-v0", num_envs=3, vectorization_mode=mode, server=server
    )
    assert isinstance(apart, SyncVectorEnv | AsyncVectorEnv)
    np.testing.assert_array_equal(together.reset(seed=1)[0], apart.reset(seed=1)[0])
    for action in random_actions(0, 60, 3, 3):
        for got, expected in zip(apart.step(action)[:4], together.step(action)[:4], strict=True):
            np.testing.assert_array_equal(got, expected)
    apart.close()
    together.close()


def test_the_server_can_be_named_by_an_environment_variable(
    server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(palr_gym.SERVER_VARIABLE, server)
    env = gymnasium.make("palr_gym/ant-strict-w3-v0")
    env.reset()
    env.close()


def test_a_closed_environment_says_so_and_closes_again_quietly(server: str) -> None:
    env = palr_gym.make("hopper", server=server)
    envs = palr_gym.make_vec("hopper", 2, server=server)
    env.reset()
    envs.reset()
    for closed in (env, envs):
        closed.close()
        closed.close()
        with pytest.raises(gymnasium.error.ClosedEnvironmentError, match="after close"):
            closed.reset()
        with pytest.raises(gymnasium.error.ClosedEnvironmentError, match="after close"):
            closed.step(closed.action_space.sample())


def test_steps_that_were_sent_must_be_waited_for(server: str) -> None:
    with palr_gym.make_vec("hopper", 2, server=server) as envs:
        envs.reset(seed=0)
        actions = np.zeros((2, 3))
        with pytest.raises(gymnasium.error.NoAsyncCallError):
            envs.step_wait()
        envs.step_async(actions)
        for refused in (lambda: envs.step_async(actions), lambda: envs.step(actions), envs.reset):
            with pytest.raises(gymnasium.error.AlreadyPendingCallError):
                refused()
        assert envs.step_wait()[0].shape == (2, 11)
