"""What is declared and never used: params, attributes, lets, latches, fields, behaviours."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.program.model import Op, Species
from antdsl.syntax import nodes


def check_unused(checked: CheckContext, report: Report) -> None:
    for species in checked.program.species.values():
        _check_species(checked, species, report)
    for field in checked.program.fields.values():
        if not checked.is_used("field", field.name):
            message = f"field `{field.name}` is never laid and never smelled"
            report.warning("unused-field", message, field.span, f"write `deposit {field.name} 1 /s` in a state, or delete it")
    _check_behaviours(checked, report)


def _check_species(checked: CheckContext, species: Species, report: Report) -> None:
    for param in species.params:
        if not checked.is_used("param", param.name):
            short = param.name.partition(".")[2]
            message = f"param `{short}` is never used"
            report.warning("unused-param", message, param.span, f"write `{short}` where its value belongs, or delete it")
    for attribute in species.attributes:
        name = f"{species.name}.{attribute.name}"
        if not attribute.is_builtin and not checked.is_used("attribute", name) and name not in checked.declared.written:
            words = f"attribute `{attribute.name}` is never used"
            report.warning("unused-attribute", words, attribute.span, "use it, or delete it")
    for binding in (*species.lets, *species.latches):
        if not checked.is_used("let", f"{species.name}.{binding.name}"):
            word = "fuzzy" if isinstance(binding.value, Op) and binding.value.name == "fuzzy" else binding.role
            words = f"`{word} {binding.name}` is never used"
            report.warning(f"unused-{binding.role}", words, binding.span, "use it, or delete it")


def _check_behaviours(checked: CheckContext, report: Report) -> None:
    """Report behaviours that nothing calls, in files with a species; a file of behaviours alone is there for others."""
    for file in checked.files:
        if not any(isinstance(item, nodes.Species) for item in file.node.items):
            continue
        for info in file.own.values():
            name = info.node.name
            if not checked.is_used("behaviour", f"{name.span}"):
                message = f"behaviour `{name.text}` is never called"
                report.warning("unused-behaviour", message, name.span, f"call it: `steer {name.text}(…)`, or delete it")
