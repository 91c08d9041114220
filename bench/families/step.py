"""`step.<task>.<n>.*`: environment steps per second."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from bench.plan import Contender, ContenderError, Figure, Group, Settings, ratio
from bench.processes import listening, measured, python

_TASKS = ("hopper", "walker2d", "halfcheetah", "ant")
# What an agent sees of lane: features of pictures, in a stack.
_SEEING_TASK = "lane-w3"
_NUM_ENVS = (1, 8, 64, 512)
_PEERS_AT = 64
_UNIT = "environment steps/s"
_SEED = 0
# Sessions side by side and environments in each.
_SESSIONS = (8, 256)
_ENVS_OF_A_SESSION = 16
# AsyncVectorEnv is slower by an order of magnitude; a part of the same episodes is enough.
_ASYNC_PART = 5


@dataclass(frozen=True)
class Work:
    """What every contender of a group is given."""

    task: str
    num_envs: int
    steps: int

    @property
    def arguments(self) -> list[str]:
        """For the command line of any contender."""
        warm_up = max(20, self.steps // 10)
        return [
            f"--task={self.task}",
            f"--num-envs={self.num_envs}",
            f"--seed={_SEED}",
            f"--warm-up={warm_up}",
            f"--steps={self.steps}",
        ]

    def part(self, divisor: int) -> "Work":
        """The same with fewer steps."""
        return Work(self.task, self.num_envs, math.ceil(self.steps / divisor))


class SameWork:
    """Sees to it that all contenders walk through the same episodes.

    They step the same environments with the same actions, so they must come to the same number of
    steps that did not only reset.
    """

    def __init__(self) -> None:
        """Nothing seen yet."""
        self._env_steps: int | None = None

    def rate(self, command: Sequence[str]) -> float:
        """Runs a contender."""
        result = measured(command)
        env_steps = result["env_steps"]
        self._env_steps = self._env_steps or env_steps
        if env_steps != self._env_steps:
            raise ContenderError(
                f"`{' '.join(command)}` took {env_steps} steps, others {self._env_steps}: not the "
                "same episodes"
            )
        return result["rate"]


def limit_command(settings: Settings, work: Work) -> list[str]:
    """Bare physics."""
    binary = str(settings.binaries / "bench-limit")
    return [binary, f"--threads={settings.threads}", *work.arguments]


def seeing_limit_command(settings: Settings, work: Work) -> list[str]:
    """Bare physics, drawing and features."""
    binary = str(settings.binaries / "bench-see-limit")
    return [binary, "step", f"--threads={settings.threads}", *work.arguments]


def rust_command(settings: Settings, work: Work, server: str) -> list[str]:
    """Our Rust client."""
    binary = str(settings.binaries / "bench-rust-client")
    return [binary, f"--server={server}", *work.arguments]


def in_process_command(settings: Settings, work: Work) -> list[str]:
    """Our environments without a server."""
    binary = str(settings.binaries / "bench-in-process")
    return [binary, f"--threads={settings.threads}", *work.arguments]


def server_command(settings: Settings) -> list[str]:
    """Our server; `listening` names its socket."""
    binary = str(settings.binaries / "palr-gym")
    return [binary, "serve", "--listen=127.0.0.1:0", "--json", f"--threads={settings.threads}"]


def calibrated(settings: Settings, task: str, num_envs: int) -> Work:
    """As much work as keeps the limit busy for `settings.seconds`."""
    probe = Work(task, num_envs, max(20, 8000 // num_envs))
    rate = measured(limit_command(settings, probe))["rate"]
    return Work(task, num_envs, max(20, round(rate * settings.seconds / num_envs)))


def _prepare(settings: Settings, *, task: str, num_envs: int) -> Mapping[str, Contender]:
    work = calibrated(settings, task, num_envs)
    same = SameWork()

    def limit() -> float:
        return same.rate(limit_command(settings, work))

    def in_process() -> float:
        return same.rate(in_process_command(settings, work))

    def rust() -> float:
        with listening(*server_command(settings)) as server:
            return same.rate(rust_command(settings, work, server))

    def python_client() -> float:
        with listening(*server_command(settings)) as server:
            arguments = [f"--server={server}", *work.arguments]
            return same.rate(python(settings, "python_client", *arguments))

    def envpool() -> float:
        # Its random numbers are its own, and so are its episodes.
        arguments = [f"--threads={settings.threads}", *work.arguments]
        return measured(python(settings, "envpool_peer", *arguments))["rate"]

    def gymnasium_async() -> float:
        arguments = work.part(_ASYNC_PART).arguments
        return measured(python(settings, "gymnasium_async_peer", *arguments))["rate"]

    return {
        "limit": limit,
        "in_process": in_process,
        "rust": rust,
        "python": python_client,
        "envpool": envpool,
        "gymnasium_async": gymnasium_async,
    }


def _figures(task: str, num_envs: int) -> list[Figure]:
    pairs = [("in_process", "limit"), ("rust", "limit"), ("python", "limit")]
    if num_envs == _PEERS_AT:
        pairs += [("python", "envpool"), ("python", "gymnasium_async")]
    return [
        ratio(
            f"step.{task}.{num_envs}.{ours}_vs_{reference}",
            ours,
            reference,
            unit=_UNIT,
            kind="throughput",
            by_default=num_envs == _PEERS_AT or task == "hopper",
        )
        for ours, reference in pairs
    ]


def _prepare_seeing(settings: Settings) -> Mapping[str, Contender]:
    probe = Work(_SEEING_TASK, _PEERS_AT, 20)
    rate = measured(seeing_limit_command(settings, probe))["rate"]
    work = Work(_SEEING_TASK, _PEERS_AT, max(20, round(rate * settings.seconds / _PEERS_AT)))
    same = SameWork()

    def limit() -> float:
        return same.rate(seeing_limit_command(settings, work))

    def rust() -> float:
        with listening(*server_command(settings)) as server:
            return same.rate(rust_command(settings, work, server))

    return {"limit": limit, "rust": rust}


def _prepare_sessions(settings: Settings) -> Mapping[str, Contender]:
    task, num_envs = "hopper", _ENVS_OF_A_SESSION

    def with_sessions(count: int) -> float:
        total = calibrated(settings, task, num_envs * count)
        work = Work(task, num_envs, total.steps)
        with listening(*server_command(settings)) as server:
            command = [*rust_command(settings, work, server), f"--sessions={count}"]
            return measured(command)["rate"]

    return {str(count): partial(with_sessions, count) for count in _SESSIONS}


def _prepare_sizes(settings: Settings) -> Mapping[str, Contender]:
    def with_size(num_envs: int) -> float:
        work = calibrated(settings, "hopper", num_envs)
        with listening(*server_command(settings)) as server:
            return measured(rust_command(settings, work, server))["rate"]

    return {str(size): partial(with_size, size) for size in (64, 4096)}


def groups() -> list[Group]:
    """All tasks in all sizes; then what many environments, or many sessions, cost each one."""
    few, many = _SESSIONS
    sizes = ratio("step.hopper.4096_vs_64", "4096", "64", unit=_UNIT, kind="throughput")
    sessions = ratio(
        f"step.hopper.{many}_sessions_vs_{few}", str(many), str(few), unit=_UNIT, kind="throughput"
    )
    seeing = ratio("step.lane.64.rust_vs_limit", "rust", "limit", unit=_UNIT, kind="throughput")
    return [
        Group([seeing], _prepare_seeing),
        *(
            Group(_figures(task, num_envs), partial(_prepare, task=task, num_envs=num_envs))
            for task in _TASKS
            for num_envs in _NUM_ENVS
        ),
        Group([sizes], _prepare_sizes),
        Group([sessions], _prepare_sessions),
    ]
