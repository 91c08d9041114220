"""Small ONNX policies, good ones and bad ones, and a forward pass in plain NumPy."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

# Old enough for every ONNX Runtime of recent years.
OPSET = 17
IR_VERSION = 9


def _model(nodes: list[Any], inputs: list[Any], outputs: list[Any], tensors: list[Any]) -> Any:
    graph = helper.make_graph(nodes, "policy", inputs, outputs, tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)])
    model.ir_version = IR_VERSION
    return model


def _linear(weights: NDArray[np.float32]) -> Any:
    """Action = tanh(observation @ weights)."""
    observation_size, action_size = weights.shape
    return _model(
        [
            helper.make_node("MatMul", ["observation", "weights"], ["mean"]),
            helper.make_node("Tanh", ["mean"], ["action"]),
        ],
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["N", observation_size])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["N", action_size])],
        [numpy_helper.from_array(weights, "weights")],
    )


def linear_policy(weights: NDArray[np.float32]) -> bytes:
    """Action = tanh(observation @ weights).

    Args:
        weights: [observation size, action size]
    """
    return _linear(weights).SerializeToString()


def policy_with_external_data(observation_size: int, action_size: int) -> bytes:
    """A policy whose weights claim to stand in another file."""
    model = _linear(np.zeros((observation_size, action_size), dtype=np.float32))
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"
    return model.SerializeToString()


def policy_that_emits_nan(observation_size: int, action_size: int) -> bytes:
    """A policy that fits in every way and answers NaN."""
    return linear_policy(np.full((observation_size, action_size), np.nan, dtype=np.float32))


@dataclass(frozen=True)
class PolicyOutput:
    """What a policy answers to N observations; each [N, action size]."""

    action: NDArray[np.float32]
    mean: NDArray[np.float32]
    log_std: NDArray[np.float32]


class NumpyPolicy:
    """The forward pass of a feed-forward ONNX model, one NumPy line for each operator."""

    def __init__(self, path: Path) -> None:
        """Reads the model's graph and weights."""
        graph: Any = onnx.load_from_string(path.read_bytes()).graph
        self._nodes: list[Any] = list(graph.node)
        self._input: str = graph.input[0].name
        self._weights: dict[str, NDArray[Any]] = {
            tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer
        }

    def __call__(self, observations: NDArray[np.float32]) -> PolicyOutput:
        """The answer to observations of shape [N, observation size]."""
        values: dict[str, Any] = {**self._weights, self._input: observations}
        for node in self._nodes:
            attributes = {
                attribute.name: helper.get_attribute_value(attribute)
                for attribute in node.attribute
            }
            operands = [values[name] for name in node.input]
            results = _apply(node.op_type, operands, attributes)
            values.update(zip(node.output, results, strict=True))
        return PolicyOutput(values["action"], values["mean"], values["log_std"])


def _apply(operator: str, operands: list[Any], attributes: dict[str, Any]) -> list[Any]:
    match operator, operands:
        case "Gemm", [x, weights, bias]:
            return [x @ (weights.T if attributes.get("transB") else weights) + bias]
        case "MatMul", [x, weights]:
            return [x @ weights]
        case "Relu", [x]:
            return [np.maximum(x, 0)]
        case "Tanh", [x]:
            return [np.tanh(x)]
        case "Clip", [x, low, high]:
            return [np.clip(x, low, high)]
        case "Add", [x, y]:
            return [x + y]
        case "Sub", [x, y]:
            return [x - y]
        case "Mul", [x, y]:
            return [x * y]
        case "Div", [x, y]:
            return [x / y]
        case _:
            raise NotImplementedError(f"operator {operator} has no line of NumPy here")
