"""The field between the nodes: trilinear in each cell, continuous everywhere, with its exact gradient."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.solids.bricks import Bricks

Floats = NDArray[np.float64]
Distances = NDArray[np.float32]
Corners = tuple[Distances, Distances, Distances, Distances, Distances, Distances, Distances, Distances]


def sample(bricks: Bricks, points: Floats) -> Distances:
    """Signed distance float32[n] at points [n,3]."""
    (v000, v001, v010, v011, v100, v101, v110, v111), (fx, fy, fz) = _corners(bricks, points)
    v00, v01, v10, v11 = _mix(v000, v001, fz), _mix(v010, v011, fz), _mix(v100, v101, fz), _mix(v110, v111, fz)
    return _mix(_mix(v00, v01, fy), _mix(v10, v11, fy), fx)


def sample_and_gradient(bricks: Bricks, points: Floats) -> tuple[Distances, Distances]:
    """Signed distance float32[n] and gradient float32[n,3] at points [n,3]."""
    (v000, v001, v010, v011, v100, v101, v110, v111), (fx, fy, fz) = _corners(bricks, points)
    v00, v01, v10, v11 = _mix(v000, v001, fz), _mix(v010, v011, fz), _mix(v100, v101, fz), _mix(v110, v111, fz)
    v0, v1 = _mix(v00, v01, fy), _mix(v10, v11, fy)
    gradient = np.empty((3, len(fx)), np.float32)
    scale = np.float32(1.0 / bricks.voxel)
    gradient[0] = (v1 - v0) * scale
    gradient[1] = _mix(v01 - v00, v11 - v10, fx) * scale
    along = _mix(v001 - v000, v011 - v010, fy), _mix(v101 - v100, v111 - v110, fy)
    gradient[2] = _mix(along[0], along[1], fx) * scale
    return _mix(v0, v1, fx), gradient.T


def _mix(a: Distances, b: Distances, t: Distances) -> Distances:
    return a + (b - a) * t


def _corners(bricks: Bricks, points: Floats) -> tuple[Corners, tuple[Distances, Distances, Distances]]:
    """Values at the corners of the cells that points [n,3] lie in, and where in them, 0 .. 1."""
    low: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
    parts: list[Distances] = []
    strides = ((bricks.shape[1] * bricks.shape[2], 256), (bricks.shape[2], 16), (1, 1))
    for axis, (brick_stride, stride) in enumerate(strides):
        place = (points[:, axis] - bricks.origin[axis]) * (1.0 / bricks.voxel)
        place = np.fmin(np.fmax(place, 0.0), bricks.nodes[axis] - 1.0)
        node = np.minimum(place.astype(np.int64), bricks.nodes[axis] - 2)
        parts.append((place - node).astype(np.float32))
        for n in (node, node + 1):
            low.append(((n >> 4) * brick_stride, (n & 15) * stride))
    found = []
    for x in low[0:2]:
        for y in low[2:4]:
            for z in low[4:6]:
                slot = bricks.table.take(x[0] + y[0] + z[0])
                found.append(bricks.values.take(slot.astype(np.int64) * 4096 + (x[1] + y[1] + z[1])))
    return tuple(found), tuple(parts)  # type: ignore[return-value]
