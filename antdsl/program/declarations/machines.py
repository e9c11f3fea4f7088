"""Checks the states and transitions of a species, and puts the transitions into evaluation order."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from antdsl import limits
from antdsl.diagnostics import Fix, Label
from antdsl.program import model
from antdsl.program.declarations.amounts import ACTION_CONTEXT, BODY_CONTEXT
from antdsl.program.declarations.appearance import check_duplicates, check_single_clip
from antdsl.program.declarations.statements import check_statements, check_take
from antdsl.program.kinds import NUMBER_TYPE, TIME_TYPE
from antdsl.program.memo import get_or_compute_part
from antdsl.program.model import Binding, Expr
from antdsl.program.names.scope import (
    MachineNames,
    NameScope,
    StableKeys,
    list_names,
    make_bad_expression,
    report_duplicate,
    suggest_name,
)
from antdsl.program.tables.colours import COLOUR_BY_NAME, choose_default_rgb, find_rgb
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import find_constant
from antdsl.program.types.operators import type_condition, type_value_as
from antdsl.program.types.states import report_unknown_state
from antdsl.source import Span
from antdsl.syntax import nodes

MachineMember = nodes.State | nodes.Start | nodes.Change | nodes.Let | nodes.Latch


def check_machine(scope: NameScope, names: MachineNames, members: Sequence[object], span: Span) -> model.Machine:
    """Return the checked machine with its states. `span`: the location of the machine's name."""
    scope = scope.with_changes(machine=names)
    states = [m for m in members if isinstance(m, nodes.State)]
    known = (names.key, *(scope.species.bindings.values() if scope.species is not None else ()))
    changes = tuple(node for node in members if isinstance(node, nodes.Change))
    anywhere = get_or_compute_part(
        scope.declarations, ("anywhere", changes, known), lambda: _check_from_any_transitions(scope, names, changes)
    )
    machine_states: list[model.State] = []
    for index, state in enumerate(_drop_duplicate_states(states)):
        general = [
            change for node, change in anywhere if change is not None and _applies_in_state(node, change, state.name.text, index)
        ]
        key = ("state", state, index, *general, *known)
        machine_states.append(
            get_or_compute_part(scope.declarations, key, partial(_check_state, scope, names, state, index, general))
        )
    return model.Machine(names.name, _find_start_index(scope, names, members, span), tuple(machine_states), span)


def _check_from_any_transitions(
    scope: NameScope, names: MachineNames, changes: Sequence[nodes.Change]
) -> list[tuple[nodes.Change, model.Transition | None]]:
    """Return the `from any` transitions. Each is a pair of its syntax node and the checked transition, which is None after an
    error."""
    scope = scope.with_changes(keys=StableKeys(f"{names.key}.{model.FROM_ANY_KEY}"))
    return [(node, _check_from_any_transition(scope, names, node)) for node in changes]


def _drop_duplicate_states(states: Sequence[nodes.State]) -> list[nodes.State]:
    return list({state.name.text: state for state in reversed(states)}.values())[::-1]


def _find_start_index(scope: NameScope, names: MachineNames, members: Sequence[object], span: Span) -> int:
    starts = [m for m in members if isinstance(m, nodes.Start)]
    for extra in starts[1:]:
        message = "a second `start`"
        advice = "an agent starts in one state"
        scope.report.error("duplicate-name", message, extra.span, advice, labels=(Label(starts[0].span, "first here"),))
    if starts:
        return _find_state_index(scope, names, starts[0].state) or 0
    if len(names.states) > 1:
        message = f"no `start` selects one of the states {list_names(names.states)} comes first"
        scope.report.error("missing-start", message, span, f"write `start {next(iter(names.states))}`")
    return 0


def _find_state_index(scope: NameScope, names: MachineNames, state: nodes.Name) -> int | None:
    """Return the index of the state with this name. For an unknown name, report an error and return the index of the most
    similar name, or None."""
    species, _, machine = names.key.partition(".")
    if state.text in names.states:
        scope.record_name_use(state.span, "state", species, machine, state.text)
        return names.states[state.text]
    return names.states.get(report_unknown_state(scope, state, species, list(names.states)) or "")


# --- one state -------------------------------------------------------------------------------------------------------


def _check_state(
    scope: NameScope, names: MachineNames, node: nodes.State, index: int, any_transitions: list[model.Transition]
) -> model.State:
    path = f"{names.key}.{node.name.text}"
    scope = scope.with_changes(keys=StableKeys(path))
    scope = scope.with_changes(local_names=_check_lets(scope, node))
    own = [_check_transition(scope, names, line, path) for line in node.body if isinstance(line, nodes.Change)]
    changes = [c for c in own if c is not None]
    check_single_clip(scope, node)
    check_duplicates(scope, node)
    order = [c for c in changes if c.is_interrupt] + any_transitions + [c for c in changes if not c.is_interrupt]
    return model.State(
        node.name.text, index, node.label.text if node.label else "", _choose_colour(scope, node, index),
        _type_duration(scope, node.at_least, "`for at least`"), tuple(order),
        check_statements(scope.with_changes(keys=StableKeys(f"{path}.enter")), node.enter, ACTION_CONTEXT),
        check_statements(scope.with_changes(keys=StableKeys(f"{path}.exit")), node.exit, ACTION_CONTEXT),
        check_statements(scope, [line for line in node.body if not isinstance(line, (nodes.Change, nodes.Let))], BODY_CONTEXT),
        node.name.span,
    )  # fmt: skip


def _check_lets(scope: NameScope, node: nodes.State) -> dict[str, Binding | Expr]:
    """Return the lets of a state in text order. Like the lets of a species, they read the agent's state at the start of the
    step."""
    local: dict[str, Binding | Expr] = dict(scope.local_names)
    assert scope.species is not None
    for line in node.body:
        if not isinstance(line, nodes.Let):
            continue
        name = line.name
        if name.text in scope.species.attributes or name.text in scope.species.bindings or name.text in local:
            report_duplicate(scope.report, "name", name, _find_earlier_declaration(node, scope, name))
        keys = StableKeys(f"{scope.keys.path}.{name.text}")
        expr = scope.with_changes(local_names=local, keys=keys, no_keep_reason="a `let` only names a value").type_expression(
            line.value
        )
        local[name.text] = Binding(name.text, "let", expr.type, expr.rate, name.span, expr, is_snapshot=True)
    return local


def _find_earlier_declaration(node: nodes.State, scope: NameScope, name: nodes.Name) -> Span:
    """Return the span where a name was declared before, in the species or in the state."""
    assert scope.species is not None
    own = scope.species.bindings.get(name.text)
    earlier = [
        line.name.span
        for line in node.body
        if isinstance(line, nodes.Let) and line.name.text == name.text and line.name is not name
    ]
    return own.span if own else earlier[0] if earlier else node.name.span


def _choose_colour(scope: NameScope, node: nodes.State, index: int) -> tuple[float, float, float]:
    colour = find_rgb(node.colour.text) if node.colour else choose_default_rgb(index)
    if colour is None and node.colour is not None:
        examples = ("red", "orange", "yellow", "green", "blue", "violet", "brown", "grey")
        scope.report.error(
            "unknown-colour",
            f"no colour `{node.colour.text}`",
            node.colour.span,
            suggest_name(node.colour.text, COLOUR_BY_NAME, f"there is {list_names(examples)} and more"),
        )
    red, green, blue = colour or choose_default_rgb(index)
    return red / 255, green / 255, blue / 255


def _type_duration(scope: NameScope, node: nodes.Expr | None, subject: str) -> Expr | None:
    if node is None:
        return None
    duration = type_value_as(scope, node, TIME_TYPE, subject)
    constant = find_constant(duration)
    if constant is not None and constant.number < 0:
        message = f"{subject} needs a time of 0 or more, but {quote_source(node.span)} is negative"
        scope.report.error("out-of-range", message, node.span, "write `0 s` or more")
    elif constant is not None and not constant.unit_power and constant.number > limits.MAX_FRAMES:
        advice = f"write a shorter time: a run has {limits.MAX_FRAMES:,} frames at most"
        scope.report.warning("never-fires", f"{quote_source(node.span)} is longer than any run", node.span, advice)
    elif constant is not None and not constant.unit_power and not constant.step and 0 < constant.number * limits.MAX_FPS < 1:
        message = f"{quote_source(node.span)} is shorter than a frame of any scene, so {subject} takes one step"
        scope.report.warning("out-of-range", message, node.span, "write `1 step`, or a longer time")
    return duration


# --- one change ------------------------------------------------------------------------------------------------------


def _check_from_any_transition(scope: NameScope, names: MachineNames, node: nodes.Change) -> model.Transition | None:
    for name in node.any_except or ():
        _find_state_index(scope, names, name)
    return _check_transition(scope, names, node, scope.keys.path)


def _applies_in_state(node: nodes.Change, change: model.Transition, state: str, index: int) -> bool:
    """Return whether a `from any` transition applies in the state with this name and index.

    It does not apply in the states that it excepts, and never leads into the current state."""
    return change.target != index and all(name.text != state for name in node.any_except or ())


def _check_transition(scope: NameScope, names: MachineNames, node: nodes.Change, path: str) -> model.Transition | None:
    key = scope.keys.make_key(_format_target(node.target), "->")
    scope = scope.with_changes(keys=StableKeys(key))
    delay = _type_delay(scope, node.delay)
    test = type_condition(scope, node.condition, "`when`") if node.condition is not None else None
    held = _type_hold_time(scope, node.held)
    claim = check_take(scope, node.take) if node.take is not None else None
    choices = _type_choices(scope, names, node.target)
    target = _find_target_index(scope, names, node.target)
    actions = check_statements(scope, node.actions, ACTION_CONTEXT)
    if target is None and not choices and not node.target.is_previous:
        return None
    return model.Transition(
        key, node.interrupt, test, delay, held, claim, target, node.target.is_previous, choices, actions, node.span,
        _type_duration(scope, node.over, "`over`"),
    )  # fmt: skip


def _type_delay(scope: NameScope, node: nodes.Expr | None) -> Expr | None:
    """Return the typed time of `after T`. The time must be the complete condition of the transition.

    In `after 1 s and meal`, the parser reads the time as the first operand of `and`, which is an error."""
    time = _find_leftmost(node)
    if node is None or time is None or time is node:
        return _type_duration(scope, node, "`after`")
    source, text = time.span.source, f"time_in_state >= {time.span.text}"
    span = Span(source, source.text.rindex("after", 0, time.span.start), time.span.end)
    message = f"`{' '.join(span.text.split())}` cannot be combined with a condition"
    scope.report.error("wrong-kind", message, span, f"write `{text}` instead", fix=Fix(span, text))
    return make_bad_expression(node.span)


def _type_hold_time(scope: NameScope, node: nodes.Expr | None) -> Expr | None:
    """Return the typed time of `held T`. It must be at the end of the condition.

    In `meal held 1 s and scent > 1`, the time is in the middle, which is an error."""
    time = _find_leftmost(node)
    if node is None or time is None or time is node:
        return _type_duration(scope, node, "`held`")
    message = f"`held {' '.join(time.span.text.split())}` is inside a condition"
    scope.report.error("wrong-kind", message, time.span, "write it at the end: it applies to the complete condition")
    return make_bad_expression(node.span)


def _find_leftmost(node: nodes.Expr | None) -> nodes.Expr | None:
    """Return the first operand of a chain of `and` and `or`."""
    while isinstance(node, nodes.Binary) and node.op in ("and", "or"):
        node = node.left
    return node


def _format_target(target: nodes.Target) -> str:
    if target.is_previous:
        return "previous"
    return target.name.text if target.name is not None else "choose"


def _find_target_index(scope: NameScope, names: MachineNames, target: nodes.Target) -> int | None:
    """Return the index of the state to which a transition leads. Return None if the target is `previous` or `choose`, and after
    an error."""
    if target.name is None or target.is_previous:
        return None
    return _find_state_index(scope, names, target.name)


def _type_choices(scope: NameScope, names: MachineNames, target: nodes.Target) -> tuple[tuple[int, Expr], ...]:
    """Return the states of a `choose` as (index, weight) pairs. The result is empty for other targets."""
    choices: list[tuple[int, Expr]] = []
    for choice in target.choices:
        weight = type_value_as(
            scope.with_changes(is_evaluated_once=True), choice.weight, NUMBER_TYPE, f"the weight of `{choice.target.text}`"
        )
        constant = find_constant(weight)
        if constant is not None and constant.number < 0:
            message = f"a weight below 0: {quote_source(choice.weight.span)}"
            scope.report.error("out-of-range", message, choice.weight.span, "write a weight of 0 or more")
        index = _find_state_index(scope, names, choice.target)
        if index is not None:
            choices.append((index, weight))
    weights = [find_constant(weight) for _, weight in choices]
    if choices and all(w is not None and w.number == 0 for w in weights):
        words = "all weights of `choose` are 0"
        scope.report.error("out-of-range", words, target.span, "give at least one state a weight above 0")
    if target.name is None and not target.is_previous and not target.choices:
        advice = "write `choose { rest: 2; roam: 1 }` with states of this machine"
        scope.report.error("missing-target", "`choose` has no states", target.span, advice)
    return tuple(choices)
