"""The reference run of a spec that compares two runs. It runs first, with the same seed, and stores the values that the
comparison needs from each frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from antdsl.plan import ir
from antdsl.plan.lowering.spec_blocks import JudgementPlan, SpecPlan
from antdsl.runtime.world import World
from antdsl.specs.lines import JudgementLine, duration_in_steps, observe_whole
from antdsl.specs.queries import SpecEvaluator

JudgementKey = tuple[str, int]


class ComparedRun:
    """The reference run of a comparison. Call `look` at each of its frames, from the first on. Frames are counted from the first,
    so the two scenes may have different frame numbers. `dt`: seconds per frame."""

    def __init__(self, plan: SpecPlan, world: World) -> None:
        self.asker = SpecEvaluator(plan, world)
        self.plan, self.first, self.dt = plan, world.frame, world.dt
        self.lines = {
            _line_key(j): JudgementLine(j, None, duration_in_steps(world, j.held)) for j in plan.judgements if j.kind == "sooner"
        }
        self.when: dict[JudgementKey, int] = {}
        self.seen: list[Mapping[str, Any]] = []
        self.blank = {each.name: np.float32(np.nan) for each in plan.others}

    def look(self, world: World) -> None:
        """Store the numbers of this frame, and whether it is the first in which the condition of a `sooner` holds."""
        self.asker.ask(world, self.blank)
        self.seen.append({each.name: self.asker.value(world, each.value) for each in self.plan.others})
        for place, line in self.lines.items():
            assert isinstance(line.plan.condition, ir.PlanNode)
            holds = bool(self.asker.value(world, line.plan.condition))
            if len(line.look(observe_whole(world.frame, False, self.first, holds, None))):
                self.when.setdefault(place, world.frame - self.first)

    def values(self, frame: int) -> Mapping[str, Any]:
        """Return the values of the reference run in a frame, counted from its first. After its last frame, they stay constant."""
        return self.seen[min(frame, len(self.seen) - 1)]

    def steps_until_held(self, line: JudgementPlan) -> int | None:
        """Return after how many steps the condition of a `sooner` held in the reference run; None if it never did."""
        return self.when.get(_line_key(line))


def _line_key(line: JudgementPlan) -> JudgementKey:
    """Return a line's location in the text, which is the same in both runs."""
    return line.span.source.path, line.span.start
