"""Determines the types of literals, names and values of things. Calls, operators and behaviours are in other files; `rules`
lists all typing functions."""

from __future__ import annotations

from dataclasses import dataclass

from antdsl import limits
from antdsl.diagnostics import Fix
from antdsl.program.kinds import BAD_TYPE, BOOL_TYPE
from antdsl.program.model import (
    AttributeRef,
    Binding,
    BindingRef,
    ChangeRate,
    Constant,
    Expr,
    NoneRef,
    OperationExpr,
    ParamRef,
    SetExpr,
    ThingRef,
    TypeKind,
    ValueType,
)
from antdsl.program.names.missing_things import suggest_missing_thing
from antdsl.program.names.scope import (
    NameScope,
    find_attributes,
    is_known_missing,
    list_names,
    make_bad_expression,
    parse_type_words,
    suggest_name,
)
from antdsl.program.tables.foreign_words import NAME_REPLACEMENTS
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.tables.units import make_constant, make_number
from antdsl.program.tables.vocabulary import (
    BUILTINS_BY_NAME,
    REDUCER_HELP,
    RESERVED_WORDS,
    RUN_VALUE_TYPES,
    SENSE_TYPE_BY_NAME,
    UNIT_BY_NAME,
)
from antdsl.program.types.descriptions import describe_type, quote_source
from antdsl.program.types.states import STATE_WORDS, find_machine, type_machine_value, type_state_word
from antdsl.source import Span
from antdsl.syntax import nodes
from antdsl.syntax.words import UNIT_NAMES

THING_KINDS = frozenset((TypeKind.FIELD, TypeKind.VECTOR_FIELD, *(TypeKind(word) for word in KIND_BY_WORD)))
OPTIONAL_KINDS = frozenset({TypeKind.ITEM, TypeKind.AGENT, TypeKind.HIT})


# --- literals --------------------------------------------------------------------------------------------------------


def type_number(scope: NameScope, node: nodes.Number, expected_type: ValueType | None) -> Expr:
    """Type a number without a unit."""
    return make_number(node.value, node.span)


def type_quantity(scope: NameScope, node: nodes.Quantity, expected_type: ValueType | None) -> Expr:
    """Type a number with a unit. Report an unknown unit."""
    expr = make_constant(node.value, node.unit, node.span)
    if expr is not None:
        if abs(expr.number) > limits.MAX_NUMBER:
            message = f"{quote_source(node.span)} is too large to store"
            scope.report.error("number-too-large", message, node.span, "write a smaller number")
        return expr
    units = ", ".join(f"`{unit}`" for unit in UNIT_BY_NAME)
    words = f"no unit `{node.unit}`"
    scope.report.error("unknown-unit", words, node.unit_span, suggest_name(node.unit, UNIT_BY_NAME, f"units are {units}"))
    return make_bad_expression(node.span)


def type_none(scope: NameScope, node: nodes.NoneOf, expected_type: ValueType | None) -> Expr:
    """Type `none` or `none of food`. The expected type determines the meaning of a bare `none`."""
    if node.of is None:
        if expected_type is not None and expected_type.kind in OPTIONAL_KINDS:
            return NoneRef(expected_type, ChangeRate.CONST, node.span)
        advice = "write `none of food` or `none of rabbit`, with the name that is meant"
        return scope.report_error("none-of-what", "the type of `none` is unknown here", node.span, advice)
    type = find_reference_type(scope, node.of)
    return make_bad_expression(node.span) if type is None else NoneRef(type, ChangeRate.CONST, node.span)


def find_reference_type(scope: NameScope, name: nodes.Name) -> ValueType | None:
    """Return the type of one item of the items `name`, or of one agent of the species `name`. For other names, report an error
    and return None."""
    declared = scope.declarations
    thing = declared.things.get(name.text)
    if thing is not None and KIND_BY_WORD[thing.kind].is_item_group:
        scope.mark_used("thing", name.text)
        scope.record_name_use(name.span, "thing", name.text)
        return ValueType(TypeKind.ITEM, referent=name.text)
    if name.text in declared.species:
        scope.mark_used("species", name.text)
        scope.record_name_use(name.span, "species", name.text)
        return ValueType(TypeKind.AGENT, referent=name.text)
    known = [t.name for t in declared.things.values() if KIND_BY_WORD[t.kind].is_item_group] + list(declared.species)
    scope.report.error(
        "unknown-name", f"no items or species `{name.text}`", name.span,
        suggest_name(name.text, known, f"declare it: `world {{ items {name.text} }}`"),
    )  # fmt: skip
    return None


# --- names -----------------------------------------------------------------------------------------------------------


def type_name(scope: NameScope, node: nodes.NameRef, expected_type: ValueType | None) -> Expr:
    name, span = node.name.text, node.span
    for look in (
        _type_local_name,
        _type_element_value,
        _type_language_word,
        _type_species_value,
        _type_builtin_value,
        _type_world_value,
    ):
        expr = look(scope, name, span)
        if expr is not None:
            return expr
    return _report_unknown(scope, node, expected_type)


def _type_local_name(scope: NameScope, name: str, span: Span) -> Expr | None:
    local_value = scope.local_names.get(name)
    if local_value is None:
        return None
    if isinstance(local_value, Binding):
        scope.mark_used("local", f"{local_value.span}:{name}")
        scope.record_local_name_use(span, local_value.span)
        return make_binding_ref(scope, local_value, span)
    if local_value.type.kind is TypeKind.BAD:
        scope.record_local_name_use(span, local_value.span)
    else:
        scope.record_name_use(
            span, "species" if local_value.type.kind is TypeKind.AGENT else "thing", name
        )  # one of them, in a spec
    return local_value


def make_binding_ref(scope: NameScope, binding: Binding, span: Span) -> Expr:
    """Return an expression for a use of a named value."""
    if binding.role == "let" and binding.is_snapshot and scope.no_let_reason:
        _report_early_use(scope, binding.name, span)
    if binding.type.kind is TypeKind.SET and isinstance(binding.value, SetExpr):
        return binding.value
    return BindingRef(binding.type, binding.rate, span, binding)


def _report_early_use(scope: NameScope, name: str, span: Span) -> None:
    scope.report.error(
        "let-too-early", f"`{name}` cannot be read here: {scope.no_let_reason}", span, "set it in `on spawn { … }`"
    )


def report_pair_value(scope: NameScope, node: nodes.Name, owner: str = "") -> Expr:
    """Report a pair value that is used without another agent in brackets. Return a placeholder."""
    help = f"read it as the agent that stores it: `{node.text}[other]`" if owner else f"write `{node.text}[other]`"
    return scope.report_error("wrong-kind", f"`{node.text}` is a value per pair: name the other agent", node.span, help)


def _type_element_value(scope: NameScope, name: str, span: Span) -> Expr | None:
    if scope.element is None:
        return None
    element = scope.element
    owner = BindingRef(element.type, ChangeRate.ELEMENT, span, element)
    if name == "it":
        return owner
    if name in STATE_WORDS and element.type.kind is TypeKind.AGENT:
        return type_state_word(scope, owner, name, span, None)
    type = find_attributes(scope.declarations, element.type).get(name)
    if type is None:
        return None
    scope.record_value_use(span, element.type, name)
    return make_attribute_ref(scope, owner, name, type, span)


def _type_language_word(scope: NameScope, name: str, span: Span) -> Expr | None:
    if name == "self":
        return ThingRef(
            ValueType(TypeKind.AGENT, referent=scope.species.name if scope.species else None), ChangeRate.AGENT, span, "self"
        )
    if name in ("true", "false"):
        return Constant(BOOL_TYPE, ChangeRate.CONST, span, float(name == "true"))
    return None


def _type_species_value(scope: NameScope, name: str, span: Span) -> Expr | None:
    """Return the value of a name that belongs to the species: a param, attribute, let, latch, or value of a machine. Return None
    for other names, and inside a behaviour."""
    species = scope.species
    if species is None or scope.behaviour is not None:
        return None
    scope.record_own_name_use(span, name)
    if name in species.params:
        scope.mark_used("param", f"{species.name}.{name}")
        return ParamRef(species.params[name], ChangeRate.RUN, span, f"{species.name}.{name}")
    if name in species.pair_value_species:
        return report_pair_value(scope, nodes.Name(name, span))
    if name in species.attributes:
        scope.mark_used("attribute", f"{species.name}.{name}")
        return AttributeRef(species.attributes[name], ChangeRate.AGENT, span, None, name)
    if name in species.bindings:
        scope.mark_used("let", f"{species.name}.{name}")
        return make_binding_ref(scope, species.bindings[name], span)
    if name in species.untyped_names:
        scope.mark_used("let", f"{species.name}.{name}")
        if scope.no_let_reason:
            _report_early_use(scope, name, span)
        return make_bad_expression(span)
    if name in STATE_WORDS and species.machines:
        return type_state_word(scope, None, name, span, None)
    return None


def _type_builtin_value(scope: NameScope, name: str, span: Span) -> Expr | None:
    if name in scope.builtins:
        type = parse_type_words(scope.builtins[name].type)
        return AttributeRef(type or BAD_TYPE, ChangeRate.AGENT, span, None, name)
    if name in RUN_VALUE_TYPES:
        type, rate = parse_type_words(RUN_VALUE_TYPES[name]) or BAD_TYPE, ChangeRate.RUN if name == "dt" else ChangeRate.STEP
        return OperationExpr(type, rate, span, "run", (ThingRef(type, rate, span, name),))
    if name in SENSE_TYPE_BY_NAME:
        return OperationExpr(parse_type_words(SENSE_TYPE_BY_NAME[name]) or BAD_TYPE, ChangeRate.AGENT, span, name, ())
    return None


def _type_world_value(scope: NameScope, name: str, span: Span) -> Expr | None:
    declared = scope.declarations
    if name in declared.fields:
        scope.mark_used("field", name)
        scope.record_name_use(span, "field", name)
        kind = TypeKind.VECTOR_FIELD if declared.fields[name].has_vectors else TypeKind.FIELD
        return ThingRef(ValueType(kind), ChangeRate.CONST, span, name)
    if name in declared.species:
        scope.mark_used("species", name)
        scope.record_name_use(span, "species", name)
        return ThingRef(ValueType(TypeKind.SPECIES, referent=name), ChangeRate.CONST, span, name)
    thing = declared.things.get(name)
    if thing is not None:
        scope.mark_used("thing", name)
        scope.record_name_use(span, "thing", name)
        kind = TypeKind(KIND_BY_WORD[thing.kind].type_word or thing.kind)
        return ThingRef(ValueType(kind, referent=name), ChangeRate.CONST, span, name)
    if name in declared.events and scope.species is not None:
        scope.mark_used("event", name)
        scope.mark_used("heard", f"{name} {scope.species.name}")
        scope.record_name_use(span, "event", name)
        return OperationExpr(BOOL_TYPE, ChangeRate.AGENT, span, "event", (ThingRef(BOOL_TYPE, ChangeRate.CONST, span, name),))
    return None


def list_visible_names(scope: NameScope) -> set[str]:
    """Return every name that may be used as a value at this position."""
    names = {*scope.local_names, *scope.builtins, *RUN_VALUE_TYPES, *SENSE_TYPE_BY_NAME, "self", "true", "false"}
    declared = scope.declarations
    names |= {*declared.fields, *declared.things, *declared.species, *declared.events}
    if scope.species is not None and scope.behaviour is None:
        own = scope.species
        names |= set(own.params) | set(own.attributes) | set(own.bindings) | own.untyped_names
        names |= {*STATE_WORDS, *own.machines} if own.machines else set()
    if scope.element is not None:
        names |= {"it", *find_attributes(scope.declarations, scope.element.type)}
    return names


def _report_unknown(scope: NameScope, node: nodes.NameRef, expected_type: ValueType | None) -> Expr:
    name, report = node.name.text, scope.report
    if name in scope.declarations.unclear_things:
        return make_bad_expression(node.span)
    if is_known_missing(scope, "name", node.name):
        return make_bad_expression(node.span)
    if name in RESERVED_WORDS:
        report.error("not-yet", f"`{name}` is a word of the language that does not work yet", node.span, "do not use it yet")
    elif scope.species is not None and any(name in m.states for m in scope.species.machines.values()):
        report.error("state-as-value", f"`{name}` is a state and has no value", node.span, f"test it with `state == {name}`")
    elif scope.species is not None and scope.behaviour is not None and name in scope.species.attributes:
        message = f"a behaviour cannot read `{name}` of the species that calls it"
        report.error("unknown-name", message, node.span, f"pass it as an argument: `{name}: …`")
    elif name in BUILTINS_BY_NAME or name in REDUCER_HELP or scope.file.find_behaviour(name) is not None:
        behaviour = scope.file.find_behaviour(name)
        defaults = [None] if behaviour is None else [argument.default for argument in behaviour.node.arguments]
        alone = None not in defaults or (name in BUILTINS_BY_NAME and not BUILTINS_BY_NAME[name][0].args)
        report.error("call-without-brackets", f"`{name}` needs brackets", node.span, f"write `{name}({'' if alone else '…'})`")
    else:
        advice, fix = suggest_missing_thing(scope, name, expected_type) or _make_foreign_word_fix(name, node.span)
        if advice is None:
            advice = suggest_name(
                name,
                list_visible_names(scope),
                f"declare it, or use one of {list_names(list_visible_names(scope) - set(scope.builtins))}",
            )
        report.error("unknown-name", f"no `{name}` is known here", node.span, advice, fix=fix)
    return make_bad_expression(node.span)


def _make_foreign_word_fix(name: str, span: Span) -> tuple[str | None, Fix | None]:
    """Return help and a fix for a name that is a unit without a number, or a word from another tool."""
    unit = f"a unit follows its number and contains no spaces: `1 {name}`, `30 mm/s`" if name in UNIT_NAMES else None
    instead = NAME_REPLACEMENTS.get(name)
    if instead is None:
        return unit, None
    return f"write `{instead}`{f', how long a step lasts; {unit}' if unit else ''}", Fix(span, instead)


# --- values of things ------------------------------------------------------------------------------------------------


def make_attribute_ref(scope: NameScope, owner: Expr, name: str, type: ValueType, span: Span) -> Expr:
    """Return the expression `owner.name`. The value must be known to exist."""
    if isinstance(owner, ThingRef) and owner.name == "self":
        scope.mark_used("attribute", f"{owner.type.referent}.{name}")
        return AttributeRef(type, ChangeRate.AGENT, span, None, name)
    if owner.type.kind is TypeKind.AGENT:
        scope.mark_used("attribute", f"{owner.type.referent}.{name}")
    return AttributeRef(type, max(owner.rate, ChangeRate.AGENT), span, owner, name)


def type_member(scope: NameScope, node: nodes.Member, expected_type: ValueType | None) -> Expr:
    machine = find_machine(scope, node.owner)
    if machine is not None:
        scope.record_name_use(node.owner.span, "machine", machine.key.partition(".")[0], machine.name)
        return type_machine_value(scope, machine, node)
    owner = scope.type_expression(node.owner)
    name, kind = node.name.text, owner.type.kind
    if kind is TypeKind.BAD:
        return owner
    if kind is TypeKind.SPECIES:
        return _type_param(scope, owner, node)
    if kind is TypeKind.AGENT and name in STATE_WORDS:
        return type_state_word(scope, owner, name, node.span, node.name.span)
    known = find_attributes(scope.declarations, owner.type)
    if name in known:
        scope.record_value_use(node.name.span, owner.type, name)
        species = scope.declarations.species.get(owner.type.referent or "") if kind is TypeKind.AGENT else None
        if species is not None and name in species.pair_value_species:
            return report_pair_value(scope, node.name, owner.type.referent or "")
        return make_attribute_ref(scope, owner, name, known[name], node.span)
    scope.record_possible_use(node.name, owner.type)
    _report_no_member(scope, owner, node, known)
    return make_bad_expression(node.span)


def _report_no_member(scope: NameScope, owner: Expr, node: nodes.Member, known_types: dict[str, ValueType]) -> None:
    name, kind, text = node.name.text, owner.type.kind, " ".join(node.owner.span.text.split())
    if kind is TypeKind.ITEMS:
        advice = f"name one: `nearest({text}).{name}`" if name != "position" else f"`position({text})`"
        scope.report.error(
            "wrong-kind", f"`{text}` means all items of that name, but `{name}` is a value of one item", node.span, advice
        )
    elif known_types:
        advice = suggest_name(name, known_types, f"there is {list_names(known_types)}")
        scope.report.error("unknown-name", f"{describe_type(owner.type)} has no `{name}`", node.name.span, advice)
    elif kind is TypeKind.VECTOR:
        message = f"components of a vector have no names, so no `{name}`"
        scope.report.error("wrong-kind", message, node.name.span, f"the component along a direction is `dot({text}, up)`")
    else:
        message = f"{quote_source(node.owner.span)} is {describe_type(owner.type)} and has no values"
        scope.report.error("wrong-kind", message, node.span, f"leave `.{name}` out")


def _type_param(scope: NameScope, owner: Expr, node: nodes.Member) -> Expr:
    names = scope.declarations.species[owner.type.referent] if owner.type.referent else None
    if names is not None and node.name.text in names.params:
        scope.mark_used("param", f"{names.name}.{node.name.text}")
        scope.record_name_use(node.name.span, "own", names.name, node.name.text)
        return ParamRef(names.params[node.name.text], ChangeRate.RUN, node.span, f"{names.name}.{node.name.text}")
    scope.record_possible_use(node.name, owner.type)
    species = owner.type.referent or "species"
    message = f"`{species}` is a whole species, but `{node.name.text}` is a value of one agent"
    return scope.report_error("wrong-kind", message, node.span, f"name one: `nearest({species}).{node.name.text}`")


@dataclass(frozen=True, slots=True)
class TypedArgument:
    """A node that stands for an argument that is already typed, so that it is not typed again."""

    expr: Expr
    span: Span


def type_typed_argument(scope: NameScope, node: TypedArgument, expected_type: ValueType | None) -> Expr:
    return node.expr


def type_bad_expression(scope: NameScope, node: nodes.BadExpr, expected_type: ValueType | None) -> Expr:
    return make_bad_expression(node.span)


def reject_range(scope: NameScope, node: nodes.RangeExpr, expected_type: ValueType | None) -> Expr:
    scope.type_expression(node.low)
    scope.type_expression(node.high)
    message = f"a range {quote_source(node.span)} is not allowed here"
    return scope.report_error("wrong-kind", message, node.span, "ranges are for arguments such as `from: 0 mm .. 5 mm`")
