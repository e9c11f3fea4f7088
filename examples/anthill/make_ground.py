"""Writes block.ply and floor.ply of this example: `python examples/anthill/make_ground.py`.

Millimetres, y up; a block of soil 150 × 50 × 110 with its top about y = 0, on a floor. The same numbers give the same files."""

# Where things lie (x, y, z):
#   doors  (-22,   0,   0)  (22,   0,   0)  (1,   0, 14)
#   rooms  (-40, -20,   1)  (38, -25,  -1)  (2, -29, 30)
#   heap   ( 50,   0,  30)

from pathlib import Path

import numpy as np
import trimesh

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, compute_wave_noise

HERE = Path(__file__).parent


def block() -> MeshArrays:
    """A box whose faces are a little uneven; its corners are rounded off."""
    made = trimesh.creation.box((150.0, 50.0, 110.0))
    for _ in range(5):
        made = made.subdivide()
    vertices = np.asarray(made.vertices, np.float64)
    inner = np.clip(vertices, [-67.0, -17.0, -47.0], [67.0, 17.0, 47.0])
    out = vertices - inner
    vertices = inner + out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9) * 8.0
    vertices += 1.1 * compute_wave_noise(vertices, 71, 30.0, 3)[:, None] * out / 8.0
    return vertices + np.array([0.0, -25.0, 0.0]), np.asarray(made.faces, np.int32)


def floor() -> MeshArrays:
    vertices, faces = build_flat_grid(np.linspace(-180.0, 180.0, 37), np.linspace(-140.0, 140.0, 29))
    x, z = vertices[:, 0], vertices[:, 2]
    return np.stack([x, -47.0 + 1.5 * compute_wave_noise(np.stack([x, z], axis=1), 72, 80.0, 2), z], axis=1), faces


def write(name: str, mesh: MeshArrays) -> None:
    vertices, faces = mesh
    # Rounded, so that the last bits of one machine's sine do not change the file.
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    write("block.ply", block())
    write("floor.ply", floor())
