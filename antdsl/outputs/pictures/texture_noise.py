"""Solid noise in float32, from small tables: smooth values with their gradient, and packed grains. Of these are soil and
stone."""

from functools import lru_cache

import numpy as np

from antdsl.outputs.pictures.shading_rows import Floats

# Turned, so that no plane across an axis of the world runs along the lattice.
_TURN = np.array([[0.36, 0.48, -0.80], [-0.80, 0.60, 0.0], [0.48, 0.64, 0.60]], np.float32)
_EDGE = 32  # the pattern repeats after this many wavelengths


def _turned(rows: Floats, matrix: Floats) -> Floats:
    """Rows (n, 3) times a matrix: written out, for BLAS wakes threads that cost more than they do."""
    turned = np.empty_like(rows)
    for k in range(3):
        turned[:, k] = rows[:, 0] * matrix[0, k] + rows[:, 1] * matrix[1, k] + rows[:, 2] * matrix[2, k]
    return turned


@lru_cache(maxsize=4)
def _table(seed: int) -> Floats:
    values = np.random.Generator(np.random.Philox(seed)).uniform(-1.0, 1.0, _EDGE**3).astype(np.float32)
    values.setflags(write=False)
    return values


def value_noise(points: Floats, wavelength: float, seed: int) -> tuple[Floats, Floats]:
    """Value (n,) within −1..1 and gradient (n, 3), per world unit, at `points` (n, 3); smooth, about one bump a `wavelength`."""
    table = _table(seed)
    scaled = _turned(points, _TURN * np.float32(1.0 / wavelength))
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
    return low + (high - low) * x, _turned(gradient, _TURN.T)


@lru_cache(maxsize=4)
def _grains(seed: int) -> Floats:
    """For each cell of a lattice where in it a grain lies, and its tone."""
    draw = np.random.Generator(np.random.Philox(seed)).uniform(-1.0, 1.0, (_EDGE**3, 4)).astype(np.float32)
    draw.setflags(write=False)
    return draw


def grain_noise(points: Floats, size: float, seed: int) -> tuple[Floats, Floats, Floats]:
    """Ground of packed grains at `points` (n, 3), about one a `size` (Worley, SIGGRAPH 1996): how far each is from the middle
    of its grain (n,), 0..1, the way from there (n, 3), about one long at the rim, and the grain's tone (n,) within −1..1."""
    table = _grains(seed)
    scaled = _turned(points, _TURN * np.float32(1.0 / size))
    low = np.floor(scaled - np.float32(0.5))
    cell = low.astype(np.int32)
    inside = scaled - low
    nearest = np.full(len(points), np.inf, np.float32)
    way, tone = np.zeros_like(points), np.zeros(len(points), np.float32)
    for x in (0, 1):
        for y in (0, 1):
            for z in (0, 1):
                own = ((cell[:, 0] + x) & (_EDGE - 1)) * (_EDGE * _EDGE) + ((cell[:, 1] + y) & (_EDGE - 1)) * _EDGE
                grain = table.take(own + ((cell[:, 2] + z) & (_EDGE - 1)), axis=0)
                apart = inside - np.array([x + 0.5, y + 0.5, z + 0.5], np.float32) - grain[:, :3] * np.float32(0.42)
                square = np.einsum("nc,nc->n", apart, apart)
                nearer = np.flatnonzero(square < nearest)
                nearest[nearer], way[nearer], tone[nearer] = square[nearer], apart[nearer], grain[nearer, 3]
    return np.minimum(np.sqrt(nearest) * np.float32(1.5), 1), _turned(way, _TURN.T * np.float32(1.5)), tone
