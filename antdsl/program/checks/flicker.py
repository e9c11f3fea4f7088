"""Reports pairs of states with transitions in both directions that hold for the same values. An agent would alternate between
the two states in every step."""

from __future__ import annotations

from collections.abc import Iterator

from antdsl.diagnostics import Label, Report
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.checks.analysis.conditions import UNREADABLE_CONDITION_ERRORS, ConditionReader
from antdsl.program.model import Assign, AttributeRef, Expr, Machine, State, Transition
from antdsl.program.traverse import iterate_parts
from antdsl.program.types.descriptions import quote_source


def check_state_flicker(context: CheckContext, report: Report) -> None:
    """Report pairs of opposite transitions with conditions that can both hold for the same values."""
    reader = ConditionReader(context.program.params)
    for species in context.program.species.values():
        for machine in species.machines:
            for forward, back in _iterate_opposite_changes(machine):
                _check_pair(reader, machine, forward, back, report)


def _iterate_opposite_changes(machine: Machine) -> Iterator[tuple[tuple[State, Transition], tuple[State, Transition]]]:
    """Yield all pairs of opposite transitions: one from a state to a later state, and one back from the later state."""
    for state in machine.states:
        for change in state.transitions:
            other = machine.states[change.target] if change.target is not None else None
            if other is not None and other.index > state.index:
                for back in other.transitions:
                    if back.target == state.index:
                        yield (state, change), (other, back)


def _check_pair(
    reader: ConditionReader,
    machine: Machine,
    forward_change: tuple[State, Transition],
    backward_change: tuple[State, Transition],
    report: Report,
) -> None:
    (state, change), (other, returning) = forward_change, backward_change
    if (
        _has_minimum_time(*forward_change)
        or _has_minimum_time(*backward_change)
        or change.condition is None
        or returning.condition is None
    ):
        return
    if _affects_test(machine, forward_change, returning.condition) or _affects_test(machine, backward_change, change.condition):
        return
    if _can_both_hold(reader, change.condition, returning.condition):
        report.warning(
            "flicker",
            f"{quote_source(change.condition.span)} and {quote_source(returning.condition.span)} can hold at once: "
            f"`{state.name}` and `{other.name}` would alternate",
            returning.condition.span,
            "use two different limits, or wait: `held 0.5 s`, or `for at least 1 s` in a state",
            labels=(Label(change.condition.span, f"from `{state.name}` to `{other.name}`"),),
        )


def _has_minimum_time(state: State, change: Transition) -> bool:
    """Return whether a transition is prevented from happening in every step, because it has a waiting time, or a `take` that may
    fail."""
    return (
        change.delay is not None
        or change.hold_time is not None
        or change.take_action is not None
        or state.min_duration is not None
    )


def _can_both_hold(reader: ConditionReader, first: Expr, second: Expr) -> bool:
    """Return whether two conditions can be true at the same time. Both must compare the same value with constants; otherwise the
    result is False."""
    try:
        cases = [reader.read_cases(first), reader.read_cases(second)]
    except UNREADABLE_CONDITION_ERRORS:
        return False
    subjects = {key for each in cases for case in each for key in case.intervals}
    if len(subjects) != 1 or any(case.truth_by_test for each in cases for case in each):
        return False
    return any(a.intersect(b) is not None for a in cases[0] for b in cases[1])


def _affects_test(machine: Machine, transition: tuple[State, Transition], test: Expr) -> bool:
    """Return whether a transition changes a value that `test` reads. `test`: the condition of the opposite transition.

    The time in the state is such a value, because each transition resets it."""
    state, change = transition
    assert change.target is not None
    blocks = (state.exit, change.actions, machine.states[change.target].enter)
    written = {line.attribute for block in blocks for line in block if isinstance(line, Assign)}
    # gives change what they give, for any test
    others = any(not isinstance(line, Assign) for block in blocks for line in block)
    read = {part.name for part in iterate_parts(test) if isinstance(part, AttributeRef)}
    return others or bool(written & read) or any(name.endswith(".time_in_state") for name in read)
