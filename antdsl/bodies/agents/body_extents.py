"""Extents of standing bodies. They are measured in the idle clip, because the arms may be spread in the rest pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.boxes import compute_posed_box, compute_rest_box
from antdsl.bodies.agents.definition import Definition, Layer
from antdsl.bodies.agents.poses import build_clip_table, compute_transforms, sample_poses, to_square_matrices

Corners = tuple[NDArray[np.float64], NDArray[np.float64]]


def compute_standing_box(body: Definition, layer: Layer) -> Corners:
    """Return the lowest and the highest corner [3] of a layer's bounding box at the start of the idle clip, in agent space.

    Units are body lengths, with front +x and up +y. Without an idle clip, the rest pose is used."""
    own = replace(body, layers={layer.name: layer})
    if body.idle not in body.clips:
        return rotate_box_to_agent_space(body, compute_rest_box(own))
    table = build_clip_table(body)
    _, world = compute_transforms(table, sample_poses(table, np.array([table.find_clip(body.idle)]), np.zeros(1)))
    matrices = np.empty((len(table.joint_order), 4, 4))
    matrices[table.joint_order] = to_square_matrices(world.transpose(3, 2, 0, 1))[0]
    return rotate_box_to_agent_space(body, compute_posed_box(own, matrices))


def rotate_box_to_agent_space(body: Definition, box: Corners) -> Corners:
    """Convert a box from the definition's space to agent space: body lengths, front +x, up +y. Return its lowest and highest
    corner."""
    corners = np.array([[box[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])
    turned = corners @ body.compute_base_matrix()[:3, :3].T
    return turned.min(axis=0), turned.max(axis=0)
