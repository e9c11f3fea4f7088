"""All places of rectangles on a lattice, in pieces that stay small in memory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]


def boxes(low: Index, count: Index, piece: int) -> Iterator[tuple[Index, Index, Index]]:
    """All places of rectangles, from `low` (n, 2), `count` (n, 2) each way, about `piece` at once: the rectangle, the place."""
    count = np.maximum(count, 0)
    rows = np.repeat(np.arange(len(low)), count[:, 0])
    u = low[rows, 0] + counted(count[:, 0])
    wide = count[rows, 1]
    ends = np.cumsum(wide)
    a = 0
    while a < rows.size:
        b = max(int(np.searchsorted(ends, (ends[a - 1] if a else 0) + piece, side="right")), a + 1)
        name = np.repeat(rows[a:b], wide[a:b])
        yield name, np.repeat(u[a:b], wide[a:b]), low[name, 1] + counted(wide[a:b])
        a = b


def counted(counts: Index) -> Index:
    """0, 1 .. for each count, one after another."""
    return np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
