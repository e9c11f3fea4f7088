"""The report on an agent's step, which is the result of `explain`. It is made from the trace and the worlds before and after the
step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from antdsl.explain.layer_report import build_layer_reports, find_steering_lines, read_total_push
from antdsl.explain.machine_report import build_machine_step
from antdsl.explain.model import Explanation, FloatTriple, MachineStep
from antdsl.explain.replaying import StepReplay
from antdsl.explain.sense_report import list_observed_sets, list_random_draws, list_sense_readings, read_field_values
from antdsl.explain.step_effects import describe_effects, list_changes
from antdsl.explain.tracing import AgentTrace
from antdsl.explain.value_text import locate_span, to_float_triple
from antdsl.plan.lowering.source_map import make_resting_site
from antdsl.program.model import Handler, Species
from antdsl.runtime.notes.active_notes import NotedAgents
from antdsl.runtime.world import AXES, Population, World

MAX_NEIGHBOUR_POSITIONS = 256  # maximum per set


@dataclass(frozen=True, slots=True)
class LocatedExplanation:
    """An explanation with positions in mm, relative to the world's origin. They are the agent's position at the start of the
    step, and the positions of the agents and items that it considered. The nearest of each set come first."""

    explanation: Explanation
    position: FloatTriple
    neighbour_positions: tuple[FloatTriple, ...]


def explain_agents(replay: StepReplay, frame: int, agents: Sequence[tuple[str, int]]) -> list[Explanation | None]:
    """Return, for each agent (species, id), what it did in the step that leads to `frame`. Its states over time are not
    included. The entry of an agent that was dead at the start of the step, or in quarantine, is None. Raises ExplainError if
    the step cannot be simulated again."""
    return [None if each is None else each.explanation for each in explain_agents_with_positions(replay, frame, agents)]


def explain_agents_with_positions(
    replay: StepReplay, frame: int, agents: Sequence[tuple[str, int]]
) -> list[LocatedExplanation | None]:
    """Return the results of `explain_agents`. Each is completed with the positions of the agent and of everything that it
    considered."""

    def explain_agent(world: World, population: Population, trace: AgentTrace) -> tuple[AgentTrace, LocatedExplanation]:
        return trace, LocatedExplanation(_build_explanation(replay, frame, world, population, trace), *_find_positions(trace))

    step = replay.replay_step(frame, agents, explain_agent)
    explanations: list[LocatedExplanation | None] = []
    for each in step.results:
        if each is None:
            explanations.append(None)
            continue
        trace, located = each
        explanation = _add_effects(replay, step.end_world, trace, located.explanation)
        explanations.append(replace(located, explanation=replace(explanation, hash=step.hash, checkpoint=step.checkpoint)))
    return explanations


def _find_positions(trace: AgentTrace) -> tuple[FloatTriple, tuple[FloatTriple, ...]]:
    """Return the agent's position at the start of the step. Also return the positions of the agents and items that it
    considered, without duplicates."""
    position = to_float_triple(trace.start_registers[f"position.{axis}"] for axis in AXES)
    near = [
        member
        for members in trace.set_members.values()
        for member in sorted(members, key=lambda m: float(m[4]))[:MAX_NEIGHBOUR_POSITIONS]
    ]
    positions = (to_float_triple(position[k] + float(member[1 + k]) for k in range(3)) for member in near)
    return position, tuple(dict.fromkeys(positions))


def _has_collided(handler: Handler, trace: AgentTrace) -> bool:
    """Return whether a collision handler has run because the agent has just begun to touch another agent."""
    if handler.event != "collision":
        return False
    return any(
        node.op == "contact" and node.attrs[0] == handler.other_species and value[0] != -1 for node, value in trace.senses.items()
    )


def _build_explanation(replay: StepReplay, frame: int, world: World, population: Population, trace: AgentTrace) -> Explanation:
    """Return the explanation of a step, without the effects of the step on the agent. `_add_effects` adds these."""
    program = replay.shot.program.species[population.name]
    notes = replay.notes[population.name]
    machines = tuple(build_machine_step(world, population, machine, notes, trace) for machine in population.plan.machines)
    fps = world.setting.fps
    velocity = to_float_triple(trace.start_registers[f"velocity.{axis}"] for axis in AXES)
    handlers = tuple(
        locate_span(handler.span)
        for handler in program.handlers
        if (handler.event in population.events and population.events[handler.event][trace.row]) or _has_collided(handler, trace)
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
        notes=_list_scene_notes(replay, world, population, trace.row),
        machines=machines,
        handlers=handlers,
        steers=find_steering_lines(population.name, notes, trace, _find_active_sites(program, machines)),
        layers=build_layer_reports(world, program.layers.mode, notes, trace),
        push=to_float_triple(read_total_push(trace)),
        velocity=(velocity, None),
        acceleration=None,
        seen=list_observed_sets(world, trace),
        fields=read_field_values(world, population, trace.row),
        senses=list_sense_readings(trace),
        draws=list_random_draws(trace),
        did=describe_effects(trace.effects),
        changes=(),
    )


def _list_scene_notes(replay: StepReplay, world: World, population: Population, row: int) -> tuple[str, ...]:
    """Return a sentence for each note of the scene that directs the agent in `row` in this step."""
    scene = replay.shot.scene
    lines = []
    for active in world.notes.active_notes if world.notes is not None else ():
        at = np.flatnonzero(active.rows.get(population.name, np.empty(0, np.intp)) == row)
        if len(at):
            where = locate_span(scene.find_span("notes", scene.model.notes.index(active.note)))
            agents = NotedAgents(world, active, population).select_agents(at)
            words = f"the scene directs it by {where.text} in {Path(where.file).name}:{where.line}, "
            later = f", {agents.delays[0]} frames later than the note" if agents.delays[0] else ""
            lines.append(f"{words}with weight {agents.weight[0]:.3g}{later}")
    return tuple(lines)


def _find_active_sites(species: Species, machines: Sequence[MachineStep]) -> tuple[str, ...]:
    """Return the code sites that run for this agent in the step. If none of its current states steers, the site of the default
    push is included."""
    sites = [f"{species.name}.{m.machine}.{m.after}#" for m in machines]
    sites += [f"{species.name}.{m.machine}.{m.after}.enter#" for m in machines if m.changed]
    sites.append(f"{species.name}.layers.face#")
    rest = species.rest
    if rest is not None:
        states = {m.name: [state.name for state in m.states] for m in species.machines}
        state_indices = {m.machine: states[m.machine].index(m.after) for m in machines}
        if all(state_indices[name] in silent for name, silent in rest.resting_states.items()):
            sites.append(make_resting_site(species.name))
    return tuple(sites)


def _add_effects(replay: StepReplay, world: World, trace: AgentTrace, explanation: Explanation) -> Explanation:
    """Return the explanation with the effects of the step added. For an agent that died in the step, add only a note."""
    population = world.populations[explanation.species]
    row = int(population.find_rows(np.array([explanation.agent]))[0])
    if row < 0:
        death = f"it died in this step, so frame {explanation.frame} does not contain it"
        return replace(explanation, notes=(*explanation.notes, death))
    velocity: FloatTriple = to_float_triple(population.now[f"velocity.{axis}"][row] for axis in AXES)
    gained = to_float_triple(
        (new_component - old_component) / world.dt
        for old_component, new_component in zip(explanation.velocity[0], velocity, strict=True)
    )
    species = replay.shot.program.species[explanation.species]
    return replace(
        explanation,
        velocity=(explanation.velocity[0], velocity),
        acceleration=gained,
        changes=list_changes(world, population, species, trace, explanation.agent),
    )
