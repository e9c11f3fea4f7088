"""Determines the types of expressions about states and clips, such as `state == carry`, `mood.state`, `time_in_state` or `clip
at MARK`."""

from __future__ import annotations

from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.kinds import BOOL_TYPE, TIME_TYPE
from antdsl.program.model import AttributeRef, ChangeRate, ClipTest, Expr, StateConstant, ThingRef, TypeKind, ValueType
from antdsl.program.names.scope import MachineNames, NameScope, is_known_missing, list_names, make_bad_expression, suggest_name
from antdsl.source import Span
from antdsl.syntax import nodes

STATE_WORDS = ("state", "previous", "next", "time_in_state")


def find_machine(scope: NameScope, owner: nodes.Expr) -> MachineNames | None:
    """Return the machine of the species with the name `owner`, such as `mood`. Return None if there is none."""
    if (
        scope.species is None
        or scope.behaviour is not None
        or not isinstance(owner, nodes.NameRef)
        or owner.name.text in scope.local_names
    ):
        return None
    return scope.species.machines.get(owner.name.text)


def type_machine_value(scope: NameScope, machine: MachineNames, node: nodes.Member) -> Expr:
    """Type a value of a machine, such as `mood.state` or `mood.time_in_state`."""
    word = node.name.text
    if word in STATE_WORDS:
        return _type_machine_word(machine, None, word, node.span)
    message = f"machine `{machine.name}` has no `{word}`"
    scope.report.error(
        "unknown-name", message, node.name.span, suggest_name(word, STATE_WORDS, f"there is {list_names(STATE_WORDS)}")
    )
    return make_bad_expression(node.span)


def type_state_word(scope: NameScope, owner: Expr | None, word: str, span: Span, name_span: Span | None) -> Expr:
    """Type `state` and similar words, for the agent itself or for the agent `owner`.

    If there are several machines, a word inside a machine refers to this machine. Outside of machines, it refers to the first
    one."""
    names = scope.species if owner is None or owner.type.referent is None else scope.declarations.species.get(owner.type.referent)
    if isinstance(owner, ThingRef) and owner.name == "self":
        owner = None
    if names is None or not names.machines:
        advice = "you can test states only of a species that is checked together with this one"
        scope.report.error("unknown-name", f"no `{word}` is known here", name_span or span, advice)
        return make_bad_expression(span)
    machine = scope.machine if owner is None and scope.machine is not None else next(iter(names.machines.values()))
    return _type_machine_word(machine, owner, word, span)


def _type_machine_word(machine: MachineNames, owner: Expr | None, word: str, span: Span) -> Expr:
    type = TIME_TYPE if word == "time_in_state" else ValueType(TypeKind.STATE, referent=machine.key)
    rate = ChangeRate.AGENT if owner is None else max(owner.rate, ChangeRate.AGENT)
    return AttributeRef(type, rate, span, owner, f"{machine.name}.{word}")


def find_state(scope: NameScope, operand: Expr, node: nodes.Expr) -> tuple[Expr, Expr] | None:
    """Return the two sides of `state == carry`: the compared value, and the constant for the state, in the machine that has a
    state of this name.

    Return None if `node` is not a bare name."""
    if not isinstance(node, nodes.NameRef) or not isinstance(operand, AttributeRef) or node.name.text in STATE_WORDS:
        return None
    species, _, machine_name = (operand.type.referent or ".").partition(".")
    machines = scope.declarations.species[species].machines
    named = "." in operand.span.text and operand.owner is None  # `mood.state` names the machine; `state` alone may mean any
    order = [machines[machine_name]] + ([] if named else [m for m in machines.values() if m.name != machine_name])
    for machine in order:
        index = machine.states.get(node.name.text)
        if index is not None:
            scope.record_name_use(node.span, "state", species, machine.name, node.name.text)
            word = operand.name.partition(".")[2]
            return _type_machine_word(machine, operand.owner, word, operand.span), StateConstant(
                ValueType(TypeKind.STATE, referent=machine.key), ChangeRate.CONST, node.span, machine.key, index
            )
    known = [state for machine in order for state in machine.states]
    report_unknown_state(scope, node.name, species, known)
    return operand, make_bad_expression(node.span)


def report_unknown_state(scope: NameScope, name: nodes.Name, species: str, known_states: list[str]) -> str | None:
    """Report an unknown state name. Return the name that was probably meant, or None."""
    meant = find_nearest_name(name.text, known_states)
    if is_known_missing(scope, "state", name, species):
        return meant
    advice = suggest_name(
        name.text, known_states, f"`{species}` has the states {list_names(known_states)}" if known_states else None
    )
    scope.report.error("unknown-state", f"no state `{name.text}` in species `{species}`", name.span, advice)
    return meant


def type_clip_test(scope: NameScope, node: nodes.ClipTest, expected_type: ValueType | None) -> Expr:
    """Type `clip done` or `clip at MARK`. In the text of a machine, the test refers to this machine. Outside of machines, it
    refers to the first machine."""
    names = scope.species
    if names is None or not names.machines or scope.behaviour is not None:
        words = "there is no clip here"
        return scope.report_error("unknown-name", words, node.span, "test it in a state of a species: `when clip done -> …`")
    if not node.at and node.name.text != "done":
        message = f"`clip {node.name.text}` is not a property of a clip"
        return scope.report_error(
            "unknown-name", message, node.span, f"write `clip done`, or for a mark `clip at {node.name.text}`"
        )
    machine = scope.machine or next(iter(names.machines.values()))
    return ClipTest(BOOL_TYPE, ChangeRate.AGENT, node.span, machine.name, node.name.text if node.at else "")
