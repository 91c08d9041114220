"""The machine on which everything is measured, and who else is using it."""

import os
import resource
import time
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
# Ticks are long.
_TELLING_S = 1.0
# Of a line "cpu" in /proc/stat: idle and iowait.
_IDLE = slice(3, 5)
# Guests' time is counted in user's and nice's already.
_COUNTED = 8


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


def processor() -> str:
    """The processor's name and how many of its cores this process may use."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else 'unknown processor'}, {cores()} cores"


class Neighbours:
    """How much of the machine was taken by processes that are not ours."""

    def __init__(self) -> None:
        """Starts to count."""
        self._started = time.monotonic()
        self._busy_s = _busy_s() - _own_s()

    def share(self) -> float | None:
        """Part of all cores' time that others used since the start; None: too soon to tell."""
        elapsed_s = time.monotonic() - self._started
        if elapsed_s < _TELLING_S:
            return None
        others_s = _busy_s() - _own_s() - self._busy_s
        # The kernel counts in ticks: a difference can come out below zero.
        return max(0.0, others_s / (elapsed_s * (os.cpu_count() or 1)))


def _busy_s() -> float:
    """CPU seconds that the whole machine has been busy."""
    first = Path("/proc/stat").read_text(encoding="utf-8").splitlines()[0]
    ticks = [int(number) for number in first.split()[1:]][:_COUNTED]
    return (sum(ticks) - sum(ticks[_IDLE])) / _TICKS_PER_S


def _own_s() -> float:
    """CPU seconds of this process and of all its children that have ended."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)
