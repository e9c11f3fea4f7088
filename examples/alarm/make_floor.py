"""Writes floor.ply of this example: `python examples/alarm/make_floor.py`.

Millimetres, y up: a floor 400 × 400 about the origin."""

from pathlib import Path

import numpy as np
import trimesh

from antdsl.bodies.shapes import build_flat_grid, compute_wave_noise

if __name__ == "__main__":
    line = np.linspace(-200.0, 200.0, 41)
    vertices, faces = build_flat_grid(line, line)
    vertices[:, 1] = 3.0 * compute_wave_noise(vertices[:, [0, 2]], 12, 110.0, 2)
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False)
    (Path(__file__).parent / "floor.ply").write_bytes(made.export(file_type="ply", vertex_normal=False))
