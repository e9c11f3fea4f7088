"""Our own ant: 60 triangles for crowds, a few hundred for close-ups, with legs that walk.

Legs move as two tripods (front and hind of one side with the middle of the other); a foot on the ground stays where it is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import Body, vertex_normals
from antdsl.bodies.shapes import Mesh

Array = NDArray[np.float64]

STEP = 0.3  # body lengths that a foot travels back, seen from the body, while it stands
STRIDE = 2 * STEP  # a foot stands for half of the cycle
LIFT = 0.07  # how high a foot swings
POSES = 16


@dataclass(frozen=True, slots=True)
class Leg:
    hip: tuple[float, float, float]
    foot: tuple[float, float, float]  # in the middle of its step
    phase: float


@dataclass(frozen=True, slots=True)
class Part:
    """A rounded part of the trunk: centre and half axes; `sides` × `rings` says how fine it is."""

    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    tint: float
    rings: int
    sides: int


def _legs() -> tuple[Leg, ...]:
    rows = (
        ((0.15, 0.135, 0.045), (0.37, 0.0, 0.27), 0.0),
        ((0.07, 0.13, 0.05), (0.05, 0.0, 0.38), 0.5),
        ((-0.01, 0.135, 0.045), (-0.30, 0.0, 0.33), 0.0),
    )
    return tuple(
        Leg((hip[0], hip[1], side * hip[2]), (foot[0], foot[1], side * foot[2]), (phase + (0.0 if side > 0 else 0.5)) % 1.0)
        for side in (1.0, -1.0)
        for hip, foot, phase in rows
    )


LEGS = _legs()


def foot_at(leg: Leg, phase: float) -> Array:
    """Where a foot is at `phase` (0..1) of the body's cycle: half of it standing, drawn back evenly, half swinging forward."""
    own = (phase + leg.phase) % 1.0
    x, y, z = leg.foot
    if own < 0.5:
        return np.array([x + STEP * (0.5 - 2 * own), y, z])
    swing = 2 * own - 1
    eased = swing * swing * (3 - 2 * swing)
    return np.array([x + STEP * (eased - 0.5), y + LIFT * np.sin(np.pi * swing), z])


def knee_of(hip: Array, foot: Array) -> Array:
    """The knee stands above the middle of hip and foot, higher when the two are near."""
    flat = float(np.hypot(foot[0] - hip[0], foot[2] - hip[2]))
    middle = hip + (foot - hip) * 0.48
    return np.array([middle[0], 0.17 + 0.36 * max(0.0, 0.55 - flat) + 0.4 * foot[1], middle[2]])


def _rounded(part: Part) -> Mesh:
    """An ellipsoid of rings across x, closed by a point at either end."""
    angles = np.linspace(0, np.pi, part.rings + 2)[1:-1]
    turn = (np.arange(part.sides) + 0.5) * 2 * np.pi / part.sides
    ring = np.stack([np.zeros(part.sides), np.sin(turn), np.cos(turn)], axis=1)
    points = (
        [np.array([[1.0, 0, 0]])] + [ring * np.sin(a) + np.array([np.cos(a), 0, 0]) for a in angles] + [np.array([[-1.0, 0, 0]])]
    )
    vertices = np.concatenate(points) * np.array(part.half) + np.array(part.centre)
    faces: list[tuple[int, int, int]] = []
    for side in range(part.sides):
        following = (side + 1) % part.sides
        faces.append((0, 1 + following, 1 + side))
        for row in range(part.rings - 1):
            a, b = 1 + row * part.sides + side, 1 + row * part.sides + following
            c, d = a + part.sides, b + part.sides
            faces += [(a, b, d), (a, d, c)]
        end = 1 + (part.rings - 1) * part.sides
        faces.append((end + side, end + following, len(vertices) - 1))
    return vertices, np.array(faces, np.int32)


def _tube(path: list[Array], widths: list[float], sides: int) -> Mesh:
    """A tube along `path`, open at its start and closed to a point when its last width is 0; two sides make a flat blade."""
    vertices: list[Array] = []
    for k, (point, width) in enumerate(zip(path, widths, strict=True)):
        along = path[min(k + 1, len(path) - 1)] - path[max(k - 1, 0)]
        along = along / np.linalg.norm(along)
        across = np.cross(along, [0.35, 0.6, 0.72] if sides > 2 else [0.0, 0.0, 1.0 if along[2] > 0 else -1.0])
        if np.linalg.norm(across) < 1e-6:
            across = np.array([1.0, 0.0, 0.0])
        across = across / np.linalg.norm(across)
        other = np.cross(along, across)
        turns = np.arange(sides) * 2 * np.pi / sides + (np.pi / 4 if sides == 2 else 0.0)
        vertices.append(point + width * (np.cos(turns)[:, None] * across + np.sin(turns)[:, None] * other))
    faces: list[tuple[int, int, int]] = []
    for k in range(len(path) - 1):
        for side in range(sides if sides > 2 else 1):
            a, b = k * sides + side, k * sides + (side + 1) % sides
            c, d = a + sides, b + sides
            faces += [(a, b, d), (a, d, c)]
    return np.concatenate(vertices), np.array(faces, np.int32)


def _trunk(fine: bool) -> tuple[Part, ...]:
    gaster = Part((-0.29, 0.165, 0), (0.21, 0.105, 0.115), 1.0, 5 if fine else 1, 9 if fine else 6)
    thorax = Part((0.075, 0.165, 0), (0.155, 0.06, 0.058), 0.7, 4 if fine else 1, 7 if fine else 4)
    head = Part((0.315, 0.175, 0), (0.105, 0.07, 0.092), 0.85, 4 if fine else 1, 8 if fine else 6)
    if not fine:
        return (gaster, thorax, head)
    petiole = Part((-0.085, 0.155, 0), (0.04, 0.052, 0.03), 0.45, 2, 5)
    eyes = tuple(Part((0.335, 0.195, side * 0.078), (0.026, 0.022, 0.016), 0.0, 2, 5) for side in (1, -1))
    return (gaster, petiole, thorax, head, *eyes)


def _limbs(phase: float, fine: bool) -> list[tuple[Mesh, float]]:
    made: list[tuple[Mesh, float]] = []
    for leg in LEGS:
        hip, foot = np.array(leg.hip), foot_at(leg, phase)
        knee = knee_of(hip, foot)
        if fine:
            ankle = knee + (foot - knee) * 0.72 + np.array([0.0, 0.012, 0.0])
            made.append((_tube([hip, knee, ankle, foot], [0.021, 0.019, 0.013, 0.006], 4), 0.16))
        else:
            made.append((_tube([hip, knee, foot], [0.022, 0.02, 0.012], 2), 0.22))
    sway = 0.03 * np.sin(2 * np.pi * phase)
    for side in (1.0, -1.0):
        root = np.array([0.37, 0.205, side * 0.045])
        elbow = np.array([0.45 + side * sway, 0.30, side * 0.155])
        tip = np.array([0.63, 0.20 + side * sway, side * (0.20 + sway)])
        if fine:
            made.append(
                (_tube([root, elbow, (elbow + tip) / 2 + np.array([0.02, 0.012, 0]), tip], [0.012, 0.012, 0.011, 0.009], 4), 0.12)
            )
            jaw = [
                np.array([0.385, 0.15, side * 0.05]),
                np.array([0.455, 0.14, side * 0.05]),
                np.array([0.5, 0.135, side * 0.008]),
            ]
            made.append((_tube(jaw, [0.02, 0.018, 0.003], 4), 0.1))
        else:
            made.append((_tube([root, tip - np.array([0.05, 0.0, 0.0])], [0.016, 0.008], 2), 0.25))
    return made


def _assembled(phase: float, fine: bool) -> tuple[Array, NDArray[np.int32], NDArray[np.float32]]:
    parts: list[tuple[Mesh, float]] = [(_rounded(part), part.tint) for part in _trunk(fine)] + _limbs(phase, fine)
    vertices: list[Array] = []
    faces: list[NDArray[np.int32]] = []
    tints: list[NDArray[np.float32]] = []
    start = 0
    for (points, triangles), tint in parts:
        vertices.append(points)
        faces.append(triangles + np.int32(start))
        tints.append(np.full(len(points), tint, np.float32) if tint < 1 else _banded(points))
        start += len(points)
    return np.concatenate(vertices), np.concatenate(faces), np.concatenate(tints)


def _banded(points: Array) -> NDArray[np.float32]:
    """The gaster's tint: bright, with a darker band at every other ring."""
    rings = np.unique(np.round(points[:, 0], 6))
    place = np.searchsorted(rings, np.round(points[:, 0], 6))
    return np.where((place % 2 == 0) & (len(rings) > 3), 0.62, 1.0).astype(np.float32)


def ant(fine: bool = False) -> Body:
    """The ant for crowds, or with `fine` the one for close-ups."""
    poses = [_assembled(k / POSES, fine) for k in range(POSES)]
    vertices, faces, tint = poses[0]
    table = np.stack([points for points, _, _ in poses]).astype(np.float32)
    return Body("ant", table, faces, vertex_normals(vertices, faces), tint, STRIDE)
