"""Finds bodies that cannot simply follow their feet. Lifts bodies on wide faces so that they clear ground that rises beyond
the face's edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.ground.mesh.face_table import (  # fmt: skip
    CORNER_OFFSET,
    EDGE1_OFFSET,
    EDGE2_OFFSET,
    FLOATS_PER_FACE_ROW,
    NORMAL_OFFSET,
    RATE1_OFFSET,
)
from antdsl.ground.mesh.surroundings import compute_position_on_face
from antdsl.ground.mesh.walkers import FootingArrays, SurfaceTables
from antdsl.machine_code.kernels import kernel, kernel_helper, load_consecutive, simd_range
from antdsl.machine_code.kernels.types import BOOL, F64, I32, I64, U8, Array1, Array2
from antdsl.numerics.kernel_vectors import TriangleWeights, Vec3, VectorColumns, dot, load_vector, minus, plus, times
from antdsl.runtime.moving.body_records import (
    MAX_LIFT_BODY_LENGTHS,
    SHARP_BEND_LEVEL,
    BodyLimits,
    BodyPoses,
    BodyRegisters,
    compute_body_shape,
)
from antdsl.runtime.moving.clearance.body_paths import BodyShape
from antdsl.runtime.moving.postures import read_vector
from antdsl.runtime.moving.velocities import HURRYING_BODY_STATE, STANDING_BODY_STATE

_F = np.float32


@kernel
def select_bodies_near_bends(
    bend_levels: Array1[U8],
    heading: VectorColumns,
    state: Array1[I32],
    level_headings: VectorColumns,
    registers: BodyRegisters,
    rows: Array1[I64],
    selected_bend_levels: Array1[U8],
    begin: I64,
    end: I64,
) -> tuple[I64, I64]:
    """Find the agents from `begin` to before `end` that may need shorter steps.

    Write them to `rows`, from index `begin` on. Return `begin` and their number. `bend_levels`: how sharply the ground around
    each agent bends, 0 if it does not. The `state` of all agents on ground that bends is set so that their bodies are aligned
    after the walk. `level_headings`: receives the headings of these agents. `selected_bend_levels`: receives the bend levels
    of the agents in `rows`."""
    count = begin
    for i in range(begin, end):
        if bend_levels[i] > 0 and state[i] == STANDING_BODY_STATE:
            state[i] = HURRYING_BODY_STATE
            for k in range(3):
                level_headings[k][i] = heading[k][i]
        waits = (
            registers.wait_share[i] != 0
            or registers.outward_direction[0][i] != 0
            or registers.outward_direction[1][i] != 0
            or registers.outward_direction[2][i] != 0
        )
        if bend_levels[i] == SHARP_BEND_LEVEL or waits:
            rows[count], selected_bend_levels[count] = i, bend_levels[i]
            count += 1
    return begin, count - begin


class LiftLists(NamedTuple):
    """The lists that `list_bodies_to_lift` writes: `rows` with their `bend_levels`, and `climbers`. `list_kinds`: a work
    buffer."""

    rows: Array1[I64]
    bend_levels: Array1[U8]
    climbers: Array1[I64]
    list_kinds: Array1[U8]


@kernel
def list_bodies_to_lift(
    surface: SurfaceTables,
    feet: FootingArrays,
    has_bend: Array1[BOOL],
    state: Array1[I32],
    bend_levels: Array1[U8],
    registers: BodyRegisters,
    lists: LiftLists,
    begin: I64,
    end: I64,
) -> tuple[I64, I64, I64]:
    """List the bodies from `begin` to before `end` that cannot simply follow their feet, and the climbers.

    A listed body is near a bend of the ground, or is shifted, waiting or inside a surface. Climbers are all other bodies on faces
    next to a bend. Return `begin`, the number of listed bodies, and the number of climbers. The `state` of a listed body becomes
    that of a body aligned with its feet."""
    first, (rows, row_levels, climbers, kind) = surface.first_faces, lists
    for row in simd_range(begin, end):
        climbs = False
        if feet.mesh[row] >= 0 and feet.face[row] >= 0:
            climbs = has_bend[first[feet.mesh[row]] + feet.face[row]]
        x, y, z = registers.lift[0][row], registers.lift[1][row], registers.lift[2][row]
        shifted = (x != 0) | (y != 0) | (z != 0) | (registers.penetration_depth[row] != 0) | (registers.wait_share[row] != 0)
        is_listed = (bend_levels[row] > 0) | (shifted & (not climbs) & (state[row] != STANDING_BODY_STATE))
        kind[row] = 1 if is_listed else 2 if climbs else 0
        if is_listed:
            state[row] = STANDING_BODY_STATE
        elif shifted:
            registers.penetration_depth[row], registers.wait_share[row] = _F(0), _F(0)
            if not climbs:
                for axis in range(3):
                    registers.lift[axis][row] = _F(0)
    count, raised = begin, begin
    for row in range(begin, end):
        rows[count], row_levels[count], climbers[raised] = row, bend_levels[row], row
        count += kind[row] == 1
        raised += kind[row] == 2
    return begin, count - begin, raised - begin


@kernel
def lift_bodies(
    surface: SurfaceTables,
    feet: FootingArrays,
    pose: BodyPoses,
    limits: BodyLimits,
    registers: BodyRegisters,
    rows: Array1[I64],
    begin: I64,
    end: I64,
) -> None:
    """Lift bodies that stand on wide faces so that they clear the neighbouring faces. Entries `begin` to before `end` of
    `rows` are processed."""
    for k in simd_range(begin, end):
        i = rows[k]
        size, up, heading = np.float64(limits.size[i]), read_vector(pose.up, i), read_vector(pose.heading, i)
        has_face = feet.mesh[i] >= 0 and feet.face[i] >= 0
        f, weights = surface.first_faces[max(feet.mesh[i], 0)] + max(feet.face[i], 0), (feet.b1[i], feet.b2[i])
        rise = _compute_face_lift(
            surface.face_table, surface.edge_links, f, weights, compute_body_shape(limits, i, size), up, heading
        )
        old = read_vector(registers.lift, i)
        change = minus(times(up, min(rise, MAX_LIFT_BODY_LENGTHS * size) if has_face else 0.0), old)
        lift = plus(old, times(change, min(limits.voluntary_shift * size / max(np.sqrt(dot(change, change)), 1e-300), 1.0)))
        for axis in range(3):
            registers.lift[axis][i] = _F(lift[axis])


@kernel_helper
def _compute_face_lift(
    table: Array1[F64], link: Array2[I32], face: I64, weights: TriangleWeights, shape: BodyShape, up: Vec3, heading: Vec3
) -> F64:
    """Return how far (mm) a body must rise along its up direction so that both its ends clear its face. They must also clear the
    faces that rise beyond the face's edges."""
    row, lift = FLOATS_PER_FACE_ROW * face, 0.0
    own = load_vector(table, row + NORMAL_OFFSET)
    side = -1.0 if dot(own, up) < 0 else 1.0
    own, place = times(own, side), compute_position_on_face(table, row, weights, side)
    middle = plus(times(up, shape.middle_height), times(heading, shape.middle_forward_offset))
    _, along, slant, shear = load_consecutive(table, row + RATE1_OFFSET - 1, 4)
    for edge in range(4):
        normal, corner = own, place
        if edge < 3:
            # Distance from an edge: the weight of the opposite corner, divided by the gradient of that weight.
            weight, x, y = 1.0 - weights[0] - weights[1], -along, shear - slant
            if edge == 1:
                weight, x, y = weights[0], along, -shear
            if edge == 2:
                weight, x, y = weights[1], 0.0, slant
            reach = shape.axis_half_length + shape.radius + abs(shape.middle_forward_offset)
            if weight * weight > (x * x + y * y) * reach * reach:
                continue
            beyond = np.int64(link[1 if side < 0 else 0, 3 * face + edge])
            if beyond < 0:
                continue
            other = FLOATS_PER_FACE_ROW * (beyond >> 3)
            normal = times(load_vector(table, other + NORMAL_OFFSET), -side if (beyond & 1) == 1 else side)
            corner = load_vector(table, other + CORNER_OFFSET)
            # The face beyond the edge rises if a corner of the own face lies above its plane.
            center = plus(
                load_vector(table, row + CORNER_OFFSET),
                times(plus(load_vector(table, row + EDGE1_OFFSET), load_vector(table, row + EDGE2_OFFSET)), 1 / 3.0),
            )
            if dot(minus(center, corner), normal) <= 0:
                continue
        for end in range(2):
            tip = plus(middle, times(heading, shape.axis_half_length if end == 0 else -shape.axis_half_length))
            gap = dot(minus(plus(place, tip), corner), normal)
            lift = max(lift, (shape.radius - gap) / max(dot(normal, up), 0.5))
    return lift
