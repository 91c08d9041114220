"""`render.*` and `features.*`: what agents that see pictures cost beside their simulation."""

import tempfile
from collections.abc import Mapping
from pathlib import Path

from bench.plan import Contender, Group, Settings, ratio
from bench.processes import measured, python

# What one costs, roughly: how many fit into a measurement.
_PICTURE_S = 0.0008
_BATCH_S = 0.15


def _prepare_render(settings: Settings) -> Mapping[str, Contender]:
    pictures = f"--pictures={max(50, round(settings.seconds / _PICTURE_S))}"
    command = [str(settings.binaries / "bench-see"), "render", pictures]

    def peer() -> float:
        return measured(python(settings, "see_peer", "render", pictures))["rate_per_cpu_s"]

    def ours() -> float:
        return measured(command)["rate_per_cpu_s"]

    def limit() -> float:
        binary = str(settings.binaries / "bench-see-limit")
        return measured([binary, "render", pictures])["rate_per_cpu_s"]

    def one() -> float:
        return measured([*command, "--threads=1"])["rate"]

    def two() -> float:
        return measured([*command, "--threads=2"])["rate"]

    return {"python": peer, "limit": limit, "ours": ours, "one": one, "two": two}


def _prepare_features(settings: Settings) -> Mapping[str, Contender]:
    folder = tempfile.TemporaryDirectory(prefix="palr-bench-")
    model = Path(folder.name) / "resnet34.onnx"
    measured(python(settings, "see_peer", "export", f"--out={model}"))
    arguments = [
        f"--extractor={model}",
        f"--batches={max(3, round(settings.seconds / _BATCH_S))}",
    ]

    def peer() -> float:
        return measured(python(settings, "see_peer", "features", *arguments))["rate"]

    def ours() -> float:
        # The folder lives as long as somebody measures.
        assert Path(folder.name).exists()
        return measured([str(settings.binaries / "bench-see"), "features", *arguments])["rate"]

    return {"python": peer, "ours": ours}


def groups() -> list[Group]:
    """Drawing and features."""
    drawing = [
        ratio(
            "render.lane.48.vs_python",
            "ours",
            "python",
            unit="pictures/CPU-s",
            kind="throughput",
        ),
        ratio("render.lane.48.vs_limit", "ours", "limit", unit="pictures/CPU-s", kind="throughput"),
        ratio(
            "render.lane.48.two_threads_vs_one", "two", "one", unit="pictures/s", kind="throughput"
        ),
    ]
    features = ratio(
        "features.batch32.vs_python_onnxruntime",
        "ours",
        "python",
        unit="pictures/s",
        kind="throughput",
    )
    return [Group(drawing, _prepare_render), Group([features], _prepare_features)]
