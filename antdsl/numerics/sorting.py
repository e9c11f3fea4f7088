"""The order of whole numbers, found by counting sixteen bits at a time: several times faster than comparing them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_BITS = 16  # NumPy sorts numbers of this width by counting


def stable_order(keys: NDArray[np.integer[Any]]) -> NDArray[np.intp]:
    """What `argsort(keys, kind="stable")` gives for whole numbers [n] (D. E. Knuth, The Art of Computer Programming 3, 5.2.5)."""
    if not keys.size:
        return np.empty(0, np.intp)
    low, high = int(keys.min()), int(keys.max())
    if high - low >= 1 << 3 * _BITS:
        return np.argsort(keys, kind="stable")
    rest = keys.astype(np.int64) - low
    order = np.argsort(rest.astype(np.uint16), kind="stable")
    for shift in range(_BITS, (high - low).bit_length(), _BITS):
        order = order.take(np.argsort((rest >> shift).astype(np.uint16).take(order), kind="stable"))
    return order
