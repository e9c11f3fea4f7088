"""Machine code that accumulates the results of reductions over pairs. The eight SIMD lanes are either eight requesting agents, or
eight parts of one agent's pairs. The terms of a sum are multiples of one quantum, so their additions need no rounding, and their
order does not matter (`numerics.exact_sums`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from antdsl.machine_code.kernels.values import Number
from antdsl.machine_code.lanes import LaneBuilder, Lanes
from antdsl.machine_code.number_kinds import F32, F64, I32, I64, LANE_COUNT
from antdsl.numerics import exact_sums
from antdsl.plan import ir

NO_LABEL = (1 << 63) - 1


@dataclass(slots=True, eq=False)
class LaneReduction:
    """The intermediate values of one reduction over pairs, stored on the stack.

    The eight lanes are either eight requesting agents, or eight parts of one agent's pairs. A label is the id or number that a
    reduction such as `nearest` returns."""

    builder: LaneBuilder
    reduction_node: ir.PlanNode
    needs_two_words: bool  # whether there are more terms than float64 adds exactly
    _stack_slots: list[tuple[Number, str]] = field(default_factory=list)  # stack slots with their kinds

    def allocate_values(self) -> None:
        """Allocate the intermediate values on the stack, and initialise them."""
        for k, row in enumerate(INITIAL_VALUES[self.reduction_node.op]):
            if k == 0 or self.needs_two_words or self.reduction_node.op != "reduce.sum":
                self._stack_slots.append((self.builder.allocate_slot(row[0], LANE_COUNT), row[0]))
                self._write_accumulator(k, self.builder.make_constant(row[1], row[0]))

    def emit_add_term(self, mask: Lanes, body: Lanes | None, label: Lanes | None) -> None:
        """Emit code that adds a term to the lanes in `mask`. The term is `body`. If the reduction selects a label, such as
        `nearest`, it stores the `label` of the least `body`."""
        e = self.builder
        match self.reduction_node.op:
            case "reduce.sum":
                assert body is not None
                term = self._round_term(e.select_lanes(mask, body, e.make_constant(0.0, F32)))
                if self.needs_two_words:
                    quantum = int(self.reduction_node.attrs[0])
                    magic = float(np.ldexp(1.5, quantum + exact_sums.LOW_WORD_BITS + 52))
                    high = (term + magic) - magic
                    self._write_accumulator(0, self._read_accumulator(0) + high)
                    self._write_accumulator(1, self._read_accumulator(1) + (term - high))
                else:
                    self._write_accumulator(0, self._read_accumulator(0) + term)
            case "reduce.count":
                self._write_accumulator(0, self._read_accumulator(0) + e.convert(mask, I32))
            case "reduce.any":
                self._write_accumulator(0, self._read_accumulator(0) | e.convert(mask, I32))
            case "reduce.min":
                assert body is not None
                least = self._read_accumulator(0)
                self._write_accumulator(0, e.select_lanes(mask & (body < least), body, least))
            case "reduce.max":
                assert body is not None
                most = self._read_accumulator(0)
                self._write_accumulator(0, e.select_lanes(mask & (body > most), body, most))
            case _:
                assert body is not None and label is not None
                least, best_label = self._read_accumulator(0), self._read_accumulator(1)
                better = mask & ((body < least) | ((body == least) & (label < best_label)))
                self._write_accumulator(0, e.select_lanes(better, body, least))
                self._write_accumulator(1, e.select_lanes(better, label, best_label))

    def _read_accumulator(self, part: int) -> Lanes:
        place, kind = self._stack_slots[part]
        return self.builder.load(place, kind, LANE_COUNT)

    def _write_accumulator(self, part: int, value: Lanes) -> None:
        self.builder.store_number(self._stack_slots[part][0], value)

    def _round_term(self, body: Lanes) -> Lanes:
        """Emit code that rounds a term to a multiple of the reduction's quantum. Same as `exact_sums.quantise_terms`."""
        quantum = int(self.reduction_node.attrs[0])
        bound, magic = float(np.ldexp(1.0, quantum + exact_sums.MAX_TERM_EXPONENT)), float(np.ldexp(1.5, quantum + 52))
        if float(np.float32(bound)) == bound:  # then clamping before the conversion gives the same result
            body, bound = self.builder.apply_function(np.clip, body, -np.float32(bound), np.float32(bound)), np.inf
        wide = self.builder.convert(body, F64)
        if bound < np.inf:
            wide = self.builder.apply_function(np.clip, wide, -bound, bound)
        rounded: Lanes = (wide + magic) - magic
        return rounded

    def emit_result(self) -> Lanes:
        """Emit code that computes the result of each lane from its intermediate values. Return the results."""
        e = self.builder
        match self.reduction_node.op:
            case "reduce.sum":
                total = self._read_accumulator(0)
                if self.needs_two_words:
                    total = total + self._read_accumulator(1)
                return e.convert(total, F32)
            case "reduce.count":
                return e.convert(self._read_accumulator(0), F32)
            case "reduce.any":
                return self._read_accumulator(0) != 0
            case "reduce.min" | "reduce.max":
                return self._read_accumulator(0) + np.float32(0)
        label = self._read_accumulator(1)
        label = e.select_lanes(label == NO_LABEL, e.make_constant(-1, I64), label)
        return label if self.reduction_node.op == "reduce.agent" else e.convert(label, I32)

    def emit_combine_lanes(self) -> None:
        """Emit code that combines the intermediate values of all eight lanes, and stores the combination in each lane."""
        for half in (4, 2, 1):
            self._emit_combine_with(
                [self.builder.rotate_lanes(self._read_accumulator(k), half) for k in range(len(self._stack_slots))]
            )

    def _emit_combine_with(self, other_reduction: list[Lanes]) -> None:
        """Emit code that combines the intermediate values with `other`, lane by lane."""
        e, a = self.builder, other_reduction[0]
        match self.reduction_node.op:
            case "reduce.sum" | "reduce.count":
                for k, value in enumerate(other_reduction):
                    self._write_accumulator(k, self._read_accumulator(k) + value)
            case "reduce.any":
                self._write_accumulator(0, self._read_accumulator(0) | a)
            case "reduce.min":
                mine = self._read_accumulator(0)
                self._write_accumulator(0, e.select_lanes(a < mine, a, mine))
            case "reduce.max":
                mine = self._read_accumulator(0)
                self._write_accumulator(0, e.select_lanes(a > mine, a, mine))
            case _:
                mine, best_label, label = self._read_accumulator(0), self._read_accumulator(1), other_reduction[1]
                better = (a < mine) | ((a == mine) & (label < best_label))
                self._write_accumulator(0, e.select_lanes(better, a, mine))
                self._write_accumulator(1, e.select_lanes(better, label, best_label))


INITIAL_VALUES: dict[str, tuple[tuple[str, Any], ...]] = {
    "reduce.sum": ((F64, 0.0), (F64, 0.0)),
    "reduce.count": ((I32, 0),),
    "reduce.any": ((I32, 0),),
    "reduce.min": ((F32, np.inf),),
    "reduce.max": ((F32, -np.inf),),
    "reduce.agent": ((F32, np.inf), (I64, NO_LABEL)),
    "reduce.item": ((F32, np.inf), (I64, NO_LABEL)),
}
