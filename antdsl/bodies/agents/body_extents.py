"""Extents of bodies as they stand: in their idle clip, because a rest pose may have its arms spread."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.boxes import posed_box, rest_box
from antdsl.bodies.agents.definition import Definition, Layer
from antdsl.bodies.agents.poses import clip_table, sample_poses, square_matrices, transforms

Corners = tuple[NDArray[np.float64], NDArray[np.float64]]


def standing_box(body: Definition, layer: Layer) -> Corners:
    """Return the lowest and highest corners [3] of a layer at the start of the idle clip, in agent space: body lengths, front
    +x, up +y. Without an idle clip it is the box in the rest pose."""
    own = replace(body, layers={layer.name: layer})
    if body.idle not in body.clips:
        return turn_box(body, rest_box(own))
    table = clip_table(body)
    _, world = transforms(table, sample_poses(table, np.array([table.number(body.idle)]), np.zeros(1)))
    matrices = np.empty((len(table.order), 4, 4))
    matrices[table.order] = square_matrices(world.transpose(3, 2, 0, 1))[0]
    return turn_box(body, posed_box(own, matrices))


def turn_box(body: Definition, box: Corners) -> Corners:
    """Return a box of a definition's space in agent space."""
    corners = np.array([[box[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])
    turned = corners @ body.base_matrix()[:3, :3].T
    return turned.min(axis=0), turned.max(axis=0)
