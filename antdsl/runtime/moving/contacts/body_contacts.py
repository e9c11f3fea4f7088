"""Contacts of bodies with the triangles around them. Computes the shift that moves a body outside, and the depth that remains."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.ground.mesh.boxes import FaceBoxTree, FaceList, find_first_face_hit, is_disjoint, list_faces_near_segment
from antdsl.ground.mesh.face_table import CORNER_OFFSET, EDGE1_OFFSET, EDGE2_OFFSET, FLOATS_PER_FACE_ROW, NORMAL_OFFSET
from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, inlined, kernel_helper
from antdsl.numerics.kernel_vectors import Vec3, dot, find_nearest_weights, load_vector, minus, plus, times
from antdsl.runtime.moving.clearance.body_paths import BodyShape

MAX_SHIFT_ROUNDS = 4  # shifts of a body out of its contacts before the depth is measured
_ANCHOR_HEIGHT_BODY_LENGTHS = 0.004  # body lengths above the feet; the middle must be visible from this point
_AXIS_POINT_COUNT = 9  # points on the axis of a capsule from which the nearest face is searched
_SLACK_BODY_LENGTHS = 0.004  # body lengths; a shallower overlap needs no shift
_MARGIN_BODY_LENGTHS = 0.3  # body lengths around a body within which faces are searched


class BodyStance(NamedTuple):
    """A body of `size` mm that stands at `position` on ground with a `normal`."""

    position: Vec3
    normal: Vec3
    up: Vec3
    heading: Vec3
    size: F64


class BodyShift(NamedTuple):
    """The shift of a body from its stance (mm), its remaining depth inside a surface (mm), and the direction out of the
    surface."""

    shift: Vec3
    remaining_depth: F64
    outward_direction: Vec3


@inlined
def _get_axis_point(middle: Vec3, heading: Vec3, half_length: F64, index: I64) -> Vec3:
    """Return one of the points at which the axis of a capsule is sampled. `index`: the number of the point."""
    return plus(middle, times(heading, half_length * (2.0 * np.float64(index) / (_AXIS_POINT_COUNT - 1) - 1.0)))


@kernel_helper
def _is_body_touching_face(
    table: Array1[F64],
    box_tree: FaceBoxTree,
    faces: FaceList,
    count: I64,
    shape: BodyShape,
    anchor: Vec3,
    middle: Vec3,
    heading: Vec3,
) -> BOOL:
    """Return whether one of the first `count` faces of a list touches a capsule.

    A face touches the capsule if it crosses the axis or the line from `anchor` to the axis. It also does if its distance from
    the axis is less than the radius."""
    half, radius = times(heading, shape.axis_half_length), shape.radius
    tip = times(heading, shape.axis_half_length + radius)
    one, two = minus(middle, half), plus(middle, half)
    low_x, low_y, low_z = min(one[0], two[0]) - radius, min(one[1], two[1]) - radius, min(one[2], two[2]) - radius
    high_x, high_y, high_z = max(one[0], two[0]) + radius, max(one[1], two[1]) + radius, max(one[2], two[2]) + radius
    if find_first_face_hit(table, box_tree, faces, count, anchor, minus(middle, anchor), 0.0).face >= 0:
        return True
    for k in range(count):
        b = faces.face_numbers[faces.first_index + k]
        if is_disjoint(box_tree.bounds, b, low_x, low_y, low_z, high_x, high_y, high_z):
            continue
        row = FLOATS_PER_FACE_ROW * box_tree.triangle_order[b]
        corner, normal = load_vector(table, row + CORNER_OFFSET), load_vector(table, row + NORMAL_OFFSET)
        at_one, at_two = dot(minus(one, corner), normal), dot(minus(two, corner), normal)
        if min(at_one, at_two) >= radius or max(at_one, at_two) <= -radius:
            continue
        edge1, edge2 = load_vector(table, row + EDGE1_OFFSET), load_vector(table, row + EDGE2_OFFSET)
        for point in range(_AXIS_POINT_COUNT):
            v = minus(_get_axis_point(middle, heading, shape.axis_half_length, point), corner)
            if abs(dot(v, normal)) < radius and find_nearest_weights(edge1, edge2, v)[2] < radius:
                return True
        if at_one * at_two < 0:
            for end in range(2):
                step = tip if end == 0 else times(tip, -1.0)
                if find_first_face_hit(table, box_tree, faces, count, middle, step, 0.0).face >= 0:
                    return True
    return False


@kernel_helper
def shift_body_outside_faces(
    table: Array1[F64],
    pieces: Array1[I32],
    box_tree: FaceBoxTree,
    faces: FaceList,
    shape: BodyShape,
    stance: BodyStance,
    shift: Vec3,
    max_shift: F64,
    max_rounds: I64,
) -> BodyShift:
    """Return the shift that moves a capsule out of all faces around it, and its remaining depth. The search starts from
    `shift`. `max_rounds`: the number of iterations. Each iteration first moves the body off the faces that its axis crosses,
    then off faces nearer than its radius. With 0 iterations, only the depth is measured. The shift is at most `max_shift` mm."""
    place, normal, up, heading, size = stance
    rest = plus(place, plus(times(up, shape.middle_height), times(heading, shape.middle_forward_offset)))
    tip = times(heading, shape.axis_half_length + shape.radius)
    anchor = plus(place, times(normal, _ANCHOR_HEIGHT_BODY_LENGTHS * size))
    middle = plus(rest, shift)
    away = minus(anchor, middle)
    near = max(shape.radius, np.sqrt(dot(away, away)))
    n = list_faces_near_segment(pieces, box_tree, minus(middle, tip), plus(middle, tip), near, -1, -1, faces)
    if not _is_body_touching_face(table, box_tree, faces, n, shape, anchor, middle, heading):
        return BodyShift(shift, 0.0, (0.0, 0.0, 0.0))
    wide = max(shape.radius + _MARGIN_BODY_LENGTHS * size, near)
    n = list_faces_near_segment(pieces, box_tree, minus(middle, tip), plus(middle, tip), wide, -1, -1, faces)
    depth, out = 0.0, (0.0, 0.0, 0.0)
    for turn in range(max_rounds + 1):
        depth = 0.0
        for part in range(3):
            middle = plus(rest, shift)
            start, step, extra = middle, tip, 0.0
            if part == 0:
                start, step, extra = anchor, minus(middle, anchor), shape.radius
            if part == 2:
                step = times(tip, -1.0)
            hit = find_first_face_hit(table, box_tree, faces, n, start, step, 0.0)
            if hit.face >= 0:
                m = load_vector(table, FLOATS_PER_FACE_ROW * hit.face + NORMAL_OFFSET)
                along = dot(m, step)
                if along > 0:
                    m, along = times(m, -1.0), -along
                over = (1.0 - min(hit.path_fraction, 1.0)) * -along + extra
                if over > depth:
                    depth, out = over, m
                if turn < max_rounds:
                    shift = plus(shift, times(m, over))
        for point in range(_AXIS_POINT_COUNT):
            center = _get_axis_point(plus(rest, shift), heading, shape.axis_half_length, point)
            best, away = shape.radius, (0.0, 0.0, 0.0)
            for k in range(n):
                row = FLOATS_PER_FACE_ROW * box_tree.triangle_order[faces.face_numbers[faces.first_index + k]]
                v = minus(center, load_vector(table, row + CORNER_OFFSET))
                # All points of a face are at least as far away as its plane.
                if abs(dot(v, load_vector(table, row + NORMAL_OFFSET))) >= best:
                    continue
                edge1, edge2 = load_vector(table, row + EDGE1_OFFSET), load_vector(table, row + EDGE2_OFFSET)
                b1, b2, distance = find_nearest_weights(edge1, edge2, v)
                if distance < best:
                    best, away = distance, minus(minus(v, times(edge1, b1)), times(edge2, b2))
            if best < shape.radius:
                over = shape.radius - best
                if over > depth and best > 1e-9:
                    depth, out = over, times(away, 1.0 / best)
                if turn < max_rounds and best > 1e-9:
                    shift = plus(shift, times(away, over / best))
        if depth <= _SLACK_BODY_LENGTHS * size:
            break
        long = np.sqrt(dot(shift, shift))
        if long > max_shift:
            shift = times(shift, max_shift / long)
    return BodyShift(shift, depth, out)
