"""Checks a species: first params and attributes, then lets and latches, then handlers, machines and layers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from antdsl import limits
from antdsl.diagnostics import Label
from antdsl.program import model
from antdsl.program.declarations.amounts import ACTION_CONTEXT, HANDLER_CONTEXT
from antdsl.program.declarations.attributes import check_attributes as attributes_in
from antdsl.program.declarations.attributes import find_switches, is_state_name
from antdsl.program.declarations.fuzzy import type_fuzzy_mean
from antdsl.program.declarations.machines import check_machine
from antdsl.program.declarations.params import check_param
from antdsl.program.declarations.resting_push import find_resting_push
from antdsl.program.declarations.statements import check_statements
from antdsl.program.kinds import BAD_TYPE, BOOL_TYPE, PUSH_TYPE, TIME_TYPE
from antdsl.program.memo import get_or_compute_part
from antdsl.program.model import Binding, ChangeRate, Dimension, TypeKind, ValueType
from antdsl.program.names.collect import BUILTIN_EVENTS, check_free_member_name
from antdsl.program.names.ordering import order_declarations
from antdsl.program.names.scope import (
    Declarations,
    FileNames,
    NameScope,
    SpeciesNames,
    StableKeys,
    make_bad_expression,
    report_duplicate,
    suggest_name,
)
from antdsl.program.types.descriptions import describe_type, quote_source
from antdsl.program.types.expressions import find_reference_type
from antdsl.program.types.folding import find_constant
from antdsl.program.types.operators import type_condition, type_facing_direction, type_value_as
from antdsl.program.types.pair_values import check_pair_value
from antdsl.source import Span
from antdsl.syntax import nodes

_PURE_LET_REASON = "a `let` only names a value"


@dataclass(slots=True)
class PartlyCheckedSpecies:
    """A species of which only the names, params and attributes have been checked. Other species can refer to these.
    `complete_species` checks and adds the rest."""

    names: SpeciesNames
    node: nodes.Species
    scope: NameScope
    params: list[model.Param]
    attributes: list[model.AttributeDecl]


def begin_species(declarations: Declarations, file: FileNames, node: nodes.Species) -> PartlyCheckedSpecies:
    """Check the params and attributes of a species, the first half of its check."""
    names = declarations.species[node.name.text]
    scope = NameScope(
        declarations, file, StableKeys(names.name), declarations.report, species=names, no_keep_reason=_PURE_LET_REASON
    )
    _check_names(scope, node)
    names.untyped_names = {m.name.text for m in _list_members(node, nodes.Let, nodes.Latch, nodes.Fuzzy)} - names.builtins.keys()
    head = tuple(m for m in node.members if isinstance(m, (nodes.ParamDecl, nodes.Declaration, nodes.AnimalProperty)))
    params, attributes, known = get_or_compute_part(
        declarations, ("draft", names.name, names.edition, head, node.name), lambda: _check_draft(scope, node)
    )
    names.attributes, names.pair_value_species, names.params = (dict(each) for each in known)
    return PartlyCheckedSpecies(names, node, scope, params, attributes)


def _check_draft(
    scope: NameScope, node: nodes.Species
) -> tuple[list[model.Param], list[model.AttributeDecl], tuple[dict[str, Any], ...]]:
    names = scope.species
    assert names is not None
    params = [p for m in node.members if isinstance(m, nodes.ParamDecl) and (p := check_param(scope, m.declaration)) is not None]
    attributes = attributes_in(scope, node)
    return params, attributes, (dict(names.attributes), dict(names.pair_value_species), dict(names.params))


def _list_members(node: nodes.Species, *kinds: type) -> list[Any]:
    """Return the members of the given node classes in text order, from the species and its machines."""
    members: list[object] = []
    for member in node.members:
        members.append(member)
        if isinstance(member, nodes.Machine):
            members += member.members
    return [m for m in members if isinstance(m, kinds)]


def _check_names(scope: NameScope, node: nodes.Species) -> None:
    """Report names that are declared twice, and names that are words of the language."""
    spans_by_name: dict[str, Span] = {}
    for member in _list_members(node, nodes.Declaration, nodes.ParamDecl, nodes.Let, nodes.Latch, nodes.Fuzzy):
        each = member.declaration if isinstance(member, nodes.ParamDecl) else member
        if isinstance(each, nodes.Fuzzy):
            value_span = each.rules[0].value.span if each.rules else each.name.span
        else:
            value_span = each.on.span if isinstance(each, nodes.Latch) else each.value.span
        if each.name.text in spans_by_name:
            report_duplicate(scope.report, "name", each.name, spans_by_name[each.name.text])
        else:
            check_free_member_name(scope.report, each.name, value_span, scope.builtins)
        spans_by_name.setdefault(each.name.text, each.name.span)
    if len(spans_by_name) > limits.MAX_ATTRIBUTES:
        message = f"species `{node.name.text}` declares more than {limits.MAX_ATTRIBUTES} names"
        scope.report.error("too-many", message, node.name.span, "split it")


# --- the rest --------------------------------------------------------------------------------------------------------


def complete_species(species_draft: PartlyCheckedSpecies) -> model.Species:
    """Check lets, latches, handlers, machines and layers. The attributes of all species must already be known."""
    names, node = species_draft.names, species_draft.node
    key = ("species", node.name, names.edition, node.help, node.members, *species_draft.attributes, *species_draft.params)
    species, names.bindings = get_or_compute_part(
        species_draft.scope.declarations, key, lambda: (_check_members(species_draft), names.bindings)
    )
    names.untyped_names.clear()
    return species


def _check_members(species_draft: PartlyCheckedSpecies) -> model.Species:
    scope, node, names = species_draft.scope, species_draft.node, species_draft.names
    declarations: dict[str, nodes.Declaration] = {}
    for member in node.members:
        if isinstance(member, nodes.Declaration):
            declarations.setdefault(member.name.text, member)
    attributes = [_add_relaxation(scope, a, declarations.get(a.name)) for a in species_draft.attributes]
    named = tuple(_list_members(node, nodes.Let, nodes.Latch, nodes.Fuzzy))
    bindings = get_or_compute_part(scope.declarations, ("bindings", names.name, named), lambda: _check_bindings(scope, node))
    names.bindings = {binding.name: binding for binding in bindings}
    names.untyped_names.clear()
    machines = _check_machines(scope.with_changes(no_keep_reason=None), node)
    known = (names.name, *bindings)
    handling = tuple(m for m in node.members if isinstance(m, nodes.On))
    handlers = get_or_compute_part(
        scope.declarations,
        ("handlers", handling, known),
        lambda: _check_handlers(scope.with_changes(no_keep_reason=None), handling),
    )
    blocks = tuple(m for m in node.members if isinstance(m, nodes.Layers))
    layers = get_or_compute_part(
        scope.declarations,
        ("layers", node.name, blocks, known),
        lambda: _check_layers(scope.with_changes(no_keep_reason=None), node),
    )
    switched = find_switches(scope, node)
    return model.Species(
        names.name, node.help.text if node.help else "", tuple(attributes), tuple(species_draft.params),
        tuple(b for b in bindings if b.role == "let"), tuple(b for b in bindings if b.role == "latch"),
        tuple(handlers), tuple(machines), layers, node.name.span,
        find_resting_push(scope.with_changes(keys=StableKeys(f"{names.name}.rest")), machines, node.name), scope.edition,
        switched["body_clearance"], switched["body_contacts"],
    )  # fmt: skip


def _add_relaxation(scope: NameScope, attribute: model.AttributeDecl, node: nodes.Declaration | None) -> model.AttributeDecl:
    """Return the attribute with its rest value. For a pair value, also set the species of the other agents."""
    if node is None or (node.relax is None and node.each is None):
        return attribute
    to = over = None
    if node.relax is not None:
        if attribute.type.kind not in (TypeKind.NUMBER, TypeKind.VECTOR, TypeKind.BAD):
            message = f"`{attribute.name}` is {describe_type(attribute.type)} and cannot relax"
            scope.report.error("wrong-kind", message, node.relax.span, "only numbers and vectors can change gradually")
        to = type_value_as(scope, node.relax.to, attribute.type, "`relax to`")
        over = type_value_as(scope, node.relax.over, TIME_TYPE, "`over`")
    each, strongest = None, 0
    if node.each is not None:
        type = find_reference_type(scope, node.each.species)
        if type is not None and type.kind is not TypeKind.AGENT:
            message = f"`{node.each.species.text}` is not a species"
            scope.report.error("wrong-kind", message, node.each.species.span, "`for each` stores values about other agents")
        each = node.each.species.text
        check_pair_value(scope, attribute, to)
        if node.each.strongest is None:
            message = f"`{attribute.name}` has no maximum number of other agents"
            scope.report.error("missing-bound", message, node.each.span, f"write `for each {each}, strongest 8`")
        else:
            count = find_constant(type_value_as(scope, node.each.strongest, ValueType(TypeKind.NUMBER), "`strongest`"))
            strongest = int(count.number) if count is not None else 0
            if count is None or not 1 <= count.number <= limits.MAX_PAIR_VALUES or count.number != strongest:
                scope.report.error(
                    "wrong-count",
                    f"`strongest` needs a whole number from 1 to {limits.MAX_PAIR_VALUES}, "
                    f"not {quote_source(node.each.strongest.span)}",
                    node.each.strongest.span,
                    "write `strongest 8`",
                )
    return model.AttributeDecl(
        attribute.name, attribute.type, attribute.default, False, attribute.help, attribute.span, to, over, each, strongest
    )  # fmt: skip


def _list_expressions(member: nodes.Let | nodes.Latch | nodes.Fuzzy) -> list[nodes.Expr]:
    if isinstance(member, nodes.Fuzzy):
        return [part for rule in member.rules for part in (rule.condition, rule.value)]
    return [member.value] if isinstance(member, nodes.Let) else [member.on, member.until]


def _check_bindings(scope: NameScope, node: nodes.Species) -> list[Binding]:
    """Return the lets, latches and fuzzy values. Each comes after the bindings that it uses."""
    names = scope.species
    assert names is not None
    declared: dict[str, nodes.Let | nodes.Latch | nodes.Fuzzy] = {}
    for member in _list_members(node, nodes.Let, nodes.Latch, nodes.Fuzzy):
        declared.setdefault(member.name.text, member)
    order, circular = order_declarations(scope.report, "lets", declared, _list_expressions, lambda m: m.name)
    bindings: list[Binding] = []
    for each in order:
        name = each.name.text
        inner = scope.with_changes(keys=StableKeys(f"{names.name}.{name}"))
        if name in circular:
            binding = Binding(
                name, "let", BAD_TYPE, ChangeRate.CONST, each.name.span, make_bad_expression(each.name.span), is_snapshot=True
            )
        elif isinstance(each, (nodes.Let, nodes.Fuzzy)):
            expr = type_fuzzy_mean(inner, each) if isinstance(each, nodes.Fuzzy) else inner.type_expression(each.value)
            binding = Binding(name, "let", expr.type, expr.rate, each.name.span, expr, is_snapshot=True)
        else:
            on, until = type_condition(inner, each.on, "`latch`"), type_condition(inner, each.until, "`until`")
            binding = Binding(name, "latch", BOOL_TYPE, ChangeRate.AGENT, each.name.span, on, until, f"{names.name}.{name}")
        names.bindings[name] = binding
        names.untyped_names.discard(name)
        bindings.append(binding)
    return bindings


def _check_machines(scope: NameScope, node: nodes.Species) -> list[model.Machine]:
    names = scope.species
    assert names is not None
    machines: list[model.Machine] = []
    loose = [m for m in node.members if isinstance(m, (nodes.State, nodes.Start, nodes.Change))]
    if "main" in names.machines and any(isinstance(m, nodes.State) for m in loose):
        machines.append(check_machine(scope, names.machines["main"], loose, node.name.span))
    elif loose:
        message = "there are no states here"
        scope.report.error("unknown-state", message, loose[0].span, "move this line into the `machine` that it belongs to")
    known_names = {m.name for m in machines}
    for member in node.members:
        if isinstance(member, nodes.Machine) and member.name.text not in known_names:
            known_names.add(member.name.text)
            machines.append(check_machine(scope, names.machines[member.name.text], member.members, member.name.span))
    return machines


def _check_handlers(scope: NameScope, handler_nodes: tuple[nodes.On, ...]) -> list[model.Handler]:
    events: dict[str, StableKeys] = {}
    return [_check_handler(scope, each, events) for each in handler_nodes]


def _check_handler(scope: NameScope, node: nodes.On, keys_by_event: dict[str, StableKeys]) -> model.Handler:
    """Check a handler. `keys_by_event`: for each event, the generator of keys that its earlier handlers also used. So two
    handlers never share random draws."""
    names, event = scope.species, node.event.text
    assert names is not None
    keys = keys_by_event.setdefault(event, StableKeys(f"{names.name}.on.{event}"))
    scope = scope.with_changes(keys=keys, no_keep_reason="an event does not happen at every step")
    other, partner_species = None, _find_partner_species(scope, node) if event == "collision" else ""
    if event == "collision" and node.variable is not None:
        _check_distinct_name(scope, node.variable)
        if partner_species:
            other = Binding(
                node.variable.text,
                "element",
                ValueType(TypeKind.AGENT, Dimension(), partner_species),
                ChangeRate.AGENT,
                node.variable.span,
            )
        scope = scope.with_changes(local_names={node.variable.text: other or make_bad_expression(node.variable.span)})
    elif node.variable is not None:
        message = f"`on {event}` does not name an agent"
        scope.report.error("wrong-argument", message, node.variable.span, f"write `on {event} {{ … }}`")
        scope = scope.with_changes(local_names={node.variable.text: make_bad_expression(node.variable.span)})
    if event not in BUILTIN_EVENTS:
        scope.mark_used("on", event)
        scope.mark_used("heard", f"{event} {scope.species.name if scope.species else ''}")
    return model.Handler(
        event,
        other,
        check_statements(scope, node.actions, ACTION_CONTEXT if event == "spawn" else HANDLER_CONTEXT),
        node.span,
        partner_species,
    )


def _find_partner_species(scope: NameScope, node: nodes.On) -> str:
    """Return the species of the other agent in a collision: the named species or, by default, the agent's own. Return "" after
    an error."""
    assert scope.species is not None
    if node.species is None:
        return scope.species.name
    name, known = node.species, list(scope.declarations.species)
    thing = scope.declarations.things.get(name.text)
    if name.text in known:
        scope.mark_used("species", name.text)
        scope.record_name_use(name.span, "species", name.text)
        return name.text
    if thing is not None:
        advice = f"test it in a state: `when touching({name.text}) -> …`"
        scope.report.error("wrong-kind", f"`{name.text}` is not a species; `on collision` needs a species", name.span, advice)
    else:
        advice = suggest_name(name.text, known, f"declare it: `world {{ species {name.text} }}`")
        scope.report.error("unknown-species", f"no species `{name.text}`", name.span, advice)
    return ""


def _check_distinct_name(scope: NameScope, variable: nodes.Name) -> None:
    """Report a name in the brackets of `on collision(…)` if it already has another meaning."""
    if variable.text in scope.declarations.species:
        message = f"`{variable.text}` is a species, but the name in brackets is the other agent"
        scope.report.error("wrong-argument", message, variable.span, f"write `on collision(other: {variable.text})`")
    elif variable.text == "self":
        message = "`self` is the agent itself, but the name in brackets is the other one"
        scope.report.error("wrong-argument", message, variable.span, "write `on collision(other)`")


# --- layers ----------------------------------------------------------------------------------------------------------


def _check_layers(scope: NameScope, node: nodes.Species) -> model.LayerStack:
    names = scope.species
    assert names is not None
    written = [m for m in node.members if isinstance(m, nodes.Layers)]
    for extra in written[1:]:
        message = "a second `layers`"
        advice = "merge them into one"
        scope.report.error("duplicate-name", message, extra.span, advice, labels=(Label(written[0].span, "first here"),))
    if not written:
        return model.LayerStack("budget", (model.Layer(None, None, "state", node.name.span, "state"),), node.name.span)
    block = written[0]
    mode = block.mode.text if block.mode else "budget"
    if mode not in ("budget", "sum", "first"):
        assert block.mode is not None
        scope.report.error(
            "unknown-setting",
            f"layers cannot be combined by `{mode}`",
            block.mode.span,
            suggest_name(mode, ("sum", "first"), "write `layers`, `layers sum` or `layers first`"),
        )
    if len(block.layers) > limits.MAX_STEERING_LAYERS:
        message = f"more than {limits.MAX_STEERING_LAYERS} layers"
        scope.report.error(
            "too-many", message, block.layers[limits.MAX_STEERING_LAYERS].span, "combine some of them in a behaviour"
        )
    scope = scope.with_changes(keys=StableKeys(f"{names.name}.layers"))
    counts: dict[str, int] = {}
    return model.LayerStack(mode, tuple(_check_layer(scope, each, counts) for each in block.layers), block.span)


def _check_layer(scope: NameScope, node: nodes.Layer, word_counts: dict[str, int]) -> model.Layer:
    """Return the checked layer. Its key is its first word, such as `separate`. The second layer with the same first word has the
    key `separate#2`."""
    text = " ".join(node.push.span.text.split())
    steered = isinstance(node.push, nodes.NameRef) and node.push.name.text == "state" and not node.is_face_line
    word = _find_layer_word(node.push)
    if node.is_face_line:
        text, word = f"face {text}", f"face {word}"
    word_counts[word] = word_counts.get(word, 0) + 1
    key = word if word_counts[word] == 1 else f"{word}#{word_counts[word]}"
    push = None
    own = scope.species
    taken = {*own.attributes, *own.bindings} if own else set()
    if node.is_face_line:
        push = type_facing_direction(scope, node.push)
    elif isinstance(node.push, nodes.NameRef) and is_state_name(scope, word) and own and word not in taken:
        message = f"`{word}` is a state, but a layer must be a push"
        # the author probably means the steering
        scope.report.error("state-as-value", message, node.push.span, "did you mean `state`?")
        push = make_bad_expression(node.push.span)
    elif not steered:
        push = type_value_as(scope, node.push, PUSH_TYPE, "a layer")
    test = type_condition(scope, node.condition, "`when`") if node.condition is not None else None
    return model.Layer(push, test, text, node.span, key, node.is_face_line)


def _find_layer_word(push: nodes.Expr) -> str:
    while isinstance(push, (nodes.Binary, nodes.Unary, nodes.Call)):
        push = push.left if isinstance(push, nodes.Binary) else push.operand if isinstance(push, nodes.Unary) else push.function
    if isinstance(push, nodes.Member):
        return push.name.text
    return push.name.text if isinstance(push, nodes.NameRef) else "push"
