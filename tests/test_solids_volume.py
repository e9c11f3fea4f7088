"""Solids as signed distances: what is inside, what digging takes away, in any order, and what is kept."""

from __future__ import annotations

import meshes
import numpy as np
import pytest

from antdsl.runtime.solids import Unusable, Volume


def ball() -> Volume:
    made = Volume.from_mesh(*meshes.ball(12.0, rings=24), 1.0)
    assert isinstance(made, Volume)
    return made


def ways(n: int, seed: int = 1) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def test_a_ball_is_as_far_away_as_it_should_be() -> None:
    solid, way = ball(), ways(2000)
    for radius in (11.0, 12.0, 13.0, 14.5):
        assert np.abs(solid.sample(way * radius) - (radius - 12)).max() < 0.12
    assert (solid.sample(way * 3) == solid.band[0]).all() and (solid.sample(way * 500) == solid.band[1]).all()
    assert solid.sample(np.full((1, 3), np.nan)).shape == (1,)


def test_what_is_removed_is_what_is_missing() -> None:
    solid, way = ball(), ways(60)
    before = solid.volume()
    removed = solid.carve(way * 11, np.full(60, 2.5), np.arange(60))
    assert removed.sum() == before - solid.volume() == solid.removed > 1000


def test_the_order_of_digging_does_not_matter() -> None:
    way = ways(60)
    order = np.random.default_rng(5).permutation(60)
    a, b = ball(), ball()
    first = a.carve(way * 11, np.full(60, 2.5), np.arange(60))
    second = b.carve(way[order] * 11, np.full(60, 2.5), np.arange(60)[order])
    assert a.digest() == b.digest() and (first[order] == second).all()


@pytest.mark.parametrize("voxel", [0.0, float("nan"), 1e-6])
def test_a_voxel_that_cannot_be(voxel: float) -> None:
    assert isinstance(Volume.from_mesh(*meshes.ball(12.0), voxel), Unusable)


def test_an_open_mesh_is_no_solid() -> None:
    vertices, faces = meshes.ball(12.0)
    problem = Volume.from_mesh(vertices, faces[:-1], 1.0)
    assert isinstance(problem, Unusable) and "closed" in problem.message


def test_a_state_is_restored() -> None:
    a, b = ball(), ball()
    a.carve(ways(60) * 11, np.full(60, 2.5), np.arange(60))
    b.restore(a.state())
    assert a.digest() == b.digest() and a.volume() == b.volume()
    with pytest.raises(ValueError, match="mesh"):
        b.restore(a.state() | {"start": np.zeros(32, np.uint8)})
