"""Emits vector operations that broadcast a number to lanes, extract a lane, or permute lanes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from antdsl.machine_code.kernels.ir import IrBuilder, NumberType
from antdsl.machine_code.kernels.values import Number
from antdsl.machine_code.number_kinds import F32, LANE_COUNT


class VectorBuilder(IrBuilder[NumberType]):
    """Emits operations that move numbers between lanes."""

    def broadcast(self, value: NumberType) -> NumberType:
        """Return the value broadcast to all lanes."""
        if value.has_several_lanes:
            return value
        if value.name[0] not in "%@":
            return self.named_number(value.kind, f"splat ({value.typed_name})", LANE_COUNT, value.literal_value)
        none = Number(value.kind, "poison", lanes=LANE_COUNT)
        first = self.op("insertelement", value.kind, none, value, x=0)
        return self.op("shufflevector", value.kind, first, none, x=f"<{LANE_COUNT} x i32> zeroinitializer")

    def extract_lane(self, value: Number, lane: int) -> NumberType:
        """Return the number in one lane."""
        return self.op("extractelement", value.kind, value, x=lane, lanes=1)

    def combine_lanes(
        self, values: Iterable[NumberType], lanes: int = LANE_COUNT, base_vector: NumberType | None = None
    ) -> NumberType:
        """Return a vector of `lanes` lanes with `values`, single numbers, in its first lanes. The other lanes come from
        `base_vector`, or are undefined if it is None."""
        for lane, value in enumerate(values):
            previous = self.named_number(value.kind, "poison", lanes) if base_vector is None else base_vector
            base_vector = self.op("insertelement", value.kind, previous, value, x=lane)
        assert base_vector is not None
        return base_vector

    def shuffle(self, a: Number, b: Number, order: Sequence[int]) -> NumberType:
        """Return a vector with lanes selected from `a` and `b`. `order`: indices into the lanes of `a` followed by the lanes
        of `b`."""
        text = f"<{len(order)} x i32> <{', '.join(f'i32 {each}' for each in order)}>"
        return self.op("shufflevector", a.kind, a, b, x=text, lanes=len(order))

    def rotate_lanes(self, value: Number, lane_offset: int) -> NumberType:
        """Return a value with its lanes rotated: lane i receives the number of lane i + `lane_offset`, and the first lane
        follows the last."""
        return self.shuffle(
            value, Number(value.kind, "poison", lanes=LANE_COUNT), [(k + lane_offset) % LANE_COUNT for k in range(LANE_COUNT)]
        )

    def transpose_rows(self, rows: Sequence[Number]) -> list[NumberType]:
        """Return the four columns of a matrix with eight rows of four numbers, with as few instructions as possible."""
        eight = range(LANE_COUNT)
        if rows[0].kind == F32:
            a, b, c, d = (self.shuffle(rows[k], rows[k + 4], eight) for k in range(4))
            low, high = (0, 8, 1, 9, 4, 12, 5, 13), (2, 10, 3, 11, 6, 14, 7, 15)
            halves = [(self.shuffle(a, b, order), self.shuffle(c, d, order)) for order in (low, high)]
            even, odd = (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)
            return [self.shuffle(x, y, order) for x, y in halves for order in (even, odd)]
        pairs = [self.shuffle(rows[k], rows[k + 2], eight) for k in (0, 1, 4, 5)]
        output = []
        for first in (0, 1):
            order = tuple(e + other for e in range(first, LANE_COUNT, 2) for other in (0, LANE_COUNT))
            x, y = (self.shuffle(pairs[k], pairs[k + 1], order) for k in (0, 2))
            output.append([self.shuffle(x, y, tuple(e + k for e in (0, 1, 4, 5, 8, 9, 12, 13))) for k in (0, 2)])
        return [output[first][half] for half in (0, 1) for first in (0, 1)]
