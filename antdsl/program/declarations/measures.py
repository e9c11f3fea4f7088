"""Checks measures: numbers and conditions about the complete run, written in the language of specs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from antdsl import limits
from antdsl.program.declarations.specs import is_free_of_draws
from antdsl.program.declarations.world import make_outer_scope
from antdsl.program.expectations import Measure
from antdsl.program.model import ChangeRate, TypeKind
from antdsl.program.names.collect import check_free_name
from antdsl.program.names.ordering import order_declarations
from antdsl.program.names.scope import Declarations, FileNames, report_duplicate
from antdsl.program.types.aggregates import AGGREGATE_WORDS, SpecRules
from antdsl.program.types.descriptions import describe_type, quote_source
from antdsl.program.types.operators import type_value
from antdsl.syntax import nodes

_RESERVED_NAMES = (*AGGREGATE_WORDS, "time_of", "at_start", "other", "motion", "frame", "time", "label", "scene", "seed")
_REPORTED_KINDS = (TypeKind.NUMBER, TypeKind.BOOL)


def declare_measures(declarations: Declarations, names: Sequence[FileNames]) -> dict[str, FileNames]:
    """Add the measures of all files to the declarations. Return the file of each measure by the measure's name."""
    file_by_name: dict[str, FileNames] = {}
    for file in names:
        for item in file.node.items:
            if isinstance(item, nodes.Measure):
                _declare_measure(declarations, item)
                file_by_name.setdefault(item.name.text, file)
    if len(declarations.measures) > limits.MAX_MEASURES:
        last = list(declarations.measures.values())[-1]
        declarations.report.error("too-many", f"more than {limits.MAX_MEASURES} measures", last.name.span, "leave some out")
        declarations.measures.clear()
    return file_by_name


def _declare_measure(declarations: Declarations, node: nodes.Measure) -> None:
    name = node.name.text
    known = declarations.measures.get(name)
    if known is not None:
        if known.span.source.path == node.span.source.path or known.span.text.split() != node.span.text.split():
            report_duplicate(declarations.report, "measure", node.name, known.name.span)
    elif name in declarations.things or name in declarations.fields or name in declarations.species:
        report_duplicate(declarations.report, "name", node.name, node.name.span)
    elif name in _RESERVED_NAMES:
        message = f"`{name}` is a word of specs, or a column in tables of measures"
        declarations.report.error("reserved-name", message, node.name.span, f"choose another name, such as `my_{name}`")
    elif check_free_name(declarations.report, node.name):
        declarations.measures[name] = node


def check_measures(declarations: Declarations, file_by_name: Mapping[str, FileNames]) -> tuple[Measure, ...]:
    """Return all measures that have no errors, with typed expressions, in text order."""
    order, _ = order_declarations(
        declarations.report, "measures", declarations.measures, lambda node: (node.value,), lambda node: node.name
    )
    measures = {node.name.text: _check_measure(declarations, file_by_name[node.name.text], node) for node in order}
    return tuple(measure for name in declarations.measures if (measure := measures[name]) is not None)


def _check_measure(declarations: Declarations, file: FileNames, node: nodes.Measure) -> Measure | None:
    scope = make_outer_scope(SpecRules(declarations).declarations, file, "measure")
    value = type_value(scope, node.value)
    if value.type.kind is TypeKind.BAD or not is_free_of_draws(declarations.report, value, "a measure"):
        return None
    if value.rate > ChangeRate.STEP or value.type.kind not in _REPORTED_KINDS:
        text = quote_source(value.span)
        if value.rate > ChangeRate.STEP:
            words = f"{text} differs from agent to agent, but a measure is one value"
            declarations.report.error(
                "wrong-rate", words, value.span, "use the `share`, `mean`, `total`, `min`, `max` or `count` of all"
            )
        else:
            words = f"a measure is a number or a condition, but {text} is {describe_type(value.type)}"
            advice = f"write `length({' '.join(value.span.text.split())})`" if value.type.kind is TypeKind.VECTOR else None
            declarations.report.error("wrong-kind", words, value.span, advice or "use a number of it")
        return None
    declarations.measure_values[node.name.text] = value
    return Measure(node.name.text, value, node.help.text if node.help is not None else "", node.span)
