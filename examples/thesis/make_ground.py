"""Writes the meshes and the curve of this example: `python examples/thesis/make_ground.py`.

Millimetres, y up; a valley 480 × 320 along x. The same numbers give the same files."""

# Where things lie (x, z):
#   nest    (-150,    0)
#   hill    x -32..32, z -70..70, about 34 high and closed below the ground too
#   apple   ( 110,   10)   on the ground, behind the hill
#   can     (  78,  -62)   30 high, sugar on its lid
#   bottle  ( -80,  100)   lies on its side, its neck toward the middle
#   stones  a dozen, round about

import json
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, build_stone, compute_wave_noise, join_meshes

HERE = Path(__file__).parent
Array = NDArray[np.float64]

CAN = ((0.0, -1.0), (17.0, -1.0), (17.0, 28.5), (15.5, 30.0), (0.0, 30.0))  # radius, height
BOTTLE = (  # lying, its neck toward +x
    (0.0, -36.0), (10.0, -36.0), (12.0, -34.0), (12.0, 8.0), (10.0, 15.0),
    (5.0, 21.0), (4.2, 34.0), (5.0, 35.0), (5.0, 38.0), (0.0, 38.0),
)  # fmt: skip
LAID = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]).T  # the bottle's y becomes x
TURNED = -0.6  # how far the bottle is turned about y, in radians
STONES = (  # x, z, half axes, seed
    (-88.0, 26.0, (10.0, 8.0, 9.0), 71),
    (-84.0, -38.0, (13.0, 9.0, 10.0), 72),
    (-60.0, 62.0, (9.0, 8.0, 11.0), 73),
    (56.0, 40.0, (10.0, 8.0, 8.0), 74),
    (66.0, -18.0, (8.0, 7.0, 9.0), 75),
    (120.0, 60.0, (14.0, 11.0, 12.0), 76),
    (20.0, 108.0, (12.0, 10.0, 14.0), 77),
    (-10.0, -110.0, (15.0, 11.0, 12.0), 78),
    (-180.0, 70.0, (12.0, 9.0, 10.0), 79),
    (-190.0, -60.0, (11.0, 9.0, 12.0), 80),
    (130.0, -100.0, (13.0, 10.0, 11.0), 81),
    (190.0, 20.0, (12.0, 10.0, 13.0), 82),
)
WAY_OUT = [[-150.0, 0.0, 0.0], [-125.0, 0.0, 1.0], [-95.0, 0.0, 0.0], [-60.0, 0.0, -2.0]]


def relief(x: Array, z: Array) -> Array:
    bank = 24.0 / (1.0 + np.exp((146.0 + 6.0 * np.sin(x / 31.0) - np.abs(z)) / 6.0))
    flat = np.stack([x, z], axis=1)
    return bank + 2.4 * compute_wave_noise(flat, 83, 110.0, 3) + 0.3 * compute_wave_noise(flat, 84, 15.0, 2)


def terrain() -> MeshArrays:
    vertices, faces = build_flat_grid(np.linspace(-240.0, 240.0, 121), np.linspace(-160.0, 160.0, 81))
    vertices[:, 1] = relief(vertices[:, 0], vertices[:, 2])
    return vertices, faces


def hill() -> MeshArrays:
    vertices, faces = build_stone(85, (33.0, 36.0, 72.0), detail=5, roughness=0.1)
    vertices += (
        0.8 * compute_wave_noise(vertices, 86, 16.0, 2)[:, None] * vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    )
    return vertices + np.array([0.0, -2.0, 0.0]), faces


def revolved(profile: tuple[tuple[float, float], ...], sections: int) -> MeshArrays:
    """What a line of (radius, height) becomes when it is turned about y."""
    made = trimesh.creation.revolve(np.array(profile), sections=sections)
    return np.asarray(made.vertices, np.float64)[:, [1, 2, 0]], np.asarray(made.faces, np.int32)


def on_ground(mesh: MeshArrays, x: float, z: float, sunk: float) -> MeshArrays:
    height = float(relief(np.array([x]), np.array([z]))[0])
    return mesh[0] + np.array([x, height - sunk, z]), mesh[1]


def can() -> MeshArrays:
    return on_ground(revolved(CAN, 32), 78.0, -62.0, sunk=0.8)


def bottle() -> MeshArrays:
    vertices, faces = revolved(BOTTLE, 24)
    turn = np.array([[np.cos(TURNED), 0, np.sin(TURNED)], [0, 1, 0], [-np.sin(TURNED), 0, np.cos(TURNED)]])
    return on_ground((vertices @ LAID @ turn.T, faces), -80.0, 100.0, sunk=-10.5)


def stones() -> MeshArrays:
    """The obstacles, each sunk by a quarter of its height."""
    return join_meshes(
        [on_ground(build_stone(seed, radii, detail=2), x, z, sunk=-0.45 * radii[1]) for x, z, radii, seed in STONES]
    )


def write(name: str, mesh: MeshArrays) -> None:
    vertices, faces = mesh
    # Rounded, so that the last bits of one machine's sine do not change the file.
    made = trimesh.Trimesh(np.round(vertices, 3), faces, process=False)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    for name, mesh in (("terrain", terrain()), ("hill", hill()), ("can", can()), ("bottle", bottle()), ("stones", stones())):
        write(f"{name}.ply", mesh)
    (HERE / "way_out.json").write_text(json.dumps(WAY_OUT) + "\n", encoding="utf-8")
