"""The records through which kernels read bodies that stay outside their ground."""

from __future__ import annotations

from typing import NamedTuple

from antdsl.ground.mesh.boxes import FaceBoxTree
from antdsl.ground.mesh.walkers import ClearanceTables
from antdsl.machine_code.kernels import inlined
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I32, I64, U8, Array1, Array2, Strided2
from antdsl.numerics.kernel_vectors import VectorColumns
from antdsl.runtime.moving.clearance.body_paths import BodyShape

SHARP_BEND_LEVEL = 2  # level of ground with sharp edges, other pieces or cuts; see `MeshGround.mark_bend_levels`
MAX_LIFT_BODY_LENGTHS = 0.6  # body lengths; the largest shift of a body


class BodyPoses(NamedTuple):
    """The up direction and the heading of each body, as x, y and z arrays."""

    up: VectorColumns
    heading: VectorColumns


class BodyLimits(NamedTuple):
    """Limits of bodies in a step.

    `max_tilts`: the largest tilt of each agent in this step (radians). `max_turn`: its largest turn (rad/s). `size`: its size
    (mm). `max_speed`: its largest speed (mm/s). `body_numbers`: the index of its body in `unit_shapes`. `dt`: the duration of the
    step (s). `unit_shapes`: for each body of the species, the fields of its `BodyShape` at a size of 1 mm. `voluntary_shift`: how
    much the shift of a body may change in the step to follow its ground (body lengths). `max_shift`: how much it may change to
    leave an obstacle (body lengths)."""

    max_tilts: Array1[F32]
    max_turn: Array1[F32]
    dt: F32
    size: Array1[F32]
    max_speed: Array1[F32]
    unit_shapes: Array2[F64]
    body_numbers: Array1[U8]
    voluntary_shift: F64
    max_shift: F64


class BodyRegisters(NamedTuple):
    """Values that a body retains from step to step.

    `lift`: its shift relative to the feet (mm). `wait_share`: how far its feet slow down to wait for the body, from 0 to 1; -1
    while it retreats. `penetration_depth`: how deep it is inside a surface (body lengths). `outward_direction`: the direction
    out of the surface that it touched. `idle_time`: for how long (s) its feet have not moved although they should."""

    lift: VectorColumns
    wait_share: Array1[F32]
    penetration_depth: Array1[F32]
    outward_direction: VectorColumns
    idle_time: Array1[F32]


class BodyRows(NamedTuple):
    """Rows of agents, with a bend level for each. `bend_levels`: how sharply the ground around the agent bends; see
    `MeshGround.mark_bend_levels`."""

    rows: Array1[I64]
    bend_levels: Array1[U8]


class BodyStances(NamedTuple):
    """The stances of all bodies: positions (n, 3) mm, normals (n, 3) of the ground, and poses (up direction and heading)."""

    positions: Strided2[F64]
    normals: Array2[F32]
    pose: BodyPoses


class FaceBuffers(NamedTuple):
    """Work buffers for face numbers. There are `buffer_count` buffers; each serves a chunk of `rows_per_chunk` rows."""

    face_numbers: Array1[I64]
    buffer_count: I64
    rows_per_chunk: I64


class ContactFaces(NamedTuple):
    """Faces that bodies must stay outside of: their packed `face_table`, the mesh piece of each face, a tree of boxes, and
    buffers."""

    face_table: Array1[F64]
    piece_numbers: Array1[I32]
    box_tree: FaceBoxTree
    buffers: FaceBuffers


class FaceSearch(NamedTuple):
    """Tables for a search of the faces near a path.

    `has_several_pieces`: whether a path may meet a face of another mesh piece, or a face that cuts its own piece.
    `clearances`: lower bounds of the distance to such faces. `piece_numbers`: the mesh piece of each face. `cut_starts`: which
    faces are cut by others. `box_tree`: a tree of the faces' boxes. `buffers`: work memory."""

    has_several_pieces: BOOL
    clearances: ClearanceTables
    piece_numbers: Array1[I32]
    cut_starts: Array1[I64]
    box_tree: FaceBoxTree
    buffers: FaceBuffers


@inlined
def compute_body_shape(limits: BodyLimits, i: I64, size: F64) -> BodyShape:
    """Return the capsule of the agent at row `i`, scaled to a body size of `size` mm."""
    k, shapes = limits.body_numbers[i], limits.unit_shapes
    return BodyShape(shapes[k, 0] * size, shapes[k, 1] * size, shapes[k, 2] * size, shapes[k, 3] * size)
