"""The kinds of lines: which agents fail a line in each frame, and why.

A line about aggregates is judged like one about a single agent with the id 0 that exists from the first frame on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import ceil

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.plan.lowering.spec_blocks import JudgementPlan
from antdsl.runtime.world import World
from antdsl.specs.aggregates import evaluate_uniform
from antdsl.specs.queries import extend_table

Ids = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
TIME_OVER_REASON, RUN_OVER_REASON, LEFT_REASON = "the time is over", "the run is over", "it left before"
_NO_IDS = np.empty(0, np.int64)
_NEVER_FRAME = -(2**62)


@dataclass(slots=True, eq=False)
class FrameObservation:
    """One frame of the agents that a line concerns: `first_frames` is each one's first frame, `free` marks those with an `until`
    that held before."""

    frame: int
    final: bool
    ids: Ids
    first_frames: Ids
    holds: BoolArray
    since: BoolArray | None
    free: BoolArray


def observe_whole(frame: int, final: bool, first: int, holds: bool, since: bool | None) -> FrameObservation:
    """Return one frame of a line about aggregates."""
    since_flags = None if since is None else np.array([since])
    return FrameObservation(
        frame, final, np.zeros(1, np.int64), np.full(1, first), np.array([holds]), since_flags, np.zeros(1, np.bool_)
    )


def duration_in_steps(world: World, time: ir.PlanNode | None) -> int | None:
    """Return a duration in whole steps, rounded up. Its float32 value may lie slightly above."""
    if time is None:
        return None
    return max(1, ceil(float(evaluate_uniform(world, time, {})) * float(world.setting.fps) * (1 - 1e-6)))


@dataclass(slots=True, eq=False)
class JudgementLine:
    """One judgement in progress; times in steps. Tables are by id. `fine`: the agent has fulfilled the line; `count`: frames for
    which the condition has held; `was`: where `since` held before; `pending`: the frame in which it became true."""

    plan: JudgementPlan
    steps: int | None
    held: int | None
    open: bool = True
    why: str = ""
    fine: BoolArray = field(default_factory=lambda: np.zeros(0, np.bool_))
    was: BoolArray = field(default_factory=lambda: np.zeros(0, np.bool_))
    count: Ids = field(default_factory=_NO_IDS.copy)
    pending: Ids = field(default_factory=_NO_IDS.copy)
    waiting: Ids = field(default_factory=_NO_IDS.copy)

    def look(self, observation: FrameObservation) -> Ids:
        """Return which agents fail in this frame. `why`: the reason in words, empty if the condition alone is the reason."""
        self.why = ""
        if self.held is not None:
            self.count = extend_table(self.count, observation.ids, 0)
            self.count[observation.ids] = np.where(observation.holds, self.count[observation.ids] + 1, 0)
            observation.holds = self.count[observation.ids] > self.held
        if observation.since is not None:
            return _JUDGE_BY_SINCE_KIND[self.plan.kind](self, observation)
        return _JUDGE_BY_KIND[self.plan.kind](self, observation)

    def start_frame(self, agent: int) -> int | None:
        """Return the frame in which an agent's expired waiting time began, if the line has a `when`."""
        known = self.plan.since is not None and agent < len(self.pending)
        return int(self.pending[agent]) if known and self.pending[agent] != _NEVER_FRAME else None

    def _find_removed(self, observation: FrameObservation, waiting: BoolArray) -> Ids:
        """Return the agents that waited before and no longer exist. `waiting`: by row, whether the agent waits now."""
        is_present = np.zeros(max(int(observation.ids.max(initial=-1)), int(self.waiting.max(initial=-1))) + 1, np.bool_)
        is_present[observation.ids] = True
        removed_ids = self.waiting[~is_present[self.waiting]]
        self.waiting = observation.ids[waiting]
        return removed_ids


def _always(line: JudgementLine, observation: FrameObservation) -> Ids:
    """Return the agents for which the condition does not hold."""
    failed: Ids = observation.ids[~observation.holds & ~observation.free]
    return failed


def _never(line: JudgementLine, observation: FrameObservation) -> Ids:
    """Return the agents for which the condition holds."""
    return observation.ids[observation.holds & ~observation.free]


def _finally(line: JudgementLine, observation: FrameObservation) -> Ids:
    """Return the agents for which the condition does not hold in the last frame."""
    return _always(line, observation) if observation.final else _NO_IDS


def _for(line: JudgementLine, observation: FrameObservation) -> Ids:
    """Return the agents for which the condition does not hold within the duration from their first frame."""
    assert line.steps is not None
    last = observation.first_frames + line.steps
    if line.plan.species is None and (observation.frame >= last).all() and observation.holds.all():
        line.open = False
    return observation.ids[~observation.holds & ~observation.free & (observation.frame <= last)]


def _eventually(line: JudgementLine, observation: FrameObservation) -> Ids:
    """Return the ids that fail `eventually` or `within`. A `within` also fails when its time is over."""
    line.fine = extend_table(line.fine, observation.ids, False)
    line.fine[observation.ids[observation.holds | observation.free]] = True
    waiting = ~line.fine[observation.ids]
    removed_ids = line._find_removed(observation, waiting)
    if len(removed_ids):
        line.why = LEFT_REASON
        return removed_ids
    if line.plan.species is None and not waiting.any():
        line.open = False
    if line.steps is not None:
        late = observation.ids[waiting & (observation.frame >= observation.first_frames + line.steps)]
        if len(late):
            line.why = TIME_OVER_REASON
            return late
    ends = line.plan.kind == "eventually" or line.plan.species is None
    if observation.final and ends and waiting.any():
        line.why = RUN_OVER_REASON
        return observation.ids[waiting]
    return _NO_IDS


# --- after a `when` --------------------------------------------------------------------------------------------------


def _has_begun(line: JudgementLine, observation: FrameObservation) -> BoolArray:
    """Return for which agents `since` holds now but not in the previous frame, bool [agents]. Store its values for the next
    frame."""
    assert observation.since is not None
    line.was, line.pending = (
        extend_table(line.was, observation.ids, False),
        extend_table(line.pending, observation.ids, _NEVER_FRAME),
    )
    comes = observation.since & ~line.was[observation.ids]
    line.was[observation.ids] = observation.since
    return comes


def _since_within(line: JudgementLine, observation: FrameObservation) -> Ids:
    """Judge `since` with `within` or `eventually`. If several waiting times overlap, the first one counts: when it ends, the
    others end."""
    comes = _has_begun(line, observation)
    pending: Ids = line.pending[observation.ids]
    pending = np.where(comes & (pending == _NEVER_FRAME), observation.frame, pending)
    pending[observation.holds | observation.free] = _NEVER_FRAME
    line.pending[observation.ids] = pending
    waiting = pending != _NEVER_FRAME
    removed_ids = line._find_removed(observation, waiting)
    if len(removed_ids):
        line.why = LEFT_REASON
        return removed_ids
    if line.steps is not None:
        late: Ids = observation.ids[waiting & (observation.frame >= pending + line.steps)]
        if len(late):
            line.why = TIME_OVER_REASON
            return late
    elif observation.final and waiting.any():
        line.why = RUN_OVER_REASON
        still: Ids = observation.ids[waiting]
        return still
    return _NO_IDS


def _since_for(line: JudgementLine, observation: FrameObservation) -> Ids:
    """Judge `since` with `for`. If several times overlap, the last one counts, because it ends after the others."""
    assert line.steps is not None
    comes = _has_begun(line, observation)
    line.pending[observation.ids[comes]] = observation.frame
    under_way = observation.frame <= line.pending[observation.ids] + line.steps
    return observation.ids[under_way & ~observation.holds & ~observation.free]


def _find_holding(line: JudgementLine, observation: FrameObservation) -> Ids:
    """Return the ids for which `until` or `sooner` holds. The caller decides whether an agent fails."""
    return observation.ids[observation.holds]


_JUDGE_BY_KIND: Mapping[str, Callable[[JudgementLine, FrameObservation], Ids]] = {
    "until": _find_holding,
    "sooner": _find_holding,
    "always": _always,
    "never": _never,
    "finally": _finally,
    "for": _for,
    "eventually": _eventually,
    "within": _eventually,
}
_JUDGE_BY_SINCE_KIND: Mapping[str, Callable[[JudgementLine, FrameObservation], Ids]] = {
    "within": _since_within,
    "eventually": _since_within,
    "for": _since_for,
}
