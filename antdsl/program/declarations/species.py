"""Checks a species: first params and attributes, lets and latches with their types, then handlers, machines and layers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from antdsl import limits
from antdsl.diagnostics import Label
from antdsl.program import model
from antdsl.program.declarations.amounts import ACTION_CONTEXT, HANDLER_CONTEXT
from antdsl.program.declarations.attributes import attributes as attributes_in
from antdsl.program.declarations.attributes import is_state_name, switches
from antdsl.program.declarations.machines import machine
from antdsl.program.declarations.params import param
from antdsl.program.declarations.resting import rest
from antdsl.program.declarations.shades import fuzzy_mean
from antdsl.program.declarations.statements import check_statements
from antdsl.program.kinds import BAD_TYPE, BOOL_TYPE, PUSH_TYPE, TIME_TYPE
from antdsl.program.memo import cached_part
from antdsl.program.model import Binding, ChangeRate, Dimension, TypeKind, ValueType
from antdsl.program.names.collect import BUILTIN_EVENTS, check_free_in_species
from antdsl.program.names.ordering import order_declarations
from antdsl.program.names.scope import (
    Declarations,
    FileNames,
    NameScope,
    SpeciesNames,
    StableKeys,
    bad_expression,
    did_you_mean,
    report_duplicate,
)
from antdsl.program.types.descriptions import quote_source, type_words
from antdsl.program.types.expressions import reference_type
from antdsl.program.types.folding import constant_behind
from antdsl.program.types.operators import condition, facing_direction, value_of_type
from antdsl.program.types.pair_values import check_pair_value
from antdsl.source import Span
from antdsl.syntax import nodes

_PURE_LET_REASON = "a `let` only names a value"


@dataclass(slots=True)
class SpeciesDraft:
    """A species under construction: its own names, so that other species may refer to them. `complete` adds the other members."""

    names: SpeciesNames
    node: nodes.Species
    scope: NameScope
    params: list[model.Param]
    attributes: list[model.AttributeDecl]


def draft(declared: Declarations, file: FileNames, node: nodes.Species) -> SpeciesDraft:
    """Check the params and attributes of a species."""
    names = declared.species[node.name.text]
    scope = NameScope(declared, file, StableKeys(names.name), declared.report, species=names, no_keep=_PURE_LET_REASON)
    _check_names(scope, node)
    names.pending = {m.name.text for m in _members_of_kind(node, nodes.Let, nodes.Latch, nodes.Fuzzy)} - names.builtins.keys()
    head = tuple(m for m in node.members if isinstance(m, (nodes.ParamDecl, nodes.Declaration, nodes.AnimalProperty)))
    params, attributes, known = cached_part(
        declared, ("draft", names.name, names.edition, head, node.name), lambda: _drafted(scope, node)
    )
    names.attributes, names.each, names.params = (dict(each) for each in known)
    return SpeciesDraft(names, node, scope, params, attributes)


def _drafted(
    scope: NameScope, node: nodes.Species
) -> tuple[list[model.Param], list[model.AttributeDecl], tuple[dict[str, Any], ...]]:
    names = scope.species
    assert names is not None
    params = [p for m in node.members if isinstance(m, nodes.ParamDecl) and (p := param(scope, m.declaration)) is not None]
    attributes = attributes_in(scope, node)
    return params, attributes, (dict(names.attributes), dict(names.each), dict(names.params))


def _members_of_kind(node: nodes.Species, *kinds: type) -> list[Any]:
    """Return the members of some kinds, of a species and of its machines, in text order."""
    members: list[object] = []
    for member in node.members:
        members.append(member)
        if isinstance(member, nodes.Machine):
            members += member.members
    return [m for m in members if isinstance(m, kinds)]


def _check_names(scope: NameScope, node: nodes.Species) -> None:
    """Report names that occur twice or are words of the language."""
    spans_by_name: dict[str, Span] = {}
    for member in _members_of_kind(node, nodes.Declaration, nodes.ParamDecl, nodes.Let, nodes.Latch, nodes.Fuzzy):
        each = member.declaration if isinstance(member, nodes.ParamDecl) else member
        if isinstance(each, nodes.Fuzzy):
            value_span = each.rules[0].value.span if each.rules else each.name.span
        else:
            value_span = each.on.span if isinstance(each, nodes.Latch) else each.value.span
        if each.name.text in spans_by_name:
            report_duplicate(scope.report, "name", each.name, spans_by_name[each.name.text])
        else:
            check_free_in_species(scope.report, each.name, value_span, scope.builtins)
        spans_by_name.setdefault(each.name.text, each.name.span)
    if len(spans_by_name) > limits.MAX_ATTRIBUTES:
        message = f"species `{node.name.text}` declares more than {limits.MAX_ATTRIBUTES} names"
        scope.report.error("too-many", message, node.name.span, "split it")


# --- the rest --------------------------------------------------------------------------------------------------------


def complete(work: SpeciesDraft) -> model.Species:
    """Check lets, latches, handlers, machines and layers. The attributes of all species must be known."""
    names, node = work.names, work.node
    key = ("species", node.name, names.edition, node.help, node.members, *work.attributes, *work.params)
    species, names.bindings = cached_part(work.scope.declared, key, lambda: (_completed(work), names.bindings))
    names.pending.clear()
    return species


def _completed(work: SpeciesDraft) -> model.Species:
    scope, node, names = work.scope, work.node, work.names
    declarations: dict[str, nodes.Declaration] = {}
    for member in node.members:
        if isinstance(member, nodes.Declaration):
            declarations.setdefault(member.name.text, member)
    attributes = [_with_relaxation(scope, a, declarations.get(a.name)) for a in work.attributes]
    named = tuple(_members_of_kind(node, nodes.Let, nodes.Latch, nodes.Fuzzy))
    bindings = cached_part(scope.declared, ("bindings", names.name, named), lambda: _bindings(scope, node))
    names.bindings = {binding.name: binding for binding in bindings}
    names.pending.clear()
    machines = _machines(scope.with_changes(no_keep=None), node)
    known = (names.name, *bindings)
    handling = tuple(m for m in node.members if isinstance(m, nodes.On))
    handlers = cached_part(
        scope.declared, ("handlers", handling, known), lambda: _handlers(scope.with_changes(no_keep=None), handling)
    )
    blocks = tuple(m for m in node.members if isinstance(m, nodes.Layers))
    layers = cached_part(
        scope.declared, ("layers", node.name, blocks, known), lambda: _layers(scope.with_changes(no_keep=None), node)
    )
    switched = switches(scope, node)
    return model.Species(
        names.name, node.help.text if node.help else "", tuple(attributes), tuple(work.params),
        tuple(b for b in bindings if b.role == "let"), tuple(b for b in bindings if b.role == "latch"),
        tuple(handlers), tuple(machines), layers, node.name.span,
        rest(scope.with_changes(keys=StableKeys(f"{names.name}.rest")), machines, node.name), scope.edition,
        switched["body_clearance"], switched["body_contacts"],
    )  # fmt: skip


def _with_relaxation(scope: NameScope, attribute: model.AttributeDecl, node: nodes.Declaration | None) -> model.AttributeDecl:
    """Return the attribute with its rest value and, for a pair value, the species of the other agents."""
    if node is None or (node.relax is None and node.each is None):
        return attribute
    to = over = None
    if node.relax is not None:
        if attribute.type.kind not in (TypeKind.NUMBER, TypeKind.VECTOR, TypeKind.BAD):
            message = f"`{attribute.name}` is {type_words(attribute.type)} and cannot relax"
            scope.report.error("wrong-kind", message, node.relax.span, "only numbers and vectors can change gradually")
        to = value_of_type(scope, node.relax.to, attribute.type, "`relax to`")
        over = value_of_type(scope, node.relax.over, TIME_TYPE, "`over`")
    each, strongest = None, 0
    if node.each is not None:
        type = reference_type(scope, node.each.species)
        if type is not None and type.kind is not TypeKind.AGENT:
            message = f"`{node.each.species.text}` is not a species"
            scope.report.error("wrong-kind", message, node.each.species.span, "`for each` stores values about other agents")
        each = node.each.species.text
        check_pair_value(scope, attribute, to)
        if node.each.strongest is None:
            message = f"`{attribute.name}` does not say for how many others it is stored"
            scope.report.error("missing-bound", message, node.each.span, f"write `for each {each}, strongest 8`")
        else:
            count = constant_behind(value_of_type(scope, node.each.strongest, ValueType(TypeKind.NUMBER), "`strongest`"))
            strongest = int(count.number) if count is not None else 0
            if count is None or not 1 <= count.number <= limits.MAX_PAIR_VALUES or count.number != strongest:
                scope.report.error(
                    "wrong-count",
                    f"`strongest` wants a whole number from 1 to {limits.MAX_PAIR_VALUES}, "
                    f"not {quote_source(node.each.strongest.span)}",
                    node.each.strongest.span,
                    "write `strongest 8`",
                )
    return model.AttributeDecl(
        attribute.name, attribute.type, attribute.default, False, attribute.help, attribute.span, to, over, each, strongest
    )  # fmt: skip


def _expressions_of(member: nodes.Let | nodes.Latch | nodes.Fuzzy) -> list[nodes.Expr]:
    if isinstance(member, nodes.Fuzzy):
        return [part for rule in member.rules for part in (rule.condition, rule.value)]
    return [member.value] if isinstance(member, nodes.Let) else [member.on, member.until]


def _bindings(scope: NameScope, node: nodes.Species) -> list[Binding]:
    """Return lets, latches and fuzzy values. Each comes after the bindings that it uses."""
    names = scope.species
    assert names is not None
    declared: dict[str, nodes.Let | nodes.Latch | nodes.Fuzzy] = {}
    for member in _members_of_kind(node, nodes.Let, nodes.Latch, nodes.Fuzzy):
        declared.setdefault(member.name.text, member)
    order, circular = order_declarations(scope.report, "lets", declared, _expressions_of, lambda m: m.name)
    bindings: list[Binding] = []
    for each in order:
        name = each.name.text
        inner = scope.with_changes(keys=StableKeys(f"{names.name}.{name}"))
        if name in circular:
            binding = Binding(
                name, "let", BAD_TYPE, ChangeRate.CONST, each.name.span, bad_expression(each.name.span), snapshot=True
            )
        elif isinstance(each, (nodes.Let, nodes.Fuzzy)):
            expr = fuzzy_mean(inner, each) if isinstance(each, nodes.Fuzzy) else inner.type_expression(each.value)
            binding = Binding(name, "let", expr.type, expr.rate, each.name.span, expr, snapshot=True)
        else:
            on, until = condition(inner, each.on, "`latch`"), condition(inner, each.until, "`until`")
            binding = Binding(name, "latch", BOOL_TYPE, ChangeRate.AGENT, each.name.span, on, until, f"{names.name}.{name}")
        names.bindings[name] = binding
        names.pending.discard(name)
        bindings.append(binding)
    return bindings


def _machines(scope: NameScope, node: nodes.Species) -> list[model.Machine]:
    names = scope.species
    assert names is not None
    machines: list[model.Machine] = []
    loose = [m for m in node.members if isinstance(m, (nodes.State, nodes.Start, nodes.Change))]
    if "main" in names.machines and any(isinstance(m, nodes.State) for m in loose):
        machines.append(machine(scope, names.machines["main"], loose, node.name.span))
    elif loose:
        message = "there are no states here"
        scope.report.error("unknown-state", message, loose[0].span, "move this line into the `machine` that it belongs to")
    known_names = {m.name for m in machines}
    for member in node.members:
        if isinstance(member, nodes.Machine) and member.name.text not in known_names:
            known_names.add(member.name.text)
            machines.append(machine(scope, names.machines[member.name.text], member.members, member.name.span))
    return machines


def _handlers(scope: NameScope, written: tuple[nodes.On, ...]) -> list[model.Handler]:
    events: dict[str, StableKeys] = {}
    return [_handler(scope, each, events) for each in written]


def _handler(scope: NameScope, node: nodes.On, events: dict[str, StableKeys]) -> model.Handler:
    """Check a handler. `events`: the keys of the earlier handlers by event, because two handlers of one event must not share
    random draws."""
    names, event = scope.species, node.event.text
    assert names is not None
    keys = events.setdefault(event, StableKeys(f"{names.name}.on.{event}"))
    scope = scope.with_changes(keys=keys, no_keep="an event does not happen at every step")
    other, partner_species = None, _partner_species(scope, node) if event == "collision" else ""
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
        scope = scope.with_changes(locals={node.variable.text: other or bad_expression(node.variable.span)})
    elif node.variable is not None:
        message = f"`on {event}` does not name an agent"
        scope.report.error("wrong-argument", message, node.variable.span, f"write `on {event} {{ … }}`")
        scope = scope.with_changes(locals={node.variable.text: bad_expression(node.variable.span)})
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


def _partner_species(scope: NameScope, node: nodes.On) -> str:
    """Return the species of the other agent in a collision: the named species, or the agent's own by default. "" after an
    error."""
    assert scope.species is not None
    if node.species is None:
        return scope.species.name
    name, known = node.species, list(scope.declared.species)
    thing = scope.declared.things.get(name.text)
    if name.text in known:
        scope.mark_used("species", name.text)
        scope.bind(name.span, "species", name.text)
        return name.text
    if thing is not None:
        advice = f"test it in a state: `when touching({name.text}) -> …`"
        scope.report.error("wrong-kind", f"`{name.text}` is not a species, but a collision is with an agent", name.span, advice)
    else:
        advice = did_you_mean(name.text, known, f"declare it: `world {{ species {name.text} }}`")
        scope.report.error("unknown-species", f"no species `{name.text}`", name.span, advice)
    return ""


def _check_distinct_name(scope: NameScope, variable: nodes.Name) -> None:
    """Report a name in the brackets of `on collision(…)` that already has another meaning."""
    if variable.text in scope.declared.species:
        message = f"`{variable.text}` is a species, but the name in brackets is the other agent"
        scope.report.error("wrong-argument", message, variable.span, f"write `on collision(other: {variable.text})`")
    elif variable.text == "self":
        message = "`self` is the agent itself, but the name in brackets is the other one"
        scope.report.error("wrong-argument", message, variable.span, "write `on collision(other)`")


# --- layers ----------------------------------------------------------------------------------------------------------


def _layers(scope: NameScope, node: nodes.Species) -> model.LayerStack:
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
            did_you_mean(mode, ("sum", "first"), "write `layers`, `layers sum` or `layers first`"),
        )
    if len(block.layers) > limits.MAX_STEERING_LAYERS:
        message = f"more than {limits.MAX_STEERING_LAYERS} layers"
        scope.report.error(
            "too-many", message, block.layers[limits.MAX_STEERING_LAYERS].span, "combine some of them in a behaviour"
        )
    scope = scope.with_changes(keys=StableKeys(f"{names.name}.layers"))
    counts: dict[str, int] = {}
    return model.LayerStack(mode, tuple(_layer(scope, each, counts) for each in block.layers), block.span)


def _layer(scope: NameScope, node: nodes.Layer, counts: dict[str, int]) -> model.Layer:
    """Check a layer. Its key is its first word, such as `separate`; a second layer with this word has the key `separate#2`."""
    text = " ".join(node.push.span.text.split())
    steered = isinstance(node.push, nodes.NameRef) and node.push.name.text == "state" and not node.faces
    word = _layer_word(node.push)
    if node.faces:
        text, word = f"face {text}", f"face {word}"
    counts[word] = counts.get(word, 0) + 1
    key = word if counts[word] == 1 else f"{word}#{counts[word]}"
    push = None
    own = scope.species
    taken = {*own.attributes, *own.bindings} if own else set()
    if node.faces:
        push = facing_direction(scope, node.push)
    elif isinstance(node.push, nodes.NameRef) and is_state_name(scope, word) and own and word not in taken:
        message = f"`{word}` is a state, but a layer must be a wish"
        scope.report.error("state-as-value", message, node.push.span, "did you mean `state`?")  # probably means the steering
        push = bad_expression(node.push.span)
    elif not steered:
        push = value_of_type(scope, node.push, PUSH_TYPE, "a layer")
    test = condition(scope, node.condition, "`when`") if node.condition is not None else None
    return model.Layer(push, test, text, node.span, key, node.faces)


def _layer_word(push: nodes.Expr) -> str:
    while isinstance(push, (nodes.Binary, nodes.Unary, nodes.Call)):
        push = push.left if isinstance(push, nodes.Binary) else push.operand if isinstance(push, nodes.Unary) else push.function
    if isinstance(push, nodes.Member):
        return push.name.text
    return push.name.text if isinstance(push, nodes.NameRef) else "push"
