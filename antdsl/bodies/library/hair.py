"""Bristles as thin pyramids of four triangles, scattered evenly over a surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.library.modelling import Model, Weights, normals_of
from antdsl.bodies.library.surfaces import Array, Point, Surface

_CANDIDATES = 8  # places that are drawn for each that is taken
_THICK = 0.035  # of its length


def hairs(
    model: Model, surface: Surface, follows: str | Weights, count: int, length: float, *, seed: int,
    where: Callable[[Array, Array], NDArray[np.bool_]] | None = None, lean: Point = (-0.5, 0.3, 0.0), both: bool = False,
) -> None:  # fmt: skip
    """Adds `count` hairs to a model that follow what the `surface` follows. `where` says of places and normals [n, 3] which are
    taken; `lean` is added to the way that a hair stands. `both`: on the left as well.

    Each is the one of many places that is farthest from those before (D. Mitchell, Spectrally optimal sampling, 1991)."""
    draw = np.random.Generator(np.random.Philox(seed))
    corners, normals = surface.points[surface.faces], normals_of(surface)[surface.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    many = count * _CANDIDATES * 2
    rows = np.searchsorted(np.cumsum(area) / area.sum(), draw.random(many))
    a, b = draw.random((2, many, 1))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    place = corners[rows, 0] * (1 - a - b) + corners[rows, 1] * a + corners[rows, 2] * b
    normal = normals[rows].mean(axis=1)
    along = surface.along[surface.faces[rows, 0]]
    if where is not None:
        kept = where(place, normal)
        place, normal, along = place[kept], normal[kept], along[kept]
    chosen = _apart(place, min(count, len(place)))
    place, normal, along = place[chosen], normal[chosen], along[chosen]
    way = normal + np.asarray(lean) + 0.25 * draw.normal(size=normal.shape)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    long = length * draw.uniform(0.65, 1.15, len(place))
    made = _pyramids(place - 0.08 * long[:, None] * normal, way, long, along)
    (model.both if both else model.add)(made, follows, "hair", "hair")


def _apart(place: Array, count: int) -> NDArray[np.intp]:
    """Rows of places that are far from each other: the first, then always the one farthest from those taken."""
    taken = np.zeros(count, np.intp)
    far = np.full(len(place), np.inf)
    for k in range(1, count):
        far = np.minimum(far, ((place - place[taken[k - 1]]) ** 2).sum(1))
        taken[k] = far.argmax()
    return taken


def _pyramids(place: Array, way: Array, length: Array, along: Array) -> Surface:
    beside = np.cross(way, np.where(np.abs(way[:, :1]) < 0.8, np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]])))
    beside /= np.linalg.norm(beside, axis=1, keepdims=True)
    other = np.cross(way, beside)
    turn = np.arange(3) * 2 * np.pi / 3
    foot = place[:, None] + (_THICK * length)[:, None, None] * (
        np.cos(turn)[None, :, None] * beside[:, None] + np.sin(turn)[None, :, None] * other[:, None]
    )
    tip = place + way * length[:, None]
    points = np.concatenate([foot, tip[:, None]], 1).reshape(-1, 3)
    one = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]])
    faces = (one[None] + 4 * np.arange(len(place))[:, None, None]).reshape(-1, 3)
    uv = np.tile([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [0.5, 1.0]], (len(place), 1))
    return Surface(points, faces.astype(np.int32), uv, np.repeat(along, 4))
