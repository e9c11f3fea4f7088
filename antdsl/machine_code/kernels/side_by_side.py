"""Loops with iterations that do not depend on each other: eight run at once in SIMD lanes, the rest one by one.

Each number of an iteration becomes a vector of eight, each condition a mask. Code under a condition runs if its mask holds for at
least one iteration, and has an effect only for these iterations. Inner loops run until all iterations have left them, and
functions until all iterations have returned a value (M. Pharr, W. R. Mark, ispc: A SPMD compiler for high-performance CPU
programming, InPar 2012)."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from antdsl.machine_code.kernels.elements import ALL_LANES
from antdsl.machine_code.kernels.ir import IrFunction
from antdsl.machine_code.kernels.records import rebuild_like
from antdsl.machine_code.kernels.statements import StatementWriter, stored_names
from antdsl.machine_code.kernels.types import INT, TRUTH
from antdsl.machine_code.kernels.units import KernelUnit, StackVariable, result_type
from antdsl.machine_code.kernels.values import KernelItem, Number, constant, leaves, rename_item, type_key
from antdsl.machine_code.kinds import LANE_COUNT

_EXIT_STATEMENTS = (ast.Break, ast.Continue, ast.Return)


@dataclass(slots=True)
class LoopTurns:
    """The stack slots of two masks of a loop or function.

    - `inside`: the iterations that have not left it
    - `now`: the iterations that run the code that follows"""

    inside: Number
    now: Number


class SimdWriter(StatementWriter):
    """Writer of a function for one iteration, or for several in SIMD lanes."""

    def __init__(self, unit: KernelUnit, part: Any, mask: Number | None = None) -> None:
        super().__init__(unit, *part.source())
        self.gives = part.types().get("return", Any)
        self.turns: list[LoopTurns] = []
        self.results: list[StackVariable] = []
        self.fresh: set[Number] = set()  # slots that no iteration has written to yet
        if mask is not None:
            self.mask = mask
            self._enter()

    def _enter(self) -> LoopTurns:
        """Begin a loop or a function for the active lanes, and return its masks."""
        assert self.mask is not None
        turns = LoopTurns(self.slot(TRUTH, LANE_COUNT), self.slot(TRUTH, LANE_COUNT))
        self.put(turns.inside, self.mask)
        self.put(turns.now, self.mask)
        self.turns.append(turns)
        return turns

    # --- variables -----------------------------------------------------------------------------------------------------

    def variable(self, item: Number) -> StackVariable:
        if self.mask is None:
            return super().variable(item)
        place = self.slot(item.kind, LANE_COUNT)
        self.fresh.add(place)
        return StackVariable(item.kind, place, LANE_COUNT)

    def assign(self, node: ast.AST, name: str, item: KernelItem) -> None:
        is_consecutive = self.mask is not None and isinstance(item, Number) and bool(item.first)
        if is_consecutive and self.mask == ALL_LANES and name not in self.variables and stored_names(self.definition)[name] == 1:
            self.variables[name] = item  # stays known as consecutive over iterations
        else:
            super().assign(node, name, item)

    def change(self, node: ast.AST, variable: StackVariable, value: Number) -> None:
        if self.mask is None:
            super().change(node, variable, value)
            return
        if not variable.wide:
            self.fail(node, "what several turns would change at once belongs to none of them")
        value = self.widened(value)
        if self.mask.known is None and variable.place not in self.fresh:
            value = self.select(self.mask, value, self.load(variable.place, variable.kind, LANE_COUNT))
        self.fresh.discard(variable.place)
        self.put(variable.place, value)

    # --- statements ----------------------------------------------------------------------------------------------------

    def _write_where(self, mask: Number, write: Callable[[], None]) -> None:
        """Write code that runs if a mask holds for at least one iteration, with this mask."""
        outer_mask, reached, then, end = self.mask, self.reached, self.label("then"), self.label("done")
        if mask.known is None:
            self.branch(self.any_lane(mask), then, end)
            self.begin(then)
        self.mask = self.reached = mask
        write()
        self.mask, self.reached, self.open = outer_mask, reached, True
        if mask.known is None:
            self.jump(end)
            self.begin(end)

    def if_(self, test: ast.expr, then: list[ast.stmt], other: list[ast.stmt]) -> None:
        if self.mask is None:
            super().if_(test, then, other)
            return
        condition = self.truth(test)
        if condition.known is not None:
            self.block(then if condition.known else other)
            return
        fresh = set(self.fresh)
        condition = self.widened(condition)
        outer_mask = self.mask
        self._write_where(self.logical_and(outer_mask, condition), lambda: self.block(then))
        new_places = self.fresh - fresh
        self.fresh &= fresh
        if other:
            self._write_where(self.logical_and(outer_mask, self.invert(condition)), lambda: self.block(other))
        self.fresh -= new_places
        self._write_remaining([*then, *other])

    def _write_remaining(self, body: list[ast.stmt]) -> None:
        """Remove from the mask the iterations that `body` has ended by `break`, `continue` or `return`."""
        if _has_exits(body):
            assert self.mask is not None
            self.mask = self.logical_and(self.mask, self.load(self.turns[-1].now, TRUTH, LANE_COUNT))

    def _clear_mask(self, place: Number) -> None:
        """Remove the active iterations from the mask in a stack slot."""
        assert self.mask is not None
        self.put(place, self.op("and", TRUTH, self.load(place, TRUTH, LANE_COUNT), self.invert(self.widened(self.mask))))

    def leave(self, loop: bool) -> None:
        if self.mask is None:
            super().leave(loop)
            return
        self._clear_mask(self.turns[-1].now)
        if loop:
            self._clear_mask(self.turns[-1].inside)
        self.open = False

    def while_(self, test: ast.expr, body: list[ast.stmt]) -> None:
        if self.mask is None:
            super().while_(test, body)
            return
        outer_mask, turns = self.mask, self._enter()
        head, inner, end = self.label("while"), self.label("body"), self.label("end")
        self.jump(head)
        self.begin(head)
        self.mask = self.load(turns.inside, TRUTH, LANE_COUNT)
        active_mask = self.logical_and(self.mask, self.widened(self.truth(test)))
        self.put(turns.inside, active_mask)
        self.put(turns.now, active_mask)
        self.branch(self.any_lane(active_mask), inner, end)
        self.begin(inner)
        reached = self.reached
        self.mask = self.reached = active_mask
        self.block(body)
        self.reached = reached
        self.jump(head)
        self.begin(end)
        self._rejoin_after_loop(outer_mask, body)

    def _rejoin_after_loop(self, outer_mask: Number, body: list[ast.stmt]) -> None:
        """Restore the mask after a loop, without the iterations that left the function in that loop."""
        self.turns.pop()
        self.mask, self.open = outer_mask, True
        if any(isinstance(each, ast.Return) for statement in body for each in ast.walk(statement)):
            self.mask = self.logical_and(outer_mask, self.load(self.turns[-1].now, TRUTH, LANE_COUNT))

    def count_loop(
        self, name: str, begin: Number, end: Number, step: int, body: list[ast.stmt], write: Callable[[], None] | None = None
    ) -> None:
        if self.mask is None:
            super().count_loop(name, begin, end, step, body, write)
            return
        write = write or (lambda: self.block(body))
        wide = begin.wide or end.wide
        begin, end = self.convert(begin, INT), self.convert(end, INT)
        if not wide and not _has_exits(body):
            self._uniform_loop(name, begin, end, step, write)
            return
        outer_mask, turns = self.mask, self._enter()
        lanes = LANE_COUNT if wide else 1
        number = self.slot(INT, lanes)
        begin, end = (self.widened(begin), self.widened(end)) if wide else (begin, end)
        self.put(number, begin)
        head, inner, exit_label = self.label("for"), self.label("body"), self.label("end")
        self.jump(head)
        self.begin(head)
        at = self.load(number, INT, lanes)
        active_mask = self.logical_and(
            self.load(turns.inside, TRUTH, LANE_COUNT), self.compare("lt" if step > 0 else "gt", at, end)
        )
        active_mask = self.widened(active_mask)
        self.put(turns.inside, active_mask)
        self.put(turns.now, active_mask)
        self.branch(self.any_lane(active_mask), inner, exit_label)
        self.begin(inner)
        reached = self.reached
        self.mask, self.reached, self.variables[name] = active_mask, active_mask, at
        write()
        self.reached = reached
        self.put(number, self.arithmetic(ast.Pass(), ast.Add(), at, constant(step)))
        self.jump(head)
        self.begin(exit_label)
        self.variables.pop(name, None)
        self._rejoin_after_loop(outer_mask, body)

    def _uniform_loop(self, name: str, begin: Number, end: Number, step: int, write: Callable[[], None]) -> None:
        """Write a loop over the same numbers for all iterations. No iteration leaves the loop early, so the mask does not
        change."""
        with self._scalar_loop(begin, end, step) as at:
            self.variables[name] = at
            fresh = set(self.fresh)
            write()
            self.fresh &= fresh
        self.variables.pop(name, None)

    @contextmanager
    def _scalar_loop(self, begin: Number, end: Number, step: int) -> Iterator[Number]:
        """Write a loop over numbers that all lanes share. Yield the number; the context writes the body."""
        number = self.slot(INT)
        self.put(number, begin)
        head, inner, exit_label = self.label("for"), self.label("body"), self.label("end")
        self.jump(head)
        self.begin(head)
        at = self.load(number, INT)
        self.branch(self.compare("lt" if step > 0 else "gt", at, end), inner, exit_label)
        self.begin(inner)
        yield at
        self.put(number, self.arithmetic(ast.Pass(), ast.Add(), at, constant(step)))
        self.jump(head)
        self.begin(exit_label)

    def unrolled_loop(self, node: ast.AST, target: ast.expr, items: list[KernelItem], body: list[ast.stmt]) -> None:
        if self.mask is None:
            super().unrolled_loop(node, target, items, body)
            return
        left = _has_exits(body)
        outer_mask, turns = self.mask, self._enter()
        for item in items:
            if left:
                self.mask = self.load(turns.inside, TRUTH, LANE_COUNT)
                self.put(turns.now, self.mask)
            self.bind(node, target, item)
            self.block(body)
            self.open = True
        self.unbind(target)
        self._rejoin_after_loop(outer_mask, body)

    def return_item(self, node: ast.AST, item: KernelItem) -> None:
        if self.mask is None:
            super().return_item(node, item)
            return
        if self.returns and type_key(self._widen(item)) != type_key(self.result):
            item = self.match_item(node, item, self.result)
        if not self.returns:
            self.results = [self.variable(self.widened(each)) for each in leaves(item)]
        self.result, self.returns, self.open = self._widen(item), True, False
        for variable, each in zip(self.results, leaves(item), strict=True):
            self.change(node, variable, each)
        for turns in self.turns:
            self._clear_mask(turns.now)
            self._clear_mask(turns.inside)

    def _widen(self, item: KernelItem) -> KernelItem:
        """Return an item with its numbers broadcast to all lanes."""
        return rebuild_like(item, map(self._widen, item)) if isinstance(item, tuple) else self.widened(item)

    def end(self) -> None:
        """Return the results of all iterations from a function that runs several iterations."""
        if self.mask is None:
            super().end()
            return
        self.result = self.result or ()
        numbers = [self.load(each.place, each.kind, LANE_COUNT) for each in self.results]
        self.emit_return(rename_item(self.result, iter([each.name for each in numbers])))

    # --- loops and calls -----------------------------------------------------------------------------------------------

    def side_by_side(self, name: str, begin: Number, end: Number, body: list[ast.stmt]) -> None:
        if self.mask is not None or self.unit.lanes == 1:
            known = dict(self.variables)
            self.count_loop(name, begin, end, 1, body)
            if self.unit.lanes == 1:
                self.variables = known
            return
        begin, end = self.convert(begin, INT), self.convert(end, INT)
        count = self.op("sub", INT, end, begin)
        rest = self.op("and", INT, count, constant(-LANE_COUNT))
        none = self.op("slt", TRUTH, count, constant(0))
        middle = self.select(none, begin, self.op("add", INT, begin, rest))
        known, loops = dict(self.variables), self.loops
        with self._scalar_loop(begin, middle, LANE_COUNT) as at:
            steps = Number(INT, f"<{', '.join(f'i64 {k}' for k in range(LANE_COUNT))}>", lanes=LANE_COUNT)
            lanes = self.op("add", INT, self.widened(at), steps)
            self.mask, self.loops = ALL_LANES, []
            self._enter()
            self.variables[name] = Number(INT, lanes.name, None, LANE_COUNT, at)
            self.block(body)
            self.turns.pop()
            self.mask, self.open, self.variables, self.loops = None, True, dict(known), loops
        super().count_loop(name, middle, end, 1, body)
        self.variables = known  # names of an iteration are local to it

    def call_function(self, node: ast.Call, function: Any, inputs: list[KernelItem]) -> KernelItem:
        part = getattr(function, "part", None)
        if part is None:
            self.fail(node, f"`{ast.unparse(node.func)}` is no function of kernels")
        types = part.types()
        for each, item in zip(part.source()[1].args.args, inputs, strict=False):
            self.fit_to_type(node, each.arg, item, types.get(each.arg, Any))
        wide = self.mask is not None and any(each.wide for item in inputs for each in leaves(item))
        name, result = write_function(self.unit, part, inputs, wide)
        operands = [each for item in inputs for each in leaves(item)]
        if wide:
            assert self.mask is not None
            operands.append(self.mask)
        numbers = list(leaves(result))
        if not numbers:
            self.do("call", *operands, x=name)
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
    """Return whether these statements may end an iteration, a loop or the function."""
    return any(isinstance(each, _EXIT_STATEMENTS) for statement in body for each in ast.walk(statement))


def write_function(unit: KernelUnit, part: Any, inputs: list[KernelItem], wide: bool = False) -> tuple[str, KernelItem]:
    """Return the name and the result of the function of a `part` for these types of inputs. The function is written at the first
    call.

    With `wide`, it runs several iterations in SIMD lanes, and its last argument is the mask of the active ones."""
    key = (part, ",".join(type_key(each) for each in inputs) + ("," if wide else ""))
    if key not in unit.specialisations:
        name = f"@{part.function.__name__}.{len(unit.specialisations)}"
        unit.specialisations[key] = name, None
        numbers = iter(f"%x{k}" for k in range(100_000))
        own = [rename_item(each, numbers) for each in inputs]
        mask = Number(TRUTH, "%mask", lanes=LANE_COUNT) if wide else None
        w = SimdWriter(unit, part, mask)
        arguments = [each for item in own for each in leaves(item)] + ([mask] if mask else [])
        w.run(own)
        unit.functions.append(IrFunction(name, w.file, arguments, part.attribute, result_type(w.result), w.slots, w.blocks))
        unit.specialisations[key] = name, w.result
    elif unit.specialisations[key][1] is None:
        raise RecursionError(f"{part} calls itself")
    return unit.specialisations[key]
