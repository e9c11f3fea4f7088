"""Writes terrain.ply and hill.ply of this example: `python examples/tunnel/make_ground.py`.

Millimetres, y up; a valley 320 × 200 along x, with a hill across it. The same numbers give the same files."""

# Where things lie (x, z):
#   nest  (-105,  0)
#   hill  x -32..32, z -78..78, about 34 high and closed below the ground too
#   food  ( 100,  6)

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, build_stone, compute_wave_noise

HERE = Path(__file__).parent
Array = NDArray[np.float64]


def terrain() -> MeshArrays:
    """A valley floor with soft waves between two banks."""
    vertices, faces = build_flat_grid(np.linspace(-160.0, 160.0, 97), np.linspace(-100.0, 100.0, 61))
    x, z = vertices[:, 0], vertices[:, 2]
    bank = 26.0 / (1.0 + np.exp((86.0 + 5.0 * np.sin(x / 29.0) - np.abs(z)) / 5.0))
    flat = np.stack([x, z], axis=1)
    y = bank + 2.2 * compute_wave_noise(flat, 61, 90.0, 3) + 0.35 * compute_wave_noise(flat, 62, 14.0, 2)
    return np.stack([x, y, z], axis=1), faces


def hill() -> MeshArrays:
    vertices, faces = build_stone(63, (33.0, 36.0, 80.0), detail=5, roughness=0.1)
    vertices += (
        0.8 * compute_wave_noise(vertices, 64, 16.0, 2)[:, None] * vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    )
    return vertices + np.array([0.0, -2.0, 0.0]), faces


def write(name: str, mesh: MeshArrays) -> None:
    vertices, faces = mesh
    # Rounded, so that the last bits of one machine's sine do not change the file.
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    write("terrain.ply", terrain())
    write("hill.ply", hill())
