"""TensorBoard's own reader finds the curves that a run's lines hold."""

import importlib
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from support.server_process import binary

# The reader's own imports warn.
pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.timeout(240)]

_NAMES = {
    "batch/nll": "batch_nll",
    "batch/hscic": "batch_hscic",
    "training/nll": "training_nll",
    "training/hscic": "training_hscic",
    "training/action_hscic": "training_action_hscic",
    "held_out/nll": "held_out_nll",
    "held_out/change_nll": "held_out_change_nll",
    "held_out/hscic": "held_out_hscic",
    "held_out/action_hscic": "held_out_action_hscic",
}
_EVALUATION_NAMES = {
    "evaluation/return": "return_mean",
    "evaluation/score": "score_mean",
    "evaluation/length": "length_mean",
}


def palr_gym(folder: Path, *arguments: str) -> None:
    subprocess.run([binary(), *arguments], cwd=folder, check=True, capture_output=True, timeout=50)


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_tensorboard_reads_what_the_lines_say_also_after_resuming(tmp_path: Path) -> None:
    collect = ["collect", "--env", "hopper", "--policy", "random", "--transitions", "1500"]
    palr_gym(tmp_path, *collect, "--out", "a.hdf5")
    train = ["train", "--env", "hopper-w2", "--data", "a.hdf5", "--training-rows", "800"]
    train += ["--held-out-rows", "100", "--batch", "16", "--set", "metric_rows=16"]
    train += ["--log-every", "2", "--evaluate-every", "4", "--episodes", "2"]
    palr_gym(tmp_path, *train, "--steps", "6")
    palr_gym(tmp_path, "train", "--resume", "--steps", "10")
    run = tmp_path / "runs" / "train" / "001"
    name = "tensorboard.backend.event_processing.event_accumulator"
    accumulator = importlib.import_module(name).EventAccumulator
    for kind, file, names in [
        ("training", "metrics.jsonl", _NAMES),
        ("evaluation", "evaluations.jsonl", _EVALUATION_NAMES),
    ]:
        events = accumulator(str(run / "tensorboard" / kind))
        events.Reload()
        assert set(events.Tags()["scalars"]) == set(names)
        for tag, field in names.items():
            got = [(event.step, event.value) for event in events.Scalars(tag)]
            wanted = [(line["step"], line[field]) for line in lines(run / file)]
            assert [step for step, _ in got] == [step for step, _ in wanted]
            assert [value for _, value in got] == pytest.approx(
                [value for _, value in wanted], rel=1e-6
            )
    assert [line["step"] for line in lines(run / "metrics.jsonl")] == [2, 4, 6, 8, 10]
    # The policy of step 6 was the finished one of the shorter run.
    assert [line["step"] for line in lines(run / "evaluations.jsonl")] == [4, 6, 8, 10]
