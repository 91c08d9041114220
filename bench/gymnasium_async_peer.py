"""Steps Gymnasium's own MuJoCo tasks in AsyncVectorEnv: a process for each environment."""

from typing import Any

import gymnasium

from bench.workload import GYMNASIUM_IDS, parser, workload


def main() -> None:
    """Measures once."""
    work = workload(parser("Measures Gymnasium's AsyncVectorEnv.").parse_args())
    # Shared memory for observations is its default.
    env: Any = gymnasium.make_vec(
        GYMNASIUM_IDS[work.task], num_envs=work.num_envs, vectorization_mode="async"
    )
    (action_size,) = env.single_action_space.shape
    actions = work.actions(action_size)
    env.reset(seed=work.seed)
    work.measure(env, actions)
    env.close()


if __name__ == "__main__":
    main()
