"""Emits loads and stores of array elements, either for one iteration of a loop or for several in SIMD lanes.

If the elements of all lanes are contiguous in memory, one instruction loads or stores all of them. Otherwise they are loaded or
stored one by one. Inactive lanes read from a dummy address and store nothing."""

from __future__ import annotations

import ast

from antdsl.machine_code.kernels.arithmetic import ArithmeticEmitter
from antdsl.machine_code.kernels.ir import ZEROS_CONSTANT
from antdsl.machine_code.kernels.types import INT, TRUTH, ScalarType
from antdsl.machine_code.kernels.values import Array, Number, make_literal_number
from antdsl.machine_code.number_kinds import LANE_COUNT

ALL_LANES = Number(TRUTH, "splat (i1 true)", True, LANE_COUNT)  # all iterations are active


class ElementAccess(ArithmeticEmitter):
    """Emits loads and stores of array elements."""

    def check_index(self, node: ast.AST, index: Number, length: Number, count: int = 1) -> None:
        """Emit a check that the indices `index` to `index + count - 1` are within an axis of `length` elements. Raises
        NotInSubsetError if a constant index is outside."""
        if index.literal_value is not None and (
            index.literal_value < 0 or (length.literal_value is not None and index.literal_value + count > length.literal_value)
        ):
            self.fail(node, f"{index.literal_value} is negative or outside the axis")
        if index.literal_value is None or length.literal_value is None:
            counts = None if index.has_several_lanes else self.get_active_mask()
            if counts is not None:
                index, length = (
                    self.select(counts, index, make_literal_number(0)),
                    self.select(counts, length, make_literal_number(count)),
                )
            self.emit_void(
                "index",
                index,
                length,
                *([self.mask] if index.has_several_lanes and self.mask is not None else []),
                x=count,
                node=node,
            )

    def _emit_span_check(self, array: Array, first: Number, count: int = LANE_COUNT) -> None:
        """Emit a check that the elements `first` to `first + count - 1` are in the array."""
        self.emit_void("span", first, *array.lengths, x=count)

    def emit_index_offset(self, node: ast.AST, array: Array, numbers: list[Number]) -> Number:
        """Return the offset of the element with indices `numbers`, counted in elements from the start of the array."""
        for each in numbers:
            if each.lane_type != "i64":
                self.fail(node, "an index must be an integer of at least 0")
        for each, length in zip(numbers, array.lengths, strict=True):
            self.check_index(node, each, length)
        steps = array.steps
        place = numbers[0] if steps is None else self.apply_operator(node, ast.Mult(), numbers[0], steps[0])
        for k, number in enumerate(numbers[1:], 1):
            if steps is None:
                place = self.apply_operator(node, ast.Mult(), place, array.lengths[k])
            else:
                number = self.apply_operator(node, ast.Mult(), number, steps[k])
            place = self.apply_operator(node, ast.Add(), place, number)
        return place

    def count_elements(self, array: Array) -> Number:
        """Return the number of elements of an array."""
        total = array.lengths[0]
        for each in array.lengths[1:]:
            total = self.op("mul", INT, total, each)
        return total

    def load_element(self, array: Array, index: Number) -> Number:
        """Load the element at an offset of `index` elements from the first one."""
        scalar = array.element_type
        if not index.has_several_lanes:
            element = self.op("load", scalar.loaded_kind, self._guarded_address(array, index))
        elif index.first_lane:
            self._emit_span_check(array, index.first_lane)
            element = self._load_lanes(array, scalar.loaded_kind, self._offset_address(array, index.first_lane))
        else:
            element = self._emit_gather(array, index)
        if scalar.kind == TRUTH:
            return self.op(
                "ne", TRUTH, element, Number("i8", "zeroinitializer" if index.has_several_lanes else "0", lanes=index.lanes)
            )
        if scalar.kind == INT and scalar.stored_type != "i64":
            return self.op("zext" if scalar.name.startswith("U") else "sext", INT, element)
        return element

    def _load_lanes(self, array: Array, kind: str, place: Number) -> Number:
        """Load consecutive elements, one per lane. The first one is at the address `place`."""
        return self.op("load", kind, place, x=_find_element_alignment(array), lanes=LANE_COUNT)

    def store_element(self, node: ast.AST, array: Array, index: Number, item: Number) -> None:
        """Store `item` as the element at an offset of `index` elements from the first one."""
        if (self.mask is not None) != index.has_several_lanes:
            self.fail(node, "several iterations of the loop would write to this element at once")
        value = self.to_stored_kind(array.element_type, self.broadcast(item) if index.has_several_lanes else item)
        if not index.has_several_lanes:
            self.emit_void("store", value, self._offset_address(array, index))
            return
        mask = self.mask or ALL_LANES
        if index.first_lane:
            self._emit_span_check(array, index.first_lane)
            place = self._offset_address(array, index.first_lane)
            if mask.literal_value is None:
                value = self.op("select", value.kind, mask, value, self._load_lanes(array, value.kind, place))
            self.emit_void("store", value, place, x=_find_element_alignment(array))
            return
        for lane in range(LANE_COUNT):
            stored, next_block = "", ""
            if mask.literal_value is None:
                stored, next_block = self.make_label("stored"), self.make_label("after")
                self.branch(self.extract_lane(mask, lane), stored, next_block)
                self.begin_block(stored)
            place = self._offset_address(array, self.extract_lane(index, lane))
            self.emit_void("store", self.extract_lane(value, lane), place)
            if next_block:
                self.jump(next_block)
                self.begin_block(next_block)

    def to_stored_kind(self, scalar: ScalarType, item: Number) -> Number:
        """Convert a number to the form in which an array with elements of type `scalar` stores it."""
        value = self.convert(item, scalar.kind)
        if value.kind == TRUTH:
            return self.op("zext", "i8", value)
        return value if value.lane_type == scalar.stored_type else self.op("trunc", scalar.stored_type, value)

    def get_row(self, node: ast.AST, array: Array, index: Number) -> Array:
        """Return the subarray at `index` along the first axis. It has one axis fewer than `array`."""
        if index.has_several_lanes:
            self.fail(node, "all lanes use the same part of an array: its index cannot depend on the iteration")
        self.check_index(node, index, array.lengths[0])
        step = make_literal_number(1) if array.steps is None else array.steps[0]
        for each in array.lengths[1:] if array.steps is None else ():
            step = self.apply_operator(node, ast.Mult(), step, each)
        address = self._offset_address(array, self.apply_operator(node, ast.Mult(), index, step))
        return Array(
            array.element_type, address, array.lengths[1:], None if array.steps is None else array.steps[1:], array.origin
        )

    def _offset_address(self, array: Array, index: Number) -> Number:
        """Return the address of the element at an offset of `index` elements."""
        return self._element_address(array, array.address, index)

    def _element_address(self, array: Array, address: Number, offset: Number | int) -> Number:
        """Return the address of the element that is `offset` elements after `address`."""
        index = Number(INT, str(offset)) if isinstance(offset, int) else offset
        return self.op("element", "ptr", address, index, x=array.element_type.stored_type, lanes=index.lanes)

    def _guarded_address(self, array: Array, index: Number) -> Number:
        """Return the address of the element at a loop-invariant index. If no iteration is active, the index may be out of range;
        the result is then the address of a block of zeros. The code compares the index with the array's length instead of using
        the mask, because LLVM can then move the load out of loops."""
        place = self._offset_address(array, index)
        if self.mask is None or self.is_always_reached:
            return place
        if array.steps is not None:
            counts = self.emit_any_lane(self.mask)
        else:
            counts = self.emit_logical_and(
                self.compare("ge", index, make_literal_number(0)), self.compare("lt", index, self.count_elements(array))
            )
        return place if counts.literal_value is not None else self.op("select", "ptr", counts, place, ZEROS_CONSTANT)

    def _emit_lane_addresses(self, array: Array, index: Number) -> Number:
        """Return one element address per lane. Inactive lanes get the address of a block of zeros to which no code writes."""
        addresses = self._offset_address(array, index)
        if self.mask is None or self.mask.literal_value is not None:
            return addresses
        return self.op("select", "ptr", self.mask, addresses, self.broadcast(ZEROS_CONSTANT))

    def load_consecutive(self, node: ast.AST, array: Array, index: Number, count: int) -> tuple[Number, ...]:
        """Return `count` consecutive elements of an array, converted to the kind that kernels compute with. `count` is a multiple
        of four."""
        self.check_index(node, index, array.lengths[0], count)
        if not index.has_several_lanes:
            offsets = [self.apply_operator(node, ast.Add(), index, make_literal_number(k)) for k in range(count)]
            return tuple(self.load_element(array, each) for each in offsets)
        addresses = self._emit_lane_addresses(array, index)
        lanes = [self.extract_lane(addresses, lane) for lane in range(LANE_COUNT)]
        return tuple(each for k in range(0, count, 4) for each in self._load_four_columns(array, lanes, k))

    def _load_four_columns(self, array: Array, lanes: list[Number], offset: int) -> list[Number]:
        """Return the elements at the offsets `offset` to `offset + 3`, as one eight-lane number per offset. `lanes`: the base
        address of each lane."""
        rows = []
        for lane in lanes:
            place = self._element_address(array, lane, offset)
            rows.append(self.op("load", array.element_type.kind, place, x=_find_element_alignment(array), lanes=4))
        return self.transpose_rows(rows)

    def load3(self, node: ast.AST, array: Array, row: Number) -> tuple[Number, ...]:
        """Return the three elements of a row of an array (n, 3)."""
        if not row.first_lane:
            return tuple(self.load_element(array, each) for each in self._emit_row_offsets(node, array, row))
        self.check_index(node, row, array.lengths[0])
        return self._load3_lanes(array, row.first_lane)

    def _load3_lanes(self, array: Array, first: Number) -> tuple[Number, ...]:
        """Return the three elements of consecutive rows, one row per lane, from row `first` on."""
        place, parts = self._rows_address(array, first), []
        for k in range(3):
            parts.append(self._load_lanes(array, array.element_type.kind, self._element_address(array, place, LANE_COUNT * k)))
        columns = []
        for column in range(3):
            positions = range(column, 3 * LANE_COUNT, 3)
            low = self.shuffle(parts[0], parts[1], tuple(k if k < 2 * LANE_COUNT else 0 for k in positions))
            order = tuple(k - LANE_COUNT if k >= 2 * LANE_COUNT else lane for lane, k in enumerate(positions))
            columns.append(self.shuffle(low, parts[2], order))
        return tuple(columns)

    def _rows_address(self, array: Array, first: Number) -> Number:
        """Return the address of row `first` of an array (n, 3). Emit a check that the rows of all lanes are in the array."""
        start = self.op("mul", INT, first, Number(INT, "3"))
        self._emit_span_check(array, start, 3 * LANE_COUNT)
        return self._offset_address(array, start)

    def store3(self, node: ast.AST, array: Array, row: Number, items: tuple[Number, ...]) -> None:
        """Store `items` as the three elements of a row of an array (n, 3)."""
        if not row.first_lane:
            for at, item in zip(self._emit_row_offsets(node, array, row), items, strict=True):
                self.store_element(node, array, at, item)
            return
        self.check_index(node, row, array.lengths[0])
        kind, mask = array.element_type.kind, self.mask or ALL_LANES
        values = [self.broadcast(self.convert(each, kind)) for each in items]
        if mask.literal_value is None:
            values = [self.select(mask, *each) for each in zip(values, self._load3_lanes(array, row.first_lane), strict=True)]
        place = self._rows_address(array, row.first_lane)
        for part in range(3):
            positions = [divmod(k, 3) for k in range(LANE_COUNT * part, LANE_COUNT * (part + 1))]
            two = self.shuffle(values[0], values[1], tuple(lane + LANE_COUNT * (c == 1) for lane, c in positions))
            order = tuple(LANE_COUNT + lane if c == 2 else k for k, (lane, c) in enumerate(positions))
            address = self._element_address(array, place, LANE_COUNT * part)
            self.emit_void("store", self.shuffle(two, values[2], order), address, x=_find_element_alignment(array))

    def _emit_row_offsets(self, node: ast.AST, array: Array, row: Number) -> list[Number]:
        """Return the offsets of a row's elements from the first element of an array."""
        return [self.emit_index_offset(node, array, [row, make_literal_number(k)]) for k in range(3)]

    def prefetch(self, array: Array, index: Number) -> tuple[()]:
        """Prefetch the memory of an element."""
        for lane in range(LANE_COUNT if index.has_several_lanes else 1):
            self.emit_void(
                "prefetch", self._offset_address(array, self.extract_lane(index, lane) if index.has_several_lanes else index)
            )
        return ()

    def _emit_gather(self, array: Array, index: Number) -> Number:
        """Load one element per lane, each at its own offset, with single loads."""
        addresses = self._emit_lane_addresses(array, index)
        return self.combine_lanes(
            self.op("load", array.element_type.loaded_kind, self.extract_lane(addresses, lane)) for lane in range(LANE_COUNT)
        )


def _find_element_alignment(array: Array) -> str:
    """Return the alignment to use for vector loads and stores, in bytes: the size of one element."""
    return f", align {array.element_type.dtype.itemsize}"
