"""Onto the zero level: Newton steps along the gradient, bounded, and along the hint where the field is flat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.bricks import Bricks
from antdsl.ground.solid.trilinear import Grid, field_at, grid_of
from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, Array1, Array2, called, kernel
from antdsl.numerics.kernel_vectors import Vec3, dot

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
    start = np.array(points, np.float64, order="C").reshape(-1, 3)
    hint = np.array(np.broadcast_to(np.asarray(hints, np.float64), start.shape), order="C")
    landed, turned, found = np.empty_like(start), np.empty_like(start), np.empty(len(start), np.bool_)
    settle(grid_of(bricks), start, hint, CLOSE * bricks.voxel, landed, turned, found)
    far = 2 * bricks.voxel if reach is None else float(reach)
    found &= ((landed - start) ** 2).sum(axis=1) <= far * far
    return Projected(np.where(found[:, None], landed, start), np.where(found[:, None], turned, hint), found)


@kernel
def settle(
    bricks: Grid,
    start: Array2[F64],
    hints: Array2[F64],
    close: F64,
    places: Array2[F64],
    normals: Array2[F64],
    found: Array1[BOOL],
) -> None:
    """As `settle_at`, of places and hints [n,3], into the last three arrays."""
    for i in range(found.size):
        p, hint = (start[i, 0], start[i, 1], start[i, 2]), (hints[i, 0], hints[i, 1], hints[i, 2])
        found[i], q, normal = settle_at(bricks[0], bricks[1], bricks[2:], p, hint, close)
        for k in range(3):
            places[i, k], normals[i, k] = q[k], normal[k]


@called
def settle_at(
    table: Array1[I32], values: Array1[F32], grid: tuple[F64, F64, F64, F64, I64, I64, I64], p: Vec3, hint: Vec3, close: F64
) -> tuple[BOOL, Vec3, Vec3]:
    """Whether the surface was found, a place within `close` (mm) of it and the normal there; those given where not.

    Each step is as long as the distance, a voxel at most where the gradient shows the way. Where the field is flat (the middle of
    a cave, the depth of the solid) the way is along the hint: down in air, up in what is solid.
    """
    voxel = grid[3]
    q = p
    if not np.isfinite(p[0] + p[1] + p[2]):
        return False, p, hint
    for turn in range(SETTLING):
        d, g = field_at(table, values, grid, q)
        square = dot(g, g)
        if abs(d) <= close:
            if square > 0:
                size = np.sqrt(square)
                return True, q, (g[0] / size, g[1] / size, g[2] / size)
            return True, q, hint
        # Between two caves that meet, gradients send to and fro: each third step keeps to the hint.
        flat = square < FLAT or turn % 3 == 2
        step = -d if flat else -d / square
        length = abs(step) * np.sqrt(square)
        if not (flat or length <= voxel):
            step = step * (voxel / length)
        ahead = hint if flat else g
        q = (q[0] + step * ahead[0], q[1] + step * ahead[1], q[2] + step * ahead[2])
    return False, p, hint
