"""The outcome of a change that the user makes on the page, and the checks of entered values."""

from __future__ import annotations

from dataclasses import dataclass, field

from antdsl.diagnostics import Report
from antdsl.pipeline import Shot
from antdsl.plan.ir import Plan
from antdsl.plan.traverse import collect_required_nodes, iterate_statements, list_field_nodes, list_operands
from antdsl.scene.checks.scene_checks import check_param
from antdsl.scene.field_settings import list_settable_names
from antdsl.scene.quantities import Quantity, QuantityError, parse_quantity

_MAX_LAYER_CHARACTERS = 60  # characters of a layer in messages


@dataclass(frozen=True, slots=True)
class EditOutcome:
    """The outcome of a change that the user made.

    `report`: the findings; if there are errors, nothing has changed.
    `line`: a summary of what persists, moves and is reset.
    `text`: the text to write into a file to make the change permanent.
    `description`: a description of the change."""

    report: Report = field(default_factory=Report)
    line: str = ""
    text: str = ""
    description: str = ""

    @property
    def is_successful(self) -> bool:
        """Return whether the change was made."""
        return self.report.ok


def shorten_text(text: str) -> str:
    """Return the text of a layer on one line, shortened if it is long."""
    words = " ".join(text.split())
    return words if len(words) <= _MAX_LAYER_CHARACTERS else f"{words[: _MAX_LAYER_CHARACTERS - 1]}…"


def make_silencing_settings(field: str) -> dict[str, str]:
    """Return the settings that hold a field's values near 0."""
    return {f"{field}.limit": "0.000001", f"{field}.keeps": "0 %/step"}


def parse_param(shot: Shot, name: str, value: str) -> tuple[Quantity | None, Report]:
    """Return the number for a param, or for a setting of a field, and a report. The number is None if there are errors."""
    report = Report()
    try:
        quantity = parse_quantity(value)
    except QuantityError as why:
        usual = f"write a number and a unit: `{name}: 50 mm`"
        report.error("wrong-value", f"`{name}: {value}`: `{value}` {why}", None, why.help or usual)
        return None, report
    if name not in shot.program.params and name not in list_settable_names(shot.program):
        report.error("unknown-thing", f"no program has a param `{name}`", None)
        return None, report
    check_param(shot.scene, shot.program, report, name, quantity)
    return (quantity if report.ok else None), report


def make_error_outcome(message: str) -> EditOutcome:
    report = Report()
    report.error("unknown-thing", message, None)
    return EditOutcome(report)


def find_binding_params(plan: Plan) -> frozenset[str]:
    """Return the params that cannot be changed between two steps, because fields, other params or newborn agents depend on these
    params."""
    nodes = [node for field_plan in plan.fields.values() for node in list_field_nodes(field_plan)]
    nodes += [param.default for param in plan.params.values()]
    for species in plan.species.values():
        nodes += [node for _, statement in iterate_statements(species.born) for node in list_operands(statement)]
    return frozenset(str(node.attrs[0]) for node in collect_required_nodes(nodes) if node.op == "param")
