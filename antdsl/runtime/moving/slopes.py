"""Treats ground that is too steep for agents as a wall. Steps onto such ground are deflected along it or cancelled.

Only species with `max_slope` are affected. A step is too steep if it leads up ground steeper than `max_slope`, or from flatter
ground onto such ground. Stair steps are not walls: an agent crosses a steep part if it can stand beyond it, at most a quarter of
its height higher or lower. Only agents with too steep a step are computed here. The result for an agent does not depend on other
agents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Footing, GroundMove
from antdsl.numerics import elementary
from antdsl.runtime.world import AXES, Population, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

MAX_SLOPE_REGISTER = "max_slope"  # for species that set it in `SpeciesPlan.settings`
_MAX_STAIR_PER_BODY_HEIGHT = 0.25  # body heights; largest difference in height beyond a steep part
_LOOKAHEAD_PER_BODY_HEIGHT = (
    0.15  # body heights; how far ahead of its feet, in addition to its step, an agent stands beyond a steep part
)
_RAY_CLEARANCE_STAIR_SHARE = 0.05  # share of a stair's height; distance of a ray above the next tread
_MIN_RISE_SHARE = 0.02  # share of the step's length; a smaller rise counts as level
_COSINE_TOLERANCE = 1e-6
_TURN_AWAY_STEP_SHARE = 0.3  # share of the step by which an agent turns away from a wall that it would touch again


@dataclass(frozen=True, slots=True, eq=False)
class StepStartStance:
    """The stances of a species' agents before a substep: footings, positions (n, 3) mm, smooth ground normals, and headings (n,
    3)."""

    footing: Footing
    position: Floats
    normal: NDArray[np.float32]
    heading: Floats

    @staticmethod
    def from_population(population: Population) -> StepStartStance:
        return StepStartStance(population.footing, population.position, population.normal, population.read_vector("heading"))

    def find_rows_on_steep_ground(
        self, world: World, population: Population, rows: Rows, footing: Footing, pose: tuple[Floats, Floats]
    ) -> Rows:
        """Return which agents have a step from the start to `footing` that is too steep, as indices into `rows`.

        `pose`: the positions (k, 3) mm and smooth normals (k, 3) at `footing`."""
        up, limit = np.asarray(world.up, np.float64), find_steepest_cosines(population, rows)
        position, smooth = pose
        displacement = position - self.position[rows]
        distance = np.sqrt(_dot_vectors(displacement, displacement))
        which = np.flatnonzero((_dot_vectors(find_face_normals(world, footing, smooth), up) < limit) & (distance > 0))
        is_rising = _dot_vectors(displacement, up)[which] > _MIN_RISE_SHARE * distance[which]
        start = self.footing.select_rows(rows[which])
        normal = find_face_normals(world, start, self.normal[rows[which]].astype(np.float64))
        was_steep = _dot_vectors(normal, up) < limit[which]
        steep: Rows = which[is_rising | ~was_steep]
        return steep


def _dot_vectors(a: Floats, b: Floats) -> Floats:
    """Return the dot products of vectors (k, 3) with other vectors (k, 3), or with a single vector (3). Terms are added in a
    fixed order."""
    product: Floats = (a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]) + a[..., 2] * b[..., 2]
    return product


def find_face_normals(world: World, footing: Footing, smooth_normals: Floats) -> Floats:
    """Return the unit normals (k, 3) of the faces below agents, oriented like the smooth normals. Agents without a footing get
    the smooth normals."""
    normal = world.ground.normal(footing)
    side = _dot_vectors(normal, smooth_normals)[:, None]
    facing: Floats = np.where(side != 0, normal * np.sign(side), smooth_normals)
    return facing


def find_steepest_cosines(population: Population, rows: Rows) -> Floats:
    """Return the cosine of the steepest slope that each agent can walk, slightly reduced to allow for rounding."""
    angle = np.clip(population.now[MAX_SLOPE_REGISTER][rows], np.float32(0), np.float32(np.pi))
    cosine: Floats = elementary.cos(angle).astype(np.float64)
    return cosine - _COSINE_TOLERANCE


def has_slope_limit(population: Population) -> bool:
    """Return whether a species limits its slope."""
    return MAX_SLOPE_REGISTER in population.plan.settings


def deflect_pushes_along_slopes(world: World, population: Population) -> None:
    """Rotate the pushes of agents on steep ground into the plane of the ground, so that a push ahead leads over stair steps.

    The component of a push along the normal becomes a push up or down the slope."""
    up, every = np.asarray(world.up, np.float64), np.arange(len(population))
    normal = find_face_normals(world, population.footing, population.normal.astype(np.float64))
    rows = np.flatnonzero(_dot_vectors(normal, up) < find_steepest_cosines(population, every))
    if not len(rows):
        return
    normal, push = normal[rows], population.read_vector("push")[rows].astype(np.float64)
    across = _dot_vectors(push, normal)[:, None]
    uphill = up - normal * _dot_vectors(normal, up)[:, None]
    uphill = uphill / np.maximum(np.sqrt(_dot_vectors(uphill, uphill))[:, None], 1e-12)
    laid = push - normal * across - uphill * across
    for k, axis in enumerate(AXES):
        population.now[f"push.{axis}"][rows] = laid[:, k]


def find_rows_blocked_by_slope(world: World, population: Population, start: StepStartStance) -> Rows:
    """Return the rows of agents with a step that is too steep. Agents that can cross the steep part like a stair step are left
    out."""
    every, pose = np.arange(len(population)), (population.position, population.normal.astype(np.float64))
    rows = start.find_rows_on_steep_ground(world, population, every, population.footing, pose)
    if not len(rows):
        return rows
    return rows[~_can_stand_beyond_slope(world, population, start, rows)]


def _can_stand_beyond_slope(world: World, population: Population, start: StepStartStance, rows: Rows) -> NDArray[np.bool_]:
    """Return which of `rows` can stand beyond the steep part ahead of them, bool[k]."""
    meshes = world.ground.meshes
    crosses = np.zeros(len(rows), np.bool_)
    if meshes is None:
        return crosses
    up, now, threads = np.asarray(world.up, np.float64), population.now, world.options.threads
    high = (now["height"] if "height" in population.plan.settings else now["size"])[rows].astype(np.float64)
    tread = (_MAX_STAIR_PER_BODY_HEIGHT * np.where(np.isfinite(high) & (high > 0), high, 0.0))[:, None]
    heading = start.heading[rows].astype(np.float64)
    ahead = heading - _dot_vectors(heading, up)[:, None] * up
    step = population.position[rows] - start.position[rows]
    lead = np.sqrt(_dot_vectors(step, step))[:, None] + _LOOKAHEAD_PER_BODY_HEIGHT / _MAX_STAIR_PER_BODY_HEIGHT * tread
    ahead = ahead / np.maximum(np.sqrt(_dot_vectors(ahead, ahead))[:, None], 1e-12) * lead
    origin = start.position[rows] + up * tread * (1 + _RAY_CLEARANCE_STAIR_SHARE)
    hit, _, _ = meshes.find_hit_normals(origin, ahead, threads)
    is_free = np.ones(len(rows), np.bool_)
    is_free[hit] = False
    down = -up * tread * (2 + 2 * _RAY_CLEARANCE_STAIR_SHARE)
    hit, _, normal = meshes.find_hit_normals(origin + ahead, down, threads)
    limit = find_steepest_cosines(population, rows)
    crosses[hit] = np.abs(_dot_vectors(normal.T, up)) >= limit[hit]
    return crosses & is_free


def deflect_steps_along_slopes(
    world: World, population: Population, start: StepStartStance, rows: Rows, step: Floats
) -> tuple[Floats, GroundMove]:
    """Return steps (k, 3) mm with which agents walk along the edge of the steep ground that stopped them, and the ends of these
    steps.

    `step` (k, 3) mm: the steps that were too steep. Agents that would meet steep ground again do not move."""
    up = np.asarray(world.up, np.float64)
    wall = find_face_normals(world, population.footing.select_rows(rows), population.normal[rows].astype(np.float64))
    wall = wall - _dot_vectors(wall, up)[:, None] * up
    wall = wall / np.maximum(np.sqrt(_dot_vectors(wall, wall))[:, None], 1e-12)
    into = _dot_vectors(step, wall)[:, None]
    along = step - wall * into
    away = along - wall * (np.sign(into) * _TURN_AWAY_STEP_SHARE * np.sqrt(_dot_vectors(step, step))[:, None])
    result, moved = along.copy(), move_along_ground(world, population, start, rows, along)
    for other in (away, np.zeros_like(step)):
        again = start.find_rows_on_steep_ground(world, population, rows, moved.footing, (moved.position, moved.up))
        if not len(again):
            break
        result[again] = other[again]
        moved.write_rows(again, move_along_ground(world, population, start, rows[again], other[again]))
    return result, moved


def move_along_ground(world: World, population: Population, start: StepStartStance, rows: Rows, step: Floats) -> GroundMove:
    """Return the result of walking agents over the ground from their start stances, by steps (k, 3) mm."""
    normal, heading = start.normal[rows].astype(np.float64), population.read_vector("heading")[rows].astype(np.float64)
    size = population.now["size"][rows].astype(np.float64)
    return world.ground.move(start.footing.select_rows(rows), step, heading, normal, size, world.options.threads)
