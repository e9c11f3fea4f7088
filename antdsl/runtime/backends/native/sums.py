"""What is added up over pairs, as machine code: running values of reductions, of eight asking agents or of one in eight parts.

Terms of sums are multiples of one quantum and add without rounding, so their order does not count (`numerics.exact_sums`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from antdsl.machine_code.emitter import Emitter
from antdsl.machine_code.lanes import F32, F64, I32, I64, WIDTH, Lanes
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
