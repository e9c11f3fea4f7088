"""Changes whose condition can never hold, or cannot but hold, as far as its comparisons with constants show."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import Checked
from antdsl.program.checks.analysis.conditions import Reader, always, never
from antdsl.program.model import Const, Expr, Transition
from antdsl.program.types.descriptions import quoted


def firing(checked: Checked, report: Report) -> None:
    reader = Reader(checked.program.params)
    for species in checked.program.species.values():
        for machine in species.machines:
            for state in machine.states:
                for change in state.transitions:
                    _change(reader, change, report)


def _change(reader: Reader, change: Transition, report: Report) -> None:
    test = change.condition
    if test is None or _word(test):
        return
    if never(reader, test):
        report.warning(
            "never-fires",
            f"{quoted(test.span)} can never hold",
            test.span,
            "change one of its numbers, or delete the change",
        )
    elif always(reader, test):
        report.warning(
            "always-fires",
            f"{quoted(test.span)} always holds",
            test.span,
            "change one of its numbers, or write `when true` if that is meant",
        )


def _word(test: Expr) -> bool:
    """`true` and `false` as words are meant so."""
    return isinstance(test, Const)
