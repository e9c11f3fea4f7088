"""Queries with which agents perceive a solid: rays through its distance field, the nearest wall, and lower bounds of the distance
to it.

The interface is that of `RayScene`, so agents perceive a solid in the same way as an obstacle. Sphere tracing: J. C. Hart, The
Visual Computer 12(10), 1996, p. 527."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.nearby import FeelerHits, FeelerQuery, list_query_rows
from antdsl.casting.triangle_grid import Arrays
from antdsl.ground.solid import Volume
from antdsl.ground.solid.bricks import NODES_PER_BRICK, NODES_PER_BRICK_SIDE
from antdsl.numerics import parallel
from antdsl.numerics.vectors import VectorComponents

Floats = NDArray[np.float64]

_MAX_MARCH_STEPS = 96  # most steps of a ray near the surface, after which it counts as free
_MIN_MARCH_STEP_VOXELS = 0.5  # smallest step of a ray, in voxels
_ALLOWED_DEPTH_VOXELS = 0.02  # depth in voxels that a ray along the surface may have without a hit
_ENTRY_BISECTIONS = 8
_SAMPLE_BLOCK_NODES = 4  # edge, in nodes, of the blocks that give one sample of the surface each, for distant queries


class SolidProximityQueries:
    """Queries of one solid: hits of feelers, the nearest wall, and clearances. Each call uses the current state of the solid."""

    def __init__(self, volume: Volume) -> None:
        self.volume = volume
        self._surface_tree: tuple[float, Any, Floats] | None = None  # volume dug so far, tree of surface points, the points

    def measure_clearance(self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], threads: int = 1) -> NDArray[np.float32]:
        """Return a distance (mm), float32[n], around each point within which there is no surface. It is 0 near a surface."""
        place = np.stack([x, y, z], axis=1).astype(np.float64)
        parts = parallel.run_in_parts(lambda begin, end: self._measure_clearance(place[begin:end]), len(place), threads)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _measure_clearance(self, place: Floats) -> NDArray[np.float32]:
        away = np.maximum(np.maximum(self.volume.low - place, place - self.volume.high), 0.0)
        outside: NDArray[np.float32] = np.sqrt((away * away).sum(axis=1)).astype(np.float32)
        within = np.flatnonzero(outside == 0)
        if within.size:
            near = np.abs(self.volume.sample_distances(place[within])) - np.float32(self.volume.voxel)
            outside[within] = np.maximum(near, np.float32(0))
        return outside

    def cast_feelers(
        self, positions: VectorComponents, directions: VectorComponents, reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """Return the first hits of feelers from `positions` along the unit vectors `directions`, within `reach` (mm, one or
        float[n]).

        Positions and directions are given as three arrays [n], x, y and z. A ray hits where it enters the solid. The start of a
        ray counts as free, even inside the solid or along the surface below the agent."""
        origin, direction = (np.stack(list(v), axis=1).astype(np.float64) for v in (positions, directions))
        n = len(origin)
        far = np.broadcast_to(np.asarray(reach, np.float64), (n,))
        voxel, through = self.volume.voxel, -_ALLOWED_DEPTH_VOXELS * self.volume.voxel
        first, last = self._intersect_box(origin, direction)
        far = np.minimum(far, last)  # otherwise an infinite reach would march for ever
        progress = np.where(first > _MAX_MARCH_STEPS * self.volume.distance_band[1], first, 0.0)
        free, shut = np.zeros(n), np.full(n, np.inf)
        rows = np.flatnonzero((far > 0) & (first <= far))
        previous_distance = self.volume.sample_distances(origin[rows] + progress[rows, None] * direction[rows]).astype(np.float64)
        for _ in range(_MAX_MARCH_STEPS + int((far - progress)[rows].max(initial=0.0) / self.volume.distance_band[1])):
            step = np.maximum(np.abs(previous_distance), _MIN_MARCH_STEP_VOXELS * voxel)
            ahead = np.minimum(progress[rows] + step, far[rows])
            next_distance = self.volume.sample_distances(origin[rows] + ahead[:, None] * direction[rows]).astype(np.float64)
            is_hit = (next_distance < through) & (previous_distance >= through)
            free[rows[is_hit]], shut[rows[is_hit]] = progress[rows[is_hit]], ahead[is_hit]
            on = ~is_hit & (ahead < far[rows])
            progress[rows] = ahead
            rows, previous_distance = rows[on], next_distance[on]
            if not rows.size:
                break
        hit = np.flatnonzero(np.isfinite(shut))
        t, normal = np.full(n, np.inf), np.zeros((3, n), np.float32)
        t[hit] = self._find_entry(origin[hit], direction[hit], free[hit], shut[hit])
        normal[:, hit] = self._compute_normals(origin[hit] + t[hit, None] * direction[hit])
        return FeelerHits(np.isfinite(t), t.astype(np.float32), *normal)

    def cast_feeler_batch(
        self, positions: Arrays, queries: Sequence[FeelerQuery], threads: int = 1
    ) -> list[tuple[int, NDArray[np.intp]]]:
        """Return, for each query, its number and the rows of agents for which `cast_feelers` must still be called. For a solid,
        these are all rows of the query."""
        return list_query_rows(queries)

    def find_nearest_within(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """Find the nearest surface within `reach` (mm, one or float[n]) of each point. Return the distance (mm), and the unit
        direction away from the surface. Inside the solid, the distance is 0."""
        place = np.stack([x, y, z], axis=1).astype(np.float64)
        reach = np.broadcast_to(np.asarray(reach, np.float32), (len(place),))
        distance, slope = self.volume.sample_with_gradients(place)
        size = np.sqrt((slope * slope).sum(axis=1))
        normal = np.where(size[:, None] > 0, slope / np.where(size > 0, size, 1)[:, None], 0).astype(np.float32)
        t = np.maximum(distance, np.float32(0))
        beyond = np.flatnonzero(
            (distance > self.volume.distance_band[1] - self.volume.voxel) & (reach >= self.volume.distance_band[1])
        )
        if beyond.size:
            t[beyond], normal[beyond] = self._find_nearest_surface(place[beyond])
        hit = t <= reach
        t[~hit], normal[~hit] = np.inf, 0
        return FeelerHits(hit, t, *np.ascontiguousarray(normal.T))

    def _intersect_box(self, origin: Floats, direction: Floats) -> tuple[Floats, Floats]:
        """Intersect rays with the bounding box of the solid. Return the lengths along each ray at which it enters and leaves the
        box. For a ray that misses the box, the exit is before the entry."""
        with np.errstate(all="ignore"):
            ends = [
                (side - origin) / direction
                for side in (self.volume.low - self.volume.voxel, self.volume.high + self.volume.voxel)
            ]
        return np.fmax.reduce(np.fmin(*ends), axis=1), np.fmin.reduce(np.fmax(*ends), axis=1)

    def _find_entry(self, origin: Floats, direction: Floats, free_lengths: Floats, inside_lengths: Floats) -> Floats:
        """Return the length along each ray at which it enters the solid. The ray is in air at `free_lengths`, and in the solid at
        `inside_lengths`. The result is accurate to 1/256 of the interval between these."""
        for _ in range(_ENTRY_BISECTIONS):
            middle = (free_lengths + inside_lengths) / 2
            solid = (
                self.volume.sample_distances(origin + middle[:, None] * direction) < -_ALLOWED_DEPTH_VOXELS * self.volume.voxel
            )
            free_lengths, inside_lengths = np.where(solid, free_lengths, middle), np.where(solid, middle, inside_lengths)
        return free_lengths

    def _compute_normals(self, place: Floats) -> NDArray[np.float32]:
        """Return unit normals (3, n) that point out of the solid."""
        slope = self.volume.sample_gradients(place)
        size = np.sqrt((slope * slope).sum(axis=1))
        return np.ascontiguousarray((slope / np.maximum(size, np.float32(1e-12))[:, None]).T)

    def _find_nearest_surface(self, place: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """For points beyond the band of the field, return the distance from the surface, and the unit direction away from it. The
        result is accurate to a few voxels."""
        from scipy.spatial import cKDTree

        removed = self.volume.removed_volume
        if self._surface_tree is None or self._surface_tree[0] != removed:
            surface_points = self._sample_surface()
            self._surface_tree = (removed, cKDTree(surface_points) if len(surface_points) else None, surface_points)
        _, tree, surface = self._surface_tree
        if tree is None:
            return np.full(len(place), np.inf, np.float32), np.zeros((len(place), 3), np.float32)
        away = place - surface[tree.query(place)[1]]
        distance = np.sqrt((away * away).sum(axis=1))
        return distance.astype(np.float32), (away / np.maximum(distance, 1e-12)[:, None]).astype(np.float32)

    def _sample_surface(self) -> Floats:
        """Return points float64[n,3] on the surface: one point in each small block of nodes that the surface crosses."""
        bricks, parts = self.volume.bricks, NODES_PER_BRICK_SIDE // _SAMPLE_BLOCK_NODES
        stored = np.flatnonzero(bricks.table >= 2)
        pool = bricks.values[: bricks.used_slots * NODES_PER_BRICK].reshape((-1,) + (parts, _SAMPLE_BLOCK_NODES) * 3)[
            bricks.table[stored]
        ]
        blocks = np.abs(pool.transpose(0, 1, 3, 5, 2, 4, 6).reshape(len(stored), parts**3, _SAMPLE_BLOCK_NODES**3))
        least = blocks.argmin(axis=2)
        brick, block = np.nonzero(np.take_along_axis(blocks, least[:, :, None], axis=2)[:, :, 0] < bricks.voxel)
        corner = np.stack(np.unravel_index(stored[brick], bricks.shape), axis=1) * NODES_PER_BRICK_SIDE
        corner += np.stack(np.unravel_index(block, (parts,) * 3), axis=1) * _SAMPLE_BLOCK_NODES
        corner += np.stack(np.unravel_index(least[brick, block], (_SAMPLE_BLOCK_NODES,) * 3), axis=1)
        place: Floats = bricks.origin + corner * bricks.voxel
        distance, slope = self.volume.sample_with_gradients(place)
        return place - slope.astype(np.float64) * distance.astype(np.float64)[:, None]
