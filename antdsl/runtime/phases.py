"""One step: its phases in order, each with the time that passed and that of the processors. The tuple PHASES is the definition
of the order; the language reference draws it.

Others, items and fields are read as they were when the step began (`start`, `seen`); what is written shows in the next step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter, process_time

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.float_environment import is_standard, standard_floats
from antdsl.numerics.sorting import morton_codes, stable_order
from antdsl.plan.ir import ValueKind
from antdsl.program.tables.effects import effects_of_phase
from antdsl.runtime import claims, digging, faults, lifecycle
from antdsl.runtime.faults import FaultStop
from antdsl.runtime.feet import walking
from antdsl.runtime.moving import advance, contacts, moving_geometry, tilting, walks
from antdsl.runtime.world import PUSHED_REGISTER, Population, World, publish_state

_SORT_INTERVAL_FRAMES, _MIN_AGENTS_TO_SORT = 16, 2048  # frames, agents


def sense(world: World) -> None:
    """Clear the senses, show the items' amounts, solve flows that are due, and find each agent's cells. Senses are computed when
    first needed. From here on, `time` and `frame` are those of the new frame."""
    world.stepping = True
    world.grids.clear()
    world.trees.clear()
    world.clearances.clear()
    world.touching = None
    world.faults.latest = None
    for items in world.items.values():
        items.show()
    for flow in world.flows.values():
        flow.begin(world)
    for population in world.populations.values():
        lifecycle.find_cells(world, population)
        tilting.lay_headings(population, world.options.threads)
        population.clear_temps(world.options.threads)
    if world.detail is not None:
        world.detail.observe(world)
    world.backend.begin(world)


def decide(world: World) -> None:
    """Run handlers, latches and transitions: what each agent intends to do."""
    _run_block(world, "decide")


def claim(world: World) -> None:
    """Settle the claims: decide which agents get what they requested."""
    claims.settle(world)


def act(world: World) -> None:
    """Run the actions of transitions, and the body of the new state. Changes are counted before the dead are removed."""
    _run_block(world, "act")
    for population in world.populations.values():
        _count_transitions(world, population)
    for watch in world.watchers:
        watch(world)


def blend(world: World) -> None:
    """Layers: the wishes become one push."""
    _run_block(world, "blend")
    faults.gather(world)


def _run_block(world: World, block: str) -> None:
    for population in world.populations.values():
        rows = walks.deciding_rows(world, population)
        if len(population) if rows is None else len(rows):
            world.backend.run(world, population, block, rows)


def effects(world: World) -> None:
    """Apply gifts, and what is settled before anything spreads or moves: events for the next step, deposits. Their order does not
    matter: none reads what another writes."""
    _settle_requests("effects", world)
    claims.settle_gifts(world)


def _settle_requests(phase: str, world: World) -> None:
    """Settle the requests of a phase, by the rows; a function that settles several is called once."""
    if any([population.effects.requests for population in world.populations.values()]):
        for settle in dict.fromkeys(SETTLER_BY_EFFECT[op] for op in effects_of_phase(phase)):
            settle(world)


def fields(world: World) -> None:
    """Fields spread and fade; then deposits land."""
    for name, field in world.fields.items():
        keep, diffusion = world.field_rates[name]
        field.step(float(keep), diffusion, world.dt, world.options.threads)


def move(world: World) -> None:
    """Move all agents along the surfaces, substep by substep; then separate overlapping bodies."""
    with np.errstate(all="ignore"):
        for population in world.populations.values():
            tilting.restore_bodies(population)
            if PUSHED_REGISTER in population.now:
                population.now[PUSHED_REGISTER].fill(0)
        for substep in range(world.setting.substeps):
            stances = contacts.record_stances(world)
            for population in world.populations.values():
                advance.move_agents(world, population, substep)
            if stances is not None:
                contacts.resolve_contacts(world, stances, world.dt / world.setting.substeps)


def measure(world: World) -> None:
    """Adds the step to the measures of motion."""
    with np.errstate(all="ignore"):
        world.motion.observe(world)


def apply_births(world: World) -> None:
    """Remove dead agents from the populations and add newborn ones."""
    _settle_requests("births", world)
    lifecycle.settle_newborn(world)
    faults.gather(world)  # of births, while their rows and the frame are still these


def commit(world: World) -> None:
    """Make what was written in this step the state that agents see in the next."""
    world.frame, world.stepping = world.display_frame, False
    by_place = (world.frame - world.setting.first_frame - 1) % _SORT_INTERVAL_FRAMES == 0  # after the first step, too
    for population in world.populations.values():
        for name in population.events:
            population.events[name], population.raised[name] = population.raised[name], population.events[name]
            population.raised[name].fill(False)
        sorts = by_place and len(population) >= _MIN_AGENTS_TO_SORT
        threads = world.options.threads
        publish_state(population, threads, _order_by_position(population, threads) if sorts else None)


def _order_by_position(population: Population, threads: int) -> NDArray[np.intp]:
    """Return rows in order of position, along the curve of G. Morton (1966): neighbours in space are then neighbours in memory.
    No result depends on it."""
    low, high = population.position.min(axis=0), population.position.max(axis=0)
    width = max(float((high - low).max()), 1e-9) / 1023
    return stable_order(morton_codes(((population.position - low) / width).astype(np.uint64), threads))


def _count_transitions(world: World, population: Population) -> None:
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


# What settles an effect, by its row's op; the phase that the row names calls it.
SETTLER_BY_EFFECT: dict[str, Callable[[World], None]] = {
    "deposit": lifecycle.deposit,
    "carve": digging.dig,
    "emit": lifecycle.raise_events,
    "spawn": lifecycle.apply_deaths_and_births,
    "die": lifecycle.apply_deaths_and_births,
}

PHASES: tuple[tuple[str, Callable[[World], None]], ...] = (
    ("sense", sense),  # first: nothing sensed in the last step holds any more
    ("decide", decide),
    ("claim", claim),  # before acting: only winners change state
    ("act", act),
    ("blend", blend),  # after acting: the new state steers at once
    ("effects", effects),  # after every read of this step
    ("fields", fields),  # what is there spreads and fades, then deposits land: what is laid at t is whole at t+1
    ("solids", partial(_settle_requests, "solids")),  # before moving: who digs goes on into what it dug
    ("move", move),
    ("motion", measure),  # before the ground goes on: what it carries along is no step of theirs
    ("strides", walking.measure),  # with it: feet step over the ground, and stand on it as it goes on
    ("carry", moving_geometry.move_world),  # after walking: who has walked stands on ground that goes on from here
    ("births", apply_births),  # after moving: a child starts where its parent is now
    ("feet", walking.walk),  # once all are there who are seen in the frame, and all that feet stand on is where it is
    ("commit", commit),
)


_SHORT_PHASE_SECONDS = 200e-6  # s
_LAST_PHASE = PHASES[-1][0]


def step(world: World) -> None:
    """Advance by one frame. Raises FaultStop after a complete step with a fault, if the options say `stop`. Raises LimitStop in
    the middle of a step that would exceed the limits."""
    if is_standard():
        _step(world)
        return
    with standard_floats():
        _step(world)


def _step(world: World) -> None:
    started, worked = perf_counter(), process_time()
    timings, spent = world.timings, world.worked
    for name, phase in PHASES:
        phase(world)
        ended = perf_counter()
        passed = ended - started
        # The processors' clock takes longer to read than many a phase of a small crowd: those have what passed, and the next that
        # takes longer the rest.
        processor_time = worked + passed if passed < _SHORT_PHASE_SECONDS and name != _LAST_PHASE else process_time()
        timings[name] = timings.get(name, 0.0) + passed
        spent[name] = spent.get(name, 0.0) + processor_time - worked
        started, worked = ended, processor_time
    if world.faults.latest is not None and world.options.on_fault == "stop":
        raise FaultStop(world.faults.latest)
