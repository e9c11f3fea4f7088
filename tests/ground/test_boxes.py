"""What straight ways meet first is what a look at every triangle finds."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import ball, terrain
from numpy.typing import NDArray
from open_shapes import joined, soup

from antdsl.ground.mesh.boxes import FaceBoxes, FaceList, find_first_face_hit, list_faces_near_segment
from antdsl.ground.mesh.surface import MeshGround

Floats = NDArray[np.float64]
N = 600


def scene(far: float = 0.0) -> MeshGround:
    """A soup of triangles beside a ball and hills, slivers and flat faces among them."""
    vertices, faces = joined([soup(400), ball(6, (9, 2, 0), 9), terrain(60, 20)])
    squeezed = vertices[faces[:100]]
    squeezed[:, 2] = squeezed[:, :2].mean(axis=1) + 1e-4
    mesh = joined([(vertices, faces), (squeezed.reshape(-1, 3), np.arange(300).reshape(-1, 3))])
    return MeshGround({"all": (mesh[0] + far, mesh[1])})


def random_steps(ground: MeshGround, rng: np.random.Generator) -> tuple[Floats, Floats]:
    corners = ground._vertices[ground._faces[rng.integers(0, len(ground._faces), N)]]
    aim = (corners * rng.dirichlet((0.4, 0.4, 0.4), N)[:, :, None]).sum(axis=1)
    step = rng.normal(size=(N, 3)) * rng.choice([0.01, 1.0, 20.0], (N, 1))
    step[::7] = (corners[:, 1] - corners[:, 0])[::7]  # along an edge
    return (aim - step * rng.choice([0.0, 0.3, 0.5, 1.0, 1.2], (N, 1))).T, step.T


def first_met(ground: MeshGround, origin: Floats, step: Floats, face: int, piece: int) -> tuple[int, float, float, float]:
    """The first face on a way that goes on by a millionth of a mm: the kernel's functions, as Python runs them."""
    table, boxes = ground.triangles[3], ground._box_tree.to_box_tree()
    face_list = FaceList(np.empty(len(table.is_live), np.int64), 0)
    one, displacement = tuple(origin.tolist()), tuple(step.tolist())
    with np.errstate(all="ignore"):
        count = list_faces_near_segment(table.piece, boxes, one, tuple((origin + step).tolist()), 0.01, face, piece, face_list)
        hit = find_first_face_hit(ground._get_walk_tables().packed_table, boxes, face_list, count, one, displacement, 1e-6)
    return hit.face, hit.path_fraction, *hit.weights


@pytest.mark.parametrize("far", [0.0, 900.0])
def test_the_first_triangle_of_a_way_is_that_of_a_look_at_all(far: float) -> None:
    ground, rng = scene(far), np.random.default_rng(2)
    table = ground.triangles[3]
    origin, step = random_steps(ground, rng)
    face, piece = np.full(N, -1), np.full(N, -1, np.int32)
    face[::2] = rng.integers(0, table.is_live.size, N // 2)
    piece[::3] = table.piece[rng.integers(0, table.is_live.size, N // 3)]
    each = [first_met(ground, origin[:, k], step[:, k], face[k], piece[k]) for k in range(N)]
    hits, part, b1, b2 = (np.array(column) for column in zip(*each, strict=True))
    a, e1, e2 = table.corner.T, table.edge1.T, table.edge2.T
    hit_count = 0
    for k in range(N):
        o, d = origin[:, k], step[:, k]
        p = np.cross(d, e2)
        det = (e1 * p).sum(axis=1)
        with np.errstate(all="ignore"):
            u, v = ((o - a) * p).sum(axis=1) / det, (np.cross(o - a, e1) @ d) / det
            t = (e2 * np.cross(o - a, e1)).sum(axis=1) / det
        slant = np.abs(det) / np.sqrt((d @ d) * (e1 * e1).sum(axis=1) * (e2 * e2).sum(axis=1))
        candidates = table.is_live & (np.arange(len(a)) != face[k]) & (table.piece != piece[k]) & (slant > 1e-9)
        surely = candidates & (u > 1e-7) & (v > 1e-7) & (u + v < 1 - 1e-7) & (t > 1e-7) & (t < 1 - 1e-7)
        maybe = candidates & (u > -1e-7) & (v > -1e-7) & (u + v < 1 + 1e-7) & (t > -1e-7) & (t < 1 + 1e-3)
        if hits[k] >= 0:
            assert maybe[hits[k]] and abs(t[hits[k]] - part[k]) < 1e-7
            assert abs(u[hits[k]] - b1[k]) < 1e-7 and abs(v[hits[k]] - b2[k]) < 1e-7
            assert not surely.any() or part[k] <= t[surely].min() + 1e-9
            hit_count += 1
        else:
            assert not surely.any()
    assert hit_count > 0.3 * N


def test_refitted_boxes_are_those_that_are_built_afresh() -> None:
    ground, rng = scene(), np.random.default_rng(3)
    vertices, faces, live = ground._vertices, ground._faces, np.flatnonzero(ground.triangles[3].is_live)
    group = (ground._vertices[faces[:, 0], 0] > 0).astype(np.int32)
    moved_vertices = vertices @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) * 1.5 + 7.0
    loose = np.unique(faces[group == 1])
    moved_vertices[np.setdiff1d(np.arange(len(vertices)), loose)] = vertices[np.setdiff1d(np.arange(len(vertices)), loose)]
    faces = faces.copy()
    held = np.isin(faces, loose).any(axis=1)
    boxes = FaceBoxes.build(vertices, faces, live, held.astype(np.int32))
    fresh = FaceBoxes.build(moved_vertices, faces, live, held.astype(np.int32))
    boxes.refit_boxes(moved_vertices, faces, int((~held[live]).sum()))
    moved, corners = moved_vertices[faces], faces
    low = rng.uniform(-15, 30, (3, 50))
    for high in (low + 0.1, low + 8.0):
        pairs = [
            np.sort(ray * len(corners) + face) for ray, face in (b.find_overlapping_pairs(low, high) for b in (boxes, fresh))
        ]
        beside = (moved.min(axis=1)[:, None] <= high.T).all(axis=2) & (moved.max(axis=1)[:, None] >= low.T).all(axis=2)
        moved_vertices, ray = np.nonzero(beside & ground.triangles[3].is_live[:, None])
        assert np.array_equal(pairs[0], pairs[1]) and np.array_equal(pairs[0], np.sort(ray * len(corners) + moved_vertices))


def test_ground_without_a_triangle_is_met_nowhere() -> None:
    ground = MeshGround({"none": (np.zeros((3, 3)), np.array([[0, 1, 2]]))})
    assert first_met(ground, np.zeros(3), np.ones(3), -1, -1)[0] == -1
