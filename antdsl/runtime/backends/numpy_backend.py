"""The NumPy backend. Each operation is a pass over arrays with one value per agent, in chunks of rows, possibly in several
threads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.elementwise import FUNCTION_BY_NAME
from antdsl.numerics.processor.float_environment import set_standard_floats
from antdsl.plan import ir
from antdsl.plan.registers import find_cacheable_senses, number_statements
from antdsl.plan.traverse import collect_required_nodes
from antdsl.runtime.backends import numpy_calls
from antdsl.runtime.backends.block_compiler import (
    BUFFERS_SLOT,
    CALL_SECONDS_SLOT,
    EFFECTS_SLOT,
    LAZY_VALUES_SLOT,
    PAIRS_SLOT,
    POPULATION_SLOT,
    THREADS_SLOT,
    WORLD_SLOT,
    BlockCompiler,
    bind_instruction_calls,
)
from antdsl.runtime.backends.metering import BlockCallMeter
from antdsl.runtime.requests import EffectRequests
from antdsl.runtime.sensing.pairs import MAX_PAIRS_PER_CHUNK
from antdsl.runtime.sensing.world_senses import compute_constant, compute_uniform_leaf
from antdsl.runtime.world import DTYPE_BY_KIND, Population, World
from antdsl.scene.setting import WorldSetting

BLOCK_NAMES = ("born", "decide", "act", "blend")
StoredSenses = dict[ir.PlanNode, tuple[NDArray[np.bool_], list[NDArray[Any]]]]


class NumpyBackend:
    """The NumPy backend of one plan. The plan is compiled once. Call `begin_step` at the start of each step, then `run` for each
    block of each species."""

    spare_rows = 0  # spare rows at the end of arrays over a species

    def __init__(self, plan: ir.Plan) -> None:
        self._blocks: dict[tuple[str, str], BlockCompiler] = {}
        self._run_nodes: dict[str, list[ir.PlanNode]] = {}
        self._step_nodes: dict[str, list[ir.PlanNode]] = {}
        self._constants: dict[str, dict[ir.PlanNode, Any]] = {}
        for name, species in plan.species.items():
            order = number_statements(species)
            sets: dict[ir.PlanNode, int] = {}
            for block in BLOCK_NAMES:
                compiler = self._blocks[name, block] = BlockCompiler(species, block, order, sets)
                compiler.compile(getattr(species, block))
                bind_instruction_calls(compiler, numpy_calls.make_call)
            roots = tuple(node for block in BLOCK_NAMES for node in self._blocks[name, block].uniform_slots)
            every = collect_required_nodes(roots)
            self._constants[name] = compute_constants(node for node in every if node.rate is ir.UpdateRate.CONST)
            self._run_nodes[name] = [node for node in every if node.rate is ir.UpdateRate.RUN]
            self._step_nodes[name] = [node for node in every if node.rate > ir.UpdateRate.RUN]
        # the setting and params from which values of the run were computed
        self._run_inputs: tuple[WorldSetting, dict[str, np.float32]] | None = None
        self._run_values: dict[str, dict[ir.PlanNode, Any]] = {}  # values of the run, and constants
        self._uniform_values: dict[str, dict[ir.PlanNode, Any]] = {}
        self._stored_senses: dict[str, StoredSenses] = {}
        self._stored_masks: dict[str, NDArray[np.bool_]] = {}  # by species [sense, row]: whether the stored value is known
        self._cached_pairs: dict[str, dict[tuple[ir.PlanNode, int], Any]] = {}
        self._buffers: list[dict[Any, list[NDArray[Any]]]] = []
        self._pool: ThreadPoolExecutor | None = None
        self.metered_blocks: dict[tuple[str, str], BlockCallMeter] = {}  # by species and block, while a Meter is active

    @property
    def blocks(self) -> Mapping[tuple[str, str], BlockCompiler]:
        """Return the instructions of each block, by species and block."""
        return self._blocks

    @property
    def backend_name(self) -> str:
        """Return the name of the backend that runs the blocks in this step, as users see it."""
        return "NumPy"

    def set_timing_enabled(self, enabled: bool) -> None:
        """Start or stop to measure the time of each call, from the next step on. Results do not change."""
        if enabled == bool(self.metered_blocks):
            return
        for each in self.metered_blocks.values():
            each.stop_metering()
        self.metered_blocks = {key: BlockCallMeter(compiler) for key, compiler in self._blocks.items()} if enabled else {}

    def begin_step(self, world: World) -> None:
        """Begin a step: compute the values that are equal for all agents, and clear cached senses."""
        for name, population in world.populations.items():
            self._uniform_values[name] = self._compute_step_values(world, name)
            n = len(population) + self.spare_rows
            self._cached_pairs[name] = {}
            has = self._stored_masks.get(name)
            if has is not None and has.shape[1] == n:
                has.fill(False)
                continue
            nodes = find_cacheable_senses(population.plan)
            has = self._stored_masks[name] = np.zeros((len(nodes), n), np.bool_)
            self._stored_senses[name] = {
                node: (
                    mask,
                    [np.empty(n, DTYPE_BY_KIND[kind]) for kind in ir.TUPLE_KINDS_BY_OPERATION.get(node.op, (node.kind,))],
                )
                for mask, node in zip(has, nodes, strict=True)
            }

    def list_messages(self) -> list[str]:
        """Return an empty list, because this backend runs everything as requested."""
        return []

    def _compute_step_values(self, world: World, species: str) -> dict[ir.PlanNode, Any]:
        """Return the values that are equal for all agents of a species, by node."""
        if self._run_inputs is None or self._run_inputs[0] is not world.setting or self._run_inputs[1] != world.params:
            self._run_inputs = (world.setting, dict(world.params))
            self._run_values = {
                name: compute_uniform_values(world, nodes, self._constants[name]) for name, nodes in self._run_nodes.items()
            }
        return compute_uniform_values(world, self._step_nodes[species], self._run_values[species])

    def run(self, world: World, population: Population, block: str, rows: NDArray[np.intp] | None = None) -> None:
        """Run a block for some rows (None: all), and add their requests to the population's effects."""
        compiler = self._blocks[population.name, block]
        if not compiler.root_scope.bound_calls:
            return
        if block == "born":
            self._uniform_values[population.name] = self._compute_step_values(world, population.name)
        chunks = self._split_rows(world, population, compiler, rows)
        threads = min(world.options.threads, len(chunks))
        metered = self.metered_blocks.get((population.name, block))
        spent = [None if metered is None else metered.make_counters() for _ in chunks]
        began = perf_counter()
        effects = [EffectRequests() for _ in chunks]
        if threads <= 1:
            for chunk, into, times in zip(chunks, effects, spent, strict=True):
                self._run_chunk(world, population, compiler, chunk, into, times, 0, True)
        else:
            self._pool = self._pool or ThreadPoolExecutor(world.options.threads, "chunks", set_standard_floats)
            lanes = [range(k, len(chunks), threads) for k in range(threads)]

            def run_lane(number: int) -> None:
                for k in lanes[number]:
                    self._run_chunk(world, population, compiler, chunks[k], effects[k], spent[k], number, False)

            list(self._pool.map(run_lane, range(threads)))
        if metered is not None:
            metered.add_counters([times for times in spent if times is not None], perf_counter() - began)
        for each in effects:
            population.effects.append_all(each)

    def _split_rows(
        self, world: World, population: Population, compiler: BlockCompiler, rows: NDArray[np.intp] | None
    ) -> list[Any]:
        """Split the rows into chunks, without quarantined agents. Each chunk is a slice or an array of rows."""
        size = max(1, world.options.chunk)
        for species in compiler.complete_species:
            size = max(1, min(size, MAX_PAIRS_PER_CHUNK // max(1, len(world.populations[species]))))
        if rows is None and population.quarantined.any():
            rows = np.flatnonzero(~population.quarantined)
        n = len(population) if rows is None else len(rows)
        parts = [slice(a, min(a + size, n)) for a in range(0, n, size)]
        return parts if rows is None else [rows[part] for part in parts]

    def _run_chunk(
        self,
        world: World,
        population: Population,
        compiler: BlockCompiler,
        rows: Any,
        effects: EffectRequests,
        call_seconds: list[float] | None,
        lane: int,
        is_only_chunk: bool,
    ) -> None:
        """Run a block for one chunk of rows, and add its requests to `effects`.

        `call_seconds`: counters for the time of each call, or None. `lane`: the number of the thread. `is_only_chunk`: whether
        this is the only chunk, so that no other thread runs."""
        v: list[Any] = [None] * compiler.slot_count
        v[WORLD_SLOT], v[POPULATION_SLOT], v[EFFECTS_SLOT], v[LAZY_VALUES_SLOT] = (
            world,
            population,
            effects,
            self._stored_senses.get(population.name),
        )
        v[CALL_SECONDS_SLOT] = call_seconds
        v[PAIRS_SLOT] = {} if compiler.name == "born" else self._cached_pairs[population.name]
        v[THREADS_SLOT] = world.options.threads if is_only_chunk else 1
        values = self._uniform_values[population.name]
        for node, slot in compiler.uniform_slots.items():
            v[slot] = values[node]
        size = rows.stop - rows.start if isinstance(rows, slice) else len(rows)
        v[BUFFERS_SLOT] = self._prepare_buffers(compiler, size, lane)
        numpy_calls.set_scope_rows(v, compiler.root_scope, rows, size, None)
        with np.errstate(all="ignore"):
            for call in compiler.root_scope.bound_calls:
                call(v)

    def _prepare_buffers(self, compiler: BlockCompiler, size: int, lane: int) -> dict[Any, list[NDArray[Any]]]:
        """Return output buffers for at least `size` rows of a block, by dtype. Each thread uses its buffers again."""
        while len(self._buffers) <= lane:
            self._buffers.append({})
        pool = self._buffers[lane]
        for dtype, count in compiler.buffer_counts.items():
            arrays = pool.setdefault(dtype, [])
            if arrays and len(arrays[0]) < size:
                arrays.clear()
            length = len(arrays[0]) if arrays else size
            arrays.extend(np.empty(length, dtype) for _ in range(count - len(arrays)))
        return pool


def compute_constants(nodes: Iterable[ir.PlanNode]) -> dict[ir.PlanNode, Any]:
    """Return the values of nodes that are constant over all steps. In `nodes`, operands come before the nodes that use them."""
    values: dict[ir.PlanNode, Any] = {}
    with np.errstate(all="ignore"):
        for node in nodes:
            f = FUNCTION_BY_NAME.get(node.op)
            values[node] = compute_constant(node) if f is None else f(*[values[a] for a in node.args])
    return values


def compute_uniform_values(
    world: World, nodes: list[ir.PlanNode], known_values: dict[ir.PlanNode, Any] | None = None
) -> dict[ir.PlanNode, Any]:
    """Return the values that are equal for all agents, as NumPy scalars by node, together with `known_values`.

    In `nodes`, operands come before the nodes that use them. If `nodes` is empty, `known_values` itself is returned."""
    if known_values is not None and not nodes:
        return known_values
    values = dict(known_values or {})
    with np.errstate(all="ignore"):
        for node in nodes:
            f = FUNCTION_BY_NAME.get(node.op)
            values[node] = compute_uniform_leaf(world, node) if f is None else f(*[values[a] for a in node.args])
    return values
