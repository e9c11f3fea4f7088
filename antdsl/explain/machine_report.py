"""Reports on what a machine decided in a step: the transitions in order, the one taken, the claims and the random draws."""

from __future__ import annotations

import numpy as np

from antdsl.explain.model import ChoiceResult, ClaimResult, MachineStep, TransitionReport
from antdsl.explain.tracing import AgentTrace
from antdsl.explain.value_text import build_condition_part, build_timer_reading, locate_span
from antdsl.numerics import randomness
from antdsl.plan.ir import MachinePlan
from antdsl.plan.lowering.source_map import ChangeNote, ChoiceNote, SourceNotes
from antdsl.program import model
from antdsl.runtime.requests import ClaimEntry
from antdsl.runtime.world import Population, World


def build_machine_step(
    world: World, population: Population, machine: MachinePlan, notes: SourceNotes, trace: AgentTrace
) -> MachineStep:
    """Return the report on one machine of an agent. `world`: the world at the start of the step."""
    old_state = int(trace.start_registers[f"{machine.name}.state"])
    new_state = int(trace.end_registers[f"{machine.name}.state"])
    own_changes = [n for n in notes.changes if n.machine == machine.name and n.state.index == old_state]
    winner = int(trace.end_registers[f"~{machine.name}.pending"]) if own_changes else 0
    winning_change = next((note for note in own_changes if note.number == winner), None)
    claim = (
        _build_claim_result(world, population, winning_change, trace)
        if winning_change is not None and winning_change.transition.take_action is not None
        else None
    )
    changed = winning_change is not None and (claim is None or claim.won)
    choice = notes.choices.get(winning_change.transition.key) if winning_change is not None and changed else None
    return MachineStep(
        machine.name,
        machine.states[old_state],
        machine.states[new_state],
        float(trace.start_registers[f"{machine.name}.time_in_state"]),
        tuple(_build_transition_report(world, machine, note, winner, trace) for note in own_changes),
        changed,
        claim,
        None if choice is None else _build_choice_result(machine, choice, trace, new_state),
    )


def _build_transition_report(
    world: World, machine: MachinePlan, note: ChangeNote, winner: int, trace: AgentTrace
) -> TransitionReport:
    """Return the report on one transition. `winner`: the index of the transition that was taken."""
    t = note.transition
    kind = "interrupt" if t.is_interrupt else "from any" if f".{model.FROM_ANY_KEY}->" in t.key else "when"
    return TransitionReport(
        locate_span(t.span),
        kind,
        _describe_target(machine, t),
        build_condition_part(world, note.condition, trace.values),
        note.condition_value is None or bool(trace.values[note.condition_value]),
        tuple(build_timer_reading(each, trace.values) for each in note.timers),
        build_condition_part(world, note.take_note, trace.values),
        bool(trace.values[note.is_taken]),
        note.number == winner,
    )


def _describe_target(machine: MachinePlan, t: model.Transition) -> str:
    """Return a text that names the target of a transition."""
    if t.targets_previous:
        return "previous"
    if t.choices:
        return " | ".join(machine.states[index] for index, _ in t.choices)
    return machine.states[t.target] if t.target is not None else "the same"


def _build_claim_result(world: World, population: Population, taken_change: ChangeNote, trace: AgentTrace) -> ClaimResult | None:
    """Return the result of the claim that a transition made. Return None if the agent made no claim for it."""
    entry = next((each for each in trace.claims if each.statement.site == taken_change.transition.key), None)
    if entry is None:
        return None
    statement = entry.statement
    name, amount = statement.target, float(entry.amount[0])
    if statement.item is not None:
        names = world.items[statement.target].names
        item = int(entry.item[0])
        name = names[item] if 0 <= item < len(names) else "none"
    return ClaimResult(
        statement.target,
        name,
        statement.attribute or statement.register or "",
        amount if np.isfinite(amount) else None,
        _compute_claim_draw(world, population, entry, trace.row),
        bool(population.now[statement.won_register][trace.row]),
        locate_span(
            taken_change.transition.take_action.span
            if taken_change.transition.take_action is not None
            else taken_change.transition.span
        ),
    )


def _compute_claim_draw(world: World, population: Population, entry: ClaimEntry, row: int) -> float:
    """Return the random number, from 0 to 1, that determines when the agent's claim was granted among all claims."""
    ids = population.ids[row : row + 1]
    words = randomness.draw_four_words(world.setting.seed, world.frame, population.name, entry.statement.site, 0, ids)
    return float(words[0][0]) / float(np.uint64(1) << np.uint64(32))


def _build_choice_result(machine: MachinePlan, note: ChoiceNote, trace: AgentTrace, new_state: int) -> ChoiceResult | None:
    """Return the random choice that a transition with `choose` made among states. Return None if no choice was computed."""
    if note.draw not in trace.values:
        return None
    total = sum(float(trace.values[node]) for _, node in note.weights)
    bars, sum_so_far = [], 0.0
    for index, node in note.weights:
        sum_so_far += float(trace.values[node])
        bars.append((machine.states[index], sum_so_far / total if total > 0 else 0.0))
    return ChoiceResult(float(trace.values[note.draw]), tuple(bars), machine.states[new_state])
