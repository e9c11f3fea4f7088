"""Inside or outside, exactly: along lines through the nodes, each triangle crossed adds or takes one winding."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.bricks import CUBE, SIDE
from antdsl.ground.solid.lattice import boxes
from antdsl.scene.geometry.closed import grained, open_edges

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

_PIECE = 1 << 16  # pairs of triangle and line looked at together


class Shell:
    """A mesh as integers, so that which side of a line a place is on has no doubt: from corners float64[n,3,3] in voxels."""

    def __init__(self, corners: Floats) -> None:
        self.corners, self.grain = grained(corners)
        self.open_edges, self.wound = open_edges(self.corners)


def brick_signs(shell: Shell, shape: tuple[int, int, int], near: Index) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether the first node of each brick is inside (all bricks), and whether each node is, bool[len(near), 4096], of some
    bricks, ascending. Inside is where the winding number is not 0, or odd where faces are not wound alike."""
    x, y, z, way = _crossings(shell)
    nodes = [n * SIDE for n in shape]
    slab = x >> 4
    order = np.argsort(slab, kind="stable")
    place = (((x & 15) * nodes[1] + y) * nodes[2] + z)[order]
    way = way[order]
    ends = np.searchsorted(slab[order], np.arange(shape[0] + 1))
    flags = np.zeros(shape, bool)
    inside = np.zeros((near.size, CUBE), bool)
    per_slab = shape[1] * shape[2]
    parts = np.searchsorted(near, np.arange(shape[0] + 1) * per_slab)
    count = np.zeros(SIDE * nodes[1] * nodes[2], np.int16)
    for s in range(shape[0]):
        count[:] = 0
        np.add.at(count, place[ends[s] : ends[s + 1]], way[ends[s] : ends[s + 1]])
        wound = np.cumsum(count.reshape(SIDE * nodes[1], nodes[2]), axis=1, dtype=np.int16)
        within = (wound != 0 if shell.wound else wound % 2 != 0).reshape(SIDE, shape[1], SIDE, shape[2], SIDE)
        flags[s] = within[0, :, 0, :, 0]
        chosen = near[parts[s] : parts[s + 1]] - s * per_slab
        inside[parts[s] : parts[s + 1]] = within[:, chosen // shape[2], :, chosen % shape[2], :].reshape(chosen.size, CUBE)
    return flags.ravel(), inside


def _crossings(shell: Shell) -> tuple[Index, Index, Index, NDArray[np.int16]]:
    """Where lines along the last axis cross triangles: the line (x, y), the first node beyond, and the winding from there on."""
    tri = shell.corners
    grain = shell.grain
    low = -((-tri.min(axis=1)) // grain)
    count = tri.max(axis=1) // grain - low + 1
    found = [_crossed(tri, grain, *places) for places in boxes(low[:, :2], count[:, :2], _PIECE)]
    if not found:
        none = np.empty(0, np.int64)
        return none, none, none, np.empty(0, np.int16)
    x, y, z, way = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return x, y, z, way


def _crossed(tri: Index, grain: int, t: Index, x: Index, y: Index) -> tuple[Index, Index, Index, NDArray[np.int16]]:
    px, py = x * grain, y * grain
    areas, above, below = [], np.ones(t.size, bool), np.ones(t.size, bool)
    for i, j in ((1, 2), (2, 0), (0, 1)):
        ax, ay, bx, by = tri[t, i, 0], tri[t, i, 1], tri[t, j, 0], tri[t, j, 1]
        area = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
        # A place on the line counts as moved by next to nothing along x, and by far less along y: no line is met at its end.
        tie = np.where(by != ay, ay - by, bx - ax)
        side = np.where(area != 0, area, tie)
        above &= side > 0
        below &= side < 0
        areas.append(area)
    hit = np.flatnonzero(above | below)
    weight = [area[hit].astype(np.float64) for area in areas]
    total = (weight[0] + weight[1]) + weight[2]
    t = t[hit]
    height = (weight[0] * tri[t, 0, 2] + weight[1] * tri[t, 1, 2]) + weight[2] * tri[t, 2, 2]
    level = np.floor(height / (total * grain)).astype(np.int64) + 1
    return x[hit], y[hit], level, np.where(above[hit], 1, -1).astype(np.int16)
