"""Records for walks over triangles: tables of faces, and the state of an agent."""

from __future__ import annotations

from typing import NamedTuple

from antdsl.ground.mesh.boxes import FaceBoxTree, FaceList
from antdsl.ground.protocol import Footing
from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, Array2
from antdsl.numerics.kernel_vectors import TriangleWeights

FaceDirection = tuple[F64, F64]  # cosine and sine in the frame of a face


class SurfaceTables(NamedTuple):
    """Tables of faces for a walk: the packed `face_table`, `link` and `has_forked_edges` of the topology, and the first face of
    each mesh."""

    face_table: Array1[F64]
    edge_links: Array2[I32]
    has_forked_edges: BOOL
    first_faces: Array1[I64]


class ClearanceTables(NamedTuple):
    """The distances of faces from other pieces of the ground: the arrays of `FacePartClearances`.

    An agent searches for other pieces within the length of its path, plus its eye height, plus `distance_noise`."""

    first_parts: Array1[I64]
    parts_per_edge: Array1[I32]
    clearances: Array1[F64]
    reach: F64
    distance_noise: F64


class SideGroups(NamedTuple):
    """The pieces and sides of faces. `piece_numbers`: the piece of each face. `side_groups` (2, m): the group number of both
    sides of each face."""

    piece_numbers: Array1[I32]
    side_groups: Array2[I32]


class CutTables(NamedTuple):
    """For each face, the faces of the same piece that cut it: `cutting_faces` from `cut_starts[face]` to `cut_starts[face + 1]`
    (exclusive)."""

    cut_starts: Array1[I64]
    cutting_faces: Array1[I64]


class LengthTolerances(NamedTuple):
    """The lengths of `GroundTolerances` (mm) that kernels read."""

    min_eye_height: F64
    coincident_distance: F64
    max_below_height: F64
    touch_distance: F64


class NearbySurfaces(NamedTuple):
    """The data for finding other pieces of the ground near a path: lookup tables, and a buffer that lists the candidate faces."""

    sides: SideGroups
    boxes: FaceBoxTree
    length_tolerances: LengthTolerances
    face_list: FaceList


class FaceWalker(NamedTuple):
    """The state of an agent on one side (1 or -1) of a face: barycentric weights, and direction of travel and heading in the
    frame of the face."""

    face: I64
    weights: TriangleWeights
    side: F64
    direction: FaceDirection
    heading: FaceDirection


class WalkProgress(NamedTuple):
    """The remaining and the travelled distance of an agent (mm), and the number of edges that it has crossed."""

    remaining_length: F64
    travelled_length: F64
    crossing_count: I64


class WalkStopReason(NamedTuple):
    """The reason why a walk paused (0 if it did not), the edge and length of the last stretch, and the number of followed
    borders."""

    event: I64
    edge: I64
    length: F64
    followed_borders: I64


class SurfaceLanding(NamedTuple):
    """The point on another face at which an agent continues: its face (-1 for none), its weights, and the side of the face.

    `distance`, `height`: the distance to this point and its height over the current face (mm). `ends_walk`: whether the agent
    stops there."""

    face: I64
    weights: TriangleWeights
    side: F64
    distance: F64
    height: F64
    ends_walk: BOOL


class PieceSearchTables(NamedTuple):
    """The tables with which several threads search for other pieces of the ground.

    - `face_buffer`: `buffer_count` buffers in sequence, each with space for all faces
    - `agent_count`: the number of agents"""

    sides: SideGroups
    cuts: CutTables
    boxes: FaceBoxTree
    length_tolerances: LengthTolerances
    face_buffer: Array1[I64]
    buffer_count: I64
    agent_count: I64


class FootingArrays(NamedTuple):
    """The footings of agents as arrays: mesh, face, two weights, and the height over the face (mm). Fields have the names of the
    columns of `Footing`."""

    mesh: Array1[I32]
    face: Array1[I32]
    b1: Array1[F64]
    b2: Array1[F64]
    over: Array1[F64]


def get_footing_arrays(footing: Footing) -> FootingArrays:
    """Return the arrays of footings on meshes that kernels read and write."""
    return FootingArrays._make(map(footing.columns.__getitem__, FootingArrays._fields))


class PoseArrays(NamedTuple):
    """Position, up, heading and direction of travel of n agents (3, n), and the distances that they have travelled [n] (mm)."""

    place: Array2[F64]
    up: Array2[F64]
    heading: Array2[F64]
    direction: Array2[F64]
    travelled: Array1[F64]


class AgentWalkResult(NamedTuple):
    """The state of an agent at the end or at a pause of its walk.

    - `search_height`: the height (mm), on the agent's side, up to which it searches for other surfaces
    - `height`: its height (mm) over its face, on its side"""

    search_height: F64
    height: F64
    walker: FaceWalker
    progress: WalkProgress
    stop: WalkStopReason
