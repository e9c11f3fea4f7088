"""Params of a species: a value, and the range in which it may change. If the three numbers do not match, the finding marks the
one that contradicts the other two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from antdsl.diagnostics import Fix, Label
from antdsl.program import model
from antdsl.program.declarations.behaviours import declared_type
from antdsl.program.model import Const, Kind, Type
from antdsl.program.names.scope import BAD, Scope
from antdsl.program.tables.units import constant, dimension_words, number, unit_of, unit_spelling
from antdsl.program.tables.vocabulary import UNITS
from antdsl.program.types.descriptions import fits, mismatch, quoted, type_words
from antdsl.program.types.folding import constant_behind
from antdsl.program.types.operators import value
from antdsl.source import Span
from antdsl.syntax import nodes


@dataclass(frozen=True, slots=True)
class _Number:
    """One of the three numbers: its text and its value."""

    node: nodes.Expr
    const: Const

    @property
    def bare(self) -> bool:
        return isinstance(self.node, nodes.Number)

    @property
    def unit(self) -> str:
        """The unit as written."""
        return unit_spelling(self.node)


def param(scope: Scope, node: nodes.Declaration) -> model.Param | None:
    names, name = scope.species, node.name.text
    assert names is not None
    names.params[name] = BAD
    for extra, word in ((node.relax, "relax"), (node.each, "for each")):
        if extra is not None:
            scope.report.error(
                "wrong-kind",
                f"a param is one value for all agents, so it has no `{word}`",
                extra.span,
                f"leave `param` out to make `{name}` an attribute",
            )
    default = _fixed(scope, node.value, f"param `{name}`")
    if default is None:
        return None
    if node.type is not None:
        type = declared_type(scope, node.type)
        if not fits(default.type, type):
            mismatch(scope.report, node.value, default.type, type, f"param `{name}`")
    low = high = None
    if node.range is not None:
        low, high = (_fixed(scope, end, f"the range of `{name}`") for end in (node.range.low, node.range.high))
        if low is not None and high is not None:
            three = [_Number(node.value, default), _Number(node.range.low, low), _Number(node.range.high, high)]
            default, low, high = (each.const for each in _together(scope, node, three))
    names.params[name] = default.type
    help = node.help.text if node.help else ""
    return model.Param(f"{names.name}.{name}", default.type, default, low, high, unit_spelling(node.value), help, node.name.span)


def _fixed(scope: Scope, node: nodes.Expr, who: str) -> Const | None:
    """A constant."""
    expr = value(scope, node)
    constant = constant_behind(expr)
    if constant is None and expr.type.kind is not Kind.BAD:
        scope.report.error(
            "wrong-rate",
            f"{quoted(node.span)} is not a plain number, which {who} starts with",
            node.span,
            "write a number with its unit, such as `40 mm`",
        )
    return constant


def _together(scope: Scope, node: nodes.Declaration, three: list[_Number]) -> list[_Number]:
    """Return the value and both ends, of one type. One of another type is reported, and taken as if it had the unit of the
    others."""
    types = [each.const.type for each in three]
    if types[0] == types[1] == types[2]:
        _ordered(scope, node, three)
        return three
    unit_numbers = [each for each in three if not each.bare]
    reference = unit_numbers[0].const if unit_numbers else three[0].const
    if len(unit_numbers) < 3 and all(each.const.type == reference.type for each in unit_numbers):
        _units_left_out(scope, three, unit_numbers)
    else:
        odd = next((n for n in range(3) if types[n - 1] == types[n - 2]), None)
        if odd is None:
            what = ", ".join(f"{quoted(each.node.span)} is {type_words(each.const.type)}" for each in three)
            assert node.range is not None
            span = Span(node.value.span.source, node.value.span.start, node.range.span.end)
            scope.report.error("units-differ", f"{what}: a param and its range want all alike", span, "give them one unit")
        else:
            reference = three[odd - 1].const
            who = f"the range of `{node.name.text}`" if odd else f"`{node.name.text}`, which has such a range,"
            _odd_one_out(scope, three, odd, reference.type, who)
    return [replace(each, const=_as(each.const, reference)) for each in three]


def _as(const: Const, reference: Const) -> Const:
    return (
        const
        if const.type == reference.type
        else Const(reference.type, const.rate, const.span, const.number, reference.u, reference.step)
    )


def _odd_one_out(scope: Scope, three: Sequence[_Number], odd: int, expected: Type, who: str) -> None:
    """One of another type than the two others."""
    node, type = three[odd].node, three[odd].const.type
    if (type.kind, expected.kind) != (Kind.NUMBER, Kind.NUMBER):
        mismatch(scope.report, node, type, expected, who)
        return
    want = dimension_words(expected.dim)
    instead = _fitting(three, odd)
    message = f"{quoted(node.span)} is {type_words(type)}, and {who} wants {want}"
    advice = f"write {want}" if odd else f"write {want} inside the range"
    fix = None if instead is None else Fix(node.span, instead)
    scope.report.error("wrong-unit", message, node.span, advice if fix is None else f"{advice}, such as `{instead}`", fix=fix)


def _fitting(three: Sequence[_Number], odd: int) -> str | None:
    """Return a replacement for the odd number with which all three match: its number with another unit, or the nearest other
    number."""
    others = [each for each in three if each is not three[odd]]

    def fit(const: Const) -> bool:
        return _go_together([const if each is three[odd] else each.const for each in three])

    by_unit = _by_unit(three[odd].node, others)
    for unit, const in by_unit.items():
        if fit(const):
            return f"{_digits(three[odd].node)} {unit}".strip()
    approximate_value = next((const.number for const in by_unit.values()), 0.0)
    near = sorted(others, key=lambda each: abs(each.const.number - approximate_value))
    return next((" ".join(each.node.span.text.split()) for each in near if fit(each.const)), None)


def _by_unit(node: nodes.Expr, others: Sequence[_Number]) -> dict[str, Const]:
    """Return the value of a number with each unit of the others, and with all units of their dimension."""
    if not isinstance(node, (nodes.Number, nodes.Quantity)):
        return {}
    type = others[0].const.type
    alike = [name for name, unit in UNITS.items() if unit.dim == type.dim and not (unit.u or unit.step)]
    units = dict.fromkeys([*(each.unit for each in others if each.unit), unit_of(type.dim), *alike])
    constants = {unit: constant(node.value, unit, node.span) if unit else number(node.value, node.span) for unit in units}
    return {unit: const for unit, const in constants.items() if const is not None and const.type == type}


def _digits(node: nodes.Expr) -> str:
    """A number as written, without its unit."""
    end = node.unit_span.start if isinstance(node, nodes.Quantity) else node.span.end
    return node.span.source.text[node.span.start : end].rstrip()


def _go_together(consts: Sequence[Const]) -> bool:
    """Whether a value and both ends are of one type and in order, as far as that is known without a scene."""
    value, low, high = consts
    if not value.type == low.type == high.type:
        return False
    return len({(each.u, each.step) for each in consts}) > 1 or low.number <= value.number <= high.number


def _units_left_out(scope: Scope, three: Sequence[_Number], unit_numbers: Sequence[_Number]) -> None:
    """Report numbers without a unit; one fix adds the unit to all of them."""
    bare = [each for each in three if each.bare]
    unit = _unit_for(three, unit_numbers)
    if unit is None:
        _no_unit_will_do(scope, three, bare, unit_numbers)
        return
    span = Span(bare[0].node.span.source, bare[0].node.span.start, bare[-1].node.span.end)
    text, copied_end = "", span.start
    for each in bare:
        text += span.source.text[copied_end : each.node.span.end] + f" {unit}"
        copied_end = each.node.span.end
    scope.report.error("missing-unit", _lack(bare, unit_numbers), span, f"write `{' '.join(text.split())}`", fix=Fix(span, text))


def _lack(bare: Sequence[_Number], unit_numbers: Sequence[_Number]) -> str:
    which = " and ".join(quoted(each.node.span) for each in bare)
    has = "has" if len(bare) == 1 else "have"
    return f"{which} {has} no unit, and {quoted(unit_numbers[0].node.span)} is {dimension_words(unit_numbers[0].const.type.dim)}"


def _unit_for(three: Sequence[_Number], unit_numbers: Sequence[_Number]) -> str | None:
    """The unit with which the bare ones go together with the others: one that is written, or another of the dimension."""
    by_unit = [_by_unit(each.node, unit_numbers) for each in three]
    for unit in next(constants for each, constants in zip(three, by_unit, strict=True) if each.bare):
        if _go_together([constants[unit] if each.bare else each.const for each, constants in zip(three, by_unit, strict=True)]):
            return unit
    return None


def _no_unit_will_do(scope: Scope, three: Sequence[_Number], bare: Sequence[_Number], unit_numbers: Sequence[_Number]) -> None:
    span = Span(bare[0].node.span.source, bare[0].node.span.start, bare[-1].node.span.end)
    instead = _fitting(three, three.index(bare[0])) if len(bare) == 1 else None
    want = dimension_words(unit_numbers[0].const.type.dim)
    ends = " and ".join(quoted(each.node.span) for each in unit_numbers)
    advice = f"write {want} that goes together with {ends}"
    fix = None if instead is None else Fix(span, instead)
    scope.report.error(
        "missing-unit", _lack(bare, unit_numbers), span, advice if fix is None else f"{advice}, such as `{instead}`", fix=fix
    )


def _ordered(scope: Scope, node: nodes.Declaration, three: list[_Number]) -> None:
    """Whether the value lies between the ends, as far as that is known without a scene."""
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
            f"the range {quoted(node.range.span)} ends before it begins",
            odd.node.span if odd else node.range.span,
            f"write the lesser end first: `{swapped}`" if odd is None else f"{_beside(odd, low)} {quoted(value.node.span)}",
            fix=Fix(node.range.span, swapped) if odd is None else None,
        )
        return
    if least <= v <= most:
        return
    end, other = (low, high) if v < least else (high, low)
    if end.unit != value.unit and other.unit == value.unit:
        scope.report.error(
            "out-of-range", f"{quoted(end.node.span)} leaves {quoted(value.node.span)} outside of the range", end.node.span,
            f"{_beside(end, low)} {quoted(value.node.span)}", labels=(Label(value.node.span, "the value it starts with"),),
        )  # fmt: skip
        return
    better = _inside(three)
    scope.report.error(
        "out-of-range", f"{quoted(value.node.span)} lies outside of {quoted(node.range.span)}", value.node.span,
        f"did you mean `{better}`?" if better else "start inside the range, or widen it",
        fix=Fix(value.node.span, better) if better else None,
    )  # fmt: skip


def _beside(end: _Number, low: _Number) -> str:
    return "write a beginning below" if end is low else "write an end above"


def _inside(three: Sequence[_Number]) -> str | None:
    """The same number with the unit of the ends, where that lies inside."""
    value, low, high = three
    units = {each.unit for each in (low, high)} - {""}
    node = value.node
    if len(units) != 1 or not isinstance(node, (nodes.Number, nodes.Quantity)):
        return None
    (unit,) = units
    converted = constant(node.value, unit, node.span)
    if converted is None or unit == value.unit or converted.type != low.const.type:
        return None
    return f"{_digits(node)} {unit}" if low.const.number <= converted.number <= high.const.number else None
