"""Finds states without steering. If other states of the species steer, agents in these states stand still: they use the
library's `halt()`."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.program import model
from antdsl.program.declarations.behaviours import expand_implicit_call
from antdsl.program.names.scope import NameScope
from antdsl.syntax import nodes

HALT_LIBRARY, HALT_BEHAVIOUR = "steering", "halt"


def find_resting_push(scope: NameScope, machines: Sequence[model.Machine], name: nodes.Name) -> model.RestingPush | None:
    """Return the push for agents in states that do not steer. Return None if some machine steers in all of its states, or if no
    machine steers at all.

    Machines that never steer, such as a machine for moods, are ignored. An agent stands still only if the current states of all
    other machines do not steer.
    `name`: the name of the species, used as the location of the implicit call."""
    silent: dict[str, tuple[int, ...]] = {}
    for machine in machines:
        quiet = tuple(state.index for state in machine.states if not is_steering(state))
        if len(quiet) < len(machine.states):
            silent[machine.name] = quiet
    if not silent or not all(silent.values()):
        return None
    halt = scope.declarations.find_library_behaviour(HALT_LIBRARY, HALT_BEHAVIOUR)
    if halt is None:
        return None
    call = nodes.Call(nodes.NameRef(name, name.span), (), name.span)
    return model.RestingPush(silent, expand_implicit_call(scope, halt, call), name.span)


def is_steering(state: model.State) -> bool:
    """Return whether a state has a statement about how its agents move. A push of zero also counts."""
    return any(isinstance(line, model.Steer) for line in state.body)
