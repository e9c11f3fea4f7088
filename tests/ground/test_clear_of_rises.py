"""How far faces are from creases and from other pieces: never more than they are, and found with few questions."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from torture_walks import shapes

from antdsl.casting.faces import find_nearest_on_triangle
from antdsl.casting.rays import RayScene
from antdsl.ground.mesh.creases import SlopeMap, compute_slope_clearance, find_inner_creases
from antdsl.ground.mesh.topology import MeshTopology, build_topology

Floats = NDArray[np.float64]


def field_of_stones(count: int, offset: float = 0.0) -> tuple[Floats, MeshTopology]:
    """A plane with spheres of several sizes in it, on it, above it and in each other: their corners (m, 3, 3) and tables."""
    random = np.random.default_rng(2)
    plane = trimesh.creation.box((400.0, 400.0, 0.0)).subdivide_to_size(25.0)
    plane = trimesh.Trimesh(plane.vertices, plane.faces[plane.face_normals[:, 2] > 0.5], process=False)
    parts = [plane]
    for _ in range(count):
        ball = trimesh.creation.icosphere(subdivisions=2, radius=random.uniform(2, 12))
        parts.append(ball.apply_translation([*random.uniform(-150, 150, 2), random.uniform(-5, 40)]))
    parts.append(trimesh.creation.icosphere(subdivisions=1, radius=3).apply_translation([0, 0, 900]))
    mesh = trimesh.util.concatenate(parts)
    vertices, faces = np.asarray(mesh.vertices, np.float64) + offset, np.asarray(mesh.faces, np.int32)
    extent = float((vertices.max(axis=0) - vertices.min(axis=0)).max())
    return vertices[faces], build_topology(vertices, faces, np.zeros(len(faces), np.int32), extent)


@pytest.mark.parametrize("offset", [0.0, 50_000.0])
def test_no_other_piece_is_nearer(offset: float) -> None:
    corners, table = field_of_stones(12, offset)
    clear = compute_slope_clearance(corners, table, find_inner_creases(table, corners))
    assert table.piece_count == 14 and (clear > 0).any()
    for face in np.random.default_rng(4).choice(len(corners), 60, replace=False):
        others = corners[table.piece != table.piece[face]]
        middle = np.broadcast_to(corners[face].mean(axis=0), (len(others), 3))
        away = np.sqrt(((find_nearest_on_triangle(middle, others) - middle) ** 2).sum(axis=1)).min()
        radius = np.sqrt(((corners[face] - middle[0]) ** 2).sum(axis=1)).max()
        least = max(away - radius, 0.0)
        assert clear[face] <= least
        if not table.cuts.is_cut[face] and away < 0.1 * 400:
            assert clear[face] >= least - 0.3, "spheres and a plane have no creases: it is near what can be known"


def test_no_face_that_cuts_its_own_piece_is_nearer() -> None:
    vertices, faces = shapes().SHAPES["eight"]()
    table = build_topology(vertices, faces, np.zeros(len(faces), np.int32), 80.0)
    corners = vertices[faces]
    clear, cut = compute_slope_clearance(corners, table, np.empty(0, np.int64)), np.flatnonzero(table.cuts.is_cut)
    assert table.piece_count == 1 and 0 < len(cut) < len(faces) / 2 and not clear[cut].any()
    for face in np.random.default_rng(4).choice(np.flatnonzero(~table.cuts.is_cut), 40, replace=False):
        middle = np.broadcast_to(corners[face].mean(axis=0), (len(cut), 3))
        away = np.sqrt(((find_nearest_on_triangle(middle, corners[cut]) - middle) ** 2).sum(axis=1)).min()
        least = max(away - np.sqrt(((corners[face] - middle[0]) ** 2).sum(axis=1)).max(), 0.0)
        assert least - 0.1 <= clear[face] <= least


def test_many_pieces_need_no_more_lookups_than_few(monkeypatch: pytest.MonkeyPatch) -> None:
    point_count, built = 0, 0
    closest, fill = RayScene.find_closest, RayScene._set_meshes

    def count_places(scene: RayScene, points: Floats, *rest: object) -> object:
        nonlocal point_count
        point_count += len(points)
        return closest(scene, points, *rest)  # type: ignore[arg-type]

    def count_faces(scene: RayScene, meshes: list[tuple[Floats, NDArray[np.int32]]]) -> None:
        nonlocal built
        built += sum(len(faces) for _, faces in meshes)
        fill(scene, meshes)

    monkeypatch.setattr(RayScene, "find_closest", count_places)
    monkeypatch.setattr(RayScene, "_set_meshes", count_faces)
    for count in (6, 60):
        corners, table = field_of_stones(count)
        point_count = built = 0
        compute_slope_clearance(corners, table, find_inner_creases(table, corners))
        assert built == len(corners)
        assert len(corners) / 2 < point_count < 4 * len(corners), (count, point_count)


def test_every_point_with_a_rise_is_named_with_few_others() -> None:
    """By distances in float64 to every crease and every face of another piece or a cut one."""
    corners, table = field_of_stones(12)
    rng, first = np.random.default_rng(3), np.array([0, 400, len(corners)])
    face = rng.integers(0, len(corners), 300)
    mesh = (face >= 400).astype(np.int32)
    place = (corners[face] * rng.dirichlet((1, 1, 1), 300)[:, :, None]).sum(axis=1)
    reach = rng.choice([0.5, 3.0, 7.3, 20.0, 100.0, 2e3], 300)
    local, where, reach[:4] = (face - first[mesh]).astype(np.int32), mesh.copy(), [0.0, -1.0, np.nan, 5.0]
    where[3:5], local[5], where[6] = -1, -1, 2
    map_, width = SlopeMap(corners, table, [], find_inner_creases(table, corners)), max(np.ptp(corners, axis=(0, 1))) / 192
    rows = map_.find_rows_near_slopes(where, local, first, place, reach, [], 2)
    assert (np.diff(rows) > 0).all() and not np.isin(range(7), rows).any()
    half = find_inner_creases(table, corners)
    one, two = (corners[half // 3, (half % 3 + k) % 3] for k in (1, 2))
    sharp = np.stack([one, two, two], axis=1)
    clear, size = (
        compute_slope_clearance(corners, table, find_inner_creases(table, corners)),
        np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1),
    )
    for k in range(7, 300):
        others = np.concatenate([sharp, corners[(table.piece != table.piece[face[k]]) | table.cuts.is_cut]])
        at = np.broadcast_to(place[k], (len(others), 3))
        away = np.sqrt(((find_nearest_on_triangle(at, others) - at) ** 2).sum(axis=1)).min()
        near = clear[face[k]] <= reach[k]
        if away <= reach[k]:
            assert k in rows
        if not near or (size[face[k]] > reach[k] and away > 2 * max(reach[k], width) + 5 * width):
            assert k not in rows
        if near and size[face[k]] <= reach[k]:
            assert k in rows
        alone = map_.find_rows_near_slopes(where[k : k + 1], local[k : k + 1], first, place[k : k + 1], reach[k : k + 1], [])
        assert len(alone) == (k in rows)
    assert 50 < len(rows) < 250
    moving = SlopeMap(corners, table, [np.arange(len(corners)) < 400], find_inner_creases(table, corners))
    box = (np.array([-50.0, -50, -9]), np.array([50.0, 50, 40]))
    inside = ((place >= box[0] - reach[:, None]) & (place <= box[1] + reach[:, None])).all(axis=1) & (np.arange(300) >= 7)
    rows = moving.find_rows_near_slopes(where, local, first, place, reach, [box])
    assert np.isin(np.flatnonzero(inside), rows).all() and len(rows) < 293
    assert not len(map_.find_rows_near_slopes(where[:0], local[:0], first, place[:0], reach[:0], []))
