"""Writes floor.ply and stones.ply of this example: `python examples/worth/make_floor.py`.

Millimetres, y up: a floor 400 × 400 about the origin, with a row of stones between nest and food."""

from pathlib import Path

import numpy as np
import trimesh

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, build_stone, compute_wave_noise, join_meshes

HERE = Path(__file__).parent
STONES = (  # x, z, half axes, seed
    (62.0, -6.0, (13.0, 15.0, 24.0), 51),
    (58.0, 40.0, (15.0, 13.0, 14.0), 52),
    (-60.0, -50.0, (20.0, 14.0, 16.0), 53),
)


def floor(lines: int = 41) -> MeshArrays:
    line = np.linspace(-200.0, 200.0, lines)
    vertices, faces = build_flat_grid(line, line)
    vertices[:, 1] = 3.0 * compute_wave_noise(vertices[:, [0, 2]], 7, 120.0, 2)
    return vertices, faces


def write(name: str, mesh: MeshArrays) -> None:
    made = trimesh.Trimesh(np.round(mesh[0], 3), mesh[1], process=False)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    write("floor.ply", floor())
    parts = [(build_stone(seed, axes, detail=2), (x, z)) for x, z, axes, seed in STONES]
    write("stones.ply", join_meshes([(points + np.array([x, 0.0, z]), faces) for (points, faces), (x, z) in parts]))
