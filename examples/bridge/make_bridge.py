"""Writes bridge.ply, mirrored.ply and equal.ply of this example: `python examples/bridge/make_bridge.py`.

Millimetres, y up: a strip 12 wide from the nest's floor to a fork, two arms that leave it by 30 degrees to either side and meet
again in a fork like it, and a strip on to the food. One arm is twice as long as the other, in `equal.ply` they
are alike; in `mirrored.ply` the arms have changed sides."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

HERE = Path(__file__).parent
HALF = 6.0  # of a strip's width
FORKS = 0.0, 200.0  # x of the two
SLANT = np.radians(30)  # between an arm and the line through both forks
STRAIGHT = 40.0  # mm from a fork on: both arms begin alike
BEND = 40.0  # radius by which the long arm bends away from that line
Point = tuple[float, float]
Points = NDArray[np.float64]


def arc(length: float, turn: float) -> Points:
    """Pieces of a stretch that turns by so much (radians) over its length, each with its turn, at most 10 degrees."""
    pieces = max(int(np.ceil(abs(turn) / np.radians(10))), 1)
    return np.tile([length / pieces, turn / pieces], (pieces, 1))


def drawn(heading: float, stretches: list[Points]) -> tuple[Point, ...]:
    """Points of a way that begins at the near fork with a heading."""
    place, found = np.array([FORKS[0], 0.0]), [(FORKS[0], 0.0)]
    for piece, turn in np.concatenate(stretches):
        heading += turn / 2
        place = place + piece * np.array([np.cos(heading), np.sin(heading)])
        heading += turn / 2
        found.append((float(place[0]), float(place[1])))
    return (*found[:-1], (FORKS[1], 0.0))


def short() -> tuple[Point, ...]:
    """Straight on from either fork, and an arc between."""
    radius = (FORKS[1] - FORKS[0] - 2 * STRAIGHT * np.cos(SLANT)) / 2 / np.sin(SLANT)
    return drawn(SLANT, [arc(STRAIGHT, 0), arc(2 * radius * SLANT, -2 * SLANT), arc(STRAIGHT, 0)])


def long(times: float) -> tuple[Point, ...]:
    """The same to the other side, with three arcs, so many times as long: the bend of the first and last is found by halving."""
    wanted = times * length(short()) - 2 * STRAIGHT
    chord = FORKS[1] - FORKS[0] - 2 * STRAIGHT * np.cos(SLANT)
    low, high = 0.0, np.pi / 2
    for _ in range(60):
        bend = (low + high) / 2
        sine = np.sin(SLANT + bend)
        radius = (chord / 2 - BEND * (sine - np.sin(SLANT))) / sine
        if 2 * BEND * bend + 2 * radius * (SLANT + bend) < wanted:
            low = bend
        else:
            high = bend
    away, ends = arc(BEND * bend, -bend), arc(STRAIGHT, 0)
    return drawn(-SLANT, [ends, away, arc(2 * radius * (SLANT + bend), 2 * (SLANT + bend)), away, ends])


def length(way: tuple[Point, ...]) -> float:
    """How long a way along the middle of an arm is, from fork to fork."""
    return float(np.linalg.norm(np.diff(np.array(way), axis=0), axis=1).sum())


def edges(way: tuple[Point, ...]) -> list[tuple[Point, Point]]:
    """Left and right end of the strip's cut at each inner point of a way: along the half of its angle."""
    points = np.array(way)
    ahead = np.diff(points, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    found = []
    for k in range(1, len(points) - 1):
        cut = left[k - 1] + left[k]
        cut *= HALF / (cut @ left[k])
        found.append((tuple(points[k] + cut), tuple(points[k] - cut)))
    return found


def strip(cuts: list[tuple[Point, Point]]) -> list[list[Point]]:
    """The quads between cuts that follow each other, in pieces no longer than wide: four triangles each, about the middle."""
    found = []
    for one, two in pairwise(cuts):
        (a, b), (c, d) = np.array(one), np.array(two)
        pieces = max(round(float(np.linalg.norm((c + d - a - b) / 2)) / (2 * HALF)), 1)
        for k in range(pieces):
            ring = [
                a + (c - a) * k / pieces,
                b + (d - b) * k / pieces,
                b + (d - b) * (k + 1) / pieces,
                a + (c - a) * (k + 1) / pieces,
            ]
            middle = tuple(sum(ring) / 4)
            found += [[middle, tuple(p), tuple(q)] for p, q in zip(ring, ring[1:] + ring[:1], strict=True)]
    return found


def bridge(upper: tuple[Point, ...], lower: tuple[Point, ...]) -> tuple[Points, NDArray[np.int64]]:
    """The floor of the nest, the strips and both arms, as one mesh."""
    outer, inner = HALF * np.tan(np.radians(15)), HALF / np.sin(np.radians(30))
    near, far = FORKS
    triangles: list[list[Point]] = []
    for x, out in ((near, -1.0), (far, 1.0)):
        corner = [(x + out * outer, HALF), (x + out * outer, -HALF), (x - out * inner, 0.0)]
        triangles.append(corner)
    first, last = ((near - outer, HALF), (near + inner, 0.0)), ((far + outer, HALF), (far - inner, 0.0))
    triangles += strip([first, *edges(upper), last])
    first, last = ((near + inner, 0.0), (near - outer, -HALF)), ((far - inner, 0.0), (far + outer, -HALF))
    triangles += strip([first, *edges(lower), last])
    triangles += strip([((-60.0, HALF), (-60.0, -HALF)), ((near - outer, HALF), (near - outer, -HALF))])
    triangles += strip([((far + outer, HALF), (far + outer, -HALF)), ((260.0, HALF), (260.0, -HALF))])
    floor = [(-60.0, -HALF), (-60.0, HALF), (-60.0, 25.0), (-120.0, 25.0), (-120.0, -25.0), (-60.0, -25.0)]
    triangles += [[(-90.0, 0.0), a, b] for a, b in zip(floor, floor[1:] + floor[:1], strict=True)]
    flat = np.round(np.array(triangles).reshape(-1, 2), 3)
    places, which = np.unique(flat, axis=0, return_inverse=True)
    faces = which.reshape(-1, 3)
    a, b, c = (places[faces[:, k]] for k in range(3))
    turned = np.cross(np.pad(b - a, ((0, 0), (0, 1))), np.pad(c - a, ((0, 0), (0, 1))))[:, 2] > 0
    faces[turned] = faces[turned][:, ::-1]  # seen from above, so that normals point up
    whole = trimesh.Trimesh(np.column_stack([places[:, 0], np.zeros(len(places)), places[:, 1]]), faces, process=False)
    fine = whole.subdivide().subdivide()  # what leads off the edges is told apart across a strip
    return np.round(fine.vertices, 3), fine.faces


def mirrored(mesh: tuple[Points, NDArray[np.int64]]) -> tuple[Points, NDArray[np.int64]]:
    """The same with its sides changed, z for -z, seen from above as before."""
    return mesh[0] * [1.0, 1.0, -1.0], mesh[1][:, ::-1]


def write(name: str, mesh: tuple[Points, NDArray[np.int64]]) -> None:
    """A file of a mesh beside this script."""
    made = trimesh.Trimesh(*mesh, process=False)
    (HERE / name).write_bytes(made.export(file_type="ply", vertex_normal=False))


if __name__ == "__main__":
    write("bridge.ply", bridge(short(), long(2.0)))
    write("mirrored.ply", mirrored(bridge(short(), long(2.0))))
    write("equal.ply", bridge(short(), tuple((x, -z) for x, z in short())))
    for way in (short(), long(2.0)):
        print(f"an arm of {length(way):.1f} mm, in the middle at {way[len(way) // 2]}")
