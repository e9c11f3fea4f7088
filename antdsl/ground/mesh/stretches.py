"""Moves agents by stretches, the parts of a path across one face each. A walk pauses where another surface may be in the path, or
beyond a border."""

from __future__ import annotations

import numpy as np

from antdsl.ground.mesh.face_table import (
    AXIS1_OFFSET,
    AXIS2_OFFSET,
    CORNER_OFFSET,
    EDGE1_OFFSET,
    EDGE2_OFFSET,
    EDGES_OFFSET,
    FLOATS_PER_FACE_ROW,
    NORMAL_OFFSET,
    RATE1_OFFSET,
    SMOOTH_NORMALS_OFFSET,
)
from antdsl.ground.mesh.topology import NO_LINKED_EDGE
from antdsl.ground.mesh.walkers import ClearanceTables, FaceDirection, FaceWalker, SurfaceTables, WalkProgress, WalkStopReason
from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, inlined, load_consecutive, prefetch, round_to_int
from antdsl.numerics.kernel_vectors import AgentPose, TriangleWeights, Vec3, clamp_weights, plus, times

MAX_EDGE_CROSSINGS = 400  # maximum number of edges crossed in one step; the agent then stops until the next step
_MIN_NORMAL_COSINE = 0.1  # cosine between face and smooth normal; below it, a direction is not lifted completely
CROSSINGS_BEFORE_NUDGE = 24  # crossings after which a walker is nudged, because it may circle a corner
CORNER_NUDGE_FRACTION = 1e-7  # share of a face by which it is moved
BORDER_INWARD_SHARE = 1e-6  # share of the direction that points inwards, so that rounding does not lead back to the border
MAX_SURFACE_HOPS = 6  # maximum number of changes of surface, or turns along a border, in one step
LOOK_AHEAD_EVENT, BORDER_EVENT, OVERHANG_EVENT = 1, 2, 3  # possible obstacle; border reached; agent above a border


@inlined
def load_face_frame(table: Array1[F64], row: I64) -> tuple[Vec3, Vec3, Vec3]:
    """Return the two axes of a face, and its normal."""
    ax, ay, az, bx, by, bz, nx, ny, nz, _, _, _ = load_consecutive(table, row + AXIS1_OFFSET, 12)
    return (ax, ay, az), (bx, by, bz), (nx, ny, nz)


@inlined
def project_to_face(axis1: Vec3, axis2: Vec3, x: F64, y: F64, z: F64, c0: F64, s0: F64) -> tuple[F64, F64, F64]:
    """Project a vector into the plane of a face. Return its unit direction (c, s) in the face's frame, and a length (mm).

    The length is that of the vector if its angle to the face is at most 60 degrees. At larger angles it decreases to 0. If the
    projection is zero or not finite, the direction is (c0, s0) and the length is 0."""
    c = axis1[0] * x + axis1[1] * y + axis1[2] * z
    s = axis2[0] * x + axis2[1] * y + axis2[2] * z
    flat = np.sqrt(c * c + s * s)
    if not (flat > 1e-150 and flat < np.inf):
        return c0, s0, 0.0
    # The length is preserved up to 60 degrees off the surface; beyond, it decreases steadily to 0.
    return c / flat, s / flat, min(np.sqrt(x * x + y * y + z * z), 2 * flat)


@inlined
def get_face_part_clearance(clearances: ClearanceTables, face: I64, weights: TriangleWeights) -> F64:
    """Return a distance (mm) from a point of `face` within which there is no other piece of the ground. It is at most `reach`
    (see `FacePartClearances`)."""
    n = clearances.parts_per_edge[face]
    if n == 0:
        return clearances.reach
    column, row = round_to_int(np.floor(weights[0] * n)), round_to_int(np.floor(weights[1] * n))
    return clearances.clearances[clearances.first_parts[face] + max(min(column, n - 1), 0) * n + max(min(row, n - 1), 0)]


@inlined
def walk_to_next_event(
    surface: SurfaceTables,
    clearances: ClearanceTables,
    search_height: F64,
    skip_first_search: BOOL,
    follow_borders: BOOL,
    walker: FaceWalker,
    progress: WalkProgress,
) -> tuple[FaceWalker, WalkProgress, WalkStopReason]:
    """Walk across faces until the displacement is used up, or until an event.

    An event occurs at a stretch that may meet another piece, within its length and up to `search_height` (mm). With
    `skip_first_search`, there is no event at the first stretch. With `follow_borders`, the walk continues along open borders with
    nothing beyond them, as long as no stretch can meet another piece."""
    table, link, forked, _ = surface
    f, (b1, b2), side, (c, s), (heading_c, heading_s) = walker
    left, distance, turn = progress
    event, edge, length, hops = 0, 0, 0.0, 0
    while turn < MAX_EDGE_CROSSINGS and left > 0:
        if turn >= CROSSINGS_BEFORE_NUDGE:  # noqa: SIM102 # tested first: it is rarely true, and the remainder of a division is expensive
            if turn % CROSSINGS_BEFORE_NUDGE == 0 and not skip_first_search:
                b1 = b1 * (1 - CORNER_NUDGE_FRACTION) + CORNER_NUDGE_FRACTION / 3
                b2 = b2 * (1 - CORNER_NUDGE_FRACTION) + CORNER_NUDGE_FRACTION / 3
        row = FLOATS_PER_FACE_ROW * f
        _, along, across, shear = load_consecutive(table, row + RATE1_OFFSET - 1, 4)
        rate1 = c * along - s * shear
        rate2 = s * across
        rate0 = -(rate1 + rate2)
        b0 = 1.0 - b1 - b2
        until, edge = np.inf, 0
        if rate0 < 0:
            until = max(b0, 0.0) / -rate0
        if rate1 < 0:
            edge_distance = max(b1, 0.0) / -rate1
            if edge_distance < until:
                until, edge = edge_distance, 1
        if rate2 < 0:
            edge_distance = max(b2, 0.0) / -rate2
            if edge_distance < until:
                until, edge = edge_distance, 2
        length = min(until, left)
        if (
            search_height > 0
            and not skip_first_search
            and get_face_part_clearance(clearances, f, (b1, b2)) <= length + search_height
        ):
            event = LOOK_AHEAD_EVENT
            break
        skip_first_search = False
        b1, b2 = clamp_weights(b1 + rate1 * length, b2 + rate2 * length)
        distance += length
        if until >= left:
            break
        left = left - length
        cosine, sine, linked, _ = load_consecutive(table, row + EDGES_OFFSET + 4 * edge, 4)
        beyond = link[1, 3 * f + edge] if forked and side < 0 else round_to_int(linked)
        if beyond < 0:
            if beyond == NO_LINKED_EDGE or not follow_borders or search_height > 0:
                event = BORDER_EVENT
                break
            (c, s), left = turn_along_border((cosine, sine), (c, s), left)
            hops += 1
            if hops >= MAX_SURFACE_HOPS:
                left = 0.0
        else:
            f, (b1, b2), side, (c, s), (heading_c, heading_s) = cross_edge(
                table, beyond, edge, (cosine, sine), (b1, b2), side, (c, s), (heading_c, heading_s)
            )
            for line in (0, 24, 32):  # cache lines that only the final pose reads
                prefetch(table, FLOATS_PER_FACE_ROW * f + line)
        turn += 1
    walker = FaceWalker(f, (b1, b2), side, (c, s), (heading_c, heading_s))
    return walker, WalkProgress(left, distance, turn), WalkStopReason(event, edge, length, hops)


@inlined
def turn_along_border(edge: FaceDirection, direction: FaceDirection, remaining_length: F64) -> tuple[FaceDirection, F64]:
    """Return the new direction along an open border, and the remaining distance in this direction. `remaining_length`: the
    remaining distance in the previous direction."""
    (edge_c, edge_s), (c, s) = edge, direction
    along = c * edge_c + s * edge_s
    turn = -1.0 if along < 0 else 1.0
    return (turn * edge_c - BORDER_INWARD_SHARE * edge_s, turn * edge_s + BORDER_INWARD_SHARE * edge_c), remaining_length * abs(
        along
    )


@inlined
def cross_edge(
    table: Array1[F64],
    half_edge: I64,
    edge: I64,
    edge_direction: FaceDirection,
    weights: TriangleWeights,
    side: F64,
    direction: FaceDirection,
    heading: FaceDirection,
) -> FaceWalker:
    """Return the state of an agent after it has crossed an edge into the next face. `half_edge`: the link across the edge.
    `edge_direction`: the direction of the edge in the frame of the current face."""
    (c1, s1), (b1, b2), (c, s), (heading_c, heading_s) = edge_direction, weights, direction, heading
    f, k2, flip = np.int64(half_edge >> 3), (half_edge >> 1) & 3, (half_edge & 1) == 1
    b0 = 1.0 - b1 - b2
    first = b1 if edge == 0 else (b2 if edge == 1 else b0)
    second = b2 if edge == 0 else (b0 if edge == 1 else b1)
    if not flip:
        first, second = second, first
    c2, s2, _, _ = load_consecutive(table, FLOATS_PER_FACE_ROW * f + EDGES_OFFSET + 4 * k2, 4)
    turn = 1.0 if flip else -1.0
    ahead, out = turn * (c * c1 + s * s1), c * s1 - s * c1
    c, s = ahead * c2 - out * s2, ahead * s2 + out * c2
    ahead, out = turn * (heading_c * c1 + heading_s * s1), heading_c * s1 - heading_s * c1
    heading_c, heading_s = ahead * c2 - out * s2, ahead * s2 + out * c2
    b1 = max(first if k2 == 0 else (0.0 if k2 == 1 else second), 0.0)
    b2 = max(second if k2 == 0 else (first if k2 == 1 else 0.0), 0.0)
    return FaceWalker(f, (b1, b2), -side if flip else side, (c, s), (heading_c, heading_s))


@inlined
def compute_final_pose(table: Array1[F64], walker: FaceWalker, height: F64) -> AgentPose:
    """Return an agent's pose in world space: position, smooth normal, heading and direction of travel.

    Heading and direction are unit vectors in the plane of the smooth normal."""
    f, (b1, b2), side, (c, s), (heading_c, heading_s) = walker
    row = FLOATS_PER_FACE_ROW * f
    b0 = 1.0 - b1 - b2
    numbers = load_consecutive(table, row, FLOATS_PER_FACE_ROW)
    axis1, axis2, (nx, ny, nz) = (
        numbers[AXIS1_OFFSET:AXIS2_OFFSET],
        numbers[AXIS2_OFFSET:NORMAL_OFFSET],
        numbers[NORMAL_OFFSET:RATE1_OFFSET],
    )
    corner, edge1, edge2 = (
        numbers[CORNER_OFFSET:EDGE1_OFFSET],
        numbers[EDGE1_OFFSET:EDGE2_OFFSET],
        numbers[EDGE2_OFFSET:SMOOTH_NORMALS_OFFSET],
    )
    s0, s1, (s2, s3, s4, s5, s6, s7, s8) = (
        numbers[EDGES_OFFSET + 7],
        numbers[EDGES_OFFSET + 11],
        numbers[SMOOTH_NORMALS_OFFSET:FLOATS_PER_FACE_ROW],
    )
    sx, sy, sz = s0 * b0 + s3 * b1 + s6 * b2, s1 * b0 + s4 * b1 + s7 * b2, s2 * b0 + s5 * b1 + s8 * b2
    size = np.sqrt(max(sx * sx + sy * sy + sz * sz, 1e-300))
    sx, sy, sz = sx / size * side, sy / size * side, sz / size * side
    nx, ny, nz = nx * side, ny * side, nz * side
    hx = axis1[0] * heading_c + axis2[0] * heading_s
    hy = axis1[1] * heading_c + axis2[1] * heading_s
    hz = axis1[2] * heading_c + axis2[2] * heading_s
    hx, hy, hz = _rotate_with_surface_normal(hx, hy, hz, nx, ny, nz, sx, sy, sz)
    off = hx * sx + hy * sy + hz * sz
    hx, hy, hz = hx - off * sx, hy - off * sy, hz - off * sz
    size = np.sqrt(hx * hx + hy * hy + hz * hz)
    place = (
        corner[0] + b1 * edge1[0] + b2 * edge2[0] + height * nx,
        corner[1] + b1 * edge1[1] + b2 * edge2[1] + height * ny,
        corner[2] + b1 * edge1[2] + b2 * edge2[2] + height * nz,
    )
    dx, dy, dz = plus(times(axis1, c), times(axis2, s))
    # Rotate along the face's normal into the plane of the smooth one, so that the next step's projection is exact.
    lift = (dx * sx + dy * sy + dz * sz) / max(nx * sx + ny * sy + nz * sz, _MIN_NORMAL_COSINE)
    dx, dy, dz = dx - lift * nx, dy - lift * ny, dz - lift * nz
    long = np.sqrt(dx * dx + dy * dy + dz * dz)
    return AgentPose(place, (sx, sy, sz), (hx / size, hy / size, hz / size), (dx / long, dy / long, dz / long))


@inlined
def _rotate_with_surface_normal(vx: F64, vy: F64, vz: F64, bx: F64, rotation: F64, bz: F64, ax: F64, ay: F64, az: F64) -> Vec3:
    """Return the vector v, rotated by the smallest rotation from unit normal b to unit normal a. If the normals are opposite, the
    rotation goes through v itself."""
    cosine = bx * ax + rotation * ay + bz * az
    if cosine < -1 + 1e-9:
        hx, hy, hz = rotation * vz - bz * vy, bz * vx - bx * vz, bx * vy - rotation * vx
        twice = 2 * (hx * vx + hy * vy + hz * vz)
        return twice * hx - vx, twice * hy - vy, twice * hz - vz
    x, y, z = rotation * az - bz * ay, bz * ax - bx * az, bx * ay - rotation * ax
    part = (x * vx + y * vy + z * vz) / (1 + cosine)
    return (
        cosine * vx + (y * vz - z * vy) + part * x,
        cosine * vy + (z * vx - x * vz) + part * y,
        cosine * vz + (x * vy - y * vx) + part * z,
    )
