"""The judge of a spec. It evaluates the world frame by frame, records what the spec needs, and reports failures."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.measures.evaluator import RunEvaluator, extend_table_for_ids
from antdsl.plan import ir
from antdsl.plan.lowering.spec_plans import JudgementPlan, ReadingPlan, SpecPlan
from antdsl.runtime.world import World
from antdsl.specs.cases import MAX_NAMED_AGENTS, GoalValue, SpecFailure
from antdsl.specs.comparison import ReferenceRunRecord
from antdsl.specs.lines import AgentIds, FrameObservation, JudgementLine, count_duration_steps, observe_aggregate
from antdsl.specs.value_text import describe_states_and_position, format_value
from antdsl.syntax.words import NUMBER_REGEX

_NUMBER_PATTERN = re.compile(NUMBER_REGEX)


class SpecJudge:
    """Judges one spec over a run. Call `judge_frame` at each frame, starting with the first, until `is_over` is true.

    `failures`: the failures in the order of detection. `fulfilled_at_start`: the lines with `within` or `eventually` that
    already hold in the first frame, and therefore test nothing. A spec that compares two runs also needs the record of its
    reference run."""

    def __init__(self, plan: SpecPlan, world: World, last: int, compared_run: ReferenceRunRecord | None = None) -> None:
        self.plan, self.first, self.reference_run = plan, world.frame, compared_run
        self.evaluator = RunEvaluator(plan, world)
        self.last = find_last_frame(plan, world, last)
        self.lines = [
            JudgementLine(j, count_duration_steps(world, j.time), count_duration_steps(world, j.hold_time))
            for j in plan.judgements
        ]
        self.failures: list[SpecFailure] = []
        self.fulfilled_at_start: list[JudgementPlan] = []
        self.goals: list[GoalValue] = []
        self.is_over = False

    def judge_frame(self, world: World) -> None:
        """Judge the current frame of the world."""
        if self.is_over:
            return
        spec_world = self.evaluator.evaluate_frame(
            world, {} if self.reference_run is None else self.reference_run.get_reference_values(world.frame - self.first)
        )
        final = world.frame >= self.last
        for line in (line for line in self.lines if line.plan.kind == "until" and line.plan.species is None):
            final = bool(len(line.find_failed(self._observe_line(world, spec_world, line, final)))) or final
        for line in self.lines:
            if line.is_undecided and line.plan.kind != "until" and (final or not line.plan.is_at_end):
                observation = self._observe_line(world, spec_world, line, final)
                if world.frame == self.first and line.is_fulfilled_at_start(observation):
                    self.fulfilled_at_start.append(line.plan)
                failing_agents = (
                    self._judge_sooner(line, observation) if line.plan.kind == "sooner" else line.find_failed(observation)
                )
                if len(failing_agents):
                    self._record_failure(world, spec_world, line, failing_agents)
        for line in self.lines:
            if line.plan.kind == "until" and line.plan.species is not None:
                released_ids = line.find_failed(self._observe_line(world, spec_world, line, final))
                line.is_fulfilled = extend_table_for_ids(line.is_fulfilled, spec_world.populations[line.plan.species].ids, False)
                line.is_fulfilled[released_ids] = True
        if final:
            self.goals = [self._read_goal(world, line.plan) for line in self.lines if line.plan.goal is not None]
        self.is_over = final or not any(line.is_undecided for line in self.lines if line.plan.kind != "until")

    def _read_goal(self, world: World, plan: JudgementPlan) -> GoalValue:
        assert plan.goal is not None
        value, target = (float(self.evaluator.evaluate_node(world, node)) for node in (plan.goal.value, plan.goal.target))
        return GoalValue(" ".join(plan.span.text.split()), value, target, plan.goal.tolerance)

    def _observe_line(self, world: World, spec_world: World, line: JudgementLine, final: bool) -> FrameObservation:
        """Evaluate the condition of a line in this frame, and return the observation."""
        plan = line.plan
        if plan.species is None:
            start_holds = None if plan.start_condition is None else self._evaluate_condition(world, plan.start_condition)
            return observe_aggregate(world.frame, final, self.first, self._evaluate_condition(world, plan.condition), start_holds)
        judged = spec_world.populations[plan.species]
        assert isinstance(plan.condition, str)
        since_flags = None if plan.start_condition is None else judged.now[str(plan.start_condition)].astype(np.bool_)
        holds = judged.now[plan.condition].astype(np.bool_)
        first_frames = np.maximum(judged.born, self.first)
        return FrameObservation(
            world.frame, final, judged.ids, first_frames, holds, since_flags, self._find_released(line, judged.ids)
        )

    def _evaluate_condition(self, world: World, node: ir.PlanNode | str) -> bool:
        """Return whether a condition on aggregates holds. If a value in it is NaN, the condition does not hold."""
        assert isinstance(node, ir.PlanNode)
        return bool(self.evaluator.evaluate_node(world, node))

    def _find_released(self, line: JudgementLine, ids: AgentIds) -> NDArray[np.bool_]:
        """Return, for each agent, whether an `until` in the same block as the line has held in an earlier frame, bool[n]."""
        free = np.zeros(len(ids), np.bool_)
        for other in self.lines:
            if other.plan.kind == "until" and other.plan.block_number == line.plan.block_number:
                free |= extend_table_for_ids(other.is_fulfilled, ids, False)[ids]
        return free

    def _judge_sooner(self, line: JudgementLine, observation: FrameObservation) -> AgentIds:
        """Return the ids of the agents that fail a `sooner` line. Its condition must hold earlier in this run than in the
        reference run.

        Frames are counted from the first frame of each run."""
        assert self.reference_run is not None
        holds = bool(len(line.find_failed(observation)))
        reference_steps = self.reference_run.find_steps_until_held(line.plan)
        is_lost = reference_steps is not None and observation.frame - self.first >= reference_steps
        if is_lost:
            line.failure_reason = f"in the reference run it held after {self._format_seconds(reference_steps or 0)}"
            line.failure_reason += ", no later than here" if holds else ", but not here yet"
        elif not holds and observation.is_final:
            is_lost, line.failure_reason = True, "the run is over, and it did not hold in the reference run either"
        line.is_undecided = not holds
        return observation.ids if is_lost else observation.ids[:0]

    def _format_seconds(self, steps: int) -> str:
        return f"{steps * self.reference_run.dt:.6g} s" if self.reference_run is not None else ""

    # --- reporting ---------------------------------------------------------------------------------------------------

    def _format_values(
        self, world: World, spec_world: World, plan: JudgementPlan, row: int | None
    ) -> tuple[tuple[str, str], ...]:
        """Return the values that a line reads, each with its source text. `row`: the row of the agent that failed; None for a
        line about aggregates."""
        reading_values: list[tuple[ReadingPlan, Any]] = []
        for reading in plan.readings:
            if reading.node is not None:
                reading_values.append((reading, self.evaluator.evaluate_node(world, reading.node)))
            elif row is not None and row >= 0 and reading.register is not None:
                reading_values.append((reading, spec_world.populations[plan.species].now[reading.register][row]))  # type: ignore[index]
        return _format_readings(world, reading_values, plan.span.text)

    def _record_failure(self, world: World, spec_world: World, line: JudgementLine, agents: AgentIds) -> None:
        """Record the failure of a line, and stop judging the line.

        For a line about aggregates, the recorded values are the aggregates. Otherwise, they are the values of the failed agent
        with the smallest id."""
        line.is_undecided = False
        plan, fps = line.plan, float(world.setting.fps)
        first_agent = int(agents.min())
        row = None
        if plan.species is not None:
            row = int(spec_world.populations[plan.species].find_rows(np.array([first_agent]))[0])
            if row >= 0:
                self.evaluator.run_block(spec_world, "blend", plan.species, np.array([row]))
        values = self._format_values(world, spec_world, plan, row)
        text = " ".join(plan.span.text.split())
        message = f"{text}{f' ({line.failure_reason})' if line.failure_reason else ''}"
        failure = SpecFailure(message, plan.span, world.frame, (world.frame - self.first) / fps, values)
        if plan.species is not None:
            named_agents = tuple(int(each) for each in np.sort(agents)[:MAX_NAMED_AGENTS])
            there_still = row is not None and row >= 0
            failure = replace(
                failure, agent=(plan.species, first_agent), other_count=len(agents) - 1, agents=named_agents,
                wait_start_frame=line.find_start_frame(first_agent),
                states_and_position=describe_states_and_position(world, plan.species, row or 0) if there_still else (),
            )  # fmt: skip
        self.failures.append(failure)


def find_last_frame(plan: SpecPlan, world: World, last_scene_frame: int) -> int:
    """Return the last frame of a spec that begins at the world's current frame. It is given by the spec's `for`, or else it is
    the last frame of the scene."""
    steps = count_duration_steps(world, plan.duration)
    return last_scene_frame if steps is None else world.frame + steps


def _format_readings(world: World, reading_values: list[tuple[ReadingPlan, Any]], line: str) -> tuple[tuple[str, str], ...]:
    """Return, for each reading, its text in the program and its formatted value.

    If two different values, or a value and a number in the line, would look equal when rounded, all of their digits are shown.
    """
    texts = [" ".join(reading.span.text.split()) for reading, _ in reading_values]
    values = [format_value(world, value, reading.type, reading.unit) for reading, value in reading_values]
    written_numbers = {float(number) for number in _NUMBER_PATTERN.findall(line)}
    alike = len(set(values)) < len({float(value) for _, value in reading_values})
    if alike or any(float(number) in written_numbers for text in values for number in _NUMBER_PATTERN.findall(text)[:1]):
        values = [format_value(world, value, reading.type, reading.unit, True) for reading, value in reading_values]
    return tuple(dict.fromkeys(zip(texts, values, strict=True)))
