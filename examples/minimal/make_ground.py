"""Writes ground.ply of this example: `python examples/minimal/make_ground.py`.

A small gentle ground, 200 × 200 mm around the origin, y up, heights within ±8 mm."""

from pathlib import Path

import numpy as np
import trimesh

from antdsl.bodies.shapes import MeshArrays, build_flat_grid


def ground(lines: int = 33) -> MeshArrays:
    line = np.linspace(-100.0, 100.0, lines)
    vertices, faces = build_flat_grid(line, line)
    x, z = vertices[:, 0], vertices[:, 2]
    vertices[:, 1] = 4.5 * np.sin(x / 24.0) * np.cos(z / 29.0) + 2.0 * np.sin((x + 2.0 * z) / 41.0)
    return vertices, faces


if __name__ == "__main__":
    vertices, faces = ground()
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False)
    (Path(__file__).parent / "ground.ply").write_bytes(made.export(file_type="ply", vertex_normal=False))
