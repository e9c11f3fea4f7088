"""Writes the statements of a kernel's function, for the types of one call."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from antdsl.machine_code.kernels.expressions import ExpressionEmitter
from antdsl.machine_code.kernels.functions import independent
from antdsl.machine_code.kernels.records import rebuild_like
from antdsl.machine_code.kernels.types import DOUBLE, FLOAT, INT, TRUTH, UNSIGNED
from antdsl.machine_code.kernels.units import KernelUnit, LoopLabels, StackVariable, result_type
from antdsl.machine_code.kernels.values import Array, KernelItem, Number, constant, has_arrays, leaves, type_key

_MAX_UNROLLED_TURNS = 4  # longer loops over constants are not unrolled


class StatementWriter(ExpressionEmitter):
    """Writer of one function for arguments of certain types."""

    def __init__(self, unit: KernelUnit, file: str, definition: ast.FunctionDef, world: dict[str, Any]) -> None:
        super().__init__(definition.name, file)
        self.unit, self.definition, self.world = unit, definition, world
        self.variables: dict[str, Any] = {}
        self.loops: list[LoopLabels] = []
        self.result: KernelItem = None
        self.returns = False
        self.gives: Any = Any  # the annotated result type
        self.open = True  # whether the current position can be reached

    def run(self, inputs: list[KernelItem]) -> None:
        """Write the body of the function for these arguments."""
        names = [each.arg for each in self.definition.args.args]
        if len(names) != len(inputs):
            self.fail(self.definition, f"{len(inputs)} arguments for {len(names)}")
        changed = stored_names(self.definition)
        for name, item in zip(names, inputs, strict=True):
            if name in changed:
                self.assign(self.definition, name, item)
            else:
                self.variables[name] = item
        self.block(self.definition.body)
        self.end()

    def end(self) -> None:
        """End the function after its body."""
        if self.open:
            self.return_item(self.definition, ())

    def lookup_name(self, name: str) -> Any:
        if name not in self.variables:
            if name in self.world:
                return self._constants(self.world[name])
            self.fail(self.definition, f"`{name}` is not known where it is read")
        return self.variables[name]

    def _constants(self, value: Any) -> KernelItem:
        """Return a value of the module as literals."""
        if isinstance(value, tuple):
            return rebuild_like(value, (self._constants(each) for each in value))
        return constant(value)

    def loaded(self, item: Any) -> KernelItem:
        if isinstance(item, tuple):
            return rebuild_like(item, (self.loaded(each) for each in item))
        if isinstance(item, StackVariable):
            return self.load(item.place, item.kind, item.lanes)
        return item

    # --- assignment ----------------------------------------------------------------------------------------------------

    def assign(self, node: ast.AST, name: str, item: KernelItem) -> None:
        """Assign a value to a name; the first assignment decides its type."""
        if name not in self.variables:
            self.variables[name] = self._allocate(item)
        self._assign_into(node, name, self.variables[name], item)

    def _allocate(self, item: KernelItem) -> Any:
        """Return new variables for the numbers of an item; arrays stay unchanged."""
        if isinstance(item, tuple):
            return rebuild_like(item, (self._allocate(each) for each in item))
        return item if isinstance(item, Array) else self.variable(item)

    def variable(self, item: Number) -> StackVariable:
        """Return a new variable for a number of the same kind."""
        return StackVariable(item.kind, self.slot(item.kind, item.lanes), item.lanes)

    def _assign_into(self, node: ast.AST, name: str, destination: Any, item: KernelItem) -> None:
        """Assign an item to existing variables. Raises NotInSubset for another type."""
        if isinstance(destination, tuple) and type(destination) is type(item) and len(destination) == len(item):
            for one, other in zip(destination, item, strict=True):
                self._assign_into(node, name, one, other)
        elif isinstance(destination, StackVariable) and isinstance(item, Number):
            if item.kind != destination.kind and not (
                item.known is not None or item.kind == TRUTH or (item.kind, destination.kind) == (INT, DOUBLE)
            ):
                self.fail(node, f"`{name}` is {destination.kind}, and is given {item.kind}")
            if destination.kind in (INT, UNSIGNED, TRUTH) and item.kind in (DOUBLE, FLOAT):
                self.fail(node, f"`{name}` is a whole number, and is given a float")
            self.change(node, destination, self.as_kind(item, destination.kind))
        elif not (isinstance(destination, Array) and item == destination):
            self.fail(node, f"`{name}` is given a value of another type")

    def change(self, node: ast.AST, variable: StackVariable, value: Number) -> None:
        """Assign another value to a variable."""
        self.put(variable.place, value)

    def _assign_target(self, node: ast.AST, target: ast.expr, item: KernelItem) -> None:
        """Assign an item to a name, a tuple of targets or an element of an array."""
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
                self._fill(node, self.value(of), item)
            case ast.Subscript(value=of, slice=index):
                array = self.value(of)
                if not isinstance(array, Array) or not isinstance(item, Number):
                    self.fail(node, "only numbers are put into arrays")
                self._store(node, array, self.at(node, array, index), item)
            case _:
                self.fail(node, "cannot be assigned to")

    def _store(self, node: ast.AST, array: Array, at: Number, item: Number) -> None:
        """Store a number as an element of an array, and record that the kernel writes to the array."""
        self.unit.written.add(array.origin)
        self.store_element(node, array, at, item)

    def _fill(self, node: ast.AST, array: KernelItem, item: KernelItem) -> None:
        """Write `a[:] = number`."""
        if not isinstance(array, Array) or array.steps is not None or not isinstance(item, Number):
            self.fail(node, "`a[:] = number` of an array in one piece")
        if self.mask is not None:
            self.fail(node, "an array is filled by one turn")
        count = self.count(array)
        flat_array = Array(array.of, array.address, (count,), None, array.origin)
        with_number = ast.Name(id="~k")
        self._count_loop("~k", constant(0), count, 1, lambda: self._store(node, flat_array, self.number(with_number), item))

    # --- statements ----------------------------------------------------------------------------------------------------

    def block(self, body: list[ast.stmt]) -> None:
        """Write statements up to the first that cannot be reached."""
        for each in body:
            if not self.open:
                return
            self.statement(each)

    def statement(self, node: ast.stmt) -> None:
        """Write one statement. Raises NotInSubset for unsupported syntax."""
        self.node, self.line = node, node.lineno
        match node:
            case ast.Expr(value=ast.Constant()) | ast.Pass():
                pass
            case ast.Expr(value=call):
                self.value(call)
            case ast.Assign(targets=[target], value=value):
                self._assign_target(node, target, self.value(value))
            case ast.Assign(targets=targets, value=value):
                item = self.value(value)
                for target in targets:
                    self._assign_target(node, target, item)
            case ast.AnnAssign(target=target, value=ast.expr() as value):
                self._assign_target(node, target, self.value(value))
            case ast.AugAssign(target=ast.Name(id=name), op=operator, value=value):
                self._augment(node, ast.Name(id=name), operator, value)
            case ast.AugAssign(target=ast.Subscript(value=of, slice=index), op=operator, value=value):
                array = self.value(of)
                if not isinstance(array, Array):
                    self.fail(node, "only an array's elements change")
                old_value = self._index_item(target_of(node), array, index)
                new_value = self.arithmetic(node, operator, old_value, self.number(value))
                self._store(node, array, self.at(node, array, index), new_value)
            case ast.If(test=test, body=then, orelse=other):
                self.if_(test, then, other)
            case ast.While(test=test, body=body, orelse=[]):
                self.while_(test, body)
            case ast.For(target=target, iter=over, body=body, orelse=[]):
                self._for(node, target, over, body)
            case ast.Break() | ast.Continue():
                self.leave(isinstance(node, ast.Break))
            case ast.Return(value=value):
                item = () if value is None else self.value(value)
                self.fit_to_type(node, "return", item, self.gives)
                self.return_item(node, item)
            case _:
                self.fail(node, f"`{ast.unparse(node).splitlines()[0]}` is not in the subset")

    def leave(self, loop: bool) -> None:
        """Leave the innermost loop, or continue with its next iteration."""
        self.jump(self.loops[-1].end if loop else self.loops[-1].following)
        self.open = False

    def _augment(self, node: ast.stmt, name: ast.Name, operator: ast.operator, value: ast.expr) -> None:
        old_value = self.number(name)
        self.assign(node, name.id, self.arithmetic(node, operator, old_value, self.number(value)))

    def if_(self, test: ast.expr, then: list[ast.stmt], other: list[ast.stmt]) -> None:
        """Write an `if`; with a literal condition, only one branch."""
        condition = self.truth(test)
        if condition.known is not None:
            self.block(then if condition.known else other)
            return
        yes, no, end = self.label("then"), self.label("else"), self.label("done")
        self.branch(condition, yes, no if other else end)
        self.begin(yes)
        self.block(then)
        reached = self.open
        if self.open:
            self.jump(end)
        self.open = True
        if other:
            self.begin(no)
            self.block(other)
            if self.open:
                self.jump(end)
            self.open = self.open or reached
        if self.open:
            self.begin(end)

    def while_(self, test: ast.expr, body: list[ast.stmt]) -> None:
        """Write a `while` loop."""
        head, inner, end = self.label("while"), self.label("body"), self.label("end")
        self.jump(head)
        self.begin(head)
        self.branch(self.truth(test), inner, end)
        self.begin(inner)
        self._body(LoopLabels(head, end), lambda: self.block(body))
        self.begin(end)

    def _body(self, loop: LoopLabels, write: Callable[[], None]) -> None:
        """Write an iteration of a loop, and the jump to the next one."""
        self.loops.append(loop)
        write()
        self.loops.pop()
        if self.open:
            self.jump(loop.following)
        self.open = True

    def _for(self, node: ast.For, target: ast.expr, over: ast.expr, body: list[ast.stmt]) -> None:
        """Write a `for` loop over a range, an array or a tuple, and unroll it if it is short."""
        if isinstance(over, ast.Call):
            known, numbers = self.resolve_name(over, over.func), [self.number(each) for each in over.args]
            if known not in (range, independent) or not isinstance(target, ast.Name):
                self.fail(node, "`for` goes over `range`, `independent` or a tuple")
            step = int(numbers[2].known or 0) if len(numbers) == 3 else 1
            if step == 0:
                self.fail(node, "a step is a number of the text, and not 0")
            begin, end = (constant(0), numbers[0]) if len(numbers) == 1 else numbers[:2]
            if begin.known is not None and end.known is not None:
                turns = range(int(begin.known), int(end.known), step)
                if len(turns) <= _MAX_UNROLLED_TURNS:
                    self.unrolled_loop(node, target, [constant(k) for k in turns], body)
                    return
            if known is independent:
                self.side_by_side(target.id, begin, end, body)
            else:
                self.count_loop(target.id, begin, end, step, body)
            return
        items = self.value(over)
        if isinstance(items, tuple):
            self.unrolled_loop(node, target, list(items), body)
            return
        if not isinstance(items, Array) or len(items.lengths) != 1:
            self.fail(node, "`for` goes over `range`, `independent`, a tuple or an array with one axis")
        at = f"~{self.label('at')}"

        def turn() -> None:
            self._assign_target(node, target, self._index_item(over, items, ast.Name(id=at)))
            self.block(body)

        self.count_loop(at, constant(0), items.lengths[0], 1, body, turn)

    def count_loop(
        self, name: str, begin: Number, end: Number, step: int, body: list[ast.stmt], write: Callable[[], None] | None = None
    ) -> None:
        """Write a loop over numbers. `write` writes an iteration; None means that an iteration is just `body`."""
        self._count_loop(name, begin, end, step, write or (lambda: self.block(body)))

    def side_by_side(self, name: str, begin: Number, end: Number, body: list[ast.stmt]) -> None:
        """Write a loop in which several iterations can run at once."""
        raise NotImplementedError

    def unrolled_loop(self, node: ast.AST, target: ast.expr, items: list[KernelItem], body: list[ast.stmt]) -> None:
        """Write the body once for each item."""
        end = self.label("end")
        for item in items:
            following = self.label("next")
            self.bind(node, target, item)
            self._body(LoopLabels(following, end), lambda: self.block(body))
            self.begin(following)
        self.jump(end)
        self.begin(end)
        self.unbind(target)

    def bind(self, node: ast.AST, target: ast.expr, item: KernelItem) -> None:
        """Bind the names of an iteration of an unrolled loop to its item. Literals stay literals."""
        if isinstance(target, ast.Name):
            self.variables[target.id] = item
        elif isinstance(target, ast.Tuple) and isinstance(item, tuple) and len(item) == len(target.elts):
            for part, each in zip(target.elts, item, strict=True):
                self.bind(node, part, each)
        else:
            self.fail(node, "cannot be bound")

    def unbind(self, target: ast.expr) -> None:
        """Remove the variables of a loop after the loop, because its last iteration is unknown."""
        for each in ast.walk(target):
            if isinstance(each, ast.Name):
                self.variables.pop(each.id, None)

    def _count_loop(self, name: str, begin: Number, end: Number, step: int, write: Callable[[], None]) -> None:
        """Write a loop over numbers."""
        begin, end = self.convert(begin, INT), self.convert(end, INT)
        number = self.slot(INT)
        self.put(number, begin)
        head, inner, following, exit_label = (self.label(stem) for stem in ("for", "body", "next", "end"))
        self.jump(head)
        self.begin(head)
        at = self.load(number, INT)
        self.branch(self.op("slt" if step > 0 else "sgt", TRUTH, at, end), inner, exit_label)
        self.begin(inner)
        if isinstance(self.variables.get(name), Number):  # from an unrolled loop
            del self.variables[name]
        self.assign(self.definition, name, at)
        self._body(LoopLabels(following, exit_label), write)
        self.begin(following)
        self.put(number, self.op("add", INT, at, constant(step)))
        self.jump(head)
        self.begin(exit_label)

    def return_item(self, node: ast.AST, item: KernelItem) -> None:
        """Write `return`. Raises NotInSubset if an earlier result has another type."""
        if self.returns and type_key(item) != type_key(self.result):
            item = self.match_item(node, item, self.result)
        if has_arrays(item):
            self.fail(node, "arrays cannot be given back")
        self.result, self.returns, self.open = item if not self.returns else self.result, True, False
        self.emit_return(item)

    def emit_return(self, item: KernelItem) -> None:
        """Write the return of an item from the function."""
        numbers = list(leaves(item))
        if len(numbers) < 2:
            self.do("return", *numbers)
            return
        aggregate = Number(result_type(item), "poison")
        for k, each in enumerate(numbers):
            aggregate = self.op("insertvalue", aggregate.kind, aggregate, each, x=k)
        self.do("return", aggregate)

    def match_item(self, node: ast.AST, item: KernelItem, other: KernelItem) -> KernelItem:
        """Convert an item to the type of another result of the function."""
        if isinstance(item, tuple) and type(item) is type(other) and len(item) == len(other):
            return rebuild_like(item, (self.match_item(node, a, b) for a, b in zip(item, other, strict=True)))
        if isinstance(item, Number) and isinstance(other, Number) and (item.known is not None or item.kind == other.kind):
            return self.as_kind(item, other.kind)
        self.fail(node, "gives back another type than before")


@lru_cache(maxsize=512)
def stored_names(definition: ast.FunctionDef) -> Counter[str]:
    """Return the names that a function assigns, each with its number of assignments."""
    return Counter(each.id for each in ast.walk(definition) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store))


def target_of(node: ast.AugAssign) -> ast.expr:
    """Return the target that an augmented assignment changes."""
    return node.target
