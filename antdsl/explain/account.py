"""The account of an agent's step: what `explain` gives, put together from the trace and the world before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from antdsl.explain.changing import changes, did
from antdsl.explain.deciding import machine_step
from antdsl.explain.model import Explanation, MachineStep, Triple
from antdsl.explain.pushing import layers, pushed, steers
from antdsl.explain.replaying import Replay
from antdsl.explain.sensing import draws, fields, seen, senses
from antdsl.explain.tracing import Trace
from antdsl.explain.values import place, triple
from antdsl.runtime.world import AXES, Population, World


def accounts(replay: Replay, frame: int, agents: Sequence[tuple[str, int]]) -> list[Explanation | None]:
    """What each agent (species, id) did in the step to a frame, without its strip; None for who did not live when it began, or
    was set aside after a fault. ExplainError when the step cannot be done again."""

    def look(world: World, population: Population, trace: Trace) -> tuple[Trace, Explanation]:
        return trace, _account(replay, frame, world, population, trace)

    done = replay.step(frame, agents, look)
    found: list[Explanation | None] = []
    for each in done.seen:
        if each is None:
            found.append(None)
            continue
        trace, told = each
        found.append(replace(_ended(replay, done.after, trace, told), hash=done.hash, checkpoint=done.checkpoint))
    return found


def _account(replay: Replay, frame: int, world: World, population: Population, trace: Trace) -> Explanation:
    """All that is known before the step has its effects."""
    program = replay.shot.program.species[population.name]
    notes = replay.notes[population.name]
    machines = tuple(machine_step(world, population, machine, notes, trace) for machine in population.plan.machines)
    velocity = triple(trace.before[f"velocity.{axis}"] for axis in AXES)
    handlers = tuple(
        place(handler.span)
        for handler in program.handlers
        if handler.event in population.events and population.events[handler.event][trace.row]
    )
    return Explanation(
        scene=Path(replay.shot.scene.source.path).name,
        species=population.name,
        agent=int(population.ids[trace.row]),
        frame=frame,
        fps=replay.cache.manifest.fps,
        hash="",
        checkpoint=0,
        mode=program.layers.mode,
        strip=(),
        alive=None,
        notes=(),
        machines=machines,
        handlers=handlers,
        steers=steers(population.name, notes, trace, _sites(population.name, machines)),
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


def _sites(species: str, machines: Sequence[MachineStep]) -> tuple[str, ...]:
    """Where lines of text run for this agent in this step: the bodies of the states that it is in."""
    found = [f"{species}.{m.machine}.{m.after}#" for m in machines]
    found += [f"{species}.{m.machine}.{m.after}.enter#" for m in machines if m.changed]
    return tuple(found)


def _ended(replay: Replay, world: World, trace: Trace, told: Explanation) -> Explanation:
    """With what came of it; of one who died in the step there is nothing more."""
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
