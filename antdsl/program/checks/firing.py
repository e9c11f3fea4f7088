"""Changes with a condition that can never hold, or always holds, as far as its comparisons with constants show; and those that
wait for a clip where none plays."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.program.checks.analysis.conditions import ConditionReader, is_always, is_never
from antdsl.program.model import ClipTest, Const, Expr, Machine, Op, Play, Species, State, Transition
from antdsl.program.types.descriptions import quote_source


def check_firing(checked: CheckContext, report: Report) -> None:
    reader = ConditionReader(checked.program.params)
    for species in checked.program.species.values():
        for machine in species.machines:
            for state in machine.states:
                for change in state.transitions:
                    _check_change(reader, change, report)
                _check_clip_waits(species, machine, state, report)


def _check_change(reader: ConditionReader, change: Transition, report: Report) -> None:
    test = change.condition
    if test is None or _is_truth_word(test):
        return
    if is_never(reader, test):
        message = f"{quote_source(test.span)} can never hold"
        report.warning("never-fires", message, test.span, "change one of its numbers, or delete the change")
    elif is_always(reader, test):
        message = f"{quote_source(test.span)} always holds"
        report.warning("always-fires", message, test.span, "change one of its numbers, or write `when true` if that is meant")


def _check_clip_waits(species: Species, machine: Machine, state: State, report: Report) -> None:
    """Report transitions that wait for the clip of a state without a clip. A transition `from any` may be meant for other
    states."""
    if any(isinstance(line, Play) for line in state.body):
        return
    for change in state.transitions:
        test = change.condition
        if test is None or not change.key.startswith(f"{species.name}.{machine.name}.{state.name}->"):
            continue
        for part in _conjuncts(test):
            if isinstance(part, ClipTest) and part.machine == machine.name:
                message = f"{quote_source(part.span)} never holds in `{state.name}`, which plays no clip"
                advice = f"write `play {'walk' if not part.mark else 'dig'}` or another clip as a line of `{state.name}`"
                report.warning("never-fires", message, part.span, advice)


def _conjuncts(test: Expr) -> list[Expr]:
    """What all has to hold for a condition to."""
    if isinstance(test, Op) and test.name == "and":
        return [part for arg in test.args if arg is not None for part in _conjuncts(arg)]
    return [test]


def _is_truth_word(test: Expr) -> bool:
    """`true` and `false` as words are meant so."""
    return isinstance(test, Const)
