"""The surface of a solid as triangles: on the zero level, closed across bricks, seen from the air, and made again where dug."""

from __future__ import annotations

from collections.abc import Iterable

import meshes
import numpy as np
import pytest

from antdsl.ground.solid import Volume

Pieces = dict[int, tuple[np.ndarray, np.ndarray]]


def make_solid(mesh: meshes.Mesh, voxel: float = 1.0) -> Volume:
    solid = Volume.from_mesh(*mesh, voxel)
    assert isinstance(solid, Volume)
    return solid


def joined(pieces: Iterable[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Pieces in one mesh, vertices with the same coordinates made one."""
    vertices, faces, count = [], [], 0
    for v, f in pieces:
        vertices.append(v)
        faces.append(f + count)
        count += len(v)
    points, name = np.unique(np.concatenate(vertices), axis=0, return_inverse=True)
    return points, name.reshape(-1)[np.concatenate(faces)]


def unpaired(faces: np.ndarray) -> int:
    """Edges that are not passed as often one way as the other."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    key = edges.min(axis=1) * (faces.max() + 1) + edges.max(axis=1)
    names, at = np.unique(key, return_inverse=True)
    balance = np.bincount(at.reshape(-1), np.where(edges[:, 0] < edges[:, 1], 1, -1), len(names))
    return int(np.count_nonzero(balance))


def volume_of(vertices: np.ndarray, faces: np.ndarray) -> float:
    v = vertices[faces]
    return float((np.cross(v[:, 0], v[:, 1]) * v[:, 2]).sum() / 6)


@pytest.mark.parametrize(
    ("mesh", "voxel"), [(meshes.box((-20, -20, -20), (20, 20, 20)), 1.0), (meshes.ball(20.0, rings=30), 0.8)]
)
def test_a_whole_surface_is_closed_and_seen_from_outside(mesh: meshes.Mesh, voxel: float) -> None:
    solid = make_solid(mesh, voxel)
    vertices, faces = joined((v, f) for _, v, f in solid.iterate_brick_meshes())
    assert unpaired(faces) == 0
    assert abs(volume_of(vertices, faces) / solid.measure_volume() - 1) < 0.01
    assert np.abs(solid.sample_distances(vertices)).max() < 2e-3 * voxel


def test_only_what_changed_is_made_again_and_fits_the_rest() -> None:
    solid, rng = make_solid(meshes.box((-20, -20, -20), (20, 20, 20))), np.random.default_rng(2)
    pieces: Pieces = {key: (v, f) for key, v, f in solid.iterate_brick_meshes()}
    piece_count = len(pieces)
    assert not list(solid.iterate_brick_meshes())
    for turn in range(4):
        middle = rng.uniform(-12, 12, (1, 3))
        solid.carve_balls(middle + rng.uniform(-6, 6, (15, 3)), rng.uniform(1, 4, 15), np.arange(15))
        changed = {key: (v, f) for key, v, f in solid.iterate_brick_meshes()}
        assert 0 < len(changed) < piece_count
        pieces |= changed
        vertices, faces = joined(pieces.values())
        assert unpaired(faces) == 0, turn
        assert abs(volume_of(vertices, faces) / solid.measure_volume() - 1) < 0.02
    again: Pieces = {key: (v, f) for key, v, f in solid.iterate_brick_meshes(changed_only=False)}
    for key, (v, f) in pieces.items():
        counterpart = again.get(key, (np.empty((0, 3)), np.empty((0, 3), np.int32)))
        assert np.array_equal(v, counterpart[0]) and np.array_equal(f, counterpart[1])
    assert not [key for key, (_, f) in again.items() if len(f) and key not in pieces]


def test_a_brick_that_was_dug_away_is_given_without_faces() -> None:
    solid = make_solid(meshes.ball(10.0))
    old_keys = {key for key, _, f in solid.iterate_brick_meshes() if len(f)}
    solid.carve_balls(np.zeros((1, 3)), np.array([30.0]), np.array([0]))
    new_counts = {key: len(f) for key, _, f in solid.iterate_brick_meshes()}
    assert old_keys and all(new_counts[key] == 0 for key in old_keys)


def test_a_restored_solid_has_the_same_surface() -> None:
    a, b = (make_solid(meshes.ball(12.0)) for _ in range(2))
    a.carve_balls(np.array([[0.0, 12, 0], [3.0, 9, 0]]), np.array([4.0, 3.0]), np.arange(2))
    b.restore_changes(a.get_changes())
    for (key, v, f), (other, w, g) in zip(a.iterate_brick_meshes(), b.iterate_brick_meshes(), strict=True):
        assert key == other and np.array_equal(v, w) and np.array_equal(f, g)
