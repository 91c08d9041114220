"""Measures palr-gym against its references and publishes what came out.

    python -m bench.run [--only PREFIX]     measure; write bench/results.json and README's tables
    python -m bench.run --list              the names that can be measured
    python -m bench.run --readme-only       only the tables

`make bench` builds what this needs. bench/README.md says what is compared and why that is fair.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from bench.families import groups
from bench.machine import Neighbours, cores, processor
from bench.plan import ROOT, ContenderError, Figure, Group, Settings
from bench.report import START_MARKER, Circumstances, Entry, as_json, entry, merged, with_tables

# A kernel's own housekeeping stays below this.
_TOO_MUCH = 0.05

RESULTS = ROOT / "bench" / "results.json"
README = ROOT / "README.md"


def say(text: str) -> None:
    """A line of progress."""
    print(f"bench: {text}", file=sys.stderr, flush=True)


def chosen(every: Sequence[Group], only: str | None) -> list[Group]:
    """The groups that have figures to measure, with those figures only."""

    def is_wanted(figure: Figure) -> bool:
        return figure.by_default if only is None else figure.name.startswith(only)

    trimmed = [
        Group(
            [figure for figure in group.figures if is_wanted(figure)], group.prepare, group.repeats
        )
        for group in every
    ]
    return [group for group in trimmed if group.figures]


def measure_group(
    group: Group, settings: Settings, circumstances: Circumstances
) -> tuple[list[Entry], list[str]]:
    """Measures the contenders of a group in turn, again and again.

    Returns:
        The figures, and the names of those that could not be had.
    """
    names = [figure.name for figure in group.figures]
    say(f"{', '.join(names)}")
    try:
        contenders = group.prepare(settings)
    except ContenderError as error:
        say(f"FAILED: {error}")
        return [], names
    needed = {key for figure in group.figures for key in figure.needs}
    turns = {key: contender for key, contender in contenders.items() if key in needed}
    failed: set[str] = set()
    rounds: list[dict[str, float]] = []
    repeats = group.repeats or settings.repeats
    for repeat in range(repeats):
        measured: dict[str, float] = {}
        neighbours = Neighbours()
        for key in [key for key in turns if key not in failed]:
            try:
                measured[key] = turns[key]()
            except ContenderError as error:
                say(f"FAILED: {key} cannot be measured, its figures are left out: {error}")
                failed.add(key)
        rounds.append(measured)
        results = ", ".join(f"{key} {number:.5g}" for key, number in measured.items())
        say(f"  {repeat + 1}/{repeats}: {results}{_noise(neighbours)}")
    entries = [
        entry(
            figure.name,
            kind=figure.kind,
            better=figure.better,
            unit=figure.unit,
            repeats=[figure.compare(measured) for measured in rounds],
            circumstances=circumstances,
        )
        for figure in group.figures
        if failed.isdisjoint(figure.needs)
    ]
    for result in entries:
        number = result.get("ratio", result.get("value"))
        say(f"  {result['name']} = {number} (all repeats: {result['spread']})")
    measured_names = {result["name"] for result in entries}
    return entries, [name for name in names if name not in measured_names]


def _noise(neighbours: Neighbours) -> str:
    """What a line of progress says about other programs."""
    share = neighbours.share()
    if share is None or share < _TOO_MUCH:
        return ""
    return f" NOISY: others used {share:.0%} of the machine; close them and measure again"


def load_results() -> list[Entry]:
    """What results.json holds."""
    return json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else []


def save(path: Path, text: str) -> None:
    """Replaces a file in one go."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


def publish_tables() -> None:
    """Writes the README's tables anew, if it has a place for them."""
    if not README.exists() or START_MARKER not in (text := README.read_text(encoding="utf-8")):
        say(f"{README.name} has no {START_MARKER}: no tables written")
        return
    save(README, with_tables(text, load_results()))


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="bench.run", description="Measures palr-gym against its references."
    )
    parser.add_argument("--only", metavar="PREFIX", help="every figure whose name begins so")
    parser.add_argument("--repeats", type=int, default=5, help="default: %(default)s")
    parser.add_argument(
        "--seconds", type=float, default=2.5, help="of one measurement; default: %(default)s"
    )
    parser.add_argument("--threads", type=int, default=cores(), help="default: one a core")
    parser.add_argument("--binaries", type=Path, default=ROOT / "target" / "release")
    parser.add_argument("--python", type=Path, default=ROOT / ".venv-bench" / "bin" / "python")
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    parser.add_argument("--dry-run", action="store_true", help="measure, but write nothing")
    parser.add_argument("--readme-only", action="store_true", help="only write the tables")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code: 1 if a figure could not be had, 64 if none fits."""
    options = parse(arguments)
    if options.readme_only:
        publish_tables()
        return 0
    wanted = chosen(groups(), options.only)
    if options.list:
        for name in (figure.name for group in wanted for figure in group.figures):
            print(name)
        return 0
    if not wanted:
        say(
            f"no figure begins with {options.only!r}; --list shows all that are measured by default"
        )
        return 64
    settings = Settings(
        seconds=options.seconds,
        repeats=options.repeats,
        threads=options.threads,
        binaries=options.binaries.absolute(),
        # Not resolved: a virtual environment is known by the path of its interpreter's link.
        python=options.python.absolute(),
    )
    circumstances = Circumstances(datetime.now(UTC).date().isoformat(), processor())
    say(f"{circumstances.processor}, load {os.getloadavg()[0]:.2f}, {settings.threads} threads")
    started = time.monotonic()
    missing: list[str] = []
    for group in wanted:
        entries, left_out = measure_group(group, settings, circumstances)
        missing += left_out
        if not options.dry_run:
            # After each group: an interrupted run keeps what it has.
            save(RESULTS, as_json(merged(load_results(), entries)))
    if not options.dry_run:
        publish_tables()
    say(f"done in {time.monotonic() - started:.0f} s")
    if missing:
        say(f"LEFT OUT (an older figure, if any, still stands): {', '.join(missing)}")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
