"""Writes waves.ply of this example: `python examples/flocking/make_ground.py`.

A wavy plane, 1000 × 1000 mm around the origin, y up, heights within ±16 mm."""

from pathlib import Path

import numpy as np
import trimesh

from antdsl.bodies.shapes import MeshArrays, build_flat_grid


def waves_sheet(lines: int = 81) -> MeshArrays:
    line = np.linspace(-500.0, 500.0, lines)
    vertices, faces = build_flat_grid(line, line)
    x, z = vertices[:, 0], vertices[:, 2]
    vertices[:, 1] = 9.0 * np.sin(x / 78.0 + 0.6 * np.sin(z / 120.0)) + 7.0 * np.sin(z / 96.0 + x / 210.0)
    return vertices, faces


if __name__ == "__main__":
    vertices, faces = waves_sheet()
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False)
    (Path(__file__).parent / "waves.ply").write_bytes(made.export(file_type="ply", vertex_normal=False))
