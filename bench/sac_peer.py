"""Stable-Baselines3's SAC: how many updates a second its own `train` does.

    python -m bench.sac_peer --updates 500

On the CPU, with one thread (its small products gain nothing from more), its default networks and
batch, on transitions of the right sizes, on which no update's cost depends. Prints a line of JSON.
"""

# torch and stable-baselines3 are not installed where types are checked.
# pyright: basic, reportMissingImports=false

import argparse
import json
import time

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.logger import configure

_OBSERVATION_SIZE = 17
_ACTION_SIZE = 6
_TRANSITIONS = 100_000
_BATCH = 256


class Sizes(gymnasium.Env):
    """Spaces of halfcheetah; nobody steps it."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (_OBSERVATION_SIZE,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (_ACTION_SIZE,), np.float32)


def ready() -> SAC:
    """An agent with a full replay buffer."""
    torch.set_num_threads(1)
    # float32 observations in its buffer, as ours.
    Sizes.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (_OBSERVATION_SIZE,))
    agent = SAC("MlpPolicy", Sizes(), batch_size=_BATCH, buffer_size=_TRANSITIONS, device="cpu")
    agent.set_logger(configure(None, []))
    rng = np.random.default_rng(0)
    buffer = agent.replay_buffer
    assert buffer is not None
    shape = buffer.observations.shape
    buffer.observations[:] = rng.standard_normal(shape, np.float32)
    buffer.next_observations[:] = rng.standard_normal(shape, np.float32)
    buffer.actions[:] = np.tanh(rng.standard_normal(buffer.actions.shape, np.float32))
    buffer.rewards[:] = rng.standard_normal(buffer.rewards.shape, np.float32)
    buffer.full = True
    return agent


def main() -> None:
    """Measures once."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--updates", type=int, required=True)
    updates = parser.parse_args().updates
    agent = ready()
    agent.train(max(1, updates // 10), _BATCH)
    started = time.perf_counter()
    agent.train(updates, _BATCH)
    wall_s = time.perf_counter() - started
    print(json.dumps({"updates": updates, "wall_s": wall_s, "rate": updates / wall_s}))


if __name__ == "__main__":
    main()
