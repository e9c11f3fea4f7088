"""Judges one spec over a run: evaluates the world frame by frame, stores what the spec needs, and reports failures."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.plan.lowering.spec_blocks import JudgementPlan, ReadingPlan, SpecPlan
from antdsl.runtime.world import World
from antdsl.specs.cases import MAX_NAMED_AGENTS, Failure
from antdsl.specs.comparison import ComparedRun
from antdsl.specs.lines import FrameObservation, Ids, JudgementLine, duration_in_steps, observe_whole
from antdsl.specs.queries import SpecEvaluator, extend_table
from antdsl.specs.value_text import agent_whereabouts, format_value
from antdsl.syntax.words import NUMBER_REGEX

_NUMBER_PATTERN = re.compile(NUMBER_REGEX)


class SpecJudge:
    """Call `look` for each frame from the first on, until `over`. `failures` are in order of detection. A spec that compares runs
    also has the reference run."""

    def __init__(self, plan: SpecPlan, world: World, last: int, compared_run: ComparedRun | None = None) -> None:
        self.plan, self.first, self.rival = plan, world.frame, compared_run
        self.asker = SpecEvaluator(plan, world)
        self.last = last_frame(plan, world, last)
        self.lines = [
            JudgementLine(j, duration_in_steps(world, j.time), duration_in_steps(world, j.held)) for j in plan.judgements
        ]
        self.failures: list[Failure] = []
        self.over = False

    def look(self, world: World) -> None:
        """Judge the world as it is at this frame."""
        if self.over:
            return
        spec_world = self.asker.ask(world, {} if self.rival is None else self.rival.values(world.frame - self.first))
        final = world.frame >= self.last
        for line in (line for line in self.lines if line.plan.kind == "until" and line.plan.species is None):
            final = bool(len(line.look(self._observe(world, spec_world, line, final)))) or final
        for line in self.lines:
            if line.open and line.plan.kind != "until" and (final or not line.plan.at_end):
                observation = self._observe(world, spec_world, line, final)
                failed = self._check_race(line, observation) if line.plan.kind == "sooner" else line.look(observation)
                if len(failed):
                    self._record_failure(world, spec_world, line, failed)
        for line in self.lines:
            if line.plan.kind == "until" and line.plan.species is not None:
                released_ids = line.look(self._observe(world, spec_world, line, final))
                line.fine = extend_table(line.fine, spec_world.populations[line.plan.species].ids, False)
                line.fine[released_ids] = True
        self.over = final or not any(line.open for line in self.lines if line.plan.kind != "until")

    def _observe(self, world: World, spec_world: World, line: JudgementLine, final: bool) -> FrameObservation:
        """Evaluate the condition of a line in this frame."""
        plan = line.plan
        if plan.species is None:
            since = None if plan.since is None else self._holds(world, plan.since)
            return observe_whole(world.frame, final, self.first, self._holds(world, plan.condition), since)
        judged = spec_world.populations[plan.species]
        assert isinstance(plan.condition, str)
        since_flags = None if plan.since is None else judged.now[str(plan.since)].astype(np.bool_)
        holds = judged.now[plan.condition].astype(np.bool_)
        first_frames = np.maximum(judged.born, self.first)
        return FrameObservation(
            world.frame, final, judged.ids, first_frames, holds, since_flags, self._find_released(line, judged.ids)
        )

    def _holds(self, world: World, node: ir.PlanNode | str) -> bool:
        """Return whether a condition on aggregates holds; NaN makes it false."""
        assert isinstance(node, ir.PlanNode)
        return bool(self.asker.value(world, node))

    def _find_released(self, line: JudgementLine, ids: Ids) -> NDArray[np.bool_]:
        """Return the agents for which an `until` of the same block has held before this frame."""
        free = np.zeros(len(ids), np.bool_)
        for other in self.lines:
            if other.plan.kind == "until" and other.plan.block == line.plan.block:
                free |= extend_table(other.fine, ids, False)[ids]
        return free

    def _check_race(self, line: JudgementLine, observation: FrameObservation) -> Ids:
        """Judge `sooner`: the condition must hold in an earlier frame here than in the other run. Frames are counted from the
        first of each run."""
        assert self.rival is not None
        holds = bool(len(line.look(observation)))
        when = self.rival.steps_until_held(line.plan)
        lost = when is not None and observation.frame - self.first >= when
        if lost:
            line.why = f"in the other run it was so after {self._seconds_text(when or 0)}"
            line.why += ", no later than here" if holds else ", but not here yet"
        elif not holds and observation.final:
            lost, line.why = True, "the run is over, and it did not hold in the other run either"
        line.open = not holds
        return observation.ids if lost else observation.ids[:0]

    def _seconds_text(self, steps: int) -> str:
        return f"{steps * self.rival.dt:.6g} s" if self.rival is not None else ""

    # --- reporting ---------------------------------------------------------------------------------------------------

    def _format_values(
        self, world: World, spec_world: World, plan: JudgementPlan, row: int | None
    ) -> tuple[tuple[str, str], ...]:
        """Return the texts and values of a line's readings. `row`: the failed agent's row; None for a line about an aggregate."""
        reading_values: list[tuple[ReadingPlan, Any]] = []
        for reading in plan.readings:
            if reading.node is not None:
                reading_values.append((reading, self.asker.value(world, reading.node)))
            elif row is not None and row >= 0 and reading.register is not None:
                reading_values.append((reading, spec_world.populations[plan.species].now[reading.register][row]))  # type: ignore[index]
        return _format_readings(world, reading_values, plan.span.text)

    def _record_failure(self, world: World, spec_world: World, line: JudgementLine, agents: Ids) -> None:
        """Close a line and store its failure, with aggregate values or those of the failed agent with the least id."""
        line.open = False
        plan, fps = line.plan, float(world.setting.fps)
        least = int(agents.min())
        row = None
        if plan.species is not None:
            row = int(spec_world.populations[plan.species].rows_of(np.array([least]))[0])
            if row >= 0:
                self.asker.run(spec_world, "blend", plan.species, np.array([row]))
        values = self._format_values(world, spec_world, plan, row)
        text = " ".join(plan.span.text.split())
        message = f"{text}{f' ({line.why})' if line.why else ''}"
        failure = Failure(message, plan.span, world.frame, (world.frame - self.first) / fps, values)
        if plan.species is not None:
            named = tuple(int(each) for each in np.sort(agents)[:MAX_NAMED_AGENTS])
            there_still = row is not None and row >= 0
            failure = replace(
                failure, agent=(plan.species, least), others=len(agents) - 1, agents=named, began=line.start_frame(least),
                whereabouts=agent_whereabouts(world, plan.species, row or 0) if there_still else (),
            )  # fmt: skip
        self.failures.append(failure)


def last_frame(plan: SpecPlan, world: World, last: int) -> int:
    """Return the last frame of a spec that begins now: the scene's last frame, or the end of the spec's `for`."""
    steps = duration_in_steps(world, plan.duration)
    return last if steps is None else world.frame + steps


def _format_readings(world: World, reading_values: list[tuple[ReadingPlan, Any]], line: str) -> tuple[tuple[str, str], ...]:
    """Return each reading's text in the program and its formatted value. Values have all digits if different values, or a value
    and a number of the line, would otherwise look alike."""
    texts = [" ".join(reading.span.text.split()) for reading, _ in reading_values]
    values = [format_value(world, value, reading.type, reading.unit) for reading, value in reading_values]
    written = {float(number) for number in _NUMBER_PATTERN.findall(line)}
    alike = len(set(values)) < len({float(value) for _, value in reading_values})
    if alike or any(float(number) in written for text in values for number in _NUMBER_PATTERN.findall(text)[:1]):
        values = [format_value(world, value, reading.type, reading.unit, True) for reading, value in reading_values]
    return tuple(dict.fromkeys(zip(texts, values, strict=True)))
