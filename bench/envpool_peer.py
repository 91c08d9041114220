"""Steps EnvPool's MuJoCo tasks in this process, synchronously."""

import importlib
from typing import Any

import numpy as np

from bench.workload import GYMNASIUM_IDS, parser, workload


def main() -> None:
    """Measures once."""
    arguments = parser("Measures EnvPool.")
    arguments.add_argument("--threads", type=int, required=True, help="EnvPool's num_threads")
    options = arguments.parse_args()
    work = workload(options)
    # By name: it has no types and is installed in .venv-bench only.
    envpool: Any = importlib.import_module("envpool")
    # batch_size unset: synchronous, each step returns all environments.
    env: Any = envpool.make_gymnasium(
        GYMNASIUM_IDS[work.task],
        num_envs=work.num_envs,
        num_threads=options.threads,
        seed=work.seed,
    )
    (action_size,) = env.action_space.shape
    # Converted beforehand, so that EnvPool does not have to.
    actions = work.actions(action_size).astype(np.float64)
    env.reset()
    work.measure(env, actions)


if __name__ == "__main__":
    main()
