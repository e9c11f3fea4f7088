"""Finds open borders without another surface beyond them. Agents can walk along these without a search."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.boxes import FaceBoxes
from antdsl.ground.mesh.surroundings import (
    BORDER_GAP_BODY_LENGTHS,
    BORDER_RAY_HEIGHT_BODY_LENGTHS,
    EYE_HEIGHT_BODY_LENGTHS,
    GroundTolerances,
)
from antdsl.ground.mesh.topology import NO_LINKED_EDGE, MeshTopology
from antdsl.numerics.vectors import dot

Index = NDArray[np.int64]

_MAX_BORDERS = 10_000  # maximum number of searched borders
_MAX_BORDER_PAIRS, _PAIRS_PER_CHUNK = 1_000_000, 50_000  # pairs of a border and a nearby face: maximum per ground, and per chunk
# Relative to the tolerances: larger than the rounding error of a corner, smaller than the width of any search path.
_PLANE_TOLERANCE = 1e-4


def find_open_borders(table: MeshTopology, boxes: FaceBoxes, scale: GroundTolerances, max_body_size: float) -> Index:
    """Return half-edges without a neighbour on either side, beyond which bodies of up to `max_body_size` mm have nowhere to step.

    For them, `find_landing_beyond_border` finds no landing. Some are omitted on a ground that is mostly borders, or has faces
    much smaller than the bodies: a complete search would take too long.

    The search paths of `find_landing_beyond_border` are in the plane perpendicular to the edge: above or below the face, or
    beyond the border. They hit nothing under two conditions. All other nearby faces are in the plane of the edge's face, and none
    of them extends beyond the line of the edge. All search paths are then at least one gap away from these faces."""
    half = np.flatnonzero((table.link[0] == NO_LINKED_EDGE) & (table.link[1] == NO_LINKED_EDGE) & np.repeat(table.is_live, 3))[
        :_MAX_BORDERS
    ]
    reach = 1.01 * (
        (BORDER_RAY_HEIGHT_BODY_LENGTHS + BORDER_GAP_BODY_LENGTHS)
        * float(np.fmax(max_body_size, scale.min_eye_height / EYE_HEIGHT_BODY_LENGTHS))
        + 4 * scale.coincident_distance
    )
    batches, begin, many, left = [half[:0]], 0, 1, _MAX_BORDER_PAIRS
    while begin < len(half) and left > 0:
        batch = half[begin : begin + many]
        is_open, pairs = _find_borders_without_ground_beyond(table, boxes, scale, reach, batch)
        batches.append(batch[is_open])
        begin, left = begin + many, left - pairs
        many = max(1, min(2 * many, _PAIRS_PER_CHUNK * len(batch) // max(pairs, 1)))
    return np.concatenate(batches)


def _find_borders_without_ground_beyond(
    table: MeshTopology, boxes: FaceBoxes, scale: GroundTolerances, reach: float, half: Index
) -> tuple[NDArray[np.bool_], int]:
    """Return a mask of the half-edges in `half` beyond which there is no ground, and the number of checked pairs.

    A pair consists of a half-edge and a face within `reach` mm of the half-edge's box."""
    face, k = half // 3, half % 3
    one, other = _get_corners(table, face, (k + 1) % 3), _get_corners(table, face, (k + 2) % 3)
    edge_rows, near_faces = boxes.find_overlapping_pairs(np.minimum(one, other) - reach, np.maximum(one, other) + reach)
    edge_rows, near_faces = (each[near_faces != face.take(edge_rows)] for each in (edge_rows, near_faces))
    out = table.to_world_vectors(face, table.edge_s.take(half), -table.edge_c.take(half)).take(edge_rows, axis=1)
    normal, begin = table.normal.take(face.take(edge_rows), axis=1), one.take(edge_rows, axis=1)
    is_open, least = np.ones(len(half), np.bool_), _PLANE_TOLERANCE * scale.coincident_distance
    for corner in range(3):
        away = _get_corners(table, near_faces, np.full(len(near_faces), corner)) - begin
        is_open[edge_rows[~((np.abs(dot(away, normal)) <= least) & (dot(away, out) <= least))]] = False
    return is_open, len(edge_rows)


def _get_corners(table: MeshTopology, face: Index, k: Index) -> NDArray[np.float64]:
    """Return one corner of each face, (3, n). `k`: the number of the corner, 0 to 2."""
    edge = np.where(k == 1, table.edge1.take(face, axis=1), table.edge2.take(face, axis=1))
    corners: NDArray[np.float64] = table.corner.take(face, axis=1) + np.where(k == 0, 0.0, edge)
    return corners
