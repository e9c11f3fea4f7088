"""States that steer nothing: where others of the species steer, who is in them stands still, by the library's `halt()`."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.program import model
from antdsl.program.declarations.behaviours import call_unwritten
from antdsl.program.names.scope import Scope
from antdsl.syntax import nodes

LIBRARY, BEHAVIOUR = "steering", "halt"


def rest(scope: Scope, machines: Sequence[model.Machine], name: nodes.Name) -> model.Rest | None:
    """The push of those in states that steer nothing; None where every state steers, or none of any machine does.

    A machine that never steers, such as one of moods, says nothing about moving. Of several that steer it is enough that one of
    them does so now: so that it may steer alone. `name` is the species' own, which stands for the call that nobody wrote."""
    silent: dict[str, tuple[int, ...]] = {}
    for machine in machines:
        quiet = tuple(state.index for state in machine.states if not steers(state))
        if len(quiet) < len(machine.states):
            silent[machine.name] = quiet
    if not silent or not all(silent.values()):
        return None
    halt = scope.declared.shipped(LIBRARY, BEHAVIOUR)
    if halt is None:
        return None
    call = nodes.Call(nodes.NameRef(name, name.span), (), name.span)
    return model.Rest(silent, call_unwritten(scope, halt, call), name.span)


def steers(state: model.State) -> bool:
    """Whether a state says how its animals move, be it by a push of nothing."""
    return any(isinstance(line, model.Steer) for line in state.body)
