"""Writes field.ply and stones.ply of this example: `python examples/battle/make_field.py`.

Millimetres, y up; 480 × 340 around the origin. A ridge with a saddle runs along z between the two camps, on the rises at x = -160
and x = 160. The same numbers give the same files."""

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, build_stone, compute_wave_noise, join_meshes

HERE = Path(__file__).parent
Array = NDArray[np.float64]

STONES = (  # x, z, half axes, seed
    (-38.0, -62.0, (12.0, 10.0, 14.0), 41),
    (24.0, 70.0, (15.0, 12.0, 11.0), 42),
    (52.0, -24.0, (8.0, 7.0, 9.0), 43),
    (-70.0, 34.0, (9.0, 8.0, 8.0), 44),
    (96.0, 92.0, (14.0, 13.0, 12.0), 45),
    (-104.0, -96.0, (16.0, 13.0, 13.0), 46),
)


def relief(x: Array, z: Array) -> Array:
    """Height of ridge, rises and noise."""
    crest = 18.0 * np.sin(z / 70.0)
    ridge = (30.0 - 17.0 * np.exp(-(((z - 10.0) / 55.0) ** 2))) * np.exp(-(((x - crest) / 46.0) ** 2))
    rises = sum(12.0 * np.exp(-(((x - cx) ** 2 + z**2) / 60.0**2)) for cx in (-160.0, 160.0))
    flat = np.stack([x, z], axis=1)
    return ridge + rises + 6.0 * compute_wave_noise(flat, 5, 150.0, 3, fade=0.45) + 0.5 * compute_wave_noise(flat, 6, 24.0, 2)


def field() -> MeshArrays:
    vertices, faces = build_flat_grid(np.linspace(-240.0, 240.0, 121), np.linspace(-170.0, 170.0, 86))
    x, z = vertices[:, 0], vertices[:, 2]
    return np.stack([x, relief(x, z), z], axis=1), faces


def stones() -> MeshArrays:
    """The obstacles, each sunk by a quarter of its height."""
    parts = []
    for x, z, radii, seed in STONES:
        vertices, faces = build_stone(seed, radii, detail=2)
        height = float(relief(np.array([x]), np.array([z]))[0])
        parts.append((vertices + np.array([x, height + 0.5 * radii[1], z]), faces))
    return join_meshes(parts)


def write(name: str, mesh: MeshArrays) -> None:
    vertices, faces = mesh
    # Rounded, so that the last bits of one machine's sine do not change the file.
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    write("field.ply", field())
    write("stones.ply", stones())
