"""The measures of one run, frame by frame, and the condition that ends the run."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from antdsl.measures.evaluator import RunEvaluator
from antdsl.plan import ir
from antdsl.plan.lowering.spec_plans import MeasuresPlan, SpecPlan
from antdsl.runtime.world import World

MeasureNumber = float | int | None


class RunMeasures:
    """Evaluates the measures of a run. Call `record_frame` at each frame, from the first on.

    `values`: the measures of the current frame by name. A number is in base units (mm, s, g, rad), and a condition is 0 or 1.
    None stands for a value that is not finite, such as the time of an event that has not happened.
    `is_over`: whether the condition that ends the run has been true."""

    def __init__(self, measures: MeasuresPlan | None, until: SpecPlan | None, world: World) -> None:
        self.nodes: Mapping[str, ir.PlanNode] = {} if measures is None else measures.nodes
        self._measured = RunEvaluator(measures, world) if measures is not None and measures.nodes else None
        self._until = None if until is None else (RunEvaluator(until, world), until.judgements[0].condition)
        self.values: dict[str, MeasureNumber] = dict.fromkeys(self.nodes)
        self.is_over = False

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the measures."""
        return tuple(self.nodes)

    def record_frame(self, world: World) -> None:
        """Evaluate all measures at this frame, and check whether the run ends with it."""
        if self._measured is not None:
            self._measured.evaluate_frame(world, {})
            for name, node in self.nodes.items():
                value = self._measured.evaluate_node(world, node)
                self.values[name] = int(value) if isinstance(value, bool | np.bool_) else _make_finite(value)
        if self._until is not None and not self.is_over:
            evaluator, condition = self._until
            assert isinstance(condition, ir.PlanNode)
            evaluator.evaluate_frame(world, {})
            self.is_over = bool(evaluator.evaluate_node(world, condition))

    def save_stored_values(self) -> NDArray[np.float64]:
        """Return the values of earlier frames that later frames need, for a checkpoint, as float64 (n, 2).

        Row 0 is the first frame. Column 0 is the value, or NaN if it is not known yet. Column 1 is 1 if the value has 64 bits.
        """
        values = [each.values.get(name, np.float32(math.nan)) for each, name in self._list_stored()]
        first = [(float(each.first), 1.0) for each in self._evaluators()[:1]]
        return np.array([*first, *((float(each), float(isinstance(each, np.float64))) for each in values)]).reshape(-1, 2)

    def restore_stored_values(self, stored_values: NDArray[np.float64]) -> None:
        """Restore the values of earlier frames from a checkpoint. An array of the wrong shape is ignored."""
        stored = self._list_stored()
        if stored_values.shape != (len(stored) + 1, 2):
            return
        for evaluator in self._evaluators():
            evaluator.first = int(stored_values[0, 0])
        for (evaluator, name), (number, is_wide) in zip(stored, stored_values[1:], strict=True):
            if not math.isnan(number):
                evaluator.values[name] = np.float64(number) if is_wide else np.float32(number)

    def _evaluators(self) -> list[RunEvaluator]:
        return [each for each in (self._measured, self._until and self._until[0]) if each is not None]

    def _list_stored(self) -> list[tuple[RunEvaluator, str]]:
        return [(each, plan.name) for each in self._evaluators() for plan in each.plan.stored_values]


def _make_finite(value: np.float32 | np.float64) -> float | None:
    """Return a number with as few digits as identify it, or None if it is not finite."""
    return float(str(value)) if math.isfinite(value) else None
