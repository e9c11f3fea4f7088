"""Records that walks over triangles use: tables of faces, and the state of an agent."""

from __future__ import annotations

from typing import NamedTuple

from antdsl.ground.mesh.boxes import FaceBoxTree, FaceList
from antdsl.ground.protocol import Footing
from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, Array2
from antdsl.numerics.kernel_vectors import TriangleWeights

FaceDirection = tuple[F64, F64]  # cosine and sine in the frame of a face


class SurfaceTables(NamedTuple):
    """Tables of faces for a walk: the packed table, `edge_links` and `has_forked_edges` of the topology, and the `first_faces`
    face of each mesh."""

    face_table: Array1[F64]
    edge_links: Array2[I32]
    has_forked_edges: BOOL
    first_faces: Array1[I64]


class ClearanceTables(NamedTuple):
    """Distances to other pieces: the arrays of `FacePartClearances`.

    An agent searches for pieces within its path, plus EYE_HEIGHT_PER_BODY times its body, plus `distance_noise`."""

    first_parts: Array1[I64]
    parts_per_edge: Array1[I32]
    clearances: Array1[F64]
    reach: F64
    distance_noise: F64


class SideGroups(NamedTuple):
    """`piece_numbers` and `side_groups` of the topology: the piece of each face, and a group number for both sides of each
    face."""

    piece_numbers: Array1[I32]
    side_groups: Array2[I32]


class CutTables(NamedTuple):
    """Faces of the same piece that cut each face: `cutting_faces` from `cut_starts[face]` to `cut_starts[face + 1]`
    (exclusive)."""

    cut_starts: Array1[I64]
    cutting_faces: Array1[I64]


class LengthTolerances(NamedTuple):
    """`min_eye_height`, `coincident_distance`, `max_below_height` and `touch_distance` of `GroundTolerances` (mm)."""

    min_eye_height: F64
    coincident_distance: F64
    max_below_height: F64
    touch_distance: F64


class NearbySurfaces(NamedTuple):
    """The tables for a search of other pieces, with a buffer for the faces that are found."""

    sides: SideGroups
    boxes: FaceBoxTree
    length_tolerances: LengthTolerances
    face_list: FaceList


class FaceWalker(NamedTuple):
    """The state of an agent on a side (1 or -1) of a face: corner weights, direction of travel, and heading in the face's
    frame."""

    face: I64
    weights: TriangleWeights
    side: F64
    direction: FaceDirection
    heading: FaceDirection


class WalkProgress(NamedTuple):
    """The distances that an agent has left and has travelled (mm), and the number of edges it has crossed."""

    remaining_length: F64
    travelled_length: F64
    crossing_count: I64


class WalkStopReason(NamedTuple):
    """The reason why a walk paused (0: it did not), the edge and length of the last stretch, and the number of followed
    borders."""

    event: I64
    edge: I64
    length: F64
    followed_borders: I64


class SurfaceLanding(NamedTuple):
    """The face on which an agent continues (-1 for none), with the weights of the landing point and the side of the face.

    `distance`, `height`: the distance to the landing point and its height over the current face (mm). `ends_walk`: whether the
    agent stops there."""

    face: I64
    weights: TriangleWeights
    side: F64
    distance: F64
    height: F64
    ends_walk: BOOL


class PieceSearchTables(NamedTuple):
    """The tables for a search of other pieces.

    - `face_buffer`: `buffer_count` parts, each with space for all faces
    - `agent_count`: the number of agents"""

    sides: SideGroups
    cuts: CutTables
    boxes: FaceBoxTree
    length_tolerances: LengthTolerances
    face_buffer: Array1[I64]
    buffer_count: I64
    agent_count: I64


class FootingArrays(NamedTuple):
    """The footings of agents: mesh, face, two weights, and the height over the face (mm). The names are those of columns."""

    mesh: Array1[I32]
    face: Array1[I32]
    b1: Array1[F64]
    b2: Array1[F64]
    over: Array1[F64]


def get_footing_arrays(footing: Footing) -> FootingArrays:
    """Return the arrays of footings on meshes, as kernels read and write them."""
    return FootingArrays._make(map(footing.columns.__getitem__, FootingArrays._fields))


class PoseArrays(NamedTuple):
    """Position, up, heading and direction of agents (3, n), and the distance that they have travelled (mm)."""

    place: Array2[F64]
    up: Array2[F64]
    heading: Array2[F64]
    direction: Array2[F64]
    travelled: Array1[F64]


class AgentWalkResult(NamedTuple):
    """An agent during a walk.

    - `search_height`: the distance (mm), on the agent's side, within which it searches for other surfaces
    - `height`: its height (mm) over its face, on its side"""

    search_height: F64
    height: F64
    walker: FaceWalker
    progress: WalkProgress
    stop: WalkStopReason
