"""Data sets in D4RL's and Minari's layouts: read back by h5py and by Minari itself."""

import json
import subprocess
from pathlib import Path
from typing import Any

import h5py as _h5py
import minari as _minari
import numpy as np
import pytest
from numpy.typing import NDArray

from palr_gym import load_dataset
from support.server_process import binary

# Their annotations are partial.
h5py: Any = _h5py
minari: Any = _minari

LENGTHS = [7, 3, 5]
ENDS = np.cumsum(LENGTHS) - 1
Arrays = dict[str, NDArray[Any]]


def palr_gym(*arguments: str | Path, check: bool = True) -> "subprocess.CompletedProcess[str]":
    """Runs `palr-gym data`."""
    line = [str(binary()), "data", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, check=check, timeout=50)


def recording() -> Arrays:
    """Three hopper episodes: by the time limit, by the task, and cut."""
    rng = np.random.default_rng(0)
    n = sum(LENGTHS)
    flags = np.zeros(n, bool)
    terminals, timeouts = flags.copy(), flags.copy()
    terminals[ENDS[1]] = True
    timeouts[ENDS[[0, 2]]] = True
    return {
        "observations": rng.normal(size=(n, 11)).astype(np.float32),
        "next_observations": rng.normal(size=(n, 11)).astype(np.float32),
        "actions": rng.uniform(-1, 1, size=(n, 3)).astype(np.float32),
        "rewards": rng.normal(size=n).astype(np.float32),
        "terminals": terminals,
        "timeouts": timeouts,
        "infos/qpos": rng.normal(size=(n, 6)),
        "infos/qvel": rng.normal(size=(n, 6)),
        "infos/action_log_probs": rng.normal(size=n).astype(np.float32),
    }


def consistent(arrays: Arrays) -> Arrays:
    """With next observations that are the following row's, as in any real recording."""
    following = np.roll(arrays["observations"], -1, axis=0)
    following[ENDS] = arrays["next_observations"][ENDS]
    return arrays | {"next_observations": following}


def write(path: Path, arrays: Arrays, env_id: str = "hopper-v0") -> None:
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file[name] = array
        file["metadata/env_id"] = env_id
        file["metadata/seed"] = 40
        file["metadata/request"] = "{}"


def read(path: Path) -> Arrays:
    with h5py.File(path) as file:
        names = [name for name in recording() if name in file]
        return {name: file[name][()] for name in names}


def metadata(path: Path) -> dict[str, Any]:
    with h5py.File(path) as file:
        return {
            name: value.asstr()[()] if value.dtype.kind == "O" else int(value[()])
            for name, value in file["metadata"].items()
        }


def test_minari_reads_what_was_converted_and_the_way_back_changes_nothing(tmp_path: Path) -> None:
    arrays = consistent(recording())
    write(tmp_path / "a.hdf5", arrays)
    palr_gym("convert", tmp_path / "a.hdf5", tmp_path / "hopper-mine-v0")
    dataset = minari.MinariDataset(tmp_path / "hopper-mine-v0" / "data")
    assert (dataset.total_episodes, dataset.total_steps) == (3, sum(LENGTHS))
    assert dataset.spec.dataset_id == "hopper-mine-v0"
    starts = [0, *(ENDS[:-1] + 1)]
    for episode, start, end in zip(dataset.iterate_episodes(), starts, ENDS, strict=True):
        rows = slice(start, end + 1)
        observations = np.vstack([arrays["observations"][rows], arrays["next_observations"][end]])
        assert np.array_equal(episode.observations, observations)
        assert dataset.observation_space.contains(episode.observations[0])
        assert np.array_equal(episode.actions, arrays["actions"][rows])
        assert dataset.action_space.contains(episode.actions[0])
        assert np.array_equal(episode.rewards, arrays["rewards"][rows])
        assert np.array_equal(episode.terminations, arrays["terminals"][rows])
        assert np.array_equal(episode.truncations, arrays["timeouts"][rows])
        assert np.array_equal(episode.infos["qpos"], arrays["infos/qpos"][rows])
    seeds = [entry["seed"] for entry in dataset.storage.get_episode_metadata(range(3))]
    assert seeds == [40, 41, 42]

    palr_gym("convert", tmp_path / "hopper-mine-v0", tmp_path / "b.hdf5")
    again = read(tmp_path / "b.hdf5")
    assert again.keys() == arrays.keys()
    for name, array in arrays.items():
        assert again[name].dtype == array.dtype, name
        assert np.array_equal(again[name], array), name
    kept = metadata(tmp_path / "b.hdf5")
    assert (kept["env_id"], kept["seed"]) == ("hopper-v0", 40)
    # Nothing takes a copy for a finished recording.
    assert "request" not in kept


def test_what_minari_wrote_is_read(tmp_path: Path) -> None:
    import gymnasium

    space = gymnasium.spaces.Box(-np.inf, np.inf, (11,), np.float64)
    actions = gymnasium.spaces.Box(-1, 1, (3,), np.float32)
    rng = np.random.default_rng(1)
    buffers = [
        minari.data_collector.EpisodeBuffer(
            id=i,
            observations=rng.normal(size=(length + 1, 11)),
            actions=rng.uniform(-1, 1, size=(length, 3)).astype(np.float32),
            rewards=list(rng.normal(size=length)),
            terminations=[False] * length,
            truncations=[False] * (length - 1) + [True],
            infos={},
        )
        for i, length in enumerate(LENGTHS)
    ]
    storage = minari.dataset.minari_storage.MinariStorage.new(
        tmp_path / "theirs", observation_space=space, action_space=actions
    )
    storage.update_episodes(buffers)
    info = json.loads(palr_gym("info", tmp_path / "theirs", "--json").stdout)
    assert (info["transitions"], info["episodes"]) == (sum(LENGTHS), 3)
    returns = [sum(buffer.rewards) for buffer in buffers]
    assert info["episode_return"]["mean"] == pytest.approx(np.mean(returns), rel=1e-6)

    palr_gym("slice", tmp_path / "theirs", tmp_path / "part-v0", "--first-episode", "1")
    part = minari.MinariDataset(tmp_path / "part-v0" / "data")
    for episode, buffer in zip(part.iterate_episodes(), buffers[1:], strict=True):
        # float64 stays float64.
        assert np.array_equal(episode.observations, buffer.observations)
        assert episode.observations.dtype == np.float64


def test_a_slice_is_those_rows(tmp_path: Path) -> None:
    arrays = recording()
    write(tmp_path / "a.hdf5", arrays)
    line = ["slice", tmp_path / "a.hdf5", tmp_path / "b.hdf5", "--first-episode", "1"]
    palr_gym(*line, "--transitions", "5")
    got = read(tmp_path / "b.hdf5")
    rows = slice(7, 12)
    for name, array in arrays.items():
        if name != "timeouts":
            assert np.array_equal(got[name], array[rows]), name
    # The cut is the end of an episode.
    assert got["timeouts"].tolist() == [False, False, False, False, True]
    again = palr_gym(*line, check=False)
    assert again.returncode == 1
    assert "it is there already" in again.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.hdf5", "b.hdf5"]


def test_a_plain_d4rl_file_is_sliced_without_what_it_lacks(tmp_path: Path) -> None:
    arrays = recording()
    names = ["observations", "actions", "rewards", "terminals", "timeouts"]
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        for name in names:
            file[name] = arrays[name]
    done = palr_gym("convert", tmp_path / "a.hdf5", tmp_path / "x-v0", check=False)
    assert done.returncode == 1
    assert "a.hdf5: has no data set next_observations" in done.stderr
    assert not (tmp_path / "x-v0").exists()
    palr_gym("slice", tmp_path / "a.hdf5", tmp_path / "b.hdf5", "--episodes", "2")
    got = read(tmp_path / "b.hdf5")
    for name in names:
        assert np.array_equal(got[name], arrays[name][:10]), name


def test_histograms_are_drawn(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5", recording())
    palr_gym("info", tmp_path / "a.hdf5", "--plot", tmp_path / "figure")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (tmp_path / "figure.svg").read_text()


def test_what_cannot_be_copied_names_the_file_and_what_is_wrong(tmp_path: Path) -> None:
    write(tmp_path / "a.hdf5", recording())
    (tmp_path / "empty").mkdir()
    cases = [
        ([tmp_path / "a.hdf5", tmp_path / "hopper"], "expected one that ends in -vN"),
        ([tmp_path / "empty", tmp_path / "b.hdf5"], "main_data.hdf5: No such file"),
        ([tmp_path / "nowhere.hdf5", tmp_path / "b.hdf5"], "nowhere.hdf5"),
    ]
    for arguments, complaint in cases:
        done = palr_gym("convert", *arguments, check=False)
        assert done.returncode in (1, 64)
        assert complaint in done.stderr, done.stderr
    line = ["slice", tmp_path / "a.hdf5", tmp_path / "b.hdf5", "--first-episode", "3"]
    assert "0 rows" in palr_gym(*line, check=False).stderr


def test_recordings_of_gymnasiums_newer_definition_are_not_taken_for_the_older(
    tmp_path: Path,
) -> None:
    write(tmp_path / "a.hdf5", recording(), "hopper-gym5")
    line = [str(binary()), "train", "--env", "hopper-w2", "--algorithm", "bc", "--steps", "1"]
    line += ["--data", str(tmp_path / "a.hdf5"), "--training-rows", "10", "--held-out-rows", "0"]
    line += ["--evaluate-every", "0", "--batch", "4", "--out", str(tmp_path / "runs")]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=50)
    assert done.returncode == 1
    assert "holds data of hopper-gym5; expected full single observations of hopper" in done.stderr


def test_python_loads_a_recording_as_arrays(tmp_path: Path) -> None:
    arrays = recording()
    write(tmp_path / "a.hdf5", arrays)
    got = load_dataset(tmp_path / "a.hdf5")
    assert (len(got), got.env_id) == (sum(LENGTHS), "hopper-v0")
    for name in ["observations", "actions", "rewards", "terminals", "timeouts"]:
        assert np.array_equal(getattr(got, name), arrays[name]), name
    assert not got.actions.flags.writeable
    assert [rows.stop - rows.start for rows in got.episodes()] == LENGTHS
    past = got.past_actions()
    assert not past[[0, 7, 10]].any()
    assert np.array_equal(past[1:7], arrays["actions"][:6])
    with h5py.File(tmp_path / "b.hdf5", "w") as file:
        file["observations"] = arrays["observations"]
    with pytest.raises(ValueError, match=r"b\.hdf5 has no actions, rewards"):
        load_dataset(tmp_path / "b.hdf5")
    with pytest.raises(ValueError, match="palr-gym data convert"):
        load_dataset(tmp_path)
