"""What is declared and never used: params, attributes, lets, latches, fields, behaviours."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import Checked
from antdsl.program.model import Op, Species
from antdsl.syntax import nodes


def unused(checked: Checked, report: Report) -> None:
    for species in checked.program.species.values():
        _species(checked, species, report)
    for field in checked.program.fields.values():
        if not checked.uses("field", field.name):
            report.warning(
                "unused-field",
                f"field `{field.name}` is never laid and never smelled",
                field.span,
                f"write `deposit {field.name} 1 /s` in a state, or delete it",
            )
    _behaviours(checked, report)


def _species(checked: Checked, species: Species, report: Report) -> None:
    for param in species.params:
        if not checked.uses("param", param.name):
            short = param.name.partition(".")[2]
            report.warning(
                "unused-param",
                f"param `{short}` is never used",
                param.span,
                f"write `{short}` where its value belongs, or delete it",
            )
    for attribute in species.attributes:
        name = f"{species.name}.{attribute.name}"
        if not attribute.is_builtin and not checked.uses("attribute", name) and name not in checked.declared.written:
            report.warning(
                "unused-attribute", f"attribute `{attribute.name}` is never used", attribute.span, "use it, or delete it"
            )
    for binding in (*species.lets, *species.latches):
        if not checked.uses("let", f"{species.name}.{binding.name}"):
            word = "fuzzy" if isinstance(binding.value, Op) and binding.value.name == "fuzzy" else binding.role
            report.warning(
                f"unused-{binding.role}", f"`{word} {binding.name}` is never used", binding.span, "use it, or delete it"
            )


def _behaviours(checked: Checked, report: Report) -> None:
    """Report behaviours that nothing calls, in files with a species; a file of behaviours alone is there for others."""
    for file in checked.files:
        if not any(isinstance(item, nodes.Species) for item in file.node.items):
            continue
        for info in file.own.values():
            name = info.node.name
            if not checked.uses("behaviour", f"{name.span}"):
                report.warning(
                    "unused-behaviour",
                    f"behaviour `{name.text}` is never called",
                    name.span,
                    f"call it: `steer {name.text}(…)`, or delete it",
                )
