"""Checks of arguments that the wire cannot carry. What it can carry, the server judges."""

import math
import operator
from typing import SupportsIndex

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
