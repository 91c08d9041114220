"""What a figure is made of: contenders that are measured in turn, and comparisons between them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

from bench.report import Better, Comparison, Kind

ROOT = Path(__file__).resolve().parent.parent

Contender = Callable[[], float]
"""Measures once: some seconds of work in a process of its own. Raises `ContenderError`."""


class ContenderError(Exception):
    """A contender could not be measured. Its figures are left out."""


@dataclass(frozen=True)
class Settings:
    """How everything is measured."""

    seconds: float
    """How long one measurement should take, after its warm-up."""
    repeats: int
    threads: int
    """Simulation threads of the server, and of what it is compared with."""
    binaries: Path
    """Folder of the release builds."""
    python: Path
    """Interpreter that has the client and the peers."""


@dataclass(frozen=True)
class Figure:
    """A name in results.json and how its numbers follow from those of the contenders."""

    name: str
    kind: Kind
    better: Better
    unit: str
    needs: tuple[str, ...]
    """The contenders that must be measured."""
    ours: Callable[[Mapping[str, float]], float]
    reference: Callable[[Mapping[str, float]], float] | None = None
    by_default: bool = True
    """Whether it is measured when no name is asked for."""

    def compare(self, measured: Mapping[str, float]) -> Comparison:
        """What one repeat comes to."""
        reference = None if self.reference is None else self.reference(measured)
        return Comparison(self.ours(measured), reference)


def ratio(
    name: str, ours: str, reference: str, *, unit: str, kind: Kind, by_default: bool = True
) -> Figure:
    """The figure that compares one contender with another."""
    return Figure(
        name=name,
        kind=kind,
        better="lower" if kind == "cost" else "higher",
        unit=unit,
        needs=(ours, reference),
        ours=itemgetter(ours),
        reference=itemgetter(reference),
        by_default=by_default,
    )


@dataclass(frozen=True)
class Group:
    """Figures that share contenders, which are measured in turn in each repeat."""

    figures: Sequence[Figure]
    prepare: Callable[[Settings], Mapping[str, Contender]]
    """Readies the contenders and gives them in the order of their turns."""
    repeats: int | None = None
    """None: as many as the settings say."""
