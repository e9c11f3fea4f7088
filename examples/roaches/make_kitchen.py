"""Writes floor.ply, wall.ply and legs.ply of this example: `python examples/roaches/make_kitchen.py`.

Millimetres, y up: a kitchen floor of 2.4 × 2 m with a wall behind it, the legs of a table and of two chairs. The floor and the
wall are the area that roaches are allowed on, of few faces. The same numbers give the same files."""

from pathlib import Path

import numpy as np
import trimesh

from antdsl.bodies.shapes import build_flat_grid

HERE = Path(__file__).parent
WIDE, DEEP, HIGH = 2400.0, 2000.0, 900.0
TABLE = [(x, z) for x in (-450.0, 450.0) for z in (-250.0, 350.0)]
CHAIRS = [(a + x, b + z) for a, b in ((-800.0, 100.0), (700.0, 500.0)) for x in (-170.0, 170.0) for z in (-170.0, 170.0)]


def floor() -> trimesh.Trimesh:
    vertices, faces = build_flat_grid(np.linspace(-WIDE / 2, WIDE / 2, 25), np.linspace(-DEEP / 2, DEEP / 2, 21))
    return trimesh.Trimesh(vertices, faces, process=False)


def wall() -> trimesh.Trimesh:
    """Along the far rim of the floor; it faces the room."""
    vertices, faces = build_flat_grid(np.linspace(-WIDE / 2, WIDE / 2, 25), np.linspace(0.0, HIGH, 10))
    upright = np.stack([vertices[:, 0], HIGH - vertices[:, 2], np.full(len(vertices), -DEEP / 2)], axis=1)
    return trimesh.Trimesh(upright, faces, process=False)


def legs() -> trimesh.Trimesh:
    made = []
    for places, radius, high in ((TABLE, 32.0, 700.0), (CHAIRS, 18.0, 430.0)):
        for x, z in places:
            leg = trimesh.creation.cylinder(radius, high, sections=16)
            leg.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
            leg.apply_translation((x, high / 2 - 5.0, z))
            made.append(leg)
    whole = trimesh.util.concatenate(made)
    return trimesh.Trimesh(np.round(whole.vertices, 3), whole.faces, process=False)


if __name__ == "__main__":
    for name, mesh in (("floor", floor()), ("wall", wall()), ("legs", legs())):
        (HERE / f"{name}.ply").write_bytes(mesh.export(file_type="ply", vertex_normal=False))
