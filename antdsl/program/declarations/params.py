"""Checks the params of a species. A param has a value and a range of allowed values.

If the value and the two ends of the range do not match, the finding marks the one that differs from the other two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from antdsl.diagnostics import Fix, Label
from antdsl.program import model
from antdsl.program.declarations.behaviours import resolve_declared_type
from antdsl.program.kinds import BAD_TYPE
from antdsl.program.model import Constant, TypeKind, ValueType
from antdsl.program.names.scope import NameScope
from antdsl.program.tables.units import choose_default_unit, describe_dimension, find_unit_spelling, make_constant, make_number
from antdsl.program.tables.vocabulary import UNIT_BY_NAME
from antdsl.program.types.descriptions import describe_type, is_compatible, quote_source, report_mismatch
from antdsl.program.types.folding import find_constant
from antdsl.program.types.operators import type_value
from antdsl.source import Span
from antdsl.syntax import nodes


@dataclass(frozen=True, slots=True)
class _WrittenParamNumber:
    """The value of a param, or one end of its range: its syntax node and its constant."""

    node: nodes.Expr
    constant: Constant

    @property
    def is_unitless(self) -> bool:
        return isinstance(self.node, nodes.Number)

    @property
    def unit(self) -> str:
        """Return the unit as in the source."""
        return find_unit_spelling(self.node)


def check_param(scope: NameScope, node: nodes.Declaration) -> model.Param | None:
    """Check a param and its range. Return None if its value is not constant."""
    names, name = scope.species, node.name.text
    assert names is not None
    names.params[name] = BAD_TYPE
    for extra, word in ((node.relax, "relax"), (node.each, "for each")):
        if extra is not None:
            message = f"a param has one value for all agents, so it cannot have `{word}`"
            scope.report.error("wrong-kind", message, extra.span, f"delete `param` to make `{name}` an attribute")
    default = _type_constant(scope, node.value, f"param `{name}`")
    if default is None:
        return None
    if node.type is not None:
        type = resolve_declared_type(scope, node.type)
        if not is_compatible(default.type, type):
            report_mismatch(scope.report, node.value, default.type, type, f"param `{name}`")
    low = high = None
    if node.range is not None:
        low, high = (_type_constant(scope, end, f"the range of `{name}`") for end in (node.range.low, node.range.high))
        if low is not None and high is not None:
            three = [
                _WrittenParamNumber(node.value, default),
                _WrittenParamNumber(node.range.low, low),
                _WrittenParamNumber(node.range.high, high),
            ]
            default, low, high = (each.constant for each in _unify_types(scope, node, three))
    names.params[name] = default.type
    help = node.help.text if node.help else ""
    return model.Param(
        f"{names.name}.{name}", default.type, default, low, high, find_unit_spelling(node.value), help, node.name.span
    )


def _type_constant(scope: NameScope, node: nodes.Expr, subject: str) -> Constant | None:
    """Return the constant value of an expression. If it is not constant, report an error and return None."""
    expr = type_value(scope, node)
    constant = find_constant(expr)
    if constant is None and expr.type.kind is not TypeKind.BAD:
        message = f"{quote_source(node.span)} is not a constant number, which {subject} needs"
        scope.report.error("wrong-rate", message, node.span, "write a number with its unit, such as `40 mm`")
    return constant


def _unify_types(
    scope: NameScope, node: nodes.Declaration, param_numbers: list[_WrittenParamNumber]
) -> list[_WrittenParamNumber]:
    """Return the three numbers of a param (value, lower end and upper end) with one common type.

    If one has a different type from the other two, it is reported and converted."""
    types = [each.constant.type for each in param_numbers]
    if types[0] == types[1] == types[2]:
        _check_order(scope, node, param_numbers)
        return param_numbers
    unit_numbers = [each for each in param_numbers if not each.is_unitless]
    reference = unit_numbers[0].constant if unit_numbers else param_numbers[0].constant
    if len(unit_numbers) < 3 and all(each.constant.type == reference.type for each in unit_numbers):
        _report_missing_units(scope, param_numbers, unit_numbers)
    else:
        odd = next((n for n in range(3) if types[n - 1] == types[n - 2]), None)
        if odd is None:
            what = ", ".join(f"{quote_source(each.node.span)} is {describe_type(each.constant.type)}" for each in param_numbers)
            assert node.range is not None
            span = Span(node.value.span.source, node.value.span.start, node.range.span.end)
            scope.report.error("units-differ", f"{what}: a param and its range must match", span, "give them one unit")
        else:
            reference = param_numbers[odd - 1].constant
            who = f"the range of `{node.name.text}`" if odd else f"`{node.name.text}`, which has such a range,"
            _report_differing_type(scope, param_numbers, odd, reference.type, who)
    return [replace(each, constant=_convert_to_type_of(each.constant, reference)) for each in param_numbers]


def _convert_to_type_of(const: Constant, reference: Constant) -> Constant:
    if const.type == reference.type:
        return const
    return Constant(reference.type, const.rate, const.span, const.number, reference.unit_power, reference.step)


def _report_differing_type(
    scope: NameScope, param_numbers: Sequence[_WrittenParamNumber], odd_index: int, expected_type: ValueType, subject: str
) -> None:
    """Report that the number at `odd_index` has a different type from the other two. `param_numbers`: value, lower end and upper
    end."""
    node, type = param_numbers[odd_index].node, param_numbers[odd_index].constant.type
    if (type.kind, expected_type.kind) != (TypeKind.NUMBER, TypeKind.NUMBER):
        report_mismatch(scope.report, node, type, expected_type, subject)
        return
    want = describe_dimension(expected_type.dimension)
    instead = _suggest_number(param_numbers, odd_index)
    message = f"{quote_source(node.span)} is {describe_type(type)}, but {subject} needs {want}"
    advice = f"write {want}" if odd_index else f"write {want} inside the range"
    fix = None if instead is None else Fix(node.span, instead)
    scope.report.error("wrong-unit", message, node.span, advice if fix is None else f"{advice}, such as `{instead}`", fix=fix)


def _suggest_number(param_numbers: Sequence[_WrittenParamNumber], odd_index: int) -> str | None:
    """Return the text that replaces the number at `odd_index`, so that value, lower end and upper end have one type.

    The text is the same number with another unit. If no unit fits, it is the one of the other two numbers that is nearer. The
    result is None if neither is possible."""
    others = [each for each in param_numbers if each is not param_numbers[odd_index]]

    def is_consistent_with(const: Constant) -> bool:
        return _is_consistent([const if each is param_numbers[odd_index] else each.constant for each in param_numbers])

    by_unit = _compute_values_by_unit(param_numbers[odd_index].node, others)
    for unit, const in by_unit.items():
        if is_consistent_with(const):
            return f"{_get_number_text(param_numbers[odd_index].node)} {unit}".strip()
    approximate_value = next((const.number for const in by_unit.values()), 0.0)
    near = sorted(others, key=lambda param: abs(param.constant.number - approximate_value))
    return next((" ".join(each.node.span.text.split()) for each in near if is_consistent_with(each.constant)), None)


def _compute_values_by_unit(node: nodes.Expr, others: Sequence[_WrittenParamNumber]) -> dict[str, Constant]:
    """Return, for each unit, the constant that the number in `node` would be with this unit.

    The units are those of the numbers in `others`, and all other units of the same dimension."""
    if not isinstance(node, (nodes.Number, nodes.Quantity)):
        return {}
    type = others[0].constant.type
    alike = [name for name, unit in UNIT_BY_NAME.items() if unit.dim == type.dimension and not (unit.unit_power or unit.step)]
    units = dict.fromkeys([*(each.unit for each in others if each.unit), choose_default_unit(type.dimension), *alike])
    constants = {
        unit: make_constant(node.value, unit, node.span) if unit else make_number(node.value, node.span) for unit in units
    }
    return {unit: const for unit, const in constants.items() if const is not None and const.type == type}


def _get_number_text(node: nodes.Expr) -> str:
    """Return the source text of a number without its unit."""
    end = node.unit_span.start if isinstance(node, nodes.Quantity) else node.span.end
    return node.span.source.text[node.span.start : end].rstrip()


def _is_consistent(consts: Sequence[Constant]) -> bool:
    """Return whether a value and both ends of its range have the same type and are in order. If their order depends on the
    scene, it counts as correct."""
    value, low, high = consts
    if not value.type == low.type == high.type:
        return False
    return len({(each.unit_power, each.step) for each in consts}) > 1 or low.number <= value.number <= high.number


def _report_missing_units(
    scope: NameScope, param_numbers: Sequence[_WrittenParamNumber], unit_numbers: Sequence[_WrittenParamNumber]
) -> None:
    """Report numbers of a param that lack a unit. A single fix adds the unit to all of them."""
    bare = [each for each in param_numbers if each.is_unitless]
    unit = _find_common_unit(param_numbers, unit_numbers)
    if unit is None:
        _report_no_unit(scope, param_numbers, bare, unit_numbers)
        return
    span = Span(bare[0].node.span.source, bare[0].node.span.start, bare[-1].node.span.end)
    text, copied_end = "", span.start
    for each in bare:
        text += span.source.text[copied_end : each.node.span.end] + f" {unit}"
        copied_end = each.node.span.end
    advice = f"write `{' '.join(text.split())}`"
    scope.report.error("missing-unit", _format_missing_units(bare, unit_numbers), span, advice, fix=Fix(span, text))


def _format_missing_units(unitless_numbers: Sequence[_WrittenParamNumber], unit_numbers: Sequence[_WrittenParamNumber]) -> str:
    which = " and ".join(quote_source(each.node.span) for each in unitless_numbers)
    has = "has" if len(unitless_numbers) == 1 else "have"
    first = unit_numbers[0]
    return f"{which} {has} no unit, and {quote_source(first.node.span)} is {describe_dimension(first.constant.type.dimension)}"


def _find_common_unit(param_numbers: Sequence[_WrittenParamNumber], unit_numbers: Sequence[_WrittenParamNumber]) -> str | None:
    """Return a unit that makes the three numbers of a param consistent when it is added to those without a unit. Return None if
    there is none.

    Units in the source are tried first, then other units of the same dimension. `unit_numbers`: the numbers with a unit."""
    by_unit = [_compute_values_by_unit(each.node, unit_numbers) for each in param_numbers]
    for unit in next(constants for each, constants in zip(param_numbers, by_unit, strict=True) if each.is_unitless):
        if _is_consistent(
            [
                constants[unit] if each.is_unitless else each.constant
                for each, constants in zip(param_numbers, by_unit, strict=True)
            ]
        ):
            return unit
    return None


def _report_no_unit(
    scope: NameScope,
    param_numbers: Sequence[_WrittenParamNumber],
    unitless_numbers: Sequence[_WrittenParamNumber],
    unit_numbers: Sequence[_WrittenParamNumber],
) -> None:
    span = Span(unitless_numbers[0].node.span.source, unitless_numbers[0].node.span.start, unitless_numbers[-1].node.span.end)
    instead = _suggest_number(param_numbers, param_numbers.index(unitless_numbers[0])) if len(unitless_numbers) == 1 else None
    want = describe_dimension(unit_numbers[0].constant.type.dimension)
    ends = " and ".join(quote_source(each.node.span) for each in unit_numbers)
    advice = f"write {want} with a unit that matches {ends}"
    fix = None if instead is None else Fix(span, instead)
    scope.report.error(
        "missing-unit",
        _format_missing_units(unitless_numbers, unit_numbers),
        span,
        advice if fix is None else f"{advice}, such as `{instead}`",
        fix=fix,
    )


def _check_order(scope: NameScope, node: nodes.Declaration, param_numbers: list[_WrittenParamNumber]) -> None:
    """Report a range with a lower end above its upper end, and a value outside the range. Numbers that depend on the scene are
    not checked."""
    value, low, high = param_numbers
    if len({(each.constant.unit_power, each.constant.step) for each in param_numbers}) > 1 or node.range is None:
        return
    v, least, most = (each.constant.number for each in param_numbers)
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
            else f"{_format_order_advice(odd, low)} {quote_source(value.node.span)}",
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
            f"{_format_order_advice(end, low)} {quote_source(value.node.span)}",
            labels=(Label(value.node.span, "its starting value"),),
        )  # fmt: skip
        return
    better = _suggest_within_limits(param_numbers)
    message = f"{quote_source(value.node.span)} is outside the range {quote_source(node.range.span)}"
    advice = f"did you mean `{better}`?" if better else "start inside the range, or widen it"
    scope.report.error("out-of-range", message, value.node.span, advice, fix=Fix(value.node.span, better) if better else None)


def _format_order_advice(end: _WrittenParamNumber, low: _WrittenParamNumber) -> str:
    return "write a beginning below" if end is low else "write an upper end above"


def _suggest_within_limits(param_numbers: Sequence[_WrittenParamNumber]) -> str | None:
    """Return the text of a param's value in which a wrong unit is replaced by the unit of the range's ends. Return None if the
    new value would be outside the range."""
    value, low, high = param_numbers
    units = {each.unit for each in (low, high)} - {""}
    node = value.node
    if len(units) != 1 or not isinstance(node, (nodes.Number, nodes.Quantity)):
        return None
    (unit,) = units
    converted = make_constant(node.value, unit, node.span)
    if converted is None or unit == value.unit or converted.type != low.constant.type:
        return None
    return f"{_get_number_text(node)} {unit}" if low.constant.number <= converted.number <= high.constant.number else None
