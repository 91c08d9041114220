"""remote-gym's client, unchanged, on our server over dm_env_rpc.

Limits that are its own, not the protocol's or ours: one environment at a time; `reset(seed=...)`
takes a seed and ignores it (so a world's seed is a setting); infos are always empty; it speaks TCP
only; and it leaves worlds, two for each environment, but never destroys them: the server does, when
nobody has joined them for as long as a session may be idle.
"""

from typing import Any

import gymnasium
import numpy as np
import pytest
import remote_gym

from support.reference import MASKS, MaskedStack, gymnasium_env, random_actions

pytestmark = pytest.mark.filterwarnings("ignore")


def remote(server: str, env_id: str, seed: int) -> Any:
    host, _, port = server.rpartition(":")
    arguments: Any = {"entrypoint": env_id, "entrypoint_kwargs": {"seed": seed}}
    return remote_gym.RemoteEnvironment(url=host, port=int(port), remote_args=arguments)


def test_it_steps_as_gymnasium_does(server: str) -> None:
    env, reference = remote(server, "hopper-w2", 3), gymnasium_env("hopper")
    stack = MaskedStack(MASKS["hopper"]["paper"], 2)
    assert env.action_space == gymnasium.spaces.Box(-1, 1, (3,), np.float32)
    assert env.observation_space.shape == (10,)
    observation, _ = env.reset()
    np.testing.assert_array_equal(observation, stack.reset(reference.reset(seed=3)[0]))
    for action in random_actions(0, 200, 3):
        got = env.step(action)
        full, reward, terminated, truncated, _ = reference.step(action)
        np.testing.assert_array_equal(got[0], stack.push(full))
        assert got[1:4] == (reward, terminated, truncated)
        if terminated or truncated:
            observation, _ = env.reset()
            np.testing.assert_array_equal(observation, stack.reset(reference.reset()[0]))
    env.close()


def test_the_time_limit_is_a_truncation(server: str) -> None:
    env = remote(server, "halfcheetah", 0)
    env.reset()
    action = np.zeros(6, dtype=np.float32)
    ends = [env.step(action)[2:4] for _ in range(1000)]
    assert ends == [(False, False)] * 999 + [(False, True)]
    env.close()
