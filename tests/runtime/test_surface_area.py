"""Places in a ball on thin faces are found without cutting them into parallel strips."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.casting.faces import find_nearest_on_triangle
from antdsl.runtime.binding.surface_area import _triangulate_ball_faces


def turn(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Twice the area between vectors in a plane, below 0 where the second lies to the right."""
    area: np.ndarray = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    return area


@pytest.mark.parametrize("width", [0.0, 1e-3, 2.0, 3e3])
def test_of_a_needle_only_what_is_near_the_ball_is_cut(width: float):
    """4 km long: what lies in the ball is covered once, and nothing far from it is there."""
    corner, edge1, edge2 = np.zeros((1, 3)), np.array([[4e6, 0, 0]]), np.array([[4e6, 0, width]])
    middle, radius = np.array([2.5e6, 0, width / 4]), 10.0
    face, weights = _triangulate_ball_faces((middle, radius), corner, edge1, edge2)
    assert 0 < len(face) < 20_000
    corners = corner[face][:, None] + weights[:, :, :1] * edge1[face][:, None] + weights[:, :, 1:] * edge2[face][:, None]
    near = find_nearest_on_triangle(np.broadcast_to(middle, (len(face), 3)), corners)
    assert (np.sqrt(((near - middle) ** 2).sum(axis=1)) <= 3 * radius).all()
    rng = np.random.default_rng(2)
    points = middle + rng.uniform(-1, 1, (2_000, 3)) * [radius, 0, radius]
    inside = (points[:, 2] > 1e-9) & (points[:, 2] < points[:, 0] * width / 4e6 - 1e-9)
    points = points[inside & (((points - middle) ** 2).sum(axis=1) < radius**2)]
    a, b, c = (corners[:, k][:, ::2] for k in range(3))
    for point in points[:, ::2][:200]:
        turns = [turn(v - u, point - u) for u, v in ((a, b), (b, c), (c, a))]
        times = (np.minimum.reduce(turns) >= -1e-6) | (np.maximum.reduce(turns) <= 1e-6)
        assert times.sum() >= 1
