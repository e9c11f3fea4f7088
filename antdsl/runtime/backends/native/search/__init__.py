"""Machine code for reductions over neighbours. One search of the cell grid serves all reductions over a species.

Eight agents are processed at a time. The cells within their radii are computed in SIMD lanes. Agents in these cells are
candidates, and their distances are measured eight at a time. Candidates that are near enough and in view are listed, one list per
agent. Then the eight lists are traversed in SIMD lanes: in each iteration, one pair per agent is tested and added to the agent's
results. `dense_neighbours` handles agents with very many candidates.

Reductions in several regions share one search if its inputs are known. The first region runs the search for its agents. Later
regions run it only for agents that have no results yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from antdsl import limits
from antdsl.machine_code.kernels.values import Number, format_llvm_type
from antdsl.machine_code.lanes import LaneBuilder, Lanes
from antdsl.machine_code.number_kinds import BOOL, F32, I8, I32, I64, LANE_COUNT, PTR
from antdsl.plan import ir
from antdsl.plan.traverse import collect_required_nodes
from antdsl.runtime.backends.block_compiler import BlockInstruction
from antdsl.runtime.backends.native.accumulators import LaneReduction
from antdsl.runtime.backends.native.address_layout import LANE_TYPE_BY_KIND
from antdsl.runtime.backends.native.block_writer import BlockWriter, FunctionWriter, NeighbourSearchPlan
from antdsl.runtime.backends.native.float4 import emit_quadruple_address
from antdsl.runtime.backends.native.reduction_loops import (
    PairValueCache,
    emit_pair_accumulation,
    find_own_values,
    find_reduction_sets,
)
from antdsl.runtime.backends.native.search.cell_rows import SEARCH_SLACK_FACTOR, CellRowReader, emit_append_numbers
from antdsl.runtime.backends.native.search.dense_neighbours import write_dense_search
from antdsl.runtime.backends.native.search.search_pairs import (
    OPERAND_STRIDE_BYTES,
    POSITION_REGISTERS,
    SearchCodePlan,
    emit_pair_measurements,
)
from antdsl.runtime.backends.native.stage_schedule import list_reduction_operands
from antdsl.runtime.sensing.pairs import find_needed_nearest_count
from antdsl.runtime.world import AXES

# Candidates of one agent that are gone through here, so that the cap leaves out none
MAX_LISTED_CANDIDATES = limits.MAX_QUERY_NEIGHBOURS
_CACHE_LINE_BYTES = 64  # bytes of a cache line
_ROWS_PER_LOOKUP = 8  # rows of cells that are looked up before their agents are listed
_LIST_STRIDE = MAX_LISTED_CANDIDATES + 2 * LANE_COUNT  # distance between the lists of two agents, in numbers
_MIN_SQUARED_DISTANCE, _COSINE_SLACK = np.float32(1e-30), np.float32(1e-5)


@dataclass(slots=True, eq=False)
class ReductionGroup:
    """Reductions that a single search computes.

    `operand_area`, `result_area`: addresses of memory through which the search receives operands and returns results.
    `answered_mask`: the address of the mask of agents that already have results."""

    number: int
    instructions: list[BlockInstruction]
    operand_area: Number
    result_area: Number
    answered_mask: Number
    search: SearchCodePlan


def emit_neighbour_reduction(b: BlockWriter, instruction: BlockInstruction) -> None:
    """Emit a reduction over neighbours, together with all others that the same search can compute."""
    e, group = b.builder, _make_reduction_group(b, instruction)
    shared = any(each.scope is not instruction.scope for each in group.instructions)
    mask = b.mask[-1]
    if not shared:
        _emit_search_call(b, group, e.mask_to_i8(mask))
    else:
        answered_mask = e.load(group.answered_mask, I8)
        missing = e.mask_to_i8(mask) & ~answered_mask
        with e.write_if(missing != 0):
            _emit_search_call(b, group, missing)
            e.store_number(group.answered_mask, answered_mask | missing)
    for k, each in enumerate(group.instructions):
        if each.scope is instruction.scope and not any(each.slot in names for names in e.known):
            kind = LANE_TYPE_BY_KIND[group.search.nodes[k].kind]
            b.record_slot_value(each.slot, _emit_area_load(e, group.result_area, k, kind))
    for chosen, k in group.search.overflow_slots.items():
        if any(each.scope is instruction.scope and each.subject.args[0] is chosen for each in group.instructions):  # type: ignore[union-attr]
            with e.write_if(e.any_lane(_emit_area_load(e, group.result_area, k, BOOL) & mask)):
                e.store_number(b.emit_array_address("counts"), e.make_constant(1, I64, 1))


def _emit_area_load(e: LaneBuilder, area: Number, k: int, kind: str) -> Lanes:
    """Return operand or result `k` of a search, loaded from the memory at `area`."""
    return e.convert(
        e.load(e.emit_offset_address(area, OPERAND_STRIDE_BYTES * k), I8 if kind == BOOL else kind, LANE_COUNT), kind
    )


def _make_reduction_group(b: BlockWriter, first: BlockInstruction) -> ReductionGroup:
    """Return a group that consists of the reduction `first` and all others that the same search can compute."""
    if first in b.groups:
        known_group: ReductionGroup = b.groups[first]
        return known_group
    together = [first, *(each for each in b.find_joint_reductions(first) if each not in b.groups)]
    number = len(b.code.searches)
    name = f"near.{b.species}.{b.compiler.name}.{number}"
    nodes = [each.subject for each in together if isinstance(each.subject, ir.PlanNode)]
    near = SearchCodePlan(name, number, nodes[0].args[0].attrs[0], nodes)
    operands = 0
    for instruction in together:
        operands += len(list_reduction_operands(instruction)) + 4
    e = b.builder
    results = 2 * len(nodes)
    own, out = (e.allocate(count, format_llvm_type(I64, LANE_COUNT)) for count in (operands, results))
    group = ReductionGroup(number, together, own, out, e.allocate_slot(I8), near)
    b.top_writers.append(lambda: e.store_number(group.answered_mask, e.make_constant(0, I8, 1)))
    for each in together:
        b.groups[each] = group
    return group


def _emit_search_call(b: BlockWriter, group: ReductionGroup, requesting: Lanes) -> None:
    """Emit code that stores the operands and calls the search for the `requesting` agents among the eight.

    The first call of this function also writes the functions of the search."""
    e, near = b.builder, group.search
    fresh = not near.operand_kinds
    by_scope: dict[int, list[BlockInstruction]] = {}
    for each in group.instructions:
        by_scope.setdefault(id(each.scope), []).append(each)
    values: list[Lanes] = []

    def append_argument(value: Lanes) -> int:
        values.append(value)
        return len(values) - 1

    reach: dict[ir.PlanNode, int] = {}
    view: dict[ir.PlanNode, int] = {}
    value_indices: dict[ir.PlanNode, int] = {}
    for instructions in by_scope.values():
        for chosen, slots in find_reduction_sets(instructions).items():
            if chosen not in reach:
                reach[chosen] = append_argument(b.find_slot_value(slots[0]))
                if not chosen.attrs[1]:
                    view[chosen] = append_argument(b.find_slot_value(slots[1]))
        for node, make in find_own_values(b, instructions).items():
            if node not in value_indices:
                value_indices[node] = append_argument(make())
    if fresh:
        near.operand_kinds, near.radius_slots, near.view_slots, near.operand_slots = (
            [value.kind for value in values],
            reach,
            view,
            value_indices,
        )
        plan = b.code.species
        stops = [chosen for chosen in near.radius_slots if find_needed_nearest_count(plan, chosen) is None]
        near.overflow_slots = {chosen: len(near.nodes) + k for k, chosen in enumerate(stops)}
        read = collect_required_nodes(arg for node in near.nodes for arg in node.args[1:])
        names = sorted(
            {each.attrs[0] for each in read if each.op == "other" and each.kind is ir.ValueKind.F32} - {*POSITION_REGISTERS}
        )
        near.extra_registers = [" ".join(names[k : k + 4]) for k in range(0, len(names), 4)]
        b.code.searches.append(NeighbourSearchPlan(near.other_species, list(near.radius_slots), near.extra_registers))
    for k, value in enumerate(values):
        e.store_number(e.emit_offset_address(group.operand_area, OPERAND_STRIDE_BYTES * k), e.broadcast(e.to_stored_form(value)))
    if fresh:
        _write_search_functions(b, near)
    e.emit_void("call", b.table, b.row, requesting, group.operand_area, group.result_area, x=f"@{near.name}")


# --- eight agents in SIMD lanes --------------------------------------------------------------------------------------


def _write_search_functions(b: BlockWriter, search_code: SearchCodePlan) -> None:
    """Write both functions of a search: one for eight agents, and one for a single agent with very many neighbours."""
    w = FunctionWriter(b.module, b.layout)
    e = w.builder
    row, bits, own, out = (
        e.named_number(I64, "%row"),
        e.named_number(I8, "%mask"),
        e.named_number(PTR, "%own"),
        e.named_number(PTR, "%out"),
    )
    asks = e.mask_from_i8(bits)

    def load_own_value(k: int) -> Lanes:
        return _emit_area_load(e, own, k, search_code.operand_kinds[k])

    place = [e.load_lanes(w.emit_array_address("start", f"position.{axis}"), row, F32) for axis in AXES]
    radius = {chosen: load_own_value(k) for chosen, k in search_code.radius_slots.items()}
    search = CellRowReader(w, search_code.number, place, list(radius.values()), asks)
    search.emit_max_radius_store()
    heading = (
        [e.load_lanes(w.emit_array_address("start", f"heading.{axis}"), row, F32) for axis in AXES]
        if search_code.view_slots
        else []
    )
    set_test = _RadiusTest(
        e, radius, {chosen: load_own_value(k) for chosen, k in search_code.view_slots.items()}, search, heading
    )
    itself = (
        e.load_lanes(w.emit_array_address("grid", search_code.number, "at"), row, I32)
        if search_code.other_species == b.species
        else None
    )
    buffer, number, over = _emit_candidate_lists(w, search_code, search, asks, set_test, itself)
    sums = [LaneReduction(e, node, needs_two_words=False) for node in search_code.nodes]
    for each in sums:
        each.allocate_values()
    with e.write_loop(e.convert(e.emit_lane_maximum(number), I64)) as k:
        is_listed = e.convert(k, I32) < number
        pair = emit_pair_measurements(w, search_code, _emit_candidate_list_reads(e, buffer, k), place, is_listed)

        def test_radius(set_node: ir.PlanNode) -> Lanes:
            reached = pair.is_present & (pair.distance <= radius[set_node])
            if set_node in search_code.view_slots:
                hx, hy, hz = heading
                ahead = e.get_or_make("ahead", lambda: (pair.dx * hx + pair.dy * hy) + pair.dz * hz)
                reached = reached & (ahead >= load_own_value(search_code.view_slots[set_node]) * pair.distance)
            return reached

        pairs = PairValueCache(
            w, lambda node: load_own_value(search_code.operand_slots[node]), pair.emit_value_of_other, b.senses
        )
        for each, node in zip(sums, search_code.nodes, strict=True):
            reached = e.get_or_make(("near", node.args[0]), lambda set_node=node.args[0]: test_radius(set_node))  # type: ignore[misc]
            emit_pair_accumulation(each, node, pairs, reached, pair.emit_ids)
    fits = asks & ~over
    for result, each in enumerate(sums):
        stored = e.to_stored_form(each.emit_result())
        start = e.emit_offset_address(out, OPERAND_STRIDE_BYTES * result)
        e.store_number(start, e.select_lanes(fits, stored, e.load(start, stored.kind, LANE_COUNT)))
    for stop in search_code.overflow_slots.values():
        start = e.emit_offset_address(out, OPERAND_STRIDE_BYTES * stop)
        e.store_number(start, e.select_lanes(fits, e.make_constant(0, I8), e.load(start, I8, LANE_COUNT)))
    with e.write_if(e.any_lane(over)):
        e.emit_void("call", w.table, row, e.mask_to_i64(over), own, out, x=f"@{search_code.name}.many")
    write_dense_search(b, search_code)
    e.end(search_code.name, (w.table, row, bits, own, out))


def _emit_candidate_list_reads(e: LaneBuilder, buffer: Lanes, k: Lanes) -> Lanes:
    """Return element `k` of each of the eight agents' lists, i32."""
    first = e.address(buffer, k, I32)
    return e.combine_lanes(e.load(e.emit_offset_address(first, 4 * _LIST_STRIDE * lane), I32) for lane in range(LANE_COUNT))


class _RadiusTest:
    """A fast test of whether a candidate may be in any set of a search.

    It compares squared distances with a tolerance, so candidates that are too far away or out of view need no square root. The
    limits of the eight requesting agents are stored in memory, and loaded for one agent at a time."""

    def __init__(
        self,
        e: LaneBuilder,
        radius: Mapping[ir.PlanNode, Lanes],
        view: Mapping[ir.PlanNode, Lanes],
        search: CellRowReader,
        heading: list[Lanes],
    ) -> None:
        self.builder, self._stack = e, search.stack
        self._heading = [self._store(each) for each in heading]
        widest = {chosen: search.max_radius for chosen in radius} if not view else radius
        limits_of = {
            chosen: (each * each) * np.float32(SEARCH_SLACK_FACTOR) + _MIN_SQUARED_DISTANCE for chosen, each in widest.items()
        }
        if not view:
            limits_of = dict(list(limits_of.items())[:1])
        self._sets: list[tuple[Number, Number | None]] = []
        for chosen, limit in limits_of.items():
            least = None
            if chosen in view:
                cosine = view[chosen]
                least = self._store(cosine * np.abs(cosine) - (cosine * cosine) * _COSINE_SLACK)
            self._sets.append((self._store(limit), least))

    def _store(self, value: Lanes) -> Number:
        place = self.builder.allocate_slot(F32, LANE_COUNT)
        self.builder.store_number(place, value)
        return place

    def build_test(self, lane: Lanes) -> Callable[[list[Lanes]], Lanes]:
        """Return the test for the agent in one lane: a function that takes the offsets of eight candidates and returns a mask."""
        e = self.builder

        def load_broadcast(place: Number) -> Lanes:
            return e.broadcast(e.load_scalar(place, lane, F32))

        own = [load_broadcast(e.emit_offset_address(self._stack, 32 * k)) for k in range(3)]
        heading = [load_broadcast(each) for each in self._heading]
        sets = [(load_broadcast(limit), None if least is None else load_broadcast(least)) for limit, least in self._sets]

        def test_distance(positions: list[Lanes]) -> Lanes:
            dx, dy, dz = (coordinate - own_coordinate for coordinate, own_coordinate in zip(positions, own, strict=True))
            square = (dx * dx + dy * dy) + dz * dz
            is_candidate = None
            for limit, least in sets:
                inside = square <= limit
                if least is not None:
                    hx, hy, hz = heading
                    ahead = (dx * hx + dy * hy) + dz * hz
                    inside = inside & ~(ahead * np.abs(ahead) + _MIN_SQUARED_DISTANCE < least * square)
                is_candidate = inside if is_candidate is None else is_candidate | inside
            assert is_candidate is not None
            return is_candidate

        return test_distance


def _emit_candidate_lists(
    w: FunctionWriter,
    search_code: SearchCodePlan,
    search: CellRowReader,
    requesting: Lanes,
    set_test: _RadiusTest,
    own_row: Lanes | None,
) -> tuple[Lanes, Lanes, Lanes]:
    """List, for each of eight agents, the candidates that may belong to any set.

    Return the address of the lists, their lengths, and a mask of the agents with more candidates than a list can hold."""
    e = w.builder
    buffer = w.emit_array_address("candidates")
    candidate_count, match_count, number, own_place = (e.allocate_slot(I32, LANE_COUNT) for _ in range(4))
    begins, ends = (e.allocate(_ROWS_PER_LOOKUP, format_llvm_type(I32, LANE_COUNT)) for _ in range(2))
    total, numbers = e.allocate_slot(I64), e.allocate_slot(I32, LANE_COUNT)
    for slot in (candidate_count, match_count):
        e.store_number(slot, e.make_constant(0, I32))
    if own_row is not None:
        e.store_number(own_place, own_row)
    columns = [w.emit_array_address("grid", search_code.number, axis) for axis in AXES]
    fours = [w.emit_array_address("grid", search_code.number, each) for each in ("places", *search_code.extra_registers)]

    def write_lane(lane: Lanes, rows: Lanes) -> None:
        """List the candidates of the agent in one lane. `rows`: the rows of cells to search."""
        test = set_test.build_test(lane)
        mine = None if own_row is None else e.broadcast(e.load_scalar(own_place, lane, I32))
        own = e.address(buffer, lane * _LIST_STRIDE, I32)
        so_far = e.address(match_count, lane, I32)
        e.store_number(total, e.convert(e.load(so_far, I32), I64))
        with e.write_loop(rows) as row:
            index = (row << 3) + lane
            begin, end = (e.load_scalar(each, index, I32) for each in (begins, ends))
            start, many = e.convert(begin, I64), e.convert(end - begin, I64)
            last = e.broadcast(end)
            e.store_number(numbers, begin + e.convert(e.make_lane_numbers(), I32))
            with e.write_loop(many, LANE_COUNT) as k:
                at = start + k
                for each in fours:  # needed when the list is traversed: eight entries are in at most three cache lines
                    for offset in (0, _CACHE_LINE_BYTES, LANE_COUNT * 16 - 4):
                        e.prefetch(e.emit_offset_address(emit_quadruple_address(e, each, at), offset))
                now = e.load(numbers, I32, LANE_COUNT)
                e.store_number(numbers, now + LANE_COUNT)
                inside = test([e.load_lanes(column, at, F32) for column in columns]) & (now < last)
                if mine is not None:
                    inside = inside & (now != mine)
                emit_append_numbers(e, own, total, now, inside)
        e.store_number(so_far, e.convert(e.load(total, I64), I32))

    every = search.emit_row_count()
    with e.write_loop(every, _ROWS_PER_LOOKUP) as first:
        rows = e.op("smin", I64, every - first, e.make_constant(_ROWS_PER_LOOKUP, I64, 1))
        e.store_number(number, e.make_constant(0, I32))
        with e.write_loop(rows) as row:
            begin, count = search.emit_next_row_read()
            sums = e.load(candidate_count, I32, LANE_COUNT) + count
            e.store_number(candidate_count, sums)
            count = e.select_lanes(sums <= MAX_LISTED_CANDIDATES, count, e.make_constant(0, I32))
            e.store_number(number, e.load(number, I32, LANE_COUNT) | count)
            at = row << 3
            e.store_lanes(begins, at, begin)
            e.store_lanes(ends, at, begin + count)
        with e.write_loop(LANE_COUNT) as lane, e.write_if(e.load_scalar(number, lane, I32) > 0):
            write_lane(lane, rows)
    counted = e.load(match_count, I32, LANE_COUNT)
    over = requesting & (e.load(candidate_count, I32, LANE_COUNT) > MAX_LISTED_CANDIDATES)
    counted = e.select_lanes(requesting & ~over, counted, e.make_constant(0, I32))
    e.store_number(number, counted)
    most, zero = e.emit_lane_maximum(counted), e.make_constant(0, I32)
    with e.write_loop(LANE_COUNT) as lane:  # all lists are traversed to the end of the longest one
        many = e.load_scalar(number, lane, I32)
        own = e.address(buffer, lane * _LIST_STRIDE, I32)
        end = e.address(own, e.convert(many, I64), I32)
        short = e.convert(most - many, I64)
        e.store_lanes(end, 0, zero)
        with e.write_if(short > LANE_COUNT), e.write_loop(short, LANE_COUNT) as k:
            e.store_lanes(end, k, zero)
    return buffer, counted, over
