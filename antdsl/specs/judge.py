"""One spec over a run: it looks at the world frame by frame, stores what it needs, and reports what was not as expected."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.plan.lowering.spec_blocks import JudgementPlan, ReadingPlan, SpecPlan
from antdsl.runtime.world import World
from antdsl.specs.cases import TOLD_AGENTS, Failure
from antdsl.specs.comparison import Rival
from antdsl.specs.lines import Ids, Line, Seen, about_the_whole, in_steps
from antdsl.specs.queries import Asker, by_id
from antdsl.specs.value_text import shown, whereabouts
from antdsl.syntax.words import NUMBER

_NUMBER = re.compile(NUMBER)


class Judge:
    """`look` at each frame from the first on, until `over`. `failures`: in order of detection. `rival`: the reference run that
    the spec compares with."""

    def __init__(self, plan: SpecPlan, world: World, last: int, rival: Rival | None = None) -> None:
        self.plan, self.first, self.rival = plan, world.frame, rival
        self.asker = Asker(plan, world)
        self.last = last_frame(plan, world, last)
        self.lines = [Line(j, in_steps(world, j.time), in_steps(world, j.held)) for j in plan.judgements]
        self.failures: list[Failure] = []
        self.over = False

    def look(self, world: World) -> None:
        """Judge the world as it is at this frame."""
        if self.over:
            return
        there = self.asker.ask(world, {} if self.rival is None else self.rival.values(world.frame - self.first))
        final = world.frame >= self.last
        for line in (line for line in self.lines if line.plan.kind == "until" and line.plan.species is None):
            final = bool(len(line.look(self._seen(world, there, line, final)))) or final
        for line in self.lines:
            if line.open and line.plan.kind != "until" and (final or not line.plan.at_end):
                seen = self._seen(world, there, line, final)
                failed = self._race(line, seen) if line.plan.kind == "sooner" else line.look(seen)
                if len(failed):
                    self._failed(world, there, line, failed)
        for line in self.lines:
            if line.plan.kind == "until" and line.plan.species is not None:
                met = line.look(self._seen(world, there, line, final))
                line.fine = by_id(line.fine, there.populations[line.plan.species].ids, False)
                line.fine[met] = True
        self.over = final or not any(line.open for line in self.lines if line.plan.kind != "until")

    def _seen(self, world: World, there: World, line: Line, final: bool) -> Seen:
        plan = line.plan
        if plan.species is None:
            since = None if plan.since is None else self._holds(world, plan.since)
            return about_the_whole(world.frame, final, self.first, self._holds(world, plan.condition), since)
        judged = there.populations[plan.species]
        assert isinstance(plan.condition, str)
        asked = None if plan.since is None else judged.now[str(plan.since)].astype(np.bool_)
        holds = judged.now[plan.condition].astype(np.bool_)
        begun = np.maximum(judged.born, self.first)
        return Seen(world.frame, final, judged.ids, begun, holds, asked, self._released(line, judged.ids))

    def _holds(self, world: World, node: ir.Node | str) -> bool:
        """Evaluate a condition on the whole; NaN makes it false."""
        assert isinstance(node, ir.Node)
        return bool(self.asker.value(world, node))

    def _released(self, line: Line, ids: Ids) -> NDArray[np.bool_]:
        """Return the agents for which an `until` of the same block has held before this frame."""
        free = np.zeros(len(ids), np.bool_)
        for other in self.lines:
            if other.plan.kind == "until" and other.plan.block == line.plan.block:
                free |= by_id(other.fine, ids, False)[ids]
        return free

    def _race(self, line: Line, seen: Seen) -> Ids:
        """Judge `sooner`: the condition must hold here in an earlier frame, counted from the first, than in the other run."""
        assert self.rival is not None
        holds = bool(len(line.look(seen)))
        when = self.rival.met(line.plan)
        lost = when is not None and seen.frame - self.first >= when
        if lost:
            line.why = f"in the other run it was so after {self._seconds(when or 0)}"
            line.why += ", no later than here" if holds else ", and here not yet"
        elif not holds and seen.final:
            lost, line.why = True, "the run is over, and in the other run it was not so either"
        line.open = not holds
        return seen.ids if lost else seen.ids[:0]

    def _seconds(self, steps: int) -> str:
        return f"{steps * self.rival.dt:.6g} s" if self.rival is not None else ""

    # --- reporting ---------------------------------------------------------------------------------------------------

    def _values(self, world: World, there: World, plan: JudgementPlan, row: int | None) -> tuple[tuple[str, str], ...]:
        found: list[tuple[ReadingPlan, Any]] = []
        for reading in plan.readings:
            if reading.node is not None:
                found.append((reading, self.asker.value(world, reading.node)))
            elif row is not None and row >= 0 and reading.register is not None:
                found.append((reading, there.populations[plan.species].now[reading.register][row]))  # type: ignore[index]
        return _told(world, found, plan.span.text)

    def _failed(self, world: World, there: World, line: Line, agents: Ids) -> None:
        """Close a line and report the values of the whole, or of the failed agent with the least id."""
        line.open = False
        plan, fps = line.plan, float(world.setting.fps)
        least = int(agents.min())
        row = None
        if plan.species is not None:
            row = int(there.populations[plan.species].rows_of(np.array([least]))[0])
            if row >= 0:
                self.asker.run(there, "blend", plan.species, np.array([row]))
        values = self._values(world, there, plan, row)
        text = " ".join(plan.span.text.split())
        message = f"{text}{f' ({line.why})' if line.why else ''}"
        failure = Failure(message, plan.span, world.frame, (world.frame - self.first) / fps, values)
        if plan.species is not None:
            named = tuple(int(each) for each in np.sort(agents)[:TOLD_AGENTS])
            there_still = row is not None and row >= 0
            failure = replace(
                failure, agent=(plan.species, least), others=len(agents) - 1, agents=named, began=line.began(least),
                whereabouts=whereabouts(world, plan.species, row or 0) if there_still else (),
            )  # fmt: skip
        self.failures.append(failure)


def last_frame(plan: SpecPlan, world: World, last: int) -> int:
    """Return the last frame of a spec that begins now: that of the scene, or after the spec's `for`."""
    steps = in_steps(world, plan.duration)
    return last if steps is None else world.frame + steps


def _told(world: World, found: list[tuple[ReadingPlan, Any]], line: str) -> tuple[tuple[str, str], ...]:
    """Return texts and values. Values have all digits if different values, or a value and a number of the line, would otherwise
    look alike."""
    texts = [" ".join(reading.span.text.split()) for reading, _ in found]
    values = [shown(world, value, reading.type, reading.unit) for reading, value in found]
    written = {float(number) for number in _NUMBER.findall(line)}
    alike = len(set(values)) < len({float(value) for _, value in found})
    if alike or any(float(number) in written for text in values for number in _NUMBER.findall(text)[:1]):
        values = [shown(world, value, reading.type, reading.unit, True) for reading, value in found]
    return tuple(dict.fromkeys(zip(texts, values, strict=True)))
