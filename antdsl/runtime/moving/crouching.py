"""Lowers bodies that crouch below low ceilings. They are lowered before they reach a ceiling, and a ceiling that is too low acts
as a wall. Only species with `crouch` have the registers for this. Upward rays from points around each agent measure the free
height. An agent lowers itself to the least of these heights, at a limited speed, and stands up after the ceiling. A step below a
ceiling for which it is still too tall is undone. Each agent is computed from its own values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.ground.protocol import GroundMove
from antdsl.ground.solid_feelers import SolidProximityQueries
from antdsl.numerics import vectors as vec
from antdsl.numerics.vector_rows import dot
from antdsl.runtime.moving.slopes import StepStartStance, move_along_ground
from antdsl.runtime.world import Population, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

CROUCH_REGISTER = "crouch"  # for species that set it in `SpeciesPlan.settings`
LOWERING_REGISTER = "~lowering"  # share of the height by which a body is lower than when it stands
_RAY_START_SHARE = 0.5  # share of the least height; rays start there, above uneven ground
_SIDE_PROBE_RADII = (
    0.9  # share of the radius; distance of the points behind and before a body, so that a wall next to it is no ceiling
)
_HEADROOM_FACTOR = 1.02  # multiple of a body's height that it needs below a ceiling
_HEIGHT_TOLERANCE_SHARE = 1e-4  # share of the height; within it, a body is as low as the ceiling
_LOOKAHEAD_SECONDS = 0.5  # s; a body lowers itself for the ceiling that it reaches in this time
_LOWERING_PER_SECOND, _RISING_PER_SECOND = np.float32(1.2), np.float32(0.8)  # shares of the height
_MIN_NORMAL_RISE = 0.2  # least up component of a normal, for points along the ground
_TURN_COSINE, _TURN_SINE = 0.5, 0.8660254037844386  # of 60 degrees, between a direction ahead and one to the side


def has_crouch(population: Population) -> bool:
    """Return whether the bodies of a species can crouch."""
    return CROUCH_REGISTER in population.plan.settings


def compute_body_heights(population: Population, rows: Rows | slice = slice(None)) -> Floats:
    """Return the heights (mm) of standing bodies, or their `size` if the species has no height."""
    height = population.now["height" if "height" in population.plan.settings else "size"][rows].astype(np.float64)
    return np.where(np.isfinite(height) & (height > 0), height, 0.0)


def compute_lowering(population: Population, rows: Rows | slice = slice(None)) -> NDArray[np.float32]:
    """Return by how much (mm) crouching has lowered each body; 0 for a species that does not crouch."""
    heights = compute_body_heights(population, rows).astype(np.float32)
    lowering: NDArray[np.float32] = population.now[LOWERING_REGISTER][rows] if has_crouch(population) else np.zeros_like(heights)
    return lowering * heights


def crouch_below_ceilings(
    world: World, population: Population, start: StepStartStance, steps: Floats, dt: float
) -> tuple[Rows, Floats, GroundMove] | None:
    """Lower and raise bodies after a walk. Return the rows with undone steps, the steps (k, 3) mm that replace them, and the
    ends of these steps. Return None if no step is undone. `steps` (n, 3): the steps of the walk (mm)."""
    every = np.arange(len(population))
    free = _measure_free_heights(world, population, every, population.position, steps, dt)
    least, lowering = _find_least_shares(population, every), population.now[LOWERING_REGISTER]
    goal, seconds = np.minimum(free.least_share_around, np.where(free.share_ahead < least, 1.0, free.share_ahead)), np.float32(dt)
    tall = np.flatnonzero(free.least_share_around < 1 - lowering.astype(np.float64))
    start_share = _measure_free_heights(world, population, tall, start.position[tall], steps[tall], dt).share_above
    is_wall = free.least_share_around[tall] < least[tall]
    goal[tall] = np.where(is_wall, start_share, goal[tall])
    change = (1 - np.clip(goal, least, 1.0)).astype(np.float32) - lowering
    lowering += np.clip(change, -_RISING_PER_SECOND * seconds, _LOWERING_PER_SECOND * seconds)
    share = 1 - lowering[tall].astype(np.float64) - _HEIGHT_TOLERANCE_SHARE  # else it would wait for the last bit
    # a body below a ceiling that came down can leave
    is_blocked = (free.least_share_around[tall] < share) & (start_share >= share)
    rows = tall[is_blocked]
    if not len(rows):
        return None
    return rows, *_walk_along_low_ceilings(
        world, population, start, rows, steps[rows], free.walking_direction[rows], is_wall[is_blocked], dt
    )


def _find_least_shares(population: Population, rows: Rows) -> Floats:
    """Return the least height to which each body can crouch, as a fraction of the body's standing height."""
    return np.clip(population.now[CROUCH_REGISTER][rows].astype(np.float64), 0.05, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class _HeadroomMeasurements:
    """The free heights at k agents, as fractions of the height that a standing body needs. `walking_direction` (k, 3): the
    directions of their walks. `share_above` (k): the free height at the position of each agent. `least_share_around` (k): the
    least free height at this position and before, behind and next to it. `share_ahead` (k): the free height where the agent
    will be soon."""

    walking_direction: Floats
    share_above: Floats
    least_share_around: Floats
    share_ahead: Floats


def _measure_free_heights(
    world: World, population: Population, rows: Rows, position: Floats, steps: Floats, dt: float
) -> _HeadroomMeasurements:
    """Return the free heights at the agents in `rows`. `position`, `steps` (k, 3): their positions and steps (mm). If a face
    is between the body and the point before it, the free height at this point is 0."""
    up, height = np.asarray(world.up, np.float64), compute_body_heights(population, rows)
    level = steps - dot(steps, up)[:, None] * up
    far = np.sqrt(dot(level, level))
    heading = population.read_vector("heading")[rows].astype(np.float64)
    heading = heading - dot(heading, up)[:, None] * up
    ahead = np.where((far > 1e-6 * height)[:, None], level, heading)
    ahead = ahead / np.maximum(np.sqrt(dot(ahead, ahead)), 1e-12)[:, None]
    radius = np.nan_to_num(population.now["radius"][rows].astype(np.float64))
    soon = radius + far * (_LOOKAHEAD_SECONDS / dt)
    normal = population.normal[rows].astype(np.float64)
    rise = np.maximum(dot(normal, np.broadcast_to(up, normal.shape)), _MIN_NORMAL_RISE)
    low, needed = _RAY_START_SHARE * _find_least_shares(population, rows) * height, height * _HEADROOM_FACTOR
    middle = position + low[:, None] * up

    def measure_at(reach: Floats, hidden_share: float) -> Floats:
        """Return the free heights at points with the offsets `reach` (k, 3) mm. `hidden_share`: the result where a face hides
        the point."""
        reach = reach - (dot(reach, normal) / rise)[:, None] * up  # along the ground
        part = _cast_rays(world, middle + reach, up * (needed - low)[:, None])
        free = np.nan_to_num((low + (needed - low) * part) / np.maximum(needed, 1e-12), nan=1.0)
        return np.where(_cast_rays(world, middle, reach) < 1, hidden_share, free)

    near, side = ahead * (_SIDE_PROBE_RADII * radius)[:, None], _compute_side_directions(ahead, up)
    above = around = measure_at(np.zeros_like(near), 1.0)
    aside = side * (_SIDE_PROBE_RADII * radius * _TURN_SINE)[:, None]
    left, right = near * _TURN_COSINE - aside, near * _TURN_COSINE + aside
    for reach, hidden_share in ((near, 0.0), (-near, 1.0), (left, 1.0), (right, 1.0)):
        around = np.minimum(around, measure_at(reach, hidden_share))
    return _HeadroomMeasurements(ahead, above, around, measure_at(ahead * soon[:, None], 1.0))


def _compute_side_directions(ahead: Floats, up: Floats) -> Floats:
    """Return the horizontal directions (k, 3) at right angles to the horizontal directions `ahead` (k, 3)."""
    return np.stack(vec.cross(tuple(np.broadcast_to(up, ahead.shape).T), tuple(ahead.T)), axis=1)


def _cast_rays(world: World, origin: Floats, displacement: Floats) -> Floats:
    """Cast rays from `origin` along `displacement` (k, 3) mm. Return the fraction of each ray before its first hit; 1 without
    a hit."""
    part, threads = np.ones(len(origin)), world.options.threads
    length = np.sqrt(dot(displacement, displacement))
    for obstacle in world.obstacles.values():
        if isinstance(obstacle, RayScene):
            hit, share, *_ = obstacle.find_hits_along_step(origin, displacement, threads)
            part[hit] = np.minimum(part[hit], share)
        elif isinstance(obstacle, SolidProximityQueries):
            unit = displacement / np.maximum(length, 1e-12)[:, None]
            rays = vec.split_columns(origin, np.float64), vec.split_columns(unit, np.float64)
            hits = obstacle.cast_feelers(*rays, length, threads)
            part = np.minimum(part, np.where(hits.hit, hits.t / np.maximum(length, 1e-12), 1.0))
    return part


def _walk_along_low_ceilings(
    world: World,
    population: Population,
    start: StepStartStance,
    rows: Rows,
    steps: Floats,
    ahead: Floats,
    is_wall: NDArray[np.bool_],
    dt: float,
) -> tuple[Floats, GroundMove]:
    """Return the steps (k, 3) mm that replace undone steps of the agents in `rows`, and the ends of these steps.

    Before a wall (`is_wall`), an agent walks along the wall, to the side with more space. All other agents, and agents without
    space at the side, wait until their body is low enough."""
    up, result = np.asarray(world.up, np.float64), np.zeros_like(steps)
    moved = move_along_ground(world, population, start, rows, result)
    side = _compute_side_directions(ahead, up)
    length = np.sqrt(dot(steps, steps))[:, None]
    tries = np.flatnonzero(is_wall)
    if not len(tries):
        return result, moved
    shares, options = [], []
    for sign in (1.0, -1.0):
        option = (ahead * _TURN_COSINE + side * (sign * _TURN_SINE))[tries] * length[tries] * _TURN_SINE
        end = start.position[rows[tries]] + option
        shares.append(_measure_free_heights(world, population, rows[tries], end, option, dt).least_share_around)
        options.append(option)
    is_right = shares[1] > shares[0]
    chosen = np.where(is_right[:, None], options[1], options[0])
    standing = 1 - population.now[LOWERING_REGISTER][rows[tries]].astype(np.float64) - _HEIGHT_TOLERANCE_SHARE
    fits = np.where(is_right, shares[1], shares[0]) >= standing
    which = tries[fits]
    if len(which):
        result[which] = chosen[fits]
        moved.write_rows(which, move_along_ground(world, population, start, rows[which], chosen[fits]))
    return result, moved
