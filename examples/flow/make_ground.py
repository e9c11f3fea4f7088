"""Writes terrain.ply, stones.ply and way_out.json of this example: `python examples/flow/make_ground.py`.

Millimetres, y up; 480 × 480 around the origin. The ground has an attribute `damp` on its vertices, from 0 to 1."""

# Where things lie (x, z; the height is the terrain's):
#   nest   (-150,  110)   in a damp hollow
#   crumbs ( 150, -120)   360 from the nest
#   stone  (   0,    0)   right between them, on a ridge

import json
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, build_stone, compute_wave_noise, join_meshes

HERE = Path(__file__).parent
Array = NDArray[np.float64]

NEST = (-150.0, 110.0)
STONES = (  # x, z, half axes, seed
    (0.0, 0.0, (62.0, 40.0, 46.0), 41),
    (78.0, 52.0, (18.0, 14.0, 16.0), 42),
    (-92.0, -58.0, (20.0, 15.0, 17.0), 43),
    (96.0, -150.0, (14.0, 12.0, 13.0), 44),
)
DRAWN = [(-150, 110), (-130, 30), (-140, -70), (-80, -140), (0, -175), (80, -185), (150, -120)]


def relief(x: Array, z: Array) -> Array:
    """Height: a ridge from the far left to the near right, a hollow about the nest, and waves."""
    ridge = 34.0 * np.exp(-(((x - z) / 1.41 / 60.0) ** 2)) * np.exp(-((np.hypot(x, z) / 190.0) ** 4))
    hollow = 14.0 * np.exp(-((np.hypot(x - NEST[0], z - NEST[1]) / 70.0) ** 2))
    return ridge - hollow + 3.0 * compute_wave_noise(np.stack([x, z], axis=1), 5, 120.0, 3, fade=0.45)


def damp(x: Array, z: Array) -> Array:
    return np.clip(1.15 - np.hypot(x - NEST[0], z - NEST[1]) / 65.0, 0.0, 1.0)


def terrain(lines: int = 97) -> tuple[MeshArrays, Array]:
    line = np.linspace(-240.0, 240.0, lines)
    vertices, faces = build_flat_grid(line, line)
    x, z = vertices[:, 0], vertices[:, 2]
    return (np.stack([x, relief(x, z), z], axis=1), faces), damp(x, z)


def stones() -> MeshArrays:
    """The obstacles, each sunk by a quarter of its height."""
    parts = []
    for x, z, radii, seed in STONES:
        vertices, faces = build_stone(seed, radii, detail=3)
        height = float(relief(np.array([x]), np.array([z]))[0])
        parts.append((vertices + np.array([x, height + 0.45 * radii[1], z]), faces))
    return join_meshes(parts)


def write(name: str, mesh: MeshArrays, **attributes: Array) -> None:
    vertices, faces = mesh
    # Rounded, so that the last bits of one machine's sine do not change the file.
    rows = {key: np.round(values, 4).astype(np.float32) for key, values in attributes.items()}
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False, vertex_attributes=rows)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    ground, wet = terrain()
    write("terrain.ply", ground, damp=wet)
    write("stones.ply", stones())
    heights = relief(*(np.array(DRAWN, float).T))
    points = [[x, round(float(y), 1), z] for (x, z), y in zip(DRAWN, heights, strict=True)]
    (HERE / "way_out.json").write_text(json.dumps(points) + "\n")
