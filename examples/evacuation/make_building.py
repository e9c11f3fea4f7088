"""Writes floor.ply and walls.ply of this example: `python examples/evacuation/make_building.py`.

Metres, y up. A corridor of 24 × 2.5 m along x with three rooms on one side and two on the other; an exit at its east end and one
in the outer wall of the south-west room. The same numbers give the same files."""

from pathlib import Path

import numpy as np
import trimesh

from antdsl.bodies.shapes import build_flat_grid

HERE = Path(__file__).parent
THICK, HIGH = 0.2, 1.1  # m; so low that one sees over them
ROOM_DOOR, EXIT_DOOR = 1.0, 1.4
EAST, SOUTH = 12.0, 8.0  # of the outer walls
CORRIDOR = 1.35  # from its middle to the middle of its walls

# Walls along x: z, from, to, middles of doors and how wide these are; walls along z likewise.
ALONG_X = (
    (-SOUTH, -EAST, EAST, (), 0.0),
    (-CORRIDOR, -EAST, EAST, (-8.0, 0.0, 8.0), ROOM_DOOR),
    (CORRIDOR, -EAST, EAST, (-2.0, 6.0), ROOM_DOOR),
    (SOUTH, -EAST, EAST, (-8.0,), EXIT_DOOR),
)
ALONG_Z = (
    (-EAST, -SOUTH, SOUTH, (), 0.0),
    (-4.0, -SOUTH, -CORRIDOR, (), 0.0),
    (4.0, -SOUTH, -CORRIDOR, (), 0.0),
    (0.0, CORRIDOR, SOUTH, (), 0.0),
    (EAST, -SOUTH, SOUTH, (0.0,), EXIT_DOOR),
)


def pieces(begin: float, end: float, doors: tuple[float, ...], width: float) -> list[tuple[float, float]]:
    """What doors leave of a wall."""
    cuts = [begin, *(at + side * width / 2 for at in doors for side in (-1, 1)), end]
    return list(zip(cuts[::2], cuts[1::2], strict=True))


def walls() -> trimesh.Trimesh:
    boxes = []
    for along_x, rows in ((True, ALONG_X), (False, ALONG_Z)):
        for at, begin, end, doors, width in rows:
            # Walls along z end where those along x begin: boxes do not stand in each other.
            over = THICK / 2 if along_x else -THICK / 2
            for a, b in pieces(begin, end, doors, width):
                a, b = (a - over if a == begin else a), (b + over if b == end else b)
                box = trimesh.creation.box((b - a, HIGH, THICK) if along_x else (THICK, HIGH, b - a))
                box.apply_translation(((a + b) / 2, HIGH / 2, at) if along_x else (at, HIGH / 2, (a + b) / 2))
                boxes.append(box)
    return trimesh.util.concatenate(boxes)


def floor() -> trimesh.Trimesh:
    vertices, faces = build_flat_grid(np.linspace(-15.0, 21.0, 73), np.linspace(-11.0, 15.0, 53))
    return trimesh.Trimesh(vertices, faces, process=False)


if __name__ == "__main__":
    for name, mesh in (("floor", floor()), ("walls", walls())):
        (HERE / f"{name}.ply").write_bytes(mesh.export(file_type="ply", vertex_normal=False))
