"""`sac.updates_vs_sb3`: updates of soft actor-critic a second, against Stable-Baselines3."""

from collections.abc import Mapping

from bench.plan import Contender, Group, Settings, ratio
from bench.processes import measured, python

# What an update costs here, roughly: how many fit into a measurement.
_SECONDS = {"ours": 0.006, "sb3": 0.012}


def _prepare(settings: Settings) -> Mapping[str, Contender]:
    def updates(contender: str) -> str:
        return f"--updates={max(20, round(settings.seconds / _SECONDS[contender]))}"

    def sb3() -> float:
        return measured(python(settings, "sac_peer", updates("sb3")))["rate"]

    def ours() -> float:
        return measured([str(settings.binaries / "bench-sac"), updates("ours")])["rate"]

    return {"sb3": sb3, "ours": ours}


def groups() -> list[Group]:
    """One figure."""
    figure = ratio("sac.updates_vs_sb3", "ours", "sb3", unit="updates/s", kind="throughput")
    return [Group([figure], _prepare)]
