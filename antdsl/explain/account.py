"""Builds the report on an agent's step, the result of `explain`, from the trace and the world before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from antdsl.explain.changing import changes, did
from antdsl.explain.deciding import machine_step
from antdsl.explain.model import Explanation, MachineStep, Triple
from antdsl.explain.pushing import layers, pushed, steers
from antdsl.explain.replaying import Replay
from antdsl.explain.sensing import draws, fields, seen, senses
from antdsl.explain.tracing import Trace
from antdsl.explain.value_text import place, triple
from antdsl.plan.lowering.source_map import resting_site
from antdsl.program.model import Handler, Species
from antdsl.runtime.world import AXES, Population, World

PLACES = 256  # of each set


@dataclass(frozen=True, slots=True)
class Account:
    """An explanation with positions, in mm relative to the world's origin: of the agent at the start of the step, and of the
    agents and items it considered. The nearest of each set comes first."""

    explanation: Explanation
    place: Triple
    neighbours: tuple[Triple, ...]


def accounts(replay: Replay, frame: int, agents: Sequence[tuple[str, int]]) -> list[Explanation | None]:
    """Return what each agent (species, id) did in the step to a frame, without its state timeline. None for an agent that did not
    live when the step began, or was in quarantine. Raises ExplainError if the step cannot be repeated."""
    return [None if each is None else each.explanation for each in placed_accounts(replay, frame, agents)]


def placed_accounts(replay: Replay, frame: int, agents: Sequence[tuple[str, int]]) -> list[Account | None]:
    """As `accounts`, with the places."""

    def look(world: World, population: Population, trace: Trace) -> tuple[Trace, Account]:
        return trace, Account(_account(replay, frame, world, population, trace), *_places(trace))

    done = replay.step(frame, agents, look)
    found: list[Account | None] = []
    for each in done.seen:
        if each is None:
            found.append(None)
            continue
        trace, made = each
        told = _ended(replay, done.after, trace, made.explanation)
        found.append(replace(made, explanation=replace(told, hash=done.hash, checkpoint=done.checkpoint)))
    return found


def _places(trace: Trace) -> tuple[Triple, tuple[Triple, ...]]:
    """Return the position of the agent at the start of the step, and those of the agents that it looked at, each once."""
    own = triple(trace.before[f"position.{axis}"] for axis in AXES)
    near = [member for members in trace.sets.values() for member in sorted(members, key=lambda m: float(m[4]))[:PLACES]]
    found = (triple(own[k] + float(member[1 + k]) for k in range(3)) for member in near)
    return own, tuple(dict.fromkeys(found))


def _collides(handler: Handler, trace: Trace) -> bool:
    """Return whether a handler of collisions has run: its agent has begun to touch another."""
    if handler.event != "collision":
        return False
    return any(node.op == "contact" and node.attrs[0] == handler.of and value[0] != -1 for node, value in trace.senses.items())


def _account(replay: Replay, frame: int, world: World, population: Population, trace: Trace) -> Explanation:
    """Return all that is known before the effects of the step."""
    program = replay.shot.program.species[population.name]
    notes = replay.notes[population.name]
    machines = tuple(machine_step(world, population, machine, notes, trace) for machine in population.plan.machines)
    fps = world.setting.fps
    velocity = triple(trace.before[f"velocity.{axis}"] for axis in AXES)
    handlers = tuple(
        place(handler.span)
        for handler in program.handlers
        if (handler.event in population.events and population.events[handler.event][trace.row]) or _collides(handler, trace)
    )
    return Explanation(
        scene=Path(replay.shot.scene.source.path).name,
        species=population.name,
        agent=int(population.ids[trace.row]),
        frame=frame,
        fps=f"{fps.numerator}/{fps.denominator}",
        hash="",
        checkpoint=0,
        mode=program.layers.mode,
        strip=(),
        alive=None,
        notes=(),
        machines=machines,
        handlers=handlers,
        steers=steers(population.name, notes, trace, _sites(program, machines)),
        layers=layers(world, program.layers.mode, notes, trace),
        push=triple(pushed(trace)),
        velocity=(velocity, None),
        acceleration=None,
        seen=seen(world, trace),
        fields=fields(world, population, trace.row),
        senses=senses(trace),
        draws=draws(trace),
        did=did(trace.effects),
        changes=(),
    )


def _sites(species: Species, machines: Sequence[MachineStep]) -> tuple[str, ...]:
    """Return the code sites that run for this agent in this step. These are the bodies of its current states, or the default
    where none of them has a `steer` line; and the layers' `face` lines."""
    found = [f"{species.name}.{m.machine}.{m.after}#" for m in machines]
    found += [f"{species.name}.{m.machine}.{m.after}.enter#" for m in machines if m.changed]
    found.append(f"{species.name}.layers.face#")
    rest = species.rest
    if rest is not None:
        states = {m.name: [state.name for state in m.states] for m in species.machines}
        here = {m.machine: states[m.machine].index(m.after) for m in machines}
        if all(here[name] in silent for name, silent in rest.silent.items()):
            found.append(resting_site(species.name))
    return tuple(found)


def _ended(replay: Replay, world: World, trace: Trace, told: Explanation) -> Explanation:
    """Return the explanation with the results of the step; an agent that died in the step has no more."""
    population = world.populations[told.species]
    row = int(population.rows_of(np.array([told.agent]))[0])
    if row < 0:
        return replace(told, notes=(f"it died in this step: frame {told.frame} is without it",))
    velocity: Triple = triple(population.now[f"velocity.{axis}"][row] for axis in AXES)
    gained = triple((after - before) / world.dt for before, after in zip(told.velocity[0], velocity, strict=True))
    species = replay.shot.program.species[told.species]
    return replace(
        told,
        velocity=(told.velocity[0], velocity),
        acceleration=gained,
        changes=changes(world, population, species, trace, told.agent),
    )
