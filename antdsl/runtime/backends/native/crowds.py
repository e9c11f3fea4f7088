"""The search for agents with very many neighbours: one at a time, any number of candidates, and the cap by distance and id."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
            buffer, count = _all(w, near, place, list(radius.values()))
            sums = [Sum(e, node, many=False) for node in near.nodes]
            for each in sums:
                each.start()
            itself = e.splat(e.convert(row, I32)) if near.other == b.species else None
            measure = _Measure(w, near, place, itself, buffer, count)
            cuts = {chosen: _cut(measure, near, size, chosen, lane) for chosen, size in radius.items()}
            heading = [e.splat(e.load_one(w.base("start", f"heading.{axis}"), row, F32)) for axis in AXES] if near.view else []
            with e.loop(count, WIDTH) as at:
                found = measure.at(at)

                def inside(chosen: ir.Node) -> Lanes:
                    reached = cuts[chosen](found, found.there & (found.distance <= radius[chosen]))
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


def _all(w: Writer, near: Search, place: list[Lanes], radii: list[Lanes]) -> tuple[Lanes, Lanes]:
    """Write down the agents that may be in the widest of some radii: where they stand in the grid's order. Gives where that is,
    and how many; the list goes on with zeros to a multiple of eight."""
    e = w.e
    buffer, total = w.base("candidates"), e.slot(I64, one=True)
    e.put(total, e.constant(0, I64, one=True))
    search = Rows(w, near.number, place, radii, e.constant(True, BOOL))
    limit = (search.widest * search.widest) * np.float32(BEYOND) + np.float32(1e-30)

    def through(first: Lanes, number: Lanes) -> None:
        begin, count = (e.one(f"extractelement {each.typed}, i64 0", I32) for each in (first, number))
        with e.loop(e.convert(count, I64), WIDTH) as k:
            turn = e.convert(k, I32)
            at = e.one(f"add i32 {begin.name}, {turn.name}", I32)
            places = e.splat(at) + e.convert(e.iota(), I32)
            there = (e.splat(turn) + e.convert(e.iota(), I32)) < e.splat(count)
            found = measured(w, near, e.where(there, places, e.constant(0, I32)), place, there)
            square = (found.dx * found.dx + found.dy * found.dy) + found.dz * found.dz
            write_down(e, buffer, total, at, there & (square <= limit))

    search.each(through)
    count = e.get(total, I64, one=True)
    e.do(f"store <{WIDTH} x i32> zeroinitializer, ptr {e.address(buffer, count, I32).name}, align 4")
    return buffer, count


@dataclass(slots=True, eq=False)
class _Measure:
    """Measures what was written down about one asking agent."""

    w: Writer
    near: Search
    place: list[Lanes]
    itself: Lanes | None
    buffer: Lanes
    count: Lanes

    def at(self, index: Lanes) -> Found:
        """Eight candidates from an index on."""
        e = self.w.e
        there = (e.splat(index) + e.iota()) < e.splat(self.count)
        at = e.where(there, e.load(self.buffer, index, I32), e.constant(0, I32))
        found = measured(self.w, self.near, at, self.place, there)
        if self.itself is not None:
            found.there = there & (found.rows != self.itself)
        return found


def _cut(measure: _Measure, near: Search, radius: Lanes, chosen: ir.Node, lane: Lanes) -> Callable[[Found, Lanes], Lanes]:
    """Where more others are in a radius than the cap, only the nearest count, by (distance, id): the bits of their distance, as a
    whole number, and their id are at most those of the last one that counts, which is found by halving. Gives what asks that of
    eight pairs. More than `limits.WITHIN_RADIUS` are told, where more than the nearest is asked for."""
    w, e = measure.w, measure.w.e
    far, last = e.slot(I32, one=True), e.slot(I64, one=True)
    e.do(f"store i32 {(1 << 31) - 1}, ptr {far}")
    e.do(f"store i64 {NO_LABEL}, ptr {last}")
    crowd = None
    if chosen in near.stops:
        crowd = e.address(Lanes(e, PTR, e.field("%out", STRIDE * near.stops[chosen]), one=True), lane, I8).name
        e.do(f"store i8 0, ptr {crowd}")

    def count(test: Callable[[Found, Lanes], Lanes]) -> Lanes:
        """How many in the radius pass a test."""
        counted = e.slot(I32)
        e.put(counted, e.constant(0, I32))
        with e.loop(measure.count, WIDTH) as index:
            found = measure.at(index)
            good = test(found, found.there & (found.distance <= radius))
            e.put(counted, e.get(counted, I32) + e.convert(good, I32))
        w.module.declare("llvm.vector.reduce.add.v8i32", I32, [f"<{WIDTH} x i32>"])
        return e.one(f"call i32 @llvm.vector.reduce.add.v8i32({e.get(counted, I32).typed})", I32)

    def least(place: str, kind: str, most: int, turns: int, enough: Callable[[Lanes], Lanes]) -> None:
        """The least whole number from 0 to `most` that is enough."""
        low, high = e.slot(kind, one=True), e.slot(kind, one=True)
        e.do(f"store {kind} 0, ptr {low}")
        e.do(f"store {kind} {most}, ptr {high}")
        with e.loop(e.constant(turns, I64, one=True)):
            a, z = e.get(low, kind, one=True), e.get(high, kind, one=True)
            wide = e.one(f"sub {kind} {z.name}, {a.name}", kind)
            middle = e.one(f"add {kind} {a.name}, {e.one(f'lshr {kind} {wide.name}, 1', kind).name}", kind)
            good = enough(middle)
            above = e.one(f"add {kind} {middle.name}, 1", kind)
            over = e.one(f"icmp sgt {kind} {above.name}, {z.name}", BOOL)
            above = e.one(f"select i1 {over.name}, {kind} {z.name}, {kind} {above.name}", kind)
            e.put(low, e.one(f"select i1 {good.name}, {kind} {a.name}, {kind} {above.name}", kind))
            e.put(high, e.one(f"select i1 {good.name}, {kind} {middle.name}, {kind} {z.name}", kind))
        e.put(place, e.get(high, kind, one=True))

    cap = limits.NEIGHBOURS
    with e.inside(e.one(f"icmp sgt i64 {measure.count.name}, {cap}", BOOL)):
        every = count(lambda found, good: good)
        with e.inside(e.one(f"icmp sgt i32 {every.name}, {cap}", BOOL)):
            if crowd is not None:
                stops = e.one(f"icmp sgt i32 {every.name}, {limits.WITHIN_RADIUS}", BOOL)
                e.do(f"store i8 {e.one(f'zext i1 {stops.name} to i8', I8).name}, ptr {crowd}")

            def by_distance(middle: Lanes) -> Lanes:
                bound = e.splat(middle)
                number = count(lambda found, good: good & (e.bits(found.distance, I32) <= bound))
                return e.one(f"icmp sge i32 {number.name}, {cap}", BOOL)

            least(far, I32, (1 << 31) - 1, 32, by_distance)
            reach = e.splat(e.get(far, I32, one=True))
            nearer = count(lambda found, good: good & (e.bits(found.distance, I32) < reach))
            rest = e.one(f"sub i32 {cap}, {nearer.name}", I32)

            def by_id(middle: Lanes) -> Lanes:
                bound = e.splat(middle)
                number = count(lambda found, good: good & (e.bits(found.distance, I32) == reach) & (found.ids() <= bound))
                return e.one(f"icmp sge i32 {number.name}, {rest.name}", BOOL)

            least(last, I64, NO_LABEL, 64, by_id)

    reach, label = e.splat(e.get(far, I32, one=True)), e.splat(e.get(last, I64, one=True))

    def counts(found: Found, inside: Lanes) -> Lanes:
        """Those of eight that count."""
        bits = e.bits(found.distance, I32)
        return inside & ((bits < reach) | ((bits == reach) & (found.ids() <= label)))

    return counts
