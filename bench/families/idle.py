"""`idle.1000.cpu_percent`: what sessions cost that nobody uses."""

import resource
from collections.abc import Mapping
from operator import itemgetter

from bench.families.step import server_command
from bench.plan import Contender, Figure, Group, Settings
from bench.processes import measured, python, started

_SESSIONS = 1000


def _prepare(settings: Settings) -> Mapping[str, Contender]:
    def idle() -> float:
        # Each session has a connection; the server inherits the limit.
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        with started(*server_command(settings)) as (server, pid):
            arguments = [f"--server={server}", f"--pid={pid}", f"--sessions={_SESSIONS}"]
            return measured(python(settings, "idle_sessions", *arguments))["cpu_percent"]

    return {"server": idle}


def groups() -> list[Group]:
    """The one figure."""
    figure = Figure(
        name=f"idle.{_SESSIONS}.cpu_percent",
        kind="absolute",
        better="lower",
        unit="% of a core",
        needs=("server",),
        ours=itemgetter("server"),
    )
    return [Group([figure], _prepare)]
