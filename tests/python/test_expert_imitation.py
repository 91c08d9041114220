"""Imitators of an expert: the program's own commands, one by one, reach the same."""

import hashlib
import json
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import expert_cards
from support.onnx_policies import linear_policy
from support.server_process import ROOT, binary

# First of the episodes of a card.
CARD_SEED = "20000"


def run(*arguments: str, timeout: float = 100) -> dict[str, Any]:
    done = subprocess.run(
        [str(binary()), *arguments, "--json"],
        check=True,
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    return json.loads(done.stdout)


def imitate(out: Path, **options: object) -> list[str]:
    """A small measurement of hopper's expert, or of what the options say."""
    chosen = {"env": "hopper", "imitators": 2, "transitions": 1500, "steps": 120, "episodes": 4}
    chosen |= {"out": out} | options
    return ["expert", "imitate", *(f"--{name}={value}" for name, value in chosen.items())]


def evaluated(policy: str) -> dict[str, Any]:
    line = ["evaluate", "--env", "hopper", "--policy", policy, "--episodes", "4"]
    return run(*line, "--seed", CARD_SEED)


def test_an_imitator_is_what_collect_train_and_evaluate_make(tmp_path: Path) -> None:
    report = run(*imitate(tmp_path / "at-once"))
    expert = evaluated("expert")
    assert report["expert"]["return_mean"] == expert["return_mean"]
    content = (ROOT / "scenes" / "experts" / "hopper.onnx").read_bytes()
    assert report["onnx_sha256"] == hashlib.sha256(content).hexdigest()

    shares: list[float] = []
    for seed, imitator in enumerate(report["imitators"]):
        data = tmp_path / f"{seed}.hdf5"
        recording = ["collect", "--env", "hopper", "--policy", "expert", "--sampled"]
        run(*recording, "--transitions", "1500", "--seed", str(seed), "--out", str(data))
        line = ["train", "--env", "hopper", "--algorithm", "bc", "--data", str(data)]
        line += ["--steps", "120", "--seed", str(seed), "--out", str(tmp_path / "by-hand")]
        line += ["--set", "training_rows=1500", "--set", "held_out.rows=0"]
        run(*line)
        by_hand = evaluated(str(tmp_path / "by-hand" / f"{seed + 1:03}"))
        assert imitator["seed"] == seed
        assert imitator["reached"]["return_mean"] == by_hand["return_mean"]
        returns = [episode["episode_return"] for episode in by_hand["episodes"]]
        assert imitator["reached"]["return_min"] == min(returns)
        shares.append(by_hand["return_mean"] / expert["return_mean"])
        assert imitator["share_of_expert"] == pytest.approx(shares[-1], rel=1e-12)
    assert len(shares) == 2
    assert report["share_of_expert"] == pytest.approx(np.mean(shares), rel=1e-12)
    error = np.std(shares, ddof=1) / np.sqrt(2)
    assert report["share_standard_error"] == pytest.approx(error, rel=1e-9)

    # A file of one's own is another policy; a single imitator has no standard error.
    file = str(ROOT / "scenes" / "experts" / "hopper.onnx")
    alone = run(*imitate(tmp_path / "alone", policy=file, imitators=1))
    assert alone["imitators"] == report["imitators"][:1]
    assert alone["share_standard_error"] is None
    # Other imitators in the same folder are others, and leave those that are there alone.
    shorter = run(*imitate(tmp_path / "at-once", steps=60, imitators=1))
    assert shorter["imitators"] != alone["imitators"]
    fewer = run(*imitate(tmp_path / "at-once", transitions=1100, imitators=1))
    assert fewer["imitators"] != alone["imitators"]
    assert run(*imitate(tmp_path / "at-once")) == report


def test_what_was_stopped_goes_on_with_the_same_command(tmp_path: Path) -> None:
    whole = run(*imitate(tmp_path / "whole", steps=400))
    line = [str(binary()), *imitate(tmp_path / "stopped", steps=400)]
    stopped = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list((tmp_path / "stopped").glob("*/bc-1500-400-1/run.json")):
        assert stopped.poll() is None, "ended early"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    stopped.send_signal(signal.SIGTERM)
    _, errors = stopped.communicate(timeout=30)
    assert stopped.returncode == 130
    assert "stopped at imitator 2 of 2; the same command goes on with it" in errors
    assert run(*imitate(tmp_path / "stopped", steps=400)) == whole


def test_a_card_says_what_imitators_reached(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    settings = {"hidden": 16, "learning_starts": 200, "batch": 32, "log_every": 400}
    settings |= {"evaluate_every": 400, "checkpoint_every": 400, "episodes": 1}
    line = ["expert", "train", "--env", "hopper", "--steps", "400", "--out", str(folder)]
    for name, value in settings.items():
        line += ["--set", f"{name}={value}"]
    run(*line, "--card-episodes", "0")
    measuring = ["expert", "card", str(folder), "--episodes", "3"]
    card = run(*measuring, "--imitate", "--imitators", "2", "--imitation-steps", "20")
    fitness = card["fitness"]
    assert [imitator["seed"] for imitator in fitness["imitators"]] == [0, 1]
    for imitator in fitness["imitators"]:
        share = imitator["reached"]["return_mean"] / card["deterministic"]["return_mean"]
        assert imitator["share_of_expert"] == pytest.approx(share, rel=1e-12)
    assert fitness["onnx_sha256"] == card["onnx"]["sha256"]
    assert json.loads((folder / "card.json").read_text()) == card
    share, error = 100 * fitness["share_of_expert"], 100 * fitness["share_standard_error"]
    assert f"| {share:.0f} ± {error:.0f} %, 20 steps |" in expert_cards.row("hopper", card)
    # Measured once more without imitators, the card keeps what it knew of them.
    assert run(*measuring)["fitness"] == fitness


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"policy": "random"}, "random has nothing to imitate"),
        ({"policy": "/nowhere.onnx"}, "/nowhere.onnx: No such file"),
        ({"imitators": 0}, "0 is not in 1.."),
        ({"transitions": 0}, "transitions is 0; expected 1 to"),
        ({"env": "hoper"}, 'did you mean "hopper"?'),
        ({"env": "hopper-w2"}, "expected full single observations of hopper"),
    ],
)
def test_wrong_requests_are_named(
    options: dict[str, object], complaint: str, tmp_path: Path
) -> None:
    line = [str(binary()), *imitate(tmp_path, **options)]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode in (1, 64)
    assert complaint in done.stderr
    assert "panicked" not in done.stderr


def test_there_is_no_share_of_a_loss(tmp_path: Path) -> None:
    policy = tmp_path / "shaking.onnx"
    policy.write_bytes(linear_policy(np.full((17, 6), 5, dtype=np.float32)))
    out = tmp_path / "imitators"
    line = [str(binary()), *imitate(out, env="halfcheetah", policy=policy)]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert "a share of that means nothing; expected a policy that returns more" in done.stderr
    assert not out.exists()
