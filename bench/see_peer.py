"""Drawing and features as Python has them.

    python -m bench.see_peer render --scene scenes/lane.xml --pictures 1000
    python -m bench.see_peer features --extractor resnet34.onnx --batches 20
    python -m bench.see_peer export --out resnet34.onnx

Prints a line of JSON.
"""

# torch, onnxruntime and mujoco are not all installed where types are checked.
# pyright: basic, reportMissingImports=false

import argparse
import importlib
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

_ROOT = Path(__file__).resolve().parent.parent
_SIDE_PX = 48
_BATCH = 32
_WARM_UP = 20


def _report(pictures: int, times: int, work: Callable[[], object]) -> None:
    started, cpu = time.perf_counter(), time.process_time()
    for _ in range(times):
        work()
    wall_s, cpu_s = time.perf_counter() - started, time.process_time() - cpu
    rates = {"rate": pictures / wall_s, "rate_per_cpu_s": pictures / cpu_s}
    print(json.dumps({"pictures": pictures, "wall_s": wall_s, "cpu_s": cpu_s} | rates))


def _render(pictures: int) -> None:
    os.environ["MUJOCO_GL"] = "osmesa"
    os.environ["LP_NUM_THREADS"] = "0"
    mujoco: Any = importlib.import_module("mujoco")

    model = mujoco.MjModel.from_xml_path(str(_ROOT / "scenes" / "lane.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = mujoco.Renderer(model, 2 * _SIDE_PX, 2 * _SIDE_PX)

    def draw() -> None:
        renderer.update_scene(data, camera="driver")
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        frame = renderer.render().reshape(_SIDE_PX, 2, _SIDE_PX, 2, 3)
        ((frame.astype(np.uint16).sum((1, 3)) + 2) // 4).astype(np.uint8)

    for _ in range(_WARM_UP):
        draw()
    _report(pictures, pictures, draw)


def _features(extractor: Path, batches: int) -> None:
    onnxruntime: Any = importlib.import_module("onnxruntime")

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(extractor), options)
    name = session.get_inputs()[0].name
    shape = (_BATCH, 3, _SIDE_PX, _SIDE_PX)
    image = np.random.default_rng(0).standard_normal(shape, np.float32)
    for _ in range(max(1, batches // 10)):
        session.run(None, {name: image})
    _report(batches * _BATCH, batches, lambda: session.run(None, {name: image}))


def _export(out: Path) -> None:
    sys.path.insert(0, str(_ROOT / "scripts"))
    from features.export import export
    from features.resnet34 import MEAN, STD, network

    sha256 = export(
        network(None), out, name="resnet34-random-weights", side_px=_SIDE_PX, mean=MEAN, std=STD
    )
    print(json.dumps({"sha256": sha256}))


def main() -> None:
    """Measures once."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["render", "features", "export"])
    parser.add_argument("--pictures", type=int, default=1000)
    parser.add_argument("--batches", type=int, default=20)
    parser.add_argument("--extractor", type=Path)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    match arguments.what:
        case "render":
            _render(arguments.pictures)
        case "features":
            _features(arguments.extractor, arguments.batches)
        case _:
            _export(arguments.out)


if __name__ == "__main__":
    main()
