"""Torchvision's ResNet34, exported, makes on the server the features that it makes in torch."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import torch

import palr_gym
from features.export import export
from features.resnet34 import MEAN, STD, network
from support.server_process import ROOT, running_server


def test_resnet34_sees_on_the_server_what_it_sees_in_torch(tmp_path: Path) -> None:
    torch.manual_seed(3)
    resnet = network(None)
    path = tmp_path / "resnet34.onnx"
    export(resnet, path, name="resnet34-random-weights", side_px=48, mean=MEAN, std=STD)
    seen = {}
    with running_server("--extractor", str(path)) as server:
        for env_id in ("lane-pixels-w1", "lane-w1"):
            with palr_gym.make_vec(env_id, 4, server=server.address) as envs:
                seen[env_id], _ = envs.reset(seed=1)
    unit = torch.from_numpy(seen["lane-pixels-w1"]).permute(0, 3, 1, 2).float() / 255
    image = (unit - torch.tensor(MEAN)[:, None, None]) / torch.tensor(STD)[:, None, None]
    with torch.no_grad():
        expected = resnet(image).numpy()
    assert expected.shape == (4, 512)
    np.testing.assert_allclose(seen["lane-w1"], expected, atol=1e-4, rtol=1e-4)


def test_the_export_script_writes_what_a_server_takes(tmp_path: Path) -> None:
    path = tmp_path / "resnet34.onnx"
    command = [sys.executable, "-m", "features.resnet34", "--out", str(path), "--side", "64"]
    subprocess.run(command, check=True, cwd=ROOT / "scripts")
    with (
        running_server("--extractor", str(path)) as server,
        palr_gym.Client(server.address) as client,
    ):
        extractor = client.spec("lane-w1").feature_extractor
    assert extractor is not None
    assert (extractor.name, extractor.size, extractor.width_px) == (
        "resnet34-random-weights",
        512,
        64,
    )
