"""Small feature extractors, good ones and bad ones."""

from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 17
IR_VERSION = 9
METADATA = {
    "palr_gym.contract": "image-features-1",
    "palr_gym.name": "mean-colours",
    "palr_gym.size": "48 48",
    "palr_gym.scale": "0.00392156862745098",
    "palr_gym.mean": "0 0 0",
    "palr_gym.std": "1 1 1",
}


def extractor(
    nodes: list[Any],
    *,
    metadata: dict[str, str] | None = None,
    size: tuple[int, int] = (48, 48),
    tensors: list[Any] | None = None,
) -> bytes:
    """A model from `image` to `features`, [N, 3]; `metadata` go over those of the contract."""
    shape: list[Any] = ["N", 3, *size]
    graph = helper.make_graph(
        nodes,
        "extractor",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("features", TensorProto.FLOAT, ["N", 3])],
        tensors or [],
    )
    model: Any = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)])
    model.ir_version = IR_VERSION
    onnx.helper.set_model_props(model, METADATA | (metadata or {}))
    return model.SerializeToString()


def mean_colours(**metadata: str) -> bytes:
    """Features are the mean of each channel."""
    nodes = [
        helper.make_node("GlobalAveragePool", ["image"], ["pooled"]),
        helper.make_node("Flatten", ["pooled"], ["features"]),
    ]
    return extractor(nodes, metadata={f"palr_gym.{key}": value for key, value in metadata.items()})


def nan_for_colour() -> bytes:
    """Features of grey pictures, on the whole, are 0; of others, NaN."""
    colour = numpy_helper.from_array(
        np.array([[1, 0, 0], [0, 1, 0], [-1, -1, 0]], np.float32), "colour"
    )
    slack = numpy_helper.from_array(np.array(0.03, np.float32), "slack")
    nodes = [
        helper.make_node("GlobalAveragePool", ["image"], ["pooled"]),
        helper.make_node("Flatten", ["pooled"], ["means"]),
        helper.make_node("MatMul", ["means", "colour"], ["differences"]),
        helper.make_node("Abs", ["differences"], ["distances"]),
        helper.make_node("Sub", ["slack", "distances"], ["left"]),
        helper.make_node("Sqrt", ["left"], ["features"]),
    ]
    return extractor(nodes, tensors=[colour, slack])


def external_data() -> bytes:
    """A model whose weights claim to stand in another file."""
    weights = numpy_helper.from_array(np.zeros((3, 3), np.float32), "weights")
    weights.ClearField("raw_data")
    weights.data_location = TensorProto.EXTERNAL
    entry = weights.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"
    nodes = [
        helper.make_node("GlobalAveragePool", ["image"], ["pooled"]),
        helper.make_node("Flatten", ["pooled"], ["means"]),
        helper.make_node("MatMul", ["means", "weights"], ["features"]),
    ]
    return extractor(nodes, tensors=[weights])
