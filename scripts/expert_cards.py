"""Writes the table of experts in scenes/experts/README.md from their model cards.

.venv/bin/python scripts/expert_cards.py
"""

import json
from pathlib import Path
from typing import Any

from documents import with_part

EXPERTS = Path(__file__).resolve().parent.parent / "scenes" / "experts"

_HEAD = [
    *("expert", "mean action", "sampled", "imitators", "made by"),
    *("transitions, updates, hours", "sha256 of the ONNX"),
]


def cards() -> dict[str, dict[str, Any]]:
    """What `palr-gym expert card` wrote, by task."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(EXPERTS.glob("*.json"))}


def table() -> str:
    """All cards as Markdown."""
    head = [f"| {' | '.join(_HEAD)} |", f"|{'---|' * len(_HEAD)}"]
    return "\n".join([*head, *(row(task, card) for task, card in cards().items())])


def with_table(readme: str) -> str:
    """`readme` with a new table between its markers."""
    return with_part(readme, "cards", table())


def row(task: str, card: dict[str, Any]) -> str:
    """One card as a line of the table."""
    hours = card["wall_time_s"] / 3600
    cells = [
        f"`{task}`",
        _measured(card["deterministic"]),
        _measured(card["sampled"]),
        _fitness(card["fitness"]),
        made_by(card),
        f"{_spaced(card['steps'])}, {_spaced(card['updates'])}, {hours:.1f}",
        f"`{card['onnx']['sha256']}`",
    ]
    return f"| {' | '.join(cells)} |"


def made_by(card: dict[str, Any]) -> str:
    """What began the run, and what was changed on the way."""
    stages: dict[int, list[str]] = {}
    for change in card.get("changes", []):
        value = change["after"]
        text = value if isinstance(value, str) else json.dumps(value)
        stages.setdefault(change["step"], []).append(f"`{change['name']}={text}`")
    later = (f"from {_spaced(step)} on {', '.join(said)}" for step, said in stages.items())
    return "; ".join([f"`{card['command']}`", *later])


def _fitness(fitness: dict[str, Any] | None) -> str:
    if fitness is None:
        return "not tried"
    share = f"{100 * fitness['share_of_expert']:.0f}"
    if (error := fitness.get("share_standard_error")) is not None:
        share += f" ± {100 * error:.0f}"
    return f"{share} %, {_spaced(fitness['steps'])} steps"


def _spaced(count: int) -> str:
    # Spaces between thousands, which no locale takes for a decimal point.
    return f"{count:,}".replace(",", " ")


def _measured(measured: dict[str, Any]) -> str:
    return (
        f"{measured['return_mean']:.1f} ± {measured['return_standard_error']:.1f}, score "
        f"**{measured['score_mean']:.1f}**"
    )


if __name__ == "__main__":
    path = EXPERTS / "README.md"
    path.write_text(with_table(path.read_text()))
