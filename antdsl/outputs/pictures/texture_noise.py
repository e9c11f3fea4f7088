"""Solid value noise with its gradient, in float32, from one small table: the grain of soil and stone."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.pictures.shading_rows import Floats, wrapped

_EDGE = 32  # the pattern repeats after this many wavelengths


@lru_cache(maxsize=4)
def _table(seed: int) -> Floats:
    values = np.random.Generator(np.random.Philox(seed)).uniform(-1.0, 1.0, _EDGE**3).astype(np.float32)
    values.setflags(write=False)
    return values


def value_noise(points: Floats, wavelength: float, seed: int) -> tuple[Floats, Floats]:
    """Value (n,) within −1..1 and gradient (n, 3), per world unit, at `points` (n, 3); smooth, about one bump a `wavelength`."""
    table = _table(seed)
    scaled = points * np.float32(1.0 / wavelength)
    whole = np.floor(scaled)
    part = scaled - whole
    cell = whole.astype(np.int32) & (_EDGE - 1)
    following = (cell + 1) & (_EDGE - 1)
    ease = part * part * (3 - 2 * part)
    slope = 6 * part * (1 - part) * np.float32(1.0 / wavelength)
    (x, y, z), (a, b, c) = ease.T, slope.T
    x0, y0, z0 = cell[:, 0] * (_EDGE * _EDGE), cell[:, 1] * _EDGE, cell[:, 2]
    x1, y1, z1 = following[:, 0] * (_EDGE * _EDGE), following[:, 1] * _EDGE, following[:, 2]
    rows = []
    for row in (x0 + y0, x0 + y1, x1 + y0, x1 + y1):
        low, high = table.take(row + z0), table.take(row + z1)
        rows.append((low + (high - low) * z, high - low))
    (v00, d00), (v01, d01), (v10, d10), (v11, d11) = rows
    low, high = v00 + (v01 - v00) * y, v10 + (v11 - v10) * y
    by_y = (v01 - v00) + ((v11 - v10) - (v01 - v00)) * x
    near, far = d00 + (d01 - d00) * y, d10 + (d11 - d10) * y
    gradient = np.stack([(high - low) * a, by_y * b, (near + (far - near) * x) * c], axis=1)
    return low + (high - low) * x, gradient


def dither(rows: NDArray[np.int64], columns: NDArray[np.int64], turn: int = 0) -> Floats:
    """A screen pattern within 0..1 whose neighbours differ most (Jimenez, SIGGRAPH course on real-time rendering, 2014)."""
    x, y = columns + 5.588238 * turn, rows + 5.588238 * turn
    return wrapped(52.9829189 * wrapped(0.06711056 * x + 0.00583715 * y)).astype(np.float32)
