"""The measures of a scene's program, and the condition that ends its run."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.loading import LoadedSources
from antdsl.measures.conditions import ConditionError, check_condition, compile_condition
from antdsl.plan.ir import Plan
from antdsl.plan.lowering.spec_blocks import lower_measures
from antdsl.plan.lowering.spec_plans import MeasuresPlan, SpecPlan
from antdsl.program.model import Program
from antdsl.scene.load import Scene


def check_until(scene: Scene, loaded: LoadedSources, *, is_option: bool = False) -> Report:
    """Return the errors in the condition that ends a run of a scene. `is_option`: whether the condition comes from an option
    instead of the scene's text."""
    report, text = Report(), scene.model.until
    if text is None:
        return report
    try:
        check_condition(loaded, text, allows_each=False)
    except ConditionError as error:
        span = None if is_option else scene.find_span("until")
        report.error("wrong-argument", f"`{'--until' if is_option else 'until'}`: {error}", span, error.help or None)
    return report


def lower_scene_measures(
    scene: Scene, program: Program, loaded: LoadedSources, plan: Plan
) -> tuple[MeasuresPlan | None, SpecPlan | None, Report]:
    """Return the plan of the measures, the plan of the scene's `until`, and a report. A plan is None if there is nothing to
    evaluate.

    `plan`: the lowered program. `check_until` must have found no errors."""
    measures, report = lower_measures(program, plan) if program.measures else (None, Report())
    until = None
    if scene.model.until is not None and report.ok:
        try:
            until = compile_condition(loaded, plan, scene.model.until)
        except ConditionError as error:
            report.error("wrong-argument", f"`until`: {error}", scene.find_span("until"), error.help or None)
    return measures, until, report
