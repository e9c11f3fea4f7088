"""Kernels over footings and near creases, against NumPy and plain loops. Memory beyond arrays has other values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from antdsl.ground.mesh.creases import find_candidates_near_slopes, mark_rows_in_near_cells
from antdsl.ground.mesh.footings import find_max_step_and_size, write_footing_positions, write_footing_sides

N = 2000
FIRST = 0, 11, 30  # the first face of each of two meshes, and the number of faces


def embed(values: Any, around: float) -> NDArray[Any]:
    """A copy of an array, between other values in memory."""
    values = np.asarray(values)
    longer = np.full(len(values) + 32, around, values.dtype)
    longer[16:-16] = values
    return longer[16:-16]


def random_footings(seed: int, meshes: int) -> tuple[np.random.Generator, NDArray[np.int32], NDArray[np.int32]]:
    rng = np.random.default_rng(seed)
    return rng, rng.integers(-1, meshes, N).astype(np.int32), rng.integers(-1, 11, N).astype(np.int32)


def test_positions_are_those_of_corners_to_the_sign_of_zero() -> None:
    rng, mesh, face = random_footings(1, 2)
    vertices, faces = rng.choice([-0.0, 0.0, 1.0, 2.5], (40, 3)), rng.integers(0, 40, (30, 3)).astype(np.int32)
    first, normal = embed(FIRST[:2], 0), rng.choice([-1.0, -0.0, 0.5, 1.0], (3, 30))
    b1, b2, over = rng.choice([0.0, -0.0, 0.5, 1.0], (3, N))
    over[::2] *= 0.0
    b1[:600] = b2[:600] = -0.0  # so that a corner's negative zero is not lost before the normal is added
    tables, place = (vertices.ravel(), faces, normal, first), np.full((N, 3), 7.0)
    assert write_footing_positions(*tables, mesh, face, b1, b2, over, place)
    known = (mesh >= 0) & (face >= 0)
    number = np.where(known, first[np.maximum(mesh, 0)] + face, 0)
    a, b, c = (vertices[faces[number, k]] for k in range(3))
    expected = ((a + b1[:, None] * (b - a)) + b2[:, None] * (c - a)) + over[:, None] * normal[:, number].T
    expected[~known] = 0.0
    assert np.array_equal(place.view(np.int64), expected.view(np.int64)) and (np.signbit(place) & (place == 0)).any()
    for wrong_mesh, wrong_face, is_valid in ((2, 0, False), (2, 3, False), (1, 19, False), (1, 18, True), (-1, 99, True)):
        mesh[9], face[9] = wrong_mesh, wrong_face
        assert write_footing_positions(*tables, mesh, face, b1, b2, over, place) == is_valid


def test_sides_are_those_of_faces() -> None:
    rng, mesh, face = random_footings(2, 2)
    first, side, sides = embed(FIRST[:2], 3), rng.integers(1, 6, 30).astype(np.int8), np.full(N, 7, np.int8)
    write_footing_sides(mesh, face, first, side, sides, 5, N - 5)
    known = (mesh >= 0) & (face >= 0)
    expected = np.where(known, side[np.where(known, first[np.maximum(mesh, 0)] + face, 0)], 0)
    expected[:5] = expected[-5:] = 7
    assert np.array_equal(sides, expected)


@pytest.mark.parametrize("axis", range(3))
def test_the_greatest_step_and_size_ignore_what_is_not_finite(axis: int) -> None:
    rng = np.random.default_rng(axis)
    displacements, sizes = rng.uniform(-1, 1, (3, 50)), embed(rng.uniform(0.5, 2, 50), 1e9)
    displacements[axis, 20] = -7.5
    displacements[(axis + 1) % 3, 30], displacements[axis, 31] = np.nan, np.inf
    sizes[3] = np.nan
    displacements[:, 49], sizes[49] = (3, -4, 12), 2.5
    assert find_max_step_and_size(displacements, sizes) == (169.0, 2.5)
    displacements[:, 49], sizes[49] = 0, 0.1
    x, y, z = displacements[:, 20]
    assert find_max_step_and_size(displacements, sizes) == ((x * x + y * y) + z * z, np.nanmax(sizes))
    most, widest = find_max_step_and_size(np.full((3, 2), np.nan), np.full(2, np.nan))
    assert most == 0 and np.isnan(widest)
    assert find_max_step_and_size(np.zeros((3, 0)), np.zeros(0))[0] == 0


def test_candidates_have_the_rung_of_their_reach() -> None:
    rng, mesh, face = random_footings(3, 3)
    first, width, largest = embed(FIRST, 0), 3.7, 700.0
    clearances, sizes = embed(rng.choice([0.0, 1.0, 5.0, np.inf], 30), 0.0), embed(rng.uniform(0.1, 900, 30), 1e9)
    reach = rng.choice([np.nan, -1.0, 0.0, 1e-3, 1.0, 3.7, 4.0, 8.0, 8.1, 100.0, 700.0, 1e4], N)
    rung = np.frexp(np.clip(reach, width, largest))[1] - np.frexp(width)[1]
    for begin, end in ((0, 900), (900, N)):
        rows, rungs = np.full((2, N), -9)
        at, count, bits = find_candidates_near_slopes(
            mesh, face, first, clearances, sizes, reach, width, largest, rows, rungs, begin, end
        )
        expected = []
        for i in range(begin, end):
            number = first[mesh[i]] + face[i] if 0 <= mesh[i] < 2 and face[i] >= 0 and reach[i] > 0 else -1
            if number >= 0 and clearances[number] <= reach[i]:
                expected.append((i, int(rung[i]) if sizes[number] > reach[i] else -1))
        assert at == begin and list(zip(rows[begin : begin + count], rungs[begin : begin + count], strict=True)) == expected
        assert bits == sum(1 << each for each in {each for _, each in expected if each >= 0}) and bits.bit_count() > 3


def test_rows_are_near_by_the_cell_of_their_position() -> None:
    rng = np.random.default_rng(4)
    near, low, width = rng.random((5, 4, 7)) < 0.5, embed([-3.0, 10.0, 2.0], 1e3), 1.5
    place, rows, rungs = rng.uniform(-6, 20, (N, 3)), rng.permutation(N)[:500], rng.integers(-1, 3, 500)
    expected = rungs.copy()
    mark_rows_in_near_cells(rows, rungs, 1, place, low, width, near, 20, 480)
    cells = np.clip(np.floor((place[rows] - low) / width), 0, np.array(near.shape) - 1).astype(int)
    changed = 20 + np.flatnonzero(expected[20:480] == 1)
    expected[changed] = np.where(near[tuple(cells[changed].T)], -1, -2)
    assert np.array_equal(rungs, expected) and len(changed) > 80
