"""The solver of contacts: bodies that overlap after all agents have walked are separated along the surface. Contacts are
position-based (M. Müller et al., Position Based Dynamics, VRIPHYS 2006, 3.3) and solved in Jacobi sweeps. Each agent moves by
the mean correction of its contacts (M. Macklin et al., Unified Particle Physics for Real-Time Applications, SIGGRAPH 2014,
4.2). A sweep adds the corrections of all pairs exactly, so the result does not depend on the order of pairs. The masses of two
bodies decide how far each of them moves. No agent moves farther from its position at the start of the step than it can walk in
the step's duration. A step into another agent is shortened and slides along that agent. Agents that overlapped before the step
separate at their walking speed. `motion_measures` measures the remaining overlap. Surface and obstacles take precedence over
contacts. An agent loses the component of its velocity that leads into another agent. Being pushed by others adds no velocity;
otherwise resting agents would never stop moving."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import elementary
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays, dot
from antdsl.runtime.moving import correction_walks
from antdsl.runtime.moving.contacts import step_clamping
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, NearbyCapsulePairs, find_near_pairs
from antdsl.runtime.moving.contacts.long_steps import StartPositions, find_long_steps, stop_long_steps_at_impacts
from antdsl.runtime.moving.contacts.separation import DEAD_ZONE_SHARE, SUM_BITS, make_buffers, restore_headings, separate_pairs
from antdsl.runtime.moving.contacts.step_retreats import Stances
from antdsl.runtime.moving.correction_walks import CorrectionWalker, SpeciesStances, write_approach, write_stances
from antdsl.runtime.moving.postures import has_posture
from antdsl.runtime.world import PUSHED_DISTANCE_REGISTER, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_F = np.float32
_SOFT_CONTACT_SECONDS = 0.1  # time constant of soft contacts


@dataclass(frozen=True, slots=True)
class SolverIterations:
    """How many iterations reduce overlaps in a substep.

    `outer_iterations`: how often pairs are measured again. `sweeps`: the number of sweeps after each measurement. `passes`:
    the number of passes; passes after the first are for agents that the ground deflected or that could not move."""

    outer_iterations: int
    sweeps: int
    passes: int

    @property
    def has_one_iteration(self) -> bool:
        """Return whether there is only one outer iteration, one sweep and one pass. Then only agents that overlap at the first
        measurement are moved."""
        return self.outer_iterations == self.sweeps == self.passes == 1


SOLVER_ITERATIONS_BY_EFFORT: Mapping[str, SolverIterations] = {
    "soft": SolverIterations(1, 1, 1),
    "hard": SolverIterations(12, 4, 3),
}


@dataclass(frozen=True, slots=True, eq=False)
class StartStances(StartPositions):
    """Positions and ground normals of agents at the start of a substep, by species; for hard contacts also their headings.

    `stances`: the complete stances of species of which steps can be undone, or None. These have complete bodies that follow the
    ground."""

    heading_by_species: Mapping[str, VectorArrays]
    stances: Mapping[str, Stances] | None


def record_stances(world: World) -> StartStances | None:
    """Return the current positions and headings of agents, for `resolve_contacts`; None if contacts are off."""
    if world.setting.contacts == "off":
        return None
    species, headings = world.populations.items(), {}
    if world.setting.contacts == "hard":
        headings = {name: vec.copy(vec.get_vector_registers(population.now, "heading")) for name, population in species}
    normals = {name: population.normal for name, population in species}
    stances = None
    if headings and any([population.plan.has_whole_body and not has_posture(population) for _, population in species]):
        stances = {name: Stances(population) for name, population in species}
    return StartStances({name: population.position for name, population in species}, normals, headings, stances)


def resolve_contacts(world: World, step_start: StartStances, dt: float) -> NearbyCapsulePairs | None:
    """Separate overlapping agents after a substep of `dt` s.

    `step_start`: the stances at the start of the substep. Returns the pairs that may touch; None if there are none."""
    if len(world) < 2:
        return None
    effort, crowd = SOLVER_ITERATIONS_BY_EFFORT[world.setting.contacts], CapsuleCrowd(world)
    is_hard = world.setting.contacts == "hard"
    long = find_long_steps(crowd, step_start) if is_hard else None
    near = find_near_pairs(crowd, DEAD_ZONE_SHARE if effort.has_one_iteration else None)
    if not len(near.first_indices) and long is None:
        return None
    share = 1.0 if is_hard else 1.0 - float(elementary.exp(_F(-dt / _SOFT_CONTACT_SECONDS)))
    agents, walked = _ContactAgents.build(crowd, near, step_start, dt)
    gap, direction, depth = near.measure_before_step(walked)
    cut = np.zeros_like(near.middle)
    if is_hard and len(near.first_indices):
        cut, stopped, changed = step_clamping.clamp_approaching_steps(
            near, _compute_approach(crowd, near.rows, dt), agents.mass, walked, gap, direction
        )
        _restore_headings(crowd, near, stopped, step_start.heading_by_species)
    if long is not None and stop_long_steps_at_impacts(world, step_start, long, near, cut, dt):
        crowd = CapsuleCrowd(world)
        near = find_near_pairs(crowd)
        agents, walked = _ContactAgents.build(crowd, near, step_start, dt)
        _, _, depth = near.measure_before_step(walked)
        cut = np.zeros_like(near.middle)
    elif is_hard and len(near.first_indices):
        near.measure_gaps(cut, changed)
    if not len(near.first_indices):
        return None
    which = np.ones(len(near.first_indices), np.bool_)
    held, walking = agents.is_frozen, CorrectionWalker(crowd, step_start.positions, dt)
    work = make_buffers(len(near.rows), len(near.first_indices))
    for left in range(effort.passes - 1, -1, -1):
        asked = _solve_separation(near, agents, which, held, walked, depth, effort, share, cut, work)
        moved_rows, requested_moves = correction_walks.select_corrected_rows(asked)
        rows = near.rows.take(moved_rows)
        got = walking.walk_corrections(rows, requested_moves)
        _record_pushes(crowd, rows, cut, moved_rows, requested_moves, got)
        if not left:
            break
        cut, held = np.zeros_like(cut), held.copy()
        touched = correction_walks.find_unresolved_rows(near, moved_rows, requested_moves, got, held)
        if not touched.any():
            break
        near.measure_gaps(cut, touched)
        visible_pairs = correction_walks.find_overlapping_pairs(near, touched)
        if visible_pairs is None:
            break
        which = visible_pairs
        at = [population.position[own].T for population, own in crowd.split_rows(rows)]
        walked[:, moved_rows] = (at[0] if len(at) == 1 else np.concatenate(at, axis=1)) - agents.start_position.take(
            moved_rows, axis=1
        )
    return near


def _compute_approach(crowd: CapsuleCrowd, rows: Rows, dt: float) -> Floats:
    """Return the displacements (3, k) mm that the given rows would make in `dt` with their velocities before this substep."""
    first, displacement = 0, np.empty((3, len(rows)))
    for population, own in crowd.split_rows(rows):
        write_approach(own, first, vec.get_vector_registers(population.start, "velocity"), dt, displacement)
        first += len(own)
    return displacement


def _record_pushes(
    crowd: CapsuleCrowd, rows: Rows, own_corrections: Floats, moved_rows: Rows, requested_moves: Floats, reached_moves: Floats
) -> None:
    """Add to a register of each agent the distance by which others pushed it. This is done for species of which the program reads
    the register.

    Only displacements by other agents are added, not `own_corrections` (3, k), the corrections of the agents' own steps. `rows`:
    ascending rows of the crowd. `moved_rows`: indices into `rows` of the agents that moved. `requested_moves` (3, k) mm: the
    requested displacements. `reached_moves`: the actual displacements, from which the distances are computed."""
    if not any(PUSHED_DISTANCE_REGISTER in population.now for population in crowd.species):
        return
    pushed = requested_moves - own_corrections.take(moved_rows, axis=1)
    short = np.where((pushed == 0).all(axis=0), 0.0, reached_moves - (requested_moves - pushed))
    far = np.sqrt(dot(short, short)).astype(_F)
    first = 0
    for population, own in crowd.split_rows(rows):
        if PUSHED_DISTANCE_REGISTER in population.now:
            population.now[PUSHED_DISTANCE_REGISTER][own] += far[first : first + len(own)]
        first += len(own)


@dataclass(frozen=True, slots=True, eq=False)
class _ContactAgents:
    """The data of agents that occur in pairs, for one substep.

    `start_position` (3, k) mm: positions at the start. `max_travel` (k) mm: the distance that each agent may walk.
    `push_share`: limits how far neighbours can push an agent; at most 1. `normal` (3, k): normals of the ground below the
    feet. `is_frozen`: whether a fault has stopped the agent."""

    start_position: Floats
    max_travel: Floats
    mass: Floats
    push_share: Floats
    normal: Floats
    is_frozen: Flags

    @staticmethod
    def build(
        crowd: CapsuleCrowd, nearby_pairs: NearbyCapsulePairs, start_stances: StartStances, dt: float
    ) -> tuple[_ContactAgents, Floats]:
        """Return the data of the agents in `nearby_pairs`, and their displacements (3, k) mm from their start positions."""
        rows = nearby_pairs.rows
        vectors, (reach, mass), first = np.empty((3, 3, len(rows))), np.empty((2, len(rows))), 0
        for p, own in crowd.split_rows(rows):
            feet = SpeciesStances(start_stances.positions[p.name], p.position, p.normal, p.now["max_speed"], p.now["mass"])
            write_stances(own, first, feet, dt, *vectors, reach, mass)
            first += len(own)
        start, walked, normal = vectors
        yields = np.ones(len(rows))
        if (
            len(rows) and mass.min() < mass.max()
        ):  # otherwise the sweeps would push a heavy agent as often as a light one cannot move away
            yields[:] = 0.0
            for k, other in (
                (nearby_pairs.first_indices, nearby_pairs.second_indices),
                (nearby_pairs.second_indices, nearby_pairs.first_indices),
            ):
                one, two = mass.take(k), mass.take(other)
                np.maximum.at(yields, k, np.minimum(2 * two / (one + two), 1.0))
        return _ContactAgents(
            start, reach, mass, yields, normal, crowd.concatenate_species(lambda p: p.quarantined).take(rows)
        ), walked


def _solve_separation(
    nearby_pairs: NearbyCapsulePairs,
    agents: _ContactAgents,
    is_selected: Flags,
    is_held: Flags,
    travel: Floats,
    depth: Floats,
    effort: SolverIterations,
    relaxation: float,
    own_corrections: Floats,
    work_buffers: tuple[Any, ...],
) -> Floats:
    """Return the displacements (3, k) mm that separate the pairs flagged in `is_selected` (m).

    Pairs are measured after the steps were changed by `own_corrections` (3, k) mm. `is_held`: flags of rows that must not move
    farther. `travel` (3, k) mm: the displacement of each row. `depth` (k) mm: the overlap of each row before the step.
    `work_buffers`: buffers for kernels."""
    magic = np.ldexp(1.5, int(np.frexp(nearby_pairs.max_radius)[1]) + 1 - SUM_BITS + 52)
    is_selected, displacement = is_selected.copy(), own_corrections.copy()
    looks, lost = effort.outer_iterations, np.empty(len(nearby_pairs.first_indices), np.intp)
    bodies = nearby_pairs.capsules
    pairs = (nearby_pairs.first_indices, nearby_pairs.second_indices, nearby_pairs.gap, nearby_pairs.direction, is_selected)
    stand = (agents.mass, agents.push_share, agents.max_travel, depth, is_held, agents.normal, travel, own_corrections)
    while looks:
        looks, count = separate_pairs(
            bodies, pairs, stand, displacement, magic, looks, effort.sweeps, relaxation, lost, work_buffers
        )
        nearby_pairs.draw_missing_axes(nearby_pairs.direction, lost[:count])
    return displacement


def _restore_headings(
    crowd: CapsuleCrowd, nearby_pairs: NearbyCapsulePairs, stopped_rows: Rows, previous_headings: Mapping[str, VectorArrays]
) -> None:
    """Reset the headings of agents to those before the substep. `stopped_rows`: their indices in the rows of `nearby_pairs`.
    An agent that cannot walk because others surround it cannot turn either."""
    rows, last = nearby_pairs.rows.take(stopped_rows), 0
    for population, own in crowd.split_rows(rows):
        first, last = last, last + len(own)
        vectors = (
            previous_headings[population.name],
            *(vec.get_vector_registers(population.now, name) for name in ("up", "heading")),
        )
        restore_headings(
            own,
            stopped_rows[first:last],
            rows[first:last],
            *vectors,
            crowd.ahead,
            nearby_pairs.axis_directions,
            nearby_pairs.middle,
        )
