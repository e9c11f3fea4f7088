"""States that no change leads to, and states that no change leads out of."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.program.model import Ask, Machine, State
from antdsl.program.tables.effects import EFFECTS


def check_reachability(checked: CheckContext, report: Report) -> None:
    for species in checked.program.species.values():
        for machine in species.machines:
            reached = _reachable_states(machine)
            for state in machine.states:
                if state.index not in reached:
                    _report_unreachable(machine, state, report)
                elif len(machine.states) > 1 and _is_stuck(state):
                    advice = f"write `when … -> {machine.states[machine.start].name}` in it, or `die` if the animal leaves"
                    report.warning("trap", f"nothing leads out of state `{state.name}`", state.span, advice)


def _reachable_states(machine: Machine) -> set[int]:
    """Return the states that are reachable from the start state. `previous` leads only to states that were active before."""
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
    report.warning("unreachable-state", f"no change leads to state `{state.name}`", state.span, advice)


def _is_stuck(state: State) -> bool:
    leaves = any(isinstance(line, Ask) and EFFECTS[line.op].last for line in (*state.body, *state.enter))
    return not state.transitions and not leaves
