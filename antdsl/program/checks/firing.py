"""Changes with a condition that can never hold, or always holds, as far as its comparisons with constants show; and those that
wait for a clip where none plays."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import Checked
from antdsl.program.checks.analysis.conditions import Reader, always, never
from antdsl.program.model import ClipTest, Const, Expr, Machine, Op, Play, Species, State, Transition
from antdsl.program.types.descriptions import quoted


def firing(checked: Checked, report: Report) -> None:
    reader = Reader(checked.program.params)
    for species in checked.program.species.values():
        for machine in species.machines:
            for state in machine.states:
                for change in state.transitions:
                    _change(reader, change, report)
                _without_clip(species, machine, state, report)


def _change(reader: Reader, change: Transition, report: Report) -> None:
    test = change.condition
    if test is None or _word(test):
        return
    if never(reader, test):
        report.warning(
            "never-fires", f"{quoted(test.span)} can never hold", test.span, "change one of its numbers, or delete the change"
        )
    elif always(reader, test):
        report.warning(
            "always-fires",
            f"{quoted(test.span)} always holds",
            test.span,
            "change one of its numbers, or write `when true` if that is meant",
        )


def _without_clip(species: Species, machine: Machine, state: State, report: Report) -> None:
    """Report transitions that wait for the clip of a state without a clip. A transition `from any` may be meant for other
    states."""
    if any(isinstance(line, Play) for line in state.body):
        return
    for change in state.transitions:
        test = change.condition
        if test is None or not change.key.startswith(f"{species.name}.{machine.name}.{state.name}->"):
            continue
        for part in _all_of(test):
            if isinstance(part, ClipTest) and part.machine == machine.name:
                report.warning(
                    "never-fires",
                    f"{quoted(part.span)} never holds in `{state.name}`, which plays no clip",
                    part.span,
                    f"write `play {'walk' if not part.mark else 'dig'}` or another clip as a line of `{state.name}`",
                )


def _all_of(test: Expr) -> list[Expr]:
    """What all has to hold for a condition to."""
    if isinstance(test, Op) and test.name == "and":
        return [part for arg in test.args if arg is not None for part in _all_of(arg)]
    return [test]


def _word(test: Expr) -> bool:
    """`true` and `false` as words are meant so."""
    return isinstance(test, Const)
