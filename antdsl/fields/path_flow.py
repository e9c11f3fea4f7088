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
_FIELD_BY_STATE_ARRAY = {  # by the name of an array in checkpoints
    "crowd": "crowd_coverage",
    "c": "axis1_components",
    "s": "axis2_components",
    "reached": "is_goal_reachable",
}
_CROWD_SMOOTHING_PASSES = 2  # number of lattice steps by which the effect of a crowd spreads


@dataclass(frozen=True, slots=True, eq=False)
class CrossableGround:
    """The faces of the ground that paths may cross, as a lattice and as a surface for path costs.

    `slot_points`: the point of `surface` at each slot of `lattice`. `axis1`, `axis2` (3, slots): the axes of each slot's face.
    `triangle_areas` (t,): the areas (mm²) of the triangles of `surface`. `is_crossable_face`: for each face of the ground,
    whether paths may cross it."""

    lattice: FaceLattice
    surface: WalkableSurface
    slot_points: Index
    axis1: Floats
    axis2: Floats
    triangle_areas: Floats
    is_crossable_face: NDArray[np.bool_]


@dataclass(slots=True, eq=False)
class PathFlow(SurfaceFlow):
    """A flow along the cheapest path to the goal: its vectors are the directions in which the remaining path cost decreases.

    If the flow avoids crowds or depends on moving things, `update_for_step` recomputes it in steps for which `is_update_due`
    is true. Points and lattice stay the same. `cost` (t,): the cost per mm in each triangle. `start_points`, `start_costs`:
    the points next to the goal at which paths end, and the cost from each to the goal. `crowd_cost`: the additional cost per
    mm in a triangle that agents cover completely. `crowd_coverage`: the area that agents cover at each point;
    `is_goal_reachable`: which points have a path to the goal."""

    crossable_ground: CrossableGround | None = None
    cost: Floats | None = None  # (t,) per mm, without agents
    start_points: Index | None = None
    start_costs: Floats | None = None  # remaining cost from each of these points
    target_gap: float = 0.0  # mm from the ground to the nearest point of the target, without its radius
    strength: float = 1.0
    crowd_cost: float = 0.0
    update_interval: int = 1  # update interval in steps
    is_update_due: Callable[[World], bool] = lambda world: False
    crowd_coverage: NDArray[np.int64] | None = None  # covered area at each point, in units of 1 / _COVERAGE_PARTS_PER_MM2 mm²
    is_goal_reachable: NDArray[np.bool_] | None = None  # mask of the points with a path to the goal
    stores_reachability: bool = False  # the state includes `reached`, because a program reads it

    def recompute_flow(self) -> None:
        """Compute the flow again, for the crowd positions recorded most recently."""
        g = self.crossable_ground
        assert g is not None and self.cost is not None and self.start_points is not None and self.start_costs is not None
        raised_cost = (
            self.cost
            if self.crowd_coverage is None
            else self.cost + self.crowd_cost * self._compute_crowd_shares(self.crowd_coverage)
        )
        bound = cost.compute_path_costs(g.surface, raised_cost, self.start_points, self.start_costs)
        self.is_goal_reachable = np.isfinite(bound)
        vectors = cost.compute_directions(g.surface, bound) * self.strength
        self.axis1_components, self.axis2_components = project_to_faces(vectors[g.slot_points], g.axis1, g.axis2)
        self.axis1_components *= g.is_crossable_face[g.lattice.get_face_by_slot()]
        self.axis2_components *= g.is_crossable_face[g.lattice.get_face_by_slot()]

    def has_flow_at(self, meshes: MeshSurfaces | None, footing: Footing, place: Floats, up: Floats) -> NDArray[np.bool_]:
        """Return whether a path leads to the goal from the lattice point nearest to each agent, bool[n].

        False for agents on faces that the flow does not cover."""
        g = self.crossable_ground
        if meshes is None or g is None or self.is_goal_reachable is None:
            return np.zeros(len(place), bool)
        face, is_on_mesh = meshes.get_face_numbers(footing)
        slot = self._find_nearest_slots(face, footing)
        return is_on_mesh & g.is_crossable_face[face] & self.is_goal_reachable[g.slot_points[slot]]

    def _find_nearest_slots(self, face: Index, footing: Footing) -> Index:
        """Return the slot nearest to each footing. It is the slot with the largest interpolation weight."""
        slots, weights = self.lattice.find_slots(face, footing.b1, footing.b2)
        nearest: Index = np.take_along_axis(slots, weights.argmax(axis=0)[None], axis=0)[0]
        return nearest

    def _compute_crowd_shares(self, crowd: NDArray[np.int64]) -> Floats:
        """Return the fraction (t,) of each triangle's area that agents cover. It is smoothed over adjacent triangles."""
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
        """Return, for each point, the sum of `corner_values` (3 t,) over all triangle corners that are at this point."""
        assert self.crossable_ground is not None
        land = self.crossable_ground.surface
        return np.bincount(land.triangles.ravel(), corner_values, len(land.points)).astype(np.float64)

    def update_for_step(self, world: World) -> None:
        if (self.crowd_coverage is None and self.update_after_motion is None) or not self.is_update_due(world):
            return
        if self.update_after_motion is not None:
            self.update_after_motion(world)
        if self.crowd_coverage is not None:
            self.crowd_coverage = self.measure_coverage(world)
        self.recompute_flow()

    def measure_coverage(self, world: World) -> NDArray[np.int64]:
        """Return, for each point, the area that agents cover. An agent counts at its nearest point. The unit is 1 /
        _COVERAGE_PARTS_PER_MM2 mm²."""
        g, meshes = self.crossable_ground, world.ground.meshes
        assert g is not None and meshes is not None
        coverage = np.zeros(len(g.surface.points), np.int64)
        for population in world.populations.values():
            face, is_on_mesh = meshes.get_face_numbers(population.footing)
            slot = self._find_nearest_slots(face, population.footing)
            radius = population.start["radius"].astype(np.float64)
            parts = np.rint(np.pi * radius * radius * _COVERAGE_PARTS_PER_MM2)
            counted = is_on_mesh & g.is_crossable_face[face] & (parts > 0) & (parts < 2.0**40)
            # integers: exact in any order
            coverage += np.bincount(g.slot_points[slot[counted]], parts[counted], len(coverage)).astype(np.int64)
        return coverage

    def get_state(self) -> dict[str, NDArray[Any]]:
        names = ["crowd"] if self.crowd_coverage is not None else []
        if self.update_after_motion is not None:
            names += ["c", "s"]
            if self.stores_reachability and self.is_goal_reachable is not None:
                names.append("reached")
        return {name: getattr(self, _FIELD_BY_STATE_ARRAY[name]) for name in names}

    def restore_state(self, arrays: dict[str, NDArray[Any]]) -> None:
        for name, array in arrays.items():
            setattr(self, _FIELD_BY_STATE_ARRAY[name], array)
        if self.update_after_motion is None:
            self.recompute_flow()


def limit_cost_from_below(raised_cost: Floats) -> Floats:
    """Return costs per mm, with very low ones raised to a minimum above 0."""
    return np.maximum(raised_cost, _MIN_COST_PER_MM)
