"""What is added up over pairs, as machine code: running values of reductions, of eight asking agents or of one in eight parts.

Terms of sums are multiples of one quantum and add without rounding, so their order does not count (`numerics.exact_sums`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from antdsl.machine_code.emitter import Emitter
from antdsl.machine_code.lanes import BOOL, F32, F64, I32, I64, PTR, WIDTH, Lanes
from antdsl.numerics import exact_sums
from antdsl.plan import ir

NO_LABEL = (1 << 63) - 1


@dataclass(slots=True, eq=False)
class Sum:
    """Running values of one reduction, on the stack: of eight agents, or of one agent in eight parts."""

    e: Emitter
    node: ir.Node
    many: bool  # more terms than float64 adds exactly
    a: str = ""
    b: str = ""

    @property
    def _two(self) -> bool:
        return self.many or self.node.op != "reduce.sum"

    def start(self) -> None:
        e, op = self.e, self.node.op
        first, second = START[op]
        if not self.a:
            self.a = e.slot(first[0])
            self.b = e.slot(second[0]) if second is not None and self._two else ""
        for place, row in ((self.a, first), (self.b, second)):
            if row is not None and place:
                value = e.constant(*reversed(row))
                e.do(f"store {value.typed}, ptr {place}")

    def take(self, mask: Lanes, body: Lanes | None, label: Lanes | None) -> None:
        """Take in a term of each lane for which a condition holds."""
        e = self.e
        match self.node.op:
            case "reduce.sum":
                assert body is not None
                term = self._rounded(e.where(mask, body, e.constant(0.0, F32)))
                if self.many:
                    quantum = int(self.node.attrs[0])
                    magic = float(np.ldexp(1.5, quantum + exact_sums.HALF + 52))
                    high = (term + magic) - magic
                    self._put(self.a, self._at(self.a, F64) + high)
                    self._put(self.b, self._at(self.b, F64) + (term - high))
                else:
                    self._put(self.a, self._at(self.a, F64) + term)
            case "reduce.count":
                self._put(self.a, self._at(self.a, I32) + e.convert(mask, I32))
            case "reduce.any":
                self._put(self.a, self._at(self.a, I32) | e.convert(mask, I32))
            case "reduce.min":
                assert body is not None
                least = self._at(self.a, F32)
                self._put(self.a, e.where(mask & (body < least), body, least))
            case "reduce.max":
                assert body is not None
                most = self._at(self.a, F32)
                self._put(self.a, e.where(mask & (body > most), body, most))
            case _:
                assert body is not None and label is not None
                least, whose = self._at(self.a, F32), self._at(self.b, I64)
                better = mask & ((body < least) | ((body == least) & (label < whose)))
                self._put(self.a, e.where(better, body, least))
                self._put(self.b, e.where(better, label, whose))

    def _at(self, place: str, kind: str) -> Lanes:
        return self.e.get(place, kind)

    def _put(self, place: str, value: Lanes) -> None:
        self.e.put(place, value)

    def terms(self, mask: Lanes, body: Lanes | None, label: Lanes | None) -> list[Lanes]:
        """What `scatter` takes in: a term of each of eight pairs, which changes nothing where a condition does not hold."""
        e = self.e
        match self.node.op:
            case "reduce.sum":
                assert body is not None
                return [self._rounded(e.where(mask, body, e.constant(0.0, F32)))]
            case "reduce.count" | "reduce.any":
                return [e.convert(mask, I32)]
            case "reduce.min" | "reduce.max":
                assert body is not None
                return [e.where(mask & (body == body), body, e.constant(START[self.node.op][0][1], F32))]
        assert body is not None and label is not None
        good = mask & (body == body)
        return [e.where(good, body, e.constant(np.inf, F32)), e.where(good, label, e.constant(NO_LABEL, I64))]

    def scatter(self, lane: Lanes, terms: list[Lanes]) -> None:
        """Take in a single term of a single pair, of one of the eight asking agents (i64)."""
        e, kinds = self.e, [row[0] for row in START[self.node.op] if row is not None]
        place = e.address(Lanes(e, PTR, self.a, one=True), lane, kinds[0]).name
        before = e.get(place, kinds[0], one=True)
        term = terms[0].name
        match self.node.op:
            case "reduce.count":
                after = e.one(f"add i32 {before.name}, {term}", I32)
            case "reduce.any":
                after = e.one(f"or i32 {before.name}, {term}", I32)
            case "reduce.min" | "reduce.max":
                word = "olt" if self.node.op == "reduce.min" else "ogt"
                better = e.one(f"fcmp {word} float {term}, {before.name}", BOOL)
                after = e.one(f"select i1 {better.name}, float {term}, float {before.name}", F32)
            case _:
                other = e.address(Lanes(e, PTR, self.b, one=True), lane, I64).name
                whose, label = e.get(other, I64, one=True), terms[1].name
                less = e.one(f"fcmp olt float {term}, {before.name}", BOOL)
                same = e.one(f"fcmp oeq float {term}, {before.name}", BOOL)
                first = e.one(f"icmp slt i64 {label}, {whose.name}", BOOL)
                first = e.one(f"and i1 {same.name}, {first.name}", BOOL)
                better = e.one(f"or i1 {less.name}, {first.name}", BOOL)
                after = e.one(f"select i1 {better.name}, float {term}, float {before.name}", F32)
                e.put(other, e.one(f"select i1 {better.name}, i64 {label}, i64 {whose.name}", I64))
        e.put(place, after)

    def _rounded(self, body: Lanes) -> Lanes:
        """A term as a multiple of the quantum, as `exact_sums.rounded` gives it."""
        quantum = int(self.node.attrs[0])
        bound, magic = float(np.ldexp(1.0, quantum + exact_sums.BOUND)), float(np.ldexp(1.5, quantum + 52))
        if float(np.float32(bound)) == bound:  # cut before it is widened, which is the same
            body, bound = self.e.meaning(np.clip, body, -np.float32(bound), np.float32(bound)), np.inf
        wide = self.e.convert(body, F64)
        if bound < np.inf:
            wide = self.e.meaning(np.clip, wide, -bound, bound)
        rounded: Lanes = (wide + magic) - magic
        return rounded

    def result(self) -> Lanes:
        """The reduction of each lane."""
        e = self.e
        match self.node.op:
            case "reduce.sum":
                total = self._at(self.a, F64)
                if self.many:
                    total = total + self._at(self.b, F64)
                return e.convert(total, F32)
            case "reduce.count":
                return e.convert(self._at(self.a, I32), F32)
            case "reduce.any":
                return self._at(self.a, I32) != 0
            case "reduce.min" | "reduce.max":
                return self._at(self.a, F32) + np.float32(0)
        label = self._at(self.b, I64)
        label = e.where(label == NO_LABEL, e.constant(-1, I64), label)
        return label if self.node.op == "reduce.agent" else e.convert(label, I32)

    def fold(self) -> None:
        """Put what the eight parts hold together, into each of them."""
        e = self.e
        for width in (4, 2, 1):
            order = ", ".join(f"i32 {(k + width) % WIDTH}" for k in range(WIDTH))
            turned = {}
            for place, row in zip((self.a, self.b), START[self.node.op], strict=True):
                if row is not None and place:
                    value = self._at(place, row[0])
                    turned[place] = e.op(
                        f"shufflevector {value.typed}, <{WIDTH} x {row[0]}> poison, <{WIDTH} x i32> <{order}>", row[0]
                    )
            self._fold(turned)

    def _fold(self, other: dict[str, Lanes]) -> None:
        e = self.e
        a = other[self.a]
        match self.node.op:
            case "reduce.sum" | "reduce.count":
                for place, value in other.items():
                    self._put(place, self._at(place, value.kind) + value)
            case "reduce.any":
                self._put(self.a, self._at(self.a, I32) | a)
            case "reduce.min":
                mine = self._at(self.a, F32)
                self._put(self.a, e.where(a < mine, a, mine))
            case "reduce.max":
                mine = self._at(self.a, F32)
                self._put(self.a, e.where(a > mine, a, mine))
            case _:
                mine, whose, label = self._at(self.a, F32), self._at(self.b, I64), other[self.b]
                better = (a < mine) | ((a == mine) & (label < whose))
                self._put(self.a, e.where(better, a, mine))
                self._put(self.b, e.where(better, label, whose))


START: dict[str, tuple[tuple[str, Any], tuple[str, Any] | None]] = {
    "reduce.sum": ((F64, 0.0), (F64, 0.0)),
    "reduce.count": ((I32, 0), None),
    "reduce.any": ((I32, 0), None),
    "reduce.min": ((F32, np.inf), None),
    "reduce.max": ((F32, -np.inf), None),
    "reduce.agent": ((F32, np.inf), (I64, NO_LABEL)),
    "reduce.item": ((F32, np.inf), (I64, NO_LABEL)),
}


class Sums:
    """Running values of several reductions, of eight agents each. Four sums of an agent lie side by side and are added to at
    once."""

    def __init__(self, e: Emitter, nodes: list[ir.Node]) -> None:
        self.e, self.all = e, [Sum(e, node, many=False) for node in nodes]
        added = [k for k, node in enumerate(nodes) if node.op == "reduce.sum"]
        self._fours = [added[k : k + 4] for k in range(0, len(added), 4)]
        self._places = [e.slot(F64, count=4) for _ in self._fours]
        for place in self._places:
            for k in range(4):
                e.put(e.field(place, 64 * k), e.constant(0.0, F64))
        for each in self.all:
            if each.node.op != "reduce.sum":
                each.start()

    def scatter(self, lane: Lanes, terms: list[list[Lanes]]) -> None:
        """Add eight terms of each reduction to the values of the agents that they belong to, lanes i32."""
        e = self.e
        lanes = e.slot(I32)
        e.put(lanes, lane)
        fours = [self._turned([terms[k][0] for k in some]) for some in self._fours]
        stored = []
        for sum_, some in zip(self.all, terms, strict=True):
            slots = [e.slot(each.kind) for each in some] if sum_.node.op != "reduce.sum" else []
            for slot, each in zip(slots, some, strict=False):
                e.put(slot, each)
            stored.append([(slot, each.kind) for slot, each in zip(slots, some, strict=False)])
        for k in range(WIDTH):
            at = e.get(e.one(f"getelementptr i32, ptr {lanes}, i64 {k}", PTR).name, I32, one=True)
            whose = e.one(f"zext i32 {at.name} to i64", I64)
            for place, turned in zip(self._places, fours, strict=True):
                mine = e.one(f"getelementptr <4 x double>, ptr {place}, i64 {whose.name}", PTR).name
                before = e.one(f"load <4 x double>, ptr {mine}", F64).name
                after = e.one(f"fadd <4 x double> {before}, {turned[k]}", F64).name
                e.do(f"store <4 x double> {after}, ptr {mine}")
            for sum_, slots_ in zip(self.all, stored, strict=True):
                if slots_:
                    single = [
                        e.get(e.one(f"getelementptr {kind}, ptr {slot}, i64 {k}", PTR).name, kind, one=True)
                        for slot, kind in slots_
                    ]
                    sum_.scatter(whose, single)

    def _turned(self, terms: list[Lanes]) -> list[str]:
        """Of up to four times eight terms eight times four."""
        e, found = self.e, []
        four = [*(each.name for each in terms), *(e.constant(0.0, F64).name for _ in range(4 - len(terms)))]

        def shuffled(a: str, b: str, of: str, order: list[int]) -> str:
            text = ", ".join(f"i32 {k}" for k in order)
            return e.op(f"shufflevector {of} {a}, {of} {b}, <{len(order)} x i32> <{text}>", F64).name

        eight = f"<{WIDTH} x double>"
        for k in range(WIDTH):
            low = shuffled(four[0], four[1], eight, [k, k + WIDTH])
            high = shuffled(four[2], four[3], eight, [k, k + WIDTH])
            found.append(shuffled(low, high, "<2 x double>", [0, 1, 2, 3]))
        return found

    def results(self) -> list[Lanes]:
        """The reductions of the eight agents."""
        e = self.e
        found = {}
        for some, place in zip(self._fours, self._places, strict=True):
            rows = [e.one(f"load <4 x double>, ptr {e.field(place, 32 * k)}", F64).name for k in range(WIDTH)]
            for part, number in enumerate(some):
                value = "poison"
                for lane, row in enumerate(rows):
                    single = e.one(f"extractelement <4 x double> {row}, i64 {part}", F64).name
                    value = e.op(f"insertelement <{WIDTH} x double> {value}, double {single}, i64 {lane}", F64).name
                found[number] = e.convert(Lanes(e, F64, value), F32)
        return [found[k] if k in found else each.result() for k, each in enumerate(self.all)]
