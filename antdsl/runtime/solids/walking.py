"""Walking on a solid: short steps along the tangent, each put back on the zero level, headings turned as the normal turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.senses.walk import turned
from antdsl.runtime.solids.projecting import project
from antdsl.runtime.solids.volume import Volume

Floats = NDArray[np.float64]

_STRIDE = 0.5  # voxels


@dataclass(frozen=True, slots=True)
class Moved:
    """Where a step led. Vectors are float64[n,3]; lengths mm.

    `normal` is a unit vector out of the solid, `heading` a unit vector at right angles to it, `direction` the unit direction of
    travel at the end, in the surface. `travelled` is the way walked. `blocked` says that the way could not be walked to its end.
    """

    points: Floats
    normal: Floats
    heading: Floats
    direction: Floats
    travelled: Floats
    blocked: NDArray[np.bool_]


def move(volume: Volume, points: Floats, steps: Floats, heading: Floats, up: Floats) -> Moved:
    """Walk agents who stand on the zero level at `points` by `steps` [n,3], laid into the surface and kept in length.

    `up` [n,3] is the unit normal that each stands by. All stay on the surface, to a hundred-thousandth of a voxel.
    """
    place, normal = np.array(points, np.float64), np.array(up, np.float64)
    head, wish = np.array(heading, np.float64), np.nan_to_num(np.asarray(steps, np.float64), posinf=0.0, neginf=0.0)
    left = np.sqrt((wish * wish).sum(axis=1))
    way, gone, blocked = _tangent(wish, normal), np.zeros(len(place)), np.zeros(len(place), bool)
    stride = _STRIDE * volume.voxel
    rows = np.flatnonzero(left > 0)
    while rows.size:
        length = np.minimum(left[rows], stride)
        landed = project(volume.bricks, place[rows] + way[rows] * length[:, None], normal[rows], volume.voxel)
        ok = landed.found
        blocked[rows[~ok]] = True
        left[rows[~ok]] = 0.0
        on = rows[ok]
        before, after = normal[on].T, landed.normals[ok].T
        for vectors in (way, head):
            vectors[on] = turned(vectors[on].T, before, after, way[on].T).T
        place[on], normal[on] = landed.points[ok], landed.normals[ok]
        way[on] = _tangent(way[on], normal[on])
        left[on] -= length[ok]
        gone[on] += length[ok]
        rows = on[left[on] > 0]
    return Moved(place, normal, _tangent(head, normal), way, gone, blocked)


def _tangent(v: Floats, normal: Floats) -> Floats:
    """Unit vectors in the surface, as near to v as can be."""
    flat = v - (v * normal).sum(axis=1)[:, None] * normal
    size = np.sqrt((flat * flat).sum(axis=1))
    other = np.zeros_like(flat)
    other[np.arange(len(flat)), np.abs(normal).argmin(axis=1)] = 1.0
    other -= (other * normal).sum(axis=1)[:, None] * normal
    other /= np.maximum(np.sqrt((other * other).sum(axis=1)), 1e-30)[:, None]
    return np.where((size > 1e-9)[:, None], flat / np.maximum(size, 1e-30)[:, None], other)
