"""States that no change leads to, and states that no change leads out of."""

from __future__ import annotations

from collections.abc import Iterator

from antdsl.diagnostics import Report
from antdsl.program.checks.checked import Checked
from antdsl.program.model import Die, Machine, State
from antdsl.source import Span
from antdsl.syntax import nodes


def reachability(checked: Checked, report: Report) -> None:
    leaving = frozenset(_leaving(checked))
    for species in checked.program.species.values():
        for machine in species.machines:
            reached = _reached(machine)
            for state in machine.states:
                if state.index not in reached:
                    _unreachable(machine, state, report)
                elif len(machine.states) > 1 and state.span not in leaving and _stuck(state):
                    report.warning(
                        "trap", f"nothing leads out of state `{state.name}`", state.span,
                        f"write `when … -> {machine.states[machine.start].name}` in it, or `die` if the animal leaves",
                    )  # fmt: skip


def _reached(machine: Machine) -> set[int]:
    """States that can be come to from the start. `previous` leads only to where one has been."""
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


def _unreachable(machine: Machine, state: State, report: Report) -> None:
    start = machine.states[machine.start].name
    report.warning(
        "unreachable-state",
        f"no change leads to state `{state.name}`",
        state.span,
        f"write `when … -> {state.name}` in state `{start}` or another, or delete it",
    )


def _leaving(checked: Checked) -> Iterator[Span]:
    """Names of states written with a way out, also where it leads nowhere or could not be read: that was told already."""
    for file in checked.files:
        for species in file.node.items:
            if not isinstance(species, nodes.Species):
                continue
            machines = [m.members for m in species.members if isinstance(m, nodes.Machine)]
            for member in (m for members in (species.members, *machines) for m in members):
                if isinstance(member, nodes.State) and (
                    any(isinstance(line, nodes.Change) for line in member.body)
                    or any(_holds(member.span, span) for span in file.node.doubtful)
                ):
                    yield member.name.span


def _holds(outer: Span, inner: Span) -> bool:
    return outer.source is inner.source and outer.start <= inner.start < outer.end


def _stuck(state: State) -> bool:
    leaves = any(isinstance(line, Die) for line in (*state.body, *state.enter))
    return not state.transitions and not leaves
