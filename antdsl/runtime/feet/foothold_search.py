"""Finds ground for feet: points of surfaces, obstacles, solids and the plane that a leg can reach, on the side of the body.

A foot first searches along the straight line from its hip to its target position, so that no leg passes through a thin mesh.
The hit may be far from the target, for example at an edge, a wall or a step. In this case, the foot searches downwards from a
point above the target, along the body's up direction. This point must be visible from the hip. Last, it uses the nearest
position on the ground. A result is always visible from the hip and within the length of the leg."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.ground.plane import PlaneGround
from antdsl.ground.solid_feelers import SolidProximityQueries
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.runtime.feet import foothold_kernels
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER, PLANE_GROUND_NUMBER
from antdsl.runtime.feet.foothold_kernels import REQUEST_FACE_BITS
from antdsl.runtime.feet.wearers import BodyWearers
from antdsl.runtime.moving.moving_geometry import compute_vertices
from antdsl.runtime.world import World

Vectors = NDArray[np.float64]  # (3, k)
Rows = NDArray[np.int64]
Arrays = tuple[NDArray[Any], ...]

_SIGHT_RAY_SHORTENING = 1e-6  # share by which a ray is shortened in the visibility test
_MIN_RAYS_PER_THREAD = 256  # fewer rays are not worth another thread
_NO_RINGS = np.empty(0), np.empty(0, np.int32), np.empty(0, np.float32)  # for a mesh on which no agent stands


@dataclass(slots=True, eq=False)
class GroundHits:
    """Hits of k rays on the ground. `ray_fraction` float64[k]: the fraction of each ray before its hit; inf without a hit.
    `position` float64[3, k]: the position of the hit (mm). `thing_numbers`, `face`, `weight`: thing, triangle and weights of
    the hit, like `on`, `face` and `weight` of `FeetState`."""

    ray_fraction: NDArray[np.float64]
    position: Vectors
    thing_numbers: NDArray[np.int16]
    face: NDArray[np.int32]
    weight: NDArray[np.float64]

    @staticmethod
    def empty(count: int) -> GroundHits:
        """Return the hits of `count` rays that hit nothing."""
        return GroundHits(
            np.full(count, np.inf), np.zeros((3, count)), np.full(count, NO_GROUND_NUMBER, np.int16), np.zeros(count, np.int32),
            np.zeros((2, count)),
        )  # fmt: skip

    @property
    def columns(self) -> Arrays:
        """Return the arrays in the order in which kernels expect them."""
        return self.ray_fraction, self.position, self.thing_numbers, self.face, self.weight

    def replace_rows(self, rows: Rows, other: GroundHits) -> None:
        """Replace the hits at `rows` by those of `other`, which has one hit for each of `rows`."""
        self.ray_fraction[rows], self.thing_numbers[rows], self.face[rows] = other.ray_fraction, other.thing_numbers, other.face
        self.position[:, rows], self.weight[:, rows] = other.position, other.weight


class FootGround:
    """All ground that feet can stand on, numbered in the order of the setting.

    It consists of the surfaces, obstacles and solids that are drawn, or of all of them if none is drawn."""

    def __init__(self, world: World) -> None:
        setting = world.setting
        meshes = {**setting.surfaces, **setting.obstacles}
        every = [*meshes, *world.solids]
        self.names = tuple(name for name in every if name not in setting.undrawn_things) or tuple(every)
        self.meshes = {name: mesh for name, mesh in meshes.items() if name in self.names}
        self.moving_numbers = [k for k, name in enumerate(self.names) if name in setting.motion.meshes]
        self._still_bounds = {
            k: _compute_bounds(self.meshes[name].vertices - world.origin)
            for k, name in enumerate(self.names)
            if name in self.meshes and k not in self.moving_numbers and len(self.meshes[name].vertices)
        }
        # By number of the ground: the bits of a start face above the face number.
        self._start_codes = np.array(
            [self.names.index(name) << REQUEST_FACE_BITS if name in self.meshes else -1 for name in world.ground.names], np.int64
        )
        self._walked_meshes: set[int] = set()  # numbers of meshes that agents stand on

    def find_start_faces(self, population: BodyWearers) -> Rows:
        """Return the face below each agent, encoded as `foothold_kernels.REQUEST_FACE_BITS` describes. Rays near agents start
        their search there."""
        columns = population.footing.columns
        if "face" not in columns or not self._start_codes.size:
            return np.full(len(population), -1)
        mesh, face = columns["mesh"], columns["face"]
        number = np.where(mesh >= 0, self._start_codes[mesh], -1)
        self._walked_meshes.update((self._start_codes[np.flatnonzero(np.bincount(mesh + 1)[1:])] >> REQUEST_FACE_BITS).tolist())
        return np.where(number >= 0, number | face, -1)

    def cast_rays(
        self, world: World, origin: Vectors, displacement: Vectors, starts: Rows, is_hit_likely: bool = True
    ) -> GroundHits:
        """Return the first hits of rays from `origin` along `displacement`.

        `starts`: faces near the origins, or -1. `is_hit_likely`: whether most rays hit a mesh that bodies walk on; Open3D then
        does not first test which rays hit. Neither argument changes the result."""
        hits, threads = GroundHits.empty(origin.shape[1]), world.options.threads
        if isinstance(world.ground, PlaneGround):
            _cast_on_plane(world, origin, displacement, hits)
        for k, name in enumerate(self.names):
            obstacle = world.obstacles.get(name)
            box = self._find_bounding_box(world, k, obstacle)
            if box is None:
                continue
            tables = self._find_grid_tables(k, obstacle)
            if not isinstance(obstacle, RayScene) or tables is None:
                near = _find_rays_at_box(box, origin, displacement)
            else:
                far = np.empty(len(hits.ray_fraction), np.int64)
                rings = obstacle.get_ring_tables(threads) if k in self._walked_meshes else None
                work = partial(
                    foothold_kernels.cast_foot_rays_on_mesh,
                    tables,
                    rings or _NO_RINGS,
                    box,
                    k,
                    origin,
                    displacement,
                    starts,
                    hits.columns,
                    far,
                )
                near = parallel.join_parts(parallel.run_in_parts(work, len(far), threads, _MIN_RAYS_PER_THREAD), far)[0]
            if not near.size:
                continue
            if isinstance(obstacle, RayScene):
                sure = is_hit_likely and name in world.setting.surfaces
                near = near if sure else _find_rays_near_mesh(obstacle, near, origin, displacement)
                if near.size:
                    self._cast_on_mesh(world, k, obstacle, near, (origin, displacement), hits, sure)
            elif isinstance(obstacle, SolidProximityQueries):
                _cast_on_solid(k, obstacle, near, origin, displacement, hits)
        return hits

    def find_nearest(self, world: World, points: Vectors, reach: NDArray[np.float64]) -> GroundHits:
        """Return the position on the ground that is nearest to each point, if it is within `reach` (mm, [k])."""
        hits, threads = GroundHits.empty(points.shape[1]), world.options.threads
        least = reach.copy()
        for k, name in enumerate(self.names):
            obstacle = world.obstacles.get(name)
            box = self._find_bounding_box(world, k, obstacle)
            if box is None:
                continue
            tables = self._find_grid_tables(k, obstacle)
            if tables is not None:
                far = np.empty(len(least), np.int64)
                work = partial(foothold_kernels.find_nearest_on_mesh, tables, box, k, points, least, hits.columns, far)
                near = parallel.join_parts(parallel.run_in_parts(work, len(far), threads, _MIN_RAYS_PER_THREAD), far)[0]
            else:
                near = np.flatnonzero(((points - reach <= box[1][:, None]) & (points + reach >= box[0][:, None])).all(axis=0))
                near = _find_points_near_mesh(obstacle, near, points, reach) if isinstance(obstacle, RayScene) else near
            if not near.size:
                continue
            if isinstance(obstacle, RayScene):
                _, face, place, distance = obstacle.find_closest(points[:, near].T, threads, least[near])
            else:
                assert isinstance(obstacle, SolidProximityQueries)
                slope = obstacle.volume.sample_gradients(points[:, near].T).astype(np.float64)
                landed = obstacle.volume.project_to_surface(points[:, near].T, _normalise_rows(slope), float(reach.max()))
                place, face = landed.points, np.zeros(near.size, np.int32)
                distance = np.where(landed.is_in_reach, _compute_lengths((landed.points - points[:, near].T).T), np.inf)
            nearer = distance < least[near]
            rows = near[nearer]
            least[rows] = distance[nearer]
            hits.replace_rows(rows, self._make_hits(world, k, distance[nearer], place[nearer].T, face[nearer]))
        return hits

    def move_positions_with_ground(
        self, world: World, thing_numbers: NDArray[np.int16], face: NDArray[np.int32], weight: Vectors, place: Vectors
    ) -> None:
        """Move the positions `place` [3, …], in place, along with the moving things that they are on."""
        for k in self.moving_numbers:
            rows = thing_numbers == k
            if rows.any():
                vertices = compute_vertices(world, self.names[k], world.display_frame)
                a, b, c = (vertices[self.meshes[self.names[k]].faces[face[rows], corner]].T for corner in range(3))
                place[:, rows] = a + weight[0][rows] * (b - a) + weight[1][rows] * (c - a)

    def _find_grid_tables(self, k: int, obstacle: object) -> Arrays | None:
        """Return the tables of the triangle grid of a mesh that does not move; None for all other ground."""
        return obstacle.get_tables() if isinstance(obstacle, RayScene) and k not in self.moving_numbers else None

    def _find_bounding_box(self, world: World, k: int, obstacle: object) -> tuple[Vectors, Vectors] | None:
        """Return the low and high corner (mm) of the bounding box of a ground; None if it has no box."""
        if isinstance(obstacle, SolidProximityQueries):
            return obstacle.volume.low, obstacle.volume.high
        if k in self.moving_numbers:
            return _compute_bounds(compute_vertices(world, self.names[k], world.display_frame))
        return self._still_bounds.get(k)

    def _cast_on_mesh(
        self,
        world: World,
        k: int,
        obstacle: RayScene,
        near_rows: Rows,
        rays: tuple[Vectors, Vectors],
        hits: GroundHits,
        is_hit_likely: bool,
    ) -> None:
        a, w = (each[:, near_rows] for each in rays)
        begin, step = np.ascontiguousarray(a.T), np.ascontiguousarray(w.T)
        which, part, _, face = obstacle.find_hits_along_step(begin, step, world.options.threads, is_hit_likely)
        nearer = part < hits.ray_fraction[near_rows[which]]
        which, part, face = which[nearer], part[nearer], face[nearer]
        hits.replace_rows(near_rows[which], self._make_hits(world, k, part, a[:, which] + w[:, which] * part, face))

    def _make_hits(self, world: World, k: int, part: NDArray[np.float64], place: Vectors, face: NDArray[np.int32]) -> GroundHits:
        hits = GroundHits(part, place, np.full(len(part), k, np.int16), np.zeros(len(part), np.int32), np.zeros((2, len(part))))
        if k in self.moving_numbers and len(part):
            hits.face = face.astype(np.int32)
            vertices = compute_vertices(world, self.names[k], world.display_frame)
            corners = tuple(vertices[self.meshes[self.names[k]].faces[face, corner]].T for corner in range(3))
            hits.weight = _compute_barycentric_weights(place, *corners)
        return hits


@dataclass(slots=True, eq=False)
class FootholdRequests:
    """The requests of feet that need ground.

    `requests` int64[k]: agent and leg, encoded as `stepping.REQUEST_LEG_BITS` describes. `columns`: hip, target position and
    up of the body, each (3, k), then two lengths [k]. These are the largest distance of the foot joint from the hip, and the
    height of this joint above the ground (mm). `displacement` (3, k): from the hip to beyond the target (mm). `start_faces`:
    start faces of the rays, as returned by `FootGround.find_start_faces`. `is_quick`: whether the foot lifts now, so that it
    searches again when it lands."""

    requests: Rows
    columns: Arrays
    displacement: Vectors
    start_faces: Rows
    is_quick: NDArray[np.bool_]

    @staticmethod
    def build(requests: Rows, aim_inputs: tuple[Any, ...], threads: int) -> FootholdRequests:
        """Return the requests with their columns and rays. `aim_inputs`: the arguments of `foothold_kernels.aim_first_rays`
        that follow `requests`."""
        count = len(requests)
        buffer = np.empty((14, count))
        columns = buffer[:3], buffer[3:6], buffer[6:9], buffer[12], buffer[13]
        seeking = FootholdRequests(requests, columns, buffer[9:12], np.empty(count, np.int64), np.empty(count, np.bool_))
        work = partial(
            foothold_kernels.aim_first_rays,
            requests,
            *aim_inputs,
            columns,
            (seeking.displacement, seeking.start_faces),
            seeking.is_quick,
        )
        parallel.run_in_parts(work, count, threads, _MIN_RAYS_PER_THREAD)
        return seeking

    def store_ground(self, hits: GroundHits, columns: Arrays, threads: int) -> None:
        """Write the ground found for the requests to `columns`: `place`, `on`, `face` and `weight` of the feet, with the axis
        of legs before that of agents."""
        work = partial(foothold_kernels.store_footholds, self.requests, self.columns, hits.columns, *columns)
        parallel.run_in_parts(work, len(self.requests), threads, _MIN_RAYS_PER_THREAD)


def find_footholds(world: World, foot_ground: FootGround, requests: FootholdRequests) -> GroundHits:
    """Return the ground for each request. Quick requests only get the hit of the first ray, even if it is far from the target."""
    threads, count = world.options.threads, len(requests.requests)
    hits = foot_ground.cast_rays(world, requests.columns[0], requests.displacement, requests.start_faces)
    fits, rows = np.empty(count, np.bool_), np.empty(count, np.int64)
    work = partial(foothold_kernels.mark_reachable_hits, requests.columns, hits.columns, requests.is_quick, fits, rows)
    (rows,) = parallel.join_parts(parallel.run_in_parts(work, count, threads, _MIN_RAYS_PER_THREAD), rows)
    if rows.size:
        _search_with_detour_rays(world, foot_ground, requests, hits, fits, rows)
    return hits


def _search_with_detour_rays(
    world: World,
    foot_ground: FootGround,
    requests: FootholdRequests,
    hits: GroundHits,
    is_reachable: NDArray[np.bool_],
    rows: Rows,
) -> None:
    """Find ground for the feet `rows`, for which the straight ray from the hip has no usable hit. First search with rays through
    a point above the target. If these fail too, search for the nearest position on the ground."""
    threads, count = world.options.threads, len(rows)
    buffer = np.empty((13, count))
    above, to_above, down, hips, reach = buffer[:3], buffer[3:6], buffer[6:9], buffer[9:12], buffer[12]
    parallel.run_in_parts(
        partial(foothold_kernels.aim_detour_rays, requests.columns, rows, above, to_above, down, hips),
        count,
        threads,
        _MIN_RAYS_PER_THREAD,
    )
    starts = requests.start_faces[rows]
    level = foot_ground.cast_rays(world, hips, to_above, starts, is_hit_likely=False)
    below = foot_ground.cast_rays(world, above, down, starts)
    lost = np.empty(count, np.int64)
    choose_inputs = requests.columns, rows, hits.columns, is_reachable, level.columns, below.columns, lost, reach
    parts = parallel.run_in_parts(
        partial(foothold_kernels.choose_nearest_hits, *choose_inputs), count, threads, _MIN_RAYS_PER_THREAD
    )
    lost, reach = parallel.join_parts(parts, lost, reach)
    if lost.size:
        rows, hips = rows[lost], np.ascontiguousarray(hips[:, lost])
        close = foot_ground.find_nearest(world, np.ascontiguousarray(requests.columns[1][:, rows]), reach)
        sight = np.where(np.isfinite(close.ray_fraction), (close.position - hips) * (1.0 - _SIGHT_RAY_SHORTENING), 0.0)
        sight_hits = foot_ground.cast_rays(world, hips, sight, starts[lost])
        foothold_kernels.accept_visible_positions(
            requests.columns, rows, close.columns, sight_hits.columns, hits.columns, 0, len(rows)
        )


def _find_rays_at_box(box: tuple[Vectors, Vectors], origin: Vectors, displacement: Vectors) -> Rows:
    """Return the indices of the rays that may hit a box."""
    low, high = np.minimum(origin, origin + displacement), np.maximum(origin, origin + displacement)
    return np.flatnonzero(((low <= box[1][:, None]) & (high >= box[0][:, None])).all(axis=0))


def _find_rays_near_mesh(obstacle: RayScene, rows: Rows, origin: Vectors, displacement: Vectors) -> Rows:
    """Return which of the rays `rows` may hit a mesh. The test uses the bounding sphere of each ray."""
    half = displacement * 0.5
    return _find_points_near_mesh(obstacle, rows, origin + half, _compute_lengths(half))


def _find_points_near_mesh(obstacle: RayScene, rows: Rows, points: Vectors, reach: NDArray[np.float64]) -> Rows:
    """Return which of the points `rows` may be within `reach` (mm) of a mesh."""
    return rows[obstacle.measure_clearance(*points[:, rows]) <= reach[rows] * (1 + 1e-4) + 1e-4]


def _cast_on_plane(world: World, origin: Vectors, displacement: Vectors, hits: GroundHits) -> None:
    """Cast rays on the ground plane, and store their hits at the same indices in `hits`."""
    up = world.up
    height = (origin[0] * up[0] + origin[1] * up[1]) + origin[2] * up[2]
    fall = -((displacement[0] * up[0] + displacement[1] * up[1]) + displacement[2] * up[2])
    part = np.where(fall > 0, height / np.where(fall > 0, fall, 1.0), np.inf)
    hit_rows = np.flatnonzero((part >= 0) & (part <= 1))
    place = origin[:, hit_rows] + displacement[:, hit_rows] * part[hit_rows]
    plane_hits = GroundHits.empty(hit_rows.size)
    plane_hits.ray_fraction, plane_hits.position, plane_hits.thing_numbers = (
        part[hit_rows],
        place,
        np.full(hit_rows.size, PLANE_GROUND_NUMBER, np.int16),
    )
    hits.replace_rows(hit_rows, plane_hits)


def _cast_on_solid(
    k: int, obstacle: SolidProximityQueries, near_rows: Rows, origin: Vectors, displacement: Vectors, ground_hits: GroundHits
) -> None:
    """Cast rays on a solid, and store the hits that are nearer than previous hits."""
    a, w = origin[:, near_rows], displacement[:, near_rows]
    length = _compute_lengths(w)
    unit = w / np.maximum(length, 1e-300)
    hits = obstacle.cast_feelers(a, unit, length)
    part = hits.t.astype(np.float64) / np.maximum(length, 1e-300)
    hit_rows = np.flatnonzero(hits.hit & (part < ground_hits.ray_fraction[near_rows]))
    place = a[:, hit_rows] + w[:, hit_rows] * part[hit_rows]
    normal = np.stack([hits.nx[hit_rows], hits.ny[hit_rows], hits.nz[hit_rows]]).astype(np.float64)
    landed = obstacle.volume.project_to_surface(place.T, _normalise_rows(normal.T), 2 * obstacle.volume.voxel)
    good = landed.is_in_reach
    hit_rows = hit_rows[good]
    solid_hits = GroundHits.empty(hit_rows.size)
    solid_hits.ray_fraction, solid_hits.position, solid_hits.thing_numbers = (
        part[hit_rows],
        landed.points[good].T,
        np.full(hit_rows.size, k, np.int16),
    )
    ground_hits.replace_rows(near_rows[hit_rows], solid_hits)


def _compute_lengths(v: Vectors) -> NDArray[np.float64]:
    return np.asarray(np.sqrt((v[0] * v[0] + v[1] * v[1]) + v[2] * v[2]))


def _normalise_rows(v: NDArray[np.float64]) -> NDArray[np.float64]:
    size = np.sqrt((v[:, 0] * v[:, 0] + v[:, 1] * v[:, 1]) + v[:, 2] * v[:, 2])
    return np.asarray(v / np.maximum(size, 1e-12)[:, None])


def _compute_bounds(vertices: NDArray[np.float64]) -> tuple[Vectors, Vectors]:
    return vertices.min(axis=0), vertices.max(axis=0)


def _compute_barycentric_weights(place: Vectors, a: Vectors, b: Vectors, c: Vectors) -> NDArray[np.float64]:
    """Return the barycentric weights of positions in triangles, float64[2, k]: those of the second and the third corner."""
    u, v, w = b - a, c - a, place - a
    uu, uv, vv, wu, wv = vec.dot(u, u), vec.dot(u, v), vec.dot(v, v), vec.dot(w, u), vec.dot(w, v)
    determinant = uu * vv - uv * uv
    determinant = np.where(determinant > 0, determinant, 1.0)
    return np.stack([(vv * wu - uv * wv) / determinant, (uu * wv - uv * wu) / determinant])
