"""The phases of a step, in the order of PHASES. The language reference shows the same order. The wall time and the CPU time of
each phase are measured.

All reads return the state at the start of the step (`start`, `visible_values`). Agents sense values written in a step only in
the next step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter, process_time

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.processor.float_environment import has_standard_floats, use_standard_floats
from antdsl.numerics.sorting import compute_morton_codes, sort_stably
from antdsl.plan.ir import ValueKind
from antdsl.program.tables.effects import list_effects_of_phase
from antdsl.runtime import claims, digging, faults, lifecycle
from antdsl.runtime.binding import releases
from antdsl.runtime.faults import FaultStop
from antdsl.runtime.feet import feet_step
from antdsl.runtime.moving import crowd_substep, moving_geometry, scripted_walks, tilting
from antdsl.runtime.moving.contacts import contact_solver
from antdsl.runtime.moving.contacts.step_retreats import take_back_overlapping_steps
from antdsl.runtime.notes.wishes import FINAL_WISH_REGISTER, STATE_WISH_REGISTER
from antdsl.runtime.periodic_steps import check_periodic_steps
from antdsl.runtime.world import PUSHED_DISTANCE_REGISTER, Population, World, publish_state

_SORT_INTERVAL_FRAMES, _MIN_AGENTS_TO_SORT = 16, 2048  # frames, agents


def prepare_senses(world: World) -> None:
    """Prepare the senses of a step: clear cached values, publish the items' amounts, update flows, and find the agents' cells.

    Senses are computed on first use. From this phase on, `time` and `frame` are those of the new frame."""
    world.is_stepping = True
    world.grids.clear()
    world.trees.clear()
    world.clearances.clear()
    world.touching_agents = None
    world.faults.fault_of_step = None
    for items in world.items.values():
        items.publish_amounts()
    for flow in world.flows.values():
        flow.update_for_step(world)
    for population in world.populations.values():
        lifecycle.update_agent_cells(world, population)
        tilting.align_leaning_bodies_with_ground(population, world.options.threads)
        population.clear_temporary_registers(world.options.threads)
    if world.detail_levels is not None:
        world.detail_levels.count_agents_of_step(world)
    if world.notes is not None:
        world.notes.begin_step(world)
    world.backend.begin_step(world)


def run_decisions(world: World) -> None:
    """Run handlers, latches and transitions. They decide what each agent intends to do."""
    _run_block(world, "decide")


def resolve_claims(world: World) -> None:
    """Resolve the claims: decide which agents get what they requested."""
    claims.resolve_claims(world)


def run_actions(world: World) -> None:
    """Run the actions of transitions, then the body of the new state. Transitions are counted before dead agents are removed."""
    _run_block(world, "act")
    for population in world.populations.values():
        _count_transitions(world, population)
    for watch in world.watchers:
        watch(world)


def combine_layers(world: World) -> None:
    """Run the layers, and combine their wishes into one push for each agent."""
    if world.notes is not None:
        world.notes.apply_wishes(world, STATE_WISH_REGISTER)
    _run_block(world, "blend")
    if world.notes is not None:
        world.notes.apply_wishes(world, FINAL_WISH_REGISTER)
        world.notes.apply_value_notes(world)
    faults.collect_faults(world)


def _run_block(world: World, block: str) -> None:
    """Run a block of every species."""
    for population in world.populations.values():
        rows = scripted_walks.find_deciding_rows(world, population)
        if len(population) if rows is None else len(rows):
            world.backend.run(world, population, block, rows)


def apply_effects(world: World) -> None:
    """Apply gifts, events for the next step and deposits, before fields spread or agents move.

    The order of these effects does not matter, because none reads values that another writes."""
    _resolve_requests("effects", world)
    claims.resolve_gifts(world)


def _resolve_requests(phase: str, world: World) -> None:
    """Apply all requests of a phase. If one function applies several kinds of requests, it is called only once."""
    if any([population.effects.requests for population in world.populations.values()]):
        for settle in dict.fromkeys(RESOLVER_BY_EFFECT[op] for op in list_effects_of_phase(phase)):
            settle(world)


def advance_fields(world: World) -> None:
    """Advance the fields by one step: they diffuse, evaporate and receive deposits."""
    for name, field in world.fields.items():
        keep, diffusion = world.field_rates[name]
        field.advance(float(keep), diffusion, world.dt, world.options.threads)
    for vectors in world.vector_fields.values():
        vectors.limit_lengths()


def move_all_agents(world: World) -> None:
    """Move all agents along their surfaces, substep by substep. Overlapping bodies are then separated."""
    with np.errstate(all="ignore"):
        if world.notes is not None:
            world.notes.apply_speed_shares(world)
        for population in world.populations.values():
            tilting.restore_leaning_bodies(population)
            if PUSHED_DISTANCE_REGISTER in population.now:
                population.now[PUSHED_DISTANCE_REGISTER].fill(0)
        for substep in range(world.setting.substeps):
            stances = contact_solver.record_stances(world)
            steps = [crowd_substep.move_agents(world, population, substep) for population in world.populations.values()]
            if stances is not None:
                clear_steps = [step for step in steps if step is not None]
                for step in clear_steps:
                    step.record_stances()
                near = contact_solver.resolve_contacts(world, stances, world.dt / world.setting.substeps)
                for step in clear_steps:
                    step.correct_moved_bodies()
                if stances.stances is not None and near is not None:
                    take_back_overlapping_steps(world, stances.stances, near)
                if world.notes is not None:
                    world.notes.undo_forbidden_pushes(world, stances.positions, world.dt / world.setting.substeps)
        if world.notes is not None:
            world.notes.restore_speeds(world)
    check_periodic_steps(world)


def record_measures(world: World) -> None:
    """Add the step to the measures of motion."""
    with np.errstate(all="ignore"):
        world.motion.record_step(world)


def apply_births(world: World) -> None:
    """Remove dead agents, add newborn agents, and create agents of crowd lines that are due."""
    _resolve_requests("births", world)
    lifecycle.initialise_cells_of_newborn(world)
    releases.release_agents(world)
    faults.collect_faults(world)  # count the faults of births before rows and frame change


def commit_step(world: World) -> None:
    """Make the values written in this step the values that agents sense in the next step."""
    world.frame, world.is_stepping = world.display_frame, False
    by_place = (world.frame - world.setting.first_frame - 1) % _SORT_INTERVAL_FRAMES == 0  # also after the first step
    for population in world.populations.values():
        for name in population.events:
            population.events[name], population.raised_events[name] = population.raised_events[name], population.events[name]
            population.raised_events[name].fill(False)
        sorts = by_place and len(population) >= _MIN_AGENTS_TO_SORT
        threads = world.options.threads
        publish_state(population, threads, _sort_rows_by_position(population, threads) if sorts else None)


def _sort_rows_by_position(population: Population, threads: int) -> NDArray[np.intp]:
    """Return the rows sorted along the space-filling curve of G. Morton (1966), so that agents near each other are near in
    memory.

    Only speed depends on this order."""
    low, high = population.position.min(axis=0), population.position.max(axis=0)
    width = max(float((high - low).max()), 1e-9) / 1023
    return sort_stably(compute_morton_codes(((population.position - low) / width).astype(np.uint64), threads))


def _count_transitions(world: World, population: Population) -> None:
    """Add the transitions of this step to the world's counts of transitions."""
    for machine in population.plan.machines:
        name = f"{machine.name}.state"
        if population.plan.registers[name].kind is not ValueKind.I32 or not len(population):
            continue
        previous_states, next_states = population.start[name], population.now[name]
        (changed,) = (previous_states != next_states).nonzero()
        if changed.size:
            count = len(machine.states)
            numbers = np.bincount(previous_states[changed].astype(np.int64) * count + next_states[changed])
            for pair in numbers.nonzero()[0].tolist():
                key = f"{population.name}.{machine.states[pair // count]}->{machine.states[pair % count]}"
                world.transitions[key] = world.transitions.get(key, 0) + int(numbers[pair])


# The function that applies an effect, by op; the effect's phase calls it.
RESOLVER_BY_EFFECT: dict[str, Callable[[World], None]] = {
    "deposit": lifecycle.apply_deposits,
    "carve": digging.apply_dig_requests,
    "emit": lifecycle.raise_events,
    "spawn": lifecycle.apply_deaths_and_births,
    "die": lifecycle.apply_deaths_and_births,
}

PHASES: tuple[tuple[str, Callable[[World], None]], ...] = (
    ("sense", prepare_senses),  # first: senses of the last step are invalid
    ("decide", run_decisions),
    ("claim", resolve_claims),  # before acting: only winners change state
    ("act", run_actions),
    ("blend", combine_layers),  # after acting: the new state steers at once
    ("effects", apply_effects),  # after all reads of this step
    ("fields", advance_fields),  # spread and evaporate, then add deposits: a deposit at t is complete at t+1
    ("solids", partial(_resolve_requests, "solids")),  # before moving: a digging agent moves into the hole that it dug
    ("move", move_all_agents),
    ("motion", record_measures),  # before the ground moves: being carried is not a step
    ("strides", feet_step.record_ground_covered),  # before the ground moves: feet step over it, then move with it
    ("carry", moving_geometry.move_geometry),  # after walking: agents move with the ground that they reached
    ("births", apply_births),  # after moving: a child starts at its parent's new position
    ("feet", feet_step.step_feet),  # last: all agents of the frame exist, and the ground is in its new position
    ("commit", commit_step),
)


_MAX_UNTIMED_PHASE_SECONDS = 200e-6  # s
_LAST_PHASE = PHASES[-1][0]


def step(world: World) -> None:
    """Advance a world by one frame.

    Raises FaultStop after the step is complete, if it had a fault and `on_fault` is `stop`. Raises LimitStop in the middle of
    a step that would exceed a limit."""
    if has_standard_floats():
        _run_phases(world)
        return
    with use_standard_floats():
        _run_phases(world)


def _run_phases(world: World) -> None:
    started, worked = perf_counter(), process_time()
    timings, spent = world.timings, world.cpu_seconds
    for name, phase in PHASES:
        phase(world)
        ended = perf_counter()
        passed = ended - started
        # Reading the CPU clock takes longer than many phases of a small crowd. Such phases get their wall time, and the next
        # longer phase gets the remainder.
        processor_time = worked + passed if passed < _MAX_UNTIMED_PHASE_SECONDS and name != _LAST_PHASE else process_time()
        timings[name] = timings.get(name, 0.0) + passed
        spent[name] = spent.get(name, 0.0) + processor_time - worked
        started, worked = ended, processor_time
    if world.faults.fault_of_step is not None and world.options.on_fault == "stop":
        raise FaultStop(world.faults.fault_of_step)
