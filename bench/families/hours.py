"""`hours.<setting>.<method>`: what the paper's 500 000 steps take, told from 2 000 of them."""

from collections.abc import Mapping
from functools import partial
from operator import itemgetter

from bench.plan import Contender, Figure, Group, Settings
from bench.processes import measured

_SETTINGS = ("hopper-w2", "ant-w4")
# Each with its defaults; PALR with M of each batch, as the paper has it, and with a pool of them.
_METHODS = (
    *("bc", "kf", "primenet", "rap", "fca", "mine", "palr-exact", "palr-pool"),
    *("palr_act-exact", "vib", "dt", "dt_palr-exact"),
)
_FULL_STEPS = 500_000
_MEASURED_STEPS = 2000
_WARM_UP = 100
# The slowest method takes seven tenths of a CPU second a step.
_TIMEOUT_S = 3600.0
_UNIT = f"CPU hours for {_FULL_STEPS} steps, extrapolated from {_MEASURED_STEPS}"


def _prepare(settings: Settings, *, setting: str) -> Mapping[str, Contender]:
    def hours(method: str) -> float:
        command = [
            str(settings.binaries / "bench-train"),
            f"--method={method}",
            f"--setting={setting}",
            f"--steps={_MEASURED_STEPS}",
            f"--warm-up={_WARM_UP}",
        ]
        return measured(command, _TIMEOUT_S)["cpu_s_per_step"] * _FULL_STEPS / 3600

    return {method: partial(hours, method) for method in _METHODS}


def groups() -> list[Group]:
    """A figure for each method; once, because each takes minutes."""
    return [
        Group(
            [
                Figure(
                    name=f"hours.{setting}.{method}",
                    kind="absolute",
                    better="lower",
                    unit=_UNIT,
                    needs=(method,),
                    ours=itemgetter(method),
                    by_default=False,
                )
                for method in _METHODS
            ],
            partial(_prepare, setting=setting),
            repeats=1,
        )
        for setting in _SETTINGS
    ]
