"""Closed surfaces that bodies are modelled of: lofts (rings swept along a path) and ellipsoids, with texture coordinates.

Each is a `Surface`: triangles counter-clockwise seen from outside; a seam of its texture coordinates has its points twice, at the
same place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.shapes import sphere

Array = NDArray[np.float64]
Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """`points` float64[n, 3]; `faces` int32[m, 3]; `uv` float64[n, 2] from 0 to 1; `along` float64[n]: from 0 at its start to 1
    at its end, by which it can be bound to joints or parted into materials."""

    points: Array
    faces: NDArray[np.int32]
    uv: Array
    along: Array

    def moved(self, points: Array) -> Surface:
        """The same with its points elsewhere."""
        return replace(self, points=points)

    def mirrored(self) -> Surface:
        """Its image on the other side of the plane z = 0."""
        return replace(self, points=self.points * np.array([1.0, 1.0, -1.0]), faces=self.faces[:, ::-1].copy())


def smooth_through(values: Sequence[Sequence[float]] | Array, at: Array, keys: Array | None = None) -> Array:
    """A curve through `values` [k, …] at `keys` (evenly from 0 to 1 if none are given), evaluated `at` [n]: cubic pieces whose
    slopes never overshoot the values (F. Fritsch and J. Butland, A method for constructing local monotone piecewise cubic
    interpolants, 1984)."""
    y = np.asarray(values, np.float64)
    x = np.linspace(0.0, 1.0, len(y)) if keys is None else np.asarray(keys, np.float64)
    if len(y) == 1:
        return np.broadcast_to(y[0], (len(at), *y.shape[1:])).copy()
    shape = (-1,) + (1,) * (y.ndim - 1)
    step = np.diff(x).reshape(shape)
    slope = np.diff(y, axis=0) / step
    inner = np.zeros_like(y)
    if len(y) > 2:
        a, b = slope[:-1], slope[1:]
        same = a * b > 0
        harmonic = 2 * a * b / np.where(same, a + b, 1.0)
        inner[1:-1] = np.where(same, harmonic, 0.0)
    inner[0], inner[-1] = slope[0], slope[-1]
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    t = ((at - x[k]) / (x[k + 1] - x[k])).reshape(shape)
    h = step[k]
    return np.asarray(
        y[k] * (1 + 2 * t) * (1 - t) ** 2 + inner[k] * h * t * (1 - t) ** 2 + y[k + 1] * t * t * (3 - 2 * t)
        - inner[k + 1] * h * t * t * (1 - t)
    )  # fmt: skip


def loft(
    path: Sequence[Point] | Array, high: Sequence[float] | Array, wide: Sequence[float] | Array, sides: int,
    up: Point = (0.0, 1.0, 0.0), square: float = 1.0,
) -> Surface:  # fmt: skip
    """Elliptic rings about the points of `path` [k, 3], across it, each with half its height along `up` and half its width,
    closed at both ends by a fan. `square` below 1 makes rings squarer (superellipses)."""
    path, high, wide = (np.asarray(each, np.float64) for each in (path, high, wide))
    count = len(path)
    ups, across = _frames(path, np.asarray(up, np.float64))
    angle = np.arange(sides + 1) / sides * 2 * np.pi
    c, s = np.cos(angle), np.sin(angle)
    c[-1], s[-1] = c[0], s[0]  # the seam is closed to the bit
    if square != 1.0:
        c, s = np.sign(c) * np.abs(c) ** square, np.sign(s) * np.abs(s) ** square
    rings = path[:, None] + (wide[:, None] * c)[..., None] * across[:, None] + (high[:, None] * s)[..., None] * ups[:, None]
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    along = length / max(length[-1], 1e-12)
    points = np.concatenate([rings.reshape(-1, 3), path[:1], path[-1:]])
    row, col = np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij")
    a = (row * (sides + 1) + col).reshape(-1)
    b, d, e = a + 1, a + sides + 1, a + sides + 2
    first, last = count * (sides + 1), count * (sides + 1) + 1
    turn = np.arange(sides)
    end = (count - 1) * (sides + 1) + turn
    faces = np.concatenate([
        np.stack([a, b, e], 1), np.stack([a, e, d], 1),
        np.stack([np.full(sides, first), turn + 1, turn], 1), np.stack([np.full(sides, last), end, end + 1], 1),
    ])  # fmt: skip
    u = np.broadcast_to(angle / (2 * np.pi), (count, sides + 1)).reshape(-1)
    v = np.repeat(0.02 + 0.96 * along, sides + 1)
    uv = np.concatenate([np.stack([u, v], 1), [[0.5, 0.0], [0.5, 1.0]]])
    return Surface(points, faces.astype(np.int32), uv, np.concatenate([np.repeat(along, sides + 1), [0.0, 1.0]]))


def _frames(path: Array, up: Array) -> tuple[Array, Array]:
    """Unit vectors [k, 3] up and across at each point of a path, carried along it without a twist."""
    way = np.gradient(path, axis=0)
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    ups = np.empty_like(path)
    now = up
    for k, along in enumerate(way):
        flat = now - along * float(now @ along)
        if np.linalg.norm(flat) < 1e-6:
            flat = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
        now = flat / np.linalg.norm(flat)
        ups[k] = now
    return ups, np.cross(ups, way)


def limb(
    path: Sequence[Point],
    radii: Sequence[float] | Array,
    sides: int,
    rings: int = 0,
    flat: float = 1.0,
    up: Point = (0.0, 1.0, 0.0),
) -> Surface:
    """A tube through the points of `path` with a radius at each, `flat` times as wide as it is high. `rings`: how many between
    its ends, which are round then; without as many as points."""
    at, radius = np.asarray(path, np.float64), np.asarray(radii, np.float64)
    if rings:
        key = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1))])
        where = np.linspace(0.0, 1.0, rings)
        at, radius = smooth_through(at, where, key / key[-1]), smooth_through(radius, where, key / key[-1])
        start, end = at[0] - at[1], at[-1] - at[-2]
        start, end = start / np.linalg.norm(start), end / np.linalg.norm(end)
        caps = np.array([0.45, 0.85])
        bulge = np.sqrt(1 - caps**2)
        at = np.concatenate([at[0] + start * radius[0] * bulge[:, None], at, at[-1] + end * radius[-1] * bulge[::-1, None]])
        radius = np.concatenate([caps * radius[0], radius, caps[::-1] * radius[-1]])
    return loft(at, radius, radius * flat, sides, up)


def ellipsoid(middle: Point, half: Point, detail: int) -> Surface:
    """An ellipsoid of 20 · 4^detail triangles."""
    ball, faces = sphere(detail)
    # A seam where u jumps from 1 to 0: triangles across it have points of their own.
    u = np.arctan2(ball[:, 2], ball[:, 0]) / (2 * np.pi) + 0.5
    v = np.arcsin(np.clip(ball[:, 1], -1, 1)) / np.pi + 0.5
    crossing = np.ptp(u[faces], axis=1) > 0.5
    late = np.unique(faces[crossing][u[faces[crossing]] < 0.5])
    twin = np.full(len(ball), -1)
    twin[late] = len(ball) + np.arange(len(late))
    split = faces.copy()
    rows = faces[crossing]
    split[crossing] = np.where(u[rows] < 0.5, twin[rows], rows)
    points = np.concatenate([ball, ball[late]])
    uv = np.stack([np.concatenate([u, np.ones(len(late))]), np.concatenate([v, v[late]])], 1)
    return Surface(points * np.array(half) + np.array(middle), split.astype(np.int32), uv, uv[:, 1])
