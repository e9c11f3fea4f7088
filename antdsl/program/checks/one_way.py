"""Memory that is never used: attributes that are set and never read, or always as at first; fields that no agent smells."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.program.memo import cached_part
from antdsl.program.model import Ask, AttributeDecl, Const, NoneRef, Program, Species, ThingRef
from antdsl.program.tables.effects import feeding_effects
from antdsl.program.traverse import parts
from antdsl.program.types.descriptions import quote_source


def check_unused_memory(checked: CheckContext, report: Report) -> None:
    for species in checked.program.species.values():
        for attribute in species.attributes:
            if not attribute.is_builtin:
                _check_attribute(checked, species, attribute, report)
    wholes = _field_users(checked.program) if checked.program.fields else ()
    named = [cached_part(checked.declared, ("named", each), partial(_used_names, each)) for each in wholes]
    read, laid = (frozenset().union(*names) for names in zip(*named, strict=True)) if named else (frozenset(), frozenset())
    for field in checked.program.fields.values():
        if field.name in laid and field.name not in read and not checked.is_used("smelled", field.name):
            advice = f"let agents follow it: `steer climb({field.name})`, or delete it"
            report.warning("unread-field", f"field `{field.name}` is laid and never smelled", field.span, advice)


def _field_users(program: Program) -> Iterator[object]:
    """Yield everything that can name a field: states one by one, as they are what changes during edits."""
    for species in program.species.values():
        yield from (state for machine in species.machines for state in machine.states)
        yield (*species.attributes, *species.lets, *species.latches, *species.handlers, species.layers)
    yield from program.specs


def _used_names(root: object) -> tuple[frozenset[str], frozenset[str]]:
    """The things that are named as values below `root`, and the fields that something is laid into."""
    every, laying = list(parts(root)), feeding_effects("field")
    return (
        frozenset(each.name for each in every if isinstance(each, ThingRef)),
        frozenset(each.of for each in every if isinstance(each, Ask) and each.op in laying),
    )


def _check_attribute(checked: CheckContext, species: Species, attribute: AttributeDecl, report: Report) -> None:
    name = f"{species.name}.{attribute.name}"
    read, written = checked.is_used("attribute", name), name in checked.declared.written
    if written and not read:
        hint = f"ask for it: `when {attribute.name} … -> …`, name it in `output: {{attributes: […]}}` of the scene, or delete it"
        report.warning("unread-attribute", f"attribute `{attribute.name}` is set and never read", attribute.span, hint)
    elif read and not written and attribute.relax_to is None and isinstance(attribute.default, (Const, NoneRef)):
        value = quote_source(attribute.default.span)
        advice = f"set it where it changes: `{attribute.name} = …`, or make it a `param` if all agents share it"
        report.warning("constant-attribute", f"attribute `{attribute.name}` is always {value}", attribute.span, advice)
