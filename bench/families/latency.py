"""`latency.*`: round trips of a single environment."""

from collections.abc import Mapping
from operator import itemgetter

from bench.families.step import (
    calibrated,
    limit_command,
    rust_command,
    server_command,
)
from bench.plan import Contender, Figure, Group, Settings
from bench.processes import listening, measured

_TASK = "hopper"


def _prepare(settings: Settings) -> Mapping[str, Contender]:
    work = calibrated(settings, _TASK, 1)

    def per_second(command: list[str]) -> float:
        # Round trips, those that only reset included: they travel all the same.
        return work.steps / measured(command)["wall_s"]

    def limit() -> float:
        return per_second(limit_command(settings, work))

    def rust() -> float:
        with listening(*server_command(settings)) as server:
            return per_second(rust_command(settings, work, server))

    def echo() -> float:
        with listening(str(settings.binaries / "bench-echo"), f"--task={_TASK}") as server:
            return per_second(rust_command(settings, work, server))

    return {"limit": limit, "rust": rust, "echo": echo}


def _without_physics(measured: Mapping[str, float]) -> float:
    return 1 / (1 / measured["rust"] - 1 / measured["limit"])


def groups() -> list[Group]:
    """The one figure so far."""
    figure = Figure(
        name="latency.unix.rust_vs_echo",
        kind="throughput",
        better="higher",
        unit="round trips/s",
        needs=("limit", "rust", "echo"),
        ours=_without_physics,
        reference=itemgetter("echo"),
    )
    return [Group([figure], _prepare)]
