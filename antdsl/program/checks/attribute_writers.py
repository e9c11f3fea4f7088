"""Reports attributes that two machines set. Machines run in parallel, so only one may set an attribute, although several may add
to it."""

from __future__ import annotations

from collections.abc import Iterator

from antdsl.diagnostics import Label, Report
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.model import Assign, Machine
from antdsl.source import Span


def check_writers(context: CheckContext, report: Report) -> None:
    """Report attributes that one machine sets and another machine also changes."""
    for species in context.program.species.values():
        first: dict[str, tuple[Machine, Span, bool]] = {}
        for machine in species.machines:
            for name, span, sets in _iterate_written_attributes(machine):
                known = first.get(name)
                if known is None or known[0] is machine:
                    first[name] = (machine, span, sets or (known is not None and known[2]))
                    continue
                if sets or known[2]:
                    message = f"machines `{known[0].name}` and `{machine.name}` both write `{name}`, in the same step"
                    advice = f"let one machine write it, or only add to it in both: `{name} += …`"
                    report.error("two-writers", message, span, advice, labels=(Label(known[1], "the other one"),))
                    break


def _iterate_written_attributes(machine: Machine) -> Iterator[tuple[str, Span, bool]]:
    """Yield each attribute that a machine writes, as its name, the span of the line, and whether the line sets the attribute.
    False means that the line adds to it."""
    for state in machine.states:
        blocks = [state.body, state.enter, state.exit, *(change.actions for change in state.transitions)]
        for block in blocks:
            for line in block:
                if isinstance(line, Assign) and line.pair_agent is None:
                    yield line.attribute, line.span, line.op == "="
