"""Networks of torch to ONNX under the extractor contract.

Input `[N, 3, H, W]` float32, N free, H and W fixed; output `[N, D]` float32. What lies between the
server's pixels and the input stands in the model's metadata, as decimal numbers:

    palr_gym.contract   image-features-1
    palr_gym.name       what it is
    palr_gym.size       H W
    palr_gym.scale      input = (pixel * scale - mean) / std, pixels within 0 to 255
    palr_gym.mean       of red, green and blue
    palr_gym.std        of red, green and blue
"""

# torch is not installed where types are checked.
# pyright: basic, reportMissingImports=false

import hashlib
from pathlib import Path

import onnx
import torch

CONTRACT = "image-features-1"


def export(
    network: torch.nn.Module,
    path: Path,
    *,
    name: str,
    side_px: int,
    mean: tuple[float, float, float],
    std: tuple[float, float, float],
) -> str:
    """Writes `path` and returns its SHA-256 in hexadecimal."""
    network.eval()
    torch.onnx.export(
        network,
        (torch.zeros(2, 3, side_px, side_px),),
        path,
        input_names=["image"],
        output_names=["features"],
        dynamic_shapes=({0: torch.export.Dim("N")},),
        external_data=False,
    )
    model = onnx.load(path)
    triple = lambda values: " ".join(repr(value) for value in values)  # noqa: E731
    onnx.helper.set_model_props(
        model,
        {
            "palr_gym.contract": CONTRACT,
            "palr_gym.name": name,
            "palr_gym.size": f"{side_px} {side_px}",
            "palr_gym.scale": repr(1 / 255),
            "palr_gym.mean": triple(mean),
            "palr_gym.std": triple(std),
        },
    )
    # Who wrote it, and where from, says nothing of what it computes.
    model.doc_string = ""
    for node in model.graph.node:
        node.ClearField("metadata_props")
        node.ClearField("doc_string")
    for value in (*model.graph.value_info, *model.graph.input, *model.graph.output):
        value.ClearField("metadata_props")
    for tensor in model.graph.initializer:
        tensor.ClearField("metadata_props")
    data = model.SerializeToString(deterministic=True)
    path.write_bytes(data)
    return hashlib.sha256(data).hexdigest()
