"""The search for agents with very many neighbours: one at a time, any number of candidates, and the cap by distance and id.

Candidates are written down, then their distances, as whole numbers that are in the same order. Where there are more in the widest
radius than the cap, the distance of the last one that counts is found by halving. It is the same for every radius: who is nearest
in a wide one is so in a narrow one too. Then the list is cut to those who count, and gone through for all that is asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from antdsl import limits
from antdsl.machine_code.lanes import BOOL, F32, I8, I32, I64, PTR, WIDTH, Lanes
from antdsl.plan import ir
from antdsl.runtime.backends.native.block import BlockWriter, Writer
from antdsl.runtime.backends.native.cells import BEYOND, Rows, write_down
from antdsl.runtime.backends.native.layout import KINDS
from antdsl.runtime.backends.native.near import STRIDE, Found, Search, measured
from antdsl.runtime.backends.native.sets import PairValues, take
from antdsl.runtime.backends.native.sums import NO_LABEL, Sum
from antdsl.runtime.world import AXES

_NONE = (1 << 31) - 1  # the number of a distance that does not count: above those of all others


def write_many(b: BlockWriter, near: Search) -> None:
    """The function that goes through some of eight asking agents, one by one."""
    w = Writer(b.module, b.layout)
    e = w.e
    with e.loop(e.constant(WIDTH, I64, one=True)) as lane:
        bit = e.one(f"lshr i64 %mask, {lane.name}", I64)
        with e.inside(e.one(f"trunc i64 {bit.name} to i1", BOOL)):
            row = e.one(f"add i64 %row, {lane.name}", I64)

            def mine(k: int) -> Lanes:
                return e.load_one(Lanes(e, PTR, e.field("%own", STRIDE * k), one=True), lane, near.kinds[k])

            own = {node: e.splat(mine(k)) for node, k in near.places.items()}
            place = [e.splat(e.load_one(w.base("start", f"position.{axis}"), row, F32)) for axis in AXES]
            radius = {chosen: e.splat(mine(k)) for chosen, k in near.reach.items()}
            crowd = _Crowd(w, near, place, e.splat(e.convert(row, I32)) if near.other == b.species else None)
            crowd.measure(list(radius.values()))
            for chosen, k in near.stops.items():
                stop = e.address(Lanes(e, PTR, e.field("%out", STRIDE * k), one=True), lane, I8)
                e.do(f"store i8 {e.convert(crowd.more_than_may_be(radius[chosen]), I8).name}, ptr {stop.name}")
            crowd.cut()
            heading = [e.splat(e.load_one(w.base("start", f"heading.{axis}"), row, F32)) for axis in AXES] if near.view else []
            sums = [Sum(e, node, many=False) for node in near.nodes]
            for each in sums:
                each.start()
            with e.loop(e.get(crowd.total, I64, one=True), WIDTH) as at:
                found = crowd.at(at)

                def inside(chosen: ir.Node) -> Lanes:
                    reached = found.there & (found.distance <= radius[chosen])
                    if chosen in near.view:
                        hx, hy, hz = heading
                        ahead = (found.dx * hx + found.dy * hy) + found.dz * hz
                        reached = reached & (ahead >= e.splat(mine(near.view[chosen])) * found.distance)
                    return reached

                pairs = PairValues(w, lambda node: own[node], found.leaf, b.senses)
                for each, node in zip(sums, near.nodes, strict=True):
                    reached = e.once(("near", node.args[0]), lambda chosen=node.args[0]: inside(chosen))  # type: ignore[misc]
                    take(each, node, pairs, reached, found.ids)
            for k, (each, node) in enumerate(zip(sums, near.nodes, strict=True)):
                each.fold()
                value = each.result()
                stored = e.convert(value, I8) if KINDS[node.kind] == BOOL else value
                single = e.one(f"extractelement {stored.typed}, i64 0", stored.kind)
                e.put(e.address(Lanes(e, PTR, e.field("%out", STRIDE * k), one=True), lane, stored.kind).name, single)
    b.module.functions[f"{near.name}.many"] = w.inner(f"{near.name}.many", "i64 %row, i64 %mask, ptr %own, ptr %out")


@dataclass(slots=True, eq=False)
class _Crowd:
    """The others around one asking agent. `buffer` has where they stand in the grid's order, `keys` their distances as whole
    numbers, `_NONE` for who is not in the widest radius; both go on to a multiple of eight. `total`: where their number lies."""

    w: Writer
    near: Search
    place: list[Lanes]
    itself: Lanes | None
    buffer: Lanes = field(init=False)
    keys: Lanes = field(init=False)
    total: str = field(init=False)

    def measure(self, radii: list[Lanes]) -> None:
        """Write down who may be in the widest of some radii, and how far away they are."""
        w, e = self.w, self.w.e
        self.buffer, self.total = w.base("candidates"), e.slot(I64, one=True)
        e.put(self.total, e.constant(0, I64, one=True))
        search = Rows(w, self.near.number, self.place, radii, e.constant(True, BOOL))
        limit = (search.widest * search.widest) * np.float32(BEYOND) + np.float32(1e-30)
        columns = [w.base("grid", self.near.number, axis) for axis in AXES]

        with e.loop(search.many()):
            row = search.following()
            begin, count = (e.convert(e.one(f"extractelement {each.typed}, i64 0", I32), I64) for each in row)
            with e.loop(count, WIDTH) as k:
                at = e.one(f"add i64 {begin.name}, {k.name}", I64)
                there = (e.splat(k) + e.iota()) < e.splat(count)
                dx, dy, dz = (e.load(column, at, F32) - own for column, own in zip(columns, self.place, strict=True))
                square = (dx * dx + dy * dy) + dz * dz
                numbers = e.splat(e.convert(at, I32)) + e.convert(e.iota(), I32)
                write_down(e, self.buffer, self.total, numbers, there & (square <= limit))
        count = e.get(self.total, I64, one=True)
        self._end(count)
        self.keys = e.address(self.buffer, e.one(f"add i64 {count.name}, {WIDTH}", I64), I32)
        with e.loop(count, WIDTH) as index:
            found = self.at(index)
            within = found.there & (found.distance <= search.widest)
            if self.itself is not None:
                within = within & (found.rows != self.itself)
            e.store(self.keys, index, e.where(within, e.bits(found.distance, I32), e.constant(_NONE, I32)))

    def _end(self, count: Lanes) -> None:
        self.w.e.do(f"store <{WIDTH} x i32> zeroinitializer, ptr {self.w.e.address(self.buffer, count, I32).name}, align 4")

    def at(self, index: Lanes) -> Found:
        """Eight of those written down, from an index on."""
        e = self.w.e
        there = (e.splat(index) + e.iota()) < e.splat(e.get(self.total, I64, one=True))
        at = e.where(there, e.load(self.buffer, index, I32), e.constant(0, I32))
        return measured(self.w, self.near, at, self.place, there)

    def _count(self, test: Callable[[Lanes, Lanes], Lanes]) -> Lanes:
        """How many pass a test, which is given an index and the keys of eight from there on."""
        w, e = self.w, self.w.e
        counted = e.slot(I32)
        e.put(counted, e.constant(0, I32))
        with e.loop(e.get(self.total, I64, one=True), WIDTH) as index:
            good = test(index, e.load(self.keys, index, I32))
            e.put(counted, e.get(counted, I32) + e.convert(good, I32))
        w.module.declare("llvm.vector.reduce.add.v8i32", I32, [f"<{WIDTH} x i32>"])
        return e.one(f"call i32 @llvm.vector.reduce.add.v8i32({e.get(counted, I32).typed})", I32)

    def _least(self, place: str, kind: str, most: int, enough: Callable[[Lanes], Lanes]) -> None:
        """Find the least whole number from 0 to `most`, all of whose bits are 1, that is enough."""
        e = self.w.e
        low, high = e.slot(kind, one=True), e.slot(kind, one=True)
        e.do(f"store {kind} 0, ptr {low}")
        e.do(f"store {kind} {most}, ptr {high}")
        with e.loop(e.constant(most.bit_length(), I64, one=True)):
            a, z = e.get(low, kind, one=True), e.get(high, kind, one=True)
            wide = e.one(f"sub {kind} {z.name}, {a.name}", kind)
            middle = e.one(f"add {kind} {a.name}, {e.one(f'lshr {kind} {wide.name}, 1', kind).name}", kind)
            good = enough(middle)
            above = e.one(f"add {kind} {middle.name}, 1", kind)
            e.put(low, e.one(f"select i1 {good.name}, {kind} {a.name}, {kind} {above.name}", kind))
            e.put(high, e.one(f"select i1 {good.name}, {kind} {middle.name}, {kind} {z.name}", kind))
        e.put(place, e.get(high, kind, one=True))

    def more_than_may_be(self, radius: Lanes) -> Lanes:
        """Whether more are in a radius than `limits.WITHIN_RADIUS`."""
        e = self.w.e
        many = e.slot(I8, one=True)
        e.do(f"store i8 0, ptr {many}")
        with e.inside(e.one(f"icmp sgt i64 {e.get(self.total, I64, one=True).name}, {limits.WITHIN_RADIUS}", BOOL)):
            inside = radius >= np.float32(0)
            bound = e.bits(radius, I32)
            number = self._count(lambda index, keys: inside & (keys <= bound))
            more = e.one(f"icmp sgt i32 {number.name}, {limits.WITHIN_RADIUS}", BOOL)
            e.put(many, e.convert(more, I8))
        return e.get(many, I8, one=True)

    def cut(self) -> None:
        """Leave only those in the list who count: of more than the cap the nearest, by (distance, id)."""
        e, cap = self.w.e, limits.NEIGHBOURS
        far, last = e.slot(I32, one=True), e.slot(I64, one=True)
        e.put(far, e.constant(_NONE - 1, I32, one=True))
        e.put(last, e.constant(NO_LABEL, I64, one=True))
        with e.inside(e.one(f"icmp sgt i64 {e.get(self.total, I64, one=True).name}, {cap}", BOOL)):

            def enough(reach: Lanes, least: int = cap) -> Lanes:
                bound = e.splat(reach)
                number = self._count(lambda index, keys: keys <= bound)
                return e.one(f"icmp sge i32 {number.name}, {least}", BOOL)

            with e.inside(enough(e.get(far, I32, one=True), cap + 1)):
                self._least(far, I32, _NONE, enough)
                reach = e.splat(e.get(far, I32, one=True))
                nearer = self._count(lambda index, keys: keys < reach)
                equal = self._count(lambda index, keys: keys == reach)
                rest = e.one(f"sub i32 {cap}, {nearer.name}", I32)

                def by_id(middle: Lanes) -> Lanes:
                    bound = e.splat(middle)
                    number = self._count(lambda index, keys: (keys == reach) & (self.at(index).ids() <= bound))
                    return e.one(f"icmp sge i32 {number.name}, {rest.name}", BOOL)

                with e.inside(e.one(f"icmp sgt i32 {equal.name}, {rest.name}", BOOL)):
                    self._least(last, I64, NO_LABEL, by_id)
        reach, label = e.splat(e.get(far, I32, one=True)), e.get(last, I64, one=True)
        ties = e.one(f"icmp ne i64 {label.name}, {NO_LABEL}", BOOL)
        out, good = e.slot(I64, one=True), e.slot(I8, one=True)
        e.put(out, e.constant(0, I64, one=True))
        with e.loop(e.get(self.total, I64, one=True), WIDTH) as index:
            keys = e.load(self.keys, index, I32)
            e.put(good, e.mask_bits(keys <= reach))
            with e.inside(ties):
                first = (keys < reach) | ((keys == reach) & (self.at(index).ids() <= e.splat(label)))
                e.put(good, e.mask_bits(first))
            write_down(e, self.buffer, out, e.load(self.buffer, index, I32), e.of_bits(e.get(good, I8, one=True)))
        e.put(self.total, e.get(out, I64, one=True))
        self._end(e.get(out, I64, one=True))
