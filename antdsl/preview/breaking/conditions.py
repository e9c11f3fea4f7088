"""Breakpoints that are hit when a condition, written in the language of specs, becomes true.

The condition is about the world as a whole, or about each agent of a species (`each SPECIES: …`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.measures.conditions import ConditionError, compile_condition
from antdsl.measures.evaluator import RunEvaluator
from antdsl.pipeline import Shot
from antdsl.plan.lowering.spec_plans import SpecPlan
from antdsl.preview.breaking.model import BreakpointError
from antdsl.preview.breaking.watchers import MAX_SELECTED_AGENTS, format_agents
from antdsl.preview.observing.observer import PauseReason
from antdsl.preview.requests import ConditionBreak
from antdsl.preview.session import PreviewSession
from antdsl.runtime import World
from antdsl.specs.value_text import format_value


class ConditionWatcher:
    """A watcher that reports a hit when a condition becomes true: it holds now and did not hold in the previous frame.

    A condition about each agent is evaluated for each agent, and the hit names the agents for which it became true."""

    def __init__(self, session: PreviewSession, request: ConditionBreak) -> None:
        self.text = " ".join(request.text.split())
        self.plan = compile_break_condition(session.shot, request.text)
        [self.line] = self.plan.judgements
        self.evaluator: RunEvaluator | None = None
        # ids for which the condition held; a single 0 for a condition about the complete world
        self.previous_ids: NDArray[np.int64] = np.zeros(0, np.int64)

    def begin(self, session: PreviewSession) -> None:
        self.evaluator = RunEvaluator(self.plan, session.world)
        self.previous_ids = self._find_matching_ids(self.evaluator, session.world)

    def check_frame(self, session: PreviewSession) -> PauseReason | None:
        if self.evaluator is None:
            self.begin(session)
            return None
        previous, self.previous_ids = self.previous_ids, self._find_matching_ids(self.evaluator, session.world)
        new = np.setdiff1d(self.previous_ids, previous)
        if not len(new):
            return None
        if self.line.species is None:
            return PauseReason(
                f"{self.text}: true at frame {session.frame}{self._describe_values(self.evaluator, session.world)}"
            )
        ids = tuple(int(each) for each in new)
        text = self.text.partition(":")[2].strip()
        return PauseReason(
            f"{format_agents(self.line.species, ids[:MAX_SELECTED_AGENTS])}: {text} at frame {session.frame}",
            self.line.species,
            ids[:MAX_SELECTED_AGENTS],
        )

    def _find_matching_ids(self, evaluator: RunEvaluator, world: World) -> NDArray[np.int64]:
        judged_world = evaluator.evaluate_frame(world, {})
        if self.line.species is None:
            assert not isinstance(self.line.condition, str)
            return np.zeros(int(bool(evaluator.evaluate_node(world, self.line.condition))), np.int64)
        judged = judged_world.populations[self.line.species]
        assert isinstance(self.line.condition, str)
        return judged.ids[judged.now[self.line.condition].astype(np.bool_)]

    def _describe_values(self, evaluator: RunEvaluator, world: World) -> str:
        readings = []
        for reading in self.line.readings:
            if reading.node is not None:
                value = format_value(world, evaluator.evaluate_node(world, reading.node), reading.type, reading.unit)
                readings.append(f"{' '.join(reading.span.text.split())} is {value}")
        return f" ({', '.join(dict.fromkeys(readings))})" if readings else ""


def compile_break_condition(shot: Shot, text: str) -> SpecPlan:
    """Return the plan that evaluates a condition. Raises BreakpointError with the first error in `text`."""
    try:
        return compile_condition(shot.loaded, shot.plan, text)
    except ConditionError as error:
        raise BreakpointError(str(error), error.help) from None
