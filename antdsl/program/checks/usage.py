"""Reports declarations that are never used, only set or only read, and programs in which nothing can act.

The declarations are params, attributes, lets, fields, behaviours and events."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial

from antdsl.diagnostics import Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.memo import get_or_compute_part
from antdsl.program.model import AttributeDecl, Constant, EffectRequest, NoneRef, OperationExpr, Program, Species, ThingRef
from antdsl.program.tables.effects import list_feeding_effects
from antdsl.program.traverse import iterate_parts
from antdsl.program.types.descriptions import quote_source
from antdsl.source import Span
from antdsl.syntax import nodes

_DECLARATION_WORD_PATTERN = re.compile(r"\b(species|behaviour)\b")


def check_empty_program(context: CheckContext, report: Report) -> None:
    """Report files that declare neither a species nor a behaviour."""
    for file in context.files:
        source, items = file.node.source, file.node.items
        if not items or any(isinstance(item, (nodes.Species, nodes.Behaviour)) for item in items):
            continue
        # such a word means that a declaration could not be parsed, which is already reported
        if not any(_DECLARATION_WORD_PATTERN.search(line.partition("#")[0]) for line in source.text.splitlines()):
            report.error("empty-program", "no species and no behaviour is declared", items[0].span, "write `species ant { … }`")


def check_unused_names(context: CheckContext, report: Report) -> None:
    """Report params, attributes, lets and behaviours that are never used."""
    for species in context.program.species.values():
        _check_species(context, species, report)
    for field in context.program.fields.values():
        if not context.is_used("field", field.name):
            message = f"field `{field.name}` is never laid or smelled"
            amount = "heading * 1 /s" if field.has_vectors else "1 /s"
            advice = f"write `deposit {field.name} {amount}` in a state, or delete it"
            report.warning("unused-field", message, field.span, advice)
    _check_behaviours(context, report)


def _check_species(context: CheckContext, species: Species, report: Report) -> None:
    for param in species.params:
        if not context.is_used("param", param.name):
            short = param.name.partition(".")[2]
            message = f"param `{short}` is never used"
            report.warning("unused-param", message, param.span, f"write `{short}` where its value belongs, or delete it")
    for attribute in species.attributes:
        name = f"{species.name}.{attribute.name}"
        if (
            not attribute.is_builtin
            and not context.is_used("attribute", name)
            and name not in context.declarations.written_attributes
        ):
            words = f"attribute `{attribute.name}` is never used"
            report.warning("unused-attribute", words, attribute.span, "use it, or delete it")
    for binding in (*species.lets, *species.latches):
        if not context.is_used("let", f"{species.name}.{binding.name}"):
            word = "fuzzy" if isinstance(binding.value, OperationExpr) and binding.value.name == "fuzzy" else binding.role
            words = f"`{word} {binding.name}` is never used"
            report.warning(f"unused-{binding.role}", words, binding.span, "use it, or delete it")


def _check_behaviours(context: CheckContext, report: Report) -> None:
    """Report behaviours that no code calls, in files that declare a species. A file with only behaviours is a library for other
    files."""
    for file in context.files:
        if not any(isinstance(item, nodes.Species) for item in file.node.items):
            continue
        for info in file.own_behaviours.values():
            name = info.node.name
            if not context.is_used("behaviour", f"{name.span}"):
                message = f"behaviour `{name.text}` is never called"
                report.warning("unused-behaviour", message, name.span, f"call it: `steer {name.text}(…)`, or delete it")


def check_unused_memory(context: CheckContext, report: Report) -> None:
    """Report attributes and fields that are only set or only read."""
    for species in context.program.species.values():
        for attribute in species.attributes:
            if not attribute.is_builtin:
                _check_attribute(context, species, attribute, report)
    wholes = _iterate_field_users(context.program) if context.program.fields else ()
    named = [get_or_compute_part(context.declarations, ("named", each), partial(_find_used_names, each)) for each in wholes]
    read, laid = (frozenset().union(*names) for names in zip(*named, strict=True)) if named else (frozenset(), frozenset())
    for field in context.program.fields.values():
        if field.name in laid and field.name not in read and not context.is_used("smelled", field.name):
            follow = "along" if field.has_vectors else "climb"
            advice = f"let agents follow it: `steer {follow}({field.name})`, or delete it"
            report.warning("unread-field", f"field `{field.name}` is laid but never smelled", field.span, advice)


def _iterate_field_users(program: Program) -> Iterator[object]:
    """Yield the parts of a program in which fields can be named. Each state is a separate part, because an edit usually changes
    only one state."""
    for species in program.species.values():
        yield from (state for machine in species.machines for state in machine.states)
        yield (*species.attributes, *species.lets, *species.latches, *species.handlers, species.layers)
    yield from (*program.specs, *program.measures)


def _find_used_names(root: object) -> tuple[frozenset[str], frozenset[str]]:
    """Return the names of things used as values below `root`, and the names of fields into which an effect deposits."""
    every, laying = list(iterate_parts(root)), list_feeding_effects("field")
    return (
        frozenset(each.name for each in every if isinstance(each, ThingRef)),
        frozenset(each.target for each in every if isinstance(each, EffectRequest) and each.op in laying),
    )


def _check_attribute(context: CheckContext, species: Species, attribute: AttributeDecl, report: Report) -> None:
    name = f"{species.name}.{attribute.name}"
    read, written = context.is_used("attribute", name), name in context.declarations.written_attributes
    if written and not read:
        hint = f"test it: `when {attribute.name} … -> …`, name it in `output: {{attributes: […]}}` of the scene, or delete it"
        report.warning("unread-attribute", f"attribute `{attribute.name}` is set but never read", attribute.span, hint)
    elif read and not written and attribute.relax_to is None and isinstance(attribute.default, (Constant, NoneRef)):
        value = quote_source(attribute.default.span)
        advice = f"set it where it changes: `{attribute.name} = …`, or make it a `param` if all agents share it"
        report.warning("constant-attribute", f"attribute `{attribute.name}` is always {value}", attribute.span, advice)


def check_events(context: CheckContext, report: Report) -> None:
    """Report events that are emitted but not handled, and events that are handled but not emitted."""
    declared = context.declarations
    if any(species.node is None for species in declared.species.values()):
        return  # a species of another file may emit or handle the event
    for event, span in declared.events.items():
        _report_unhandled_event(context, event, span, report)
        raised = any(context.is_used(op, event) for op in list_feeding_effects("event"))
        noticed = context.is_used("on", event) or context.is_used("event", event)
        others = [name for name in declared.events if name != event]
        near = find_nearest_name(event, others)
        if raised and not noticed:
            advice = f"did you mean `{near}`?" if near else f"write `on {event} {{ … }}`, or test for it: `when {event} -> …`"
            report.warning("unheard-event", f"no agent handles the event `{event}`", span, advice)
        elif noticed and not raised:
            advice = f"did you mean `{near}`?" if near else f"write `emit {event}(within: 20 mm)` where it happens"
            report.warning("silent-event", f"no agent emits the event `{event}`", span, advice)


def _report_unhandled_event(context: CheckContext, event: str, span: Span, report: Report) -> None:
    """Report each species that receives an event although it neither handles the event nor tests for it."""
    for name in context.declarations.species:
        if context.is_used("told", f"{event} {name}") and not context.is_used("heard", f"{event} {name}"):
            advice = f"write `on {event} {{ … }}` in `species {name}`, or test for it there: `when {event} -> …`"
            report.warning("unheard-event", f"a `{name}` receives the event `{event}`, but does not handle it", span, advice)
