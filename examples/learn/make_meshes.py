"""Writes the meshes of the lessons of docs/learn: `python examples/learn/make_meshes.py`.

Millimetres, y up. The same numbers give the same files."""

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, build_stone, compute_wave_noise, join_meshes

HERE = Path(__file__).parent
Array = NDArray[np.float64]


def relief(x: Array, z: Array, hills: float) -> Array:
    """The height of a rolling ground, with hills of about this height."""
    flat = np.stack([x, z], axis=1)
    return hills * compute_wave_noise(flat, 5, 120.0, 2, fade=0.4) + 0.3 * compute_wave_noise(flat, 6, 15.0, 2)


def ground(width: float, hills: float, lines: int = 41) -> MeshArrays:
    """A square about the origin."""
    line = np.linspace(-width / 2, width / 2, lines)
    vertices, faces = build_flat_grid(line, line)
    vertices[:, 1] = relief(vertices[:, 0], vertices[:, 2], hills)
    return vertices, faces


def leaf(length: float = 110.0, breadth: float = 60.0) -> MeshArrays:
    """A leaf along x, folded a little along its middle, its tip and its edges lower."""
    along, across = np.linspace(-1.0, 1.0, 41), np.linspace(-1.0, 1.0, 21)
    vertices, faces = build_flat_grid(along, across)
    u, v = vertices[:, 0], vertices[:, 2]
    half = breadth / 2 * np.clip(1.0 - u * u, 0.0, 1.0) ** 0.7 * (1.0 - 0.3 * u) + 0.8
    z = v * half * (1.0 + 0.03 * np.sin(14.0 * u))
    y = 4.0 * np.abs(v) ** 1.5 - 7.0 * u * u + 1.0 * np.sin(6.0 * u + 2.0 * v)
    return np.stack([u * length / 2, y, z], axis=1), faces


def stones(hills: float, *places: tuple[float, float, float, int]) -> MeshArrays:
    """Stones half sunk into the ground: each with x, z, radius and seed."""
    parts = []
    for x, z, radius, seed in places:
        vertices, faces = build_stone(seed, (radius, 0.75 * radius, 0.85 * radius), detail=3)
        height = float(relief(np.array([x]), np.array([z]), hills)[0])
        parts.append((vertices + np.array([x, height + 0.15 * radius, z]), faces))
    return join_meshes(parts)


def write(name: str, mesh: MeshArrays) -> None:
    vertices, faces = mesh
    # Rounded, so that the last bits of one machine's sine do not change the file.
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    write("walk/ground.ply", ground(200.0, 4.0))
    write("states/leaf.ply", leaf())
    write("layers/ground.ply", ground(200.0, 3.0))
    write("trails/ground.ply", ground(300.0, 6.0))
    write("surfaces/ground.ply", ground(200.0, 4.0))
    write("surfaces/boulder.ply", stones(4.0, (8.0, 6.0, 22.0, 31)))
    write(
        "surfaces/pebbles.ply",
        stones(4.0, (-19.0, 34.0, 5.0, 11), (-30.0, -8.0, 7.0, 12), (27.0, 31.0, 5.5, 13), (4.0, 42.0, 3.5, 14)),
    )
    write("species/ground.ply", ground(200.0, 4.0))
    write("bodies/ground.ply", ground(120.0, 1.5))
    write("directing/ground.ply", ground(240.0, 5.0))
