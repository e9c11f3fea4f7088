"""Writes terrain.ply, boulder.ply and stones.ply of this example: `python examples/foraging/make_ground.py`.

Millimetres, y up; 800 × 800 around the origin. The same numbers give the same files."""

# Where things lie (x, z; the height is the terrain's):
#   nest    (   0,    0)   on a low rise
#   apple   ( 120,   90)   150 from the nest, two stones in the way
#   donut   (-280,  175)   330 from the nest, beyond the gully and five stones
#   boulder (  70, -110)   about 65 in radius, half sunk: ants climb it
#   shelf   x 110..350, z about -215: a rock shelf that overhangs the ground below by 30

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, build_stone, compute_wave_noise, join_meshes

HERE = Path(__file__).parent
Array = NDArray[np.float64]

HILLS = (  # x, z, height, width
    (-210.0, -190.0, 95.0, 120.0),
    (250.0, 230.0, 62.0, 105.0),
    (-330.0, 320.0, 48.0, 110.0),
    (-40.0, 330.0, 30.0, 80.0),
    (0.0, 0.0, 10.0, 60.0),
)
BOULDER = (70.0, -110.0)
STONES = (  # x, z, half axes, seed
    (62.0, 42.0, (15.0, 12.0, 11.0), 11),
    (88.0, 78.0, (11.0, 10.0, 13.0), 12),
    (-70.0, 52.0, (20.0, 15.0, 16.0), 13),
    (-132.0, 70.0, (14.0, 13.0, 18.0), 14),
    (-168.0, 124.0, (22.0, 17.0, 15.0), 15),
    (-226.0, 130.0, (15.0, 12.0, 12.0), 16),
    (-232.0, 172.0, (12.0, 11.0, 14.0), 17),
    (30.0, 150.0, (24.0, 19.0, 18.0), 18),
    (180.0, 40.0, (26.0, 20.0, 22.0), 19),
    (-90.0, -75.0, (17.0, 15.0, 20.0), 20),
    (210.0, -70.0, (19.0, 14.0, 16.0), 21),
    (-30.0, 230.0, (28.0, 20.0, 22.0), 22),
    (-340.0, 40.0, (30.0, 24.0, 25.0), 23),
)


def smooth(value: Array, start: float, end: float) -> Array:
    t = np.clip((value - start) / (end - start), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def relief(x: Array, z: Array) -> Array:
    """Height of hills, gully and noise, without the shelf."""
    y = sum(
        (height * np.exp(-((x - cx) ** 2 + (z - cz) ** 2) / (2 * width**2)) for cx, cz, height, width in HILLS), np.zeros_like(x)
    )
    gully = x + 165.0 + 28.0 * np.sin(z / 62.0) - 0.25 * z  # runs along z, west of the nest
    y -= 26.0 * np.exp(-((gully / 24.0) ** 2)) * smooth(z, -120.0, -20.0)
    flat = np.stack([x, z], axis=1)
    return y + 7.0 * compute_wave_noise(flat, 3, 210.0, 3, fade=0.45) + 0.55 * compute_wave_noise(flat, 4, 26.0, 2)


def terrain(lines: int = 146) -> MeshArrays:
    """The ground, with the shelf: near its line the grid rises, leans out over itself, and comes back behind the lip."""
    line = np.linspace(-400.0, 400.0, lines)
    vertices, faces = build_flat_grid(line, line)
    x, z = vertices[:, 0], vertices[:, 2]
    along = smooth(x, 95.0, 170.0) * (1.0 - smooth(x, 300.0, 372.0))
    behind = (-215.0 + 14.0 * np.sin(x / 31.0)) - z  # how far a point lies behind the foot of the shelf
    rise = 30.0 * smooth(behind, -2.0, 16.0) + 5.0 * smooth(behind, 16.0, 30.0) + 20.0 * smooth(behind, 29.0, 44.0)
    back = 1.0 - smooth(behind, 60.0, 175.0)
    lean = 46.0 * smooth(behind, 13.0, 32.0) * back * along
    y = relief(x, z) + rise * along * (0.35 + 0.65 * back)
    return np.stack([x, y, z + lean], axis=1), faces


def boulder() -> MeshArrays:
    vertices, faces = build_stone(31, (68.0, 52.0, 60.0), detail=4, roughness=0.13)
    vertices += (
        0.9 * compute_wave_noise(vertices, 32, 22.0, 2)[:, None] * vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    )
    return on_ground(vertices, *BOULDER, sunk=2.0), faces


def stones() -> MeshArrays:
    """The obstacles, each sunk by a quarter of its height."""
    parts = [(build_stone(seed, radii, detail=2), (x, z), radii[1]) for x, z, radii, seed in STONES]
    return join_meshes([(on_ground(vertices, x, z, sunk=-0.45 * high), faces) for (vertices, faces), (x, z), high in parts])


def on_ground(vertices: Array, x: float, z: float, sunk: float) -> Array:
    height = float(relief(np.array([x]), np.array([z]))[0])
    return vertices + np.array([x, height - sunk, z])


def write(name: str, mesh: MeshArrays) -> None:
    vertices, faces = mesh
    # Rounded, so that the last bits of one machine's sine do not change the file.
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    write("terrain.ply", terrain())
    write("boulder.ply", boulder())
    write("stones.ply", stones())
