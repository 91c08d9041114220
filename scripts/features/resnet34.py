"""torchvision's ResNet34 as a feature extractor: the paper's, if its ImageNet weights are given.

    PYTHONPATH=scripts python -m features.resnet34 --weights WEIGHTS.pth --out resnet34.onnx

It wants torch, torchvision, onnx and onnxscript. Without `--weights` they are random.
"""

# torch is not installed where types are checked.
# pyright: basic, reportMissingImports=false

import argparse
from pathlib import Path

import torch
from torchvision.models import resnet34

from features.export import export

# As torchvision prepares ImageNet's pictures.
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)


def network(weights: Path | None) -> torch.nn.Module:
    """`[N, 3, H, W]` -> `[N, 512]`: pooled, without the layer that tells ImageNet's classes."""
    whole = resnet34(weights=None)
    if weights is not None:
        whole.load_state_dict(torch.load(weights, weights_only=True))
    whole.fc = torch.nn.Identity()
    return whole.eval()


def main() -> None:
    """Exports."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--weights", type=Path, help="torchvision's file; random weights without")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--side", type=int, default=48, help="pixels of a picture's side")
    arguments = parser.parse_args()
    torch.manual_seed(0)
    name = "resnet34" if arguments.weights else "resnet34-random-weights"
    whole = network(arguments.weights)
    sha256 = export(whole, arguments.out, name=name, side_px=arguments.side, mean=MEAN, std=STD)
    print(f"{arguments.out}: {name}, SHA-256 {sha256}")


if __name__ == "__main__":
    main()
