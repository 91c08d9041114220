"""Rows to train on, against a transcription of docs/preprocessing.md in plain Python."""

import subprocess
from pathlib import Path
from typing import Any

import h5py as _h5py
import numpy as np
import pytest
import safetensors.numpy as _safetensors
from numpy.typing import NDArray

from support.server_process import binary

# Their annotations are partial.
h5py: Any = _h5py
safetensors: Any = _safetensors

# What the paper's own code keeps of an observation.
MASKS = {"hopper": [0, 1, 2, 3, 4], "halfcheetah": [0, 1, 2, 3, 8, 9, 10, 11, 12]}
SIZES = {"hopper": (11, 3), "halfcheetah": (17, 6)}


def recording(path: Path, task: str, seed: int) -> dict[str, NDArray[Any]]:
    """Random episodes of random lengths, one of a single row, ended in every way."""
    rng = np.random.default_rng(seed)
    lengths = [*rng.integers(2, 40, size=30).tolist(), 1, *rng.integers(2, 40, size=30).tolist()]
    n, (width, actions) = sum(lengths), SIZES[task]
    last = np.cumsum(lengths) - 1
    is_end = np.zeros(n, bool)
    is_end[last[:-1]] = True
    terminated = rng.random(n) < 0.5
    arrays = {
        "observations": rng.normal(3, 5, size=(n, width)).astype(np.float32),
        "actions": rng.uniform(-1, 1, size=(n, actions)).astype(np.float32),
        "rewards": rng.normal(size=n).astype(np.float32),
        "terminals": is_end & terminated,
        "timeouts": is_end & ~terminated,
    }
    # An entry that never varies in one mask.
    arrays["observations"][:, 1] = 2.5
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file[name] = array
    return arrays


def stacks(arrays: dict[str, NDArray[Any]], mask: list[int], w: int) -> NDArray[np.float32]:
    """Rules 1, 4 and 5, row by row."""
    rows: list[NDArray[np.float32]] = []
    history: list[NDArray[np.float32]] = []
    blank = np.zeros(len(mask), np.float32)
    for row, observation in enumerate(arrays["observations"]):
        history.append(observation[mask])
        rows.append(np.concatenate([*[blank] * (w - len(history)), *history[-w:]]))
        if arrays["terminals"][row] or arrays["timeouts"][row]:
            history = []
    return np.stack(rows)


def past_actions(arrays: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
    """Rules 1 and 6."""
    past = np.zeros_like(arrays["actions"])
    for row in range(1, len(past)):
        if not (arrays["terminals"][row - 1] or arrays["timeouts"][row - 1]):
            past[row] = arrays["actions"][row - 1]
    return past


@pytest.mark.parametrize(
    ("task", "w", "statistics", "seed"),
    [
        ("hopper", 1, "training", 0),
        ("hopper", 2, "training", 1),
        ("hopper", 4, "all", 2),
        ("halfcheetah", 3, "training", 3),
        ("halfcheetah", 2, "all", 4),
    ],
)
def test_rows_follow_the_rules(
    task: str, w: int, statistics: str, seed: int, tmp_path: Path
) -> None:
    arrays = recording(tmp_path / "data.hdf5", task, seed)
    n = len(arrays["rewards"])
    training, start, held_out = n // 2, n // 2 + 7, n // 3
    out = tmp_path / "rows.safetensors"
    line = [str(binary()), "data", "prepare", str(tmp_path / "data.hdf5"), str(out)]
    line += [f"--env={task}-w{w}", f"--training-rows={training}", f"--statistics={statistics}"]
    line += [f"--held-out-rows={held_out}", f"--held-out-start={start}"]
    subprocess.run(line, check=True, capture_output=True, timeout=50)
    got = safetensors.load_file(out)

    seen, past = stacks(arrays, MASKS[task], w), past_actions(arrays)
    rows = seen[:training] if statistics == "training" else seen
    mean, std = rows.astype(np.float64).mean(axis=0), rows.astype(np.float64).std(axis=0)
    std[rows.min(axis=0) == rows.max(axis=0)] = 1
    np.testing.assert_allclose(got["observation_mean"], mean, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(got["observation_std"], std, rtol=1e-6)
    parts = {"training": slice(0, training), "held_out": slice(start, start + held_out)}
    for name, part in parts.items():
        expected = (seen[part] - mean) / std
        np.testing.assert_allclose(got[f"{name}.observations"], expected, rtol=1e-5, atol=1e-5)
        np.testing.assert_array_equal(got[f"{name}.actions"], arrays["actions"][part])
        np.testing.assert_array_equal(got[f"{name}.past_actions"], past[part])

    again = subprocess.run(line, check=False, capture_output=True, text=True, timeout=50)
    assert again.returncode == 1
    assert "rows.safetensors" in again.stderr
    assert "exists" in again.stderr


def test_held_out_rows_are_whole_runs_of_unseen_episodes(tmp_path: Path) -> None:
    arrays = recording(tmp_path / "data.hdf5", "hopper", 5)
    out = tmp_path / "rows.safetensors"
    line = [str(binary()), "data", "prepare", str(tmp_path / "data.hdf5"), str(out)]
    line += ["--env=hopper-w2", "--training-rows=300", "--held-out-rows=100"]
    subprocess.run(line, check=True, capture_output=True, timeout=50)
    got = safetensors.load_file(out)["held_out.actions"]
    # Actions are all different, so they tell the row.
    rows = {tuple(action): row for row, action in enumerate(arrays["actions"].tolist())}
    chosen = [rows[tuple(action)] for action in got.tolist()]
    assert chosen == sorted(set(chosen))
    assert len(chosen) == 100
    ends = np.flatnonzero(arrays["terminals"] | arrays["timeouts"])
    episodes = np.searchsorted(ends, chosen)
    assert len(set(episodes.tolist())) >= 20
    starts = np.concatenate([[0], ends + 1])
    assert min(starts[episodes]) >= 300
    for episode in set(episodes.tolist()):
        own = [row for row, other in zip(chosen, episodes, strict=True) if other == episode]
        assert own == list(range(own[0], own[-1] + 1))


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--env=hoper-w2"], "hopper"),
        (["--env=halfcheetah-w2"], "observations has 11 columns"),
        (["--env=hopper-w2", "--training-rows=100000"], "100000"),
        (["--env=hopper-w2", "--training-rows=0"], "0"),
        (["--env=hopper-w2", "--statistics=some"], "training, all"),
    ],
)
def test_what_cannot_be_prepared_is_refused(
    arguments: list[str], complaint: str, tmp_path: Path
) -> None:
    recording(tmp_path / "data.hdf5", "hopper", 6)
    line = [str(binary()), "data", "prepare", str(tmp_path / "data.hdf5"), str(tmp_path / "out")]
    refused = subprocess.run(
        [*line, *arguments], check=False, capture_output=True, text=True, timeout=50
    )
    assert refused.returncode != 0
    assert complaint in refused.stderr
    assert not (tmp_path / "out").exists()
