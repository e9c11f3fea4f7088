"""Searches the surroundings of agents beyond the next face: for other surfaces in their path, and for surfaces beyond a
border."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from antdsl.ground.mesh.boxes import find_first_face_hit, list_faces_near_segment
from antdsl.ground.mesh.face_table import (
    AXIS1_OFFSET,
    AXIS2_OFFSET,
    CORNER_OFFSET,
    EDGE1_OFFSET,
    EDGE2_OFFSET,
    EDGE_COSINE_INDEX,
    EDGE_SINE_INDEX,
    EDGES_OFFSET,
    FLOATS_PER_FACE_ROW,
    NORMAL_OFFSET,
)
from antdsl.ground.mesh.walkers import FaceDirection, FaceWalker, LengthTolerances, NearbySurfaces, SideGroups, SurfaceLanding
from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, inlined, kernel_helper
from antdsl.numerics.kernel_vectors import (
    TriangleWeights,
    Vec3,
    clamp_weights,
    dot,
    find_nearest_weights,
    fmax,
    fmin,
    load_vector,
    minus,
    normalise_or_first_axis,
    plus,
    rotate_between_normals,
    times,
)

EYE_HEIGHT_BODY_LENGTHS = 0.02  # body lengths; eye height above the surface
# multiple of the eye height; the search covers at least this distance, because climbing also gains height
MIN_LOOK_AHEAD_FACTOR = 8.0
BORDER_GAP_BODY_LENGTHS = 0.02  # body lengths; distance beyond a border that is searched
# Body lengths: height and depth of the search at a border, and its second depth
BORDER_RAY_HEIGHT_BODY_LENGTHS, BORDER_RAY_DEPTH_BODY_LENGTHS = 0.5, 0.25
RELATIVE_DISTANCE_NOISE = 1e-4  # share of the ground's extent; exceeds the error of distances to other pieces
RELATIVE_MIN_EYE_HEIGHT = 1e-6  # share of the extent; smallest eye height
RELATIVE_COINCIDENT_DISTANCE = 1e-8  # share of the extent; nearer surfaces coincide
RELATIVE_TOUCH_DISTANCE = 1e-9  # share of the extent; feet nearer to a cutting face are on it
# Cosine of about 100 degrees. Agents do not step over a border between faces with a smaller cosine.
MIN_COSINE_BETWEEN_NORMALS = -0.17


@dataclass(frozen=True, slots=True)
class GroundTolerances:
    """Lengths (mm) that are proportional to the size of a ground.

    - `distance_noise`: an upper bound of the error of measured distances to other pieces of the ground
    - `min_eye_height`: the least height above the feet from which an agent searches for other surfaces
    - `coincident_distance`: the distance within which surfaces coincide
    - `touch_distance`: the distance within which faces touch
    - `max_below_height`: a surface that shows its back to an agent counts as below the agent, up to this height above its feet"""

    distance_noise: float
    min_eye_height: float
    coincident_distance: float
    touch_distance: float
    max_below_height: float

    @staticmethod
    def from_extent(extent: float) -> GroundTolerances:
        """Return the lengths for a ground of size `extent` (mm)."""
        return GroundTolerances(
            RELATIVE_DISTANCE_NOISE * extent,
            RELATIVE_MIN_EYE_HEIGHT * extent,
            RELATIVE_COINCIDENT_DISTANCE * extent,
            RELATIVE_TOUCH_DISTANCE * extent,
            10 * RELATIVE_COINCIDENT_DISTANCE * extent,
        )

    def get_length_tolerances(self) -> LengthTolerances:
        """Return the lengths that kernels read."""
        return LengthTolerances(self.min_eye_height, self.coincident_distance, self.max_below_height, self.touch_distance)


class SurfaceStance(NamedTuple):
    """The position, local up direction and direction of travel of an agent on a surface."""

    position: Vec3
    up: Vec3
    direction: Vec3


class VisibleSurface(NamedTuple):
    """A visible face (-1 for none), the weights and distance of its visible point, the direction of view, and the eye height."""

    face: I64
    weights: TriangleWeights
    distance: F64
    direction: Vec3
    eye_height: F64


class BorderFrame(NamedTuple):
    """The face that an agent leaves over a border, the side of this face, and the local up direction."""

    face: I64
    side: F64
    up: Vec3


@kernel_helper
def find_landing_ahead(
    table: Array1[F64], nearby_surfaces: NearbySurfaces, body: F64, walker: FaceWalker, remaining_length: F64, length: F64
) -> SurfaceLanding:
    """Return the landing on another piece of ground in the agent's path, as seen from slightly above the ground.

    If the agent's own piece hides the other piece, the search is repeated from the least eye height. Otherwise feet could pass
    below the agent's own piece."""
    pieces, boxes, face_list, f = (
        nearby_surfaces.sides.piece_numbers,
        nearby_surfaces.boxes,
        nearby_surfaces.face_list,
        walker.face,
    )
    least, fine = nearby_surfaces.length_tolerances.min_eye_height, nearby_surfaces.length_tolerances.coincident_distance
    ground = compute_surface_stance(table, walker)
    place, _, direction = ground
    high = fmax(fmin(EYE_HEIGHT_BODY_LENGTHS * body, remaining_length / MIN_LOOK_AHEAD_FACTOR), least)
    n = list_faces_near_segment(
        pieces, boxes, place, plus(place, times(direction, length)), high + 2 * fine, -1, pieces[f], face_list
    )
    if n == 0:
        return SurfaceLanding(-1, (0.0, 0.0), 1.0, length, 0.0, False)
    face, weights, distance, towards, eye = _find_visible_piece(table, nearby_surfaces, n, ground, length, high)
    if face < 0:
        return SurfaceLanding(face, (0.0, 0.0), 1.0, length, 0.0, False)
    if _is_face_hidden(table, nearby_surfaces, f, ground, length, eye, towards):
        n = list_faces_near_segment(
            pieces, boxes, place, plus(place, times(direction, length)), high + 2 * fine, -1, pieces[f], face_list
        )
        face, weights, distance, towards, eye = _find_visible_piece(table, nearby_surfaces, n, ground, length, least)
        if face < 0:
            return SurfaceLanding(face, (0.0, 0.0), 1.0, length, 0.0, False)
    weights = clamp_weights(weights[0] + 0.0, weights[1] + 0.0)
    return SurfaceLanding(
        face,
        weights,
        _find_approached_side(table, face, towards),
        min(np.sqrt(distance * distance + eye * eye), remaining_length),
        0.0,
        False,
    )


@kernel_helper
def _find_visible_piece(
    table: Array1[F64], around: NearbySurfaces, face_count: I64, ground: SurfaceStance, length: F64, eye_height: F64
) -> VisibleSurface:
    """Return another piece of ground in the path that is visible from the height `eye_height`, or below a low ceiling from half
    the ceiling's height. If none is visible, search from eye height down to the ground at the end of the path."""
    boxes, face_list, fine, under = (
        around.boxes,
        around.face_list,
        around.length_tolerances.coincident_distance,
        around.length_tolerances.max_below_height,
    )
    place, up, direction = ground
    roof, part, _ = find_first_face_hit(table, boxes, face_list, face_count, place, times(up, eye_height), fine)
    # A face slightly above the agent's feet with its back to the agent counts as below: climbing feet may be that deep in the
    # ground.
    if roof >= 0 and (dot(load_vector(table, FLOATS_PER_FACE_ROW * roof + NORMAL_OFFSET), up) < 0 or eye_height * part > under):
        eye_height = eye_height * part / 2
    eye, step = plus(place, times(up, eye_height)), times(direction, length)
    face, part, weights = find_first_face_hit(table, boxes, face_list, face_count, eye, step, fine)
    if face >= 0:
        return VisibleSurface(face, weights, min(part, 1.0) * length, direction, eye_height)
    # An obstacle between eye and ground at this point is below the next eye position, on the next face or in the next step.
    down = times(up, -eye_height)
    face, _, weights = find_first_face_hit(table, boxes, face_list, face_count, plus(eye, step), down, 0.0)
    return VisibleSurface(face, weights, length, down, eye_height)


@kernel_helper
def _is_face_hidden(
    table: Array1[F64], around: NearbySurfaces, f: I64, ground: SurfaceStance, length: F64, eye_height: F64, ray_direction: Vec3
) -> BOOL:
    """Return whether the agent's own piece of ground blocks its view along the search path. `f`: the agent's face.
    `ray_direction`: the direction of the last part of the path."""
    pieces, boxes, face_list, fine = (
        around.sides.piece_numbers,
        around.boxes,
        around.face_list,
        around.length_tolerances.coincident_distance,
    )
    place, up, direction = ground
    step, piece = times(direction, length), pieces[f]
    eye = plus(place, times(up, eye_height))
    n = list_faces_near_segment(pieces, boxes, place, plus(place, step), eye_height + 2 * fine, f, -1, face_list)
    first = find_first_face_hit(table, boxes, face_list, n, plus(place, times(up, fine)), times(up, eye_height - fine), 0.0).face
    if first >= 0 and pieces[first] == piece:
        return True
    first = find_first_face_hit(table, boxes, face_list, n, eye, step, fine).face
    if first >= 0 and pieces[first] == piece:
        return True
    if ray_direction[0] == direction[0] and ray_direction[1] == direction[1] and ray_direction[2] == direction[2]:
        return False
    first = find_first_face_hit(table, boxes, face_list, n, plus(eye, step), ray_direction, 0.0).face
    return first >= 0 and pieces[first] == piece


@kernel_helper
def find_landing_beyond_border(
    table: Array1[F64], nearby_surfaces: NearbySurfaces, body: F64, edge: I64, walker: FaceWalker
) -> SurfaceLanding:
    """Return the landing for an agent at an open border. It is the first surface that a search path beyond the border hits.

    The search path goes up from the face, out over the border and down beyond it. It then goes back below the border, first at a
    small depth and then at a larger one. The landing contains the face to step onto, the distance to it, and its height.

    Each part of the search path begins at the end of the previous part, and ends at the first surface. So an agent never steps
    onto a surface behind another one. The path extends one gap beyond the border, and one gap back below it."""
    sides, boxes, face_list, f = nearby_surfaces.sides, nearby_surfaces.boxes, nearby_surfaces.face_list, walker.face
    pieces, least, fine = (
        sides.piece_numbers,
        nearby_surfaces.length_tolerances.min_eye_height,
        nearby_surfaces.length_tolerances.coincident_distance,
    )
    row = FLOATS_PER_FACE_ROW * f
    place, up = (
        compute_position_on_face(table, row, walker.weights, walker.side),
        times(load_vector(table, row + NORMAL_OFFSET), walker.side),
    )
    border = BorderFrame(f, walker.side, up)
    along = row + EDGES_OFFSET + 4 * edge
    out = _to_world_direction(table, row, (table[along + EDGE_SINE_INDEX], -table[along + EDGE_COSINE_INDEX]))
    body = fmax(body, least / EYE_HEIGHT_BODY_LENGTHS)
    gap, high = BORDER_GAP_BODY_LENGTHS * body, BORDER_RAY_HEIGHT_BODY_LENGTHS * body
    most, across = high, times(out, gap)
    lift = times(up, high)
    n = list_faces_near_segment(pieces, boxes, plus(place, lift), minus(place, lift), gap + 4 * fine, f, -1, face_list)
    if n == 0:
        return SurfaceLanding(-1, (0.0, 0.0), 1.0, 0.0, 0.0, False)
    hair = times(out, 2 * fine)  # a small offset, for borders exactly above or below this one
    roof, part, _ = find_first_face_hit(
        table, boxes, face_list, n, plus(minus(place, hair), times(up, fine)), times(up, high - fine), 0.0
    )
    if roof >= 0:
        high = (fine + part * (high - fine)) / 2
    if find_first_face_hit(table, boxes, face_list, n, plus(place, times(up, high)), across, 0.0).face >= 0:
        high = min(high, EYE_HEIGHT_BODY_LENGTHS * body)
        face, part, weights = find_first_face_hit(table, boxes, face_list, n, plus(place, times(up, high)), across, 0.0)
        if face >= 0:
            distance = gap * min(part, 1.0)
            if abs(high) <= gap:
                return _build_landing(table, sides, border, face, weights, out, np.sqrt(distance * distance + high * high), 0.0)
            return _build_landing(table, sides, border, face, weights, out, distance, high)
    over, towards = plus(place, across), times(up, -(high + most))
    face, part, weights = find_first_face_hit(table, boxes, face_list, n, plus(over, times(up, high)), towards, 0.0)
    rise, distance = -most, gap
    if face >= 0:
        rise = high - part * (high + most)
        if _can_land_on_face(table, sides, border, face, towards):
            # Step onto the nearest point of the face to a position above the border and above the face's plane.
            face_row = FLOATS_PER_FACE_ROW * face
            normal, corner = load_vector(table, face_row + NORMAL_OFFSET), load_vector(table, face_row + CORNER_OFFSET)
            plane = dot(minus(corner, place), normal) / dot(up, normal)
            height = min(plane, high) if plane > rise else rise
            if abs(height) <= gap:
                height = 0.0
            above, edge1, edge2 = (
                plus(place, times(up, height)),
                load_vector(table, face_row + EDGE1_OFFSET),
                load_vector(table, face_row + EDGE2_OFFSET),
            )
            b1, b2, away = find_nearest_weights(edge1, edge2, minus(above, corner))
            onto = minus(plus(plus(corner, times(edge1, b1)), times(edge2, b2)), above)
            rise, distance, weights = height, away, (b1, b2)
            first, part, nearer = find_first_face_hit(table, boxes, face_list, n, above, onto, 0.0)
            if part * away < away - fine:
                face, weights, distance, towards = first, nearer, part * away, onto
        else:
            face = -1
    if face < 0:
        lowest, towards = rise, times(out, -2 * gap)
        for depth in (BORDER_GAP_BODY_LENGTHS * body, BORDER_RAY_DEPTH_BODY_LENGTHS * body):
            if lowest < -depth:
                face, part, weights = find_first_face_hit(table, boxes, face_list, n, minus(over, times(up, depth)), towards, 0.0)
                if face >= 0:
                    rise, distance = -depth, abs(gap - part * (2 * gap))
                    break
    if face < 0 or not _can_land_on_face(table, sides, border, face, towards):
        return SurfaceLanding(-1, (0.0, 0.0), 1.0, 0.0, 0.0, False)
    # Straight down at the border itself, where the hit may be nearer; straight across to near surfaces.
    if rise < -gap:
        fall = times(up, rise + fine)
        sooner, part, nearer = find_first_face_hit(
            table, boxes, face_list, n, minus(plus(place, hair), times(up, fine)), fall, 0.0
        )
        if sooner >= 0:
            face, weights, towards = sooner, nearer, fall
            rise, distance = part * (rise + fine) - fine, 0.0
    if abs(rise) <= gap:
        return _build_landing(table, sides, border, face, weights, towards, np.sqrt(distance * distance + rise * rise), 0.0)
    return _build_landing(table, sides, border, face, weights, towards, distance, rise)


@inlined
def project_directions_to_face(
    table: Array1[F64], walker: FaceWalker, face: I64, side: F64
) -> tuple[FaceDirection, FaceDirection]:
    """Return a walker's direction of travel and heading in the frame of another face. Both are rotated with the normal from its
    face to the other face."""
    row, other_row = FLOATS_PER_FACE_ROW * walker.face, FLOATS_PER_FACE_ROW * face
    old_normal, new_normal = (
        times(load_vector(table, row + NORMAL_OFFSET), walker.side),
        times(load_vector(table, other_row + NORMAL_OFFSET), side),
    )
    direction = _to_world_direction(table, row, walker.direction)
    new_direction = rotate_between_normals(direction, old_normal, new_normal, direction)
    heading = rotate_between_normals(_to_world_direction(table, row, walker.heading), old_normal, new_normal, direction)
    axis1, axis2 = load_vector(table, other_row + AXIS1_OFFSET), load_vector(table, other_row + AXIS2_OFFSET)
    return normalise_or_first_axis(dot(axis1, new_direction), dot(axis2, new_direction)), normalise_or_first_axis(
        dot(axis1, heading), dot(axis2, heading)
    )


@inlined
def compute_surface_stance(table: Array1[F64], walker: FaceWalker) -> SurfaceStance:
    """Return the position, up direction and direction of travel of a walker in world space."""
    row, side = FLOATS_PER_FACE_ROW * walker.face, walker.side
    place = compute_position_on_face(table, row, walker.weights, side)
    return SurfaceStance(
        place, times(load_vector(table, row + NORMAL_OFFSET), side), _to_world_direction(table, row, walker.direction)
    )


@inlined
def compute_position_on_face(table: Array1[F64], row: I64, weights: TriangleWeights, side: F64) -> Vec3:
    """Return the position of a point on a face, given by its weights."""
    return plus(
        plus(load_vector(table, row + CORNER_OFFSET), times(load_vector(table, row + EDGE1_OFFSET), weights[0])),
        times(load_vector(table, row + EDGE2_OFFSET), weights[1]),
    )


@inlined
def _to_world_direction(table: Array1[F64], row: I64, direction: FaceDirection) -> Vec3:
    """Convert a direction in the frame of a face to a vector in world space."""
    return plus(
        times(load_vector(table, row + AXIS1_OFFSET), direction[0]), times(load_vector(table, row + AXIS2_OFFSET), direction[1])
    )


@inlined
def _find_approached_side(table: Array1[F64], face: I64, direction: Vec3) -> F64:
    """Return the side (1 or -1) of a face on which a path in `direction` arrives. The agent then walks on this side."""
    return -1.0 if dot(load_vector(table, FLOATS_PER_FACE_ROW * face + NORMAL_OFFSET), direction) > 0 else 1.0


@kernel_helper
def _can_land_on_face(table: Array1[F64], sides: SideGroups, border: BorderFrame, face: I64, direction: Vec3) -> BOOL:
    """Return whether an agent may step over a border to a face.

    It may step neither to the other side of the surface on which it walks, nor to a face that turns back below this surface."""
    pieces, side_groups = sides
    to_side = _find_approached_side(table, face, direction)
    own_side, other = 1 if border.side < 0 else 0, 1 if to_side < 0 else 0
    alike = pieces[border.face] != pieces[face] or side_groups[own_side, border.face] == side_groups[other, face]
    return (
        alike
        and dot(times(load_vector(table, FLOATS_PER_FACE_ROW * face + NORMAL_OFFSET), to_side), border.up)
        > MIN_COSINE_BETWEEN_NORMALS
    )


@kernel_helper
def _build_landing(
    table: Array1[F64],
    sides: SideGroups,
    border: BorderFrame,
    face: I64,
    weights: TriangleWeights,
    direction: Vec3,
    distance: F64,
    rise: F64,
) -> SurfaceLanding:
    """Return the landing of `find_landing_beyond_border` on a face. If the agent may not step there, its face is -1."""
    if not _can_land_on_face(table, sides, border, face, direction):
        return SurfaceLanding(-1, (0.0, 0.0), 1.0, 0.0, 0.0, False)
    return SurfaceLanding(
        face,
        clamp_weights(weights[0] + 0.0, weights[1] + 0.0),
        _find_approached_side(table, face, direction),
        distance,
        rise,
        False,
    )
