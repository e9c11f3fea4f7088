"""The kinds of lines in a spec. Each kind decides which agents fail a line in a frame, and why.

In names, `since` refers to the condition of a `when`. A line about aggregates is judged like a line about a single agent, which
has the id 0 and exists from the first frame on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import ceil

import numpy as np
from numpy.typing import NDArray

from antdsl.measures.aggregates import evaluate_uniform_node
from antdsl.measures.evaluator import extend_table_for_ids
from antdsl.plan import ir
from antdsl.plan.lowering.spec_plans import JudgementPlan
from antdsl.runtime.world import World

AgentIds = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
TIME_OVER_REASON, RUN_OVER_REASON, AGENT_LEFT_REASON = "the time is over", "the run is over", "it left before"
_NO_IDS = np.empty(0, np.int64)
_NO_FRAME_NUMBER = -(2**62)


@dataclass(slots=True, eq=False)
class FrameObservation:
    """The input for judging a line in one frame. The arrays have one row for each agent that the line concerns.

    - `first_frames`: the first frame of each agent.
    - `condition_holds`: whether the condition of the line holds.
    - `start_condition_holds`: whether the condition of its `when` holds; None without a `when`.
    - `is_released`: whether an `until` in the same block has held for the agent in an earlier frame."""

    frame: int
    is_final: bool
    ids: AgentIds
    first_frames: AgentIds
    condition_holds: BoolArray
    start_condition_holds: BoolArray | None
    is_released: BoolArray


def observe_aggregate(
    frame: int, is_final: bool, first_frame: int, is_fulfilled: bool, start_holds: bool | None
) -> FrameObservation:
    """Return the observation of one frame for a line about aggregates. It has a single row."""
    since_flags = None if start_holds is None else np.array([start_holds])
    return FrameObservation(
        frame,
        is_final,
        np.zeros(1, np.int64),
        np.full(1, first_frame),
        np.array([is_fulfilled]),
        since_flags,
        np.zeros(1, np.bool_),
    )


def count_duration_steps(world: World, time: ir.PlanNode | None) -> int | None:
    """Return a duration as a whole number of steps, rounded up. A tiny rounding error of the float32 duration does not add a
    step."""
    if time is None:
        return None
    return max(1, ceil(float(evaluate_uniform_node(world, time, {})) * float(world.setting.fps) * (1 - 1e-6)))


@dataclass(slots=True, eq=False)
class JudgementLine:
    """The state of judging one line of a spec over a run. Arrays are indexed by agent id.

    - `steps`, `held_steps`: the duration of the line, and the duration of its `held`, in steps; None if absent.
    - `is_undecided`: whether the line is still being judged. `failure_reason`: the reason of the last failure, as text.
    - `is_fulfilled`: whether each agent has fulfilled the line.
    - `count`: the number of consecutive frames in which the condition has held.
    - `previous_start_condition`: whether the condition of the `when` held in the previous frame.
    - `pending_since_frames`: the frame in which each agent's current waiting time began; _NO_FRAME_NUMBER for agents that are
      not waiting.
    - `waiting_ids`: the ids of the agents that were waiting in the previous frame."""

    plan: JudgementPlan
    steps: int | None
    held_steps: int | None
    is_undecided: bool = True
    failure_reason: str = ""
    is_fulfilled: BoolArray = field(default_factory=lambda: np.zeros(0, np.bool_))
    previous_start_condition: BoolArray = field(default_factory=lambda: np.zeros(0, np.bool_))
    held_step_counts: AgentIds = field(default_factory=_NO_IDS.copy)
    pending_since_frames: AgentIds = field(default_factory=_NO_IDS.copy)
    waiting_ids: AgentIds = field(default_factory=_NO_IDS.copy)

    def find_failed(self, observation: FrameObservation) -> AgentIds:
        """Return the ids of the agents that fail in this frame.

        This also sets `failure_reason`, which is "" if the only reason is that the condition is false."""
        self.failure_reason = ""
        if self.held_steps is not None:
            self.held_step_counts = extend_table_for_ids(self.held_step_counts, observation.ids, 0)
            self.held_step_counts[observation.ids] = np.where(
                observation.condition_holds, self.held_step_counts[observation.ids] + 1, 0
            )
            observation.condition_holds = self.held_step_counts[observation.ids] > self.held_steps
        if observation.start_condition_holds is not None:
            return _JUDGE_BY_SINCE_KIND[self.plan.kind](self, observation)
        return _JUDGE_BY_KIND[self.plan.kind](self, observation)

    def is_fulfilled_at_start(self, observation: FrameObservation) -> bool:
        """Return whether a line that waits for its condition is already fulfilled in the first frame, for all agents that it
        concerns."""
        waits = (
            self.plan.kind in ("within", "eventually") and observation.start_condition_holds is None and self.held_steps is None
        )
        return waits and len(observation.ids) > 0 and bool(observation.condition_holds.all())

    def find_start_frame(self, agent: int) -> int | None:
        """Return the frame in which the expired waiting time of an agent began. Return None if the line has no `when`, or the
        agent was not waiting."""
        is_pending = self.plan.start_condition is not None and agent < len(self.pending_since_frames)
        return (
            int(self.pending_since_frames[agent]) if is_pending and self.pending_since_frames[agent] != _NO_FRAME_NUMBER else None
        )

    def _find_removed(self, observation: FrameObservation, is_waiting: BoolArray) -> AgentIds:
        """Return the ids of agents that were waiting in the previous frame and no longer exist. `is_waiting`: for each row,
        whether the agent is waiting now."""
        is_present = np.zeros(max(int(observation.ids.max(initial=-1)), int(self.waiting_ids.max(initial=-1))) + 1, np.bool_)
        is_present[observation.ids] = True
        removed_ids = self.waiting_ids[~is_present[self.waiting_ids]]
        self.waiting_ids = observation.ids[is_waiting]
        return removed_ids


def _judge_always(line: JudgementLine, observation: FrameObservation) -> AgentIds:
    """Return the ids of the agents for which the condition does not hold."""
    failing_agents: AgentIds = observation.ids[~observation.condition_holds & ~observation.is_released]
    return failing_agents


def _judge_never(line: JudgementLine, observation: FrameObservation) -> AgentIds:
    """Return the ids of the agents for which the condition holds."""
    return observation.ids[observation.condition_holds & ~observation.is_released]


def _judge_finally(line: JudgementLine, observation: FrameObservation) -> AgentIds:
    """Return the ids of the agents for which the condition does not hold in the last frame."""
    return _judge_always(line, observation) if observation.is_final else _NO_IDS


def _judge_for(line: JudgementLine, observation: FrameObservation) -> AgentIds:
    """Return the ids of agents for which the condition is false although it must still hold. It must hold for the line's
    duration, counted from the agent's first frame."""
    assert line.steps is not None
    last = observation.first_frames + line.steps
    if line.plan.species is None and (observation.frame >= last).all() and observation.condition_holds.all():
        line.is_undecided = False
    return observation.ids[~observation.condition_holds & ~observation.is_released & (observation.frame <= last)]


def _judge_eventually(line: JudgementLine, observation: FrameObservation) -> AgentIds:
    """Return the ids of the agents that fail `eventually` or `within`. `within` fails as soon as its time has elapsed."""
    line.is_fulfilled = extend_table_for_ids(line.is_fulfilled, observation.ids, False)
    line.is_fulfilled[observation.ids[observation.condition_holds | observation.is_released]] = True
    waiting = ~line.is_fulfilled[observation.ids]
    removed_ids = line._find_removed(observation, waiting)
    if len(removed_ids):
        line.failure_reason = AGENT_LEFT_REASON
        return removed_ids
    if line.plan.species is None and not waiting.any():
        line.is_undecided = False
    if line.steps is not None:
        late = observation.ids[waiting & (observation.frame >= observation.first_frames + line.steps)]
        if len(late):
            line.failure_reason = TIME_OVER_REASON
            return late
    ends = line.plan.kind == "eventually" or line.plan.species is None
    if observation.is_final and ends and waiting.any():
        line.failure_reason = RUN_OVER_REASON
        return observation.ids[waiting]
    return _NO_IDS


# --- after a `when` --------------------------------------------------------------------------------------------------


def _update_waiting_agents(line: JudgementLine, observation: FrameObservation) -> BoolArray:
    """Return whether the condition of the `when` has become true for each agent in this frame, bool[n]. Its current values are
    stored for the comparison in the next frame."""
    assert observation.start_condition_holds is not None
    line.previous_start_condition, line.pending_since_frames = (
        extend_table_for_ids(line.previous_start_condition, observation.ids, False),
        extend_table_for_ids(line.pending_since_frames, observation.ids, _NO_FRAME_NUMBER),
    )
    comes = observation.start_condition_holds & ~line.previous_start_condition[observation.ids]
    line.previous_start_condition[observation.ids] = observation.start_condition_holds
    return comes


def _judge_since_within(line: JudgementLine, observation: FrameObservation) -> AgentIds:
    """Return the ids of the agents that fail a `when` with `within` or `eventually`. If several waiting times of an agent
    overlap, only the first counts. All of them end with it."""
    comes = _update_waiting_agents(line, observation)
    pending: AgentIds = line.pending_since_frames[observation.ids]
    pending = np.where(comes & (pending == _NO_FRAME_NUMBER), observation.frame, pending)
    pending[observation.condition_holds | observation.is_released] = _NO_FRAME_NUMBER
    line.pending_since_frames[observation.ids] = pending
    waiting = pending != _NO_FRAME_NUMBER
    removed_ids = line._find_removed(observation, waiting)
    if len(removed_ids):
        line.failure_reason = AGENT_LEFT_REASON
        return removed_ids
    if line.steps is not None:
        late: AgentIds = observation.ids[waiting & (observation.frame >= pending + line.steps)]
        if len(late):
            line.failure_reason = TIME_OVER_REASON
            return late
    elif observation.is_final and waiting.any():
        line.failure_reason = RUN_OVER_REASON
        late_agents: AgentIds = observation.ids[waiting]
        return late_agents
    return _NO_IDS


def _judge_since_for(line: JudgementLine, observation: FrameObservation) -> AgentIds:
    """Return the ids of the agents that fail a `when` with `for`. If several durations of an agent overlap, only the last
    counts, because it ends last."""
    assert line.steps is not None
    comes = _update_waiting_agents(line, observation)
    line.pending_since_frames[observation.ids[comes]] = observation.frame
    under_way = observation.frame <= line.pending_since_frames[observation.ids] + line.steps
    return observation.ids[under_way & ~observation.condition_holds & ~observation.is_released]


def _find_ids_where_condition_holds(line: JudgementLine, observation: FrameObservation) -> AgentIds:
    """Return the ids of the agents for which the condition of an `until` or `sooner` holds. The caller decides whether these
    agents fail."""
    return observation.ids[observation.condition_holds]


_JUDGE_BY_KIND: Mapping[str, Callable[[JudgementLine, FrameObservation], AgentIds]] = {
    "until": _find_ids_where_condition_holds,
    "sooner": _find_ids_where_condition_holds,
    "always": _judge_always,
    "never": _judge_never,
    "finally": _judge_finally,
    "for": _judge_for,
    "eventually": _judge_eventually,
    "within": _judge_eventually,
}
_JUDGE_BY_SINCE_KIND: Mapping[str, Callable[[JudgementLine, FrameObservation], AgentIds]] = {
    "within": _judge_since_within,
    "eventually": _judge_since_within,
    "for": _judge_since_for,
}
