"""Creates the flows and maps of a setting on the ground: points at the requested resolution, and the values at these points."""

from __future__ import annotations

from copy import copy
from functools import partial
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.casting.curves import resample_curve
from antdsl.diagnostics import Report
from antdsl.fields.face_points import FaceLattice, LatticeTooFineError, choose_cell_size, choose_edge_pieces, weld_points
from antdsl.fields.flow import (
    PaintedMap,
    SurfaceFlow,
    VectorFunction,
    compute_falloff,
    find_nearest_on_target,
    make_spread_source,
    project_to_faces,
)
from antdsl.fields.path_cost import WalkableSurface
from antdsl.fields.path_flow import CrossableGround, PathFlow, limit_cost_from_below
from antdsl.ground.protocol import Flags, Floats, Index, MeshSurfaces
from antdsl.runtime.binding.binding_cache import BindingCache
from antdsl.runtime.binding.border_edges import find_border_edges
from antdsl.runtime.moving.obstacles import get_obstacle_scene
from antdsl.scene.setting import BorderFlowData, FlowData, FlowTarget, PaintedValues, SolvedFlowData, SpreadFlowData

if TYPE_CHECKING:
    from antdsl.runtime.world import World

_CLEARANCE_COST_FACTOR = 8.0  # cost of a mm next to an obstacle, relative to open ground
_MAX_BURIED_SHARE_OF_VOXEL = 0.05  # ground buried deeper in a solid cannot be crossed
_RAY_HEIGHT_PER_EDGE = 0.25  # height of obstacle rays above the ground, as a share of the edge


def bind_flows(world: World, report: Report, binding_cache: BindingCache) -> None:
    """Create all maps and flows of the setting that the plan uses. Flows that never change are cached in `binding_cache`."""
    setting = world.setting
    for name, painted in setting.maps.items():
        world.maps[name] = PaintedMap(_collect_corner_values(world, painted)[:, :, 0])
    land = (setting.surfaces, setting.obstacles, setting.maps, setting.up, setting.uses_rays, world.origin)
    for name, flow in setting.flows.items():
        if isinstance(flow, SolvedFlowData) or world.solids or setting.motion:
            bind_one_flow(world, name, flow, report)
            continue
        bound_flow = binding_cache.get_or_compute("flow", (land, flow), partial(_get_cached_flow, world, name, flow))
        if bound_flow is None:
            bind_one_flow(world, name, flow, report)  # reports errors
        else:
            world.flows[name] = copy(bound_flow)


def _get_cached_flow(world: World, name: str, flow: FlowData) -> SurfaceFlow | None:
    """Return a bound flow that can be cached. None if binding reports an error."""
    bind_one_flow(world, name, flow, Report())
    return world.flows.get(name)


def bind_one_flow(world: World, name: str, flow: FlowData, report: Report) -> None:
    """Create one flow, and add it to the world under its name. Add errors to the report."""
    try:
        world.flows[name] = bound_flow = _make_flow(world, flow)
        if not isinstance(flow, PaintedValues) and _may_flow_change(world, flow):
            bound_flow.update_after_motion = lambda current_world: _recompute_flow(current_world, bound_flow, flow)
    except LatticeTooFineError as error:
        report.error(
            "flow-too-fine",
            f"flow `{name}` would have about {error.needed:,} points; at most {limits.MAX_FLOW_POINTS:,} are allowed",
            world.setting.spans.get(name),
            "write a larger `cell` or a smaller `radius` for the flow",
        )


def _make_flow(world: World, flow: FlowData) -> SurfaceFlow:
    if isinstance(flow, PaintedValues):
        return _make_painted_flow(world, flow)
    if isinstance(flow, SpreadFlowData):
        return _make_spread_flow(world, flow)
    return _make_border_flow(world, flow) if isinstance(flow, BorderFlowData) else _make_solved_flow(world, flow)


# --- what moves ------------------------------------------------------------------------------------------------------


def _may_flow_change(world: World, flow: SpreadFlowData | BorderFlowData | SolvedFlowData) -> bool:
    """Return whether any input of a flow may move: surfaces, the target, or obstacles that paths avoid."""
    moves = world.setting.motion
    moving = [name for name in moves.meshes if name in world.setting.surfaces or isinstance(flow, SolvedFlowData)]
    dug = bool(world.solids) and isinstance(flow, SolvedFlowData)
    return bool(moving) or dug or (not isinstance(flow, BorderFlowData) and flow.target.name in {**moves.items, **moves.curves})


def _recompute_flow(world: World, bound_flow: SurfaceFlow, flow: SpreadFlowData | BorderFlowData | SolvedFlowData) -> None:
    """Replace the values of a flow by values for the current positions of its inputs."""
    if isinstance(flow, SolvedFlowData):
        assert isinstance(bound_flow, PathFlow) and bound_flow.crossable_ground is not None
        known = bound_flow.crossable_ground
        bound_flow.crossable_ground = ground = _make_crossable_ground(
            world, bound_flow.lattice, known.is_crossable_face, known.slot_points
        )
        bound_flow.cost = _compute_triangle_costs(world, flow, ground)
        bound_flow.start_points, bound_flow.start_costs, bound_flow.target_gap = _find_goal_points(world, flow, ground)
        return
    now = _make_flow(world, flow)
    bound_flow.lattice, bound_flow.axis1_components = now.lattice, now.axis1_components
    bound_flow.axis2_components, bound_flow.compute_vectors = now.axis2_components, now.compute_vectors


def _get_ground_meshes(world: World) -> MeshSurfaces:
    """Return the meshes of the ground, on which flows are defined."""
    meshes = world.ground.meshes
    assert meshes is not None
    return meshes


# --- painted ---------------------------------------------------------------------------------------------------------


def _collect_corner_values(world: World, painted_values: PaintedValues) -> Floats:
    """Return painted values at the corners of all ground faces, (3, faces, width). They are 0 on unpainted surfaces."""
    _, faces, mesh, _ = _get_ground_meshes(world).triangles
    own = np.flatnonzero(mesh == world.surface_index[painted_values.surface])
    values = painted_values.values.reshape(len(painted_values.values), -1)
    corner_values = np.zeros((3, len(faces), values.shape[1]))
    local = world.setting.surfaces[painted_values.surface].faces
    for k in range(3):
        corner_values[k, own] = values if painted_values.is_per_face else values[local[:, k]]
    return corner_values


def _make_painted_flow(world: World, painted_values: PaintedValues) -> SurfaceFlow:
    """Return a flow that interpolates the painted vectors."""
    table = _get_ground_meshes(world).triangles[3]
    corners = _collect_corner_values(world, painted_values)
    parts = [project_to_faces(corners[k], table.axis1, table.axis2) for k in range(3)]
    c, s = (np.stack([part[k] for part in parts], axis=1).ravel() for k in range(2))
    return SurfaceFlow(FaceLattice.from_edge_pieces(np.ones(corners.shape[1], np.int64)), c, s)


# --- points over the ground ------------------------------------------------------------------------------------------


def _select_faces_of_surfaces(world: World, surfaces: tuple[str, ...]) -> Flags:
    """Return a mask of the faces of the surfaces `surfaces`, without faces of area 0."""
    _, _, mesh, table = _get_ground_meshes(world).triangles
    mesh_numbers = [world.surface_index[name] for name in surfaces] or list(world.surface_index.values())
    chosen: Flags = table.is_live & np.isin(mesh, mesh_numbers)
    return chosen


def _measure_longest_edges(world: World) -> tuple[Floats, Floats]:
    """Return the length of the longest edge (mm), and the centre (n, 3; mm), of each ground face."""
    vertices, faces, _, _ = _get_ground_meshes(world).triangles
    corners = vertices[faces]
    edges = np.stack([corners[:, (k + 1) % 3] - corners[:, k] for k in range(3)])
    return np.sqrt((edges * edges).sum(axis=2)).max(axis=0), corners.mean(axis=1)


def _make_flow_lattice(world: World, is_chosen: Flags, flow: SpreadFlowData | BorderFlowData | SolvedFlowData) -> FaceLattice:
    """Return a lattice on the selected faces, at the flow's resolution. Raises LatticeTooFine if the flow's cells are too
    small."""
    edges = np.where(is_chosen, _measure_longest_edges(world)[0], 0.0)
    return FaceLattice.from_edge_pieces(choose_edge_pieces(flow, edges, _get_ground_meshes(world).extent))


def _find_slot_positions(world: World, lattice: FaceLattice) -> tuple[Index, Floats]:
    """Return the face and the position (n, 3; mm) of each slot of a lattice."""
    table = _get_ground_meshes(world).triangles[3]
    face = lattice.get_face_by_slot()
    b1, b2 = lattice.compute_slot_weights()
    place = table.corner.take(face, axis=1) + b1 * table.edge1.take(face, axis=1) + b2 * table.edge2.take(face, axis=1)
    return face, np.ascontiguousarray(place.T)


def _make_vector_flow(
    world: World, lattice: FaceLattice, face: Index, vectors: Floats, is_chosen: Flags, source: VectorFunction | None = None
) -> SurfaceFlow:
    table = _get_ground_meshes(world).triangles[3]
    c, s = project_to_faces(vectors, table.axis1.take(face, axis=1), table.axis2.take(face, axis=1))
    return SurfaceFlow(lattice, c * is_chosen[face], s * is_chosen[face], source)


def _locate_target(world: World, target: FlowTarget) -> FlowTarget:
    """Return the target with its position in the current frame, relative to the world's origin."""
    moves = world.setting.motion
    tracks = (moves.curves if target.is_line else moves.items).get(target.name)
    positions = target.positions if tracks is None else moves.find_positions(tracks, world.frame)
    if tracks is not None and target.item_index is not None:
        positions = positions[target.item_index : target.item_index + 1]
    return FlowTarget(positions - world.origin, target.radii, target.is_line)


# --- about a target, and at borders ----------------------------------------------------------------------------------


def _make_spread_flow(world: World, flow: SpreadFlowData) -> SurfaceFlow:
    target = _locate_target(world, flow.target)
    source = make_spread_source(flow, target)
    if world.ground.meshes is None:
        return SurfaceFlow(FaceLattice.from_edge_pieces(np.ones(0, np.int64)), np.zeros(0), np.zeros(0), source)
    chosen = near = _select_faces_of_surfaces(world, flow.surfaces)
    if flow.radius is not None:
        longest, middle = _measure_longest_edges(world)
        near = chosen & (find_nearest_on_target(target, middle)[0] <= flow.radius + longest)
    lattice = _make_flow_lattice(world, near, flow)
    face, place = _find_slot_positions(world, lattice)
    vectors = np.zeros_like(place)
    near_slots = np.flatnonzero(near[face])
    vectors[near_slots] = source(place[near_slots])
    return _make_vector_flow(world, lattice, face, vectors, chosen, source if not flow.surfaces else None)


def _make_border_flow(world: World, flow: BorderFlowData) -> SurfaceFlow:
    chosen = _select_faces_of_surfaces(world, flow.surfaces)
    one, two, inward = find_border_edges(_get_ground_meshes(world), chosen)
    edge = two - one
    length = np.sqrt((edge * edge).sum(axis=1))
    longest, middle = _measure_longest_edges(world)
    cell = choose_cell_size(flow, _get_ground_meshes(world).extent)
    pieces = np.clip(np.ceil(2 * length / cell), 1, 4096).astype(np.int64)
    which = np.repeat(np.arange(len(edge)), pieces)
    part = (np.arange(len(which)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[which]
    rim = one[which] + part[:, None] * edge[which]
    near = chosen.copy()
    target = FlowTarget(rim, np.zeros(len(rim)))
    if len(rim):
        near &= find_nearest_on_target(target, middle)[0] <= flow.max_distance + longest
    lattice = _make_flow_lattice(world, near, flow)
    face, place = _find_slot_positions(world, lattice)
    vectors = np.zeros_like(place)
    near_slots = np.flatnonzero(near[face]) if len(rim) else np.empty(0, np.int64)
    if len(near_slots):
        from scipy.spatial import cKDTree

        sample = cKDTree(rim).query(place[near_slots])[1]
        line = which[sample]
        along = ((place[near_slots] - one[line]) * edge[line]).sum(axis=1) / np.maximum(length[line], 1e-12) ** 2
        direction = place[near_slots] - (one[line] + np.clip(along, 0.0, 1.0)[:, None] * edge[line])
        distance = np.sqrt((direction * direction).sum(axis=1))
        direction += 0.5 * cell * inward[line]
        direction /= np.maximum(np.sqrt((direction * direction).sum(axis=1)), 1e-12)[:, None]
        vectors[near_slots] = direction * (compute_falloff(distance, flow.max_distance, flow.falloff) * flow.strength)[:, None]
    return _make_vector_flow(world, lattice, face, vectors, chosen)


# --- solved ----------------------------------------------------------------------------------------------------------


def _make_solved_flow(world: World, flow: SolvedFlowData) -> SurfaceFlow:
    chosen = _select_faces_of_surfaces(world, flow.surfaces)
    lattice = _make_flow_lattice(world, chosen, flow)
    grounds = _make_crossable_ground(world, lattice, chosen)
    start, first, gap = _find_goal_points(world, flow, grounds)
    every = max(1, ceil(flow.interval / world.dt - 1e-9))
    changes = bool(flow.crowding or world.setting.motion)
    looked = [_list_solid_versions(world)]

    def is_update_due(current_world: World) -> bool:
        """Return whether it is time for a new solution, and its inputs have changed."""
        if (current_world.frame - current_world.setting.first_frame) % every:
            return False
        previous_state, looked[0] = looked[0], _list_solid_versions(current_world)
        return changes or looked[0] != previous_state

    solved_flow = PathFlow(
        lattice, np.zeros(0), np.zeros(0), None,
        crossable_ground=grounds, cost=_compute_triangle_costs(world, flow, grounds), start_points=start, start_costs=first,
        target_gap=gap, strength=flow.strength, crowd_cost=flow.crowding, update_interval=every, is_update_due=is_update_due,
        crowd_coverage=np.zeros(len(grounds.surface.points), np.int64) if flow.crowding else None,
        stores_reachability=any(node.op == "flow.reachable" for node in world.plan.nodes),
    )  # fmt: skip
    solved_flow.recompute_flow()
    return solved_flow


def _list_solid_versions(world: World) -> list[int]:
    """Return one number per solid, which changes whenever the solid is dug."""
    return [volume.bricks.volume_steps for volume in world.solids.values()]


def _make_crossable_ground(world: World, lattice: FaceLattice, is_chosen: Flags, point: Index | None = None) -> CrossableGround:
    """Return the ground on which paths run, for a lattice: merged points, open triangles, and links between surfaces. A triangle
    is open if no obstacle cuts it and it is not inside undug solid. `point`: the point of each slot, if already known."""
    _, _, mesh, table = _get_ground_meshes(world).triangles
    face, place = _find_slot_positions(world, lattice)
    if point is None:
        point = weld_points(place, mesh[face])[0]
    count = int(point.max(initial=-1)) + 1
    points = np.empty((count, 3))
    points[point] = place
    small, owner = lattice.compute_triangles()
    triangles = point[small]
    a, b, c = (points[triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    areas = np.sqrt((across * across).sum(axis=1)) / 2
    open_ = is_chosen[owner] & (areas > 0) & ~_find_blocked_triangles(world, triangles, points, table.normal.T[owner])
    for volume in world.solids.values():
        open_ &= ~(volume.sample_distances(points) < -_MAX_BURIED_SHARE_OF_VOXEL * volume.voxel)[triangles].any(axis=1)
    of = np.empty(count, np.int32)
    of[point] = mesh[face]
    land = WalkableSurface(points, triangles, open_, _link_points_across_surfaces(points, of, np.unique(triangles[open_]), areas))
    axis1, axis2 = table.axis1.take(face, axis=1), table.axis2.take(face, axis=1)
    return CrossableGround(lattice, land, point, axis1, axis2, areas, is_chosen)


def _find_blocked_triangles(world: World, triangles: Index, points: Floats, normal: Floats) -> Flags:
    """Return the triangles that have an edge which hits an obstacle. Edges are tested slightly above the ground."""
    cut = np.zeros(len(triangles), bool)
    for name in world.plan.obstacles:
        if name not in world.obstacles:
            continue
        scene = get_obstacle_scene(world, name)
        for k in range(3):
            start, end = points[triangles[:, k]], points[triangles[:, (k + 1) % 3]]
            step = end - start
            lift = _RAY_HEIGHT_PER_EDGE * np.sqrt((step * step).sum(axis=1))[:, None] * normal
            cut[scene.find_hits_along_step(start + lift, step)[0]] = True
            cut[scene.find_hits_along_step(end + lift, -step)[0]] = True
    return cut


def _link_points_across_surfaces(points: Floats, surface_numbers: NDArray[np.int32], used_points: Index, areas: Floats) -> Index:
    """Return pairs (k, 2) of points that are on different surfaces and near each other."""
    from scipy.spatial import cKDTree

    surfaces = np.unique(surface_numbers[used_points])
    reach = 2.0 * float(np.sqrt(np.median(areas))) if len(areas) else 0.0
    pairs = [np.empty((0, 2), np.int64)]
    for one in surfaces:
        mine, others = used_points[surface_numbers[used_points] == one], used_points[surface_numbers[used_points] > one]
        if len(mine) and len(others):
            distance, nearest_one = cKDTree(points[mine]).query(points[others], distance_upper_bound=reach)
            close = np.isfinite(distance)
            pairs.append(np.stack([others[close], mine[nearest_one[close]]], axis=1))
    return np.concatenate(pairs)


def _find_goal_points(world: World, flow: SolvedFlowData, grounds: CrossableGround) -> tuple[Index, Floats, float]:
    """Return the points at the target, their remaining distances to it (mm), and the gap (mm) between target and ground.

    Points at the target are within its radius, or nearest to one of its positions. The gap is the least distance of such a
    position from a point, minus the radius."""
    from scipy.spatial import cKDTree

    land = grounds.surface
    used = np.unique(land.triangles[land.is_walkable])
    if not len(used):
        return used, np.zeros(0), 0.0
    target = _locate_target(world, flow.target)
    positions, radii = target.positions, target.radii
    side = float(np.sqrt(np.median(grounds.triangle_areas[land.is_walkable])))
    if target.is_line:
        positions = resample_curve(positions, side)
        radii = np.zeros(len(positions))
    tree = cKDTree(land.points[used])
    distance, away_by = np.full(len(used), np.inf), np.inf if len(positions) else 0.0
    for place, radius in zip(positions, radii, strict=True):
        gap, least = tree.query(place)
        away_by = min(away_by, max(0.0, float(gap - radius)))
        near = np.asarray(tree.query_ball_point(place, max(radius, gap + 1.5 * side)), np.int64)
        near = np.append(near, least)
        away = land.points[used[near]] - place
        left = np.maximum(np.sqrt((away * away).sum(axis=1)) - max(radius, gap), 0.0)
        distance[near] = np.minimum(distance[near], left)
    at = np.flatnonzero(np.isfinite(distance))
    return used[at], distance[at], away_by


def _compute_triangle_costs(world: World, flow: SolvedFlowData, grounds: CrossableGround) -> Floats:
    """Return the cost of a path within each triangle, per mm, without the cost of agents in the way."""
    land = grounds.surface
    _, owner = grounds.lattice.compute_triangles()
    normal = _get_ground_meshes(world).triangles[3].normal.T[owner]
    upright = np.abs((normal * world.up).sum(axis=1))
    price = 1.0 + flow.slope * np.sqrt(np.maximum(1 - upright * upright, 0.0))
    middle = land.points[land.triangles].mean(axis=1)
    if flow.clearance > 0:
        x, y, z = middle.T.astype(np.float32)
        gap = np.full(len(middle), np.inf)
        for name in world.plan.obstacles:
            if name in world.obstacles:
                gap = np.minimum(gap, world.obstacles[name].find_nearest_within(x, y, z, flow.clearance).t)
        tight = np.clip(1 - gap / flow.clearance, 0.0, 1.0)
        price = price + _CLEARANCE_COST_FACTOR * tight * tight
    if flow.maps:
        b1, b2 = grounds.lattice.compute_slot_weights()
        small, _ = grounds.lattice.compute_triangles()
        b1, b2 = b1[small].mean(axis=1), b2[small].mean(axis=1)
        for name, factor in flow.maps.items():
            one, two, three = (corner.take(owner) for corner in world.maps[name].corner_values)
            price = price + factor * (one * (1 - b1 - b2) + two * b1 + three * b2)
    return limit_cost_from_below(price)
