"""The reference run of a spec that compares two runs.

It runs first, with the same seed, and records in each frame the values that the comparison needs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from antdsl.measures.evaluator import RunEvaluator
from antdsl.plan import ir
from antdsl.plan.lowering.spec_plans import JudgementPlan, SpecPlan
from antdsl.runtime.world import World
from antdsl.specs.lines import JudgementLine, count_duration_steps, observe_aggregate

JudgementKey = tuple[str, int]


class ReferenceRunRecord:
    """A record of the values in a spec's reference run. Call `record_frame` at each frame of the reference run, starting with
    the first.

    Frames are counted from the first frame of each run, because the two scenes may have different frame numbers. `dt`: seconds
    per frame."""

    def __init__(self, plan: SpecPlan, world: World) -> None:
        self.evaluator = RunEvaluator(plan, world)
        self.plan, self.first, self.dt = plan, world.frame, world.dt
        self.lines = {
            _make_line_key(j): JudgementLine(j, None, count_duration_steps(world, j.hold_time))
            for j in plan.judgements
            if j.kind == "sooner"
        }
        self.steps_by_line: dict[JudgementKey, int] = {}
        self.values_by_frame: list[Mapping[str, Any]] = []
        self.blank_values = {each.name: np.float32(np.nan) for each in plan.reference_values}

    def record_frame(self, world: World) -> None:
        """Record the numbers of this frame. For each `sooner` line, also record the first frame in which its condition holds."""
        self.evaluator.evaluate_frame(world, self.blank_values)
        self.values_by_frame.append(
            {each.name: self.evaluator.evaluate_node(world, each.value) for each in self.plan.reference_values}
        )
        for place, line in self.lines.items():
            assert isinstance(line.plan.condition, ir.PlanNode)
            holds = bool(self.evaluator.evaluate_node(world, line.plan.condition))
            if len(line.find_failed(observe_aggregate(world.frame, False, self.first, holds, None))):
                self.steps_by_line.setdefault(place, world.frame - self.first)

    def get_reference_values(self, frame: int) -> Mapping[str, Any]:
        """Return the values of the reference run in a frame. `frame`: counted from the first frame of that run. Beyond its last
        frame, return the values of its last frame."""
        return self.values_by_frame[min(frame, len(self.values_by_frame) - 1)]

    def find_steps_until_held(self, line: JudgementPlan) -> int | None:
        """Return after how many steps of the reference run the condition of a `sooner` first held, or None if it never held."""
        return self.steps_by_line.get(_make_line_key(line))


def _make_line_key(line: JudgementPlan) -> JudgementKey:
    """Return a key for a line of a spec. It is the line's location in the source, which is the same in the reference run and in
    the judged run."""
    return line.span.source.path, line.span.start
