"""How far faces are from creases and from other pieces: never more than they are, and found with few questions."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from antdsl.casting.faces import nearest_on_triangle
from antdsl.casting.rays import RayScene
from antdsl.ground.mesh.creases import clear_of_rises
from antdsl.ground.mesh.topology import Topology, build

Floats = NDArray[np.float64]


def field_of_stones(count: int, offset: float = 0.0) -> tuple[Floats, Topology]:
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
    return vertices[faces], build(vertices, faces, np.zeros(len(faces), np.int32), extent)


@pytest.mark.parametrize("offset", [0.0, 50_000.0])
def test_no_other_piece_is_nearer(offset: float) -> None:
    corners, table = field_of_stones(12, offset)
    clear = clear_of_rises(corners, table)
    assert table.pieces == 14 and (clear > 0).any()
    for face in np.random.default_rng(4).choice(len(corners), 60, replace=False):
        others = corners[table.piece != table.piece[face]]
        middle = np.broadcast_to(corners[face].mean(axis=0), (len(others), 3))
        away = np.sqrt(((nearest_on_triangle(middle, others) - middle) ** 2).sum(axis=1)).min()
        radius = np.sqrt(((corners[face] - middle[0]) ** 2).sum(axis=1)).max()
        least = max(away - radius, 0.0)
        assert clear[face] <= least
        if not table.cuts.cut[face] and away < 0.1 * 400:
            assert clear[face] >= least - 0.3, "spheres and a plane have no creases: it is near what can be known"


def test_many_pieces_are_asked_no_more_of_than_few(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, built = 0, 0
    closest, fill = RayScene.closest, RayScene._fill

    def count_places(scene: RayScene, points: Floats, *rest: object) -> object:
        nonlocal asked
        asked += len(points)
        return closest(scene, points, *rest)  # type: ignore[arg-type]

    def count_faces(scene: RayScene, meshes: list[tuple[Floats, NDArray[np.int32]]]) -> None:
        nonlocal built
        built += sum(len(faces) for _, faces in meshes)
        fill(scene, meshes)

    monkeypatch.setattr(RayScene, "closest", count_places)
    monkeypatch.setattr(RayScene, "_fill", count_faces)
    for count in (6, 60):
        corners, table = field_of_stones(count)
        asked = built = 0
        clear_of_rises(corners, table)
        assert built == len(corners)
        assert len(corners) / 2 < asked < 4 * len(corners), (count, asked)
