"""Sums up runs on the lane scene: docs/lane.json, and the table in docs/lane.md.

.venv/bin/python scripts/lane_table.py FOLDER...    reads finished runs below the folders
.venv/bin/python scripts/lane_table.py              writes the table anew from docs/lane.json

docs/lane.md says which commands make the runs.
"""

import json
import statistics
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from documents import with_part

DOCS = Path(__file__).resolve().parent.parent / "docs"
# scipy is not among what this project's scripts need: Student's t, 97.5 %, by degrees of freedom.
_T = {1: 12.71, 2: 4.303, 3: 3.182, 4: 2.776, 5: 2.571, 7: 2.365, 9: 2.262}
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


def with_table(page: str, runs: Iterable[dict[str, Any]]) -> str:
    """`page` with a new table between its markers."""
    return with_part(page, "runs", table(runs))


def _last(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text().splitlines()[-1])


def _row(env_id: str, algorithm: str, alpha: float, runs: list[dict[str, Any]]) -> str:
    def mean(name: str) -> float:
        return statistics.fmean(one[name] for one in runs)

    scores = [one["score_mean"] for one in runs]
    spread = ""
    if len(scores) > 1:
        half = _T[len(scores) - 1] * statistics.stdev(scores) / len(scores) ** 0.5
        spread = f" ± {half:.1f}"
    stack = env_id.removesuffix("-v0").rpartition("-w")[2]
    cells = [
        algorithm.upper(),
        stack if stack.isdigit() else "1",
        f"{alpha:g}" if alpha else "",
        str(len(runs)),
        f"{mean('score_mean'):.1f}{spread}",
        f"{mean('length_mean'):.0f}",
        f"{mean('held_out_nll'):.2f}",
        f"{mean('held_out_change_nll'):.2f}",
        f"{mean('held_out_action_hscic'):.4f}",
        f"{mean('held_out_hscic'):.4f}",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Writes data and table."""
    data, page = DOCS / "lane.json", DOCS / "lane.md"
    if len(sys.argv) > 1:
        manifests = (path for root in sys.argv[1:] for path in Path(root).rglob("run.json"))
        folders = sorted(path.parent for path in manifests)
        if not folders:
            raise SystemExit(f"no run in or below {', '.join(sys.argv[1:])}")
        data.write_text(json.dumps([run(folder) for folder in folders], indent=1) + "\n")
    page.write_text(with_table(page.read_text(), json.loads(data.read_text())))


if __name__ == "__main__":
    main()
