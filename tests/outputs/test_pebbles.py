"""Pebbles in pictures: the same ones in all pictures of a ground, and so low that agents walk over them."""

from __future__ import annotations

import meshes
import numpy as np
import pytest
from scipy.spatial import cKDTree

from antdsl.outputs.pictures.camera import CameraView
from antdsl.outputs.pictures.static_setting import scatter_pebbles
from antdsl.outputs.pictures.surface_materials import PictureScales

UP = np.array([0.0, 1.0, 0.0])
VERTICES, FACES = meshes.terrain(400.0, 100)


def camera(x: float, z: float, high: float = 12.0, pixels: int = 900) -> CameraView:
    """A camera above the ground that looks straight down."""
    axes = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    return CameraView(np.array([x, 20.0 + high, z]), *axes, (0.5, 0.4), pixels, int(pixels * 0.8))


def pebbles(view: CameraView, grain: float, ground: meshes.Mesh = (VERTICES, FACES)) -> dict[tuple[float, ...], np.ndarray]:
    """The vertices of each pebble, by its rounded middle."""
    points, faces = scatter_pebbles(*ground, UP, view, PictureScales(600.0, grain)) or (np.empty((0, 3)), FACES[:0])
    parent = np.arange(len(points))
    for _ in range(20):  # the least vertex of each pebble spreads over its faces
        for a, b in ((0, 1), (1, 2), (2, 0)):
            least = np.minimum(parent[faces[:, a]], parent[faces[:, b]])
            np.minimum.at(parent, faces[:, a], least)
            np.minimum.at(parent, faces[:, b], least)
    order = np.argsort(parent, kind="stable")
    groups = np.split(points[order], np.flatnonzero(np.diff(parent[order])) + 1) if len(points) else []
    return {tuple(group.mean(axis=0).round(6)): group for group in groups}


def test_two_cameras_see_the_same_pebbles_between_them() -> None:
    first, second = (pebbles(camera(x, 0.0), 4.0) for x in (-6.0, 6.0))
    middle = [
        {key for key, group in results.items() if np.hypot(key[0], key[2]) < 8 and np.ptp(group, axis=0).max() > 0.3}
        for results in (first, second)
    ]  # smaller ones are drawn near each camera
    assert middle[0] == middle[1] and len(middle[0]) > 20 and first.keys() != second.keys()


def test_crowds_of_other_sizes_share_the_pebbles_of_one_size() -> None:
    positions, widths = {}, {}
    for grain in (4.0, 8.0):
        results = pebbles(camera(0.0, 0.0, -12.0), grain)
        positions[grain] = np.array([(group.max(axis=0) + group.min(axis=0)) / 2 for group in results.values()])
        widths[grain] = np.array([np.ptp(group, axis=0).max() for group in results.values()])
    away = cKDTree(positions[8.0]).query(positions[4.0])[0]
    is_shared = away < 0.2 * widths[4.0]  # pebbles of the largest class are rounder
    assert is_shared[widths[4.0] > 0.26].all() and is_shared.sum() > 100
    assert (~is_shared).sum() > 100 and widths[8.0].max() > 1.5 * widths[4.0].max()


@pytest.mark.parametrize("grain", [2.0, 4.0, 5.6])
def test_no_pebble_is_higher_than_a_hundredth_of_a_body(grain: float) -> None:
    results = pebbles(camera(0.0, 0.0, -8.0), grain, meshes.grid(400.0, 100))
    heights = np.array([group[:, 1].max() for group in results.values()])
    assert len(results) > 100 and heights.min() > 0 and heights.max() <= 0.01 * grain


def test_far_cameras_see_none() -> None:
    assert not pebbles(camera(0.0, 0.0, 5_000.0), 4.0)
    assert scatter_pebbles(VERTICES, FACES[:0], UP, camera(0.0, 0.0), PictureScales(600.0, 4.0)) is None
