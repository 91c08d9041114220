"""`train.<setting>.*`: CPU seconds of a training step, against torch."""

from collections.abc import Mapping
from functools import partial

from bench.plan import Contender, Figure, Group, Settings, ratio
from bench.processes import measured, python

_SETTINGS = ("hopper-w2", "ant-w4")
_UNIT = "CPU seconds/step"
_METHODS = ("kf", "primenet", "rap", "fca", "mine")
# What a step costs here, roughly: how many fit into a measurement.
_SECONDS = {"bc": 0.004, "palr": 0.4, "kf": 0.005, "primenet": 0.008, "rap": 0.008}
_OUR_SECONDS = {"palr-exact": 0.1, "palr-pool": 0.008}
_INNER_SECONDS = 0.02


def _prepare(settings: Settings, *, setting: str) -> Mapping[str, Contender]:
    def steps(seconds: float) -> int:
        return max(10, round(settings.seconds / seconds))

    def torch(method: str) -> Contender:
        count = steps(_SECONDS.get(method, _INNER_SECONDS))
        arguments = [f"--method={method}", f"--setting={setting}", f"--steps={count}"]
        command = python(settings, "torch_peer", *arguments)
        return lambda: measured(command)["cpu_s_per_step"]

    def ours(method: str) -> Contender:
        count = steps(_OUR_SECONDS.get(method, _SECONDS.get(method, _INNER_SECONDS)))
        binary = str(settings.binaries / "bench-train")
        command = [binary, f"--method={method}", f"--setting={setting}", f"--steps={count}"]
        return lambda: measured(command)["cpu_s_per_step"]

    contenders = {f"torch-{method}": torch(method) for method in ("bc", "palr", *_METHODS)}
    mine = ("bc", "palr-exact", "palr-pool", *_METHODS)
    return contenders | {method: ours(method) for method in mine}


def _figures(setting: str) -> list[Figure]:
    pairs = [
        ("bc_vs_torch", "bc", "torch-bc"),
        ("palr_pool_vs_torch_bc", "palr-pool", "torch-bc"),
        ("palr_exact_vs_torch", "palr-exact", "torch-palr"),
        *((f"{method}_vs_torch", method, f"torch-{method}") for method in _METHODS),
    ]
    return [
        ratio(f"train.{setting}.{name}", ours, reference, unit=_UNIT, kind="cost")
        for name, ours, reference in pairs
    ]


def groups() -> list[Group]:
    """Both settings, each with all methods."""
    return [Group(_figures(setting), partial(_prepare, setting=setting)) for setting in _SETTINGS]
