"""Measures the path of a body over the triangles below it: how the ground turns along the path, and its height profile. A path
is a straight line over the triangles, ahead of the feet and behind them. At each edge that the line crosses, the ground turns;
the turn is given by a rotation vector along the edge. The mean of these rotations over the path orients the body. So a body
begins to turn one path length before an edge. It is half turned on the edge, and completes the turn at the same distance
beyond."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.ground.mesh.boxes import FaceBoxTree, FaceList, find_first_face_hit
from antdsl.ground.mesh.face_table import (
    AXIS1_OFFSET,
    AXIS2_OFFSET,
    EDGES_OFFSET,
    FLOATS_PER_FACE_ROW,
    NORMAL_OFFSET,
    RATE1_OFFSET,
)
from antdsl.ground.mesh.stretches import cross_edge
from antdsl.ground.mesh.surroundings import compute_position_on_face, project_directions_to_face
from antdsl.ground.mesh.walkers import FaceWalker, SurfaceTables
from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, inlined, kernel_helper, load_consecutive, round_to_int
from antdsl.numerics.elementary_loops import atan2
from antdsl.numerics.kernel_vectors import Vec3, clamp_weights, cross, dot, load_vector, minus, plus, times

_F = np.float32
MAX_VALLEY_TURN = 2.0  # radians; a valley with a larger turn is a wall
MAX_PATH_EDGES = 16  # maximum number of edges that a path crosses on each side of the feet
FLOATS_PER_PATH_POINT = (
    8  # floats of a path point: position, normal of the face that begins there, distance, whether that face rises
)
NORMAL_OFFSET_IN_POINT, DISTANCE_OFFSET_IN_POINT, RISE_OFFSET_IN_POINT = 3, 6, 7
FLOATS_PER_PATH = FLOATS_PER_PATH_POINT * (MAX_PATH_EDGES + 2)  # points of one side: the feet, the edges, and the end


class GroundBend(NamedTuple):
    """The mean rotation of the ground's normal along a path, and the size of the path's height profile.

    `roll`, `pitch`: the components of the rotation vector (radians) along the path and to the left of it. `point_count`: the
    number of points of the profile."""

    roll: F64
    pitch: F64
    point_count: I64


class BodyShape(NamedTuple):
    """The capsule of a trunk: half the length of its axis, its radius, and the position of its middle, in mm.

    `middle_height`, `middle_forward_offset`: how far the middle is above the feet, and how far ahead of them."""

    axis_half_length: F64
    radius: F64
    middle_height: F64
    middle_forward_offset: F64


@inlined
def write_path_point(points: Array1[F64], index: I64, position: Vec3, normal: Vec3, distance: F64, rise: F64) -> None:
    """Write point `index` of a path to `points`: its position, its normal, its distance along the path, and its height `rise`."""
    row = FLOATS_PER_PATH_POINT * index
    points[row], points[row + 1], points[row + 2] = position
    points[row + 3], points[row + 4], points[row + 5] = normal
    points[row + 6], points[row + 7] = distance, rise


class FacesNearby(NamedTuple):
    """The faces near a body, which are the first `face_count` entries of `faces`. The other fields are as in `FaceSearch`."""

    box_tree: FaceBoxTree
    faces: FaceList
    face_count: I64
    piece_numbers: Array1[I32]
    cut_starts: Array1[I64]


@inlined
def may_faces_cross(nearby_faces: FacesNearby, face: I64, other_face: I64) -> BOOL:
    """Return whether `other_face` may cross `face`. It may if the faces belong to different pieces of the ground, or if both are
    cut by other faces of their piece."""
    pieces, cuts = nearby_faces.piece_numbers, nearby_faces.cut_starts
    return pieces[face] != pieces[other_face] or (
        cuts[face + 1] > cuts[face] and cuts[other_face + 1] > cuts[other_face] and face != other_face
    )


@kernel_helper
def measure_ground_bend(
    surface: SurfaceTables, nearby_faces: FacesNearby, start: FaceWalker, path_length: F64, probe_height: F64, points: Array1[F64]
) -> GroundBend:
    """Walk a path of length `path_length` (mm), and return how the ground turns along it. The result is the mean over the path
    ahead and the path behind.

    If a face of `nearby_faces` crosses the path at the height `probe_height` (mm), the path continues on that face. `points`:
    receives the height profile, with points at the feet, at each edge and at the end of the path."""
    table, link, forked, _ = surface
    walker, left, roll, pitch, count, climb, walks = start, path_length, 0.0, 0.0, 0, 0.0, True
    normal = times(load_vector(table, FLOATS_PER_FACE_ROW * start.face + NORMAL_OFFSET), start.side)
    while walks:
        f, (b1, b2), side, (c, s), heading = walker
        row = FLOATS_PER_FACE_ROW * f
        place = compute_position_on_face(table, row, (b1, b2), side)
        write_path_point(points, count, place, normal, path_length - left, climb)
        count += 1
        _, along, slant, shear = load_consecutive(table, row + RATE1_OFFSET - 1, 4)
        rate1, rate2 = c * along - s * shear, s * slant
        rate0 = -(rate1 + rate2)
        until, edge = np.inf, 0
        if rate0 < 0:
            until = max(1.0 - b1 - b2, 0.0) / -rate0
        if rate1 < 0 and max(b1, 0.0) / -rate1 < until:
            until, edge = max(b1, 0.0) / -rate1, 1
        if rate2 < 0 and max(b2, 0.0) / -rate2 < until:
            until, edge = max(b2, 0.0) / -rate2, 2
        length = min(until, left)
        cosine, sine, linked, _ = load_consecutive(table, row + EDGES_OFFSET + 4 * edge, 4)
        beyond = link[1, 3 * f + edge] if forked and side < 0 else round_to_int(linked)
        walks = until < left and beyond >= 0 and count <= MAX_PATH_EDGES
        other, turn, ahead, aside = normal, 0.0, 0.0, 0.0
        axis1, axis2 = load_vector(table, row + AXIS1_OFFSET), load_vector(table, row + AXIS2_OFFSET)
        travel = plus(times(axis1, c), times(axis2, s))
        meets = False
        if nearby_faces.face_count > 0 and count <= MAX_PATH_EDGES:
            hit = find_first_face_hit(
                table,
                nearby_faces.box_tree,
                nearby_faces.faces,
                nearby_faces.face_count,
                plus(place, times(normal, probe_height)),
                times(travel, length),
                0.0,
            )
            if hit.face >= 0 and may_faces_cross(nearby_faces, f, hit.face):
                meets, walks = True, True
                length = hit.path_fraction * length
                other = load_vector(table, FLOATS_PER_FACE_ROW * hit.face + NORMAL_OFFSET)
                other_side = -1.0 if dot(other, travel) > 0 else 1.0
                other = times(other, other_side)
                hinge = cross(normal, other)
                sine = np.sqrt(dot(hinge, hinge))
                turn = np.float64(atan2(_F(sine), _F(dot(normal, other))))
                hinge = times(hinge, 1 / max(sine, 1e-12))
                ahead, aside = dot(hinge, travel), dot(hinge, cross(normal, travel))
                direction, facing = project_directions_to_face(table, walker, hit.face, other_side)
                walker = FaceWalker(hit.face, clamp_weights(hit.weights[0], hit.weights[1]), other_side, direction, facing)
        left -= length
        weights = clamp_weights(b1 + rate1 * length, b2 + rate2 * length)
        if walks and not meets:
            axis = plus(times(axis1, cosine), times(axis2, sine))
            ahead, aside = cosine * c + sine * s, (sine * c - cosine * s) * side
            walker = cross_edge(table, beyond, edge, (cosine, sine), weights, side, (c, s), heading)
            other = times(load_vector(table, FLOATS_PER_FACE_ROW * walker.face + NORMAL_OFFSET), walker.side)
            turn = np.float64(atan2(_F(dot(cross(normal, other), axis)), _F(dot(normal, other))))
        is_wall = walks and turn * aside < 0 and abs(turn) > MAX_VALLEY_TURN
        if is_wall or not walks:
            end = compute_position_on_face(table, row, weights, side)
            write_path_point(points, count, end, normal, path_length - max(left, 0.0), -1.0 if is_wall else 0.0)
            count += 1
            walks = False
        else:
            roll += turn * ahead * left
            pitch += turn * aside * left
            climb = max(-turn * aside, 0.0)
            normal = other
    share = 0.5 / path_length
    return GroundBend(roll * share, pitch * share, count)


@kernel_helper
def compute_lift_over_profile(
    points: Array1[F64], count: I64, shape: BodyShape, position: Vec3, up: Vec3, heading: Vec3, max_rise: F64
) -> F64:
    """Return how far (mm) a body at `position` must rise along its up direction to be above the height profile.

    The result is at most `max_rise`. The capsule must clear each point of the profile. Its ends must also clear the lines
    between the points."""
    lift = 0.0
    old_x, old_y = 0.0, 0.0
    for k in range(count):
        away = minus(load_vector(points, FLOATS_PER_PATH_POINT * k), position)
        x, y = dot(away, heading) - shape.middle_forward_offset, dot(away, up) - shape.middle_height
        off = max(abs(x) - shape.axis_half_length, 0.0)
        if off < shape.radius:
            lift = max(lift, y + np.sqrt(shape.radius * shape.radius - off * off))
        if k > 0:
            dx, dy = x - old_x, y - old_y
            size = np.sqrt(dx * dx + dy * dy)
            if size > 1e-9:
                dx, dy = dx / size, dy / size
                # The normal of the line on the body's side: profile points are ordered away from the feet.
                nx, ny = -dy, dx
                if ny < 0:
                    nx, ny = -nx, -ny
                for end in range(2):
                    center = shape.axis_half_length if end == 0 else -shape.axis_half_length
                    ex, ey = center - old_x, -old_y
                    if ny > 0.1:
                        rise = (shape.radius - (ex * nx + ey * ny)) / ny
                        foot = ex * dx + (ey + rise) * dy
                        if foot >= 0 and foot <= size:
                            lift = max(lift, rise)
        old_x, old_y = x, y
    return min(lift, max_rise)
