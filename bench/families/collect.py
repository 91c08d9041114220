"""`collect.hopper.vs_limit`: transitions of the expert a second, into a file."""

import math
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from bench.plan import Contender, Group, Settings, ratio
from bench.processes import measured, ran

_SEED = 0
# What a transition costs on one thread, roughly: how many fit into a measurement.
_SECONDS = 60e-6


def _prepare(settings: Settings) -> Mapping[str, Contender]:
    seconds = max(settings.seconds, 1.0)
    transitions = math.ceil(seconds * settings.threads / _SECONDS)

    def limit() -> float:
        arguments = [f"--threads={settings.threads}", f"--transitions={transitions}"]
        return measured([str(settings.binaries / "bench-collect-limit"), *arguments])["rate"]

    def ours() -> float:
        with TemporaryDirectory(prefix="palr-bench-") as folder:
            out = Path(folder) / "hopper.hdf5"
            command = [str(settings.binaries / "palr-gym"), "collect", "--env=hopper", "--sampled"]
            command += [f"--seed={_SEED}", f"--transitions={transitions}", f"--out={out}"]
            started = time.perf_counter()
            ran(command)
            return transitions / (time.perf_counter() - started)

    return {"limit": limit, "ours": ours}


def groups() -> list[Group]:
    """One figure."""
    figure = ratio(
        "collect.hopper.vs_limit", "ours", "limit", unit="transitions/s", kind="throughput"
    )
    return [Group([figure], _prepare)]
