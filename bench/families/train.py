"""`train.<setting>.*`: CPU seconds of a training step, against torch."""

import resource
import tempfile
from collections.abc import Mapping
from functools import partial

from bench.plan import Contender, Figure, Group, Settings, ratio
from bench.processes import measured, python, ran

_SETTINGS = ("hopper-w2", "ant-w4")
_UNIT = "CPU seconds/step"
_METHODS = ("kf", "primenet", "rap", "fca", "mine")
# What a step costs here, roughly: how many fit into a measurement.
_SECONDS = {"bc": 0.004, "palr": 0.4, "kf": 0.005, "primenet": 0.008, "rap": 0.008}
_OUR_SECONDS = {"palr-exact": 0.1, "palr-pool": 0.008, "palr-lockstep10": 0.2}
_INNER_SECONDS = 0.02
_TRANSITIONS = 55_000
_EVALUATED_STEPS = 2000


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
    mine = ("bc", "palr-exact", "palr-pool", "palr-lockstep10", *_METHODS)
    return contenders | {method: ours(method) for method in mine}


def _figures(setting: str) -> list[Figure]:
    pairs = [
        ("bc_vs_torch", "bc", "torch-bc"),
        ("palr_pool_vs_torch_bc", "palr-pool", "torch-bc"),
        ("palr_exact_vs_torch", "palr-exact", "torch-palr"),
        ("palr_lockstep10_vs_torch", "palr-lockstep10", "torch-palr"),
        *((f"{method}_vs_torch", method, f"torch-{method}") for method in _METHODS),
    ]
    return [
        ratio(f"train.{setting}.{name}", ours, reference, unit=_UNIT, kind="cost")
        for name, ours, reference in pairs
    ]


def _prepare_evaluation(settings: Settings) -> Mapping[str, Contender]:
    """The same run of `palr-gym train` with and without evaluation beside it.

    A fifth of what lies between two evaluations by default, with a fifth of the episodes.
    """
    binary = str(settings.binaries / "palr-gym")
    folder = tempfile.TemporaryDirectory(prefix="palr-bench-")
    data = f"{folder.name}/hopper.hdf5"
    recording = [
        "--env=hopper",
        "--policy=expert",
        f"--transitions={_TRANSITIONS}",
        f"--out={data}",
    ]
    ran([binary, "collect", *recording])

    def run(every: int) -> Contender:
        arguments = ["--env=hopper-w2", f"--data={data}", "--weights=pool"]
        arguments += [f"--steps={_EVALUATED_STEPS}", f"--evaluate-every={every}", "--episodes=4"]
        arguments += ["--set=palr.pool_size=64"]

        def cpu_s_per_step() -> float:
            # Nothing outlives the contenders: the folder does, as long as there is one.
            assert folder.name
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            ran([binary, "train", *arguments])
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            return spent / _EVALUATED_STEPS

        return cpu_s_per_step

    return {"with_eval": run(_EVALUATED_STEPS), "without_eval": run(0)}


def groups() -> list[Group]:
    """Both settings, each with all methods; evaluation beside training."""
    name = "train.hopper-w2.with_eval_vs_without"
    evaluated = ratio(name, "with_eval", "without_eval", unit=_UNIT, kind="cost")
    methods = [
        Group(_figures(setting), partial(_prepare, setting=setting)) for setting in _SETTINGS
    ]
    return [*methods, Group([evaluated], _prepare_evaluation)]
