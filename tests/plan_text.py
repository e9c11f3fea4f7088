"""Small programs from text to a verified plan, for tests of lowering and of the passes."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.loading import find_library
from antdsl.plan import ir, lower, verify_plan
from antdsl.program import check
from antdsl.program.model import Program
from antdsl.source import Source
from antdsl.syntax import parse

WORLD = """ant 1
world {
  surface ground
  obstacle stones
  curve way_in
  items food { load = 10 }
  items nest { load = 0 }
}
"""


def program_of(text: str, world: str = WORLD) -> Program:
    """A checked program; `text` stands below a world with ground, stones, food and a nest."""
    file, report = parse(Source("test.ant", world + text))
    program, findings = check(file, find_library)
    report.extend(findings)
    assert report.ok, [f"{d.span}: {d.code}: {d.message}" for d in report.errors]
    return program


def lowered(text: str, world: str = WORLD, **options: object) -> tuple[ir.Plan, Report]:
    plan, report = lower(program_of(text, world), **options)  # type: ignore[arg-type]
    verify_plan(plan)
    return plan, report


def plan_of(text: str, world: str = WORLD, **options: object) -> ir.Plan:
    """The plan of a text that has nothing to complain about."""
    plan, report = lowered(text, world, **options)
    assert not report.diagnostics, report.diagnostics
    return plan


def codes(report: Report) -> list[str]:
    return [d.code for d in report.sort_by_place()]
