"""Keeps what imitation experiments came to, and writes their tables.

    .venv/bin/python scripts/imitation_results.py add NAME FOLDER...
    .venv/bin/python scripts/imitation_results.py

The first sums up the runs below the folders, which take the places of those of the same settings
and seeds; both write the tables in docs anew. The results are in docs/imitation.json; the tables
stand between markers in docs/*.md.
"""

import argparse
import json
import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from documents import with_part

DOCS = Path(__file__).resolve().parent.parent / "docs"
RESULTS = DOCS / "imitation.json"
JUDGED = 0.5
"""The last evaluations of a run, as a share, whose mean is its score. The paper takes 50."""

PAPER = {
    ("hopper-w2", "bc"): (32.47, 2.85),
    ("hopper-w2", "palr"): (42.01, 2.44),
    ("walker2d-w2", "bc"): (53.04, 2.69),
    ("walker2d-w2", "palr"): (79.83, 2.29),
}
"""Scores of Table 1, as Table 11 prints them, with standard errors: 500 000 steps, 5 seeds."""

Run = dict[str, Any]


def summed_up(folder: Path) -> Run:
    """What the run in `folder` came to."""
    manifest = json.loads((folder / "run.json").read_text())
    settings = manifest["settings"]
    evaluations = _lines(folder / "evaluations.jsonl")
    metrics = _lines(folder / "metrics.jsonl")
    if not evaluations or metrics[-1]["step"] != settings["steps"]:
        raise SystemExit(f"{folder} has not ended, or was not evaluated")
    reports = metrics[-math.ceil(len(metrics) / 4) :]
    last = evaluations[-max(1, round(JUDGED * len(evaluations))) :]
    algorithm = settings["algorithm"]
    is_palr = "palr" in algorithm
    return {
        "env": settings["env"],
        "algorithm": algorithm,
        "alpha": settings["palr"]["alpha"] if is_palr else None,
        "weights": settings["palr"]["weights"] if is_palr else None,
        "seed": settings["seed"],
        "batch_seed": settings["batch_seed"],
        "steps": settings["steps"],
        "training_rows": settings["training_rows"],
        "data_sha256": manifest["data"]["sha256"],
        "git_revision": manifest["versions"]["git_revision"],
        "evaluations": len(last),
        "episodes": last[-1]["episodes"],
        "score": statistics.fmean(evaluation["score_mean"] for evaluation in last),
        "best_score": max(evaluation["score_mean"] for evaluation in evaluations),
        "held_out_nll": metrics[-1]["held_out_nll"],
        # As `--alpha auto` judges.
        "held_out_change_nll": statistics.fmean(
            report["held_out_change_nll"] for report in reports
        ),
        "held_out_hscic": metrics[-1]["held_out_hscic"],
        "held_out_action_hscic": metrics[-1]["held_out_action_hscic"],
    }


def _lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def results() -> dict[str, list[Run]]:
    """All experiments by their names."""
    return json.loads(RESULTS.read_text()) if RESULTS.exists() else {}


def _settings(run: Run) -> tuple[Any, ...]:
    alpha = -1.0 if run["alpha"] is None else run["alpha"]
    weights = run["weights"] or ""
    return (run["env"], run["algorithm"], alpha, weights, run["steps"], run["seed"])


def merged(old: Iterable[Run], new: Iterable[Run]) -> list[Run]:
    """Both, in the order of their settings; of the same settings and seed, the new one."""
    runs = {_settings(run): run for run in [*old, *new]}
    return [runs[settings] for settings in sorted(runs)]


def _grouped(runs: Iterable[Run], key: Callable[[Run], Any]) -> dict[Any, list[Run]]:
    groups: dict[Any, list[Run]] = {}
    for run in runs:
        groups.setdefault(key(run), []).append(run)
    return groups


def mean_and_error(values: Sequence[float]) -> tuple[float, float]:
    """Mean and its standard error over seeds."""
    return statistics.fmean(values), statistics.stdev(values) / len(values) ** 0.5


def _score(runs: Sequence[Run]) -> str:
    mean, error = mean_and_error([run["score"] for run in runs])
    return f"{mean:.1f} ± {error:.1f}"


def _mean(runs: Sequence[Run], name: str, form: str) -> str:
    return format(statistics.fmean(run[name] for run in runs), form)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def beside_the_paper(runs: Sequence[Run]) -> str:
    """BC and PALR of each environment beside the paper's numbers."""
    head = [
        "setting",
        "method",
        "score here",
        "paper",
        "likelihood",
        "leakage of the representation",
        "of the action",
    ]
    rows: list[list[str]] = []
    for (env, algorithm), group in _grouped(runs, lambda r: (r["env"], r["algorithm"])).items():
        mean, error = PAPER[env, algorithm]
        alpha = group[0]["alpha"]
        rows.append(
            [
                f"`{env}`",
                "BC" if alpha is None else f"PALR, alpha = {alpha:g}",
                f"**{_score(group)}**",
                f"{mean:.1f} ± {error:.1f}",
                format(-statistics.fmean(run["held_out_nll"] for run in group), ".2f"),
                _mean(group, "held_out_hscic", ".2e"),
                _mean(group, "held_out_action_hscic", ".2e"),
            ]
        )
    return _table(head, rows)


def by_alpha(runs: Sequence[Run]) -> str:
    """A row for each alpha; what the rule of `--alpha auto` takes is marked."""
    head = ["alpha", "score", "change_nll", "leakage of the representation"]
    groups = _grouped(runs, lambda run: run["alpha"])
    nll = {
        alpha: statistics.fmean(run["held_out_change_nll"] for run in group)
        for alpha, group in groups.items()
    }
    chosen = min(sorted(nll, reverse=True), key=lambda alpha: nll[alpha])
    rows = [
        [
            f"**{alpha:g}, chosen**" if alpha == chosen else f"{alpha:g}",
            _score(group),
            f"{nll[alpha]:.3f}",
            _mean(group, "held_out_hscic", ".2e"),
        ]
        for alpha, group in sorted(groups.items())
    ]
    return _table(head, rows)


def by_weights(runs: Sequence[Run]) -> str:
    """`exact` beside `pool`."""
    head = ["setting", "M", "score of each seed", "mean", "leakage of the representation"]
    rows = [
        [
            f"`{env}`, {steps} steps",
            weights,
            ", ".join(f"{run['score']:.1f}" for run in group),
            _score(group),
            _mean(group, "held_out_hscic", ".2e"),
        ]
        for (env, weights, steps), group in _grouped(
            runs, lambda run: (run["env"], run["weights"], run["steps"])
        ).items()
    ]
    return _table(head, rows)


TABLES: dict[str, tuple[str, str, Callable[[Sequence[Run]], str]]] = {
    "paper": ("imitation.md", "paper", beside_the_paper),
    "weights": ("imitation.md", "weights", by_weights),
    "alpha-toy": ("alpha.md", "alpha-toy", by_alpha),
    "alpha-hopper": ("alpha.md", "alpha-hopper", by_alpha),
}
"""Of each experiment: its document, its marker, its table."""


def with_tables(document: str, text: str) -> str:
    """`text`, of the file `document` in docs, with its tables anew."""
    for name, runs in results().items():
        file, marker, table = TABLES[name]
        if file == document:
            text = with_part(text, marker, table(runs))
    return text


def main() -> None:
    """Adds an experiment, or writes the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command")
    add = commands.add_parser("add", help="sum up runs as an experiment")
    add.add_argument("name", choices=sorted(TABLES))
    add.add_argument("folders", nargs="+", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "add":
        folders = sorted(
            {path.parent for top in arguments.folders for path in top.rglob("run.json")}
        )
        if not folders:
            raise SystemExit(f"no run in or below {', '.join(map(str, arguments.folders))}")
        all_results = results()
        runs = merged(all_results.get(arguments.name, []), map(summed_up, folders))
        all_results[arguments.name] = runs
        RESULTS.write_text(json.dumps(all_results, indent=1) + "\n")
    for document in sorted({file for file, _, _ in TABLES.values()}):
        path = DOCS / document
        path.write_text(with_tables(document, path.read_text()))


if __name__ == "__main__":
    main()
