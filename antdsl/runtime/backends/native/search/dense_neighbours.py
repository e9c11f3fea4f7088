"""The search for agents with very many neighbours: one agent at a time, with any number of candidates. Only the nearest
neighbours by distance and id count, up to a fixed number, the cap.

Candidates are listed, and their distances as integers that sort like the distances. If more candidates than the cap are within
the widest radius, bisection finds the distance of the last neighbour that counts. This cap is valid for every radius, because the
nearest in a wide radius are also the nearest in a narrow one. Then the list is reduced to the neighbours that count, and
traversed for all requested reductions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from antdsl import limits
from antdsl.machine_code.kernels.values import Number
from antdsl.machine_code.lanes import Lanes
from antdsl.machine_code.number_kinds import BOOL, F32, I8, I32, I64, LANE_COUNT, PTR
from antdsl.plan import ir
from antdsl.runtime.backends.native.accumulators import NO_LABEL, LaneReduction
from antdsl.runtime.backends.native.block_writer import BlockWriter, FunctionWriter
from antdsl.runtime.backends.native.reduction_loops import PairValueCache, emit_pair_accumulation
from antdsl.runtime.backends.native.search.cell_rows import SEARCH_SLACK_FACTOR, CellRowReader, emit_append_numbers
from antdsl.runtime.backends.native.search.search_pairs import (
    OPERAND_STRIDE_BYTES,
    NeighbourLanes,
    SearchCodePlan,
    emit_pair_measurements,
)
from antdsl.runtime.world import AXES

_REJECTED_DISTANCE_NUMBER = (1 << 31) - 1  # key of a rejected candidate, above the keys of all distances


def write_dense_search(b: BlockWriter, search_code: SearchCodePlan) -> None:
    """Write the function that searches for each agent in a mask of eight, one by one."""
    w = FunctionWriter(b.module, b.layout)
    e = w.builder
    rows, mask, own_area, out = (
        e.named_number(I64, "%row"),
        e.named_number(I64, "%mask"),
        e.named_number(PTR, "%own"),
        e.named_number(PTR, "%out"),
    )
    with e.write_loop(LANE_COUNT) as lane, e.write_if(e.emit_bit_test(mask, lane)):
        row = rows + lane

        def load_own_value(k: int) -> Lanes:
            return e.load_scalar(e.emit_offset_address(own_area, OPERAND_STRIDE_BYTES * k), lane, search_code.operand_kinds[k])

        def store_result(k: int, value: Lanes) -> None:
            e.store_number(e.address(e.emit_offset_address(out, OPERAND_STRIDE_BYTES * k), lane, value.kind), value)

        own = {node: e.broadcast(load_own_value(k)) for node, k in search_code.operand_slots.items()}
        place = [e.broadcast(e.load_scalar(w.emit_array_address("start", f"position.{axis}"), row, F32)) for axis in AXES]
        radius = {chosen: e.broadcast(load_own_value(k)) for chosen, k in search_code.radius_slots.items()}
        crowd = _DenseNeighbourSearch(
            w, search_code, place, e.broadcast(e.convert(row, I32)) if search_code.other_species == b.species else None
        )
        crowd.emit_candidate_list(list(radius.values()))
        for chosen, k in search_code.overflow_slots.items():
            store_result(k, crowd.emit_is_over_limit(radius[chosen]))
        crowd.emit_nearest_reduction()
        heading = (
            [e.broadcast(e.load_scalar(w.emit_array_address("start", f"heading.{axis}"), row, F32)) for axis in AXES]
            if search_code.view_slots
            else []
        )
        sums = [LaneReduction(e, node, needs_two_words=False) for node in search_code.nodes]
        for each in sums:
            each.allocate_values()
        with e.write_loop(e.load(crowd.count_address, I64), LANE_COUNT) as at:
            others = crowd.emit_neighbour_loads(at)

            def test_radius(set_node: ir.PlanNode) -> Lanes:
                reached = others.is_present & (others.distance <= radius[set_node])
                if set_node in search_code.view_slots:
                    hx, hy, hz = heading
                    ahead = (others.dx * hx + others.dy * hy) + others.dz * hz
                    reached = reached & (ahead >= load_own_value(search_code.view_slots[set_node]) * others.distance)
                return reached

            pairs = PairValueCache(w, lambda node: own[node], others.emit_value_of_other, b.senses)
            for each, node in zip(sums, search_code.nodes, strict=True):
                reached = e.get_or_make(("near", node.args[0]), partial(test_radius, node.args[0]))
                emit_pair_accumulation(each, node, pairs, reached, others.emit_ids)
        for k, each in enumerate(sums):
            each.emit_combine_lanes()
            store_result(k, e.extract_lane(e.to_stored_form(each.emit_result()), 0))
    e.end(f"{search_code.name}.many", (w.table, rows, mask, own_area, out))


@dataclass(slots=True, eq=False)
class _DenseNeighbourSearch:
    """The agents around one requesting agent.

    `buffer`: their positions in the order of the grid. `keys`: their distances as integers that sort like the distances, or
    `_REJECTED_DISTANCE_NUMBER` outside the widest radius. Both are padded to a multiple of eight. `count_address`: the address of
    their number."""

    writer: FunctionWriter
    search: SearchCodePlan
    own_position: list[Lanes]
    own_row: Lanes | None
    buffer: Lanes = field(init=False)
    keys: Lanes = field(init=False)
    count_address: Number = field(init=False)

    def emit_candidate_list(self, radii: list[Lanes]) -> None:
        """Emit code that lists the agents that may be within the widest radius, with their distances."""
        w, e = self.writer, self.writer.builder
        self.buffer, self.count_address = w.emit_array_address("candidates"), e.allocate_slot(I64)
        e.store_number(self.count_address, e.make_constant(0, I64, 1))
        search = CellRowReader(w, self.search.number, self.own_position, radii, e.make_constant(True, BOOL))
        limit = (search.max_radius * search.max_radius) * np.float32(SEARCH_SLACK_FACTOR) + np.float32(1e-30)
        columns = [w.emit_array_address("grid", self.search.number, axis) for axis in AXES]

        with e.write_loop(search.emit_row_count()):
            row = search.emit_next_row_read()
            begin, count = (e.convert(e.extract_lane(each, 0), I64) for each in row)
            with e.write_loop(count, LANE_COUNT) as k:
                at = begin + k
                is_present = k + e.make_lane_numbers() < count
                dx, dy, dz = (e.load_lanes(column, at, F32) - own for column, own in zip(columns, self.own_position, strict=True))
                square = (dx * dx + dy * dy) + dz * dz
                numbers = e.convert(at, I32) + e.convert(e.make_lane_numbers(), I32)
                emit_append_numbers(e, self.buffer, self.count_address, numbers, is_present & (square <= limit))
        count = e.load(self.count_address, I64)
        self._emit_list_padding(count)
        self.keys = e.address(self.buffer, count + LANE_COUNT, I32)
        with e.write_loop(count, LANE_COUNT) as index:
            others = self.emit_neighbour_loads(index)
            within = others.is_present & (others.distance <= search.max_radius)
            if self.own_row is not None:
                within = within & (others.rows != self.own_row)
            e.store_lanes(
                self.keys,
                index,
                e.select_lanes(within, e.reinterpret_bits(others.distance, I32), e.make_constant(_REJECTED_DISTANCE_NUMBER, I32)),
            )

    def _emit_list_padding(self, count: Lanes) -> None:
        """Emit code that appends eight zeros to the list, because code reads the list eight entries at a time."""
        self.writer.builder.store_lanes(self.buffer, count, self.writer.builder.make_constant(0, I32))

    def emit_neighbour_loads(self, index: Lanes) -> NeighbourLanes:
        """Emit code that loads eight consecutive agents of the neighbour list, starting at `index`."""
        e = self.writer.builder
        is_present = index + e.make_lane_numbers() < e.load(self.count_address, I64)
        at = e.select_lanes(is_present, e.load_lanes(self.buffer, index, I32), e.make_constant(0, I32))
        return emit_pair_measurements(self.writer, self.search, at, self.own_position, is_present)

    def _emit_passing_count(self, test: Callable[[Lanes, Lanes], Lanes]) -> Lanes:
        """Return how many of the listed agents pass a test. The test gets an index, and the eight keys from that index on."""
        e = self.writer.builder
        counted = e.allocate_slot(I32, LANE_COUNT)
        e.store_number(counted, e.make_constant(0, I32))
        with e.write_loop(e.load(self.count_address, I64), LANE_COUNT) as index:
            good = test(index, e.load_lanes(self.keys, index, I32))
            e.store_number(counted, e.load(counted, I32, LANE_COUNT) + e.convert(good, I32))
        return e.op("reduce.add", I32, e.load(counted, I32, LANE_COUNT), lanes=1)

    def _emit_bisection(self, place: Number, kind: str, max_value: int, is_enough: Callable[[Lanes], Lanes]) -> None:
        """Emit code that finds by bisection the least integer for which `is_enough` holds, and writes it to `place`.

        The integer is from 0 to `max_value`, which must be a power of 2 minus 1."""
        e = self.writer.builder
        low, high = e.allocate_slot(kind), e.allocate_slot(kind)
        e.store_number(low, e.make_constant(0, kind, 1))
        e.store_number(high, e.make_constant(max_value, kind, 1))
        with e.write_loop(max_value.bit_length()):
            a, z = e.load(low, kind), e.load(high, kind)
            middle = a + ((z - a) >> 1)
            good = is_enough(middle)
            e.store_number(low, e.select_lanes(good, a, middle + 1))
            e.store_number(high, e.select_lanes(good, middle, z))
        e.store_number(place, e.load(high, kind))

    def emit_is_over_limit(self, radius: Lanes) -> Lanes:
        """Return whether more than `limits.MAX_CANDIDATES_IN_RADIUS` other agents are within a radius."""
        e = self.writer.builder
        many = e.allocate_slot(I8)
        e.store_number(many, e.make_constant(0, I8, 1))
        with e.write_if(e.load(self.count_address, I64) > limits.MAX_CANDIDATES_IN_RADIUS):
            inside = radius >= np.float32(0)
            bound = e.reinterpret_bits(radius, I32)
            number = self._emit_passing_count(lambda index, keys: inside & (keys <= bound))
            e.store_number(many, e.convert(number > limits.MAX_CANDIDATES_IN_RADIUS, I8))
        return e.load(many, I8)

    def emit_nearest_reduction(self) -> None:
        """Emit code that reduces the list to the nearest agents by distance and id, if there are more than the cap."""
        e, cap = self.writer.builder, limits.MAX_QUERY_NEIGHBOURS
        far, last = e.allocate_slot(I32), e.allocate_slot(I64)
        e.store_number(far, e.make_constant(_REJECTED_DISTANCE_NUMBER - 1, I32, 1))
        e.store_number(last, e.make_constant(NO_LABEL, I64, 1))
        with e.write_if(e.load(self.count_address, I64) > cap):

            def has_enough(reach: Lanes, count: int = cap) -> Lanes:
                bound = e.broadcast(reach)
                return self._emit_passing_count(lambda index, keys: keys <= bound) >= count

            with e.write_if(has_enough(e.load(far, I32), cap + 1)):
                self._emit_bisection(far, I32, _REJECTED_DISTANCE_NUMBER, has_enough)
                reach = e.broadcast(e.load(far, I32))
                nearer = self._emit_passing_count(lambda index, keys: keys < reach)
                equal = self._emit_passing_count(lambda index, keys: keys == reach)
                rest = cap - nearer

                def by_id(middle: Lanes) -> Lanes:
                    bound = e.broadcast(middle)
                    return (
                        self._emit_passing_count(
                            lambda index, keys: (keys == reach) & (self.emit_neighbour_loads(index).emit_ids() <= bound)
                        )
                        >= rest
                    )

                with e.write_if(equal > rest):
                    self._emit_bisection(last, I64, NO_LABEL, by_id)
        reach, label = e.broadcast(e.load(far, I32)), e.load(last, I64)
        ties = label != NO_LABEL
        out, good = e.allocate_slot(I64), e.allocate_slot(I8)
        e.store_number(out, e.make_constant(0, I64, 1))
        with e.write_loop(e.load(self.count_address, I64), LANE_COUNT) as index:
            keys = e.load_lanes(self.keys, index, I32)
            e.store_number(good, e.mask_to_i8(keys <= reach))
            with e.write_if(ties):
                first = (keys < reach) | ((keys == reach) & (self.emit_neighbour_loads(index).emit_ids() <= label))
                e.store_number(good, e.mask_to_i8(first))
            emit_append_numbers(e, self.buffer, out, e.load_lanes(self.buffer, index, I32), e.mask_from_i8(e.load(good, I8)))
        e.store_number(self.count_address, e.load(out, I64))
        self._emit_list_padding(e.load(out, I64))
