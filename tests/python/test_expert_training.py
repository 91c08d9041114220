"""Training an expert: from the seed to the optimiser against float64 JAX, and being interrupted."""

import json
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import onnx as _onnx
import pytest
import safetensors.numpy as _safetensors

import expert_cards
from support import sac_reference as reference
from support.methods_parts import flat
from support.server_process import binary

# Its annotations are partial.
safetensors: Any = _safetensors
onnx: Any = _onnx

# Gymnasium calls its -v4 environments out of date.
pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")

RECIPES = [
    reference.Recipe("hopper", "sac", 5, 2, 3, 80, 32, 24, 25, 5),
    reference.Recipe("hopper", "tqc", 5, 2, 3, 80, 32, 24, 7, 2),
    reference.Recipe("ant", "tqc", 1, 3, 2, 60, 32, 24, 5, 1),
    reference.Recipe("walker2d", "tqc", 2, 1, 4, 60, 32, 24, 5, 1, actor_every=2),
    reference.Recipe("hopper", "sac", 3, 2, 6, 80, 32, 24, 25, 5, actor_average=0.25),
    reference.Recipe("halfcheetah", "sac", 4, 2, 4, 80, 32, 24, 25, 5, reward_cap=-0.2),
    reference.Recipe("hopper", "tqc", 7, 2, 3, 80, 32, 24, 7, 2, reward_cap=0.5),
    reference.Recipe("ant", "sac", 8, 2, 4, 80, 32, 24, 25, 5, healthy_z_range=(0.5, 0.7)),
    reference.Recipe("hopper", "sac", 9, 3, 4, 90, 32, 24, 25, 5, episode_steps=7),
    reference.Recipe(
        "ant", "sac", 6, 2, 4, 80, 32, 24, 25, 5, perturbation=0.4, perturbation_duration=8
    ),
]


def command(recipe: reference.Recipe, out: Path, steps: int) -> list[str]:
    """Small networks; nothing is reported before the end."""
    settings: dict[str, object] = {
        "steps": steps,
        "seed": recipe.seed,
        "num_envs": recipe.num_envs,
        "updates_per_step": 1 / recipe.num_envs,
        "actor_every": recipe.actor_every,
        "actor_average": recipe.actor_average,
        "perturbation": recipe.perturbation,
        "perturbation_duration": recipe.perturbation_duration,
        "learning_starts": recipe.learning_starts,
        "batch": recipe.batch,
        "hidden": recipe.hidden,
        "quantiles": recipe.quantiles,
        "dropped_quantiles": recipe.dropped,
        "episodes": 1,
        "log_every": steps,
        "evaluate_every": steps,
        "checkpoint_every": steps,
    }
    line = [str(binary()), "expert", "train", "--env", recipe.task, "--critic", recipe.critic]
    line += ["--out", str(out), "--card-episodes", "0", "--json"]
    if recipe.reward_cap is not None:
        settings["reward_cap"] = recipe.reward_cap
    if recipe.episode_steps is not None:
        settings["episode_steps"] = recipe.episode_steps
    if recipe.healthy_z_range is not None:
        settings["healthy_z_range"] = list(recipe.healthy_z_range)
    for name, value in settings.items():
        line += ["--set", f"{name}={value}"]
    return line


@pytest.mark.parametrize(
    "recipe", RECIPES, ids=lambda recipe: f"{recipe.task}-{recipe.critic}-{recipe.seed}"
)
def test_updates_are_those_of_the_reference(recipe: reference.Recipe, tmp_path: Path) -> None:
    # The first round of the policy's own has no update beside it.
    steps = recipe.learning_starts + (recipe.updates + 1) * recipe.num_envs
    folder = tmp_path / "run"
    subprocess.run(
        [*command(recipe, folder, steps), "--print-config"], check=True, capture_output=True
    )
    subprocess.run(command(recipe, folder, steps), check=True, capture_output=True, timeout=50)
    expected = reference.Run(recipe)

    [record] = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert record["updates"] == recipe.updates
    for name in expected.losses[-1]:
        want = np.mean([losses[name] for losses in expected.losses if name in losses])
        assert record[name] == pytest.approx(want, rel=2e-4, abs=1e-5), name

    state = safetensors.load_file(folder / "checkpoint.safetensors")
    for name, (parameters, first, second) in expected.networks().items():
        for moment, want in [("first", first), ("second", second)]:
            got = state[f"{name}.adam.{moment}_moment"]
            assert np.abs(got - want).max() < 2e-3 * np.abs(want).max(), f"{name}, {moment}"
        difference = np.abs(state[f"{name}.parameters"] - parameters)
        # Where a gradient is all but zero, Adam's step is its sign, which rounding decides.
        clear = np.abs(first) > 1e-3 * np.abs(first).max()
        assert difference[clear].max() < 2e-5, name
    for slow, name in zip(expected.slow, ["critic_1", "critic_2"], strict=True):
        assert np.abs(state[f"{name}.slow"] - flat(slow)).max() < 1e-5
    averaged = state["averaged.actor.parameters"]
    moved = np.abs(averaged - state["actor.parameters"]).max()
    assert (moved > 1e-6) == (recipe.actor_average < 1)
    exported = safetensors.load_file(folder / "policy.safetensors")
    assert sum(array.size for array in exported.values()) == averaged.size
    assert np.abs(averaged - flat(expected.averaged_actor)).max() < 1e-4


def test_a_stopped_or_killed_run_goes_on_and_what_it_exports_is_whole(tmp_path: Path) -> None:
    recipe = reference.Recipe("hopper", "tqc", 0, 4, 0, 200, 32, 32, 5, 1)
    folder = tmp_path / "run"
    line = command(recipe, folder, 1_000_000)
    line += [
        "--set",
        "checkpoint_every=400",
        "--set",
        "evaluate_every=400",
        "--set",
        "log_every=400",
    ]
    killed = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_for(folder / "evaluations.jsonl", killed)
    wait_for(folder / "checkpoint.safetensors", killed)
    killed.kill()
    killed.wait()
    before = len((folder / "evaluations.jsonl").read_text().splitlines())

    again = subprocess.run(line, capture_output=True, text=True, check=False, timeout=20)
    assert again.returncode == 1
    assert "holds a run; --resume goes on with it" in again.stderr

    stopped = subprocess.Popen([*line, "--resume"], stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        if len((folder / "evaluations.jsonl").read_text().splitlines()) > before:
            break
        time.sleep(0.05)
    stopped.send_signal(signal.SIGTERM)
    output, _ = stopped.communicate(timeout=20)
    assert stopped.returncode == 130
    outcome = json.loads(output)
    assert not outcome["is_complete"]
    assert outcome["counters"]["resumed"] == 1
    replay = safetensors.load_file(folder / "replay.safetensors")
    assert replay["rewards"].shape == replay["continues"].shape
    assert len(replay["observations"]) == 11 * len(replay["rewards"]) > 0

    steps = [json.loads(row)["step"] for row in (folder / "metrics.jsonl").read_text().splitlines()]
    assert steps == sorted(set(steps))
    assert steps[-1] <= outcome["counters"]["step"]
    assert (folder / "checkpoint.safetensors").stat().st_size < 5_000_000
    model = onnx.load(str(folder / "policy.onnx"))
    onnx.checker.check_model(model)
    assert [output.name for output in model.graph.output] == ["action", "mean", "log_std"]

    card = subprocess.run(
        [str(binary()), "expert", "card", str(folder), "--episodes", "2", "--json"],
        check=True,
        capture_output=True,
        text=True,
        timeout=30,
    )
    card = json.loads(card.stdout)
    assert card == json.loads((folder / "card.json").read_text())
    assert card["curve"]
    assert card["resumed"] == 1

    drawing = [str(binary()), "expert", "plot", str(folder), "--out", str(tmp_path / "curve")]
    subprocess.run(drawing, check=True, capture_output=True, timeout=30)
    assert "return of the mean action" in (tmp_path / "curve.svg").read_text()
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
    drawing[3] = str(folder / "expert.json")
    refused = subprocess.run(drawing, capture_output=True, text=True, check=False, timeout=30)
    assert refused.returncode == 1
    assert "expert.json is no model card" in refused.stderr
    assert card["onnx"]["bytes"] == (folder / "policy.onnx").stat().st_size

    # A folder that begins from the checkpoint has the best policy too, unless otherwise chosen.
    changes: list[tuple[list[str], bool]] = [
        ([], True),
        (["--set", "episodes=2"], False),
        (["--set", "reward_cap=2"], False),
    ]
    for number, (more, is_kept) in enumerate(changes):
        begun = tmp_path / f"begun-{number}"
        beginning = [*line, *more, "--from", str(folder / "checkpoint.safetensors")]
        beginning[beginning.index("--out") + 1] = str(begun)
        process = subprocess.Popen(beginning, stdout=subprocess.DEVNULL)
        wait_for(begun / "policy.onnx", process)
        process.kill()
        process.wait()
        same = (begun / "policy.onnx").read_bytes() == (folder / "policy.onnx").read_bytes()
        assert same == is_kept

    other = subprocess.run(
        [*line, "--resume", "--set", "discount=0.9"],
        capture_output=True,
        text=True,
        check=False,
        timeout=20,
    )
    assert "is of a run with other settings" in other.stderr


def test_a_resumed_run_learns_by_its_new_settings(tmp_path: Path) -> None:
    recipe = reference.Recipe("hopper", "sac", 0, 4, 0, 80, 32, 24, 25, 5)
    folder = tmp_path / "run"
    line = command(recipe, folder, 400)
    subprocess.run(line, check=True, capture_output=True, timeout=50)
    before = safetensors.load_file(folder / "checkpoint.safetensors")
    more = ["--resume", "--set", "steps=800", "--set", "learning_rate=1e-9"]
    resumed = [*line, *more]
    outcome = subprocess.run(resumed, check=True, capture_output=True, text=True, timeout=50)
    assert json.loads(outcome.stdout)["counters"]["step"] == 800
    after = safetensors.load_file(folder / "checkpoint.safetensors")
    for name in ("actor", "critic_1", "critic_2", "temperature"):
        moved = np.abs(after[f"{name}.parameters"] - before[f"{name}.parameters"]).max()
        moment = f"{name}.adam.first_moment"
        assert moved < 1e-6, name
        assert np.abs(after[moment] - before[moment]).max() > 0, name

    # The card says when it changed, and what began the run.
    measuring = [str(binary()), "expert", "card", str(folder), "--episodes", "1", "--json"]
    measured = subprocess.run(measuring, check=True, capture_output=True, text=True, timeout=30)
    card = json.loads(measured.stdout)
    assert card["changes"] == [
        {"step": 400, "name": "learning_rate", "before": 3e-4, "after": 1e-9}
    ]
    assert "learning_rate" not in card["command"]
    assert expert_cards.made_by(card).endswith("`; from 400 on `learning_rate=1e-09`")


def wait_for(path: Path, process: "subprocess.Popen[bytes]") -> None:
    """Until the file is there and has something in it."""
    deadline = time.monotonic() + 30
    while not (path.exists() and path.stat().st_size):
        assert process.poll() is None, "ended early"
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--env", "hoper"], "hopper"),
        (["--env", "hopper", "--set", "batch=0"], "batch is 0; expected at least 1"),
        (["--env", "hopper", "--set", "bach=1"], "there is no setting `bach`"),
        (["--env", "hopper", "--critic", "ddpg"], "ddpg"),
        (["--env", "hopper", "--set", "batch=many"], "batch: invalid type: string"),
        (["--env", "ant", "--set", "perturbation=-1"], "perturbation is -1; expected"),
        (["--env", "ant", "--set", "perturbation=1e300"], "expected a number from 0 to 10"),
        (["--env", "ant", "--set", "reward_cap=1e300"], "reward_cap is 1000"),
        (["--env", "ant", "--set", "healthy_z_range=[1,0.5]"], "expected the lower height first"),
        (["--env", "ant", "--set", "healthy_z_range=0.5"], "healthy_z_range: invalid type"),
        (
            ["--env", "ant", "--set", "perturbation_duration=0.5"],
            "is 0.5; expected at least 1 step",
        ),
        (["--env", "hopper", "--set", "dropped_quantiles=25"], "fewer than the 25 quantiles"),
        (["--env", "hopper", "--from", "/nowhere"], "there is no such checkpoint"),
    ],
)
def test_wrong_settings_are_named(arguments: list[str], complaint: str, tmp_path: Path) -> None:
    line = [str(binary()), "expert", "train", "--out", str(tmp_path / "run"), *arguments]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=20)
    assert done.returncode in (1, 64)
    assert complaint in done.stderr
    assert not (tmp_path / "run" / "expert.json").exists()
