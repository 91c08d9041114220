"""Sums up runs on the lane scene: docs/lane.json, and the tables in docs/lane.md.

    .venv/bin/python scripts/lane_table.py grid FOLDER...
    .venv/bin/python scripts/lane_table.py replicates FOLDER...
    .venv/bin/python scripts/lane_table.py

The first two read finished runs below the folders: those that share their demonstrations, and those
of which each seed has its own. All write the tables anew.
docs/lane.md says which commands make the runs.
"""

import argparse
import json
import statistics
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from documents import with_part

DOCS = Path(__file__).resolve().parent.parent / "docs"
# scipy is not among what this project's scripts need: Student's t, 97.5 %, by degrees of freedom.
_T = dict(
    enumerate(
        (12.71, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179),
        start=1,
    )
)
_MEASURED = ("held_out_nll", "held_out_change_nll", "held_out_hscic", "held_out_action_hscic")
_HEAD = [
    *("method", "w", "alpha", "seeds", "score", "steps survived of 250"),
    *("held-out NLL", "where actions change", "leakage of actions", "of the representation"),
]


def run(folder: Path) -> dict[str, Any]:
    """What a finished run came to: its last evaluation and its last report."""
    manifest = json.loads((folder / "run.json").read_text())
    settings = manifest["settings"]
    evaluation = _last(folder / "evaluations.jsonl")
    report = _last(folder / "metrics.jsonl")
    algorithm = settings["algorithm"]
    return {
        "env_id": manifest["env_id"],
        "algorithm": algorithm,
        "alpha": settings["palr"]["alpha"] if algorithm == "palr" else None,
        "seed": settings["seed"],
        "steps": settings["steps"],
        "batch": settings["batch"],
        "data_sha256": manifest["data"]["sha256"],
        **{name: evaluation[name] for name in ("episodes", "score_mean", "length_mean")},
        **{name: report[name] for name in _MEASURED},
    }


def table(runs: Iterable[dict[str, Any]]) -> str:
    """A row for each method, stack and alpha: means over seeds, the score with a 95 % interval."""
    rows: dict[tuple[str, str, float], list[dict[str, Any]]] = {}
    for one in runs:
        key = (one["env_id"], one["algorithm"], one["alpha"] or 0.0)
        rows.setdefault(key, []).append(one)
    lines = [f"| {' | '.join(_HEAD)} |", f"|{'---|' * len(_HEAD)}"]
    return "\n".join([*lines, *(_row(*key, rows[key]) for key in sorted(rows))])


def paired(runs: Iterable[dict[str, Any]]) -> str:
    """Scores by method and stack, and their differences within replicates, with 95 % intervals.

    Runs of a replicate have the same seed and the same demonstrations.
    """
    scores: dict[tuple[str, str], dict[tuple[str, int], float]] = {}
    for one in runs:
        replicate = (one["data_sha256"], one["seed"])
        scores.setdefault((one["algorithm"], _stack(one["env_id"])), {})[replicate] = one[
            "score_mean"
        ]

    def values(algorithm: str, stack: str) -> list[float]:
        return [score for _, score in sorted(scores[algorithm, stack].items())]

    def less(values: list[float], others: list[float]) -> list[float]:
        return [value - other for value, other in zip(values, others, strict=True)]

    head = ("method", "replicates", "w = 1", "w = 3", "w = 3 less w = 1")
    rows = {method.upper(): [values(method, "1"), values(method, "3")] for method in ("bc", "palr")}
    rows["PALR less BC"] = [less(*pair) for pair in zip(rows["PALR"], rows["BC"], strict=True)]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for name, (one, three) in rows.items():
        cells = map(_interval, (one, three, less(three, one)))
        lines.append(f"| {' | '.join([name, str(len(one)), *cells])} |")
    return "\n".join(lines)


def with_tables(page: str, runs: dict[str, list[dict[str, Any]]]) -> str:
    """`page` with new tables between its markers."""
    return with_part(
        with_part(page, "runs", table(runs["grid"])), "replicates", paired(runs["replicates"])
    )


def _last(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text().splitlines()[-1])


def _stack(env_id: str) -> str:
    stack = env_id.removesuffix("-v0").rpartition("-w")[2]
    return stack if stack.isdigit() else "1"


def _interval(values: list[float]) -> str:
    """The mean, with a 95 % interval if there are several."""
    spread = ""
    if len(values) > 1:
        half = _T[len(values) - 1] * statistics.stdev(values) / len(values) ** 0.5
        spread = f" ± {half:.1f}"
    return f"{statistics.fmean(values):.1f}{spread}"


def _row(env_id: str, algorithm: str, alpha: float, runs: list[dict[str, Any]]) -> str:
    def mean(name: str) -> float:
        return statistics.fmean(one[name] for one in runs)

    cells = [
        algorithm.upper(),
        _stack(env_id),
        f"{alpha:g}" if alpha else "",
        str(len(runs)),
        _interval([one["score_mean"] for one in runs]),
        f"{mean('length_mean'):.0f}",
        f"{mean('held_out_nll'):.2f}",
        f"{mean('held_out_change_nll'):.2f}",
        f"{mean('held_out_action_hscic'):.4f}",
        f"{mean('held_out_hscic'):.4f}",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Writes data and tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", nargs="?", choices=("grid", "replicates"))
    parser.add_argument("folders", nargs="*", type=Path)
    arguments = parser.parse_args()
    data, page = DOCS / "lane.json", DOCS / "lane.md"
    runs = json.loads(data.read_text())
    if arguments.name is not None:
        manifests = (path for root in arguments.folders for path in root.rglob("run.json"))
        folders = sorted(path.parent for path in manifests)
        if not folders:
            raise SystemExit(
                f"no run in or below {', '.join(map(str, arguments.folders)) or 'nothing'}"
            )
        runs[arguments.name] = [run(folder) for folder in folders]
        data.write_text(json.dumps(runs, indent=1) + "\n")
    page.write_text(with_tables(page.read_text(), runs))


if __name__ == "__main__":
    main()
