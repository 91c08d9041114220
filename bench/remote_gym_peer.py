"""Steps Gymnasium's task through remote-gym: its server in one process, its client in this one."""

import importlib
import multiprocessing
import socket
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from bench.workload import GYMNASIUM_IDS, parser, workload

_START_TIMEOUT_S = 60


class _Counted:
    """Its environment with Gymnasium's vector interface, as far as `Workload` wants it."""

    def __init__(self, env: Any) -> None:
        self._env = env

    def step(self, actions: Any) -> Any:
        # After an end, the next step begins anew: the protocol's NEXT_STEP, one round trip as well.
        observation, reward, terminated, truncated, info = self._env.step(actions[0])
        return observation, reward, np.array([terminated]), np.array([truncated]), info


def create_environment(env_id: int, task: str, **_: Any) -> Any:
    """What remote-gym's server asks for; `env_id` is its number of the environment."""
    del env_id
    env: Any = gymnasium.make(GYMNASIUM_IDS[task])
    env = gymnasium.wrappers.DtypeObservation(env, np.float32)
    # Gymnasium 1.0 dropped what remote-gym still reads.
    env.reward_range = (-float("inf"), float("inf"))
    return env


def _serve(port: int, is_up: Any) -> None:
    # It loads this file, and wants it below the folder in which it runs.
    Path("entrypoint.py").write_text("from bench.remote_gym_peer import create_environment\n")
    arguments: Any = {"entrypoint": "entrypoint.py", "entrypoint_kwargs": {}}
    remote_gym: Any = importlib.import_module("remote_gym")
    server: Any = remote_gym.create_remote_environment_server(
        arguments, "localhost", port, use_thread=True
    )
    is_up.set()
    server.wait_for_termination()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def main() -> None:
    """Measures once."""
    work = workload(parser("Measures remote-gym.").parse_args())
    context = multiprocessing.get_context("spawn")
    port, is_up = _free_port(), context.Event()
    server = context.Process(target=_serve, args=(port, is_up), daemon=True)
    server.start()
    if not is_up.wait(_START_TIMEOUT_S):
        raise TimeoutError("remote-gym's server does not start")
    kwargs: Any = {"entrypoint_kwargs": {"task": work.task}}
    remote_gym: Any = importlib.import_module("remote_gym")
    env: Any = remote_gym.RemoteEnvironment(url="localhost", port=port, remote_args=kwargs)
    (action_size,) = env.action_space.shape
    actions = work.actions(action_size)
    env.reset()
    work.measure(_Counted(env), actions)
    env.close()
    # Its server waits for its threads when asked to end; nobody waits for it.
    server.kill()


if __name__ == "__main__":
    main()
