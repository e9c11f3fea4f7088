"""The backend that runs a plan's blocks as machine code. NumPy runs them until the code is ready, or always if no code can be
compiled. The results are bit-identical."""

from __future__ import annotations

from concurrent.futures import Future, wait

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code import code_cache, llvm_compiler
from antdsl.machine_code.number_kinds import LANE_COUNT
from antdsl.plan import ir
from antdsl.plan.traverse import collect_required_nodes
from antdsl.runtime.backends.native import program_listing
from antdsl.runtime.backends.native.block_runner import BlockRunner
from antdsl.runtime.backends.native.block_writer import NeighbourSearchPlan
from antdsl.runtime.backends.native.compile_queue import (
    CodeUnavailable,
    CompiledPlanCode,
    find_compiled_code,
    find_stored_blocks,
    start_code_build,
)
from antdsl.runtime.backends.native.padded_arrays import PaddedArrays
from antdsl.runtime.backends.native.programs import WorldFacts, write_program
from antdsl.runtime.backends.native.search.search_grids import Arrays, SearchGrids
from antdsl.runtime.backends.numpy_backend import NumpyBackend
from antdsl.runtime.backends.reference import AgentRun
from antdsl.runtime.requests import EffectRequests
from antdsl.runtime.world import AXES, Population, World

_MIN_AGENTS_FOR_CODE = 2_000  # with as many agents, loading code pays off after a few steps
_MIN_EARLIER_STEP_SECONDS = 0.2  # CPU seconds of earlier steps from which compilation pays off
_MAX_LOAD_SECONDS = 1.0  # maximum wait for stored code
_SAMPLED_RADII = 8  # agents of which radii are computed to choose the first cell size
_DEFAULT_AGENTS_PER_CELL = 8  # agents per cell if no radius is known


class NativeBackend(NumpyBackend):
    """The native backend of one world. A thread compiles the code of the plan from the first step on."""

    spare_rows = LANE_COUNT

    def __init__(self, plan: ir.Plan) -> None:
        super().__init__(plan)
        self._plan = plan
        self._pending_code: Future[CompiledPlanCode] | None = None
        self._unavailable_reason: str | None = None  # the reason if machine code cannot be made
        self._has_begun = False
        self._looked_up_facts: set[WorldFacts] = set()  # facts for which stored code was searched
        self.ready_code: CompiledPlanCode | None = None
        self._runners: dict[tuple[str, str], BlockRunner] = {}
        self._is_timed = False  # whether the active code is timed by line
        # the inactive code: timed code while untimed code is active, and the reverse
        self._inactive_code: tuple[
            CompiledPlanCode | None, Future[CompiledPlanCode] | None, dict[tuple[str, str], BlockRunner]
        ] = (None, None, {})
        self._padded_arrays = PaddedArrays()
        self._versions: list[int] = []
        self._search_radii: dict[tuple[str, str, int], float] = {}
        self._grids = SearchGrids()

    @property
    def backend_name(self) -> str:
        return super().backend_name if self.ready_code is None else "machine code"

    def set_timing_enabled(self, enabled: bool) -> None:
        """Start or stop to measure the time of program lines, from the next step on.

        Timing requires other machine code. NumPy runs the blocks until this code is ready."""
        if enabled != self._is_timed:
            self._is_timed = enabled
            current = (self.ready_code, self._pending_code, self._runners)
            (self.ready_code, self._pending_code, self._runners), self._inactive_code = self._inactive_code, current
        super().set_timing_enabled(enabled)

    def begin_step(self, world: World) -> None:
        """Begin a step: compute the values that are equal for all agents, clear cached senses, and use code that has become
        ready."""
        self._request_compiled_code(world, world.options.wait_for_code)
        self._has_begun = True
        versions = [population.version for population in world.populations.values()]
        if versions != self._versions:
            self._versions = versions
            self._padded_arrays.drop_unused_copies()
        self._padded_arrays.begin_step(world.populations.values())
        self._grids.begin_step()
        super().begin_step(world)

    def list_messages(self) -> list[str]:
        """Return messages for the user, for example that NumPy runs instead of machine code. Results are the same."""
        sentences = [] if self._unavailable_reason is None else [self._unavailable_reason]
        return sentences + code_cache.take_messages()

    def wait_for_code(self, world: World) -> None:
        """Wait until machine code for all blocks is ready for the next step, or until compilation has failed."""
        self._request_compiled_code(world, True)

    def count_instructions_by_function(self) -> dict[str, int]:
        """Return the number of LLVM instructions of each function, by name, if compiled for a generic processor."""
        if self.ready_code is None:
            return {}
        native_program = write_program(self._plan, self.blocks, self.ready_code.facts, llvm_compiler.PORTABLE_TARGET)
        return {
            f"instructions {name}": number
            for name, number in program_listing.count_instructions_by_function(native_program).items()
        }

    def _request_compiled_code(self, world: World, must_wait: bool) -> None:
        """Request missing machine code, if enough steps remain for it to pay off.

        Code that an earlier run has stored is loaded before the first step. Other code is requested after the first step, so that
        the user soon sees the result of that step. With `must_wait`, return only when the code is ready."""
        if self.ready_code is not None or self._unavailable_reason is not None:
            return
        if self._is_timed and llvm_compiler.is_available() and not llvm_compiler.find_host_target().is_x86:
            return  # other processors may forbid reading the counter
        facts = WorldFacts.from_setting(world.setting, is_timed=self._is_timed)
        ready = find_compiled_code(world.plan, facts)
        pays = len(world) >= _MIN_AGENTS_FOR_CODE or sum(world.cpu_seconds.values()) >= _MIN_EARLIER_STEP_SECONDS
        if ready is None and self._pending_code is None and (must_wait or pays):
            is_first = facts not in self._looked_up_facts
            self._looked_up_facts.add(facts)
            stored = find_stored_blocks(world.plan, self.blocks, facts) if is_first else None
            if must_wait or self._has_begun or stored is not None:
                self._pending_code = start_code_build(world.plan, self.blocks, facts, stored)
                if stored is not None:
                    wait([self._pending_code], _MAX_LOAD_SECONDS)
        if self._pending_code is not None and (must_wait or self._pending_code.done()):
            try:
                ready = self._pending_code.result()
            except CodeUnavailable as error:
                self._unavailable_reason = f"NumPy runs instead of machine code, more slowly but with the same result: {error}"
            except Exception as problem:
                if must_wait:
                    raise
                self._unavailable_reason = (
                    "NumPy runs instead of machine code, more slowly but with the same result: compilation failed, which is a "
                    f"bug in antdsl ({type(problem).__name__}: {problem})"
                )
        if ready is not None:
            self.ready_code = ready

    def run(self, world: World, population: Population, block: str, rows: NDArray[np.intp] | None = None) -> None:
        """Run a block for some rows (None: all), and add their requests to the population's effects. NumPy runs blocks of
        births."""
        name = population.name
        code = None if rows is not None else self._runners.get((name, block)) or self._find_runner(name, block)
        metered = self.metered_blocks.get((name, block)) if self.metered_blocks else None
        if code is None or (code.code.line_counters is None) != (metered is None):
            super().run(world, population, block, rows)
            return
        near = code.code.searches
        grids = [self._find_search_grid(world, population, block, each, number) for number, each in enumerate(near)]
        values, tables = self._uniform_values[name], code.tables
        tables.fill_tables(world, population, values, self._run_values[name], self._stored_senses[name], grids)
        for begin, end in code.run_block(world, population, values, metered):
            super().run(world, population, block, np.arange(begin, end))  # raises the error with its location
        for lane in tables.lanes.every:
            for field, laid in lane.deposit_flags.items():
                if laid[0]:
                    world.fields[field].mark_deposits_pending()
                    laid[0] = False
        for number in range(len(near)):
            key, widest = (name, block, number), [lane.max_radii[number] for lane in tables.lanes.every]
            self._search_radii[key] = max([max(each.tolist()) for each in widest]) or self._search_radii[key]
            for each in widest:
                each.fill(0)

    def _find_runner(self, species: str, block: str) -> BlockRunner | None:
        """Return the runner of a block's machine code. None if the block has no machine code."""
        if self.ready_code is None or (species, block) not in self.ready_code.block_codes:
            return None
        native_block = self._runners[species, block] = BlockRunner(self.ready_code, species, block, self._padded_arrays)
        return native_block

    def _find_search_grid(
        self, world: World, population: Population, block: str, search: NeighbourSearchPlan, number: int
    ) -> Arrays:
        """Return the arrays of the cell grid for a search.

        The cell size depends on the greatest radius of the previous step. In the first step, `_estimate_search_radius` estimates
        this radius."""
        key = (population.name, block, number)
        other = world.populations[search.species]
        if key not in self._search_radii:
            self._search_radii[key] = _estimate_search_radius(
                world, population, other, [chosen.args[0] for chosen in search.set_nodes]
            )
        widest = self._search_radii[key]
        beside = [(names, [other.start[name] for name in names.split()]) for names in search.extra_registers]
        return self._grids.build_tables(world, other, widest if widest > 0 else 1.0, beside)


def _estimate_search_radius(world: World, population: Population, other: Population, radii: list[ir.PlanNode]) -> float:
    """Return the greatest radius (mm) of a search, for a sample of agents, computed by the reference backend.

    If the radius itself depends on a search, this would take too long. Then return a radius within which about
    `_DEFAULT_AGENTS_PER_CELL` other agents are."""
    cheap = [
        radius for radius in radii if not any(each.op in ("set.agents", "set.every") for each in collect_required_nodes([radius]))
    ]
    lengths = [0.0] if len(cheap) == len(radii) else [_choose_cell_size(other)]
    for row in np.linspace(0, len(population) - 1, min(_SAMPLED_RADII, len(population))).astype(int) if cheap else ():
        agent = AgentRun(world, population, int(row), population.now, int(row), EffectRequests(), {})
        lengths += [float(agent.compute_value(radius)) for radius in cheap]
    return max((each for each in lengths if np.isfinite(each)), default=0.0)


def _choose_cell_size(population: Population) -> float:
    """Return the edge length (mm) of cells that contain about `_DEFAULT_AGENTS_PER_CELL` agents each.

    The crowd may extend along a line, over an area or through a volume."""
    columns = (population.start[f"position.{axis}"] for axis in AXES)
    extents = sorted((float(np.ptp(finite)) for place in columns if len(finite := place[np.isfinite(place)])), reverse=True)
    share = _DEFAULT_AGENTS_PER_CELL / max(len(population), 1)
    return max((float(np.prod(extents[:k]) * share) ** (1 / k) for k in range(1, len(extents) + 1)), default=0.0)
