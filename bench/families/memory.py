"""`memory.*`: what environments and sessions take of the server's memory."""

from collections.abc import Mapping
from functools import partial
from operator import itemgetter

from bench.families.step import server_command
from bench.plan import Contender, Figure, Group, Settings
from bench.processes import measured, python, started

_TASKS = ("hopper", "walker2d", "halfcheetah", "ant")
_NUM_ENVS = (64, 4096)
_SESSIONS = (8, 256)
# Memory does not depend on what else the machine does.
_REPEATS = 3


def _growth(settings: Settings, what: str, pair: tuple[int, int], *arguments: str) -> float:
    """Bytes that each of the second many takes more than if there were only the first many."""
    sizes: list[float] = []
    for count in pair:
        with started(*server_command(settings)) as (server, pid):
            command = [f"--server={server}", f"--pid={pid}", f"--{what}={count}", *arguments]
            sizes.append(measured(python(settings, "memory_of_sessions", *command))["bytes"])
    return (sizes[1] - sizes[0]) / (pair[1] - pair[0])


def _prepare_task(settings: Settings, *, task: str) -> Mapping[str, Contender]:
    return {"env": lambda: _growth(settings, "num-envs", _NUM_ENVS, f"--task={task}")}


def _prepare_sessions(settings: Settings) -> Mapping[str, Contender]:
    return {"session": lambda: _growth(settings, "sessions", _SESSIONS, "--task=hopper")}


def _figure(name: str, needs: str, unit: str) -> Figure:
    return Figure(
        name=name,
        kind="absolute",
        better="lower",
        unit=unit,
        needs=(needs,),
        ours=itemgetter(needs),
    )


def groups() -> list[Group]:
    """One for each task, and one for sessions."""
    return [
        *(
            Group(
                [_figure(f"memory.{task}.per_env", "env", "bytes per environment")],
                partial(_prepare_task, task=task),
                _REPEATS,
            )
            for task in _TASKS
        ),
        Group(
            [_figure("memory.hopper.per_session", "session", "bytes per session of one")],
            _prepare_sessions,
            _REPEATS,
        ),
    ]
