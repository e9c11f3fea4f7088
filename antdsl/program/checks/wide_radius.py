"""Reports neighbour radii that contain all agents: each agent would then go through the complete crowd in every step."""

from __future__ import annotations

from collections.abc import Mapping

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.program.checks.analysis.ranges import range_of
from antdsl.program.model import BindingRef, Constant, Expr, Param, ParamRef, ReduceExpr, SetExpr, Species, TypeKind
from antdsl.program.traverse import parts
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import constant_behind

_MAX_BODY_LENGTHS = 1000  # body lengths; a larger radius is reported
_DEFAULT_BODY_SIZE_MM = 4.0  # mm; body size if the program does not set it


def check_wide_radius(checked: CheckContext, report: Report) -> None:
    """Report neighbour searches with a constant radius above 1000 body lengths."""
    for species in checked.program.species.values():
        size = _max_body_size(species, checked.program.params)
        every = list(parts(species))
        one = {id(part.over) for part in every if isinstance(part, ReduceExpr) and part.how == "nearest"}
        for part in every:
            if (
                not isinstance(part, SetExpr)
                or not part.args
                or part.args[0] is None
                or not _is_radius_search(part, id(part) in one)
            ):
                continue
            written = part.args[0]
            radius = _radius(written, checked.program.params)
            if radius is None or radius.u or radius.number <= _MAX_BODY_LENGTHS * size:
                continue
            own = [each.span for each in _named_values(written) if each.span.source.path == species.span.source.path]
            span = own[-1] if own else written.span
            message = f"within {quote_source(span)} there are all agents: that is {radius.number / size:,.0f} body lengths"
            advice = (
                f"write some body lengths, such as `3 * size`; of all within it the {limits.MAX_QUERY_NEIGHBOURS} nearest count"
            )
            report.warning("wide-radius", message, span, advice)


def _is_radius_search(part: SetExpr, only_the_nearest: bool) -> bool:
    """Return whether a set examines all agents within a radius. The search for the nearest agent alone is faster, so it does not
    count."""
    if part.source == "neighbours":
        return True
    return part.source == "all" and part.element.type.kind is TypeKind.AGENT and not (only_the_nearest and part.where is None)


def _named_values(expr: Expr) -> list[Expr]:
    """Return an expression and, if it is a name, the chain of expressions that the name stands for."""
    exprs = [expr]
    while isinstance(expr, BindingRef) and expr.binding.role in ("argument", "let") and expr.binding.value is not None:
        expr = expr.binding.value
        exprs.append(expr)
    return exprs


def _radius(expr: Expr, params: Mapping[str, Param]) -> Constant | None:
    """Return the constant value of a radius; a param counts by its default."""
    last = _named_values(expr)[-1]
    return constant_behind(params[last.name].default if isinstance(last, ParamRef) and last.name in params else last)


def _max_body_size(species: Species, params: Mapping[str, Param]) -> float:
    """Return the largest possible body size in mm, as far as the program determines it."""
    written = next((a.default for a in species.attributes if a.name == "size"), None)
    high = range_of(written, params, {}).high if written is not None else _DEFAULT_BODY_SIZE_MM
    return high if 0 < high < limits.MAX_NUMBER else _DEFAULT_BODY_SIZE_MM
