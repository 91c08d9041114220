"""Steps a server through our Python client, by Gymnasium's vector interface and nothing else."""

import math

from bench.workload import parser, workload
from palr_gym import RemoteVectorEnv


def main() -> None:
    """Measures once."""
    arguments = parser("Measures a server with the Python client.")
    arguments.add_argument("--server", required=True, help="host:port or unix:/path")
    options = arguments.parse_args()
    work = workload(options)
    with RemoteVectorEnv(work.task, work.num_envs, server=options.server) as env:
        actions = work.actions(math.prod(env.single_action_space.shape or ()))
        env.reset(seed=work.seed)
        work.measure(env, actions)


if __name__ == "__main__":
    main()
