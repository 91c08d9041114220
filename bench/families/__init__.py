"""One module for each first part of a name, and a line here."""

from bench.families import collect, hours, idle, latency, memory, sac, see, start, step, train
from bench.plan import Group


def groups() -> list[Group]:
    """Everything that can be measured."""
    return [
        *step.groups(),
        *latency.groups(),
        *start.groups(),
        *idle.groups(),
        *memory.groups(),
        *train.groups(),
        *hours.groups(),
        *sac.groups(),
        *collect.groups(),
        *see.groups(),
    ]
