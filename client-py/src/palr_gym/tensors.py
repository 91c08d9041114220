"""`Tensor` messages from and to NumPy arrays.

Arrays that come out are copies: writable, and independent of the message and of each other. A
view would be read-only and would keep the whole message alive; the copy costs well under a
microsecond for 64 environments.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palr_gym._proto.palr_gym.v1 import tensor_pb2
from palr_gym.errors import ServerError

FLOAT32 = np.dtype("<f4")
FLOAT64 = np.dtype("<f8")
BOOL = np.dtype(np.bool_)
UINT8 = np.dtype(np.uint8)

_DTYPES: dict[int, np.dtype[Any]] = {
    tensor_pb2.DATA_TYPE_FLOAT32: FLOAT32,
    tensor_pb2.DATA_TYPE_FLOAT64: FLOAT64,
    tensor_pb2.DATA_TYPE_BOOL: BOOL,
    tensor_pb2.DATA_TYPE_UINT8: UINT8,
}


def float32_tensor(array: NDArray[np.float32]) -> tensor_pb2.Tensor:
    """A message with the shape and elements of `array`."""
    return tensor_pb2.Tensor(
        dtype=tensor_pb2.DATA_TYPE_FLOAT32,
        shape=array.shape,
        data=np.ascontiguousarray(array, dtype=FLOAT32).tobytes(),
    )


def float64_tensor(array: NDArray[np.float64]) -> tensor_pb2.Tensor:
    """A message with the shape and elements of `array`."""
    return tensor_pb2.Tensor(
        dtype=tensor_pb2.DATA_TYPE_FLOAT64,
        shape=array.shape,
        data=np.ascontiguousarray(array, dtype=FLOAT64).tobytes(),
    )


def to_array(tensor: tensor_pb2.Tensor, dtype: np.dtype[Any], shape: Sequence[int]) -> NDArray[Any]:
    """The elements of `tensor`, checked against what the protocol promises. -1 matches any size.

    Raises:
        ServerError: Type, shape or number of bytes are not what was promised.
    """
    got_shape = tuple(tensor.shape)
    fits = len(got_shape) == len(shape) and all(
        want in (-1, got) for got, want in zip(got_shape, shape, strict=True)
    )
    if _DTYPES.get(tensor.dtype) != dtype or not fits:
        raise ServerError(
            f"the server sent a tensor of type {tensor.dtype} and shape {list(got_shape)}; "
            f"expected {dtype} and {list(shape)}"
        )
    return elements(tensor.data, dtype, got_shape)


def elements(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """The elements in `data`, whose type and shape are known. For the path of every step.

    Raises:
        ServerError: `data` is longer or shorter than `shape` says.
    """
    return _view(data, dtype, shape).copy()


def columns(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Like `elements`, but with the last dimension first: each column becomes contiguous."""
    return np.moveaxis(_view(data, dtype, shape), -1, 0).copy()


def _view(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    try:
        return np.frombuffer(data, dtype).reshape(shape)
    except ValueError:
        raise ServerError(
            f"the server sent {len(data)} bytes; expected {dtype} of shape {list(shape)}"
        ) from None
