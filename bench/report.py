"""Figures as data: from measurements to entries of results.json and tables of the README.

Nothing here measures, reads or writes.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from statistics import median_low
from typing import Literal, NotRequired, TypedDict

Kind = Literal["throughput", "cost", "absolute"]
Better = Literal["higher", "lower"]

START_MARKER = "<!-- bench:start -->"
END_MARKER = "<!-- bench:end -->"

_SIGNIFICANT_DIGITS = 5
_HEADINGS: Mapping[str, str] = {
    "step": "Stepping",
    "latency": "Round trips",
    "start": "Starting",
    "idle": "Idling",
    "memory": "Memory",
    "train": "Training",
    "hours": "The paper's full training, extrapolated",
    "render": "Rendering",
    "features": "Features",
    "sac": "SAC",
    "collect": "Collecting",
}


class Entry(TypedDict):
    """A figure in results.json, in this order."""

    name: str
    kind: Kind
    better: Better
    ours: NotRequired[float]
    reference: NotRequired[float]
    ratio: NotRequired[float]
    """ours / reference. A figure has either these three or a value."""
    value: NotRequired[float]
    unit: str
    """Of ours and reference, or of value."""
    spread: list[float]
    """Smallest and largest ratio (or value) of all repeats."""
    repeats: int
    command: str
    date: str
    processor: str


@dataclass(frozen=True)
class Comparison:
    """What one repeat gave: ours, and what stood against it if anything did."""

    ours: float
    reference: float | None = None

    @property
    def ratio(self) -> float:
        """What the figure is about: ours / reference, or ours alone."""
        return self.ours if self.reference is None else self.ours / self.reference


@dataclass(frozen=True)
class Circumstances:
    """Where and when it was measured."""

    date: str
    processor: str


def entry(
    name: str,
    *,
    kind: Kind,
    better: Better,
    unit: str,
    repeats: Sequence[Comparison],
    circumstances: Circumstances,
) -> Entry:
    """The figure of the repeat whose ratio is the median of all repeats' ratios.

    Ours and its reference are measured one after the other in each repeat, so a machine that is
    slow for a while slows both: their ratio within a repeat is what can be trusted. Of an even
    number of repeats the lower of the two in the middle is taken, so that the published numbers
    always are of one repeat and their quotient is the published ratio.
    """
    ratios = [comparison.ratio for comparison in repeats]
    middle = repeats[ratios.index(median_low(ratios))]
    result = Entry(
        name=name,
        kind=kind,
        better=better,
        unit=unit,
        spread=[_rounded(min(ratios)), _rounded(max(ratios))],
        repeats=len(repeats),
        command=f"make bench ONLY={name}",
        date=circumstances.date,
        processor=circumstances.processor,
    )
    if middle.reference is None:
        result["value"] = _rounded(middle.ours)
    else:
        result["ours"] = _rounded(middle.ours)
        result["reference"] = _rounded(middle.reference)
        result["ratio"] = _rounded(middle.ratio)
    return result


def merged(old: Iterable[Entry], new: Iterable[Entry]) -> list[Entry]:
    """`old` with the entries of `new` in the place of those with the same names, by name."""
    entries = {entry["name"]: entry for entry in old} | {entry["name"]: entry for entry in new}
    return sorted(entries.values(), key=lambda entry: _sort_key(entry["name"]))


def as_json(entries: Iterable[Entry]) -> str:
    """What results.json holds."""
    keys = list(Entry.__annotations__)
    rows = [dict(sorted(row.items(), key=lambda item: keys.index(item[0]))) for row in entries]
    return json.dumps(rows, indent=2) + "\n"


def tables(entries: Iterable[Entry]) -> str:
    """All figures as Markdown, for each first part of a name.

    Figures named `family.task.n.ours_vs_reference` stand in one table, a row for each task and n.
    """
    blocks: list[str] = []
    ordered = sorted(entries, key=lambda entry: _sort_key(entry["name"]))
    for family, members in groupby(ordered, key=lambda entry: entry["name"].split(".")[0]):
        rows = list(members)
        blocks.append(f"**{_HEADINGS.get(family, family)}**")
        by_size = [row for row in rows if _is_by_size(row["name"])]
        others = [row for row in rows if not _is_by_size(row["name"])]
        blocks += [_ratios_by_size(by_size)] if by_size else []
        blocks += [_list(others)] if others else []
    where = sorted({f"{entry['processor']}, {entry['date']}" for entry in ordered})
    blocks.append(f"Measured on: {'; '.join(where) or 'nothing yet'}. `make bench` repeats it.")
    return "\n\n".join(blocks)


def with_tables(readme: str, entries: Iterable[Entry]) -> str:
    """`readme` with new tables between its markers; without both markers, as it is."""
    head, start, rest = readme.partition(START_MARKER)
    _, end, tail = rest.partition(END_MARKER)
    if not start or not end:
        return readme
    return f"{head}{START_MARKER}\n{tables(entries)}\n{END_MARKER}{tail}"


def _list(entries: Iterable[Entry]) -> str:
    head = [
        "| figure | ours | reference | unit | ratio | all repeats |",
        "|---|---:|---:|---|---:|---|",
    ]
    return "\n".join([*head, *map(_row, entries)])


def _is_by_size(name: str) -> bool:
    parts = name.split(".")
    return len(parts) == 4 and parts[2].isdigit() and "_vs_" in parts[3]


def _ratios_by_size(entries: Sequence[Entry]) -> str:
    """Rows: task and size. Columns: who, against whom; with the range of all repeats."""
    pairs = sorted({entry["name"].split(".")[3] for entry in entries}, key=_pair_key)
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for entry in entries:
        _, task, size, pair = entry["name"].split(".")
        low, high = entry["spread"]
        text = f"**{entry.get('ratio', math.nan):.2f}** ({low:.2f} to {high:.2f})"
        cells.setdefault((task, size), {})[pair] = text
    titles = [pair.replace("_vs_", " / ").replace("_", " ") for pair in pairs]
    lines = [f"| | {' | '.join(titles)} |", f"|---|{'---|' * len(pairs)}"]
    for (task, size), row in cells.items():
        lines.append(f"| {task}, {size} | {' | '.join(row.get(pair, '') for pair in pairs)} |")
    return "\n".join(lines)


def _pair_key(pair: str) -> tuple[bool, str]:
    """The limit first."""
    return (not pair.endswith("_vs_limit"), pair)


def _row(entry: Entry) -> str:
    low, high = (_text(bound) for bound in entry["spread"])
    if "ratio" in entry and "ours" in entry and "reference" in entry:
        ours, reference = _text(entry["ours"]), _text(entry["reference"])
        ratio = f"**{_ratio(entry['ratio'])}**"
        low, high = (_ratio(bound) for bound in entry["spread"])
    else:
        ours, reference, ratio = f"**{_text(entry.get('value', math.nan))}**", "", ""
    cells = [f"`{entry['name']}`", ours, reference, entry["unit"], ratio]
    return f"| {' | '.join(cells)} | {low} to {high} |"


def _ratio(number: float) -> str:
    """Two digits after the point; more where two would say little."""
    return f"{number:.2f}" if number >= 0.1 else f"{number:.2g}"


def _text(number: float) -> str:
    """Three significant digits or all digits before the point, whichever is more."""
    if not math.isfinite(number) or number == 0:
        return str(number)
    decimals = max(0, 2 - math.floor(math.log10(abs(number))))
    # Spaces between thousands, which no locale takes for a decimal point.
    return f"{number:,.{decimals}f}".replace(",", " ")


def _rounded(number: float) -> float:
    return float(f"{number:.{_SIGNIFICANT_DIGITS}g}")


def _sort_key(name: str) -> list[tuple[int, str]]:
    """Numbers in a name by their value: step.hopper.8 before step.hopper.64."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in name.split(".")]
