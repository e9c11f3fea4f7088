"""Writes ground.ply and stones.ply of this example: `python examples/foraging_study/make_ground.py`.

Millimetres, y up; the same numbers give the same files."""

# Where things lie (x, z; the height is the ground's):
#   home    (   0,   0)   in the middle of a hill, a ring that is open toward +z
#   apple   ( 115,  95)   150 from home
#   donut   (-250, 210)   325 from home
#   stones  beside both ways

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, build_stone, join_meshes

HERE = Path(__file__).parent
Array = NDArray[np.float64]

ACROSS, ALONG = (-320.0, 240.0), (-170.0, 300.0)  # the ground's edges in x and in z
RING, HEIGHT, WIDTH = 48.0, 16.0, 12.0  # of the hill round the nest
GAP = 32.0  # degrees to either side of +z
SWELLS = ((-180.0, -120.0, 24.0, 90.0), (200.0, 240.0, 22.0, 90.0), (-60.0, 290.0, 12.0, 70.0))  # x, z, height, width
STONES = (  # x, z, half axes, seed
    (84.0, 30.0, (13.0, 11.0, 11.0), 11),
    (60.0, 118.0, (12.0, 11.0, 14.0), 12),
    (-96.0, 132.0, (16.0, 14.0, 14.0), 13),
    (-180.0, 108.0, (15.0, 13.0, 18.0), 14),
    (-150.0, 200.0, (16.0, 14.0, 12.0), 15),
    (170.0, -40.0, (20.0, 17.0, 18.0), 16),
    (-110.0, -80.0, (18.0, 15.0, 16.0), 17),
    (30.0, 220.0, (18.0, 15.0, 16.0), 18),
)


def relief(x: Array, z: Array) -> Array:
    """Height: swells, and the hill with its opening."""
    y = sum((h * np.exp(-((x - cx) ** 2 + (z - cz) ** 2) / (2 * w**2)) for cx, cz, h, w in SWELLS), np.zeros_like(x))
    off = np.degrees(np.abs(np.arctan2(x, z)))  # 0 toward +z
    wall = np.clip((off - GAP) / 18.0, 0.0, 1.0)
    wall = wall * wall * (3.0 - 2.0 * wall)
    return y + HEIGHT * wall * np.exp(-(((np.hypot(x, z) - RING) / WIDTH) ** 2))


def lines(start: float, end: float) -> Array:
    """Close together at the hill, far apart elsewhere."""
    low = np.linspace(start, -84.0, round((-84.0 - start) / 22.0) + 1)
    high = np.linspace(84.0, end, round((end - 84.0) / 22.0) + 1)
    return np.concatenate([low[:-1], np.linspace(-84.0, 84.0, 29), high[1:]])


def ground() -> MeshArrays:
    vertices, faces = build_flat_grid(lines(*ACROSS), lines(*ALONG))
    vertices[:, 1] = relief(vertices[:, 0], vertices[:, 2])
    return vertices, faces


def stones() -> MeshArrays:
    """The obstacles, each sunk by a quarter of its height."""
    parts = []
    for x, z, radii, seed in STONES:
        vertices, faces = build_stone(seed, radii, detail=2)
        height = float(relief(np.array([x]), np.array([z]))[0])
        parts.append((vertices + np.array([x, height + 0.45 * radii[1], z]), faces))
    return join_meshes(parts)


def write(name: str, mesh: MeshArrays) -> None:
    vertices, faces = mesh
    # Rounded, so that the last bits of one machine's sine do not change the file.
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    write("ground.ply", ground())
    write("stones.ply", stones())
