"""The kinds of lines: which agents fail a line in each frame, and why.

A line about the whole is judged like one about a single agent with the id 0 that exists from the first frame on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import ceil

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.plan.lowering.spec_blocks import JudgementPlan
from antdsl.runtime.world import World
from antdsl.specs.aggregates import value_of
from antdsl.specs.queries import by_id

Ids = NDArray[np.int64]
Truths = NDArray[np.bool_]
TIME_OVER, RUN_OVER, LEFT = "the time is over", "the run is over", "it left before"
_NOBODY = np.empty(0, np.int64)
_NEVER = -(2**62)


@dataclass(slots=True, eq=False)
class Seen:
    """One frame of the agents that a line concerns: `begun` is each one's first frame, `free` marks those with an `until` that
    held before."""

    frame: int
    final: bool
    ids: Ids
    begun: Ids
    holds: Truths
    since: Truths | None
    free: Truths


def about_the_whole(frame: int, final: bool, first: int, holds: bool, since: bool | None) -> Seen:
    """One frame of a line about the whole."""
    asked = None if since is None else np.array([since])
    return Seen(frame, final, np.zeros(1, np.int64), np.full(1, first), np.array([holds]), asked, np.zeros(1, np.bool_))


def in_steps(world: World, time: ir.Node | None) -> int | None:
    """Return a duration in whole steps, rounded up. Its float32 value may lie slightly above."""
    if time is None:
        return None
    return max(1, ceil(float(value_of(world, time, {})) * float(world.setting.fps) * (1 - 1e-6)))


@dataclass(slots=True, eq=False)
class Line:
    """One judgement in progress; times in steps. Tables are by id. `fine`: the agent has fulfilled the line; `count`: frames for
    which the condition has held; `was`: where `since` held before; `pending`: the frame in which it became true."""

    plan: JudgementPlan
    steps: int | None
    held: int | None
    open: bool = True
    why: str = ""
    fine: Truths = field(default_factory=lambda: np.zeros(0, np.bool_))
    was: Truths = field(default_factory=lambda: np.zeros(0, np.bool_))
    count: Ids = field(default_factory=_NOBODY.copy)
    pending: Ids = field(default_factory=_NOBODY.copy)
    waiting: Ids = field(default_factory=_NOBODY.copy)

    def look(self, seen: Seen) -> Ids:
        """Return which agents fail in this frame. `why`: the reason in words, empty if the condition alone is the reason."""
        self.why = ""
        if self.held is not None:
            self.count = by_id(self.count, seen.ids, 0)
            self.count[seen.ids] = np.where(seen.holds, self.count[seen.ids] + 1, 0)
            seen.holds = self.count[seen.ids] > self.held
        if seen.since is not None:
            return _SINCE[self.plan.kind](self, seen)
        return _KINDS[self.plan.kind](self, seen)

    def began(self, agent: int) -> int | None:
        """Return the frame in which an agent's expired waiting time began, if the line has a `when`."""
        known = self.plan.since is not None and agent < len(self.pending)
        return int(self.pending[agent]) if known and self.pending[agent] != _NEVER else None

    def _left(self, seen: Seen, waiting: Truths) -> Ids:
        """Return the agents that waited before and no longer exist. `waiting`, by row: those that wait now."""
        there = np.zeros(max(int(seen.ids.max(initial=-1)), int(self.waiting.max(initial=-1))) + 1, np.bool_)
        there[seen.ids] = True
        gone = self.waiting[~there[self.waiting]]
        self.waiting = seen.ids[waiting]
        return gone


def _always(line: Line, seen: Seen) -> Ids:
    failed: Ids = seen.ids[~seen.holds & ~seen.free]
    return failed


def _never(line: Line, seen: Seen) -> Ids:
    return seen.ids[seen.holds & ~seen.free]


def _finally(line: Line, seen: Seen) -> Ids:
    return _always(line, seen) if seen.final else _NOBODY


def _for(line: Line, seen: Seen) -> Ids:
    assert line.steps is not None
    last = seen.begun + line.steps
    if line.plan.species is None and (seen.frame >= last).all() and seen.holds.all():
        line.open = False
    return seen.ids[~seen.holds & ~seen.free & (seen.frame <= last)]


def _eventually(line: Line, seen: Seen) -> Ids:
    """Return the failed ids of `eventually`, and of `within`, which also fails when its time is over."""
    line.fine = by_id(line.fine, seen.ids, False)
    line.fine[seen.ids[seen.holds | seen.free]] = True
    waiting = ~line.fine[seen.ids]
    gone = line._left(seen, waiting)
    if len(gone):
        line.why = LEFT
        return gone
    if line.plan.species is None and not waiting.any():
        line.open = False
    if line.steps is not None:
        late = seen.ids[waiting & (seen.frame >= seen.begun + line.steps)]
        if len(late):
            line.why = TIME_OVER
            return late
    ends = line.plan.kind == "eventually" or line.plan.species is None
    if seen.final and ends and waiting.any():
        line.why = RUN_OVER
        return seen.ids[waiting]
    return _NOBODY


# --- after a `when` --------------------------------------------------------------------------------------------------


def _comes(line: Line, seen: Seen) -> Truths:
    """Return where `since` holds now and did not in the frame before."""
    assert seen.since is not None
    line.was, line.pending = by_id(line.was, seen.ids, False), by_id(line.pending, seen.ids, _NEVER)
    comes = seen.since & ~line.was[seen.ids]
    line.was[seen.ids] = seen.since
    return comes


def _since_within(line: Line, seen: Seen) -> Ids:
    """Also `eventually`. Of several overlapping times, the first one counts: what ends it ends the others."""
    comes = _comes(line, seen)
    pending: Ids = line.pending[seen.ids]
    pending = np.where(comes & (pending == _NEVER), seen.frame, pending)
    pending[seen.holds | seen.free] = _NEVER
    line.pending[seen.ids] = pending
    waiting = pending != _NEVER
    gone = line._left(seen, waiting)
    if len(gone):
        line.why = LEFT
        return gone
    if line.steps is not None:
        late: Ids = seen.ids[waiting & (seen.frame >= pending + line.steps)]
        if len(late):
            line.why = TIME_OVER
            return late
    elif seen.final and waiting.any():
        line.why = RUN_OVER
        still: Ids = seen.ids[waiting]
        return still
    return _NOBODY


def _since_for(line: Line, seen: Seen) -> Ids:
    """Of several overlapping times, the last one counts: it ends after the others."""
    assert line.steps is not None
    comes = _comes(line, seen)
    line.pending[seen.ids[comes]] = seen.frame
    under_way = seen.frame <= line.pending[seen.ids] + line.steps
    return seen.ids[under_way & ~seen.holds & ~seen.free]


def _met(line: Line, seen: Seen) -> Ids:
    """Return the ids for which `until` or `sooner` holds; these alone fail no agent."""
    return seen.ids[seen.holds]


_KINDS: Mapping[str, Callable[[Line, Seen], Ids]] = {
    "until": _met,
    "sooner": _met,
    "always": _always,
    "never": _never,
    "finally": _finally,
    "for": _for,
    "eventually": _eventually,
    "within": _eventually,
}
_SINCE: Mapping[str, Callable[[Line, Seen], Ids]] = {"within": _since_within, "eventually": _since_within, "for": _since_for}
