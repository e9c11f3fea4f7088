"""Walking over triangles along straight lines that are unfolded across edges, climb other surfaces and stop at open borders.

The walk is exact in float64: the point never leaves its triangle, and the path is as long as requested. A first loop walks all
agents. Agents that may reach anything other than the next face of their own surface wait for a second loop."""

from __future__ import annotations

import numpy as np

from antdsl.ground.mesh.boxes import FaceList
from antdsl.ground.mesh.crossings import find_surface_crossing
from antdsl.ground.mesh.face_table import EDGE_COSINE_INDEX, EDGE_SINE_INDEX, EDGES_OFFSET, FLOATS_PER_FACE_ROW, MESH_OFFSET
from antdsl.ground.mesh.stretches import (
    BORDER_EVENT,
    LOOK_AHEAD_EVENT,
    MAX_SURFACE_HOPS,
    OVERHANG_EVENT,
    compute_final_pose,
    get_face_part_clearance,
    load_face_frame,
    project_to_face,
    turn_along_border,
    walk_to_next_event,
)
from antdsl.ground.mesh.surroundings import (
    EYE_HEIGHT_BODY_LENGTHS,
    find_landing_ahead,
    find_landing_beyond_border,
    project_directions_to_face,
)
from antdsl.ground.mesh.topology import NO_LINKED_EDGE
from antdsl.ground.mesh.walkers import (
    AgentWalkResult,
    ClearanceTables,
    FaceWalker,
    FootingArrays,
    NearbySurfaces,
    PieceSearchTables,
    PoseArrays,
    SurfaceLanding,
    SurfaceTables,
    WalkProgress,
    WalkStopReason,
)  # fmt: skip
from antdsl.machine_code.kernels import inlined, kernel, kernel_helper, prefetch, simd_range
from antdsl.machine_code.kernels.types import BOOL, F64, I32, I64, U8, Array1, Array2, Strided2
from antdsl.numerics.kernel_vectors import AgentPose, TriangleWeights, Vec3, get_column, store_column
from antdsl.numerics.kernel_vectors import clamp_weights as _inside
from antdsl.numerics.parallel import compute_buffer_index

# Values of waiting agents: rows of an array of floats, and of an array of integers.
(
    WEIGHT1_ROW,
    WEIGHT2_ROW,
    SIDE_ROW,
    DIRECTION_COSINE_ROW,
    DIRECTION_SINE_ROW,
    HEADING_COSINE_ROW,
    HEADING_SINE_ROW,
    REMAINING_ROW,
    TRAVELLED_ROW,
    BORDER_HEIGHT_ROW,
    EVENT_LENGTH_ROW,
    BODY_SIZE_ROW,
    FLOAT_ROW_COUNT,
) = range(13)
AGENT_ROW, FACE_ROW, CROSSINGS_ROW, HOPS_ROW, IS_BLOCKED_ROW, IS_NEAR_OTHER_PIECE_ROW, EVENT_ROW, EDGE_ROW, INTEGER_ROW_COUNT = (
    range(9)
)
LEFT_OUT_STATUS, FINISHED_STATUS, WAITING_STATUS = range(
    3
)  # state of an agent after the first loop; other callers leave agents out, for `walk_all`
PREFETCH_GROUPS_AHEAD = 2  # number of groups of eight agents between a prefetch and its use
PREFETCH_GROUP_SIZE = 64  # agents with rows prefetched together; they fit into the first-level cache


@inlined
def prefetch_faces(surface: SurfaceTables, mesh: Array1[I32], face: Array1[I32], begin: I64, end: I64) -> None:
    """Prefetch the table rows of the faces on which agents `begin` to `end` (exclusive) stand."""
    table, first = surface.face_table, surface.first_faces
    for i in simd_range(begin, end):
        if mesh[i] >= 0:
            row = FLOATS_PER_FACE_ROW * (first[mesh[i]] + face[i])
            prefetch(table, row)
            prefetch(table, row + 8)
            prefetch(table, row + 16)
            prefetch(table, row + 24)
            prefetch(table, row + 32)


@inlined
def walk_agent(
    surface: SurfaceTables,
    clearances: ClearanceTables,
    follow_borders: BOOL,
    face: I64,
    weights: TriangleWeights,
    height: F64,
    size: F64,
    wish: Vec3,
    heading: Vec3,
    up: Vec3,
) -> AgentWalkResult:
    """Walk an agent from the point `weights` of `face` over this and the following faces. It starts `height` mm off the face
    along its normal.

    `wish`: the displacement. `follow_borders`: whether the agent continues along open borders. Returns the state at the end or at
    the first event."""
    axis1, axis2, normal = load_face_frame(surface.face_table, FLOATS_PER_FACE_ROW * face)
    along_up = up[0] * normal[0] + up[1] * normal[1] + up[2] * normal[2]
    side = -1.0 if along_up < 0 else 1.0
    height = height * side
    weights = _inside(weights[0] + 0.0, weights[1] + 0.0)
    c, s, left = project_to_face(axis1, axis2, wish[0], wish[1], wish[2], 1.0, 0.0)
    heading_c, heading_s, _ = project_to_face(axis1, axis2, heading[0], heading[1], heading[2], c, s)
    high = _compute_search_margin(clearances.distance_noise, size)
    if not get_face_part_clearance(clearances, face, weights) <= left + high:
        high = -np.inf  # the complete path needs no search
    walker, progress = FaceWalker(face, weights, side, (c, s), (heading_c, heading_s)), WalkProgress(left, 0.0, 0)
    if height != 0 and left > 0:
        stop = WalkStopReason(OVERHANG_EVENT, 0, 0.0, 0)
    else:
        walker, progress, stop = walk_to_next_event(surface, clearances, high, False, follow_borders, walker, progress)
        if stop.followed_borders > 0:
            height = 0.0
    return AgentWalkResult(high, height, walker, progress, stop)


@inlined
def move_waiting_agents_to_front(
    statuses: Array1[U8], float_rows: Array2[F64], integer_rows: Array2[I64], begin: I64, end: I64
) -> tuple[I64, I64]:
    """Move the columns of waiting agents in `float_rows` and `integer_rows` to the front, so that they are adjacent from column
    `begin` on.

    Return how many of the agents `begin` to `end` (exclusive) wait (WAITING_STATUS), and how many are left out
    (LEFT_OUT_STATUS)."""
    waiting, left = 0, 0
    for k in range(begin, end):
        if statuses[k] == WAITING_STATUS:
            for row in range(0, FLOAT_ROW_COUNT):
                float_rows[row, begin + waiting] = float_rows[row, k]
            for row in range(0, INTEGER_ROW_COUNT):
                integer_rows[row, begin + waiting] = integer_rows[row, k]
            waiting += 1
        elif statuses[k] == LEFT_OUT_STATUS:
            left += 1
    return waiting, left


@kernel
def walk_all_agents(
    surface: SurfaceTables,
    clearances: ClearanceTables,
    footings: FootingArrays,
    body: Array1[F64],
    vectors: tuple[Array2[F64], Array2[F64], Array2[F64]],
    float_rows: Array2[F64],
    integer_rows: Array2[I64],
    statuses: Array1[U8],
    end_footings: FootingArrays,
    poses: PoseArrays,
    begin: I64,
    end: I64,
) -> tuple[I64, I64, I64]:
    """Make one step of agents `begin` to `end` (exclusive), as far as it needs no search for other surfaces.

    - `footings`: the initial footings; an agent without a footing, or with weights that are not finite, has none afterwards
    - `vectors`: displacement, heading and up (3, n); a displacement that is not finite counts as zero
    - `statuses`: receives FINISHED_STATUS for agents that have been moved, WAITING_STATUS for agents that wait
    - `float_rows`, `integer_rows` (.., n): receive the states of waiting agents, from column `begin` on
    - `end_footings`, `poses`: receive the results of moved agents

    Returns `begin`, how many agents wait, and how many are left out (0 in this function)."""
    mesh, face, b1s, b2s, overs = footings
    first = surface.first_faces
    wish, heading, up = vectors
    for start in range(begin, end, PREFETCH_GROUP_SIZE):
        last = min(start + PREFETCH_GROUP_SIZE, end)
        prefetch_faces(surface, mesh, face, start, last)
        for i in simd_range(start, last):
            statuses[i] = FINISHED_STATUS
            step, look, above_it = get_column(wish, i), get_column(heading, i), get_column(up, i)
            if mesh[i] < 0 or face[i] < 0 or not np.isfinite(b1s[i] + b2s[i] + overs[i]):
                end_footings.mesh[i], end_footings.face[i], poses.travelled[i] = -1, -1, 0.0
                end_footings.b1[i], end_footings.b2[i], end_footings.over[i] = 0.0, 0.0, 0.0
                _store_pose(poses, i, AgentPose((0.0, 0.0, 0.0), above_it, look, look))
                continue
            f, weights = first[mesh[i]] + face[i], (b1s[i], b2s[i])
            walk = walk_agent(surface, clearances, False, f, weights, overs[i], body[i], step, look, above_it)
            if walk.stop.event:
                statuses[i] = WAITING_STATUS
                store_waiting_agent(float_rows, integer_rows, i, body[i], walk)
                continue
            # No edge leads to another mesh.
            store_footing(end_footings, i, mesh[i], walk.walker.face - first[mesh[i]], walk.height, walk.walker)
            poses.travelled[i] = walk.progress.travelled_length
            _store_pose(poses, i, compute_final_pose(surface.face_table, walk.walker, walk.height))
    waiting, left = move_waiting_agents_to_front(statuses, float_rows, integer_rows, begin, end)
    return begin, waiting, left


@kernel
def continue_walks(
    surface: SurfaceTables,
    clearances: ClearanceTables,
    piece_tables: PieceSearchTables,
    stop_at_borders: BOOL,
    float_rows: Strided2[F64],
    integer_rows: Strided2[I64],
    statuses: Array1[U8],
    footings: FootingArrays,
    poses: PoseArrays,
    is_blocked: Array1[BOOL],
    begin: I64,
    end: I64,
) -> None:
    """Complete the steps of agents that wait for a search for other surfaces. Only waiting agents `begin` to `end` (exclusive)
    are processed. With `stop_at_borders`, paths end at open borders."""
    table, first, boxes = surface.face_table, surface.first_faces, piece_tables.boxes
    face_list = FaceList(
        piece_tables.face_buffer,
        compute_buffer_index(begin, piece_tables.agent_count, piece_tables.buffer_count) * boxes.triangle_order.size,
    )
    around = NearbySurfaces(piece_tables.sides, boxes, piece_tables.length_tolerances, face_list)
    for k in range(begin, end):
        i = integer_rows[AGENT_ROW, k]
        size = float_rows[BODY_SIZE_ROW, k]
        high = (
            _compute_search_margin(clearances.distance_noise, size) if integer_rows[IS_NEAR_OTHER_PIECE_ROW, k] != 0 else -np.inf
        )
        f, b1, b2, side, over = (
            integer_rows[FACE_ROW, k],
            float_rows[WEIGHT1_ROW, k],
            float_rows[WEIGHT2_ROW, k],
            float_rows[SIDE_ROW, k],
            float_rows[BORDER_HEIGHT_ROW, k],
        )
        walker = FaceWalker(
            f,
            (b1, b2),
            side,
            (float_rows[DIRECTION_COSINE_ROW, k], float_rows[DIRECTION_SINE_ROW, k]),
            (float_rows[HEADING_COSINE_ROW, k], float_rows[HEADING_SINE_ROW, k]),
        )
        left, distance, turn, looked = (
            float_rows[REMAINING_ROW, k],
            float_rows[TRAVELLED_ROW, k],
            integer_rows[CROSSINGS_ROW, k],
            False,
        )
        event, edge, length = integer_rows[EVENT_ROW, k], integer_rows[EDGE_ROW, k], float_rows[EVENT_LENGTH_ROW, k]
        while event:
            to = SurfaceLanding(-1, (0.0, 0.0), walker.side, 0.0, 0.0, False)
            if event == LOOK_AHEAD_EVENT:
                looked = True
                if length > 0:
                    to = to._replace(distance=length)
                    if piece_tables.cuts.cut_starts[walker.face + 1] > piece_tables.cuts.cut_starts[walker.face]:
                        to = find_surface_crossing(surface, around, piece_tables.cuts, walker, length)
                    nearer = find_landing_ahead(table, around, size, walker, left, to.distance)
                    if nearer.face >= 0:
                        to = nearer
                if to.face >= 0:
                    looked = False
                    turn += 1
            elif event == OVERHANG_EVENT:
                edge, outward = _find_open_border(table, surface.edge_links, walker)
                if outward:
                    event = BORDER_EVENT
                    turn -= 1  # because only `walk_to_next_event` counts this crossing
                else:
                    over, left, distance = _climb_over_border(over, 0.0, left, distance)
                    if over != 0:
                        left = 0.0
            if event == BORDER_EVENT:
                turn += 1
                to = find_landing_beyond_border(table, around, size, edge, walker)
                over, left, distance = _climb_over_border(over, to.height, left, distance)
                if to.face < 0 and over == to.height:
                    row = FLOATS_PER_FACE_ROW * walker.face + EDGES_OFFSET + 4 * edge
                    (c, s), left = turn_along_border(
                        (table[row + EDGE_COSINE_INDEX], table[row + EDGE_SINE_INDEX]), walker.direction, left
                    )
                    walker = walker._replace(direction=(c, s))
                    integer_rows[IS_BLOCKED_ROW, k] = 1
                    integer_rows[HOPS_ROW, k] += 1
                    if stop_at_borders or integer_rows[HOPS_ROW, k] >= MAX_SURFACE_HOPS:
                        left = 0.0
                elif to.face < 0 or over != to.height or not left >= to.distance:
                    if distance == 0:
                        integer_rows[IS_BLOCKED_ROW, k] = 1
                    to, left = to._replace(face=-1), 0.0
                else:
                    over = 0.0
                    integer_rows[IS_NEAR_OTHER_PIECE_ROW, k] = 1
                    high = _compute_search_margin(clearances.distance_noise, size)
            if to.face >= 0:
                direction, heading = project_directions_to_face(table, walker, to.face, to.side)
                walker = FaceWalker(to.face, to.weights, to.side, direction, heading)
                left = max(left - to.distance, 0.0)
                distance += to.distance
                integer_rows[HOPS_ROW, k] += 1
                if to.ends_walk or integer_rows[HOPS_ROW, k] >= MAX_SURFACE_HOPS:
                    left = 0.0
                    integer_rows[IS_BLOCKED_ROW, k] = 1
            walker, progress, stop = walk_to_next_event(
                surface, clearances, high, looked, False, walker, WalkProgress(left, distance, turn)
            )
            left, distance, turn = progress
            event, edge, length, _ = stop
            looked = False
        statuses[i] = FINISHED_STATUS
        mesh = int(table[FLOATS_PER_FACE_ROW * walker.face + MESH_OFFSET])
        store_footing(footings, i, mesh, walker.face - first[mesh], over, walker)
        poses.travelled[i], is_blocked[i] = distance, integer_rows[IS_BLOCKED_ROW, k] != 0
        _store_pose(poses, i, compute_final_pose(table, walker, over))


@inlined
def store_footing(footings: FootingArrays, i: I64, mesh: I64, face: I64, height: F64, walker: FaceWalker) -> None:
    """Write the footing of agent `i` after a walk. `height`: its height above the face (mm), on the agent's side."""
    footings.mesh[i], footings.face[i], footings.over[i] = mesh, face, height * walker.side + 0.0
    footings.b1[i], footings.b2[i] = walker.weights


@inlined
def _store_pose(poses: PoseArrays, i: I64, pose: AgentPose) -> None:
    store_column(poses.place, i, pose.position)
    store_column(poses.up, i, pose.up)
    store_column(poses.heading, i, pose.heading)
    store_column(poses.direction, i, pose.direction)


@inlined
def _compute_search_margin(noise: F64, body: F64) -> F64:
    """Return the distance (mm) from the path within which an agent searches for other pieces of the ground."""
    high = EYE_HEIGHT_BODY_LENGTHS * body
    if not high > noise:
        high = noise
    return high + noise


@kernel_helper
def store_waiting_agent(float_rows: Array2[F64], integer_rows: Array2[I64], i: I64, body: F64, walk: AgentWalkResult) -> None:
    """Store the state of agent `i`, which waits. An agent that has followed borders is marked as blocked."""
    high, over, walker, progress, stop = walk
    (
        integer_rows[AGENT_ROW, i],
        integer_rows[HOPS_ROW, i],
        integer_rows[IS_BLOCKED_ROW, i],
        integer_rows[IS_NEAR_OTHER_PIECE_ROW, i],
    ) = (i, stop.followed_borders, stop.followed_borders > 0, high > 0)
    float_rows[BODY_SIZE_ROW, i], float_rows[SIDE_ROW, i], float_rows[BORDER_HEIGHT_ROW, i], float_rows[EVENT_LENGTH_ROW, i] = (
        body,
        walker.side,
        over,
        stop.length,
    )
    float_rows[WEIGHT1_ROW, i], float_rows[WEIGHT2_ROW, i] = walker.weights
    float_rows[DIRECTION_COSINE_ROW, i], float_rows[DIRECTION_SINE_ROW, i] = walker.direction
    float_rows[HEADING_COSINE_ROW, i], float_rows[HEADING_SINE_ROW, i] = walker.heading
    float_rows[REMAINING_ROW, i], float_rows[TRAVELLED_ROW, i], integer_rows[CROSSINGS_ROW, i] = progress
    integer_rows[FACE_ROW, i], integer_rows[EVENT_ROW, i], integer_rows[EDGE_ROW, i] = walker.face, stop.event, stop.edge


@inlined
def _climb_over_border(height: F64, level: F64, remaining_length: F64, distance: F64) -> tuple[F64, F64, F64]:
    """Move an agent up or down at a border towards the height `level` (mm above the current face), as far as its remaining
    distance allows.

    Returns the new height, the remaining distance and the distance travelled."""
    most = level - height
    climb = min(abs(most), remaining_length)
    to = level if climb >= abs(most) else height + (-climb if most < 0 else climb)
    return to, remaining_length - climb, distance + climb


@inlined
def _find_open_border(table: Array1[F64], link: Array2[I32], walker: FaceWalker) -> tuple[I64, BOOL]:
    """Return the open border that an agent steps over, as an edge number 0 to 2, and whether the agent moves outwards."""
    f, (b1, b2), side, (c, s), _ = walker
    weights, edge, least = (1.0 - b1 - b2, b1, b2), 0, np.inf
    for k in range(3):
        if link[1 if side < 0 else 0, 3 * f + k] == NO_LINKED_EDGE and weights[k] < least:
            edge, least = k, weights[k]
    row = FLOATS_PER_FACE_ROW * f + EDGES_OFFSET + 4 * edge
    return edge, c * table[row + EDGE_SINE_INDEX] - s * table[row + EDGE_COSINE_INDEX] > 0
