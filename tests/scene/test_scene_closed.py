"""Which meshes close to a body, and which look inward."""

from __future__ import annotations

from pathlib import Path

import meshes
import numpy as np
import pytest
import trimesh
from test_scene_files import SCENE, folder, opened  # noqa: F401

from antdsl.scene.geometry.closed_meshes import count_inward_pieces, count_open_edges_and_sides

BALL = meshes.ball(10.0)
SMALL = meshes.ball(4.0)


def turned(mesh: meshes.Mesh) -> meshes.Mesh:
    return mesh[0], mesh[1][:, ::-1]


def both(one: meshes.Mesh, two: meshes.Mesh) -> meshes.Mesh:
    return np.concatenate([one[0], two[0]]), np.concatenate([one[1], two[1] + len(one[0])])


def moved(mesh: meshes.Mesh, by: float) -> meshes.Mesh:
    return mesh[0] + by, mesh[1]


def one_turned(mesh: meshes.Mesh) -> meshes.Mesh:
    faces = mesh[1].copy()
    faces[len(faces) // 2] = faces[len(faces) // 2, ::-1]
    return mesh[0], faces


def torn(mesh: meshes.Mesh) -> meshes.Mesh:
    return mesh[0], mesh[1][1:]


@pytest.mark.parametrize(
    ("mesh", "inward", "mixed"),
    [
        (BALL, 0, 0),
        (turned(BALL), 1, 0),
        (moved(BALL, 1e6), 0, 0),
        (turned(moved(BALL, -1e6)), 1, 0),
        (both(BALL, turned(SMALL)), 0, 0),  # a hollow
        (both(BALL, moved(turned(SMALL), 30.0)), 1, 0),
        (both(turned(BALL), moved(turned(BALL), 30.0)), 2, 0),
        (one_turned(BALL), 0, 1),
        (torn(turned(BALL)), 0, 0),  # neither side is inside
        (torn(one_turned(BALL)), 0, 0),
        ((BALL[0][BALL[1]].reshape(-1, 3), np.arange(3 * len(BALL[1])).reshape(-1, 3)[:, ::-1]), 1, 0),  # corners not joined
        ((np.zeros((0, 3)), np.zeros((0, 3), np.int32)), 0, 0),
    ],
)
def test_pieces_that_look_inward(mesh: meshes.Mesh, inward: int, mixed: int) -> None:
    assert meshes.outward(BALL)
    assert count_inward_pieces(mesh[0], mesh[1].astype(np.int32)) == (inward, mixed)


def test_random_order_of_faces_and_corners_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    for trial in range(10):
        pieces = [moved(turned(BALL) if rng.random() < 0.5 else BALL, 40.0 * k) for k in range(4)]
        expected = sum(not meshes.outward(moved(piece, 0.0)) for piece in pieces)
        vertices, faces = pieces[0]
        for piece in pieces[1:]:
            vertices, faces = both((vertices, faces), piece)
        faces = np.array([np.roll(face, rng.integers(3)) for face in faces[rng.permutation(len(faces))]])
        assert count_inward_pieces(vertices, faces.astype(np.int32)) == (expected, 0), trial


def test_edges_that_border_on_nothing() -> None:
    corners = np.round(BALL[0][BALL[1]] * 1000).astype(np.int64)
    assert count_open_edges_and_sides(corners) == (0, True)
    assert count_open_edges_and_sides(corners[1:]) == (3, False)
    assert count_open_edges_and_sides(np.round(one_turned(BALL)[0][one_turned(BALL)[1]] * 1000).astype(np.int64)) == (0, False)
    assert count_open_edges_and_sides(corners[:0]) == (0, True)


@pytest.mark.parametrize(
    ("mesh", "words"),
    [(BALL, None), (turned(BALL), "parts of the obstacle `stone` point inward"), (one_turned(BALL), "point both in and out")],
)
def test_an_obstacle_that_looks_inward_is_warned_of(folder: Path, mesh: meshes.Mesh, words: str | None) -> None:  # noqa: F811
    (folder / "stone.ply").write_bytes(trimesh.Trimesh(*mesh, process=False).export(file_type="ply"))
    program = (folder / "ant.ant").read_text()
    (folder / "ant.ant").write_text(program.replace("surface ground", "surface ground; obstacle stone"))
    shot, report = opened(folder, SCENE.replace("  food:", "  stone: {mesh: stone.ply}\n  food:"))
    assert shot is not None
    warnings = [d for d in report.diagnostics if d.code == "inside-out"]
    assert len(warnings) == (words is not None) and all(words in d.message and d.severity == "warning" for d in warnings)  # type: ignore[operator]
    assert all(d.span is not None and d.span.text == "{mesh: stone.ply}" for d in warnings)
