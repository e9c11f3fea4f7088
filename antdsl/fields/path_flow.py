"""A flow along the cheapest path to a goal. The cost of a path depends on slopes, obstacles, crowds and painted costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.fields import path_cost as cost
from antdsl.fields.face_points import FaceLattice
from antdsl.fields.flow import SurfaceFlow, project_to_faces
from antdsl.fields.path_cost import WalkableSurface
from antdsl.ground.protocol import Floats, Footing, Index, MeshSurfaces

if TYPE_CHECKING:
    from antdsl.runtime.world import World

_MIN_COST_PER_MM = 0.05  # smallest cost per mm: negative painted costs make no path free
_COVERAGE_PARTS_PER_MM2 = 1024.0  # covered area is counted in these integer units, so that the order of agents does not matter
_MAX_COVERAGE = 2.0  # upper limit of the coverage of a triangle
_CROWD_SMOOTHING_PASSES = 2  # number of lattice steps by which the effect of a crowd spreads


@dataclass(frozen=True, slots=True, eq=False)
class CrossableGround:
    """The faces of the ground that paths may cross, as a lattice and as a surface for paths.

    `slot_points`: the point of `surface` at each slot of `lattice`.
    `axis1`, `axis2` (3, slots): the axes of each slot's face.
    `triangle_areas` (t,): the areas (mm²) of the triangles of `surface`.
    `faces`: for each face of the ground, whether paths may cross it."""

    lattice: FaceLattice
    surface: WalkableSurface
    slot_points: Index
    axis1: Floats
    axis2: Floats
    triangle_areas: Floats
    faces: NDArray[np.bool_]


@dataclass(slots=True, eq=False)
class PathFlow(SurfaceFlow):
    """A flow along the cheapest path to the goal: its vectors are the directions in which the remaining path cost decreases.

    If the flow avoids crowds, or something moves, `begin` updates it in steps with `is_due`. Points and lattice stay the same.
    `cost` (t,): the cost per mm in each triangle. `start_points`, `start_costs`: the points at which paths end, and the cost
    from each to the goal. `crowding`: the additional cost per mm where agents cover a complete triangle.
    `crowd`: the area that agents cover at each point; `reached`: which points have a path to the goal."""

    crossable_ground: CrossableGround | None = None
    cost: Floats | None = None  # (t,) per mm, without agents
    start_points: Index | None = None
    start_costs: Floats | None = None  # remaining cost from each of these points
    target_gap: float = 0.0  # mm from the ground to the nearest point of the target, without its radius
    strength: float = 1.0
    crowding: float = 0.0
    interval: int = 1  # update interval in steps
    is_due: Callable[[World], bool] = lambda world: False
    crowd: NDArray[np.int64] | None = None  # covered area at each point, in units of 1 / _COVERAGE_PARTS_PER_MM2 mm²
    reached: NDArray[np.bool_] | None = None  # mask of the points with a path to the goal
    stores_reached: bool = False  # the state includes `reached`, because a program reads it

    def update_flow(self) -> None:
        """Compute the flow for the most recently recorded crowd."""
        g = self.crossable_ground
        assert g is not None and self.cost is not None and self.start_points is not None and self.start_costs is not None
        raised_cost = self.cost if self.crowd is None else self.cost + self.crowding * self._compute_crowd_shares(self.crowd)
        bound = cost.compute_path_costs(g.surface, raised_cost, self.start_points, self.start_costs)
        self.reached = np.isfinite(bound)
        vectors = cost.compute_directions(g.surface, bound) * self.strength
        self.c, self.s = project_to_faces(vectors[g.slot_points], g.axis1, g.axis2)
        self.c *= g.faces[g.lattice.faces()]
        self.s *= g.faces[g.lattice.faces()]

    def has_flow_at(self, meshes: MeshSurfaces | None, footing: Footing, place: Floats, up: Floats) -> NDArray[np.bool_]:
        """Return whether a path leads to the goal from the lattice point nearest to each agent, bool[n].

        The value is false on faces that the flow does not cover."""
        g = self.crossable_ground
        if meshes is None or g is None or self.reached is None:
            return np.zeros(len(place), bool)
        face, is_on_mesh = meshes.get_face_numbers(footing)
        slot = self._find_nearest_slot(face, footing)
        return is_on_mesh & g.faces[face] & self.reached[g.slot_points[slot]]

    def _find_nearest_slot(self, face: Index, footing: Footing) -> Index:
        """Return the slot nearest to each footing: the one with the largest weight."""
        slots, weights = self.lattice.locate(face, footing.b1, footing.b2)
        nearest: Index = np.take_along_axis(slots, weights.argmax(axis=0)[None], axis=0)[0]
        return nearest

    def _compute_crowd_shares(self, crowd: NDArray[np.int64]) -> Floats:
        """Return the share of each triangle's area that agents cover, smoothed over the adjacent triangles."""
        g = self.crossable_ground
        assert g is not None
        point_areas = self._sum_to_points(np.repeat(g.triangle_areas / 3, 3))
        share = crowd / _COVERAGE_PARTS_PER_MM2 / np.maximum(point_areas, 1e-9)
        for _ in range(_CROWD_SMOOTHING_PASSES):
            share = self._sum_to_points(
                np.repeat(share[g.surface.triangles].mean(axis=1) * g.triangle_areas / 3, 3)
            ) / np.maximum(point_areas, 1e-9)
        shares: Floats = np.minimum(share[g.surface.triangles].mean(axis=1), _MAX_COVERAGE)
        return shares

    def _sum_to_points(self, corner_values: Floats) -> Floats:
        """Return, for each point, the sum of `corner_values` (3 t,) over the triangle corners at that point."""
        assert self.crossable_ground is not None
        land = self.crossable_ground.surface
        return np.bincount(land.triangles.ravel(), corner_values, len(land.points)).astype(np.float64)

    def begin(self, world: World) -> None:
        if (self.crowd is None and self.updater is None) or not self.is_due(world):
            return
        if self.updater is not None:
            self.updater(world)
        if self.crowd is not None:
            self.crowd = self.measure_coverage(world)
        self.update_flow()

    def measure_coverage(self, world: World) -> NDArray[np.int64]:
        """Return, for each point, the area that the agents nearest to it cover, in units of 1 / _COVERAGE_PARTS_PER_MM2 mm²."""
        g, meshes = self.crossable_ground, world.ground.meshes
        assert g is not None and meshes is not None
        coverage = np.zeros(len(g.surface.points), np.int64)
        for population in world.populations.values():
            face, is_on_mesh = meshes.get_face_numbers(population.footing)
            slot = self._find_nearest_slot(face, population.footing)
            radius = population.start["radius"].astype(np.float64)
            parts = np.rint(np.pi * radius * radius * _COVERAGE_PARTS_PER_MM2)
            counted = is_on_mesh & g.faces[face] & (parts > 0) & (parts < 2.0**40)
            # integers: exact in any order
            coverage += np.bincount(g.slot_points[slot[counted]], parts[counted], len(coverage)).astype(np.int64)
        return coverage

    def state(self) -> dict[str, NDArray[Any]]:
        arrays: dict[str, NDArray[Any]] = {} if self.crowd is None else {"crowd": self.crowd}
        if self.updater is not None:
            arrays |= {"c": self.c, "s": self.s}
            if self.stores_reached and self.reached is not None:
                arrays["reached"] = self.reached
        return arrays

    def restore(self, arrays: dict[str, NDArray[Any]]) -> None:
        for name, array in arrays.items():
            setattr(self, name, array)
        if self.updater is None:
            self.update_flow()


def raise_to_min_cost(raised_cost: Floats) -> Floats:
    """Return the costs per mm, each raised to a least cost above 0."""
    return np.maximum(raised_cost, _MIN_COST_PER_MM)
