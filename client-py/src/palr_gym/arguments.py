"""Checks of arguments that the wire cannot carry. What it can carry, the server judges."""

import math
import operator
from typing import Any, SupportsIndex, cast

import numpy as np
from numpy.typing import NDArray

from palr_gym.errors import InvalidArgument


def unsigned(name: str, value: SupportsIndex, bits: int) -> int:
    """`value` as an integer of `bits` bits.

    Raises:
        InvalidArgument: It is none.
    """
    try:
        integer = operator.index(value)
    except TypeError:
        integer = -1
    if not 0 <= integer < 1 << bits:
        raise InvalidArgument(f"{name} is {value!r}; expected an integer from 0 to 2**{bits} - 1")
    return integer


def seconds(name: str, value: float) -> float:
    """`value` as a positive, finite number of seconds.

    Raises:
        InvalidArgument: It is none.
    """
    if not (math.isfinite(value) and value > 0):
        raise InvalidArgument(f"{name} is {value!r}; expected a number of seconds above 0")
    return float(value)


def reset_mask(options: dict[str, Any] | None, num_envs: int) -> NDArray[np.bool_] | None:
    """The mask in the `options` of a reset, held to the rules of `SyncVectorEnv`.

    Raises:
        TypeError: It is no array of booleans.
        InvalidArgument: It has another shape, or chooses nothing.
    """
    if options is None or "reset_mask" not in options:
        return None
    value: object = options["reset_mask"]
    name = "options['reset_mask']"
    if not isinstance(value, np.ndarray):
        raise TypeError(f"{name} has type {type(value)}; expected a numpy array")
    mask = cast("NDArray[Any]", value)
    if mask.dtype != np.bool_:
        raise TypeError(f"{name} has dtype {mask.dtype}; expected bool")
    if mask.shape != (num_envs,):
        raise InvalidArgument(f"{name} has shape {mask.shape}; expected ({num_envs},)")
    if not mask.any():
        raise InvalidArgument(f"{name} is false everywhere; expected at least one true entry")
    return mask
