"""`latency.*`: round trips of a single environment."""

from collections.abc import Mapping
from operator import itemgetter

from bench.families.step import (
    calibrated,
    limit_command,
    rust_command,
    server_command,
)
from bench.plan import Contender, Figure, Group, Settings, ratio
from bench.processes import listening, measured, python

_TASK = "hopper"
_UNIT = "round trips/s"
# remote-gym is slower by an order of magnitude; a part of the same episodes is enough.
_REMOTE_GYM_PART = 10


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


def _prepare_python(settings: Settings) -> Mapping[str, Contender]:
    work = calibrated(settings, _TASK, 1)
    part = work.part(_REMOTE_GYM_PART)

    def python_client() -> float:
        with listening(*server_command(settings)) as server:
            command = python(settings, "python_client", f"--server={server}", *work.arguments)
            return work.steps / measured(command)["wall_s"]

    def remote_gym() -> float:
        command = python(settings, "remote_gym_peer", *part.arguments)
        return part.steps / measured(command)["wall_s"]

    return {"python": python_client, "remote_gym": remote_gym}


def _without_physics(measured: Mapping[str, float]) -> float:
    return 1 / (1 / measured["rust"] - 1 / measured["limit"])


def groups() -> list[Group]:
    """One for each client."""
    rust = Figure(
        name="latency.unix.rust_vs_echo",
        kind="throughput",
        better="higher",
        unit=_UNIT,
        needs=("limit", "rust", "echo"),
        ours=_without_physics,
        reference=itemgetter("echo"),
    )
    python_figure = ratio(
        "latency.unix.python_vs_dm_env_rpc", "python", "remote_gym", unit=_UNIT, kind="throughput"
    )
    return [Group([rust], _prepare), Group([python_figure], _prepare_python)]
