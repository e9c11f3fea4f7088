"""Changes that come after one that always happens."""

from __future__ import annotations

from antdsl.diagnostics import Label, Report
from antdsl.program.checks.checked import Checked
from antdsl.program.model import Const, Transition


def shadowed(checked: Checked, report: Report) -> None:
    for species in checked.program.species.values():
        for machine in species.machines:
            for state in machine.states:
                first: Transition | None = None
                for change in state.transitions:
                    if first is not None:
                        report.warning(
                            "shadowed-change", "this change is never looked at", change.span,
                            "move it above the one that always happens",
                            labels=(Label(first.span, "this one always happens"),),
                        )  # fmt: skip
                    elif _always(change):
                        first = change


def _always(change: Transition) -> bool:
    test = change.condition
    certain = test is None or (isinstance(test, Const) and test.number != 0)
    return certain and change.after is None and change.held is None and change.take is None
