"""Kernels that keep bodies outside their ground. They shorten steps, turn bodies over the path below them, and shift bodies.

A body follows the mean turn of the ground along its path (`body_paths`), no faster than it can turn. Its angle to the ground's
normal is limited. So an agent waits before an edge until its body can stand beyond the edge."""

from __future__ import annotations

import numpy as np

from antdsl.ground.mesh.boxes import FaceBoxTree, FaceList, list_faces_near_segment
from antdsl.ground.mesh.face_table import AXIS1_OFFSET, AXIS2_OFFSET, FLOATS_PER_FACE_ROW, NORMAL_OFFSET  # fmt: skip
from antdsl.ground.mesh.stretches import get_face_part_clearance, project_to_face
from antdsl.ground.mesh.surroundings import compute_position_on_face
from antdsl.ground.mesh.walkers import FaceWalker, FootingArrays, SurfaceTables
from antdsl.machine_code.kernels import allocate_scratch, inlined, kernel, kernel_helper
from antdsl.machine_code.kernels.types import F32, F64, I64, Array1, Array2
from antdsl.numerics.elementary_loops import atan2, compute_cos_and_sin
from antdsl.numerics.kernel_vectors import (
    TriangleWeights,
    Vec3,
    VectorColumns,
    cross,
    dot,
    get_row64,
    load_vector,
    minus,
    normalise_vector,
    plus,
    rotate_about_axis,
    times,
)  # fmt: skip
from antdsl.numerics.parallel import compute_buffer_index
from antdsl.runtime.moving.body_records import (
    MAX_LIFT_BODY_LENGTHS,
    SHARP_BEND_LEVEL,
    BodyLimits,
    BodyPoses,
    BodyRegisters,
    BodyRows,
    BodyStances,
    ContactFaces,
    FaceBuffers,
    FaceSearch,
    compute_body_shape,
)
from antdsl.runtime.moving.clearance.body_paths import (
    DISTANCE_OFFSET_IN_POINT,
    FLOATS_PER_PATH,
    FLOATS_PER_PATH_POINT,
    NORMAL_OFFSET_IN_POINT,
    RISE_OFFSET_IN_POINT,
    BodyShape,
    FacesNearby,
    compute_lift_over_profile,
    measure_ground_bend,
)
from antdsl.runtime.moving.contacts.body_contacts import BodyShift, BodyStance, shift_body_outside_faces
from antdsl.runtime.moving.postures import (
    compute_perpendicular_direction,
    find_rotation_axis,
    read_vector,
    tilt_body_towards,
    turn_heading,
    turn_heading_towards,
)

_F = np.float32
PATH_LENGTH_BODY_LENGTHS = 1.0  # body lengths; length of the path ahead of the feet, and of the path behind them
_PROBE_HEIGHT_BODY_LENGTHS = 0.03  # body lengths above the ground at which a path meets other pieces
_MAX_LEAN = 1.0  # radians between body and the ground below the feet (57 degrees)
_LEAN_RADIANS_PER_BODY_LENGTH = 0.65  # radians that the limit grows per body length of distance
_MIN_WAIT_LAG, _MAX_WAIT_LAG = 0.087, 0.35  # radians; from the first lag on feet slow down, at the second they stop
_SHARP_EDGE_SLACK = 0.05  # radians beyond half the turn of a sharp edge, by which a body is off the ground beyond after a step
_LEAN_SLACK = 0.03  # radians by which a body may lean less than it should when its feet step over an edge
_MIN_VELOCITY_SHARE = 0.3  # share of the velocity that an agent retains while it waits for its body
_MAX_STRIDE = 1.2  # of the longest step; feet and shift together move a body no farther
_RETREAT_SIDE_SHARE = 0.3  # least share of a retreat that leads to the side of the heading
_RETREAT_SHARE = 0.2  # share of the step by which an agent retreats from a surface that its body touched
_EDGE_GAP_BODY_LENGTHS = 0.002  # body lengths between an edge and waiting feet
_EDGE_REACH_BODY_LENGTHS = 0.05  # body lengths; feet this near to an edge stand at the edge
_VALLEY_GAP_BODY_LENGTHS = 0.01  # body lengths; the same for a valley that is too narrow for the body


@inlined
def _get_face_list(buffers: FaceBuffers, box_tree: FaceBoxTree, begin: I64) -> I64:
    """Return the index in `buffers` at which the face list of a chunk starts. `begin`: the first row of the chunk."""
    return compute_buffer_index(begin, buffers.rows_per_chunk, buffers.buffer_count) * box_tree.triangle_order.size


@kernel_helper
def _list_crossing_faces(
    search: FaceSearch, face: I64, weights: TriangleWeights, position: Vec3, reach: F64, faces: FaceList
) -> I64:
    """Write the faces that a path may meet to `faces`, and return their number. The path starts at `position` on `face` and
    has the length `reach` (mm). Faces of the agent's own mesh piece are included only if the piece cuts itself."""
    if not search.has_several_pieces or get_face_part_clearance(search.clearances, face, weights) > reach * (
        1 + _PROBE_HEIGHT_BODY_LENGTHS
    ):
        return 0
    piece = -1 if search.cut_starts[search.cut_starts.size - 1] > 0 else np.int64(search.piece_numbers[face])
    return list_faces_near_segment(search.piece_numbers, search.box_tree, position, position, reach, -1, piece, faces)


@inlined
def _compute_angle(a: Vec3, b: Vec3) -> F64:
    """Return the angle (radians) between two vectors."""
    side = cross(a, b)
    return np.float64(atan2(_F(np.sqrt(dot(side, side))), _F(dot(a, b))))


@kernel_helper
def _rotate_towards_normal(up: Vec3, normal: Vec3, max_angle: F64, ahead: Vec3) -> Vec3:
    """Return `up`, rotated towards `normal` as far as necessary for an angle of at most `max_angle` (radians) between them."""
    angle, result = _compute_angle(up, normal), up
    if angle > max_angle:
        axis, _, _ = find_rotation_axis(up, normal, ahead)
        c, s = compute_cos_and_sin(_F(angle - max_angle))
        result = normalise_vector(rotate_about_axis(up, axis, np.float64(c), np.float64(s)))
    return result


@inlined
def _find_largest_lean(ground_turn: F64, max_angle: F64) -> F64:
    """Return how far (radians) a body should lean when it approaches an edge.

    `ground_turn`: the turn of the ground at the edge. `max_angle`: how far the body can tilt in a step. It leans only as far as
    necessary, so that it stays close to the ground on both sides."""
    return max(_MAX_LEAN, 0.5 * ground_turn - max_angle - _SHARP_EDGE_SLACK)


@kernel
def limit_steps(
    surface: SurfaceTables, search: FaceSearch, feet: FootingArrays, body_rows: BodyRows, poses: BodyPoses,
    normals: Array2[F32], step: VectorColumns, velocity: VectorColumns, limits: BodyLimits, registers: BodyRegisters,
    begin: I64, end: I64
) -> None:  # fmt: skip
    """Shorten the steps (mm) of agents so that their bodies can follow. Entries `begin` to before `end` of `body_rows` are
    processed. A step may only lead away from a surface that the body touched in the last step. It ends before an edge if the
    body cannot stand beyond it. It also ends before a valley that is too narrow for the body."""
    table, first, rows, levels = surface.face_table, surface.first_faces, body_rows.rows, body_rows.bend_levels
    points, faces = (
        allocate_scratch(FLOATS_PER_PATH, F64),
        FaceList(search.buffers.face_numbers, _get_face_list(search.buffers, search.box_tree, begin)),
    )
    for j in range(begin, end):
        i = rows[j]
        displacement = read_vector(step, i)
        length = np.sqrt(dot(displacement, displacement))
        if feet.mesh[i] < 0 or feet.face[i] < 0 or feet.over[i] != 0 or not (length > 0 and length < np.inf):
            continue
        wall, ground, size = read_vector(registers.outward_direction, i), get_row64(normals, i), np.float64(limits.size[i])
        if dot(wall, wall) > 0:
            wall = minus(wall, times(ground, dot(wall, ground)))
            retreat = _retreat_from_wall(displacement, length, wall, _RETREAT_SHARE * (length + limits.voluntary_shift * size))
            displacement = _limit_retreat_to_same_side(displacement, retreat, wall, cross(ground, read_vector(poses.heading, i)))
            for k in range(3):
                step[k][i] = _F(displacement[k])
                velocity[k][i], registers.outward_direction[k][i] = step[k][i] / limits.dt, _F(0)
        part = _F(1) - registers.wait_share[i]
        if dot(wall, wall) > 0 and registers.idle_time[i] <= limits.dt:
            registers.wait_share[i] = _F(-1)
        if levels[j] == SHARP_BEND_LEVEL:
            f = first[feet.mesh[i]] + feet.face[i]
            row = FLOATS_PER_FACE_ROW * f
            own = load_vector(table, row + NORMAL_OFFSET)
            side = -1.0 if dot(own, ground) < 0 else 1.0
            own, weights = times(own, side), (feet.b1[i], feet.b2[i])
            axis1, axis2 = load_vector(table, row + AXIS1_OFFSET), load_vector(table, row + AXIS2_OFFSET)
            c, s, left = project_to_face(axis1, axis2, displacement[0], displacement[1], displacement[2], 1.0, 0.0)
            if left > 0:
                place = compute_position_on_face(table, row, weights, side)
                count = _list_crossing_faces(search, f, weights, place, left + _PROBE_HEIGHT_BODY_LENGTHS * size, faces)
                nearby = FacesNearby(search.box_tree, faces, count, search.piece_numbers, search.cut_starts)
                start = FaceWalker(f, weights, side, (c, s), (c, s))
                bend = measure_ground_bend(surface, nearby, start, left, _PROBE_HEIGHT_BODY_LENGTHS * size, points)
                free, up = left, read_vector(poses.up, i)
                for k in range(1, bend.point_count - 1):
                    n = load_vector(points, FLOATS_PER_PATH_POINT * k + NORMAL_OFFSET_IN_POINT)
                    turn, most = _compute_angle(own, n), np.float64(limits.max_tilts[i])
                    if _compute_angle(up, n) > max(_MAX_LEAN + most, turn - _find_largest_lean(turn, most)) + _LEAN_SLACK:
                        free = min(
                            free,
                            max(
                                points[FLOATS_PER_PATH_POINT * k + DISTANCE_OFFSET_IN_POINT] - _EDGE_GAP_BODY_LENGTHS * size, 0.0
                            ),
                        )
                # A body at its nearest possible distance from the surface beyond an edge cannot cross that edge.
                turns_away = free < _EDGE_REACH_BODY_LENGTHS * size and free < left and part == _F(1)
                last = FLOATS_PER_PATH_POINT * (bend.point_count - 1)
                if points[last + RISE_OFFSET_IN_POINT] < 0:
                    free = min(free, max(points[last + DISTANCE_OFFSET_IN_POINT] - _VALLEY_GAP_BODY_LENGTHS * size, 0.0))
                    turns_away = True
                if turns_away:
                    for k in range(3):
                        registers.outward_direction[k][i] = _F(-displacement[k] / length)
                part = _F(min(free / left, 1.0)) * part
        for k in range(3):
            step[k][i] = step[k][i] * part
            velocity[k][i] = velocity[k][i] * max(part, _F(_MIN_VELOCITY_SHARE))


@inlined
def _retreat_from_wall(step: Vec3, length: F64, wall: Vec3, distance: F64) -> Vec3:
    """Return a step with its component into a wall replaced by a component of length `distance` away from the wall. A step that
    does not lead into the wall is reversed instead. `length`: the length of `step`. `wall`: the direction away from the wall,
    along the ground."""
    size = np.sqrt(dot(wall, wall))
    into = dot(step, wall)
    out, inside = times(step, -1 / length), -length
    if size > 0.1 and into < -0.1 * size * length:
        out, inside = times(wall, 1 / size), into / size
    changed = plus(step, times(out, distance - inside))
    return times(changed, min(max(length, distance) / max(np.sqrt(dot(changed, changed)), 1e-300), 1.0))


@inlined
def _limit_retreat_to_same_side(step: Vec3, retreat: Vec3, wall: Vec3, left: Vec3) -> Vec3:
    """Return a retreat on the same side of the heading as the step, and slightly sideways. Return `retreat` if that direction
    would lead into the wall.

    Without the change, a body that turns towards its step could turn the wrong way, or from side to side. `left`: the direction
    to the left of the heading."""
    size, aside = np.sqrt(dot(retreat, retreat)), dot(retreat, left)
    side = max(abs(aside), _RETREAT_SIDE_SHARE * size) * (1.0 if dot(step, left) >= 0 else -1.0)
    turned = plus(retreat, times(left, side - aside))
    turned = times(turned, size / max(np.sqrt(dot(turned, turned)), 1e-300))
    return turned if dot(turned, wall) >= 0 else retreat


@kernel
def aim_bodies(
    surface: SurfaceTables,
    search: FaceSearch,
    feet: FootingArrays,
    body_rows: BodyRows,
    previous_poses: BodyPoses,
    current_poses: BodyPoses,
    limits: BodyLimits,
    registers: BodyRegisters,
    begin: I64,
    end: I64,
) -> None:
    """Turn bodies towards the poses of their feet, and lift the bodies off the path below. Entries `begin` to before `end` of
    `body_rows` are processed. `previous_poses`: poses before the step. `current_poses`: poses of the feet; they are replaced by
    the poses of the bodies."""
    table, first, rows, levels = surface.face_table, surface.first_faces, body_rows.rows, body_rows.bend_levels
    faces = FaceList(search.buffers.face_numbers, _get_face_list(search.buffers, search.box_tree, begin))
    ahead_points, behind_points = allocate_scratch(FLOATS_PER_PATH, F64), allocate_scratch(FLOATS_PER_PATH, F64)
    for j in range(begin, end):
        i = rows[j]
        stands = read_vector(previous_poses.up, i)
        look = compute_perpendicular_direction(read_vector(previous_poses.heading, i), stands)
        normal, heading = read_vector(current_poses.up, i), read_vector(current_poses.heading, i)
        if registers.wait_share[i] < 0:
            heading = turn_heading(look, stands, normal)  # it turns once it has retreated
        long = limits.size[i]
        size = np.float64(long if long > 0 and np.isfinite(long) else _F(0))
        limited = np.isfinite(limits.max_turn[i])
        turn = np.float64(min(max(limits.max_turn[i], _F(0)) * limits.dt, _F(4))) if limited else np.float64(4)
        target_up, target_heading, place, ahead_count, behind_count = normal, heading, (0.0, 0.0, 0.0), 0, 0
        if feet.mesh[i] >= 0 and feet.face[i] >= 0 and feet.over[i] == 0 and size > 0 and levels[j] > 0:
            f = first[feet.mesh[i]] + feet.face[i]
            row = FLOATS_PER_FACE_ROW * f
            own = load_vector(table, row + NORMAL_OFFSET)
            side = -1.0 if dot(own, normal) < 0 else 1.0
            own, weights, window = times(own, side), (feet.b1[i], feet.b2[i]), PATH_LENGTH_BODY_LENGTHS * size
            travel = turn_heading_towards(
                turn_heading(look, stands, own), compute_perpendicular_direction(heading, own), own, turn
            )
            c, s = dot(load_vector(table, row + AXIS1_OFFSET), travel), dot(load_vector(table, row + AXIS2_OFFSET), travel)
            place = compute_position_on_face(table, row, weights, side)
            count = 0
            if levels[j] == SHARP_BEND_LEVEL:
                count = _list_crossing_faces(search, f, weights, place, window, faces)
            nearby = FacesNearby(search.box_tree, faces, count, search.piece_numbers, search.cut_starts)
            start, back = FaceWalker(f, weights, side, (c, s), (c, s)), FaceWalker(f, weights, side, (-c, -s), (c, s))
            roll, pitch, ahead_count = measure_ground_bend(
                surface, nearby, start, window, _PROBE_HEIGHT_BODY_LENGTHS * size, ahead_points
            )
            roll2, pitch2, behind_count = measure_ground_bend(
                surface, nearby, back, window, _PROBE_HEIGHT_BODY_LENGTHS * size, behind_points
            )
            bend = plus(times(travel, roll - roll2), times(cross(own, travel), pitch - pitch2))
            angle = np.sqrt(dot(bend, bend))
            axis, (c32, s32) = times(bend, 1 / max(angle, 1e-300)), compute_cos_and_sin(_F(angle))
            mean = normalise_vector(rotate_about_axis(own, axis, np.float64(c32), np.float64(s32)))
            target_heading = compute_perpendicular_direction(
                rotate_about_axis(travel, axis, np.float64(c32), np.float64(s32)), mean
            )
            target_up, lean = mean, _MAX_LEAN
            for back_k in range(ahead_count - 1):
                k = ahead_count - 2 - back_k
                n = load_vector(ahead_points, FLOATS_PER_PATH_POINT * k + NORMAL_OFFSET_IN_POINT)
                extra, beyond = (
                    _LEAN_RADIANS_PER_BODY_LENGTH * ahead_points[FLOATS_PER_PATH_POINT * k + DISTANCE_OFFSET_IN_POINT] / size,
                    _compute_angle(own, n),
                )
                lean = max(lean, _find_largest_lean(beyond, np.float64(limits.max_tilts[i])) - 4.0 * extra)
                target_up = _rotate_towards_normal(target_up, n, max(_MAX_LEAN + extra, 0.5 * beyond), travel)
            target_up = _rotate_towards_normal(target_up, normal, lean, travel)
            target_heading = turn_heading(target_heading, mean, target_up)
        up, turned, (tilt, full_tilt) = tilt_body_towards(stands, look, target_up, limits.max_tilts[i])
        yaw = np.sqrt(max(turn * turn - np.float64(tilt) * np.float64(tilt), 0.0)) if limited else 4.0
        facing = turn_heading_towards(turned, turn_heading(target_heading, target_up, up), up, yaw)
        rise = 0.0
        if ahead_count > 0:
            shape = compute_body_shape(limits, i, size)
            rise = compute_lift_over_profile(ahead_points, ahead_count, shape, place, up, facing, MAX_LIFT_BODY_LENGTHS * size)
            rise = max(
                rise,
                compute_lift_over_profile(behind_points, behind_count, shape, place, up, facing, MAX_LIFT_BODY_LENGTHS * size),
            )
        lag = (np.float64(full_tilt) - np.float64(tilt) - _MIN_WAIT_LAG) / (_MAX_WAIT_LAG - _MIN_WAIT_LAG)
        registers.wait_share[i] = _F(min(max(lag, 0.0), 1.0))
        registers.penetration_depth[i] = _F(0)
        lift = read_vector(registers.lift, i)
        change = minus(times(up, rise), lift)
        distance = np.sqrt(dot(change, change))
        lift = plus(lift, times(change, min(limits.voluntary_shift * size / max(distance, 1e-300), 1.0)))
        for k in range(3):
            current_poses.up[k][i], current_poses.heading[k][i] = _F(up[k]), _F(facing[k])
            registers.lift[k][i] = _F(lift[k])


@kernel_helper
def _shift_outside_all(
    ground: ContactFaces,
    obstacles: ContactFaces,
    begin: I64,
    shape: BodyShape,
    stance: BodyStance,
    shift: Vec3,
    max_angle: F64,
    max_rounds: I64,
) -> BodyShift:
    """Return the shift that moves a body out of the ground and of obstacles, and the greatest remaining depth.

    After a shift out of an obstacle, the body is moved out of the ground again."""
    table, pieces, boxes, buffers = ground
    faces = FaceList(buffers.face_numbers, _get_face_list(buffers, boxes, begin))
    result = shift_body_outside_faces(table, pieces, boxes, faces, shape, stance, shift, max_angle, max_rounds)
    if obstacles.box_tree.triangle_order.size == 0:
        return result
    others = FaceList(obstacles.buffers.face_numbers, _get_face_list(obstacles.buffers, obstacles.box_tree, begin))
    for turn in range(2):
        other = shift_body_outside_faces(
            obstacles.face_table,
            obstacles.piece_numbers,
            obstacles.box_tree,
            others,
            shape,
            stance,
            result.shift,
            max_angle,
            max_rounds if turn == 0 else 0,
        )
        change = minus(other.shift, result.shift)
        if turn == 0 and dot(change, change) > 0:
            result = shift_body_outside_faces(table, pieces, boxes, faces, shape, stance, other.shift, max_angle, max_rounds)
        elif other.remaining_depth > result.remaining_depth:
            result = BodyShift(result.shift, other.remaining_depth, other.outward_direction)
    return result


@kernel
def shift_bodies(
    ground: ContactFaces, obstacles: ContactFaces, rows: Array1[I64], stances: BodyStances, limits: BodyLimits,
    lift: VectorColumns, previous_lift: VectorColumns, depths: Array1[F32], outward_directions: Array2[F32], max_rounds: I64,
    begin: I64, end: I64
) -> None:  # fmt: skip
    """Shift the bodies at `rows` out of the faces around them, starting from their `lift` (mm).

    Entries `begin` to before `end` are processed. `ground`, `obstacles`: the faces of the ground and of obstacles.
    `previous_lift`: for each of `rows`, the shift before the step minus the step of the feet. A body that would have to move
    too far is treated as deep inside. `max_rounds`: as in `shift_body_outside_faces`. `depths`, `outward_directions` (3, k):
    receive the remaining depth of each of `rows` (body lengths), and the direction out."""
    place, normals, pose = stances
    for j in range(begin, end):
        i = rows[j]
        size = np.float64(limits.size[i])
        position = (place[i, 0], place[i, 1], place[i, 2])
        stance = BodyStance(position, get_row64(normals, i), read_vector(pose.up, i), read_vector(pose.heading, i), size)
        shape, most = compute_body_shape(limits, i, size), MAX_LIFT_BODY_LENGTHS * size
        result = _shift_outside_all(ground, obstacles, begin, shape, stance, read_vector(lift, i), most, max_rounds)
        change = minus(result.shift, read_vector(previous_lift, j))
        depths[j] = _F(result.remaining_depth / size) if size > 0 else _F(0)
        reach = max(limits.max_shift * size, _MAX_STRIDE * np.float64(limits.max_speed[i]) * np.float64(limits.dt))
        out = result.outward_direction
        if dot(change, change) > reach * reach:
            depths[j], out = _F(1), times(change, -1.0)
        for k in range(3):
            outward_directions[k, j] = _F(out[k])
            lift[k][i] = _F(result.shift[k])
