"""Lists the cells of a regular lattice that triangles touch. The test is exact, and is done in batches that need little
memory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

_TRIANGLES_PER_CHUNK = 1 << 15  # triangles per batch
# Pairs of a triangle and a cell per batch: the intermediate results fit into the processor's cache
_PAIRS_PER_CHUNK = 1 << 13
_CELL_WIDTH_SLACK = 1e-9  # cells
_OTHER_AXES = ((1, 2), (2, 0), (0, 1))
_MAX_TRIANGLE_EXTENT = 2.0  # extent in cells; a larger triangle is cut in four
_MAX_CELL_NUMBER = float(1 << 62)
_THIN_TRIANGLE_RATIO = 64.0  # ratio of length in cells to touched cells; above it, a triangle is sliced


def iterate_triangle_cells(
    corners: NDArray[np.float64], exact: bool = True, margin: float = 0.0
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield all pairs of a triangle and a cell that it touches, in batches of k: cells int64[k,3], and triangle numbers int64[k].

    - `corners`: float64[n,3,3] (triangle, corner, axis) in units of cells; cell (i,j,k) is [i,i+1)×[j,j+1)×[k,k+1)
    - `exact`: if false, yield instead all cells of a small box around each part of a triangle
    - `margin`: also yield the cells within this distance (in cells) of a triangle

    A pair may be yielded more than once if the triangle is large. The test of a triangle against a box is that of Akenine-Möller,
    Fast 3D Triangle-Box Overlap Testing, 2001, p. 2-4."""
    for a in range(0, len(corners), _TRIANGLES_PER_CHUNK):
        yield from _iterate_touched_cells(
            corners[a : a + _TRIANGLES_PER_CHUNK], np.arange(a, min(a + _TRIANGLES_PER_CHUNK, len(corners))), exact, margin
        )


def _iterate_touched_cells(
    tri: NDArray[np.float64], triangle_numbers: NDArray[np.int64], exact: bool, margin: float
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield the pairs of `iterate_triangle_cells`, for at most `_TRIANGLES_PER_CHUNK` triangles with the numbers
    `triangle_numbers`.

    A long thin triangle is cut across its length into slices that are about as long as wide. Cutting it into quarters repeatedly
    would give thin triangles again, n²/4 of them for a length of n cells."""
    todo = [(tri, triangle_numbers)]
    while todo:
        tri, triangle_numbers = todo.pop()
        low, high = _compute_bounds(tri)
        large = (high - low).max(axis=1) > _MAX_TRIANGLE_EXTENT
        small = ~large
        if small.any():
            yield _find_cells_by_box(tri[small], triangle_numbers[small], exact, margin)
        if not large.any():
            continue
        tri, triangle_numbers = tri[large], triangle_numbers[large]
        thin = _find_thin_triangles(tri)
        if not thin.all():
            quarters, names = _split_triangles_in_four(tri[~thin]), np.tile(triangle_numbers[~thin], 4)
            for a in range(0, len(quarters), _TRIANGLES_PER_CHUNK):
                todo.append((quarters[a : a + _TRIANGLES_PER_CHUNK], names[a : a + _TRIANGLES_PER_CHUNK]))
        if thin.any():
            for slices, slice_rows in _iterate_triangle_chunks(tri[thin]):
                for pairs in _iterate_touched_cells(slices, triangle_numbers[thin][slice_rows], exact, margin):
                    yield _drop_repeated_pairs(*pairs)


def _drop_repeated_pairs(
    cells: NDArray[np.int64], triangle_numbers: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Remove most duplicates from pairs of a cell and a triangle, and return the remaining pairs. Duplicates occur because the
    parts into which a triangle is cut share cells."""
    lowest = cells.min(axis=0, initial=np.iinfo(np.int64).max)
    key = triangle_numbers - triangle_numbers.min(initial=0)
    key_count = float(key.max(initial=0)) + 1
    for axis in range(3):
        span = int(cells[:, axis].max(initial=lowest[axis]) - lowest[axis]) + 1
        key, key_count = key * span + (cells[:, axis] - lowest[axis]), key_count * span
    if key_count >= _MAX_CELL_NUMBER:
        return cells, triangle_numbers
    first_rows = np.unique(key, return_index=True)[1]
    return cells[first_rows], triangle_numbers[first_rows]


def _find_thin_triangles(tri: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of thin triangles. If these were cut into quarters repeatedly, they would have far more parts than cells."""
    sides = [tri[:, (k + 1) % 3] - tri[:, k] for k in range(3)]
    square = np.max([(side * side).sum(axis=1) for side in sides], axis=0)
    normal = np.cross(sides[0], sides[1])
    thin: NDArray[np.bool_] = square > _THIN_TRIANGLE_RATIO * (np.sqrt((normal * normal).sum(axis=1)) + np.sqrt(square))
    return thin


def _iterate_triangle_chunks(tri: NDArray[np.float64]) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Cut triangles into slices across their longest side. Yield the slices in batches, with the triangle number of each slice.

    A batch has at most `_TRIANGLES_PER_CHUNK` slices. Each triangle is first cut in two along its height. Each half is cut into
    slices parallel to the height, beginning at its tip, and each slice into two triangles."""
    sides = np.stack([((tri[:, (k + 1) % 3] - tri[:, k]) ** 2).sum(axis=1) for k in range(3)])
    first, row = sides.argmax(axis=0), np.arange(len(tri))
    start, end, apex = (tri[row, (first + k) % 3] for k in range(3))
    base_vector = end - start
    part = ((apex - start) * base_vector).sum(axis=1) / (base_vector * base_vector).sum(axis=1)
    foot = start + np.clip(part, 0.0, 1.0)[:, None] * base_vector
    tip, foot, apex = np.concatenate([start, end]), np.tile(foot, (2, 1)), np.tile(apex, (2, 1))
    height = np.sqrt(((apex - foot) ** 2).sum(axis=1))
    length = np.sqrt(((foot - tip) ** 2).sum(axis=1))
    count = np.ceil(length / np.maximum(height, _MAX_TRIANGLE_EXTENT - height)).astype(np.int64)
    stop = np.cumsum(count)
    for a in range(0, int(stop[-1]), _TRIANGLES_PER_CHUNK // 2):
        step = np.arange(a, min(a + _TRIANGLES_PER_CHUNK // 2, int(stop[-1])))
        half = np.searchsorted(stop, step, "right")
        near = (step - (stop[half] - count[half])) / count[half]
        far = (step + 1 - (stop[half] - count[half])) / count[half]
        low, high = (tip[half] + share[:, None] * (foot[half] - tip[half]) for share in (near, far))
        left, right = (tip[half] + share[:, None] * (apex[half] - tip[half]) for share in (near, far))
        parts = np.concatenate([np.stack([low, high, right], axis=1), np.stack([low, right, left], axis=1)])
        yield parts, np.tile(half % len(tri), 2)


def _split_triangles_in_four(tri: NDArray[np.float64]) -> NDArray[np.float64]:
    """Divide each triangle into four at the midpoints of its sides. Return the parts, float64[4n,3,3]."""
    a, b, c = tri[:, 0], tri[:, 1], tri[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def _compute_bounds(tri: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and highest coordinates of triangles, both float64[n,3].

    It combines the three corners one by one, which is faster than a reduction along an axis."""
    a, b, c = tri[:, 0], tri[:, 1], tri[:, 2]
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _find_cells_by_box(
    tri: NDArray[np.float64], triangle_numbers: NDArray[np.int64], exact: bool, margin: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the cells that triangles touch, and the triangle number of each cell. All cells in the bounding box of a triangle
    are tested."""
    lowest, highest = _compute_bounds(tri)
    low, high = np.floor(lowest - margin).astype(np.int64), np.floor(highest + margin).astype(np.int64)
    size = high - low + 1
    count = size[:, 0] * size[:, 1] * size[:, 2]
    row = np.repeat(np.arange(len(tri)), count)
    step = np.arange(row.size) - np.repeat(np.cumsum(count) - count, count)
    nx, ny = size[row, 0], size[row, 1]
    cells = low[row]
    rows, x_steps = np.divmod(step, nx)
    layers, y_steps = np.divmod(rows, ny)
    for axis, offsets in enumerate((x_steps, y_steps, layers)):
        cells[:, axis] += offsets
    if exact:
        flat = np.ascontiguousarray(tri.reshape(-1, 9).T)
        parts = [slice(begin, begin + _PAIRS_PER_CHUNK) for begin in range(0, len(row), _PAIRS_PER_CHUNK)]
        is_touched = np.concatenate([_find_touching_cells(flat, row[part], cells[part], 0.5 + margin) for part in parts])
        cells, row = cells[is_touched], row[is_touched]
    return cells, triangle_numbers[row]


def _find_touching_cells(
    tri: NDArray[np.float64], triangle_rows: NDArray[np.int64], cells: NDArray[np.int64], half: float
) -> NDArray[np.bool_]:
    """Return whether each of k pairs of a triangle and a cell touches, bool[k]. Their bounding boxes must touch.

    - `tri`: the corners of triangles, float64[9,n]; `triangle_rows` int64[k]: the triangle of each pair
    - `cells` int64[k,3]: the cell of each pair
    - `half`: half the edge length of the cells"""
    middle = cells.T + 0.5
    v = [[tri[3 * corner + axis].take(triangle_rows) - middle[axis] for axis in range(3)] for corner in range(3)]
    e = [[w - u for u, w in zip(v[one], v[other], strict=True)] for one, other in ((0, 1), (1, 2), (2, 0))]
    normal = [e[0][p] * e[1][q] - e[0][q] * e[1][p] for p, q in _OTHER_AXES]
    distance = np.abs(normal[0] * v[0][0] + normal[1] * v[0][1] + normal[2] * v[0][2])
    touch: NDArray[np.bool_] = distance <= half * (np.abs(normal[0]) + np.abs(normal[1]) + np.abs(normal[2])) + _CELL_WIDTH_SLACK
    for edge in e:
        length = [np.abs(part) for part in edge]
        for p, q in _OTHER_AXES:
            reach = half * (length[p] + length[q]) + _CELL_WIDTH_SLACK
            projections = [edge[p] * w[q] - edge[q] * w[p] for w in v]
            touch &= np.minimum(np.minimum(projections[0], projections[1]), projections[2]) <= reach
            touch &= np.maximum(np.maximum(projections[0], projections[1]), projections[2]) >= -reach
    return touch
