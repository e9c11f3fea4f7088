"""Runs a plan's blocks as machine code; what has none is called between the stages."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.runtime.backends import numpy_calls
from antdsl.runtime.backends.compile import (
    EFFECTS,
    LAZY,
    NEARBY,
    PAIRS,
    POPULATION,
    WORLD,
    BlockCompiler,
    Does,
    Instruction,
    Run,
    Scope,
)
from antdsl.runtime.backends.native import machine
from antdsl.runtime.backends.native.block import BlockCode
from antdsl.runtime.backends.native.grids import Arrays, Grids
from antdsl.runtime.backends.native.lanes import WIDTH
from antdsl.runtime.backends.native.programs import Program, program
from antdsl.runtime.backends.native.tables import Rooms, Tables
from antdsl.runtime.backends.numpy_backend import NumpyBackend
from antdsl.runtime.backends.reference import Agent
from antdsl.runtime.moving import moving_geometry
from antdsl.runtime.pairs import NearbySets
from antdsl.runtime.requests import Effects, FaultEntry, GiveEntry
from antdsl.runtime.sensing import SENSES
from antdsl.runtime.world import Population, World

_SAMPLED = 8  # agents whose radius is worked out before the first search, to choose cells by


class NativeBackend(NumpyBackend):
    """Compiled for a plan and the world it is bound to."""

    spare = WIDTH

    def __init__(self, plan: ir.Plan) -> None:
        super().__init__(plan)
        self.program: Program | None = None
        self._code: machine.Code | None = None
        self._tables: dict[tuple[str, str, int], Tables] = {}
        self._rooms = Rooms()
        self._versions: dict[str, int] = {}
        self._widest: dict[tuple[str, str, int], float] = {}
        self._calls: dict[Instruction, Run] = {}
        self._together: dict[tuple[str, str, int], list[list[Instruction]]] = {}

    def begin(self, world: World) -> None:
        """Values of the step, and nothing sensed yet."""
        if self.program is None:
            self.program = program(
                world.plan,
                self._blocks,
                moving=moving_geometry.moving(world) is not None,
                detail=world.detail is not None,
                avx2=machine.host().avx2,
            )
            self._code = machine.load(machine.object_code(self.program.text, machine.host()))
            self._grids = Grids(self._code.function)
            for key, code in self.program.blocks.items():
                for stage, calls in enumerate(code.schedule.calls):
                    self._together[(*key, stage)] = _groups(calls, code)
                for each in (*code.requests, *(each for group in code.schedule.calls for each in group)):
                    self._calls[each] = numpy_calls.call(each, self._blocks[key])(each.out, each.inputs, None)
        versions = {name: population.version for name, population in world.populations.items()}
        if versions != self._versions:
            self._versions = versions
            self._rooms.forget()
        self._grids.forget()
        super().begin(world)

    def run(self, world: World, population: Population, block: str, rows: NDArray[np.intp] | None = None) -> None:
        """Run a block for some rows (None: all), and put what they ask for into the population's effects."""
        code = None if self.program is None else self.program.blocks.get((population.name, block))
        if rows is not None or code is None or self._code is None:
            super().run(world, population, block, rows)
            return
        self._native(world, population, block, code)

    def _native(self, world: World, population: Population, block: str, code: BlockCode) -> None:
        compiler = self._blocks[population.name, block]
        size = -(-max(WIDTH, world.options.chunk) // WIDTH) * WIDTH
        n = len(population)
        chunks = [(a, min(a + size, n)) for a in range(0, n, size)]
        tables = self._tables.setdefault((population.name, block, 0), Tables(code, self._rooms))
        grids = [self._grid(world, population, block, code, compiler, k, tables) for k in range(len(code.near))]
        tables.fill(world, population, self._values[population.name], self._kept.get(population.name), grids)
        tables.room(min(size, n))
        with np.errstate(all="ignore"):
            for begin, end in chunks:
                self._go(world, population, compiler, code, tables, begin, end)
        for k, widest in enumerate(tables.widest):
            self._widest[population.name, block, k] = float(widest.max()) or self._widest[population.name, block, k]
            widest[:] = 0

    def _grid(
        self,
        world: World,
        population: Population,
        block: str,
        code: BlockCode,
        compiler: BlockCompiler,
        number: int,
        tables: Tables,
    ) -> Arrays:
        """Cells for a search: they suit the greatest radius of the step before, or of some agents."""
        near = code.near[number]
        widest = self._widest.get((population.name, block, number))
        if widest is None:
            found = [0.0]
            rows = np.linspace(0, len(population) - 1, min(_SAMPLED, len(population))).astype(int)
            for row in rows:
                agent = Agent(world, population, int(row), population.now, int(row), Effects(), {})
                found += [float(agent.value(chosen.args[0])) for chosen in near.sets]
            widest = max((each for each in found if np.isfinite(each)), default=0.0)
        self._widest[population.name, block, number] = widest
        return self._grids.of(world, world.populations[near.species], widest if widest > 0 else 1.0)

    def _go(
        self,
        world: World,
        population: Population,
        compiler: BlockCompiler,
        code: BlockCode,
        tables: Tables,
        begin: int,
        end: int,
    ) -> None:
        assert self._code is not None
        effects = population.effects
        tables.notes[0] = tables.crowded[0] = 0
        picked: dict[int, NDArray[np.intp]] = {}
        v: list[Any] | None = None
        for stage, name in enumerate(code.names):
            self._code.function(name)(tables.address, begin, end)
            if code.schedule.calls[stage]:
                v = v or self._slots(world, population, compiler, effects)
                v[compiler.root.rows] = slice(begin, end)
                for some in self._together[population.name, compiler.name, stage]:
                    self._call(v, code, tables, some, picked, begin, end)
        if tables.crowded[0]:
            super().run(world, population, compiler.name, np.arange(begin, end))  # which stops and says where
        for each in code.requests:
            v = v or self._slots(world, population, compiler, effects)
            self._ask(v, code, tables, each, picked, begin, end)
        for instruction, slot in code.gives:
            there, item, gone = (tables.arrays[slot, part] for part in range(3))
            rows = np.flatnonzero(there[: end - begin])
            if len(rows):
                what = instruction.what
                assert isinstance(what, ir.Give)
                effects.gives.append(GiveEntry(what, item[rows], gone[rows]))
        for k in range(int(tables.notes[0])):
            row, told = int(tables.notes[1 + 2 * k]), int(tables.notes[2 + 2 * k])
            refused, span = code.faults[told >> 16]
            rows = row + np.flatnonzero([told >> bit & 1 for bit in range(WIDTH)])
            effects.faults.append(FaultEntry(compiler.name, refused, span, rows))

    def _slots(self, world: World, population: Population, compiler: BlockCompiler, effects: Effects) -> list[Any]:
        v: list[Any] = [None] * compiler.slots
        v[WORLD], v[POPULATION], v[EFFECTS], v[LAZY] = world, population, effects, self._kept.get(population.name)
        v[PAIRS], v[NEARBY] = {}, NearbySets(1)
        values = self._values[population.name]
        for node, slot in compiler.uniforms.items():
            v[slot] = values[node]
        return v

    def _enter(
        self,
        v: list[Any],
        code: BlockCode,
        tables: Tables,
        scope: Scope,
        picked: dict[int, NDArray[np.intp]],
        begin: int,
        end: int,
    ) -> NDArray[np.intp]:
        """The rows of a scope, counted within the chunk."""
        slot = code.schedule.slot(scope.rows)
        if slot not in picked:
            picked[slot] = np.flatnonzero(tables.arrays[slot, 0][: end - begin])
        found = picked[slot]
        v[scope.rows], v[scope.size] = (slice(begin, end) if len(found) == end - begin else found + begin), len(found)
        return found

    def _inputs(self, v: list[Any], code: BlockCode, tables: Tables, each: Instruction, chosen: NDArray[np.intp]) -> None:
        for slot in each.inputs:
            source = code.schedule.slot(slot)
            if (source, 0) in tables.arrays:
                v[slot] = tables.arrays[source, 0].take(chosen)
            elif source != slot and v[source] is not None:
                v[slot] = v[source]

    def _call(
        self,
        v: list[Any],
        code: BlockCode,
        tables: Tables,
        some: list[Instruction],
        picked: dict[int, NDArray[np.intp]],
        begin: int,
        end: int,
    ) -> None:
        """Make a call, or several of one sense with one name at once: who asks is named as often as it asks."""
        if len(some) > 1 or some[0] in code.guarded:
            self._calls_at_once(v, code, tables, some, begin, end)
            return
        (each,) = some
        chosen = self._enter(v, code, tables, each.scope, picked, begin, end)
        if not len(chosen):
            return
        self._inputs(v, code, tables, each, chosen)
        self._calls[each](v)
        self._put(tables, each, chosen, v[each.out])

    def _calls_at_once(
        self, v: list[Any], code: BlockCode, tables: Tables, some: list[Instruction], begin: int, end: int
    ) -> None:
        chosen = [
            np.flatnonzero(tables.arrays[code.guarded.get(each, code.schedule.slot(each.scope.rows)), 0][: end - begin])
            for each in some
        ]
        ends = np.cumsum([len(rows) for rows in chosen])
        if not ends[-1]:
            return
        columns = []
        for place in range(len(some[0].inputs)):
            parts = []
            for each, rows in zip(some, chosen, strict=True):
                source = code.schedule.slot(each.inputs[place])
                array = tables.arrays.get((source, 0))
                parts.append(np.full(len(rows), v[each.inputs[place]]) if array is None else array.take(rows))
            columns.append(np.concatenate(parts))
        node = some[0].what
        assert isinstance(node, ir.Node)
        found = SENSES[node.op](v[WORLD], v[POPULATION], node, np.concatenate(chosen) + begin, *columns)
        parts_of = [np.split(part, ends[:-1]) for part in (found if isinstance(found, tuple) else (found,))]
        for k, (each, rows) in enumerate(zip(some, chosen, strict=True)):
            self._put(tables, each, rows, tuple(part[k] for part in parts_of))

    @staticmethod
    def _put(tables: Tables, each: Instruction, chosen: NDArray[np.intp], found: Any) -> None:
        """Leave the results of a call where the next stage looks for them."""
        for part, value in enumerate(found if isinstance(found, tuple) else (found,)):
            if (each.out, part) in tables.arrays:
                tables.arrays[each.out, part][chosen] = value

    def _ask(
        self,
        v: list[Any],
        code: BlockCode,
        tables: Tables,
        each: Instruction,
        picked: dict[int, NDArray[np.intp]],
        begin: int,
        end: int,
    ) -> None:
        chosen = self._enter(v, code, tables, each.scope, picked, begin, end)
        if len(chosen):
            self._inputs(v, code, tables, each, chosen)
            self._calls[each](v)


def _groups(calls: list[Instruction], code: BlockCode) -> list[list[Instruction]]:
    """Calls in their order; those that can be guarded or are of one sense and name are made at once."""
    found: list[list[Instruction]] = []
    known: dict[Any, list[Instruction]] = {}
    for each in calls:
        if each.does is not Does.VALUE or not isinstance(each.what, ir.Node) or each.what.op not in SENSES:
            found.append([each])
            continue
        key = (each.what.op, each.what.attrs)
        if key not in known:
            known[key] = []
            found.append(known[key])
        known[key].append(each)
    return found
