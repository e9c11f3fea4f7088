"""Reports states that no transition enters or leaves, and transitions that cannot happen.

A transition cannot happen if an earlier one always happens first, or if its condition never holds. Conditions that always hold
are also reported. The analysis uses only comparisons with constants."""

from __future__ import annotations

from antdsl.diagnostics import Label, Report
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.checks.analysis.conditions import ConditionReader, does_condition_imply, is_always_false, is_always_true
from antdsl.program.model import ClipTest, Constant, EffectRequest, Expr, Machine, OperationExpr, Play, Species, State, Transition
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import find_constant
from antdsl.source import Span


def check_reachability(context: CheckContext, report: Report) -> None:
    """Report states that cannot be reached, and states that cannot be left."""
    for species in context.program.species.values():
        for machine in species.machines:
            reached = _find_reachable_states(machine)
            for state in machine.states:
                if state.index not in reached:
                    _report_unreachable(machine, state, report)
                elif len(machine.states) > 1 and _is_stuck(state):
                    advice = f"write `when … -> {machine.states[machine.start].name}` in it, or `die` if the animal leaves"
                    report.warning("trap", f"no transition leaves state `{state.name}`", state.span, advice)


def _find_reachable_states(machine: Machine) -> set[int]:
    """Return the indices of the states that can be reached from the start state. The target `previous` does not make further
    states reachable."""
    reached: set[int] = set()
    stack = [machine.start]
    while stack:
        index = stack.pop()
        if index in reached or index >= len(machine.states):
            continue
        reached.add(index)
        for change in machine.states[index].transitions:
            stack += [change.target] if change.target is not None else [choice for choice, _ in change.choices]
    return reached


def _report_unreachable(machine: Machine, state: State, report: Report) -> None:
    start = machine.states[machine.start].name
    advice = f"write `when … -> {state.name}` in state `{start}` or another, or delete it"
    report.warning("unreachable-state", f"no transition leads to state `{state.name}`", state.span, advice)


def _is_stuck(state: State) -> bool:
    leaves = any(
        isinstance(line, EffectRequest) and EFFECT_BY_OPERATION[line.op].removes_agent for line in (*state.body, *state.enter)
    )
    return not state.transitions and not leaves


def check_shadowed_transitions(context: CheckContext, report: Report) -> None:
    """Report transitions that never happen because an earlier transition of the same state always happens first."""
    reader = ConditionReader(context.program.params)
    for species in context.program.species.values():
        for machine in species.machines:
            # a `from any` is in many states, and may be effective in only some of them
            above: dict[Span, list[Transition | None]] = {}
            changes: dict[Span, Transition] = {}
            for state in machine.states:
                for place, change in enumerate(state.transitions):
                    first = next((each for each in state.transitions[:place] if _is_shadowing(reader, each, change)), None)
                    above.setdefault(change.span, []).append(first)
                    changes[change.span] = change
            for span, earlier_changes in above.items():
                if earlier_changes[0] is not None and None not in earlier_changes:
                    _report_shadowed(reader, changes[span], earlier_changes[0], report)


def _report_shadowed(reader: ConditionReader, change: Transition, first: Transition, report: Report) -> None:
    certain = first.delay is None and first.hold_time is None and is_always_true(reader, first.condition)
    label = "this transition always happens" if certain else "this transition happens whenever the later one could"
    advice = f"move it above the one that {'always happens' if certain else 'comes first'}"
    if first.take_action is not None:
        label = "this transition is chosen whenever the later one could be; if its `take` fails, the agent stays in its state"
        advice = "add a condition to the first transition that fails when nothing is left, such as `and food.load > 0`"
    report.warning("shadowed-change", "this transition never happens", change.span, advice, labels=(Label(first.span, label),))


def _is_shadowing(reader: ConditionReader, first: Transition, change: Transition) -> bool:
    """Return whether the earlier transition `first` always happens instead of the later transition `change`.

    This is also so if `first` has a `take`. In a step in which the take fails, no other transition is tried."""
    if not _is_wait_shorter(first.delay, change.delay) or not _is_wait_shorter(first.hold_time, change.hold_time):
        return False
    if change.condition is not None and is_always_false(reader, change.condition):
        return False  # a condition that never holds is already reported
    return does_condition_imply(reader, change.condition, first.condition)


def _is_wait_shorter(first: Expr | None, other: Expr | None) -> bool:
    """Compare two waiting times. Return whether `first` has elapsed in every case in which `other` has elapsed."""
    if first is None:
        return True
    a, b = find_constant(first), (find_constant(other) if other is not None else None)
    return a is not None and b is not None and (a.unit_power, a.step) == (b.unit_power, b.step) and a.number <= b.number


def check_constant_conditions(context: CheckContext, report: Report) -> None:
    """Report transitions with a condition that never or always holds."""
    reader = ConditionReader(context.program.params)
    for species in context.program.species.values():
        for machine in species.machines:
            for state in machine.states:
                for change in state.transitions:
                    _check_transition(reader, change, report)
                _check_clip_waits(species, machine, state, report)


def _check_transition(reader: ConditionReader, change: Transition, report: Report) -> None:
    test = change.condition
    if test is None or _is_boolean_literal(test):
        return
    if is_always_false(reader, test):
        message = f"{quote_source(test.span)} can never hold"
        report.warning("never-fires", message, test.span, "change one of its numbers, or delete the transition")
    elif is_always_true(reader, test):
        message = f"{quote_source(test.span)} always holds"
        report.warning("always-fires", message, test.span, "change one of its numbers, or write `when true` if that is meant")


def _check_clip_waits(species: Species, machine: Machine, state: State, report: Report) -> None:
    """Report transitions that wait for the clip of a state without a clip.

    Transitions `from any` are not reported, because they may be meant for other states."""
    if any(isinstance(line, Play) for line in state.body):
        return
    for change in state.transitions:
        test = change.condition
        if test is None or not change.key.startswith(f"{species.name}.{machine.name}.{state.name}->"):
            continue
        for part in _split_conjunction(test):
            if isinstance(part, ClipTest) and part.machine == machine.name:
                message = f"{quote_source(part.span)} never holds in `{state.name}`, which plays no clip"
                advice = f"write `play {'walk' if not part.mark else 'dig'}` or another clip as a line of `{state.name}`"
                report.warning("never-fires", message, part.span, advice)


def _split_conjunction(test: Expr) -> list[Expr]:
    """Return the parts of a condition that are joined by `and`."""
    if isinstance(test, OperationExpr) and test.name == "and":
        return [part for arg in test.args if arg is not None for part in _split_conjunction(arg)]
    return [test]


def _is_boolean_literal(test: Expr) -> bool:
    """Return whether a condition is the word `true` or `false`. Such a condition is constant on purpose."""
    return isinstance(test, Constant)
