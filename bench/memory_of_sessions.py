"""Opens sessions, steps them, and reads how much memory their server then has."""

import argparse
import contextlib
import json
import math
import resource
from pathlib import Path

import numpy as np

from palr_gym import RemoteVectorEnv

_STEPS = 30


def _resident_bytes(pid: int) -> int:
    """Memory of a process that no other one shares."""
    rollup = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
    kilobytes = [
        int(line.split()[1]) for line in rollup.splitlines() if line.startswith("Private_")
    ]
    return sum(kilobytes) * 1024


def main() -> None:
    """Measures once."""
    parser = argparse.ArgumentParser(description="Measures a server's memory.")
    parser.add_argument("--server", required=True, help="host:port or unix:/path")
    parser.add_argument("--pid", type=int, required=True, help="of the server")
    parser.add_argument("--task", required=True, help="such as hopper")
    parser.add_argument("--sessions", type=int, default=1)
    parser.add_argument("--num-envs", type=int, default=1, help="of each session")
    options = parser.parse_args()
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    with contextlib.ExitStack() as stack:
        for seed in range(options.sessions):
            env = RemoteVectorEnv(options.task, options.num_envs, server=options.server)
            stack.enter_context(env)
            env.reset(seed=seed * options.num_envs)
            size = math.prod(env.single_action_space.shape or ())
            actions = np.zeros((options.num_envs, size), np.float32)
            for _ in range(_STEPS):
                env.step(actions)
        used = _resident_bytes(options.pid)
    print(json.dumps({"bytes": used}))


if __name__ == "__main__":
    main()
