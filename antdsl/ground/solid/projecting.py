"""Onto the zero level: Newton steps along the gradient, bounded, and along the hint where the field is flat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.bricks import Bricks
from antdsl.ground.solid.trilinear import Columns, field

Floats = NDArray[np.float64]

CLOSE = 1e-5  # voxels: as near as float32 nodes make sense
SETTLING = 60
FLAT = 0.01  # square of a gradient that says nothing about the way


@dataclass(frozen=True, slots=True)
class Projected:
    """Places on the surface float64[n,3], unit normals out of the solid float64[n,3], and whether one was found in reach."""

    points: Floats
    normals: Floats
    found: NDArray[np.bool_]


def project(bricks: Bricks, points: Floats, hints: Floats, reach: float | None = None) -> Projected:
    """As `Volume.project`; where nothing is found the point stays, with its hint."""
    start = np.array(points, np.float64).reshape(-1, 3)
    hint = np.array(np.broadcast_to(np.asarray(hints, np.float64), start.shape))
    place, normal, found = settle(bricks, tuple(start.T), tuple(hint.T), CLOSE * bricks.voxel)
    landed, turned = np.stack(place, axis=1), np.stack(normal, axis=1)
    far = 2 * bricks.voxel if reach is None else float(reach)
    found &= ((landed - start) ** 2).sum(axis=1) <= far * far
    return Projected(np.where(found[:, None], landed, start), np.where(found[:, None], turned, hint), found)


def settle(
    bricks: Bricks, start: Columns, hint: Columns, close: Floats | float
) -> tuple[list[Floats], list[Floats], NDArray[np.bool_]]:
    """Places within `close` (mm) of the zero level, the unit normals there, and whether they were reached.

    Each step is as long as the distance, a voxel at most where the gradient shows the way. Where the field is flat (the middle of
    a cave, the depth of the solid) the way is along the hint: down in air, up in what is solid.
    """
    place = [np.array(p, np.float64) for p in start]
    normal = [np.array(h, np.float64) for h in hint]
    found = np.zeros(place[0].size, bool)
    rows = np.flatnonzero(np.isfinite(place[0] + place[1] + place[2]))
    within = np.broadcast_to(np.asarray(close, np.float64), found.shape)
    for turn in range(SETTLING):
        if not rows.size:
            break
        at = [p[rows] for p in place]
        d, gx, gy, gz = field(bricks, *at)
        square = (gx * gx + gy * gy) + gz * gz
        here = np.abs(d) <= within[rows]
        # Between two caves that meet, gradients send to and fro: each third step keeps to the hint.
        flat = (square < FLAT) | (turn % 3 == 2)
        done = np.flatnonzero(here & (square > 0))
        size = np.sqrt(square[done])
        for into, slope in zip(normal, (gx, gy, gz), strict=True):
            into[rows[done]] = slope[done] / size
        found[rows[here]] = True
        step = np.where(flat, -d, -d / np.where(flat, 1.0, square))
        length = np.abs(step) * np.sqrt(square)
        step *= np.where(flat | (length <= bricks.voxel), 1.0, bricks.voxel / np.where(length > 0, length, 1.0))
        away = np.flatnonzero(~here)
        for axis, slope in enumerate((gx, gy, gz)):
            way = np.where(flat, hint[axis][rows], slope)
            place[axis][rows[away]] += (step * way)[away]
        rows = rows[away]
    return place, normal, found
