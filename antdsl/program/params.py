"""Params of a species: a value, and the range that it may be changed in. Of the three numbers that do not go together, the one is
marked that the other two speak against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from antdsl.diagnostics import Fix, Label
from antdsl.program import model
from antdsl.program.behaviours import declared_type
from antdsl.program.folding import constant_behind
from antdsl.program.model import Const, Kind
from antdsl.program.operators import value
from antdsl.program.scope import BAD, Scope
from antdsl.program.units import constant, dimension_words, unit_of, unit_spelling
from antdsl.program.wording import fits, mismatch, quoted, type_words
from antdsl.source import Span
from antdsl.syntax import nodes


@dataclass(frozen=True, slots=True)
class _Number:
    """One of the three: as written, and what it is worth."""

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
    found = value(scope, node)
    constant = constant_behind(found)
    if constant is None and found.type.kind is not Kind.BAD:
        scope.report.error(
            "wrong-rate",
            f"{quoted(node.span)} is not a plain number, which {who} starts with",
            node.span,
            "write a number with its unit, such as `40 mm`",
        )
    return constant


def _together(scope: Scope, node: nodes.Declaration, three: list[_Number]) -> list[_Number]:
    """The value and both ends, of one type: what is of another is told, and taken as if it had the unit of the others."""
    types = [each.const.type for each in three]
    if types[0] == types[1] == types[2]:
        _ordered(scope, node, three)
        return three
    told = [each for each in three if not each.bare]
    wanted = told[0].const if told else three[0].const
    if len(told) < 3 and all(each.const.type == wanted.type for each in told):
        _units_left_out(scope, three, told)
    else:
        odd = next((n for n in range(3) if types[n - 1] == types[n - 2]), None)
        if odd is None:
            what = ", ".join(f"{quoted(each.node.span)} is {type_words(each.const.type)}" for each in three)
            assert node.range is not None
            span = Span(node.value.span.source, node.value.span.start, node.range.span.end)
            scope.report.error("units-differ", f"{what}: a param and its range want all alike", span, "give them one unit")
        else:
            wanted = three[odd - 1].const
            who = f"the range of `{node.name.text}`" if odd else f"`{node.name.text}`, which has such a range,"
            mismatch(scope.report, three[odd].node, types[odd], wanted.type, who)
    return [replace(each, const=_as(each.const, wanted)) for each in three]


def _as(const: Const, wanted: Const) -> Const:
    return const if const.type == wanted.type else Const(wanted.type, const.rate, const.span, const.number, wanted.u, wanted.step)


def _units_left_out(scope: Scope, three: Sequence[_Number], told: Sequence[_Number]) -> None:
    """Some of the numbers have no unit: it is written out behind each, in one go."""
    unit = next((each.unit for each in told if each.unit), "") or unit_of(told[0].const.type.dim)
    bare = [each for each in three if each.bare]
    span = Span(bare[0].node.span.source, bare[0].node.span.start, bare[-1].node.span.end)
    text, done = "", span.start
    for each in bare:
        text += span.source.text[done : each.node.span.end] + f" {unit}"
        done = each.node.span.end
    which = " and ".join(quoted(each.node.span) for each in bare)
    lack = f"{which} {'has' if len(bare) == 1 else 'have'} no unit"
    message = f"{lack}, and {quoted(told[0].node.span)} is {dimension_words(told[0].const.type.dim)}"
    scope.report.error("missing-unit", message, span, f"write `{' '.join(text.split())}`", fix=Fix(span, text))


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
    found = constant(node.value, unit, node.span)
    if found is None or unit == value.unit or found.type != low.const.type:
        return None
    end = node.unit_span.start if isinstance(node, nodes.Quantity) else node.span.end
    number = node.span.source.text[node.span.start : end].rstrip()
    return f"{number} {unit}" if low.const.number <= found.number <= high.const.number else None
