"""Runs a plan's blocks as machine code. NumPy runs blocks until their code is ready, and if no code can be made. The results have
the same bits."""

from __future__ import annotations

from concurrent.futures import Future, wait

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code import codes, machine
from antdsl.machine_code.kinds import LANE_COUNT
from antdsl.plan import ir
from antdsl.plan.traverse import required_nodes
from antdsl.runtime.backends.native import listing
from antdsl.runtime.backends.native.block import NeighbourSearch
from antdsl.runtime.backends.native.programs import WorldFacts, program
from antdsl.runtime.backends.native.ready import CodeUnavailable, ReadyCode, find, find_ready, start_building
from antdsl.runtime.backends.native.rooms import PaddedArrays
from antdsl.runtime.backends.native.runner import BlockRunner
from antdsl.runtime.backends.native.search.grids import Arrays, SearchGrids
from antdsl.runtime.backends.numpy_backend import NumpyBackend
from antdsl.runtime.backends.reference import AgentRun
from antdsl.runtime.requests import EffectRequests
from antdsl.runtime.world import AXES, Population, World

_MIN_AGENTS_FOR_CODE = 2_000  # with as many agents, loading code pays off after a few steps
_MIN_STEP_SECONDS = 0.2  # CPU seconds of earlier steps from which compilation pays off
_MAX_LOAD_SECONDS = 1.0  # maximum wait for stored code
_SAMPLED_RADII = 8  # agents of which radii are computed to choose the first cell size
_DEFAULT_AGENTS_PER_CELL = 8  # agents per cell if no radius is known


class NativeBackend(NumpyBackend):
    """Runs a plan in one world. A thread compiles the code from the first step on."""

    spare = LANE_COUNT

    def __init__(self, plan: ir.Plan) -> None:
        super().__init__(plan)
        self._plan = plan
        self._coming: Future[ReadyCode] | None = None
        self._without: str | None = None  # the reason if machine code cannot be made
        self._begun = False
        self._sought: set[WorldFacts] = set()  # facts for which stored code was searched
        self.ready: ReadyCode | None = None
        self._running: dict[tuple[str, str], BlockRunner] = {}
        self._timed = False  # whether the active code is timed by line
        # the inactive code: timed code while untimed code is active, and the reverse
        self._aside: tuple[ReadyCode | None, Future[ReadyCode] | None, dict[tuple[str, str], BlockRunner]] = (None, None, {})
        self._rooms = PaddedArrays()
        self._versions: list[int] = []
        self._widest: dict[tuple[str, str, int], float] = {}
        self._grids = SearchGrids()

    @property
    def by(self) -> str:
        return super().by if self.ready is None else "machine code"

    def measure(self, on: bool) -> None:
        """Time program lines from the next step on, or stop timing. Timing needs separate code; NumPy runs until that code is
        ready."""
        if on != self._timed:
            self._timed = on
            current = (self.ready, self._coming, self._running)
            (self.ready, self._coming, self._running), self._aside = self._aside, current
        super().measure(on)

    def begin(self, world: World) -> None:
        """Begin a step: set its loop-invariant values, clear cached senses, and switch to machine code that has become ready."""
        self._request_code(world, world.options.wait_for_code)
        self._begun = True
        versions = [population.version for population in world.populations.values()]
        if versions != self._versions:
            self._versions = versions
            self._rooms.drop_unused()
        self._rooms.begin_step(world.populations.values())
        self._grids.begin_step()
        super().begin(world)

    def messages(self) -> list[str]:
        """Return messages for the user about differences from the requested execution. None of them changes a result."""
        sentences = [] if self._without is None else [self._without]
        return sentences + codes.messages()

    def wait_for_code(self, world: World) -> None:
        """Wait until all blocks can run as machine code from the next step on, or until this has failed."""
        self._request_code(world, True)

    def counts(self) -> dict[str, int]:
        """Return the number of LLVM instructions of each function, compiled for a generic processor."""
        if self.ready is None:
            return {}
        native_program = program(self._plan, self.blocks, self.ready.facts, machine.PORTABLE_TARGET)
        return {f"instructions {name}": number for name, number in listing.instruction_counts(native_program).items()}

    def _request_code(self, world: World, waits: bool) -> None:
        """Start to build missing code after the first step, for which a user waits, if the remaining steps are worth it.

        Code that an earlier run has stored is loaded before the step."""
        if self.ready is not None or self._without is not None:
            return
        if self._timed and machine.is_available() and not machine.host().x86:
            return  # other processors may forbid reading the counter
        facts = WorldFacts.of(world.setting, timed=self._timed)
        ready = find_ready(world.plan, facts)
        pays = len(world) >= _MIN_AGENTS_FOR_CODE or sum(world.worked.values()) >= _MIN_STEP_SECONDS
        if ready is None and self._coming is None and (waits or pays):
            is_first = facts not in self._sought
            self._sought.add(facts)
            stored = find(world.plan, self.blocks, facts) if is_first else None
            if waits or self._begun or stored is not None:
                self._coming = start_building(world.plan, self.blocks, facts, stored)
                if stored is not None:
                    wait([self._coming], _MAX_LOAD_SECONDS)
        if self._coming is not None and (waits or self._coming.done()):
            try:
                ready = self._coming.result()
            except CodeUnavailable as why:
                self._without = f"NumPy runs instead of machine code, slower and with the same result: {why}"
            except Exception as problem:
                if waits:
                    raise
                self._without = (
                    "NumPy runs instead of machine code, slower and with the same result: making it failed, which is a mistake "
                    f"in antdsl ({type(problem).__name__}: {problem})"
                )
        if ready is not None:
            self.ready = ready

    def run(self, world: World, population: Population, block: str, rows: NDArray[np.intp] | None = None) -> None:
        """Run a block for some rows (None: all), and add their requests to the population's effects. Blocks of births run in
        NumPy."""
        name = population.name
        code = None if rows is not None else self._running.get((name, block)) or self._ready_block(name, block)
        metered = self.metered.get((name, block)) if self.metered else None
        if code is None or (code.code.lines is None) != (metered is None):
            super().run(world, population, block, rows)
            return
        near = code.code.near
        grids = [self._search_cells(world, population, block, each, number) for number, each in enumerate(near)]
        values, tables = self._values[name], code.tables
        tables.fill(world, population, values, self._lasting[name], self._kept[name], grids)
        for begin, end in code.run(world, population, values, metered):
            super().run(world, population, block, np.arange(begin, end))  # raises the error with its location
        for lane in tables.lanes.every:
            for field, laid in lane.laid.items():
                if laid[0]:
                    world.fields[field].mark_pending()
                    laid[0] = False
        for number in range(len(near)):
            key, widest = (name, block, number), [lane.widest[number] for lane in tables.lanes.every]
            self._widest[key] = max([max(each.tolist()) for each in widest]) or self._widest[key]
            for each in widest:
                each.fill(0)

    def _ready_block(self, species: str, block: str) -> BlockRunner | None:
        """Return the runner of a block's machine code; None if the block has no machine code."""
        if self.ready is None or (species, block) not in self.ready.written:
            return None
        native_block = self._running[species, block] = BlockRunner(self.ready, species, block, self._rooms)
        return native_block

    def _search_cells(self, world: World, population: Population, block: str, near: NeighbourSearch, number: int) -> Arrays:
        """Return the cell grid for a search. Its cells suit the greatest radius of the previous step, or initially that of
        `_estimate_radius`."""
        key = (population.name, block, number)
        other = world.populations[near.species]
        if key not in self._widest:
            self._widest[key] = _estimate_radius(world, population, other, [chosen.args[0] for chosen in near.sets])
        widest = self._widest[key]
        beside = [(names, [other.start[name] for name in names.split()]) for names in near.beside]
        return self._grids.of(world, other, widest if widest > 0 else 1.0, beside)


def _estimate_radius(world: World, population: Population, other: Population, radii: list[ir.PlanNode]) -> float:
    """Return the greatest radius (mm) of a search, computed by the reference backend for a sample of agents.

    A radius that itself depends on a search would take too long. It is replaced by a radius that contains about
    `_DEFAULT_AGENTS_PER_CELL` of the others."""
    cheap = [radius for radius in radii if not any(each.op in ("set.agents", "set.every") for each in required_nodes([radius]))]
    lengths = [0.0] if len(cheap) == len(radii) else [_default_cell_size(other)]
    for row in np.linspace(0, len(population) - 1, min(_SAMPLED_RADII, len(population))).astype(int) if cheap else ():
        agent = AgentRun(world, population, int(row), population.now, int(row), EffectRequests(), {})
        lengths += [float(agent.value(radius)) for radius in cheap]
    return max((each for each in lengths if np.isfinite(each)), default=0.0)


def _default_cell_size(population: Population) -> float:
    """Return the edge (mm) of a cell that contains about `_DEFAULT_AGENTS_PER_CELL` agents, for a crowd along a line, on a
    sheet or in a volume."""
    columns = (population.start[f"position.{axis}"] for axis in AXES)
    extents = sorted((float(np.ptp(finite)) for place in columns if len(finite := place[np.isfinite(place)])), reverse=True)
    share = _DEFAULT_AGENTS_PER_CELL / max(len(population), 1)
    return max((float(np.prod(extents[:k]) * share) ** (1 / k) for k in range(1, len(extents) + 1)), default=0.0)
