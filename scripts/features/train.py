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

from features.export import export
from features.frames import NO_LEAD_GAP_M, Frames, draw
from features.network import MEAN, STD, CompactResNet, Recipe, features, probe, train

NAME = "lane-compact-resnet"
FRAMES = {"train": (24_000, 10_000_000), "probe": (6_000, 20_000_000), "test": (4_096, 30_000_000)}
"""Frames, and the first seed of their episodes: three kinds that share none."""
SEEN_GAP_M = 25.0
"""The car ahead is probed up to here; further away it has three pixels."""


def probes(network: CompactResNet, fit: Frames, test: Frames) -> dict[str, float]:
    """R² on held-out frames of what a linear map of the features says of each quantity."""
    x, x_test = features(network, fit.pixels), features(network, test.pixels)
    report: dict[str, float] = {}
    for name in (
        "lateral_error_m",
        "heading_error_rad",
        "lead_gap_m",
        "velocity_along_mps",
        "past_throttle",
        "past_steer",
    ):
        y, y_test = fit.shown[name].astype(float), test.shown[name].astype(float)
        rows, rows_test = np.ones(len(y), bool), np.ones(len(y_test), bool)
        if name == "lead_gap_m":
            rows, rows_test = y < SEEN_GAP_M, y_test < SEEN_GAP_M
            assert SEEN_GAP_M < NO_LEAD_GAP_M
        report[name] = probe((x[rows], y[rows]), (x_test[rows_test], y_test[rows_test]))
    return report


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
    network = CompactResNet(recipe.width)
    random_weights = probes(network, frames["probe"], frames["test"])
    print("random weights", json.dumps(random_weights), flush=True)
    trained = random_weights
    begin = time.process_time()
    for epoch, loss, network in train(
        frames["train"].pixels, recipe, arguments.work / "checkpoint.pt"
    ):
        trained = probes(network, frames["probe"], frames["test"])
        minutes = (time.process_time() - begin) / 60
        print(f"epoch {epoch}: loss {loss:.3f}, {minutes:.1f} core minutes", end=" ")
        print(json.dumps({name: round(value, 3) for name, value in trained.items()}), flush=True)
    path = arguments.out / f"{NAME}.onnx"
    sha256 = export(network, path, name=NAME, side_px=48, mean=MEAN, std=STD)
    card = {
        "name": NAME,
        "sha256": sha256,
        "bytes": path.stat().st_size,
        "parameters": sum(parameter.numel() for parameter in network.parameters()),
        "features": network.size,
        "recipe": asdict(recipe),
        "frames": {kind: {"count": n, "first_seed": seed} for kind, (n, seed) in FRAMES.items()},
        "linear_probe_r2": trained,
        "linear_probe_r2_of_random_weights": random_weights,
    }
    path.with_suffix(".json").write_text(json.dumps(card, indent=2) + "\n")
    print(json.dumps(card, indent=2))


if __name__ == "__main__":
    main()
