"""Operations on rows of float32 vectors, fast for millions of rows.

Work is split into pieces that fit into a core's cache, and run on several threads."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

SAMPLES_PER_CHUNK = 1 << 16  # samples processed at once
# float32 throughout. NumPy's own types would not ensure that, because Python numbers convert them.
Floats = NDArray[Any]


def compute_dot_products(a: Floats, b: Floats) -> Floats:
    """Return the dot products (n,) of rows (n, 3). This is several times faster than a sum over the short axis."""
    result: Floats = np.einsum("nc,nc->n", a, b)
    return result


def normalise_rows(a: Floats) -> Floats:
    """Return rows (n, 3) scaled to unit length. A zero row remains zero."""
    return a * (1 / np.maximum(np.sqrt(compute_dot_products(a, a)), np.float32(1e-12)))[:, None]


def interpolate_vertices(table: Floats, corners: NDArray[np.int32], u: Floats, v: Floats) -> Floats:
    """Return values (n, c) interpolated within faces, from a `table` of values per vertex.

    `corners` (n, 3): the vertices of each face. `u`, `v` (n,): the weights of the second and the third corner."""
    total = table.take(corners[:, 0], axis=0)
    total *= (1 - u - v)[:, None]
    total += table.take(corners[:, 1], axis=0) * u[:, None]
    total += table.take(corners[:, 2], axis=0) * v[:, None]
    return total


def split_rows(count: int) -> list[slice]:
    """Return slices that divide `count` rows into pieces."""
    return [slice(start, min(start + SAMPLES_PER_CHUNK, count)) for start in range(0, count, SAMPLES_PER_CHUNK)]


def run_each(work: Callable[[Any], None], parts: Iterable[Any], threads: int) -> None:
    """Call `work` for each part, on several threads. Different parts must write to different memory."""
    if threads == 1:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(work, parts):
            pass
