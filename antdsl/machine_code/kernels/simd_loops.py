"""Emits loops with independent iterations: eight iterations run at once in SIMD lanes, and the remaining ones run one by one.

Each number of an iteration becomes a vector of eight, each condition a mask. Code under a condition runs if its mask is true
for at least one iteration, and it affects only the iterations in the mask. Inner loops run until all iterations have left
them, and functions until all iterations have returned a value (M. Pharr, W. R. Mark, ispc: A SPMD compiler for
high-performance CPU programming, InPar 2012)."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from antdsl.machine_code.kernels.element_access import ALL_LANES
from antdsl.machine_code.kernels.ir import IrFunction
from antdsl.machine_code.kernels.kernel_unit import KernelUnit, StackVariable, result_type
from antdsl.machine_code.kernels.records import rebuild_like
from antdsl.machine_code.kernels.statements import StatementWriter, count_assigned_names
from antdsl.machine_code.kernels.types import INT, TRUTH
from antdsl.machine_code.kernels.values import KernelItem, Number, flatten_item, make_literal_number, make_type_key, rename_item
from antdsl.machine_code.number_kinds import LANE_COUNT

_EXIT_STATEMENTS = (ast.Break, ast.Continue, ast.Return)


@dataclass(slots=True)
class LoopMasks:
    """The stack slots of the two masks that a loop or function uses.

    - `remaining_mask`: the iterations that have not left the loop or function
    - `active_mask`: the iterations that run the code that follows"""

    remaining_mask: Number
    active_mask: Number


class SimdWriter(StatementWriter):
    """Emits the instructions of a function, either for one iteration or for several in SIMD lanes."""

    def __init__(self, unit: KernelUnit, part: Any, mask: Number | None = None) -> None:
        super().__init__(unit, *part.source())
        self.gives = part.types().get("return", Any)
        self.loop_masks: list[LoopMasks] = []
        self.result_variables: list[StackVariable] = []
        self.unwritten_slots: set[Number] = set()  # slots that no iteration has written to yet
        if mask is not None:
            self.mask = mask
            self._begin_masks()

    def _begin_masks(self) -> LoopMasks:
        """Begin a loop or a function for the active lanes. Return its masks, which initially contain all active lanes."""
        assert self.mask is not None
        turns = LoopMasks(self.allocate_slot(TRUTH, LANE_COUNT), self.allocate_slot(TRUTH, LANE_COUNT))
        self.store_number(turns.remaining_mask, self.mask)
        self.store_number(turns.active_mask, self.mask)
        self.loop_masks.append(turns)
        return turns

    # --- variables -----------------------------------------------------------------------------------------------------

    def make_variable(self, item: Number) -> StackVariable:
        if self.mask is None:
            return super().make_variable(item)
        place = self.allocate_slot(item.kind, LANE_COUNT)
        self.unwritten_slots.add(place)
        return StackVariable(item.kind, place, LANE_COUNT)

    def assign(self, node: ast.AST, name: str, item: KernelItem) -> None:
        is_consecutive = self.mask is not None and isinstance(item, Number) and bool(item.first_lane)
        if (
            is_consecutive
            and self.mask == ALL_LANES
            and name not in self.variables
            and count_assigned_names(self.definition)[name] == 1
        ):
            self.variables[name] = item  # its value is still known to be consecutive over iterations
        else:
            super().assign(node, name, item)

    def set_variable(self, node: ast.AST, variable: StackVariable, value: Number) -> None:
        if self.mask is None:
            super().set_variable(node, variable, value)
            return
        if not variable.has_several_lanes:
            self.fail(node, "several iterations of the loop would assign this at once")
        value = self.broadcast(value)
        if self.mask.literal_value is None and variable.slot_address not in self.unwritten_slots:
            value = self.select(self.mask, value, self.load(variable.slot_address, variable.kind, LANE_COUNT))
        self.unwritten_slots.discard(variable.slot_address)
        self.store_number(variable.slot_address, value)

    # --- statements ----------------------------------------------------------------------------------------------------

    def _write_where(self, mask: Number, write: Callable[[], None]) -> None:
        """Call `write` to emit code that affects only the iterations in `mask`. The code is skipped if no iteration is in the
        mask."""
        outer_mask, reached, then, end = self.mask, self.reached_mask, self.make_label("then"), self.make_label("done")
        if mask.literal_value is None:
            self.branch(self.emit_any_lane(mask), then, end)
            self.begin_block(then)
        self.mask = self.reached_mask = mask
        write()
        self.mask, self.reached_mask, self.is_reachable = outer_mask, reached, True
        if mask.literal_value is None:
            self.jump(end)
            self.begin_block(end)

    def write_if(self, test: ast.expr, true_body: list[ast.stmt], false_body: list[ast.stmt]) -> None:
        if self.mask is None:
            super().write_if(test, true_body, false_body)
            return
        condition = self.emit_condition(test)
        if condition.literal_value is not None:
            self.write_block(true_body if condition.literal_value else false_body)
            return
        fresh = set(self.unwritten_slots)
        condition = self.broadcast(condition)
        outer_mask = self.mask
        self._write_where(self.emit_logical_and(outer_mask, condition), lambda: self.write_block(true_body))
        new_places = self.unwritten_slots - fresh
        self.unwritten_slots &= fresh
        if false_body:
            self._write_where(self.emit_logical_and(outer_mask, self.emit_not(condition)), lambda: self.write_block(false_body))
        self.unwritten_slots -= new_places
        self._write_remaining([*true_body, *false_body])

    def _write_remaining(self, body: list[ast.stmt]) -> None:
        """Remove from the mask the iterations that `body` ended by `break`, `continue` or `return`. Called after the code of
        `body`."""
        if _has_exits(body):
            assert self.mask is not None
            self.mask = self.emit_logical_and(self.mask, self.load(self.loop_masks[-1].active_mask, TRUTH, LANE_COUNT))

    def _clear_mask(self, place: Number) -> None:
        """Remove the active iterations from the mask in a stack slot."""
        assert self.mask is not None
        self.store_number(
            place, self.op("and", TRUTH, self.load(place, TRUTH, LANE_COUNT), self.emit_not(self.broadcast(self.mask)))
        )

    def exit_loop(self, is_break: bool) -> None:
        if self.mask is None:
            super().exit_loop(is_break)
            return
        self._clear_mask(self.loop_masks[-1].active_mask)
        if is_break:
            self._clear_mask(self.loop_masks[-1].remaining_mask)
        self.is_reachable = False

    def write_while(self, test: ast.expr, body: list[ast.stmt]) -> None:
        if self.mask is None:
            super().write_while(test, body)
            return
        outer_mask, turns = self.mask, self._begin_masks()
        head, inner, end = self.make_label("while"), self.make_label("body"), self.make_label("end")
        self.jump(head)
        self.begin_block(head)
        self.mask = self.load(turns.remaining_mask, TRUTH, LANE_COUNT)
        active_mask = self.emit_logical_and(self.mask, self.broadcast(self.emit_condition(test)))
        self.store_number(turns.remaining_mask, active_mask)
        self.store_number(turns.active_mask, active_mask)
        self.branch(self.emit_any_lane(active_mask), inner, end)
        self.begin_block(inner)
        reached = self.reached_mask
        self.mask = self.reached_mask = active_mask
        self.write_block(body)
        self.reached_mask = reached
        self.jump(head)
        self.begin_block(end)
        self._rejoin_after_loop(outer_mask, body)

    def _rejoin_after_loop(self, outer_mask: Number, body: list[ast.stmt]) -> None:
        """Restore the mask `outer_mask` after a loop. Iterations that returned from the function within the loop stay
        inactive."""
        self.loop_masks.pop()
        self.mask, self.is_reachable = outer_mask, True
        if any(isinstance(each, ast.Return) for statement in body for each in ast.walk(statement)):
            self.mask = self.emit_logical_and(outer_mask, self.load(self.loop_masks[-1].active_mask, TRUTH, LANE_COUNT))

    def write_range_loop(
        self, name: str, begin: Number, end: Number, step: int, body: list[ast.stmt], write: Callable[[], None] | None = None
    ) -> None:
        if self.mask is None:
            super().write_range_loop(name, begin, end, step, body, write)
            return
        write = write or (lambda: self.write_block(body))
        wide = begin.has_several_lanes or end.has_several_lanes
        begin, end = self.convert(begin, INT), self.convert(end, INT)
        if not wide and not _has_exits(body):
            self._write_uniform_loop(name, begin, end, step, write)
            return
        outer_mask, turns = self.mask, self._begin_masks()
        lanes = LANE_COUNT if wide else 1
        number = self.allocate_slot(INT, lanes)
        begin, end = (self.broadcast(begin), self.broadcast(end)) if wide else (begin, end)
        self.store_number(number, begin)
        head, inner, exit_label = self.make_label("for"), self.make_label("body"), self.make_label("end")
        self.jump(head)
        self.begin_block(head)
        at = self.load(number, INT, lanes)
        active_mask = self.emit_logical_and(
            self.load(turns.remaining_mask, TRUTH, LANE_COUNT), self.compare("lt" if step > 0 else "gt", at, end)
        )
        active_mask = self.broadcast(active_mask)
        self.store_number(turns.remaining_mask, active_mask)
        self.store_number(turns.active_mask, active_mask)
        self.branch(self.emit_any_lane(active_mask), inner, exit_label)
        self.begin_block(inner)
        reached = self.reached_mask
        self.mask, self.reached_mask, self.variables[name] = active_mask, active_mask, at
        write()
        self.reached_mask = reached
        self.store_number(number, self.apply_operator(ast.Pass(), ast.Add(), at, make_literal_number(step)))
        self.jump(head)
        self.begin_block(exit_label)
        self.variables.pop(name, None)
        self._rejoin_after_loop(outer_mask, body)

    def _write_uniform_loop(self, name: str, begin: Number, end: Number, step: int, write: Callable[[], None]) -> None:
        """Emit an inner loop with a range that is equal in all lanes. No lane leaves it early, so the mask does not change."""
        with self._write_scalar_loop(begin, end, step) as at:
            self.variables[name] = at
            fresh = set(self.unwritten_slots)
            write()
            self.unwritten_slots &= fresh
        self.variables.pop(name, None)

    @contextmanager
    def _write_scalar_loop(self, begin: Number, end: Number, step: int) -> Iterator[Number]:
        """Emit a loop over numbers that all lanes share. Yield the loop variable; the `with` block emits the body."""
        number = self.allocate_slot(INT)
        self.store_number(number, begin)
        head, inner, exit_label = self.make_label("for"), self.make_label("body"), self.make_label("end")
        self.jump(head)
        self.begin_block(head)
        at = self.load(number, INT)
        self.branch(self.compare("lt" if step > 0 else "gt", at, end), inner, exit_label)
        self.begin_block(inner)
        yield at
        self.store_number(number, self.apply_operator(ast.Pass(), ast.Add(), at, make_literal_number(step)))
        self.jump(head)
        self.begin_block(exit_label)

    def write_unrolled_loop(self, node: ast.AST, target: ast.expr, items: list[KernelItem], body: list[ast.stmt]) -> None:
        if self.mask is None:
            super().write_unrolled_loop(node, target, items, body)
            return
        left = _has_exits(body)
        outer_mask, turns = self.mask, self._begin_masks()
        for item in items:
            if left:
                self.mask = self.load(turns.remaining_mask, TRUTH, LANE_COUNT)
                self.store_number(turns.active_mask, self.mask)
            self.bind_target(node, target, item)
            self.write_block(body)
            self.is_reachable = True
        self.unbind_target(target)
        self._rejoin_after_loop(outer_mask, body)

    def write_return(self, node: ast.AST, item: KernelItem) -> None:
        if self.mask is None:
            super().write_return(node, item)
            return
        if self.has_return and make_type_key(self._broadcast_item(item)) != make_type_key(self.result):
            item = self.match_item(node, item, self.result)
        if not self.has_return:
            self.result_variables = [self.make_variable(self.broadcast(each)) for each in flatten_item(item)]
        self.result, self.has_return, self.is_reachable = self._broadcast_item(item), True, False
        for variable, each in zip(self.result_variables, flatten_item(item), strict=True):
            self.set_variable(node, variable, each)
        for turns in self.loop_masks:
            self._clear_mask(turns.active_mask)
            self._clear_mask(turns.remaining_mask)

    def _broadcast_item(self, item: KernelItem) -> KernelItem:
        """Return an item with each of its numbers broadcast to all lanes."""
        return rebuild_like(item, map(self._broadcast_item, item)) if isinstance(item, tuple) else self.broadcast(item)

    def end(self) -> None:
        """End a function that runs several iterations, and return their results."""
        if self.mask is None:
            super().end()
            return
        self.result = self.result or ()
        numbers = [self.load(each.slot_address, each.kind, LANE_COUNT) for each in self.result_variables]
        self.emit_return(rename_item(self.result, iter([each.name for each in numbers])))

    # --- loops and calls -----------------------------------------------------------------------------------------------

    def write_simd_loop(self, name: str, begin: Number, end: Number, body: list[ast.stmt]) -> None:
        if self.mask is not None or self.unit.lanes == 1:
            known = dict(self.variables)
            self.write_range_loop(name, begin, end, 1, body)
            if self.unit.lanes == 1:
                self.variables = known
            return
        begin, end = self.convert(begin, INT), self.convert(end, INT)
        count = self.op("sub", INT, end, begin)
        rest = self.op("and", INT, count, make_literal_number(-LANE_COUNT))
        none = self.op("slt", TRUTH, count, make_literal_number(0))
        middle = self.select(none, begin, self.op("add", INT, begin, rest))
        known, loops = dict(self.variables), self.loops
        with self._write_scalar_loop(begin, middle, LANE_COUNT) as at:
            steps = Number(INT, f"<{', '.join(f'i64 {k}' for k in range(LANE_COUNT))}>", lanes=LANE_COUNT)
            lanes = self.op("add", INT, self.broadcast(at), steps)
            self.mask, self.loops = ALL_LANES, []
            self._begin_masks()
            self.variables[name] = Number(INT, lanes.name, None, LANE_COUNT, at)
            self.write_block(body)
            self.loop_masks.pop()
            self.mask, self.is_reachable, self.variables, self.loops = None, True, dict(known), loops
        super().write_range_loop(name, middle, end, 1, body)
        self.variables = known  # names of an iteration are local to it

    def call_function(self, node: ast.Call, function: Any, inputs: list[KernelItem]) -> KernelItem:
        part = getattr(function, "part", None)
        if part is None:
            self.fail(node, f"`{ast.unparse(node.func)}` is not a function of kernels")
        types = part.types()
        for each, item in zip(part.source()[1].args.args, inputs, strict=False):
            self.fit_to_type(node, each.arg, item, types.get(each.arg, Any))
        wide = self.mask is not None and any(each.has_several_lanes for item in inputs for each in flatten_item(item))
        name, result = write_function(self.unit, part, inputs, wide)
        operands = [each for item in inputs for each in flatten_item(item)]
        if wide:
            assert self.mask is not None
            operands.append(self.mask)
        numbers = list(flatten_item(result))
        if not numbers:
            self.emit_void("call", *operands, x=name)
            return ()
        if len(numbers) == 1:
            value_names = [self.op("call", numbers[0].kind, *operands, x=name, lanes=numbers[0].lanes).name]
        else:
            aggregate = self.op("call", result_type(result), *operands, x=name, lanes=1)
            value_names = [
                self.op("extractvalue", each.kind, aggregate, x=k, lanes=each.lanes).name for k, each in enumerate(numbers)
            ]
        return rename_item(result, iter(value_names))


def _has_exits(body: list[ast.stmt]) -> bool:
    """Return whether these statements contain a `break`, `continue` or `return`."""
    return any(isinstance(each, _EXIT_STATEMENTS) for statement in body for each in ast.walk(statement))


def write_function(unit: KernelUnit, part: Any, inputs: list[KernelItem], in_lanes: bool = False) -> tuple[str, KernelItem]:
    """Return the name and result of the translation of `part` for these types of inputs.

    The first call for these types writes the function. `in_lanes`: whether the function runs several iterations in SIMD lanes.
    Its last argument is then the mask of the active iterations."""
    key = (part, ",".join(make_type_key(each) for each in inputs) + ("," if in_lanes else ""))
    if key not in unit.specialisations:
        name = f"@{part.function.__name__}.{len(unit.specialisations)}"
        unit.specialisations[key] = name, None
        numbers = iter(f"%x{k}" for k in range(100_000))
        own = [rename_item(each, numbers) for each in inputs]
        mask = Number(TRUTH, "%mask", lanes=LANE_COUNT) if in_lanes else None
        w = SimdWriter(unit, part, mask)
        arguments = [each for item in own for each in flatten_item(item)] + ([mask] if mask else [])
        w.run(own)
        unit.functions.append(IrFunction(name, w.file, arguments, part.attribute, result_type(w.result), w.slots, w.blocks))
        unit.specialisations[key] = name, w.result
    elif unit.specialisations[key][1] is None:
        raise RecursionError(f"{part} calls itself")
    return unit.specialisations[key]
