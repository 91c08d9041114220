"""Recorded demonstrations read from a file, whoever recorded them."""

import importlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

_NEEDED = ("observations", "actions", "rewards", "terminals", "timeouts")


@dataclass(frozen=True, eq=False)
class Recording:
    """N transitions of E episodes, one after the other. The arrays cannot be written to."""

    path: str
    """Where it was read from."""
    env_id: str | None
    """What the file says that it holds; D4RL's own files do not say."""
    observations: NDArray[np.float32]
    """[N, observation size]: before each action."""
    actions: NDArray[np.float32]
    """[N, action size]"""
    rewards: NDArray[np.float32]
    """[N]"""
    terminals: NDArray[np.bool_]
    """[N]: the task ended the episode here."""
    timeouts: NDArray[np.bool_]
    """[N]: the episode ended here, but not by the task."""
    next_observations: NDArray[np.float32] | None
    """[N, observation size]: after each action; None if the file does not hold them."""

    def __len__(self) -> int:
        """N."""
        return len(self.rewards)

    def episodes(self) -> Iterator[slice]:
        """The rows of each episode; the last one is closed at the end of the file."""
        start = 0
        for last in np.flatnonzero(self.terminals | self.timeouts).tolist():
            yield slice(start, last + 1)
            start = last + 1
        if start < len(self):
            yield slice(start, len(self))

    def past_actions(self) -> NDArray[np.float32]:
        """[N, action size]: what was done one step before; zeros where an episode begins."""
        past = np.roll(self.actions, 1, axis=0)
        past[[rows.start for rows in self.episodes()]] = 0
        return past

    def torch(self) -> Any:
        """A `torch.utils.data.Dataset` of (observation, action, past action), one row an item.

        Raises:
            ImportError: torch is not installed.
        """
        torch: Any = importlib.import_module("torch")
        arrays = (self.observations, self.actions, self.past_actions())
        # torch refuses arrays that cannot be written to.
        return torch.utils.data.TensorDataset(*(torch.from_numpy(a.copy()) for a in arrays))


def load_dataset(path: str | os.PathLike[str]) -> Recording:
    """Reads an HDF5 file in D4RL's layout.

    `palr-gym data convert` makes one from a data set of Minari's.

    Raises:
        ImportError: h5py is not installed (`pip install palr-gym[hdf5]`).
        OSError: There is no such file, or it is no HDF5 file.
        ValueError: It lacks an array, or arrays have not the same number of rows.
    """
    h5py: Any = importlib.import_module("h5py")
    name = os.fspath(path)
    if Path(name).is_dir():
        raise ValueError(
            f"{name} is a folder; expected an HDF5 file in D4RL's layout. `palr-gym data convert "
            f"{name} OUT.hdf5` makes one from a Minari data set"
        )
    with h5py.File(name, "r") as file:
        missing = [array for array in _NEEDED if array not in file]
        if missing:
            found = ", ".join(sorted(file))
            raise ValueError(f"{name} has no {', '.join(missing)}; found {found or 'nothing'}")

        def array(key: str, dtype: type[np.generic]) -> NDArray[Any]:
            values = cast("NDArray[Any]", np.asarray(file[key][()]).astype(dtype, copy=False))
            if values.ndim == 2 and key in _NEEDED[2:]:
                values = values[:, 0]
            values.flags.writeable = False
            return values

        observations = array("observations", np.float32)
        has_next = "next_observations" in file
        env_id = file.get("metadata/env_id")
        recording = Recording(
            path=name,
            env_id=None if env_id is None else str(env_id.asstr()[()]),
            observations=observations,
            actions=array("actions", np.float32),
            rewards=array("rewards", np.float32),
            terminals=array("terminals", np.bool_),
            timeouts=array("timeouts", np.bool_),
            next_observations=array("next_observations", np.float32) if has_next else None,
        )
    for key in _NEEDED:
        rows = len(getattr(recording, key))
        if rows != len(observations):
            raise ValueError(f"{name}: {key} has {rows} rows; observations has {len(observations)}")
    return recording
