"""Writes the shapes of this example: `python examples/torture/make_shapes.py`.

Millimetres, y up: whatever is hard to walk on. Agents are 4 mm long; each shape stands about its own origin."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from antdsl.bodies.shapes import MeshArrays, build_flat_grid, build_stone, compute_wave_noise, join_meshes

HERE = Path(__file__).parent
Floats = NDArray[np.float64]

THICKNESS = 0.05  # of the plate: an eightieth of an agent
RIM, LID = 25.0, 9.0  # of the can: its radius, and that of the hole in its lid
CAN, TIN = 50.0, 0.3  # its height, and how thick its tin is
CAN_OUTSIDE = ((0.0, 0.0), (RIM, 0.0), (RIM, CAN / 2), (RIM, CAN), (17.0, CAN), (LID, CAN))
CAN_INSIDE = ((LID, CAN - TIN), (17.0, CAN - TIN), (RIM - TIN, CAN - TIN), (RIM - TIN, CAN / 2), (RIM - TIN, TIN), (0.0, TIN))
NECK = 60.0  # of the bottle: where its mouth is
SUNK = -4.0  # where the middle of the half sunk stone is
STACK = ((0, 13, 0, 22, 16, 20, 61), (3, 35, 2, 17, 13, 16, 62), (-2, 53, -2, 13, 11, 14, 63), (0, 69, 0, 9, 9, 8, 64))

# Radius and height, from the middle of the floor outside, up to the mouth, and down again inside to the middle of the floor.
BOTTLE = (
    (0.0, 0.0), (15.0, 0.0), (20.0, 3.0), (22.0, 10.0), (22.0, 34.0), (19.0, 41.0), (11.0, 46.0), (8.0, 50.0), (8.0, 57.0),
    (9.0, 59.0), (8.0, 60.0), (6.5, 59.0), (6.0, 57.0), (6.0, 50.5), (9.5, 44.5), (17.5, 39.5), (20.0, 33.5), (20.0, 10.5),
    (18.5, 4.5), (14.0, 2.0), (0.0, 2.0),
)  # fmt: skip
TWISTED = (26.0, 9.0)  # radius of the Möbius strip, and half its width


def turned(profile: Sequence[tuple[float, float]], sectors: int) -> MeshArrays:
    """What a line of (radius, height) becomes when it is turned about y. Points of radius 0 are one place."""
    angle = 2 * np.pi * np.arange(sectors) / sectors
    around = np.stack([np.cos(angle), np.zeros(sectors), np.sin(angle)], axis=1)
    vertices, rings = [], []
    for radius, height in profile:
        points = around * radius if radius else np.zeros((1, 3))
        first = sum(len(v) for v in vertices)
        rings.append(first + (np.arange(sectors) if radius else np.zeros(sectors, int)))
        vertices.append(points + np.array([0.0, height, 0.0]))
    faces = []
    for low, high in pairwise(rings):
        a, b, c, d = low, np.roll(low, -1), np.roll(high, -1), high
        faces += [np.stack([a, d, c], axis=1), np.stack([a, c, b], axis=1)]
    every = np.concatenate(faces)
    real = (every[:, 0] != every[:, 1]) & (every[:, 1] != every[:, 2]) & (every[:, 2] != every[:, 0])
    return np.concatenate(vertices), every[real].astype(np.int32)


def cuboid(x: float, y: float, z: float) -> MeshArrays:
    """A closed box on the floor, its faces seen from outside."""
    made = trimesh.creation.box((x, y, z))
    return np.asarray(made.vertices, np.float64) + np.array([0, y / 2, 0]), np.asarray(made.faces, np.int32)


def cube() -> MeshArrays:
    return cuboid(40.0, 40.0, 40.0)


def plate() -> MeshArrays:
    """On its edge: two faces a hair apart."""
    vertices, faces = cuboid(60.0, 45.0, THICKNESS)
    return vertices, faces


def torus() -> MeshArrays:
    angle = 2 * np.pi * np.arange(16) / 16
    ring = [(24.0 + 9.0 * float(np.cos(t)), 9.0 + 9.0 * float(np.sin(t))) for t in angle]
    return turned([*ring, ring[0]], 32)


def bottle() -> MeshArrays:
    """Of glass 2 mm thick, open at its mouth."""
    return turned(BOTTLE, 28)


def can() -> MeshArrays:
    """Of tin 0.3 mm thick, closed but for a hole in its lid."""
    return turned(CAN_OUTSIDE + CAN_INSIDE, 30)


def pot() -> MeshArrays:
    """The can once more, of a sheet without any thickness: its border is not walked round."""
    return turned(CAN_OUTSIDE, 30)


def stones() -> MeshArrays:
    """Four stones on top of each other, each sunk into the one below."""
    parts = []
    for x, y, z, *radii, seed in STACK:
        vertices, faces = build_stone(int(seed), (radii[0], radii[1], radii[2]), detail=2)
        parts.append((vertices + np.array([x, y, z], float), faces))
    return join_meshes(parts)


def moebius(along: int = 72, across: int = 6) -> MeshArrays:
    """One side, one border; the last cells meet the first upside down."""
    t = 2 * np.pi * np.arange(along) / along
    w = np.linspace(-1.0, 1.0, across + 1) * TWISTED[1]
    radius = TWISTED[0] + w * np.cos(t[:, None] / 2)
    height = w * np.sin(t[:, None] / 2) + 12.0
    vertices = np.stack([radius * np.cos(t[:, None]), height, radius * np.sin(t[:, None])], axis=2).reshape(-1, 3)
    number = np.arange(along * (across + 1)).reshape(along, across + 1)
    following = np.concatenate([number[1:], number[:1, ::-1]])
    a, b, c, d = number[:, :-1], number[:, 1:], following[:, 1:], following[:, :-1]
    faces = np.concatenate([np.stack([a, b, c], axis=2).reshape(-1, 3), np.stack([a, c, d], axis=2).reshape(-1, 3)])
    return vertices, faces.astype(np.int32)


def rag() -> MeshArrays:
    """An open sheet with waves, with a border all round it and another round a hole."""
    line = np.linspace(-28.0, 28.0, 25)
    vertices, faces = build_flat_grid(line, line)
    vertices[:, 1] = 20.0 + 4.0 * compute_wave_noise(vertices[:, [0, 2]], 5, 40.0, 2)
    middle = vertices[faces].mean(axis=1)
    return vertices, faces[np.hypot(middle[:, 0] - 4.0, middle[:, 2] + 3.0) > 8.0]


def broken() -> MeshArrays:
    """A ball with all that goes wrong in meshes: doubled faces, faces the other way round, faces without area, loose corners."""
    vertices, faces = build_stone(65, (22.0, 20.0, 22.0), detail=2)
    vertices = vertices + np.array([0.0, 19.0, 0.0])
    odd = faces.copy()
    odd[::3] = odd[::3][:, ::-1]
    loose = vertices[odd[:60]].reshape(-1, 3)  # each with corners of its own
    own = np.arange(180).reshape(-1, 3) + len(vertices)
    points, lines = np.repeat(odd[:25, :1], 3, axis=1), odd[25:50][:, [0, 1, 1]]
    every = [own, odd[60:], odd[100:150], odd[150:200][:, [1, 2, 0]], odd[200:240][:, ::-1], points, lines]
    return np.concatenate([vertices, loose]), np.concatenate(every).astype(np.int32)


def rod(length: float = 70.0, radius: float = 2.5) -> MeshArrays:
    """A twig along y, closed, thinner than two agents are wide."""
    return turned([(0.0, 0.0), (radius, 0.0), (radius, length / 2), (radius * 0.8, length), (0.0, length)], 9)


def eight(along: int = 64, around: int = 12, radius: float = 7.0) -> MeshArrays:
    """A closed hose along the curve of Gerono, which goes through itself in the middle: one piece, walls inside walls."""
    t = 2 * np.pi * np.arange(along) / along
    line = np.stack([34.0 * np.sin(t), np.full(along, 12.0), 34.0 * np.sin(t) * np.cos(t)], axis=1)
    ahead = np.stack([np.cos(t), np.zeros(along), np.cos(2 * t)], axis=1)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    across = np.cross(ahead, [0.0, 1.0, 0.0])
    turn = 2 * np.pi * (np.arange(around) + 0.3) / around
    ring = across[:, None] * np.cos(turn)[:, None] + np.array([0.0, 1.0, 0.0]) * np.sin(turn)[:, None]
    vertices = (line[:, None] + radius * ring).reshape(-1, 3)
    number = np.arange(along * around).reshape(along, around)
    a, b = number, np.roll(number, -1, axis=1)
    c, d = np.roll(b, -1, axis=0), np.roll(a, -1, axis=0)
    faces = np.concatenate([np.stack([a, c, b], axis=2).reshape(-1, 3), np.stack([a, d, c], axis=2).reshape(-1, 3)])
    return vertices, faces.astype(np.int32)


def boulder() -> MeshArrays:
    """To be sunk into the ground by half."""
    vertices, faces = build_stone(66, (24.0, 20.0, 21.0), detail=3)
    return vertices + np.array([0.0, SUNK, 0.0]), faces


def ground(lines: int = 61) -> MeshArrays:
    """Flat about the shapes, with a hill at the far end."""
    line = np.linspace(-180.0, 180.0, lines)
    vertices, faces = build_flat_grid(line, line)
    x, z = vertices[:, 0], vertices[:, 2]
    vertices[:, 1] = 40.0 * np.exp(-((x / 60.0) ** 2 + ((z + 130.0) / 40.0) ** 2))
    return vertices, faces


SHAPES = {
    "cube": cube, "plate": plate, "torus": torus, "bottle": bottle, "can": can, "pot": pot, "stones": stones, "moebius": moebius,
    "rag": rag, "broken": broken, "eight": eight, "rod": rod, "boulder": boulder, "ground": ground,
}  # fmt: skip


def write(name: str, mesh: MeshArrays) -> None:
    made = trimesh.Trimesh(np.round(mesh[0], 3), mesh[1], process=False)
    (HERE / f"{name}.ply").write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    for name, shape in SHAPES.items():
        if name not in ("pot", "broken", "eight"):  # for tests only
            write(name, shape())
