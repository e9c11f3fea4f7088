"""One spec over a run: looks at the world frame by frame, remembers what has to be remembered, says what was not as expected.

The agents are asked by the run's own backend, in a copy of the world whose registers are the spec's; nothing of the run changes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field
from math import ceil, radians
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.plan.judging import JudgementPlan, ReadingPlan, SpecPlan
from antdsl.plan.walk import needed, operands, statements
from antdsl.program.expected import MOTION
from antdsl.runtime.backends import BACKENDS
from antdsl.runtime.births import find_cells
from antdsl.runtime.effects import Effects
from antdsl.runtime.world import AXES, DTYPES, Items, Population, World
from antdsl.specs.cases import Failure
from antdsl.specs.values import shown
from antdsl.specs.wholes import value_of, whole

Ids = NDArray[np.int64]
_NOBODY = np.empty(0, np.int64)
_UNKNOWN = 1e300  # what no float32 can be: of agents that were not there yet
_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@dataclass(slots=True, eq=False)
class _Line:
    """One judgement under way. `fine`, by id: agents that have shown what they must; `waiting`: ids of those that have not."""

    plan: JudgementPlan
    steps: int | None  # for `within`
    open: bool = True
    fine: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))
    waiting: Ids = field(default_factory=_NOBODY.copy)


class Judge:
    """`look` at each frame from the first on, until `over`; then `end`. `failures` in the order in which they were seen."""

    def __init__(self, plan: SpecPlan, world: World, last: int) -> None:
        self.plan, self.first = plan, world.frame
        self.backend: Any = BACKENDS[world.options.backend](plan.plan)
        fps = float(world.setting.fps)
        if plan.duration is not None:
            last = self.first + _steps(float(value_of(world, plan.duration, {})), fps)
        self.last = last
        self.lines = [
            _Line(j, None if j.time is None else _steps(float(value_of(world, j.time, {})), fps)) for j in plan.judgements
        ]
        self.told: dict[str, Any] = {}
        self.names = [w.name for w in plan.wholes] + [s.name for s in plan.starts] + [f"motion.{name}" for name in MOTION]
        self.starts: dict[str, NDArray[np.float64]] = {}  # by id
        self.failures: list[Failure] = []
        self.over = False
        self.smelling = {name for name, species in plan.plan.species.items() if _smells(species)}

    # --- a frame -----------------------------------------------------------------------------------------------------

    def look(self, world: World) -> None:
        """Judge the world as it is at this frame."""
        if self.over:
            return
        self._measure(world)
        there = self._asked(world)
        until = [line for line in self.lines if line.plan.kind == "until" and line.plan.species is None]
        final = world.frame >= self.last or any(self._holds(world, line) for line in until)
        for line in self.lines:
            if line.open and line.plan.kind != "until" and (final or not line.plan.at_end):
                self._whole(world, there, line) if line.plan.species is None else self._each(world, there, line)
        for line in self.lines:
            if line.plan.kind == "until" and line.plan.species is not None:
                judged = there.populations[line.plan.species]
                line.fine = _by_id(line.fine, judged, False)
                line.fine[judged.ids[_answer(judged, line)]] = True
        if final:
            self._end(world, there)
        self.over = final or not any(line.open for line in self.lines if line.plan.kind != "until")

    def _measure(self, world: World) -> None:
        for name, number in world.motion.summary().items():
            unknown = world.motion.ways == 0 and name in ("circling", "straightness")
            turned = radians(number) if name == "turn_p99" else number
            self.told[f"motion.{name}"] = np.float32(np.nan if unknown else turned)

    def _asked(self, world: World) -> World:
        """A copy of the world in which every agent and item has answered."""
        for items in world.items.values():
            items.show()
        there = copy(world)
        there.plan, there.backend, there.grids, there.clearances = self.plan.plan, self.backend, {}, {}
        there.populations = {
            name: self._items(world.items[name]) if name in world.items else self._agents(there, world.populations[name])
            for name in self.plan.plan.species
        }
        there.told = dict.fromkeys(self.names, np.float32(0))  # nobody has been asked yet
        self.backend.begin(there)
        self._run(there, "decide")
        for each in self.plan.wholes:
            self.told[each.name] = whole(world, there.populations, each)
        for start in self.plan.starts:
            if start.value is not None:
                if start.name not in self.told:
                    self.told[start.name] = value_of(world, start.value, self.told)
            elif start.species is not None and start.asked is not None:
                self._remember(there.populations[start.species], start.name, start.asked)
        there.told = {name: np.float32(number) for name, number in self.told.items()}
        self.backend.begin(there)
        self._run(there, "act")
        return there

    def _run(self, there: World, block: str, species: str | None = None, rows: Any = None) -> None:
        for name, population in there.populations.items():
            if len(population) and getattr(population.plan, block).statements and species in (None, name):
                self.backend.run(there, population, block, rows)

    def _agents(self, there: World, population: Population) -> Population:
        """A population with the same agents and registers for answers."""
        found = copy(population)
        found.plan, found.effects, found.cells = self.plan.plan.species[population.name], Effects(), {}
        count = len(population)
        registers = found.plan.registers
        found.now = _answers(registers, population.start, count)
        found.start = {**population.start, **found.now}
        if population.name in self.smelling:
            find_cells(there, found)
        return found

    def _items(self, items: Items) -> Population:
        """Items as if they were agents of a species of their own."""
        plan, count = self.plan.plan.species[items.name], len(items)
        start = {f"position.{axis}": items.seen[axis] for axis in AXES}
        start |= {name: items.seen[name] for name in ("radius", *items.amounts)}
        nobody = np.zeros(count, np.bool_)
        now = _answers(plan.registers, start, count)
        return Population(plan, np.arange(count), np.zeros(count, np.int64), nobody, start, now, items.position, None, {}, {})

    def _remember(self, judged: Population, name: str, asked: str) -> None:
        """What a number was in each agent's first frame, into the register that the conditions read."""
        ids, now = judged.ids, judged.now[asked]
        values = self.starts[name] = _by_id(self.starts.get(name, np.zeros(0)), judged, _UNKNOWN)
        values[ids] = np.where(values[ids] == _UNKNOWN, now, values[ids])
        judged.start[name] = values[ids].astype(np.float32)

    # --- lines -------------------------------------------------------------------------------------------------------

    def _holds(self, world: World, line: _Line) -> bool:
        """A condition on the whole; what is no number makes it false."""
        assert isinstance(line.plan.condition, ir.Node)
        return bool(value_of(world, line.plan.condition, self.told))

    def _whole(self, world: World, there: World, line: _Line) -> None:
        kind = line.plan.kind
        holds = self._holds(world, line)
        if kind in ("always", "never"):
            if holds is (kind == "never"):
                self._failed(world, there, line, None, "")
        elif holds:
            line.open = False
        elif line.steps is not None and world.frame >= self.first + line.steps:
            self._failed(world, there, line, None, "the time is over")

    def _each(self, world: World, there: World, line: _Line) -> None:
        kind, name = line.plan.kind, line.plan.species
        judged = there.populations[name]  # type: ignore[index]
        holds = _answer(judged, line)
        free = self._released(line, judged)
        if kind in ("always", "never"):
            wrong = judged.ids[(holds == (kind == "never")) & ~free]
            if len(wrong):
                self._failed(world, there, line, wrong, "")
            return
        line.fine = _by_id(line.fine, judged, False)
        line.fine[judged.ids[holds | free]] = True
        there_now = np.zeros(len(line.fine), np.bool_)
        there_now[judged.ids] = True
        gone = line.waiting[~there_now[line.waiting]]
        rows = np.flatnonzero(~line.fine[judged.ids])
        line.waiting = judged.ids[rows]
        if len(gone):
            self._failed(world, there, line, gone, "it left before")
        elif line.steps is not None:
            begun = np.maximum(judged.born[rows], self.first)
            late = line.waiting[world.frame >= begun + line.steps]
            if len(late):
                self._failed(world, there, line, late, "the time is over")

    def _released(self, line: _Line, judged: Population) -> NDArray[np.bool_]:
        """The agents for which an `until` of the same block has held before this frame."""
        free = np.zeros(len(judged), np.bool_)
        for other in self.lines:
            if other.plan.kind == "until" and other.plan.block == line.plan.block:
                free |= _by_id(other.fine, judged, False)[judged.ids]
        return free

    def _end(self, world: World, there: World) -> None:
        """The run is over: what should have come and has not, has failed."""
        for line in self.lines:
            if not line.open or line.plan.kind not in ("eventually", "within"):
                continue
            if line.plan.species is None:
                self._failed(world, there, line, None, "the run is over")
            elif line.plan.kind == "eventually" and len(line.waiting):
                self._failed(world, there, line, line.waiting, "the run is over")

    def _values(self, world: World, there: World, plan: JudgementPlan, row: int | None) -> tuple[tuple[str, str], ...]:
        found: list[tuple[ReadingPlan, Any]] = []
        for reading in plan.readings:
            if reading.node is not None:
                found.append((reading, value_of(world, reading.node, self.told)))
            elif row is not None and row >= 0 and reading.register is not None:
                found.append((reading, there.populations[plan.species].now[reading.register][row]))  # type: ignore[index]
        return _told(world, found, plan.span.text)

    def _failed(self, world: World, there: World, line: _Line, agents: Ids | None, why: str) -> None:
        """Close a line, and tell the values of the whole, or of the agent with the least id of those that it is about."""
        line.open = False
        plan = line.plan
        agent = None if agents is None else int(agents.min())
        row = None if agent is None else int(there.populations[plan.species].rows_of(np.array([agent]))[0])  # type: ignore[index]
        if row is not None and row >= 0:
            self._run(there, "blend", plan.species, np.array([row]))
        values = self._values(world, there, plan, row)
        text = " ".join(plan.span.text.split())
        whose = None if agent is None or plan.species is None else (plan.species, agent)
        others = 0 if agents is None else len(agents) - 1
        time = (world.frame - self.first) / float(world.setting.fps)
        self.failures.append(Failure(f"{text}{f' ({why})' if why else ''}", plan.span, world.frame, time, values, whose, others))


def _by_id(table: NDArray[Any], judged: Population, unknown: Any) -> NDArray[Any]:
    """The table, long enough for every id that there is; ids are counted from 0."""
    more = int(judged.ids.max(initial=-1)) + 1 - len(table)
    return table if more <= 0 else np.concatenate([table, np.full(max(more, len(table)), unknown, table.dtype)])


def _answer(judged: Population, line: _Line) -> NDArray[np.bool_]:
    """Whether the line's condition holds, for each agent."""
    assert isinstance(line.plan.condition, str)
    return judged.now[line.plan.condition]


def _told(world: World, found: list[tuple[ReadingPlan, Any]], line: str) -> tuple[tuple[str, str], ...]:
    """Texts and values; to the last place where different values, or a value and a number of the line, would look alike."""
    texts = [" ".join(reading.span.text.split()) for reading, _ in found]
    values = [shown(world, value, reading.type, reading.unit) for reading, value in found]
    written = {float(number) for number in _NUMBER.findall(line)}
    alike = len(set(values)) < len({float(value) for _, value in found})
    if alike or any(float(number) in written for text in values for number in _NUMBER.findall(text)[:1]):
        values = [shown(world, value, reading.type, reading.unit, True) for reading, value in found]
    return tuple(dict.fromkeys(zip(texts, values, strict=True)))


def _answers(registers: Mapping[str, ir.Register], known: Mapping[str, Any], count: int) -> dict[str, NDArray[Any]]:
    """Arrays for what the blocks will store; a number that is none stays so."""
    own = [register for register in registers.values() if register.name not in known]
    return {r.name: np.full(count, np.nan if r.kind is ir.Kind.F32 else 0, DTYPES[r.kind]) for r in own}


def _smells(species: ir.SpeciesPlan) -> bool:
    """Whether a block asks for the agent's own cell of a field."""
    asked = (node for block in (species.decide, species.act, species.blend) for _, s in statements(block) for node in operands(s))
    return any(node.op.startswith("field.") for node in needed(asked))


def _steps(seconds: float, fps: float) -> int:
    """A duration in whole steps, rounded up; the float32 it came as may lie a little above."""
    return max(1, ceil(seconds * fps * (1 - 1e-6)))
