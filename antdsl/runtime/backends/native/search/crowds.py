"""Search for agents with very many neighbours: one agent at a time, any number of candidates, and a cap by distance and id.

Candidates are listed, then their distances as integers in the same order. If the widest radius contains more candidates than
the cap, bisection finds the distance of the last counted neighbour. The cap applies to every radius, because the nearest in a
wide radius are also the nearest in a narrow one. Then the list is reduced to the counted neighbours and traversed for all
requested reductions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from antdsl import limits
from antdsl.machine_code.kernels.values import Number
from antdsl.machine_code.kinds import BOOL, F32, I8, I32, I64, LANE_COUNT, PTR
from antdsl.machine_code.lanes import Lanes
from antdsl.plan import ir
from antdsl.runtime.backends.native.block import BlockWriter, FunctionWriter
from antdsl.runtime.backends.native.search.cells import SEARCH_SLACK_FACTOR, CellRows, append_numbers
from antdsl.runtime.backends.native.search.near import OPERAND_STRIDE_BYTES, NeighbourLanes, SearchCode, measure_pairs
from antdsl.runtime.backends.native.sets import PairValues, accumulate
from antdsl.runtime.backends.native.sums import NO_LABEL, RunningReduction
from antdsl.runtime.world import AXES

_REJECTED_DISTANCE_NUMBER = (1 << 31) - 1  # key of a rejected candidate, above the keys of all distances


def write_dense_search(b: BlockWriter, near: SearchCode) -> None:
    """Write the function that processes the agents in a mask of eight, one by one."""
    w = FunctionWriter(b.module, b.layout)
    e = w.e
    rows, mask, own_area, out = (
        e.named_number(I64, "%row"),
        e.named_number(I64, "%mask"),
        e.named_number(PTR, "%own"),
        e.named_number(PTR, "%out"),
    )
    with e.loop(LANE_COUNT) as lane, e.inside(e.has_bit(mask, lane)):
        row = rows + lane

        def mine(k: int) -> Lanes:
            return e.read_one(e.field(own_area, OPERAND_STRIDE_BYTES * k), lane, near.kinds[k])

        def put(k: int, value: Lanes) -> None:
            e.put(e.address(e.field(out, OPERAND_STRIDE_BYTES * k), lane, value.kind), value)

        own = {node: e.widened(mine(k)) for node, k in near.operand_slots.items()}
        place = [e.widened(e.read_one(w.base("start", f"position.{axis}"), row, F32)) for axis in AXES]
        radius = {chosen: e.widened(mine(k)) for chosen, k in near.reach.items()}
        crowd = _DenseNeighbours(w, near, place, e.widened(e.convert(row, I32)) if near.other == b.species else None)
        crowd.measure(list(radius.values()))
        for chosen, k in near.stops.items():
            put(k, crowd.is_over_limit(radius[chosen]))
        crowd.keep_nearest()
        heading = [e.widened(e.read_one(w.base("start", f"heading.{axis}"), row, F32)) for axis in AXES] if near.view else []
        sums = [RunningReduction(e, node, many=False) for node in near.nodes]
        for each in sums:
            each.start()
        with e.loop(e.load(crowd.total, I64), LANE_COUNT) as at:
            others = crowd.at(at)

            def inside(chosen: ir.PlanNode) -> Lanes:
                reached = others.is_present & (others.distance <= radius[chosen])
                if chosen in near.view:
                    hx, hy, hz = heading
                    ahead = (others.dx * hx + others.dy * hy) + others.dz * hz
                    reached = reached & (ahead >= mine(near.view[chosen]) * others.distance)
                return reached

            pairs = PairValues(w, lambda node: own[node], others.leaf, b.senses)
            for each, node in zip(sums, near.nodes, strict=True):
                reached = e.get_or_make(("near", node.args[0]), lambda chosen=node.args[0]: inside(chosen))  # type: ignore[misc]
                accumulate(each, node, pairs, reached, others.ids)
        for k, each in enumerate(sums):
            each.combine_lanes()
            put(k, e.one(e.as_stored(each.result()), 0))
    e.end(f"{near.name}.many", (w.table, rows, mask, own_area, out))


@dataclass(slots=True, eq=False)
class _DenseNeighbours:
    """The others around one requesting agent.

    `buffer`: their positions in the grid's order. `keys`: their distances as integers, `_REJECTED_DISTANCE_NUMBER` outside the
        widest radius.
    Both are padded to a multiple of eight. `total`: the address of their number."""

    w: FunctionWriter
    near: SearchCode
    place: list[Lanes]
    itself: Lanes | None
    buffer: Lanes = field(init=False)
    keys: Lanes = field(init=False)
    total: Number = field(init=False)

    def measure(self, radii: list[Lanes]) -> None:
        """List the others that may be within the widest radius, with their distances."""
        w, e = self.w, self.w.e
        self.buffer, self.total = w.base("candidates"), e.slot(I64)
        e.put(self.total, e.constant(0, I64, 1))
        search = CellRows(w, self.near.number, self.place, radii, e.constant(True, BOOL))
        limit = (search.widest * search.widest) * np.float32(SEARCH_SLACK_FACTOR) + np.float32(1e-30)
        columns = [w.base("grid", self.near.number, axis) for axis in AXES]

        with e.loop(search.row_count()):
            row = search.next_row()
            begin, count = (e.convert(e.one(each, 0), I64) for each in row)
            with e.loop(count, LANE_COUNT) as k:
                at = begin + k
                is_present = k + e.iota() < count
                dx, dy, dz = (e.read(column, at, F32) - own for column, own in zip(columns, self.place, strict=True))
                square = (dx * dx + dy * dy) + dz * dz
                numbers = e.convert(at, I32) + e.convert(e.iota(), I32)
                append_numbers(e, self.buffer, self.total, numbers, is_present & (square <= limit))
        count = e.load(self.total, I64)
        self._close_list(count)
        self.keys = e.address(self.buffer, count + LANE_COUNT, I32)
        with e.loop(count, LANE_COUNT) as index:
            others = self.at(index)
            within = others.is_present & (others.distance <= search.widest)
            if self.itself is not None:
                within = within & (others.rows != self.itself)
            e.write(self.keys, index, e.where(within, e.bits(others.distance, I32), e.constant(_REJECTED_DISTANCE_NUMBER, I32)))

    def _close_list(self, count: Lanes) -> None:
        """Append eight zeros to the list, because it is read eight entries at a time."""
        self.w.e.write(self.buffer, count, self.w.e.constant(0, I32))

    def at(self, index: Lanes) -> NeighbourLanes:
        """Return eight of the listed others, from `index` on."""
        e = self.w.e
        is_present = index + e.iota() < e.load(self.total, I64)
        at = e.where(is_present, e.read(self.buffer, index, I32), e.constant(0, I32))
        return measure_pairs(self.w, self.near, at, self.place, is_present)

    def _count_passing(self, test: Callable[[Lanes, Lanes], Lanes]) -> Lanes:
        """Return how many of the others pass a test. Its inputs are an index and the eight keys from that index on."""
        e = self.w.e
        counted = e.slot(I32, LANE_COUNT)
        e.put(counted, e.constant(0, I32))
        with e.loop(e.load(self.total, I64), LANE_COUNT) as index:
            good = test(index, e.read(self.keys, index, I32))
            e.put(counted, e.load(counted, I32, LANE_COUNT) + e.convert(good, I32))
        return e.op("reduce.add", I32, e.load(counted, I32, LANE_COUNT), lanes=1)

    def _find_least(self, place: Number, kind: str, most: int, enough: Callable[[Lanes], Lanes]) -> None:
        """Find the least integer from 0 to `most` for which `enough` holds, and write it to `place`. All bits of `most` are 1."""
        e = self.w.e
        low, high = e.slot(kind), e.slot(kind)
        e.put(low, e.constant(0, kind, 1))
        e.put(high, e.constant(most, kind, 1))
        with e.loop(most.bit_length()):
            a, z = e.load(low, kind), e.load(high, kind)
            middle = a + ((z - a) >> 1)
            good = enough(middle)
            e.put(low, e.where(good, a, middle + 1))
            e.put(high, e.where(good, middle, z))
        e.put(place, e.load(high, kind))

    def is_over_limit(self, radius: Lanes) -> Lanes:
        """Return whether more than `limits.MAX_CANDIDATES_IN_RADIUS` others are within a radius."""
        e = self.w.e
        many = e.slot(I8)
        e.put(many, e.constant(0, I8, 1))
        with e.inside(e.load(self.total, I64) > limits.MAX_CANDIDATES_IN_RADIUS):
            inside = radius >= np.float32(0)
            bound = e.bits(radius, I32)
            number = self._count_passing(lambda index, keys: inside & (keys <= bound))
            e.put(many, e.convert(number > limits.MAX_CANDIDATES_IN_RADIUS, I8))
        return e.load(many, I8)

    def keep_nearest(self) -> None:
        """Reduce the list to the counted others: if there are more than the cap, the nearest by (distance, id)."""
        e, cap = self.w.e, limits.MAX_QUERY_NEIGHBOURS
        far, last = e.slot(I32), e.slot(I64)
        e.put(far, e.constant(_REJECTED_DISTANCE_NUMBER - 1, I32, 1))
        e.put(last, e.constant(NO_LABEL, I64, 1))
        with e.inside(e.load(self.total, I64) > cap):

            def enough(reach: Lanes, least: int = cap) -> Lanes:
                bound = e.widened(reach)
                return self._count_passing(lambda index, keys: keys <= bound) >= least

            with e.inside(enough(e.load(far, I32), cap + 1)):
                self._find_least(far, I32, _REJECTED_DISTANCE_NUMBER, enough)
                reach = e.widened(e.load(far, I32))
                nearer = self._count_passing(lambda index, keys: keys < reach)
                equal = self._count_passing(lambda index, keys: keys == reach)
                rest = cap - nearer

                def by_id(middle: Lanes) -> Lanes:
                    bound = e.widened(middle)
                    return self._count_passing(lambda index, keys: (keys == reach) & (self.at(index).ids() <= bound)) >= rest

                with e.inside(equal > rest):
                    self._find_least(last, I64, NO_LABEL, by_id)
        reach, label = e.widened(e.load(far, I32)), e.load(last, I64)
        ties = label != NO_LABEL
        out, good = e.slot(I64), e.slot(I8)
        e.put(out, e.constant(0, I64, 1))
        with e.loop(e.load(self.total, I64), LANE_COUNT) as index:
            keys = e.read(self.keys, index, I32)
            e.put(good, e.mask_bits(keys <= reach))
            with e.inside(ties):
                first = (keys < reach) | ((keys == reach) & (self.at(index).ids() <= label))
                e.put(good, e.mask_bits(first))
            append_numbers(e, self.buffer, out, e.read(self.buffer, index, I32), e.from_bits(e.load(good, I8)))
        e.put(self.total, e.load(out, I64))
        self._close_list(e.load(out, I64))
