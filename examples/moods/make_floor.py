"""Writes floor.ply and stones.ply of this example: `python examples/moods/make_floor.py`.

Millimetres, y up: an uneven floor 1200 × 1200 about the origin, and four stones on it."""

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, build_stone, compute_wave_noise, join_meshes

HERE = Path(__file__).parent
STONES = (  # x, z, half axes, seed
    (-40.0, -190.0, (46.0, 26.0, 38.0), 41),
    (200.0, -30.0, (40.0, 30.0, 52.0), 42),
    (60.0, 190.0, (52.0, 24.0, 40.0), 43),
    (-210.0, 60.0, (38.0, 28.0, 42.0), 44),
)


def height(x: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(5.0 * compute_wave_noise(np.stack([x, z], axis=1), 9, 240.0, 2))


def on_floor(x: float, z: float) -> float:
    return float(height(np.array([x]), np.array([z]))[0])


def floor(lines: int = 61) -> MeshArrays:
    line = np.linspace(-600.0, 600.0, lines)
    vertices, faces = build_flat_grid(line, line)
    vertices[:, 1] = height(vertices[:, 0], vertices[:, 2])
    return vertices, faces


def stones() -> MeshArrays:
    """Half sunk, so that nobody gets beneath."""
    parts = [(build_stone(seed, axes, detail=2), (x, z)) for x, z, axes, seed in STONES]
    return join_meshes([(points + np.array([x, on_floor(x, z), z]), faces) for (points, faces), (x, z) in parts])


def write(name: str, mesh: MeshArrays) -> None:
    made = trimesh.Trimesh(np.round(mesh[0], 3), mesh[1], process=False)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    write("floor.ply", floor())
    write("stones.ply", stones())
