"""Neighbours looked for so far away that everybody is one: each agent would go through the whole crowd in every step."""

from __future__ import annotations

from collections.abc import Mapping

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.program.checks.checked import Checked
from antdsl.program.checks.ranges import range_of
from antdsl.program.folding import constant_behind
from antdsl.program.model import Param, SetOf, Species
from antdsl.program.walk import parts
from antdsl.program.wording import quoted

_LENGTHS = 1000  # of a body: beyond so many nobody senses a neighbour
_SIZE = 4.0  # mm, of a body where the program does not say


def wide_radius(checked: Checked, report: Report) -> None:
    for species in checked.program.species.values():
        size = _size(species, checked.program.params)
        for part in parts(species):
            if not isinstance(part, SetOf) or part.source != "neighbours" or part.args[0] is None:
                continue
            radius, written = constant_behind(part.args[0]), part.args[0]
            if radius is not None and not radius.u and radius.number > _LENGTHS * size:
                report.warning(
                    "wide-radius",
                    f"within {quoted(radius.span)} there is everybody: that is {radius.number / size:,.0f} body lengths",
                    radius.span if radius.span.source.path == species.span.source.path else written.span,
                    f"write some body lengths, such as `3 * size`; of all within it the {limits.NEIGHBOURS} nearest count",
                )


def _size(species: Species, params: Mapping[str, Param]) -> float:
    """The largest that a body can be, in mm, as far as the program shows."""
    written = next((a.default for a in species.attributes if a.name == "size"), None)
    high = range_of(written, params, {}).high if written is not None else _SIZE
    return high if 0 < high < limits.LARGEST else _SIZE
