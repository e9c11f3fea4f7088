"""Reports neighbour radii that are so large that they contain all agents. Each agent would then process the complete crowd in
every step."""

from __future__ import annotations

from collections.abc import Mapping

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.checks.analysis.ranges import compute_range
from antdsl.program.model import (
    BindingRef,
    Constant,
    Expr,
    OperationExpr,
    Param,
    ParamRef,
    ReduceExpr,
    SetExpr,
    Species,
    TypeKind,
)
from antdsl.program.tables.editions import CRAWLING_SIZE_SETTING, STANDING_SIZE_SETTING
from antdsl.program.traverse import iterate_parts
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import find_constant

_MAX_BODY_LENGTHS = 1000  # body lengths; a larger radius is reported
_DEFAULT_BODY_SIZE_MM = 4.0  # mm; body size if the program does not set it


def check_wide_radius(context: CheckContext, report: Report) -> None:
    """Report neighbour searches with a constant radius above 1000 body lengths."""
    for species in context.program.species.values():
        size = _compute_max_body_size(species, context.program.params)
        every = list(iterate_parts(species))
        one = {id(part.elements) for part in every if isinstance(part, ReduceExpr) and part.reducer == "nearest"}
        for part in every:
            if (
                not isinstance(part, SetExpr)
                or not part.args
                or part.args[0] is None
                or not _is_radius_search(part, id(part) in one)
            ):
                continue
            written = part.args[0]
            radius = _find_constant_radius(written, context.program.params)
            if radius is None or radius.unit_power or radius.number <= _MAX_BODY_LENGTHS * size:
                continue
            own = [each.span for each in _follow_names(written) if each.span.source.path == species.span.source.path]
            span = own[-1] if own else written.span
            message = f"within {quote_source(span)} contains all agents: it is {radius.number / size:,.0f} body lengths"
            advice = f"write a few body lengths, such as `3 * size`; only the {limits.MAX_QUERY_NEIGHBOURS} nearest agents count"
            report.warning("wide-radius", message, span, advice)


def _is_radius_search(part: SetExpr, is_nearest_only: bool) -> bool:
    """Return whether a set examines all agents within a radius. `is_nearest_only`: whether only the nearest agent is searched
    for. Such a search does not count, because it is faster."""
    if part.source == "neighbours":
        return True
    return part.source == "all" and part.element.type.kind is TypeKind.AGENT and not (is_nearest_only and part.condition is None)


def _follow_names(expr: Expr) -> list[Expr]:
    """Return an expression. If it is a name, also return the expression that the name stands for, and so on to the last one."""
    exprs = [expr]
    while isinstance(expr, BindingRef) and expr.binding.role in ("argument", "let") and expr.binding.value is not None:
        expr = expr.binding.value
        exprs.append(expr)
    return exprs


def _find_constant_radius(expr: Expr, params: Mapping[str, Param]) -> Constant | None:
    """Return the constant value of a radius, or None if it is not constant. The value of a param is its default."""
    last = _follow_names(expr)[-1]
    return find_constant(params[last.name].default if isinstance(last, ParamRef) and last.name in params else last)


def _compute_max_body_size(species: Species, params: Mapping[str, Param]) -> float:
    """Return the largest possible body size in mm that the program allows."""
    written = next((a.default for a in species.attributes if a.name in (CRAWLING_SIZE_SETTING, STANDING_SIZE_SETTING)), None)
    if isinstance(written, OperationExpr) and written.name == "normal":
        written = written.args[0]  # a normal number has no largest value: the mean counts
    high = compute_range(written, params, {}).high if written is not None else _DEFAULT_BODY_SIZE_MM
    return high if 0 < high < limits.MAX_NUMBER else _DEFAULT_BODY_SIZE_MM
