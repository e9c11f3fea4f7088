"""Pads arrays and returns their addresses, for machine code that reads eight rows at once."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.number_kinds import LANE_COUNT

_char_from_buffer: Callable[[Any], Any] = ctypes.c_char.from_buffer
_address_of_char = ctypes.addressof


def copy_padded(array: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of an array [n, ..] that is followed in memory by eight rows of zeros."""
    padded = np.zeros((len(array) + LANE_COUNT, *array.shape[1:]), array.dtype)
    padded[: len(array)] = array
    view: NDArray[Any] = padded[: len(array)]
    return view


def gather_padded(array: NDArray[Any], rows: NDArray[np.intp]) -> NDArray[Any]:
    """Return the elements of an array [n] at the indices `rows`, followed by eight spare zeros in memory."""
    output = allocate_padded(len(rows), array.dtype)
    array.take(rows, out=output, mode="clip")
    return output


def allocate_padded(count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return an uninitialised array [count], followed by eight spare zeros in memory."""
    padded = np.empty(count + LANE_COUNT, dtype)
    padded[count:] = 0
    view: NDArray[Any] = padded[:count]
    return view


def has_padding(array: NDArray[Any]) -> bool:
    """Return whether an array is the first part of a larger one with at least eight more rows."""
    padded = array.base
    if not isinstance(padded, np.ndarray) or padded.ndim != 1 or padded.dtype != array.dtype or not array.flags.c_contiguous:
        return False
    return len(padded) >= len(array) + LANE_COUNT and get_array_address(padded) == get_array_address(array)


def get_array_address(array: NDArray[Any]) -> int:
    """Return the start address of an array. Raises ValueError if the array is not contiguous."""
    try:
        return _address_of_char(_char_from_buffer(array))  # a third of the time of `array.ctypes.data`
    except (TypeError, ValueError):  # read-only, empty, or not in one piece
        pass
    if not array.flags.c_contiguous:
        raise ValueError("machine code needs contiguous arrays")
    location: int = array.ctypes.data
    return location
