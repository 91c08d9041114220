"""What every Python contender steps, and how it reports. Runs where NumPy is installed."""

import argparse
import json
import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class VectorEnv(Protocol):
    """What is used of Gymnasium's vector interface."""

    def step(self, actions: NDArray[Any], /) -> Any:
        """Steps every environment once; gives Gymnasium's five values."""
        ...


@dataclass(frozen=True)
class Workload:
    """The same environments from the same seeds with the same actions for everyone."""

    task: str
    num_envs: int
    seed: int
    warm_up: int
    steps: int

    def actions(self, action_size: int) -> NDArray[np.float32]:
        """Uniformly random, [warm_up + steps, num_envs, action size]; as bench/src/lib.rs."""
        shape = (self.warm_up + self.steps, self.num_envs, action_size)
        return np.random.default_rng(self.seed).uniform(-1, 1, shape).astype(np.float32)

    def measure(self, env: VectorEnv, actions: NDArray[Any]) -> None:
        """Steps `env`, which has just been reset, and prints the result.

        Environments are in autoreset mode NEXT_STEP: the step after an end only resets, and is
        not counted.
        """
        assert len(actions) == self.warm_up + self.steps
        ended = np.zeros(self.num_envs, dtype=np.bool_)
        for action in actions[: self.warm_up]:
            _, _, terminated, truncated, _ = env.step(action)
            ended = terminated | truncated
        ends = [ended]
        started = time.perf_counter()
        for action in actions[self.warm_up :]:
            _, _, terminated, truncated, _ = env.step(action)
            ends.append(terminated | truncated)
        wall_s = time.perf_counter() - started
        reset_steps = sum(int(np.count_nonzero(ended)) for ended in ends[:-1])
        env_steps = self.steps * self.num_envs - reset_steps
        print(json.dumps({"env_steps": env_steps, "wall_s": wall_s, "rate": env_steps / wall_s}))


def parser(description: str) -> argparse.ArgumentParser:
    """The arguments that every contender takes, as bench/src/lib.rs does."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--task", required=True, help="such as hopper")
    parser.add_argument("--num-envs", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--warm-up", type=int, default=100, help="steps before the clock starts")
    parser.add_argument("--steps", type=int, default=1000, help="steps while it runs")
    return parser


def workload(options: argparse.Namespace) -> Workload:
    """What the parsed arguments say."""
    return Workload(
        task=options.task,
        num_envs=options.num_envs,
        seed=options.seed,
        warm_up=options.warm_up,
        steps=options.steps,
    )


GYMNASIUM_IDS = {
    "ant": "Ant-v4",
    "halfcheetah": "HalfCheetah-v4",
    "hopper": "Hopper-v4",
    "walker2d": "Walker2d-v4",
}
"""What our tasks are called elsewhere."""
