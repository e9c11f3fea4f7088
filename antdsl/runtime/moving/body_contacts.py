"""Contacts of bodies with the triangles around them: the shift that moves a body outside, and the depth that remains."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.ground.mesh.boxes import BoxTree, FaceList, find_first_hit, gather_faces
from antdsl.ground.mesh.face_table import CORNER_OFFSET, EDGE1_OFFSET, EDGE2_OFFSET, NORMAL_OFFSET, ROW_FLOATS
from antdsl.machine_code.kernels import F64, I32, I64, Array1, kernel_helper
from antdsl.numerics.kernel_vectors import Vec3, dot, load_vector, minus, nearest_weights, plus, times
from antdsl.runtime.moving.body_paths import BodyShape

SHIFT_TURNS = 4  # shifts of a body out of its contacts before the depth is measured
_ANCHOR_HEIGHT_PER_BODY = 0.02  # body lengths above the feet; the middle must be visible from this point
_AXIS_POINTS = 9  # points on the axis of a capsule from which the nearest face is searched
_SLACK_PER_BODY = 0.004  # body lengths; a shallower overlap needs no shift
_MARGIN_PER_BODY = 0.3  # body lengths around a body within which faces are searched


class BodyStance(NamedTuple):
    """A body of `size` mm that stands at `place` on ground with a `normal`."""

    place: Vec3
    normal: Vec3
    up: Vec3
    heading: Vec3
    size: F64


class BodyShift(NamedTuple):
    """The shift of a body from its stance (mm), its remaining depth inside a surface (mm), and the direction out."""

    shift: Vec3
    depth: F64
    out: Vec3


@kernel_helper
def shift_outside(
    table: Array1[F64],
    pieces: Array1[I32],
    boxes: BoxTree,
    faces: FaceList,
    shape: BodyShape,
    stance: BodyStance,
    shift: Vec3,
    most: F64,
    turns: I64,
) -> BodyShift:
    """Return the shift that brings a capsule outside all faces around it, starting from `shift`, and its remaining depth.

    Each of `turns` first moves the body off the faces that its axis crosses, then off the faces nearer than its radius. With 0
    turns, only the depth is measured. The shift is at most `most` mm."""
    place, normal, up, heading, size = stance
    rest = plus(place, plus(times(up, shape.height), times(heading, shape.ahead)))
    tip = times(heading, shape.half + shape.radius)
    anchor = plus(place, times(normal, _ANCHOR_HEIGHT_PER_BODY * size))
    middle = plus(rest, shift)
    away = minus(anchor, middle)
    wide = max(shape.radius + _MARGIN_PER_BODY * size, np.sqrt(dot(away, away)))
    n = gather_faces(pieces, boxes, minus(middle, tip), plus(middle, tip), wide, -1, -1, faces)
    depth, out = 0.0, (0.0, 0.0, 0.0)
    for turn in range(turns + 1):
        depth = 0.0
        for part in range(3):
            middle = plus(rest, shift)
            start, step, extra = middle, tip, 0.0
            if part == 0:
                start, step, extra = anchor, minus(middle, anchor), shape.radius
            if part == 2:
                step = times(tip, -1.0)
            hit = find_first_hit(table, boxes, faces, n, start, step, 0.0)
            if hit.face >= 0:
                m = load_vector(table, ROW_FLOATS * hit.face + NORMAL_OFFSET)
                along = dot(m, step)
                if along > 0:
                    m, along = times(m, -1.0), -along
                over = (1.0 - min(hit.path_fraction, 1.0)) * -along + extra
                if over > depth:
                    depth, out = over, m
                if turn < turns:
                    shift = plus(shift, times(m, over))
        for point in range(_AXIS_POINTS):
            center = plus(plus(rest, shift), times(heading, shape.half * (2.0 * np.float64(point) / (_AXIS_POINTS - 1) - 1.0)))
            best, away = shape.radius, (0.0, 0.0, 0.0)
            for k in range(n):
                row = ROW_FLOATS * boxes.triangle_order[faces.numbers[faces.begin + k]]
                v = minus(center, load_vector(table, row + CORNER_OFFSET))
                # All points of a face are at least as far away as its plane.
                if abs(dot(v, load_vector(table, row + NORMAL_OFFSET))) >= best:
                    continue
                edge1, edge2 = load_vector(table, row + EDGE1_OFFSET), load_vector(table, row + EDGE2_OFFSET)
                b1, b2, distance = nearest_weights(edge1, edge2, v)
                if distance < best:
                    best, away = distance, minus(minus(v, times(edge1, b1)), times(edge2, b2))
            if best < shape.radius:
                over = shape.radius - best
                if over > depth and best > 1e-9:
                    depth, out = over, times(away, 1.0 / best)
                if turn < turns and best > 1e-9:
                    shift = plus(shift, times(away, over / best))
        if depth <= _SLACK_PER_BODY * size:
            break
        long = np.sqrt(dot(shift, shift))
        if long > most:
            shift = times(shift, most / long)
    return BodyShift(shift, depth, out)
