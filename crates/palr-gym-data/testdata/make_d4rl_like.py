"""Writes d4rl_like.hdf5: laid out as D4RL's hopper-expert-v2.hdf5, and with h5py as that was.

12 rows in episodes of 5 (terminated), 4 (timed out) and 3 (cut by the end of the file). Entry
(t, j) of `observations` is t + j / 16, of `actions` (t - 6) / 8 + j / 32; `rewards` are t / 4.

    .venv/bin/python crates/palr-gym-data/testdata/make_d4rl_like.py
"""

from pathlib import Path

import h5py
import numpy as np

N, D, A = 12, 11, 3
t = np.arange(N, dtype=np.float32)[:, None]
observations = t + np.arange(D, dtype=np.float32) / 16
ends = np.arange(N)

with h5py.File(Path(__file__).with_name("d4rl_like.hdf5"), "w") as file:

    def put(name: str, values: np.ndarray) -> None:
        """Adds a data set, compressed as D4RL's are."""
        file.create_dataset(name, data=values, compression="gzip")

    put("observations", observations)
    put("next_observations", observations + 1)
    put("actions", (t - 6) / 8 + np.arange(A, dtype=np.float32) / 32)
    put("rewards", t[:, 0] / 4)
    put("terminals", ends == 4)
    put("timeouts", ends == 8)
    put("infos/action_log_probs", np.zeros(N, np.float32))
    put("infos/qpos", np.zeros((N, 6)))
    put("infos/qvel", np.zeros((N, 6)))
    file["metadata/algorithm"] = np.bytes_("SAC")
    file["metadata/iteration"] = 3000
    file["metadata/policy/fc0/weight"] = np.zeros((4, D), np.float32)
    file["metadata/policy/nonlinearity"] = np.bytes_("relu")
