"""Compilation of conditions that are not part of a program, such as a breakpoint or the end of a run.

Conditions are written in the language of specs. They concern the complete world, or each agent of a species (`each SPECIES:
…`)."""

from __future__ import annotations

import re

from antdsl.diagnostics import Report
from antdsl.loading import LoadedSources
from antdsl.plan import ir
from antdsl.plan.lowering.spec_blocks import lower_spec
from antdsl.plan.lowering.spec_plans import SpecPlan
from antdsl.program.model import Program
from antdsl.source import Source
from antdsl.syntax import nodes, parse

_EACH_PATTERN = re.compile(r"\s*each\s+([A-Za-z_]\w*)\s*:(.*)", re.DOTALL)
_SOURCE_NAME = "<condition>"
_ONE_CONDITION_HELP = "write one condition, such as `count(state == carry) > 10`"


_COMPLETE_RUN_HELP = "use `share`, `count`, `any` or `every` to test all agents together"


class ConditionError(Exception):
    """Error for a text that is not a condition. The message gives the reason. `help`: the text to write instead, or ""."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.help = help


def check_condition(loaded: LoadedSources, text: str, *, allows_each: bool = True) -> Program:
    """Return the program of the loaded files, with the condition added as its last spec. Raises ConditionError with the first
    error in the text. `allows_each`: whether the condition may be about each agent."""
    from antdsl.program import check

    short_text = " ".join(text.split())
    if not allows_each and _EACH_PATTERN.fullmatch(text):
        raise ConditionError("the condition is about each agent, not about the complete run", _COMPLETE_RUN_HELP)
    file, report = parse(Source(_SOURCE_NAME, _make_spec_text(text)))
    _raise_first_error(report)
    if not _is_one_line(file):
        raise ConditionError(f"`{short_text[:80]}` is not one condition", _ONE_CONDITION_HELP)
    program, report = check([*loaded.files, file], loaded.find_library, loaded.module_by_path)
    species = next(iter(program.species), "SPECIES")
    each_help = f"write `each {species}: {short_text}` to test every agent, or use `count` to test all agents together"
    words = each_help if allows_each else _COMPLETE_RUN_HELP
    _raise_first_error(report, "" if _EACH_PATTERN.fullmatch(text) else words)
    return program


def compile_condition(loaded: LoadedSources, plan: ir.Plan, text: str) -> SpecPlan:
    """Return the plan that evaluates a condition, as if this were the only line of a spec. Raises ConditionError with the first
    error in the text. `plan`: the lowered program of the loaded files."""
    program = check_condition(loaded, text)
    spec_plan, report = lower_spec(program.specs[-1], program, plan)
    _raise_first_error(report)
    if spec_plan is None or len(spec_plan.judgements) != 1:
        raise ConditionError(f"`{' '.join(text.split())[:80]}` is not one condition", _ONE_CONDITION_HELP)
    return spec_plan


def _make_spec_text(text: str) -> str:
    each = _EACH_PATTERN.fullmatch(text)
    if each is None:
        return f'spec "condition" {{\n  never: {text}\n}}\n'
    return f'spec "condition" {{\n  each {each[1]} {{\n    never: {each[2]}\n  }}\n}}\n'


def _is_one_line(file: nodes.File) -> bool:
    """Return whether the file is one bare condition, so that it can be written in one line."""
    if len(file.items) != 1 or not isinstance(file.items[0], nodes.Spec):
        return False
    [*lines] = file.items[0].lines
    if len(lines) == 1 and lines[0].kind == "each":
        [*lines] = lines[0].lines
    return len(lines) == 1 and lines[0].kind == "never" and lines[0].held is None


def _raise_first_error(report: Report, suggestion: str = "") -> None:
    """Raise ConditionError with the first error in the text of the condition.

    The error "the file contains only a spec" is ignored. `suggestion`: the text to write instead if a condition about the
    complete world could only be about an agent."""
    for error in report.sort_by_place():
        if error.severity == "error" and error.code != "empty-program":
            help = (error.help or "").replace("never: ", "")
            if suggestion and error.code in ("wrong-rate", "unknown-name") and not help.startswith("did you mean"):
                help = suggestion
            raise ConditionError(error.message, help)
