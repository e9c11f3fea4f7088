"""The random start positions of the agents of a crowd line. Each depends only on (seed, species, id, number of the try)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import elementary, randomness
from antdsl.numerics import vectors as vec
from antdsl.runtime.binding.spacing import StartPositionCandidates
from antdsl.runtime.binding.start_shapes import (
    FULL_TURN,
    draw_points_in_disc,
    draw_shape_points,
    has_placement_shape,
    resolve_placement,
)
from antdsl.runtime.binding.surface_area import SampledFaceArea, collect_face_area
from antdsl.runtime.moving.obstacles import get_obstacle_scene
from antdsl.runtime.world import World
from antdsl.scene.setting import CrowdData, MeshData

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

PLACEMENT_FRAME = 0  # random draws of placement use no frame
MAX_RANDOM_COVERED_SHARE = 0.42  # up to this cover, randomly placed agents all find space without touching
_AREA_SAMPLE_COUNT = 1 << 14  # sample points to measure the area where agents can start
_COINCIDENT_DISTANCE_MM = 1e-3  # mm
_MAX_RADIUS_TRIES = 8  # maximum number of tried radii
_DEFAULT_DISC_RADIUS_MM = 100.0  # mm: without ground and without a radius


class StartPositionSampler:
    """The source of start positions for the agents of one crowd line."""

    def __init__(self, world: World, crowd: CrowdData) -> None:
        self._world, self._crowd, self._species, self.place = world, crowd, crowd.species, resolve_placement(world, crowd.place)
        self.has_points = (crowd.place.points is not None and len(crowd.place.points) > 0) or crowd.place.ranks is not None
        setting = world.setting
        self._get_ground_meshes = {**setting.surfaces, **{name: solid.mesh for name, solid in setting.solids.items()}}
        self._surface_names = crowd.place.surfaces or tuple(setting.surfaces) or tuple(self._get_ground_meshes)
        self._faces: SampledFaceArea | None = None
        self._density_faces: SampledFaceArea | None = None
        if crowd.place.is_by_area and not self.has_points and self._get_ground_meshes:
            self._faces = collect_face_area(
                world, self._surface_names, crowd.place.density, self.place.disc_centre, crowd.place.radius
            )

    def estimate_area(self) -> float | None:
        """Return the ground area (mm²) on which agents can start; None if unknown. Estimates from samples have two digits."""
        place = self.place
        if self.has_points or has_placement_shape(place) or place.ray_origin is not None:
            return None
        if place.density is not None and not place.is_by_area:
            return None
        ids = np.arange(_AREA_SAMPLE_COUNT)
        drawn = self.draw_candidates(ids, range(1))
        good = drawn.is_allowed
        if self._faces is not None:
            total_area = self._faces.total_area
        elif place.disc_centre is not None or not self._get_ground_meshes:
            radius = _DEFAULT_DISC_RADIUS_MM if place.radius is None else place.radius
            total_area = float(np.pi * radius * radius)
        else:
            total_area = collect_face_area(self._world, self._surface_names, None, None, None).total_area
            # a point projected onto another face is covered from above
            displacement = drawn.position - self._find_target_points(ids, 0)
            good = good & (vec.length(vec.split_columns(displacement, np.float64)) < _COINCIDENT_DISTANCE_MM)
        share = float(np.count_nonzero(good)) / _AREA_SAMPLE_COUNT
        return total_area if share == 1 else float(f"{total_area * share:.1e}")

    def find_sufficient_radius(self, agent_area: float) -> float | None:
        """Return a radius (mm) of the place that suffices for agents that cover `agent_area` (mm²). None if there is none."""
        radius = self.place.radius
        for _ in range(_MAX_RADIUS_TRIES):
            if radius is None:
                break
            wider = StartPositionSampler(self._world, replace(self._crowd, place=replace(self.place, radius=radius)))
            area = wider.estimate_area()
            if area is None or area * MAX_RANDOM_COVERED_SHARE >= agent_area * 0.999:
                return radius if area is not None else None
            radius *= min(max(math.sqrt(agent_area / (MAX_RANDOM_COVERED_SHARE * area)), 1.01), 8.0) if area > 0 else 8.0
        return None

    def fits_unlimited_surface(self, agent_area: float) -> bool:
        """Return whether agents that cover `agent_area` (mm²) would fit on all sides of the surface, not only on its upper side.

        Always False unless the line starts agents anywhere on a surface, from above."""
        place = self.place
        if (
            self.has_points
            or has_placement_shape(place)
            or place.is_by_area
            or not place.surfaces
            or any((place.ray_origin, place.density, place.disc_centre, place.radius))
        ):
            return False
        wider = StartPositionSampler(self._world, replace(self._crowd, place=replace(place, is_by_area=True))).estimate_area()
        return wider is not None and wider * MAX_RANDOM_COVERED_SHARE >= agent_area

    def draw_candidates(self, ids: Ids, tries: range) -> StartPositionCandidates:
        """Return start positions for each try in `tries`: the positions of all agents for the first try, then for the next try,
        and so on."""
        world, place = self._world, self.place
        if has_placement_shape(place):
            return self._draw_by_shape(ids, tries)
        if place.ray_origin is not None and world.ground.meshes is not None:
            return self._draw_by_rays(np.asarray(place.ray_origin, np.float64) - world.origin, ids, tries)
        if self._faces is not None:
            return self._draw_by_area(self._faces, ids, tries)
        points = self._wrap_points_into_period([self._find_target_points(ids, attempt) for attempt in tries])
        if self.has_points and place.is_by_area:
            footing, has_ground = world.ground.find_nearest(points, place.surfaces or None)[0], np.ones(len(points), np.bool_)
            return StartPositionCandidates(footing, world.ground.position(footing), world.ground.normal(footing), has_ground)
        footing, has_ground = world.ground.place_points(points, world.up, place.surfaces or None)
        at = world.ground.position(footing)
        up = np.array(np.broadcast_to(world.up, at.shape))
        return StartPositionCandidates(
            footing, at, up, has_ground & ~is_inside_obstacle(world, at) if not self.has_points else has_ground
        )

    def _draw_by_shape(self, ids: Ids, tries: range) -> StartPositionCandidates:
        """Return positions of a shape, such as ranks, lines or clumps, dropped onto the ground below.

        For edges, volumes and areas, return the nearest points of the ground instead."""
        world, place = self._world, self.place
        points = self._wrap_points_into_period([self._find_shape_points(ids, attempt) for attempt in tries])
        has_ground = np.ones(len(points), np.bool_)
        if place.is_by_area or place.volume is not None or place.border_surface is not None:
            footing = world.ground.find_nearest(points, place.surfaces or None)[0]
            at, up = world.ground.position(footing), world.ground.normal(footing)
        else:
            footing, has_ground = world.ground.place_points(points, world.up, place.surfaces or None)
            at = world.ground.position(footing)
            up = np.array(np.broadcast_to(world.up, at.shape))
        is_allowed = has_ground if self.has_points else has_ground & ~is_inside_obstacle(world, at)
        return StartPositionCandidates(footing, at, up, is_allowed)

    def _wrap_points_into_period(self, point_sets: list[Floats]) -> Floats:
        """Concatenate sets of points (n, 3; mm). In a periodic world, move the points into its box."""
        points, periodic = np.concatenate(point_sets), self._world.periodic
        return points if periodic is None else periodic.box.wrap_points(points)

    def _find_shape_points(self, ids: Ids, attempt: int) -> Floats:
        """Return the positions (n, 3; mm) that the place defines. Agents of a clump start around a common position."""
        world, place = self._world, self.place
        numbers = world.crowd_lines[self._crowd.line_index].find_positions_in_line(ids)
        if place.clumps is None:
            return draw_shape_points(world, place, numbers, lambda k: self._draw_uniform_numbers(ids, 4 * attempt + k))
        clumps = numbers % place.clumps.number
        u, v = (self._draw_uniform_numbers(ids, 2 * attempt + k, "clump") for k in range(2))
        return self._find_clump_centres(clumps) + draw_points_in_disc(world, place.clumps.radius, u, v)

    def _find_clump_centres(self, clumps: Ids) -> Floats:
        site = f"clump centre {self._crowd.line_index}"
        place = replace(self.place, clumps=None)
        if has_placement_shape(place):
            return draw_shape_points(self._world, place, clumps, lambda k: self._draw_uniform_numbers(clumps, k, site))
        if self._faces is not None:
            return self._faces.draw_points(*(self._draw_uniform_numbers(clumps, k, site) for k in range(4)))[3]
        return self._find_target_points(clumps, 0, site)

    def _draw_uniform_numbers(self, ids: Ids, index: int, site: str = "place") -> NDArray[np.float32]:
        seed = self._world.setting.seed if self.place.seed is None else self.place.seed
        return randomness.draw_uniform(seed, PLACEMENT_FRAME, self._species, site, index, ids)

    def _find_target_points(self, ids: Ids, attempt: int, site: str = "place") -> Floats:
        """Return the positions (n, 3; mm) from which agents are dropped onto the ground."""
        world, place = self._world, self.place
        if place.points is not None and len(place.points):
            return np.asarray(place.points, np.float64)[ids % len(place.points)] - world.origin
        u, v, w = (self._draw_uniform_numbers(ids, 4 * attempt + k, site) for k in range(3))
        if place.disc_centre is not None or not self._get_ground_meshes:
            middle = np.zeros(3) if place.disc_centre is None else np.asarray(place.disc_centre, np.float64) - world.origin
            radius = _DEFAULT_DISC_RADIUS_MM if place.radius is None else place.radius
            return middle + draw_points_in_disc(world, radius, u, v)
        if place.density is not None:
            if self._density_faces is None:
                self._density_faces = collect_face_area(
                    world, place.surfaces or tuple(world.surface_index), place.density, None, None
                )
            return self._density_faces.draw_points(u, v, w, self._draw_uniform_numbers(ids, 4 * attempt + 3, site))[3]
        return _draw_points_on_faces([self._get_ground_meshes[name] for name in self._surface_names], u, v, w) - world.origin

    def _draw_by_area(self, faces: SampledFaceArea, ids: Ids, tries: range) -> StartPositionCandidates:
        """Return positions spread evenly over faces of any orientation. The up directions are the normals of the faces."""
        draws = [np.concatenate([self._draw_uniform_numbers(ids, 4 * attempt + k) for attempt in tries]) for k in range(4)]
        footing, up, can_stand = faces.draw_footings(*draws)
        at = self._world.ground.position(footing)
        return StartPositionCandidates(footing, at, up, can_stand & ~is_inside_obstacle(self._world, at))

    def _draw_by_rays(self, start: Floats, ids: Ids, tries: range) -> StartPositionCandidates:
        """Return the first hits of rays from `start` in random directions, with up directions towards `start`.

        If a ray hits no mesh that `on` permits, return the nearest surface point, marked as not allowed."""
        world, meshes = self._world, self._world.ground.meshes
        assert meshes is not None
        mesh_numbers = [meshes.names.index(name) for name in (self.place.surfaces or meshes.names) if name in meshes.names]
        far = meshes.extent * 1.8 + float(np.abs(start - (meshes.low + meshes.high) / 2).max())
        u, v = (
            np.concatenate([self._draw_uniform_numbers(ids, 2 * attempt + k, "inside") for attempt in tries]) for k in range(2)
        )
        height = 1.0 - 2.0 * u.astype(np.float64)  # directions evenly distributed on the sphere (Archimedes' hat-box theorem)
        flat, angle = np.sqrt(np.maximum(1.0 - height * height, 0.0)), v * FULL_TURN
        directions = np.stack([flat * elementary.cos(angle), height, flat * elementary.sin(angle)], axis=1)
        begin = np.broadcast_to(start, directions.shape)
        has_hit, part, footing = meshes.find_path_hits(begin, directions * far)
        good = has_hit & np.isin(footing.mesh, mesh_numbers)
        at = np.where(good[:, None], begin + directions * (far * part)[:, None], begin)
        good &= ~is_inside_obstacle(world, at)
        standing = world.ground.find_nearest(at)[0]
        up = np.where(good[:, None], -directions, world.up)
        return StartPositionCandidates(standing, world.ground.position(standing), up, good)


def _draw_points_on_faces(
    meshes: list[MeshData], u: NDArray[np.float32], v: NDArray[np.float32], w: NDArray[np.float32]
) -> Floats:
    """Return points spread evenly over the area of the given meshes. `u`, `v`, `w`: random numbers from 0 to 1."""
    corners = np.concatenate([m.vertices[m.faces] for m in meshes])
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = vec.cross(vec.split_columns(edge, np.float64), vec.split_columns(other, np.float64))
    area = np.cumsum(vec.length(normal))
    face = np.minimum(np.searchsorted(area, u.astype(np.float64) * area[-1], side="right"), len(area) - 1)
    fold = v + w > 1
    a, b = np.where(fold, 1 - v, v), np.where(fold, 1 - w, w)
    points: Floats = corners[face, 0] + a[:, None] * edge[face] + b[:, None] * other[face]
    return points


def is_inside_obstacle(world: World, points: Floats) -> NDArray[np.bool_]:
    """Return a mask of the points that are inside an obstacle: an upward ray from the point first hits the back of a face."""
    is_inside = np.zeros(len(points), np.bool_)
    up = np.broadcast_to(world.up, points.shape)
    for name in world.plan.obstacles:
        mesh = world.setting.obstacles.get(name)
        if mesh is None or not len(mesh.faces):
            continue
        hits = get_obstacle_scene(world, name).find_first_hits(points, up)
        face = np.maximum(hits.face, 0)
        corners = mesh.vertices[mesh.faces[face if world.periodic is None else world.periodic.obstacle_faces[name].source[face]]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])  # edges do not depend on the origin
        is_inside |= hits.is_hit & ((normal * up).sum(axis=1) > 0)
    return is_inside
