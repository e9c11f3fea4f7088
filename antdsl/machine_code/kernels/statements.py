"""Emits the instructions of a kernel function's statements, for the argument types of one call."""

from __future__ import annotations

import ast
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from antdsl.machine_code.kernels.expressions import ExpressionEmitter
from antdsl.machine_code.kernels.kernel_functions import simd_range
from antdsl.machine_code.kernels.kernel_unit import KernelUnit, LoopLabels, StackVariable, result_type
from antdsl.machine_code.kernels.records import rebuild_like
from antdsl.machine_code.kernels.types import DOUBLE, FLOAT, INT, TRUTH, UNSIGNED
from antdsl.machine_code.kernels.values import (
    Array,
    KernelItem,
    Number,
    flatten_item,
    has_arrays,
    make_literal_number,
    make_type_key,
)

_MAX_UNROLLED_ITERATIONS = 4  # longer loops over constants are not unrolled


class StatementWriter(ExpressionEmitter):
    """Emits the instructions of one function, for arguments of given types."""

    def __init__(self, unit: KernelUnit, file: str, definition: ast.FunctionDef, module_names: dict[str, Any]) -> None:
        super().__init__(definition.name, file)
        self.unit, self.definition, self.module_names = unit, definition, module_names
        self.variables: dict[str, Any] = {}
        self.loops: list[LoopLabels] = []
        self.result: KernelItem = None
        self.has_return = False
        self.gives: Any = Any  # the annotated result type
        self.is_reachable = True  # whether the current position can be reached

    def run(self, inputs: list[KernelItem]) -> None:
        """Emit the body of the function. `inputs`: its arguments."""
        names = [each.arg for each in self.definition.args.args]
        if len(names) != len(inputs):
            self.fail(self.definition, f"{len(inputs)} arguments for {len(names)}")
        changed = count_assigned_names(self.definition)
        for name, item in zip(names, inputs, strict=True):
            if name in changed:
                self.assign(self.definition, name, item)
            else:
                self.variables[name] = item
        self.write_block(self.definition.body)
        self.end()

    def end(self) -> None:
        """End the function. If its body can reach its end without a `return`, add one."""
        if self.is_reachable:
            self.write_return(self.definition, ())

    def lookup_name(self, name: str) -> Any:
        if name not in self.variables:
            if name in self.module_names:
                return self._literal_item(self.module_names[name])
            self.fail(self.definition, f"`{name}` has no value where it is read")
        return self.variables[name]

    def _literal_item(self, value: Any) -> KernelItem:
        """Return a Python value from the kernel's module as an item of literals."""
        if isinstance(value, tuple):
            return rebuild_like(value, (self._literal_item(each) for each in value))
        return make_literal_number(value)

    def load_variables(self, item: Any) -> KernelItem:
        if isinstance(item, tuple):
            return rebuild_like(item, (self.load_variables(each) for each in item))
        if isinstance(item, StackVariable):
            return self.load(item.slot_address, item.kind, item.lanes)
        return item

    # --- assignment ----------------------------------------------------------------------------------------------------

    def assign(self, node: ast.AST, name: str, item: KernelItem) -> None:
        """Assign an item to a local name. The first assignment decides the type of the variable."""
        if name not in self.variables:
            self.variables[name] = self._allocate_variable(item)
        self._assign_into(node, name, self.variables[name], item)

    def _allocate_variable(self, item: KernelItem) -> Any:
        """Return a copy of an item with new stack variables instead of its numbers; arrays are unchanged."""
        if isinstance(item, tuple):
            return rebuild_like(item, (self._allocate_variable(each) for each in item))
        return item if isinstance(item, Array) else self.make_variable(item)

    def make_variable(self, item: Number) -> StackVariable:
        """Return a new variable that can hold numbers of the same kind as `item`."""
        return StackVariable(item.kind, self.allocate_slot(item.kind, item.lanes), item.lanes)

    def _assign_into(self, node: ast.AST, name: str, destination: Any, item: KernelItem) -> None:
        """Assign an item to existing variables. Raises NotInSubsetError if its type is not that of the variables."""
        if isinstance(destination, tuple) and type(destination) is type(item) and len(destination) == len(item):
            for one, other in zip(destination, item, strict=True):
                self._assign_into(node, name, one, other)
        elif isinstance(destination, StackVariable) and isinstance(item, Number):
            if item.kind != destination.kind and not (
                item.literal_value is not None or item.kind == TRUTH or (item.kind, destination.kind) == (INT, DOUBLE)
            ):
                self.fail(node, f"`{name}` is {destination.kind}, but gets {item.kind}")
            if destination.kind in (INT, UNSIGNED, TRUTH) and item.kind in (DOUBLE, FLOAT):
                self.fail(node, f"`{name}` is an integer, but gets a float")
            self.set_variable(node, destination, self.to_kind(item, destination.kind))
        elif not (isinstance(destination, Array) and item == destination):
            self.fail(node, f"`{name}` gets a value of another type")

    def set_variable(self, node: ast.AST, variable: StackVariable, value: Number) -> None:
        """Assign a new value to a variable."""
        self.store_number(variable.slot_address, value)

    def _assign_target(self, node: ast.AST, target: ast.expr, item: KernelItem) -> None:
        """Assign an item to a target: a name, a tuple of targets or an element of an array."""
        match target:
            case ast.Name(id="_"):
                pass
            case ast.Name(id=name):
                self.assign(node, name, item)
            case ast.Tuple(elts=parts):
                if not isinstance(item, tuple) or len(parts) != len(item):
                    self.fail(node, f"this needs {len(parts)} values")
                for part, each in zip(parts, item, strict=True):
                    self._assign_target(node, part, each)
            case ast.Subscript(value=of, slice=ast.Slice(lower=None, upper=None)):
                self._fill_array(node, self.emit_item(of), item)
            case ast.Subscript(value=of, slice=index):
                array = self.emit_item(of)
                if not isinstance(array, Array) or not isinstance(item, Number):
                    self.fail(node, "arrays store only numbers")
                self._store_item(node, array, self.compute_offset(node, array, index), item)
            case _:
                self.fail(node, "this cannot be assigned to")

    def _store_item(self, node: ast.AST, array: Array, index: Number, item: Number) -> None:
        """Store a number as an element of an array, and record that the kernel writes to the array."""
        self.unit.written_arrays.add(array.origin)
        self.store_element(node, array, index, item)

    def _fill_array(self, node: ast.AST, array: KernelItem, item: KernelItem) -> None:
        """Emit `a[:] = number`, which stores one number in all elements."""
        if not isinstance(array, Array) or array.steps is not None or not isinstance(item, Number):
            self.fail(node, "`a[:] = number` needs a contiguous array and a number")
        if self.mask is not None:
            self.fail(node, "several iterations of the loop would fill the array at once")
        count = self.count_elements(array)
        flat_array = Array(array.element_type, array.address, (count,), None, array.origin)
        with_number = ast.Name(id="~k")
        self._write_counted_loop(
            "~k",
            make_literal_number(0),
            count,
            1,
            lambda: self._store_item(node, flat_array, self.emit_number(with_number), item),
        )

    # --- statements ----------------------------------------------------------------------------------------------------

    def write_block(self, body: list[ast.stmt]) -> None:
        """Emit statements up to the first one that cannot be reached."""
        for each in body:
            if not self.is_reachable:
                return
            self.write_statement(each)

    def write_statement(self, node: ast.stmt) -> None:
        """Emit one statement. Raises NotInSubsetError for unsupported syntax."""
        self.node, self.line = node, node.lineno
        match node:
            case ast.Expr(value=ast.Constant()) | ast.Pass():
                pass
            case ast.Expr(value=call):
                self.emit_item(call)
            case ast.Assign(targets=[target], value=value):
                self._assign_target(node, target, self.emit_item(value))
            case ast.Assign(targets=targets, value=value):
                item = self.emit_item(value)
                for target in targets:
                    self._assign_target(node, target, item)
            case ast.AnnAssign(target=target, value=ast.expr() as value):
                self._assign_target(node, target, self.emit_item(value))
            case ast.AugAssign(target=ast.Name(id=name), op=operator, value=value):
                self._write_augmented(node, ast.Name(id=name), operator, value)
            case ast.AugAssign(target=ast.Subscript(value=of, slice=index), op=operator, value=value):
                array = self.emit_item(of)
                if not isinstance(array, Array):
                    self.fail(node, "only elements of arrays can be changed")
                old_value = self._emit_index(get_augmented_target(node), array, index)
                new_value = self.apply_operator(node, operator, old_value, self.emit_number(value))
                self._store_item(node, array, self.compute_offset(node, array, index), new_value)
            case ast.If(test=test, body=then, orelse=other):
                self.write_if(test, then, other)
            case ast.While(test=test, body=body, orelse=[]):
                self.write_while(test, body)
            case ast.For(target=target, iter=over, body=body, orelse=[]):
                self._write_for(node, target, over, body)
            case ast.Break() | ast.Continue():
                self.exit_loop(isinstance(node, ast.Break))
            case ast.Return(value=value):
                item = () if value is None else self.emit_item(value)
                self.fit_to_type(node, "return", item, self.gives)
                self.write_return(node, item)
            case _:
                self.fail(node, f"`{ast.unparse(node).splitlines()[0]}` is not in the subset")

    def exit_loop(self, is_break: bool) -> None:
        """Emit a jump out of the innermost loop if `is_break`, else to its next iteration."""
        self.jump(self.loops[-1].end_label if is_break else self.loops[-1].next_label)
        self.is_reachable = False

    def _write_augmented(self, node: ast.stmt, name: ast.Name, operator: ast.operator, value: ast.expr) -> None:
        """Emit an augmented assignment to a name, such as `n += 1`."""
        old_value = self.emit_number(name)
        self.assign(node, name.id, self.apply_operator(node, operator, old_value, self.emit_number(value)))

    def write_if(self, test: ast.expr, true_body: list[ast.stmt], false_body: list[ast.stmt]) -> None:
        """Emit an `if`. If the condition is a literal, only one branch is emitted."""
        condition = self.emit_condition(test)
        if condition.literal_value is not None:
            self.write_block(true_body if condition.literal_value else false_body)
            return
        yes, no, end = self.make_label("then"), self.make_label("else"), self.make_label("done")
        self.branch(condition, yes, no if false_body else end)
        self.begin_block(yes)
        self.write_block(true_body)
        reached = self.is_reachable
        if self.is_reachable:
            self.jump(end)
        self.is_reachable = True
        if false_body:
            self.begin_block(no)
            self.write_block(false_body)
            if self.is_reachable:
                self.jump(end)
            self.is_reachable = self.is_reachable or reached
        if self.is_reachable:
            self.begin_block(end)

    def write_while(self, test: ast.expr, body: list[ast.stmt]) -> None:
        """Emit a `while` loop."""
        head, inner, end = self.make_label("while"), self.make_label("body"), self.make_label("end")
        self.jump(head)
        self.begin_block(head)
        self.branch(self.emit_condition(test), inner, end)
        self.begin_block(inner)
        self._write_iteration(LoopLabels(head, end), lambda: self.write_block(body))
        self.begin_block(end)

    def _write_iteration(self, loop: LoopLabels, write: Callable[[], None]) -> None:
        """Emit the body of a loop, and the jump to the next iteration."""
        self.loops.append(loop)
        write()
        self.loops.pop()
        if self.is_reachable:
            self.jump(loop.next_label)
        self.is_reachable = True

    def _write_for(self, node: ast.For, target: ast.expr, iterable: ast.expr, body: list[ast.stmt]) -> None:
        """Emit a `for` loop over a range, an array or a tuple. Short constant ranges and tuples are unrolled."""
        if isinstance(iterable, ast.Call):
            known, numbers = self.resolve_name(iterable, iterable.func), [self.emit_number(each) for each in iterable.args]
            if known not in (range, simd_range) or not isinstance(target, ast.Name):
                self.fail(node, "`for` iterates over `range`, `simd_range` or a tuple")
            step = int(numbers[2].literal_value or 0) if len(numbers) == 3 else 1
            if step == 0:
                self.fail(node, "the step must be a literal other than 0")
            begin, end = (make_literal_number(0), numbers[0]) if len(numbers) == 1 else numbers[:2]
            if begin.literal_value is not None and end.literal_value is not None:
                turns = range(int(begin.literal_value), int(end.literal_value), step)
                if len(turns) <= _MAX_UNROLLED_ITERATIONS:
                    self.write_unrolled_loop(node, target, [make_literal_number(k) for k in turns], body)
                    return
            if known is simd_range:
                self.write_simd_loop(target.id, begin, end, body)
            else:
                self.write_range_loop(target.id, begin, end, step, body)
            return
        items = self.emit_item(iterable)
        if isinstance(items, tuple):
            self.write_unrolled_loop(node, target, list(items), body)
            return
        if not isinstance(items, Array) or len(items.lengths) != 1:
            self.fail(node, "`for` iterates over `range`, `simd_range`, a tuple or an array with one axis")
        at = f"~{self.make_label('at')}"

        def write_iteration() -> None:
            self._assign_target(node, target, self._emit_index(iterable, items, ast.Name(id=at)))
            self.write_block(body)

        self.write_range_loop(at, make_literal_number(0), items.lengths[0], 1, body, write_iteration)

    def write_range_loop(
        self, name: str, begin: Number, end: Number, step: int, body: list[ast.stmt], write: Callable[[], None] | None = None
    ) -> None:
        """Emit a loop over a range. `write`: emits one iteration; if it is None, an iteration is `body`."""
        self._write_counted_loop(name, begin, end, step, write or (lambda: self.write_block(body)))

    @abstractmethod
    def write_simd_loop(self, name: str, begin: Number, end: Number, body: list[ast.stmt]) -> None:
        """Emit a `simd_range` loop, in which several iterations may run at once."""

    def write_unrolled_loop(self, node: ast.AST, target: ast.expr, items: list[KernelItem], body: list[ast.stmt]) -> None:
        """Emit the body once for each item."""
        end = self.make_label("end")
        for item in items:
            following = self.make_label("next")
            self.bind_target(node, target, item)
            self._write_iteration(LoopLabels(following, end), lambda: self.write_block(body))
            self.begin_block(following)
        self.jump(end)
        self.begin_block(end)
        self.unbind_target(target)

    def bind_target(self, node: ast.AST, target: ast.expr, item: KernelItem) -> None:
        """Bind the loop target of an unrolled loop to the item of one iteration. Literals stay literals."""
        if isinstance(target, ast.Name):
            self.variables[target.id] = item
        elif isinstance(target, ast.Tuple) and isinstance(item, tuple) and len(item) == len(target.elts):
            for part, each in zip(target.elts, item, strict=True):
                self.bind_target(node, part, each)
        else:
            self.fail(node, "cannot be bound")

    def unbind_target(self, target: ast.expr) -> None:
        """Remove the loop variables after a loop, because their last values are unknown."""
        for each in ast.walk(target):
            if isinstance(each, ast.Name):
                self.variables.pop(each.id, None)

    def _write_counted_loop(self, name: str, begin: Number, end: Number, step: int, write: Callable[[], None]) -> None:
        """Emit a loop with a counter from `begin` to before `end`, in steps of `step`."""
        begin, end = self.convert(begin, INT), self.convert(end, INT)
        number = self.allocate_slot(INT)
        self.store_number(number, begin)
        head, inner, following, exit_label = (self.make_label(stem) for stem in ("for", "body", "next", "end"))
        self.jump(head)
        self.begin_block(head)
        at = self.load(number, INT)
        self.branch(self.op("slt" if step > 0 else "sgt", TRUTH, at, end), inner, exit_label)
        self.begin_block(inner)
        if isinstance(self.variables.get(name), Number):  # from an unrolled loop
            del self.variables[name]
        self.assign(self.definition, name, at)
        self._write_iteration(LoopLabels(following, exit_label), write)
        self.begin_block(following)
        self.store_number(number, self.op("add", INT, at, make_literal_number(step)))
        self.jump(head)
        self.begin_block(exit_label)

    def write_return(self, node: ast.AST, item: KernelItem) -> None:
        """Emit a `return` statement. Raises NotInSubsetError if an earlier result has another type."""
        if self.has_return and make_type_key(item) != make_type_key(self.result):
            item = self.match_item(node, item, self.result)
        if has_arrays(item):
            self.fail(node, "a kernel cannot return arrays")
        self.result, self.has_return, self.is_reachable = item if not self.has_return else self.result, True, False
        self.emit_return(item)

    def emit_return(self, item: KernelItem) -> None:
        """Emit the instruction that returns `item` from the function."""
        numbers = list(flatten_item(item))
        if len(numbers) < 2:
            self.emit_void("return", *numbers)
            return
        aggregate = Number(result_type(item), "poison")
        for k, each in enumerate(numbers):
            aggregate = self.op("insertvalue", aggregate.kind, aggregate, each, x=k)
        self.emit_void("return", aggregate)

    def match_item(self, node: ast.AST, item: KernelItem, other: KernelItem) -> KernelItem:
        """Return `item` converted to the type of `other`, an earlier return value of the function. Raises NotInSubsetError if
        that is not possible."""
        if isinstance(item, tuple) and type(item) is type(other) and len(item) == len(other):
            return rebuild_like(item, (self.match_item(node, a, b) for a, b in zip(item, other, strict=True)))
        if isinstance(item, Number) and isinstance(other, Number) and (item.literal_value is not None or item.kind == other.kind):
            return self.to_kind(item, other.kind)
        self.fail(node, "returns another type than an earlier `return`")


@lru_cache(maxsize=512)
def count_assigned_names(definition: ast.FunctionDef) -> Counter[str]:
    """Return how often a function assigns each of its local names."""
    return Counter(each.id for each in ast.walk(definition) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store))


def get_augmented_target(node: ast.AugAssign) -> ast.expr:
    """Return the syntax tree of the target that an augmented assignment changes."""
    return node.target
