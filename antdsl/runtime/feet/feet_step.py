"""Runs one step of all feet. For each body, it calls the kernels of `stepping`, and `foothold_search` to find ground for feet."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import parallel
from antdsl.runtime.feet import soles, stepping, trunk
from antdsl.runtime.feet.body_tables import POSITION_ROW, SIZE_ROW, UP_ROW, compute_body_table
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER, SWING_PHASE_OF_STANDING_FOOT, FeetState, make_zeros_by_leg
from antdsl.runtime.feet.foothold_search import FootGround, FootholdRequests, find_footholds
from antdsl.runtime.feet.gaits import REST_X_ROW, REST_Z_ROW, Gaits
from antdsl.runtime.feet.wearers import BodyWearers, get_body_wearers
from antdsl.runtime.world import World
from antdsl.scene.crowds.body_choice import find_species_of_key
from antdsl.scene.setting import LegsData

_F = np.float32
_DUG_GAP_LEG_SHARE = 0.02  # share of the leg length; with a larger gap to the solid, the ground below the foot was dug away
_PHASE_STEP_PER_ID = 0.6180339887498949  # phase difference at birth of agents with successive ids (golden ratio)
_MIN_AGENTS_PER_THREAD = 256  # fewer agents are not worth another thread


class LegsOfBody:
    """The legs of one body and their gaits."""

    def __init__(self, legs: LegsData) -> None:
        self.legs, self.gaits = legs, Gaits(legs)


def place_initial_feet(world: World) -> None:
    """Place the feet of all agents with legs on the ground, if feet are simulated."""
    prepare_feet_of_bodies(world)
    if world.feet:
        step_feet(world)


def prepare_feet_of_bodies(world: World) -> None:
    """Add empty feet for each body with legs to a world, if feet are simulated."""
    world.feet, world.legs_by_species, world.foot_ground = {}, {}, None
    if not world.options.feet or world.periodic is not None:  # feet stay where they stand, also when their agent wraps
        return
    for name, legs in world.setting.legs.items():
        if find_species_of_key(name) in world.populations:
            soles = len(legs.foot) if legs.has_flat_soles else 0
            world.feet[name], world.legs_by_species[name] = FeetState.make_empty(len(legs.foot), soles), LegsOfBody(legs)
    if world.feet:
        world.foot_ground = FootGround(world)


def record_ground_covered(world: World) -> None:
    """Record how far the rest position of each foot moved over the ground in this step. Call this before the ground
    itself moves."""
    for name, feet in world.feet.items():
        population, walkers = get_body_wearers(world, name), world.legs_by_species[name]
        feet, new = feet.match_ids(population.ids)
        world.feet[name] = feet
        n = len(feet)
        bodies = compute_body_table(population, "bodies before the ground moves", world.options.threads)
        feet.covered, feet.stood = make_zeros_by_leg((2, n, feet.legs), np.float32), bodies[POSITION_ROW : POSITION_ROW + 3]
        if n:
            is_new = np.zeros(n, np.bool_)
            is_new[new] = True
            last_pose = feet.position, feet.heading, feet.up
            work = partial(
                stepping.measure_ground_covered, bodies, last_pose, walkers.gaits.legs, is_new, _transpose_legs(feet.covered)
            )
            parallel.run_in_parts(work, n, world.options.threads, _MIN_AGENTS_PER_THREAD)


def step_feet(world: World) -> None:
    """Move all feet to their positions in the new frame."""
    for name in world.feet:
        _FeetStep(world, name, get_body_wearers(world, name), world.legs_by_species[name]).run_step()


def _transpose_legs(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array [..., n, L] as contiguous array [..., L, n], which kernels read."""
    return array.swapaxes(-1, -2)


class _FeetStep:
    """One step of the feet of n agents that have the same body, with L legs."""

    def __init__(self, world: World, name: str, population: BodyWearers, walkers: LegsOfBody) -> None:
        assert world.foot_ground is not None
        self.world, self.foot_ground, self.species_legs, self.gaits = world, world.foot_ground, walkers, walkers.gaits
        self.population = population
        self.feet, self.newborn_rows = world.feet[name].match_ids(population.ids)
        world.feet[name] = self.feet
        self.threads, self.dt = world.options.threads, _F(world.dt)
        self.bodies = compute_body_table(population, "bodies", self.threads)
        feet, (n, legs) = self.feet, self.feet.swing.shape
        if feet.covered is None:
            feet.covered = make_zeros_by_leg((2, n, legs), np.float32)
        place_columns = tuple(_transpose_legs(each) for each in (feet.place, feet.start, feet.shown))
        states = tuple(_transpose_legs(each) for each in (feet.swing, feet.on, feet.found))
        self.covered = _transpose_legs(feet.covered)
        self.columns = place_columns, states, (feet.phase, feet.rise, feet.slope)
        singles = population.get_buffers("feet", 5, (legs, n), np.float32)
        (points,) = population.get_buffers("feet from bodies", 1, (3, legs, n), np.float32)
        (what,) = population.get_buffers("what feet do", 1, (legs, n), np.uint8)
        self.targets = (*singles, points, what)
        pace = population.get_buffers("paces", 2, (n,), np.float32)
        self.pace = (*pace, *population.get_buffers("slow", 1, (n,), np.bool_))
        (self.undermined,) = population.get_buffers("undermined", 1, (legs, n), np.bool_)
        (self.requests,) = population.get_buffers("requests of feet", 1, (n * legs,), np.int64)

    def run_step(self) -> None:
        """Advance all feet by one frame."""
        feet, n = self.feet, len(self.feet)
        if n:
            self._move_feet_with_ground()
            self._place_newborn_feet()
            self._find_undermined_feet()
            self._plan_swings()
            last = feet.position, feet.heading, feet.up
            step_inputs = self.bodies, self.gaits.legs, self._compute_trunk_steps(), self.columns, self.pace, self.targets, last
            parallel.run_in_parts(partial(stepping.take_steps, *step_inputs), n, self.threads, _MIN_AGENTS_PER_THREAD)
            if feet.soles:
                soles.rotate_soles_to_ground(
                    self.world, self.foot_ground, feet, self.bodies[UP_ROW : UP_ROW + 3], self.targets[2].T
                )
        feet.covered = feet.stood = None

    def _move_feet_with_ground(self) -> None:
        """Move footholds with the ground below them. Move the start points of swings with the bodies."""
        feet = self.feet
        if self.foot_ground.moving_numbers:
            self.foot_ground.move_positions_with_ground(self.world, feet.on, feet.face, feet.weight, feet.place)
            if feet.stood is not None:
                displacement = self.bodies[POSITION_ROW : POSITION_ROW + 3] - feet.stood
                feet.start += np.where(np.isfinite(displacement), displacement, 0.0)[:, :, None]

    def _place_newborn_feet(self) -> None:
        """Place the feet of newborn agents at their rest positions. Give each of these agents a different gait phase."""
        rows, feet, legs = self.newborn_rows, self.feet, self.gaits.legs
        if not rows.size:
            return
        turns = feet.ids[rows].astype(np.float64) * _PHASE_STEP_PER_ID
        feet.phase[rows] = (turns - np.floor(turns)).astype(np.float32)
        for target, rest in zip(
            self.targets, (legs[REST_X_ROW], legs[REST_Z_ROW], np.zeros_like(legs[REST_X_ROW])), strict=False
        ):
            target[:, rows] = rest[:, None]
        self.targets[-1][:, rows] = stepping.SEARCHING_FOOT
        self._find_footholds((rows[:, None] << stepping.REQUEST_LEG_BITS | np.arange(feet.legs)).ravel())
        feet.swing[rows] = np.where(feet.on[rows] == NO_GROUND_NUMBER, _F(1), SWING_PHASE_OF_STANDING_FOOT)
        feet.start[:, rows] = feet.place[:, rows]
        feet.sole[:, rows] = feet.tread[:, rows]

    def _find_undermined_feet(self) -> None:
        """Find the feet that lost their ground to digging."""
        feet = self.feet
        self.undermined[:] = False
        for k, name in enumerate(self.foot_ground.names):
            volume = self.world.solids.get(name)
            rows = feet.on == k if volume is not None and volume.removed_volume > 0 else None
            if volume is not None and rows is not None and rows.any():
                length = self.species_legs.legs.length.astype(np.float32) * self.bodies[SIZE_ROW][:, None]
                gap = np.maximum(_DUG_GAP_LEG_SHARE * length[rows], 0.02 * volume.voxel)
                _transpose_legs(self.undermined)[rows] = volume.sample_distances(feet.place[:, rows].T) > gap

    def _plan_swings(self) -> None:
        """Decide which feet lift and which land, and find ground for feet that need it."""
        gaits, dt = self.gaits, self.dt
        times = dt, dt / _F(gaits.rest_cycle_seconds), dt / _F(gaits.max_swing_seconds), gaits.least_reach
        plan_inputs = (
            self.bodies, self.covered, gaits.legs, gaits.kernel_tables, times, self.undermined, self.columns,
            self.pace, self.targets, self.requests,
        )  # fmt: skip
        parts = parallel.run_in_parts(
            partial(stepping.plan_steps, *plan_inputs), len(self.feet), self.threads, _MIN_AGENTS_PER_THREAD
        )
        self._find_footholds(parallel.join_parts(parts, self.requests)[0])

    def _find_footholds(self, requests: NDArray[np.int64]) -> None:
        """Find ground for feet, and store it. `requests`: the agent and leg of each foot, encoded as
        `stepping.REQUEST_LEG_BITS` describes."""
        if requests.size:
            feet, gaits, targets = self.feet, self.gaits, self.targets
            goals, measures = (*targets[:3], targets[-1]), (gaits.legs, gaits.exact_legs)
            aim_inputs = (
                self.bodies,
                self.covered,
                measures,
                self.columns[2],
                goals,
                self.foot_ground.find_start_faces(self.population),
            )
            seeking = FootholdRequests.build(requests, aim_inputs, self.threads)
            hits = find_footholds(self.world, self.foot_ground, seeking)
            columns = tuple(_transpose_legs(each) for each in (feet.place, feet.on, feet.face, feet.weight))
            seeking.store_ground(hits, columns, self.threads)
            if feet.soles:
                which = requests >> stepping.REQUEST_LEG_BITS, requests & stepping.REQUEST_LEG_MASK
                up = self.bodies[UP_ROW : UP_ROW + 3, which[0]]
                soles.measure_tread_slopes(self.world, self.foot_ground, feet, which, up)

    def _compute_trunk_steps(self) -> tuple[np.float32, np.float32, np.float32]:
        """Return the argument `trunk_steps` of `stepping.take_steps`: the limits of trunk movement."""
        dt, legs = float(self.dt), self.species_legs.legs
        height = max(float((legs.hip[:, 1] - legs.foot[:, 1]).max()), 1e-3) * trunk.MAX_RISE_HIP_SHARE
        return _F(dt / (dt + trunk.TRUNK_SETTLING_SECONDS)), _F(dt / (dt + trunk.TRUNK_RISING_SECONDS)), _F(height)
