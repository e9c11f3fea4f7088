"""Checks the types and initial values of a species' attributes.

Each attribute is placed after the attributes that its initial value reads."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

from antdsl.diagnostics import Label
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program import model
from antdsl.program.declarations.behaviours import resolve_declared_type
from antdsl.program.kinds import BAD_TYPE, BOOL_TYPE
from antdsl.program.model import Expr, TypeKind
from antdsl.program.names.ordering import order_declarations
from antdsl.program.names.scope import (
    NameScope,
    SpeciesNames,
    StableKeys,
    is_known_missing,
    make_bad_expression,
    parse_type_words,
    report_duplicate,
    suggest_name,
)
from antdsl.program.tables.defaults import parse_default
from antdsl.program.tables.editions import (
    CRAWLING_SIZE_SETTING,
    DEFAULT_BY_SETTING,
    NO_LIMIT_WORD,
    OPTIONAL_ATTRIBUTES,
    STANDING_DEFAULTS,
    STANDING_SIZE_SETTING,
    SWITCH_EDITION,
    SWITCH_HELP,
)
from antdsl.program.tables.vocabulary import (
    BUILTIN_ATTRIBUTE_BY_NAME,
    BUILTINS_BY_NAME,
    REDUCER_HELP,
    SENSE_REPLACEMENTS,
    explain_range,
)
from antdsl.program.types.descriptions import describe_type, quote_source
from antdsl.program.types.folding import find_constant
from antdsl.program.types.operators import type_value, type_value_as
from antdsl.source import Span
from antdsl.syntax import nodes
from antdsl.syntax.words import LANGUAGE_WORDS

_STORABLE_KINDS = (TypeKind.NUMBER, TypeKind.VECTOR, TypeKind.BOOL, TypeKind.ITEM, TypeKind.AGENT, TypeKind.BAD)
_TOO_EARLY_REASON = "starting values are computed before the animal has sensed anything"


# --- attributes ------------------------------------------------------------------------------------------------------


def check_attributes(scope: NameScope, node: nodes.Species) -> list[model.AttributeDecl]:
    """Return the built-in attributes and the species' own attributes. Each comes after the attributes that its initial value
    reads."""
    declared: dict[str, nodes.Declaration | nodes.AnimalProperty] = {}
    assert scope.species is not None
    for name, row in scope.builtins.items():
        default = get_default_text(name, scope.species) if row.is_settable else None
        if default is not None and default != NO_LIMIT_WORD and not has_default_without_register(name, scope.species):
            declared[name] = nodes.AnimalProperty(
                nodes.Name(name, node.name.span), parse_default(default, node.name.span), None, node.name.span
            )
    written: dict[str, Span] = {}
    for member in node.members:
        if isinstance(member, nodes.AnimalProperty):
            if member.name.text in written:
                report_duplicate(scope.report, "property", member.name, written[member.name.text])
            if member.name.text not in SWITCH_HELP and _is_settable(scope, member):
                declared[member.name.text] = member
            written.setdefault(member.name.text, member.name.span)
        elif isinstance(member, nodes.Declaration) and member.name.text not in scope.builtins:
            declared.setdefault(member.name.text, member)
    if scope.edition >= SWITCH_EDITION:
        _check_extent(scope, node, written)
    order, circular = order_declarations(scope.report, "starting values", declared, lambda d: [d.value], lambda d: d.name)
    declarations = [_check_attribute(scope, each, each.name.text in circular) for each in order]
    _check_speeds(scope, declarations, declared)
    return declarations


def _check_extent(scope: NameScope, node: nodes.Species, span_by_name: Mapping[str, Span]) -> None:
    """Check that a species sets exactly one of `size` and `height`."""
    size, height = span_by_name.get(CRAWLING_SIZE_SETTING), span_by_name.get(STANDING_SIZE_SETTING)
    if size is not None and height is not None:
        message = "`size` follows from `height` and the body"
        labels = (Label(height, "the height is here"),)
        scope.report.error("duplicate-name", message, size, "delete one of the two lines", labels=labels)
    elif size is None and height is None and node.members:
        message = f"`{node.name.text}` has no size"
        advice = "write `size 4 mm`, or `height 1.7 m` for a standing body"
        scope.report.error("missing-setting", message, node.name.span, advice)


def _check_speeds(
    scope: NameScope,
    declarations: list[model.AttributeDecl],
    nodes_by_name: Mapping[str, nodes.Declaration | nodes.AnimalProperty],
) -> None:
    """Check that the lowest speed of a species is not above its highest speed. A speed that is not known is not checked."""
    known = {each.name: find_constant(each.default) for each in declarations if each.name in ("min_speed", "max_speed")}
    least, most = known.get("min_speed"), known.get("max_speed")
    if (
        least is None
        or most is None
        or (least.unit_power, least.step) != (most.unit_power, most.step)
        or least.number <= most.number
    ):
        return
    place, fastest = nodes_by_name["min_speed"].value.span, nodes_by_name["max_speed"]
    usual = fastest.span == fastest.name.span  # the default, not in the source
    text = f"`{BUILTIN_ATTRIBUTE_BY_NAME['max_speed'].default}`" if usual else quote_source(fastest.value.span)
    scope.report.error("out-of-range", f"`min_speed` is more than `max_speed`, which is {text}", place, f"write {text} or less")


def get_default_text(name: str, species: SpeciesNames) -> str | None:
    """Return the default of a species' setting as text in the language. Return None if the setting has no default."""
    if species.has_standing_bodies and name in STANDING_DEFAULTS:
        return STANDING_DEFAULTS[name]
    row = DEFAULT_BY_SETTING.get(name)
    return BUILTIN_ATTRIBUTE_BY_NAME[name].default if row is None else row.get_default(species.edition) or None


def has_default_without_register(name: str, species: SpeciesNames) -> bool:
    """Return whether an attribute has a default that applies even in species without a register for the attribute."""
    return name in OPTIONAL_ATTRIBUTES and not (species.has_standing_bodies and name in STANDING_DEFAULTS)


def find_switches(scope: NameScope, node: nodes.Species) -> dict[str, bool]:
    """Return, by name, whether each switch of a species is on. A switch is a setting such as `body_clearance`.

    A switch that the text does not set has the default of the edition."""
    assert scope.species is not None
    values = {name: get_default_text(name, scope.species) == "true" for name in SWITCH_HELP}
    for member in node.members:
        if not isinstance(member, nodes.AnimalProperty) or member.name.text not in SWITCH_HELP:
            continue
        name = member.name.text
        if scope.edition < SWITCH_EDITION:
            _report_later_edition(scope, member, SWITCH_EDITION)
            continue
        constant = find_constant(type_value_as(scope.with_changes(is_evaluated_once=True), member.value, BOOL_TYPE, f"`{name}`"))
        if constant is not None:
            values[name] = bool(constant.number)
        elif not any(d.span == member.value.span for d in scope.report.diagnostics):
            message = f"`{name}` is a setting of the species, which has one value"
            scope.report.error("wrong-rate", message, member.value.span, f"write `{name} true` or `{name} false`")
    return values


def _report_later_edition(scope: NameScope, member: nodes.AnimalProperty, edition: int) -> None:
    message = f"`{member.name.text}` exists from edition {edition} on"
    path = scope.file.node.source.path
    advice = f"run `antdsl fmt --edition {edition} {path}`, which makes `ant {edition}` of the first line"
    scope.report.error("unknown-property", message, member.name.span, advice)


def _is_settable(scope: NameScope, member: nodes.AnimalProperty) -> bool:
    row, name = scope.builtins.get(member.name.text), member.name
    if row is not None and row.is_settable:
        return True
    later = BUILTIN_ATTRIBUTE_BY_NAME.get(name.text)
    if row is None and later is not None and later.is_settable and later.edition > scope.edition:
        _report_later_edition(scope, member, later.edition)
        return False
    known = [n for n, g in scope.builtins.items() if g.is_settable]
    if row is None and scope.species and isinstance(member.value, nodes.NameRef) and is_state_name(scope, member.value.name.text):
        known = ["start"]  # as in `strat search`: of these words, only `start` is followed by a state
        if find_nearest_name(name.text, known):
            scope.report.error("unknown-property", f"an animal has no property `{name.text}`", name.span, "did you mean `start`?")
            return False
    text = " ".join(member.value.span.text.split())
    if row is not None:
        better = (
            f"`max_speed {text}` sets its highest speed" if name.text == "speed" else "it is computed from the agent's motion"
        )
        scope.report.error("not-settable", f"`{name.text}` cannot be set", name.span, better)
    else:
        scope.report.error(
            "unknown-property",
            f"an animal has no property `{name.text}`",
            name.span,
            _suggest_place(name.text)
            or suggest_name(name.text, known, f"write an attribute of your own as `{name.text} = {text}`"),
        )
        is_known_missing(scope, "name", name)  # the misspelt line was meant to declare it
    type_value(scope.with_changes(is_evaluated_once=True), member.value)
    return False


def _suggest_place(word: str) -> str | None:
    """Return advice about where a word may be used in a program. Return None if `word` is not a word of the language.

    Such words, such as the names of senses, cannot be attribute names."""
    if word in SENSE_REPLACEMENTS:
        return f"write the sense where its value is needed: {SENSE_REPLACEMENTS[word].replace('X', 'food')}"
    if word in BUILTINS_BY_NAME or word in REDUCER_HELP:
        return f"`{word}` belongs where its value is needed: `let x = {word}(…)`"
    return f"`{word}` is a word of the language that cannot begin a line here" if word in LANGUAGE_WORDS else None


def is_state_name(scope: NameScope, word: str) -> bool:
    """Return whether a word is the name of a state of the species."""
    return scope.species is not None and any(word in machine.states for machine in scope.species.machines.values())


def _check_attribute(scope: NameScope, node: nodes.Declaration | nodes.AnimalProperty, is_circular: bool) -> model.AttributeDecl:
    names, name = scope.species, node.name.text
    assert names is not None
    inner = scope.with_changes(keys=StableKeys(f"{names.name}.{name}"), no_let_reason=_TOO_EARLY_REASON, is_evaluated_once=True)
    help = node.help.text if node.help else ""
    if isinstance(node, nodes.AnimalProperty):
        type = parse_type_words(BUILTIN_ATTRIBUTE_BY_NAME[name].type) or BAD_TYPE
        default = make_bad_expression(node.value.span) if is_circular else _type_builtin_default(inner, node, type)
        _check_positive(scope, node, default)
        return model.AttributeDecl(name, type, default, True, help, node.name.span)
    stated = resolve_declared_type(scope, node.type) if node.type is not None else None
    stated = None if stated == BAD_TYPE else stated
    if is_circular:
        default = make_bad_expression(node.value.span)
    else:
        default = type_value(inner, node.value) if stated is None else type_value_as(inner, node.value, stated, f"`{name}`")
    type = stated or default.type
    if type.kind not in _STORABLE_KINDS:
        advice = "an attribute is a number, a vector, a yes or no, an item or an agent"
        scope.report.error("wrong-kind", f"{describe_type(type)} cannot be an attribute", node.value.span, advice)
        type = BAD_TYPE
    names.attributes[name] = type
    if node.each is not None:
        names.pair_value_species[name] = node.each.species.text
    if node.range is not None:
        message = f"only a param can have a range, but `{name}` is an attribute"
        scope.report.error("wrong-kind", message, node.range.span, f"write `param {name} = …`, or leave the range out")
    return model.AttributeDecl(name, type, default, False, help, node.name.span)


def _type_builtin_default(scope: NameScope, node: nodes.AnimalProperty, type: model.ValueType) -> Expr:
    """Return the initial value of a built-in attribute that a species sets. For `none`, which means no limit, it is infinite."""
    name, limits = node.name.text, BUILTIN_ATTRIBUTE_BY_NAME[node.name.text].can_be_unlimited
    if limits and isinstance(node.value, nodes.NoneOf) and node.value.of is None:
        return model.Constant(type, model.ChangeRate.CONST, node.value.span, inf)
    return type_value_as(scope, node.value, type, f"`{name}`")


def _check_positive(scope: NameScope, node: nodes.AnimalProperty, default: Expr) -> None:
    constant = find_constant(default)
    help = None if constant is None else explain_range(node.name.text, constant.number)
    if help is not None:
        scope.report.error("out-of-range", f"`{node.name.text}` cannot be {quote_source(node.value.span)}", node.value.span, help)
