"""Bodies on ground with solids tilt no faster than they turn: over the rim of a tunnel, or from its floor onto its wall, in some
steps and not in one."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime import kernels
from antdsl.runtime.senses.ground import MoveResult
from antdsl.runtime.senses.walk import cross, dot, turned

Floats = NDArray[np.float64]

_LEANING = np.radians(60.0)  # off the normal of a mesh at most: up also says on which side of it one stands


def tilted(moved: MoveResult, up: Floats, most: NDArray[np.float32], solid: NDArray[np.bool_]) -> MoveResult:
    """What a walk led to, `up` turned from that before it ([n,3]) by at most `most` (radians, inf for any) a body.

    Heading and direction turn with it. `solid` says who has come to stand on a solid; others are close to their normal already,
    or are taken so far."""
    before, after = np.asarray(up, np.float64).T, moved.up.T
    hasty = np.flatnonzero(dot(before, after) < kernels.wide_cos(np.minimum(most, np.pi)))
    if not len(hasty):
        return moved
    a, b, direction = (v.take(hasty, axis=1) for v in (before, after, moved.direction.T))
    axis = cross(a, b)
    sine = np.sqrt(dot(axis, axis))
    whole = kernels.wide_atan2(sine, dot(a, b))
    angle = np.minimum(most[hasty], whole)
    angle = np.where(solid[hasty], angle, np.maximum(angle, whole - _LEANING))
    # Half a turn has no axis of its own: it goes forward, over the way walked.
    axis = np.where(sine > 1e-9, axis / np.maximum(sine, 1e-300), cross(a, direction))
    stood = a * kernels.wide_cos(angle) + cross(axis, a) * kernels.wide_sin(angle)
    stood /= np.sqrt(dot(stood, stood))
    heading = turned(moved.heading.T.take(hasty, axis=1), b, stood, direction)
    found = {}
    for name, some in (("up", stood), ("heading", heading), ("direction", turned(direction, b, stood, direction))):
        vectors = np.array(getattr(moved, name).T, order="C")
        vectors[:, hasty] = some
        found[name] = vectors.T
    return dataclasses.replace(moved, **found)
