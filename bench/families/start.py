"""`start.healthy_ms`: from exec to the first SERVING."""

import tempfile
from collections.abc import Mapping
from operator import itemgetter
from pathlib import Path

from bench.plan import Contender, Figure, Group, Settings
from bench.processes import measured

_REPEATS = 20


def _prepare(settings: Settings) -> Mapping[str, Contender]:
    def start() -> float:
        with tempfile.TemporaryDirectory(prefix="palr-bench-") as folder:
            socket = Path(folder) / "server.sock"
            binaries = settings.binaries
            command = [f"--binary={binaries / 'palr-gym'}", f"--unix={socket}"]
            return measured([str(binaries / "bench-start"), *command])["healthy_ms"]

    return {"server": start}


def groups() -> list[Group]:
    """The one figure."""
    figure = Figure(
        name="start.healthy_ms",
        kind="absolute",
        better="lower",
        unit="ms",
        needs=("server",),
        ours=itemgetter("server"),
    )
    return [Group([figure], _prepare, repeats=_REPEATS)]
