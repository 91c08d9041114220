"""Makes the compact feature extractor of the lane scenes, from nothing to its model card.

    palr-gym serve --unix /tmp/palr-gym.sock &
    PYTHONPATH=scripts:client-py/src python -m features.train --server unix:/tmp/palr-gym.sock

It wants torch, onnx, onnxscript and the packages of client-py; less than two hours on two cores.
Frames and checkpoints lie in runs/features; a run that was interrupted goes on.
"""

# torch is not installed where types are checked.
# pyright: basic, reportMissingImports=false

import argparse
import json
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from features.export import export
from features.frames import Frames, draw
from features.geometry import NAMES, SEEN_GAP_M, Bends, geometry
from features.network import MEAN, STD, CompactResNet, Recipe, features, probe, train

NAME = "lane-compact-resnet"
FRAMES = {"train": (24_000, 10_000_000), "probe": (6_000, 20_000_000), "test": (4_096, 30_000_000)}
"""Frames, and the first seed of their episodes: three kinds that share none."""
SEEN = ("lateral_error_m", "heading_error_rad", "lead_gap_m")
"""What the features should tell."""
HIDDEN = ("velocity_along_mps", "past_throttle", "past_steer")
"""What a single frame should not reveal beyond what the pose lets one guess."""
PROBE_EVERY = 4


def probes(network: CompactResNet, fit: Frames, test: Frames) -> dict[str, float]:
    """R² on held-out frames of what a linear map of the features says of each quantity."""
    x, x_test = features(network, fit.pixels), features(network, test.pixels)
    report: dict[str, float] = {}
    for name in (*SEEN, *HIDDEN):
        y, y_test = fit.shown[name].astype(float), test.shown[name].astype(float)
        rows, rows_test = np.ones(len(y), bool), np.ones(len(y_test), bool)
        if name == "lead_gap_m":
            rows, rows_test = y < SEEN_GAP_M, y_test < SEEN_GAP_M
        report[name] = probe((x[rows], y[rows]), (x_test[rows_test], y_test[rows_test]))
    return report


def of_the_pose(fit: Frames, test: Frames) -> dict[str, float]:
    """R² of the same linear regression of what is hidden on the geometry: what any features say."""

    def known(frames: Frames) -> NDArray[np.float64]:
        table = geometry(frames.shown, Bends(fit.shown)).astype(float)
        return np.where(np.isnan(table), 0, table)

    x, x_test = known(fit), known(test)
    return {
        name: probe((x, fit.shown[name].astype(float)), (x_test, test.shown[name].astype(float)))
        for name in HIDDEN
    }


def rounded(report: dict[str, float]) -> str:
    """For people."""
    return json.dumps({name: round(value, 3) for name, value in report.items()})


def main() -> None:
    """Draws, trains, probes, exports."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--server", help="a running palr-gym; needed until frames are there")
    parser.add_argument("--work", type=Path, default=Path("runs/features"))
    parser.add_argument("--out", type=Path, default=Path("scenes/features"))
    parser.add_argument("--epochs", type=int, default=Recipe.epochs)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    arguments.work.mkdir(parents=True, exist_ok=True)
    frames: dict[str, Frames] = {}
    for kind, (count, seed) in FRAMES.items():
        path = arguments.work / f"{kind}.npz"
        if not path.exists():
            draw(arguments.server, count, seed).save(path)
        frames[kind] = Frames.load(path)
        print(f"{kind}: {len(frames[kind].pixels)} frames", flush=True)
    recipe = Recipe(epochs=arguments.epochs)
    torch.manual_seed(recipe.seed)
    untrained = CompactResNet(recipe.width)
    random_weights = probes(untrained, frames["probe"], frames["test"])
    print("random weights", rounded(random_weights), flush=True)
    taught = frames["train"]
    shown = geometry(taught.shown, Bends(taught.shown))
    begin, network = time.process_time(), untrained
    for epoch, losses, network in train(
        taught.pixels, shown, recipe, arguments.work / "checkpoint.pt"
    ):
        minutes = (time.process_time() - begin) / 60
        text = ", ".join(f"{loss:.4f}" for loss in losses)
        print(f"epoch {epoch}: losses {text}, {minutes:.1f} core minutes", flush=True)
        if epoch % PROBE_EVERY == 0 and epoch < recipe.epochs:
            print(rounded(probes(network, frames["probe"], frames["test"])), flush=True)
    path = arguments.out / f"{NAME}.onnx"
    sha256 = export(network, path, name=NAME, side_px=48, mean=MEAN, std=STD)
    card = {
        "name": NAME,
        "sha256": sha256,
        "bytes": path.stat().st_size,
        "parameters": sum(parameter.numel() for parameter in network.parameters()),
        "features": network.size,
        "objective": "the geometry that a single frame shows, and the frame itself (regression)",
        "taught": NAMES,
        "recipe": asdict(recipe),
        "frames": {kind: {"count": n, "first_seed": seed} for kind, (n, seed) in FRAMES.items()},
        "linear_probe_r2": probes(network, frames["probe"], frames["test"]),
        "linear_probe_r2_of_random_weights": random_weights,
        "r2_of_the_pose_itself": of_the_pose(frames["probe"], frames["test"]),
    }
    path.with_suffix(".json").write_text(json.dumps(card, indent=2) + "\n")
    print(json.dumps(card, indent=2))


if __name__ == "__main__":
    main()
