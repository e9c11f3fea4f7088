"""Handles places where a piece of surface cuts the face that an agent walks on. The path then continues on the cutting face, or
ends at the cut."""

from __future__ import annotations

import numpy as np

from antdsl.ground.mesh.face_table import (
    AXIS1_OFFSET,
    AXIS2_OFFSET,
    CORNER_OFFSET,
    EDGE1_OFFSET,
    EDGE2_OFFSET,
    FLOATS_PER_FACE_ROW,
    NORMAL_OFFSET,
    RATE1_OFFSET,
    RATE2_OFFSET,
    SHEAR_OFFSET,
)
from antdsl.ground.mesh.surroundings import compute_surface_stance
from antdsl.ground.mesh.topology import NO_LINKED_EDGE
from antdsl.ground.mesh.walkers import CutTables, FaceWalker, NearbySurfaces, SurfaceLanding, SurfaceTables
from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, Array2, inlined, kernel_helper
from antdsl.numerics.kernel_vectors import TriangleWeights, Vec3, clamp_weights, dot, fmax, load_vector, minus, plus, times

MIN_TOUCHES_OFF_FACE = 16.0  # distance, in touch lengths, of feet from the face they left: more than the tolerance of its border
MIN_SQUARED_CUT_SINE = 1e-6  # squared sine of the angle of a cut; limits how far feet are moved from a flat cut
MAX_RUN_PER_RISE = 1e3  # mm along a face per mm up, above which the face counts as level


@kernel_helper
def find_surface_crossing(
    surface: SurfaceTables, around: NearbySurfaces, cuts: CutTables, walker: FaceWalker, length: F64
) -> SurfaceLanding:
    """Return the landing on the first face that cuts the current face across the path. Only faces of the same piece of the ground
    count. The path continues there.

    The path ends instead if it would continue on the other side of an open sheet, or if there is no space. The search of
    `surroundings`, from above the ground, cannot find such faces: near a cut, any point above the feet may already be behind
    another sheet.

    Feet stay at least the touch distance (mm) away from the cutting face. This is a thousand times the rounding error of float64,
    so it is always certain on which side of the face they are."""
    table, link, f, side = surface.face_table, surface.edge_links, walker.face, walker.side
    (first, others), touch = cuts, around.length_tolerances.touch_distance
    place, up, direction = compute_surface_stance(table, walker)
    face, best, best_distance, soonest = -1, np.inf, length, np.inf
    for k in range(first[f], first[f + 1]):
        other = others[k]
        row = FLOATS_PER_FACE_ROW * other
        normal, corner = load_vector(table, row + NORMAL_OFFSET), load_vector(table, row + CORNER_OFFSET)
        begins = dot(normal, minus(place, corner))
        towards = dot(normal, direction)
        ends = begins + towards * length
        if not (begins * ends <= 0 or (abs(ends) <= touch and abs(ends) < abs(begins))) or not abs(begins) > touch:
            continue
        # A face that does not rise above the plane of the feet is below the current sheet.
        rise = fmax(fmax(dot(up, load_vector(table, row + EDGE1_OFFSET)), dot(up, load_vector(table, row + EDGE2_OFFSET))), 0.0)
        if not dot(up, minus(corner, place)) + rise > touch:
            continue
        crossing_distance = min(max(begins / (begins - ends if begins != ends else 1.0), 0.0), 1.0) * length
        crossing_place = plus(place, times(direction, crossing_distance))
        if not _is_within_face(table, row, crossing_place, 4 * touch) or not _is_crossing_to_other_side(
            table, link, f, side, other, begins, crossing_place, touch
        ):
            continue
        # Keep a distance from the surface that was left: otherwise the next step could not tell the side of the feet.
        # So the face that is first at that distance counts.
        leans = -dot(up, normal) / (towards if towards != 0 else 1.0)
        late = crossing_distance + MIN_TOUCHES_OFF_FACE * touch * min(max(leans, -MAX_RUN_PER_RISE), MAX_RUN_PER_RISE)
        soonest = min(soonest, crossing_distance)
        if late < best or (late == best and other < face):
            face, best, best_distance = other, late, crossing_distance
    if face < 0:
        return SurfaceLanding(-1, (0.0, 0.0), 1.0, length, 0.0, False)
    row = FLOATS_PER_FACE_ROW * face
    normal = load_vector(table, row + NORMAL_OFFSET)
    crossing_place, towards = plus(place, times(direction, best_distance)), dot(normal, direction)
    steep = minus(up, times(normal, dot(up, normal)))
    off = times(steep, MIN_TOUCHES_OFF_FACE * touch / max(dot(steep, steep), MIN_SQUARED_CUT_SINE))
    pieces, side_groups = around.sides
    back = pieces[f] == pieces[face] and side_groups[1 if side < 0 else 0, f] != side_groups[1 if towards > 0 else 0, face]
    if back or _is_blocked_by_third_sheet(table, cuts, face, f, crossing_place, off, touch):
        # Up to the distance that feet keep from the cutting face; in a corner, not at all.
        near = 0.0
        if back:
            near = max(soonest - MIN_TOUCHES_OFF_FACE * touch / max(abs(towards), 1 / MAX_RUN_PER_RISE), 0.0)
        weights = _compute_landing_weights(table, FLOATS_PER_FACE_ROW * f, plus(place, times(direction, near)))
        return SurfaceLanding(
            f,
            weights,
            (-1.0 if -dot(load_vector(table, FLOATS_PER_FACE_ROW * f + NORMAL_OFFSET), up) > 0 else 1.0),
            near,
            0.0,
            True,
        )
    return SurfaceLanding(
        face,
        _compute_landing_weights(table, row, plus(crossing_place, off)),
        (-1.0 if towards > 0 else 1.0),
        best_distance,
        0.0,
        False,
    )


@inlined
def _transform_to_face_frame(table: Array1[F64], row: I64, place: Vec3) -> tuple[F64, F64]:
    """Return the coordinates of a position along the two axes of a face, relative to the face's first corner."""
    off = minus(place, load_vector(table, row + CORNER_OFFSET))
    return dot(load_vector(table, row + AXIS1_OFFSET), off), dot(load_vector(table, row + AXIS2_OFFSET), off)


@inlined
def _compute_weights(table: Array1[F64], row: I64, place: Vec3) -> TriangleWeights:
    """Project a nearby position onto a face. Return its barycentric weights, clamped to the triangle."""
    c, s = _transform_to_face_frame(table, row, place)
    return clamp_weights(c * table[row + RATE1_OFFSET] - s * table[row + SHEAR_OFFSET] + 0.0, s * table[row + RATE2_OFFSET] + 0.0)


@inlined
def _compute_landing_weights(table: Array1[F64], row: I64, place: Vec3) -> TriangleWeights:
    """Project a position onto a face. Return its barycentric weights, corrected for rounding."""
    b1, b2 = _compute_weights(table, row, place)
    return clamp_weights(b1 + 0.0, b2 + 0.0)  # clamped again, because rounding may have moved them


@inlined
def _is_within_face(table: Array1[F64], row: I64, place: Vec3, touch: F64) -> BOOL:
    """Return whether a position in the plane of a face is inside the face, or at most about `touch` mm outside it."""
    c, s = _transform_to_face_frame(table, row, place)
    rate1, rate2, shear = table[row + RATE1_OFFSET], table[row + RATE2_OFFSET], table[row + SHEAR_OFFSET]
    b1, b2 = c * rate1 - s * shear, s * rate2
    over = touch * (abs(rate1) + abs(rate2) + abs(shear))
    return b1 >= -over and b2 >= -over and b1 + b2 <= 1 + over


@inlined
def _find_lowest_corner_height(table: Array1[F64], face: I64, other: I64, sign: F64) -> F64:
    """Return the height of the lowest corner of `face` over the plane of the face `other`. `sign`: 1 if heights are along the
    plane's normal, -1 if they are against it."""
    row, other_row = FLOATS_PER_FACE_ROW * face, FLOATS_PER_FACE_ROW * other
    up = times(load_vector(table, other_row + NORMAL_OFFSET), sign)
    first = dot(up, minus(load_vector(table, row + CORNER_OFFSET), load_vector(table, other_row + CORNER_OFFSET)))
    return first + min(min(dot(up, load_vector(table, row + EDGE1_OFFSET)), dot(up, load_vector(table, row + EDGE2_OFFSET))), 0.0)


@inlined
def _is_crossing_to_other_side(
    table: Array1[F64],
    link: Array2[I32],
    face: I64,
    side: F64,
    other_face: I64,
    start_height: F64,
    crossing_place: Vec3,
    touch: F64,
) -> BOOL:
    """Return whether a path continues beyond the plane of the face `other_face`, which it reaches at `crossing_place`.
    `start_height`: the signed height of the path's start over the plane.

    It does not if the current face only touches `other_face`, and the neighbour of the current face folds back into a wedge
    without space."""
    sign = -1.0 if start_height < 0 else 1.0
    if not _find_lowest_corner_height(table, face, other_face, sign) >= -touch:
        return True
    b1, b2 = _compute_weights(table, FLOATS_PER_FACE_ROW * face, crossing_place)
    edge, least = 0, 1.0 - b1 - b2
    if b1 < least:
        edge, least = 1, b1
    if b2 < least:
        edge = 2
    beyond = link[1 if side < 0 else 0, 3 * face + edge]
    if beyond == NO_LINKED_EDGE:
        return True
    return _find_lowest_corner_height(table, beyond >> 3, other_face, sign) < -touch


@inlined
def _is_blocked_by_third_sheet(
    table: Array1[F64], cuts: CutTables, face: I64, own_face: I64, place: Vec3, offset: Vec3, touch: F64
) -> BOOL:
    """Return whether a third sheet prevents an agent from stepping onto `face` at the position `place`.

    This is so if feet that are moved by `offset` away from `own_face` would pass through or touch the third sheet."""
    first, others = cuts
    is_tight = False
    for k in range(first[face], first[face + 1]):
        third = others[k]
        if third == own_face:
            continue
        row = FLOATS_PER_FACE_ROW * third
        normal = load_vector(table, row + NORMAL_OFFSET)
        begins = dot(normal, minus(place, load_vector(table, row + CORNER_OFFSET)))
        ends = begins + dot(normal, offset)
        is_touched = (begins * ends < 0 and abs(begins) > touch) or abs(ends) <= touch
        is_tight = is_tight or (is_touched and _is_within_face(table, row, place, 2 * MIN_TOUCHES_OFF_FACE * touch))
    return is_tight
