"""Checks the params of a species: each has a value, and a range within which it may change.

If the value and the two ends do not match, the finding marks the number that contradicts the other two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from antdsl.diagnostics import Fix, Label
from antdsl.program import model
from antdsl.program.declarations.behaviours import declared_type
from antdsl.program.kinds import BAD_TYPE
from antdsl.program.model import Constant, TypeKind, ValueType
from antdsl.program.names.scope import NameScope
from antdsl.program.tables.units import constant, default_unit, dimension_words, number, unit_spelling
from antdsl.program.tables.vocabulary import UNIT_BY_NAME
from antdsl.program.types.descriptions import is_compatible, quote_source, report_mismatch, type_words
from antdsl.program.types.folding import constant_behind
from antdsl.program.types.operators import value
from antdsl.source import Span
from antdsl.syntax import nodes


@dataclass(frozen=True, slots=True)
class _ParamNumber:
    """The value or one end of the range: its syntax node and its constant."""

    node: nodes.Expr
    const: Constant

    @property
    def is_unitless(self) -> bool:
        return isinstance(self.node, nodes.Number)

    @property
    def unit(self) -> str:
        """Return the unit as in the source."""
        return unit_spelling(self.node)


def param(scope: NameScope, node: nodes.Declaration) -> model.Param | None:
    """Check a param and its range. Return None if its value is not constant."""
    names, name = scope.species, node.name.text
    assert names is not None
    names.params[name] = BAD_TYPE
    for extra, word in ((node.relax, "relax"), (node.each, "for each")):
        if extra is not None:
            message = f"a param has one value for all agents, so it cannot have `{word}`"
            scope.report.error("wrong-kind", message, extra.span, f"leave `param` out to make `{name}` an attribute")
    default = _constant(scope, node.value, f"param `{name}`")
    if default is None:
        return None
    if node.type is not None:
        type = declared_type(scope, node.type)
        if not is_compatible(default.type, type):
            report_mismatch(scope.report, node.value, default.type, type, f"param `{name}`")
    low = high = None
    if node.range is not None:
        low, high = (_constant(scope, end, f"the range of `{name}`") for end in (node.range.low, node.range.high))
        if low is not None and high is not None:
            three = [_ParamNumber(node.value, default), _ParamNumber(node.range.low, low), _ParamNumber(node.range.high, high)]
            default, low, high = (each.const for each in _unify_types(scope, node, three))
    names.params[name] = default.type
    help = node.help.text if node.help else ""
    return model.Param(f"{names.name}.{name}", default.type, default, low, high, unit_spelling(node.value), help, node.name.span)


def _constant(scope: NameScope, node: nodes.Expr, who: str) -> Constant | None:
    """Return the constant value of an expression; report an error and return None if it is not constant."""
    expr = value(scope, node)
    constant = constant_behind(expr)
    if constant is None and expr.type.kind is not TypeKind.BAD:
        message = f"{quote_source(node.span)} is not a plain number, which {who} starts with"
        scope.report.error("wrong-rate", message, node.span, "write a number with its unit, such as `40 mm`")
    return constant


def _unify_types(scope: NameScope, node: nodes.Declaration, three: list[_ParamNumber]) -> list[_ParamNumber]:
    """Return the value and both ends with one type. A number of another type is reported, and gets the type of the others."""
    types = [each.const.type for each in three]
    if types[0] == types[1] == types[2]:
        _check_order(scope, node, three)
        return three
    unit_numbers = [each for each in three if not each.is_unitless]
    reference = unit_numbers[0].const if unit_numbers else three[0].const
    if len(unit_numbers) < 3 and all(each.const.type == reference.type for each in unit_numbers):
        _report_missing_units(scope, three, unit_numbers)
    else:
        odd = next((n for n in range(3) if types[n - 1] == types[n - 2]), None)
        if odd is None:
            what = ", ".join(f"{quote_source(each.node.span)} is {type_words(each.const.type)}" for each in three)
            assert node.range is not None
            span = Span(node.value.span.source, node.value.span.start, node.range.span.end)
            scope.report.error("units-differ", f"{what}: a param and its range want all alike", span, "give them one unit")
        else:
            reference = three[odd - 1].const
            who = f"the range of `{node.name.text}`" if odd else f"`{node.name.text}`, which has such a range,"
            _report_odd_type(scope, three, odd, reference.type, who)
    return [replace(each, const=_with_type_of(each.const, reference)) for each in three]


def _with_type_of(const: Constant, reference: Constant) -> Constant:
    if const.type == reference.type:
        return const
    return Constant(reference.type, const.rate, const.span, const.number, reference.u, reference.step)


def _report_odd_type(scope: NameScope, three: Sequence[_ParamNumber], odd: int, expected: ValueType, who: str) -> None:
    """Report the number `three[odd]`, which has another type than the other two."""
    node, type = three[odd].node, three[odd].const.type
    if (type.kind, expected.kind) != (TypeKind.NUMBER, TypeKind.NUMBER):
        report_mismatch(scope.report, node, type, expected, who)
        return
    want = dimension_words(expected.dim)
    instead = _fitting_text(three, odd)
    message = f"{quote_source(node.span)} is {type_words(type)}, and {who} wants {want}"
    advice = f"write {want}" if odd else f"write {want} inside the range"
    fix = None if instead is None else Fix(node.span, instead)
    scope.report.error("wrong-unit", message, node.span, advice if fix is None else f"{advice}, such as `{instead}`", fix=fix)


def _fitting_text(three: Sequence[_ParamNumber], odd: int) -> str | None:
    """Return a replacement for the number `three[odd]` with which all three match. It is the number with another unit, or else
    the nearer of the other two numbers."""
    others = [each for each in three if each is not three[odd]]

    def fit(const: Constant) -> bool:
        return _is_consistent([const if each is three[odd] else each.const for each in three])

    by_unit = _values_by_unit(three[odd].node, others)
    for unit, const in by_unit.items():
        if fit(const):
            return f"{_number_text(three[odd].node)} {unit}".strip()
    approximate_value = next((const.number for const in by_unit.values()), 0.0)
    near = sorted(others, key=lambda each: abs(each.const.number - approximate_value))
    return next((" ".join(each.node.span.text.split()) for each in near if fit(each.const)), None)


def _values_by_unit(node: nodes.Expr, others: Sequence[_ParamNumber]) -> dict[str, Constant]:
    """Return the constant for the number in `node` with each possible unit: the units of the other numbers, and all units of
    their dimension."""
    if not isinstance(node, (nodes.Number, nodes.Quantity)):
        return {}
    type = others[0].const.type
    alike = [name for name, unit in UNIT_BY_NAME.items() if unit.dim == type.dim and not (unit.u or unit.step)]
    units = dict.fromkeys([*(each.unit for each in others if each.unit), default_unit(type.dim), *alike])
    constants = {unit: constant(node.value, unit, node.span) if unit else number(node.value, node.span) for unit in units}
    return {unit: const for unit, const in constants.items() if const is not None and const.type == type}


def _number_text(node: nodes.Expr) -> str:
    """Return the source text of a number without its unit."""
    end = node.unit_span.start if isinstance(node, nodes.Quantity) else node.span.end
    return node.span.source.text[node.span.start : end].rstrip()


def _is_consistent(consts: Sequence[Constant]) -> bool:
    """Return whether a value and both ends have one type and are in order. If their order depends on the scene, the result is
    True."""
    value, low, high = consts
    if not value.type == low.type == high.type:
        return False
    return len({(each.u, each.step) for each in consts}) > 1 or low.number <= value.number <= high.number


def _report_missing_units(scope: NameScope, three: Sequence[_ParamNumber], unit_numbers: Sequence[_ParamNumber]) -> None:
    """Report numbers without a unit; one fix adds the unit to all of them."""
    bare = [each for each in three if each.is_unitless]
    unit = _common_unit(three, unit_numbers)
    if unit is None:
        _report_no_unit(scope, three, bare, unit_numbers)
        return
    span = Span(bare[0].node.span.source, bare[0].node.span.start, bare[-1].node.span.end)
    text, copied_end = "", span.start
    for each in bare:
        text += span.source.text[copied_end : each.node.span.end] + f" {unit}"
        copied_end = each.node.span.end
    advice = f"write `{' '.join(text.split())}`"
    scope.report.error("missing-unit", _missing_units_text(bare, unit_numbers), span, advice, fix=Fix(span, text))


def _missing_units_text(bare: Sequence[_ParamNumber], unit_numbers: Sequence[_ParamNumber]) -> str:
    which = " and ".join(quote_source(each.node.span) for each in bare)
    has = "has" if len(bare) == 1 else "have"
    first = unit_numbers[0]
    return f"{which} {has} no unit, and {quote_source(first.node.span)} is {dimension_words(first.const.type.dim)}"


def _common_unit(three: Sequence[_ParamNumber], unit_numbers: Sequence[_ParamNumber]) -> str | None:
    """Return a unit with which the numbers without a unit match the others. It is a unit in the source, or another one of the
    same dimension."""
    by_unit = [_values_by_unit(each.node, unit_numbers) for each in three]
    for unit in next(constants for each, constants in zip(three, by_unit, strict=True) if each.is_unitless):
        if _is_consistent(
            [constants[unit] if each.is_unitless else each.const for each, constants in zip(three, by_unit, strict=True)]
        ):
            return unit
    return None


def _report_no_unit(
    scope: NameScope, three: Sequence[_ParamNumber], bare: Sequence[_ParamNumber], unit_numbers: Sequence[_ParamNumber]
) -> None:
    span = Span(bare[0].node.span.source, bare[0].node.span.start, bare[-1].node.span.end)
    instead = _fitting_text(three, three.index(bare[0])) if len(bare) == 1 else None
    want = dimension_words(unit_numbers[0].const.type.dim)
    ends = " and ".join(quote_source(each.node.span) for each in unit_numbers)
    advice = f"write {want} that goes together with {ends}"
    fix = None if instead is None else Fix(span, instead)
    scope.report.error(
        "missing-unit",
        _missing_units_text(bare, unit_numbers),
        span,
        advice if fix is None else f"{advice}, such as `{instead}`",
        fix=fix,
    )


def _check_order(scope: NameScope, node: nodes.Declaration, three: list[_ParamNumber]) -> None:
    """Report a range that ends before it begins, and a value outside the range. Numbers that depend on the scene are not
    checked."""
    value, low, high = three
    if len({(each.const.u, each.const.step) for each in three}) > 1 or node.range is None:
        return
    v, least, most = (each.const.number for each in three)
    if least > most:
        between = most <= v <= least
        odd = None if between else low if v <= most else high
        swapped = f"{high.node.span.text} .. {low.node.span.text}"
        scope.report.error(
            "empty-range",
            f"the range {quote_source(node.range.span)} ends before it begins",
            odd.node.span if odd else node.range.span,
            f"write the lower end first: `{swapped}`"
            if odd is None
            else f"{_limit_text(odd, low)} {quote_source(value.node.span)}",
            fix=Fix(node.range.span, swapped) if odd is None else None,
        )
        return
    if least <= v <= most:
        return
    end, other = (low, high) if v < least else (high, low)
    if end.unit != value.unit and other.unit == value.unit:
        scope.report.error(
            "out-of-range", f"{quote_source(end.node.span)} leaves {quote_source(value.node.span)} outside of the range",
            end.node.span,
            f"{_limit_text(end, low)} {quote_source(value.node.span)}",
            labels=(Label(value.node.span, "the value it starts with"),),
        )  # fmt: skip
        return
    better = _text_within_limits(three)
    message = f"{quote_source(value.node.span)} lies outside of {quote_source(node.range.span)}"
    advice = f"did you mean `{better}`?" if better else "start inside the range, or widen it"
    scope.report.error("out-of-range", message, value.node.span, advice, fix=Fix(value.node.span, better) if better else None)


def _limit_text(end: _ParamNumber, low: _ParamNumber) -> str:
    return "write a beginning below" if end is low else "write an upper end above"


def _text_within_limits(three: Sequence[_ParamNumber]) -> str | None:
    """Return the value's number with the unit of the ends, if this lies inside the range; else None."""
    value, low, high = three
    units = {each.unit for each in (low, high)} - {""}
    node = value.node
    if len(units) != 1 or not isinstance(node, (nodes.Number, nodes.Quantity)):
        return None
    (unit,) = units
    converted = constant(node.value, unit, node.span)
    if converted is None or unit == value.unit or converted.type != low.const.type:
        return None
    return f"{_number_text(node)} {unit}" if low.const.number <= converted.number <= high.const.number else None
