"""Writes the meshes and the curve of this example: `python examples/pedestrians/make_corridor.py`.

Metres, y up. A round corridor of 40 m by 2.5 m has 100 square metres; a room of 8 by 9 m has a passage 2 m long, in four widths.
The same numbers give the same files."""

import json
from pathlib import Path

import numpy as np
import trimesh

from antdsl.bodies.shapes import build_flat_grid

HERE = Path(__file__).parent
RADIUS, WIDTH, SIDES = 40 / (2 * np.pi), 2.5, 96  # of the middle of the corridor (m); corners of its circles
THICK, HIGH, DEEP = 0.3, 1.1, 0.2  # m; walls begin below the floor
ROOM_LENGTH, ROOM_WIDTH, PASSAGE_LENGTH = 9.0, 8.0, 2.0  # m
PASSAGE_WIDTHS = (0.8, 1.2, 1.6, 2.4)  # m


def build_ring(inner: float, outer: float) -> trimesh.Trimesh:
    """Return a wall between two circles."""
    ring = trimesh.creation.annulus(r_min=inner, r_max=outer, height=HIGH + DEEP, sections=SIDES)
    ring.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    ring.apply_translation((0, (HIGH - DEEP) / 2, 0))
    return ring


def build_box(x: tuple[float, float], z: tuple[float, float]) -> trimesh.Trimesh:
    """Return a wall over a rectangle."""
    box = trimesh.creation.box((x[1] - x[0], HIGH + DEEP, z[1] - z[0]))
    box.apply_translation((sum(x) / 2, (HIGH - DEEP) / 2, sum(z) / 2))
    return box


def build_floor(x: tuple[float, float], z: tuple[float, float]) -> trimesh.Trimesh:
    """Return a flat rectangle of cells of 1 m."""
    axes = [np.linspace(low, high, round(high - low) + 1) for low, high in (x, z)]
    return trimesh.Trimesh(*build_flat_grid(*axes), process=False)


def build_room(width: float) -> trimesh.Trimesh:
    """Return the walls of a room whose passage has this width."""
    side = ROOM_WIDTH / 2
    parts = [
        build_box((0, PASSAGE_LENGTH), (width / 2, side + THICK)),
        build_box((0, PASSAGE_LENGTH), (-side - THICK, -width / 2)),
        build_box((-ROOM_LENGTH - THICK, 0), (side, side + THICK)),
        build_box((-ROOM_LENGTH - THICK, 0), (-side - THICK, -side)),
        build_box((-ROOM_LENGTH - THICK, -ROOM_LENGTH), (-side, side)),
    ]
    return trimesh.util.concatenate(parts)


if __name__ == "__main__":
    inner, outer = RADIUS - WIDTH / 2, RADIUS + WIDTH / 2
    trimesh.util.concatenate([build_ring(inner - THICK, inner), build_ring(outer, outer + THICK)]).export(HERE / "corridor.ply")
    ring = trimesh.creation.annulus(r_min=inner - THICK / 2, r_max=outer + THICK / 2, height=1, sections=SIDES)
    top = ring.submesh([np.flatnonzero(ring.face_normals[:, 2] > 0.9)], append=True)
    vertices = np.column_stack((top.vertices[:, 0], np.zeros(len(top.vertices)), -top.vertices[:, 1]))
    trimesh.Trimesh(vertices, top.faces, process=False).export(HERE / "corridor_floor.ply")
    angles = np.linspace(0, 2 * np.pi, 145)
    points = np.column_stack((RADIUS * np.cos(angles), np.zeros(145), RADIUS * np.sin(angles)))
    (HERE / "round.json").write_text(json.dumps(points.round(4).tolist()) + "\n", encoding="utf-8")
    build_floor((-11, 12), (-12, 12)).export(HERE / "floor.ply")
    for width in PASSAGE_WIDTHS:
        build_room(width).export(HERE / f"passage_{round(100 * width)}.ply")
