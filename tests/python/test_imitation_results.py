"""The tables of imitation experiments in docs are those that their results make."""

import json
from pathlib import Path
from typing import Any

import pytest

import imitation_results
from support.server_process import ROOT


@pytest.mark.parametrize(
    "document", sorted({file for file, _, _ in imitation_results.TABLES.values()})
)
def test_documents_have_the_tables_that_the_results_make(document: str) -> None:
    text = (ROOT / "docs" / document).read_text()
    command = ".venv/bin/python scripts/imitation_results.py"
    assert imitation_results.with_tables(document, text) == text, f"run {command}"


def run_folder(parent: Path, name: str, alpha: float, scores: list[float]) -> Path:
    """A run's folder as far as the script looks into it."""
    folder = parent / name
    folder.mkdir(parents=True)
    settings: dict[str, Any] = {
        "env": "hopper-w2",
        "algorithm": "palr",
        "palr": {"alpha": alpha, "weights": "pool"},
        "seed": 1,
        "batch_seed": 0,
        "steps": 4,
        "training_rows": 10,
    }
    manifest = {
        "settings": settings,
        "data": {"sha256": "ab"},
        "versions": {"git_revision": "cd"},
    }
    (folder / "run.json").write_text(json.dumps(manifest))
    evaluations = [{"score_mean": score, "episodes": 3} for score in scores]
    (folder / "evaluations.jsonl").write_text("\n".join(map(json.dumps, evaluations)))
    metrics = {
        "step": 4,
        "held_out_nll": -alpha,
        "held_out_change_nll": -alpha,
        "held_out_hscic": 0.5,
        "held_out_action_hscic": 0.25,
    }
    (folder / "metrics.jsonl").write_text(json.dumps(metrics))
    return folder


def test_a_score_is_the_mean_of_the_last_half_and_the_likeliest_change_is_chosen(
    tmp_path: Path,
) -> None:
    runs = [
        imitation_results.summed_up(
            run_folder(tmp_path, f"{alpha}-{at}", alpha, [90, 0, scores, scores])
        )
        for alpha, pair in {1.0: (10, 14), 2.0: (20, 24)}.items()
        for at, scores in enumerate(pair)
    ]
    assert [run["score"] for run in runs] == [10, 14, 20, 24]
    assert {run["best_score"] for run in runs} == {90}
    assert imitation_results.by_alpha(runs).splitlines()[2:] == [
        "| 1 | 12.0 ± 2.0 | -1.000 | 5.00e-01 |",
        "| **2, chosen** | 22.0 ± 2.0 | -2.000 | 5.00e-01 |",
    ]
    unfinished = run_folder(tmp_path, "unfinished", 1.0, [])
    with pytest.raises(SystemExit, match="unfinished has not ended"):
        imitation_results.summed_up(unfinished)


def test_new_runs_take_the_places_of_those_with_their_settings_and_seeds(tmp_path: Path) -> None:
    def run(name: str, alpha: float, score: float) -> imitation_results.Run:
        return imitation_results.summed_up(run_folder(tmp_path, name, alpha, [score]))

    old = [run("a", 2.0, 10.0), run("b", 1.0, 20.0)]
    merged = imitation_results.merged(old, [run("c", 2.0, 30.0), run("d", 3.0, 40.0)])
    assert [(run["alpha"], run["score"]) for run in merged] == [
        (1.0, 20.0),
        (2.0, 30.0),
        (3.0, 40.0),
    ]
