"""Walking over triangles: straight lines that unfold across edges, climb obstacles and stop at open borders. Exact in float64:
the point never leaves its triangle, and the path is as long as requested.

A first loop goes over all agents. Agents that may meet anything but the next face of their own surface wait for a second loop."""

from __future__ import annotations

import numpy as np

from antdsl.ground.mesh.boxes import FaceList
from antdsl.ground.mesh.crossings import find_crossing
from antdsl.ground.mesh.face_table import EDGE_COSINE, EDGE_SINE, EDGES_OFFSET, MESH_OFFSET, ROW_FLOATS
from antdsl.ground.mesh.stretches import (
    BORDER_EVENT,
    LOOK_AHEAD_EVENT,
    MAX_SURFACE_HOPS,
    OVERHANG_EVENT,
    along_border,
    final_pose,
    frame,
    free_distance,
    lay_on_face,
    walk_stretches,
)
from antdsl.ground.mesh.surroundings import EYE_HEIGHT_PER_BODY, find_piece_ahead, look_beyond_border, turn_to_face
from antdsl.ground.mesh.topology import NO_LINK
from antdsl.ground.mesh.walkers import (
    AgentWalk,
    ClearanceTables,
    FaceWalker,
    FootingArrays,
    NearbySurfaces,
    PieceTables,
    PoseArrays,
    SurfaceLanding,
    SurfaceTables,
    WalkProgress,
    WalkStop,
)  # fmt: skip
from antdsl.machine_code.kernels import called, fetch_ahead, independent, inlined, kernel
from antdsl.machine_code.kernels.types import BOOL, F64, I32, I64, U8, Array1, Array2, Strided2
from antdsl.numerics.kernel_vectors import AgentPose, TriangleWeights, Vec3, of, put_vector
from antdsl.numerics.kernel_vectors import clamp_weights as _inside
from antdsl.numerics.parallel import buffer_index

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
    OVER_BORDER_ROW,
    EVENT_LENGTH_ROW,
    BODY_SIZE_ROW,
    FLOAT_ROW_COUNT,
) = range(13)
AGENT_ROW, FACE_ROW, CROSSINGS_ROW, HOPS_ROW, BLOCKED_ROW, IS_NEAR_ROW, EVENT_ROW, EDGE_ROW, INTEGER_ROW_COUNT = range(9)
LEFT_OUT_STATUS, FINISHED_STATUS, WAITING_STATUS = range(
    3
)  # state of an agent after the first loop; other callers leave agents out, for `walk_all`
PREFETCH_EIGHTS = 2  # groups of eight agents by which prefetches are ahead
PREFETCH_GROUP_SIZE = 64  # agents with rows prefetched together: as many as fit into the first-level cache


@inlined
def prefetch_faces(surface: SurfaceTables, mesh: Array1[I32], face: Array1[I32], begin: I64, end: I64) -> None:
    """Prefetch the rows of the faces that agents `begin` to `end` (exclusive) stand on."""
    table, first = surface.table, surface.first
    for i in independent(begin, end):
        if mesh[i] >= 0:
            row = ROW_FLOATS * (first[mesh[i]] + face[i])
            fetch_ahead(table, row)
            fetch_ahead(table, row + 8)
            fetch_ahead(table, row + 16)
            fetch_ahead(table, row + 24)
            fetch_ahead(table, row + 32)


@inlined
def walk_agent(
    surface: SurfaceTables,
    near: ClearanceTables,
    along_open: BOOL,
    f: I64,
    weights: TriangleWeights,
    over: F64,
    size: F64,
    wish: Vec3,
    heading: Vec3,
    up: Vec3,
) -> AgentWalk:
    """Walk an agent over face `f` and the faces beyond its edges. It starts at `weights`, at height `over` the face.

    The result is that of `walk_stretches`. With `along_open`, the agent follows open borders."""
    axis1, axis2, normal = frame(surface.table, ROW_FLOATS * f)
    along_up = up[0] * normal[0] + up[1] * normal[1] + up[2] * normal[2]
    side = -1.0 if along_up < 0 else 1.0
    over = over * side
    weights = _inside(weights[0] + 0.0, weights[1] + 0.0)
    c, s, left = lay_on_face(axis1, axis2, wish[0], wish[1], wish[2], 1.0, 0.0)
    heading_c, heading_s, _ = lay_on_face(axis1, axis2, heading[0], heading[1], heading[2], c, s)
    high = _search_margin(near.noise, size)
    if not free_distance(near, f, weights) <= left + high:
        high = -np.inf  # no search is needed on the complete path
    walker, progress = FaceWalker(f, weights, side, (c, s), (heading_c, heading_s)), WalkProgress(left, 0.0, 0)
    if over != 0 and left > 0:
        stop = WalkStop(OVERHANG_EVENT, 0, 0.0, 0)
    else:
        walker, progress, stop = walk_stretches(surface, near, high, False, along_open, walker, progress)
        if stop.hops > 0:
            over = 0.0
    return AgentWalk(high, over, walker, progress, stop)


@inlined
def compact_waiting(how: Array1[U8], reals: Array2[F64], wholes: Array2[I64], begin: I64, end: I64) -> tuple[I64, I64]:
    """Return how many of the agents `begin` to `end` (exclusive) wait, and how many are left out.

    The columns of `reals` and `wholes` of waiting agents are moved together, from column `begin` on."""
    waiting, left = 0, 0
    for k in range(begin, end):
        if how[k] == WAITING_STATUS:
            for row in range(0, FLOAT_ROW_COUNT):
                reals[row, begin + waiting] = reals[row, k]
            for row in range(0, INTEGER_ROW_COUNT):
                wholes[row, begin + waiting] = wholes[row, k]
            waiting += 1
        elif how[k] == LEFT_OUT_STATUS:
            left += 1
    return waiting, left


@kernel
def walk_all(
    surface: SurfaceTables,
    near: ClearanceTables,
    at: FootingArrays,
    body: Array1[F64],
    vectors: tuple[Array2[F64], Array2[F64], Array2[F64]],
    reals: Array2[F64],
    wholes: Array2[I64],
    how: Array1[U8],
    placed: FootingArrays,
    moved: PoseArrays,
    begin: I64,
    end: I64,
) -> tuple[I64, I64, I64]:
    """Make one step of agents `begin` to `end` (exclusive).

    - `at`: where agents stand; an agent that is nowhere, or has weights that are not finite, is nowhere afterwards
    - `vectors`: wish, heading and up (3, n); a wish that is not finite counts as zero
    - `how`: written for each agent: whether it has been moved (FINISHED_STATUS) or waits (WAITING_STATUS)
    - `reals`, `wholes` (.., n): the waiting agents, from column `begin` on
    - `placed`, `moved`: the results

    Returns `begin`, how many agents wait, and how many are left out (0 in this function)."""
    mesh, face, b1s, b2s, overs = at
    first = surface.first
    wish, heading, up = vectors
    for start in range(begin, end, PREFETCH_GROUP_SIZE):
        last = min(start + PREFETCH_GROUP_SIZE, end)
        prefetch_faces(surface, mesh, face, start, last)
        for i in independent(start, last):
            how[i] = FINISHED_STATUS
            step, look, above_it = of(wish, i), of(heading, i), of(up, i)
            if mesh[i] < 0 or face[i] < 0 or not np.isfinite(b1s[i] + b2s[i] + overs[i]):
                placed.mesh[i], placed.face[i], moved.travelled[i] = -1, -1, 0.0
                placed.b1[i], placed.b2[i], placed.over[i] = 0.0, 0.0, 0.0
                _store_pose(moved, i, AgentPose((0.0, 0.0, 0.0), above_it, look, look))
                continue
            f, weights = first[mesh[i]] + face[i], (b1s[i], b2s[i])
            walk = walk_agent(surface, near, False, f, weights, overs[i], body[i], step, look, above_it)
            if walk.stop.event:
                how[i] = WAITING_STATUS
                store_waiting(reals, wholes, i, body[i], walk)
                continue
            # No edge leads to another mesh.
            store_footing(placed, i, mesh[i], walk.walker.face - first[mesh[i]], walk.over, walk.walker)
            moved.travelled[i] = walk.progress.travelled
            _store_pose(moved, i, final_pose(surface.table, walk.walker, walk.over))
    waiting, left = compact_waiting(how, reals, wholes, begin, end)
    return begin, waiting, left


@kernel
def continue_walks(
    surface: SurfaceTables,
    near: ClearanceTables,
    known: PieceTables,
    straight: BOOL,
    reals: Strided2[F64],
    wholes: Strided2[I64],
    how: Array1[U8],
    placed: FootingArrays,
    moved: PoseArrays,
    blocked: Array1[BOOL],
    begin: I64,
    end: I64,
) -> None:
    """Complete the step of waiting agents `begin` to `end` (exclusive). With `straight`, paths end at open borders."""
    table, first, boxes = surface.table, surface.first, known.boxes
    face_list = FaceList(known.buffer, buffer_index(begin, known.count, known.buffer_count) * boxes.order.size)
    around = NearbySurfaces(known.sides, boxes, known.lengths, face_list)
    for k in range(begin, end):
        i = wholes[AGENT_ROW, k]
        size = reals[BODY_SIZE_ROW, k]
        high = _search_margin(near.noise, size) if wholes[IS_NEAR_ROW, k] != 0 else -np.inf
        f, b1, b2, side, over = (
            wholes[FACE_ROW, k],
            reals[WEIGHT1_ROW, k],
            reals[WEIGHT2_ROW, k],
            reals[SIDE_ROW, k],
            reals[OVER_BORDER_ROW, k],
        )
        walker = FaceWalker(
            f,
            (b1, b2),
            side,
            (reals[DIRECTION_COSINE_ROW, k], reals[DIRECTION_SINE_ROW, k]),
            (reals[HEADING_COSINE_ROW, k], reals[HEADING_SINE_ROW, k]),
        )
        left, distance, turn, looked = reals[REMAINING_ROW, k], reals[TRAVELLED_ROW, k], wholes[CROSSINGS_ROW, k], False
        event, edge, length = wholes[EVENT_ROW, k], wholes[EDGE_ROW, k], reals[EVENT_LENGTH_ROW, k]
        while event:
            to = SurfaceLanding(-1, (0.0, 0.0), walker.side, 0.0, 0.0, False)
            if event == LOOK_AHEAD_EVENT:
                looked = True
                if length > 0:
                    to = to._replace(distance=length)
                    if known.cuts.first[walker.face + 1] > known.cuts.first[walker.face]:
                        to = find_crossing(surface, around, known.cuts, walker, length)
                    nearer = find_piece_ahead(table, around, size, walker, left, to.distance)
                    if nearer.face >= 0:
                        to = nearer
                if to.face >= 0:
                    looked = False
                    turn += 1
            elif event == OVERHANG_EVENT:
                edge, outward = _open_border(table, surface.link, walker)
                if outward:
                    event = BORDER_EVENT
                    turn -= 1  # only `walk_stretches` counts this crossing
                else:
                    over, left, distance = _climb_border(over, 0.0, left, distance)
                    if over != 0:
                        left = 0.0
            if event == BORDER_EVENT:
                turn += 1
                to = look_beyond_border(table, around, size, edge, walker)
                over, left, distance = _climb_border(over, to.height, left, distance)
                if to.face < 0 and over == to.height:
                    row = ROW_FLOATS * walker.face + EDGES_OFFSET + 4 * edge
                    (c, s), left = along_border((table[row + EDGE_COSINE], table[row + EDGE_SINE]), walker.direction, left)
                    walker = walker._replace(direction=(c, s))
                    wholes[BLOCKED_ROW, k] = 1
                    wholes[HOPS_ROW, k] += 1
                    if straight or wholes[HOPS_ROW, k] >= MAX_SURFACE_HOPS:
                        left = 0.0
                elif to.face < 0 or over != to.height or not left >= to.distance:
                    if distance == 0:
                        wholes[BLOCKED_ROW, k] = 1
                    to, left = to._replace(face=-1), 0.0
                else:
                    over = 0.0
                    wholes[IS_NEAR_ROW, k] = 1
                    high = _search_margin(near.noise, size)
            if to.face >= 0:
                direction, heading = turn_to_face(table, walker, to.face, to.side)
                walker = FaceWalker(to.face, to.weights, to.side, direction, heading)
                left = max(left - to.distance, 0.0)
                distance += to.distance
                wholes[HOPS_ROW, k] += 1
                if to.stops or wholes[HOPS_ROW, k] >= MAX_SURFACE_HOPS:
                    left = 0.0
                    wholes[BLOCKED_ROW, k] = 1
            walker, progress, stop = walk_stretches(
                surface, near, high, looked, False, walker, WalkProgress(left, distance, turn)
            )
            left, distance, turn = progress
            event, edge, length, _ = stop
            looked = False
        how[i] = FINISHED_STATUS
        mesh = int(table[ROW_FLOATS * walker.face + MESH_OFFSET])
        store_footing(placed, i, mesh, walker.face - first[mesh], over, walker)
        moved.travelled[i], blocked[i] = distance, wholes[BLOCKED_ROW, k] != 0
        _store_pose(moved, i, final_pose(table, walker, over))


@inlined
def store_footing(placed: FootingArrays, i: I64, mesh: I64, face: I64, over: F64, walker: FaceWalker) -> None:
    """Write the footing of agent `i` after a walk: on a face of a mesh, at height `over` the face on the agent's side."""
    placed.mesh[i], placed.face[i], placed.over[i] = mesh, face, over * walker.side + 0.0
    placed.b1[i], placed.b2[i] = walker.weights


@inlined
def _store_pose(moved: PoseArrays, i: I64, pose: AgentPose) -> None:
    put_vector(moved.place, i, pose.place)
    put_vector(moved.up, i, pose.up)
    put_vector(moved.heading, i, pose.heading)
    put_vector(moved.direction, i, pose.direction)


@inlined
def _search_margin(noise: F64, body: F64) -> F64:
    """Return the distance (mm) from the path within which a piece of surface matters."""
    high = EYE_HEIGHT_PER_BODY * body
    if not high > noise:
        high = noise
    return high + noise


@called
def store_waiting(reals: Array2[F64], wholes: Array2[I64], i: I64, body: F64, walk: AgentWalk) -> None:
    """Record an agent that waits. If it has followed borders, their number and the fact that it is blocked are recorded too."""
    high, over, walker, progress, stop = walk
    wholes[AGENT_ROW, i], wholes[HOPS_ROW, i], wholes[BLOCKED_ROW, i], wholes[IS_NEAR_ROW, i] = (
        i,
        stop.hops,
        stop.hops > 0,
        high > 0,
    )
    reals[BODY_SIZE_ROW, i], reals[SIDE_ROW, i], reals[OVER_BORDER_ROW, i], reals[EVENT_LENGTH_ROW, i] = (
        body,
        walker.side,
        over,
        stop.length,
    )
    reals[WEIGHT1_ROW, i], reals[WEIGHT2_ROW, i] = walker.weights
    reals[DIRECTION_COSINE_ROW, i], reals[DIRECTION_SINE_ROW, i] = walker.direction
    reals[HEADING_COSINE_ROW, i], reals[HEADING_SINE_ROW, i] = walker.heading
    reals[REMAINING_ROW, i], reals[TRAVELLED_ROW, i], wholes[CROSSINGS_ROW, i] = progress
    wholes[FACE_ROW, i], wholes[EVENT_ROW, i], wholes[EDGE_ROW, i] = walker.face, stop.event, stop.edge


@inlined
def _climb_border(over: F64, level: F64, left: F64, distance: F64) -> tuple[F64, F64, F64]:
    """Move up or down over a border to a level (mm above the current face), limited by the distance left.

    Returns the new height, and the distance left and travelled."""
    most = level - over
    climb = min(abs(most), left)
    to = level if climb >= abs(most) else over + (-climb if most < 0 else climb)
    return to, left - climb, distance + climb


@inlined
def _open_border(table: Array1[F64], link: Array2[I32], walker: FaceWalker) -> tuple[I64, BOOL]:
    """Return the open border that an agent is stepping over, and whether it heads out over it."""
    f, (b1, b2), side, (c, s), _ = walker
    weights, edge, least = (1.0 - b1 - b2, b1, b2), 0, np.inf
    for k in range(3):
        if link[1 if side < 0 else 0, 3 * f + k] == NO_LINK and weights[k] < least:
            edge, least = k, weights[k]
    row = ROW_FLOATS * f + EDGES_OFFSET + 4 * edge
    return edge, c * table[row + EDGE_SINE] - s * table[row + EDGE_COSINE] > 0
