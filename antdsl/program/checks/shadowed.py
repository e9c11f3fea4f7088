"""Transitions after one that is true whenever they are: the first true one wins, so they have no effect."""

from __future__ import annotations

from antdsl.diagnostics import Label, Report
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.program.checks.analysis.conditions import ConditionReader, implies, is_always, is_never
from antdsl.program.model import Expr, Transition
from antdsl.program.types.folding import constant_behind
from antdsl.source import Span


def check_shadowed(checked: CheckContext, report: Report) -> None:
    reader = ConditionReader(checked.program.params)
    for species in checked.program.species.values():
        for machine in species.machines:
            above: dict[Span, list[Transition | None]] = {}  # `from any` stands in many states, and may count in some
            changes: dict[Span, Transition] = {}
            for state in machine.states:
                for place, change in enumerate(state.transitions):
                    first = next((each for each in state.transitions[:place] if _is_hiding(reader, each, change)), None)
                    above.setdefault(change.span, []).append(first)
                    changes[change.span] = change
            for span, earlier_changes in above.items():
                if earlier_changes[0] is not None and None not in earlier_changes:
                    _report_shadowed(reader, changes[span], earlier_changes[0], report)


def _report_shadowed(reader: ConditionReader, change: Transition, first: Transition, report: Report) -> None:
    certain = first.delay is None and first.held is None and is_always(reader, first.condition)
    label = "this one always happens" if certain else "this one happens whenever the other could"
    advice = f"move it above the one that {'always happens' if certain else 'comes first'}"
    report.warning("shadowed-change", "this change is never looked at", change.span, advice, labels=(Label(first.span, label),))


def _is_hiding(reader: ConditionReader, first: Transition, change: Transition) -> bool:
    """Whether the upper one happens whenever the lower one could. One that takes something may find nothing to take."""
    if first.take is not None or not _is_earlier(first.delay, change.delay) or not _is_earlier(first.held, change.held):
        return False
    if change.condition is not None and is_never(reader, change.condition):
        return False  # that one is reported already, whatever is above it
    return implies(reader, change.condition, first.condition)


def _is_earlier(first: Expr | None, other: Expr | None) -> bool:
    """Return whether the first waiting time has passed whenever the other has."""
    if first is None:
        return True
    a, b = constant_behind(first), (constant_behind(other) if other is not None else None)
    return a is not None and b is not None and (a.u, a.step) == (b.u, b.step) and a.number <= b.number
