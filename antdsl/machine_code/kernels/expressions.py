"""Emits the instructions of the expressions in kernels: operators, conditions, indices and calls."""

from __future__ import annotations

import ast
import builtins
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from types import ModuleType
from typing import Any, NoReturn

from antdsl.machine_code.kernels.element_access import ElementAccess
from antdsl.machine_code.kernels.ir import MAX_CONSECUTIVE_ELEMENTS
from antdsl.machine_code.kernels.kernel_functions import (
    EMITTER_BY_FUNCTION,
    allocate_scratch,
    load3,
    load_consecutive,
    prefetch,
    store3,
)
from antdsl.machine_code.kernels.kernel_unit import KernelUnit
from antdsl.machine_code.kernels.records import get_field_types, is_record, rebuild_like
from antdsl.machine_code.kernels.types import DOUBLE, FLOAT, INT, TRUTH, UNSIGNED, ArrayType, ScalarType
from antdsl.machine_code.kernels.values import Array, KernelItem, Number, flatten_item, make_literal_number

_COMPARISON_WORDS = {ast.Lt: "lt", ast.LtE: "le", ast.Gt: "gt", ast.GtE: "ge", ast.Eq: "eq", ast.NotEq: "ne"}


class ExpressionEmitter(ElementAccess, ABC):
    """Emits the instructions of Python expressions.

    `variables`: the value of each local name. `module_names`: the global names of the kernel's module. `unit`: the functions
    of the LLVM IR text."""

    module_names: dict[str, Any]
    unit: KernelUnit

    @abstractmethod
    def lookup_name(self, name: str) -> Any:
        """Return the value of a name. Stack variables in the value are returned as they are, without loading their numbers."""

    @abstractmethod
    def load_variables(self, item: Any) -> KernelItem:
        """Return an item with its stack variables replaced by their loaded numbers."""

    @abstractmethod
    def call_function(self, node: ast.Call, function: Any, inputs: list[KernelItem]) -> KernelItem:
        """Emit a call of a kernel function, and return its result."""

    def emit_number(self, node: ast.expr) -> Number:
        """Emit an expression, and return its value as a number. Raises NotInSubsetError if the value is not a number."""
        value = self.emit_item(node)
        if not isinstance(value, Number):
            self.fail(node, "this must be a number")
        return value

    def emit_condition(self, node: ast.expr) -> Number:
        """Emit an expression, and return its value as a condition."""
        value = self.emit_number(node)
        return make_literal_number(bool(value.literal_value)) if value.literal_value is not None else self.convert(value, TRUTH)

    def emit_item(self, node: ast.expr) -> KernelItem:
        """Emit an expression, and return its value. Raises NotInSubsetError for unsupported syntax."""
        match node:
            case ast.Constant(value=bool() | int() | float() as known):
                return make_literal_number(known)
            case ast.Name(id=name):
                return self.load_variables(self.lookup_name(name))
            case ast.Tuple(elts=parts):
                return tuple(item for each in parts for item in self._emit_tuple_items(each))
            case ast.BinOp(left=left, op=operator, right=right):
                return self.apply_operator(node, operator, self.emit_number(left), self.emit_number(right))
            case ast.UnaryOp(op=operator, operand=operand):
                return self._emit_unary(node, operator, operand)
            case ast.Compare(left=left, ops=operators, comparators=others):
                return self._emit_comparison([left, *others], operators)
            case ast.BoolOp(op=operator, values=parts):
                return self._emit_boolean(isinstance(operator, ast.And), parts)
            case ast.IfExp(test=test, body=then, orelse=other):
                return self._emit_conditional(node, test, then, other)
            case ast.Subscript(value=of, slice=index):
                return self.load_variables(self._emit_index(node, self._emit_before_load(of), index))
            case ast.Attribute(value=of, attr=attribute):
                return self.load_variables(self._emit_attribute(node, of, attribute))
            case ast.Call(func=ast.Attribute(value=of, attr="_replace")):
                return self._replace_fields(node, self.emit_item(of))
            case ast.Call(func=function, args=arguments):
                return self._emit_call(node, function, arguments)
        self.fail(node, f"`{ast.unparse(node)}` is not in the subset")

    def _emit_tuple_items(self, node: ast.expr) -> Any:
        """Return the items that one element of a tuple expression adds to the tuple. An element `*value` adds several items."""
        if not isinstance(node, ast.Starred):
            return (self.emit_item(node),)
        spread = self.emit_item(node.value)
        if not isinstance(spread, tuple):
            self.fail(node, "`*` expands only tuples and records")
        return spread

    def _emit_before_load(self, node: ast.expr) -> Any:
        """Return the value of an expression without loading stack variables. So an index or attribute loads only the part that
        it selects."""
        match node:
            case ast.Name(id=name):
                return self.lookup_name(name)
            case ast.Attribute(value=of, attr=attribute):
                return self._emit_attribute(node, of, attribute)
        return self.emit_item(node)

    def _emit_unary(self, node: ast.expr, operator: ast.unaryop, operand: ast.expr) -> Number:
        if isinstance(operator, ast.Not):
            value = self.emit_condition(operand)
            return make_literal_number(not value.literal_value) if value.literal_value is not None else self.emit_not(value)
        value = self.emit_number(operand)
        if isinstance(operator, ast.USub):
            return self.negate(value)
        if isinstance(operator, ast.Invert):
            return self.emit_not(self.convert(value, INT) if value.literal_value is not None else value)
        self.fail(node, "no such operator")

    def _emit_comparison(self, parts: list[ast.expr], operators: list[ast.cmpop]) -> Number:
        values = [self.emit_number(part) for part in parts]
        conjunction = None
        for (a, b), operator in zip(pairwise(values), operators, strict=True):
            if type(operator) not in _COMPARISON_WORDS:
                self.fail(parts[0], "no such comparison")
            held = self.compare(_COMPARISON_WORDS[type(operator)], a, b)
            conjunction = held if conjunction is None else self.emit_logical_and(conjunction, held)
        assert conjunction is not None
        return conjunction

    def _emit_boolean(self, is_and: bool, parts: list[ast.expr]) -> Number:
        """Emit `and` (if `is_and`) or `or` of conditions, and return the result. As in Python, later conditions are evaluated
        only if needed."""
        first = self.emit_condition(parts[0])
        if len(parts) == 1 or (first.literal_value is not None and bool(first.literal_value) != is_and):
            return first
        if first.literal_value is not None:
            return self._emit_boolean(is_and, parts[1:])
        if self.mask is not None:
            return self._emit_boolean_lanes(first, is_and, parts[1:])
        place, rest, end = self.allocate_slot(TRUTH), self.make_label("more"), self.make_label("both")
        self.store_number(place, first)
        self.branch(first, *((rest, end) if is_and else (end, rest)))
        self.begin_block(rest)
        self.store_number(place, self._emit_boolean(is_and, parts[1:]))
        self.jump(end)
        self.begin_block(end)
        return self.load(place, TRUTH)

    def _emit_conditional(self, node: ast.expr, test: ast.expr, true_expr: ast.expr, false_expr: ast.expr) -> KernelItem:
        """Emit `true_expr if test else false_expr`. Only the expression that the test selects is evaluated."""
        condition = self.emit_condition(test)
        if condition.literal_value is not None:
            return self.emit_item(true_expr if condition.literal_value else false_expr)
        if condition.has_several_lanes:
            return self._emit_conditional_lanes(node, condition, true_expr, false_expr)
        yes, no, end = self.make_label("yes"), self.make_label("no"), self.make_label("chosen")
        self.branch(condition, yes, no)
        self.begin_block(yes)
        first = self.emit_item(true_expr)
        after_first = self.current_block
        self.begin_block(no)
        second = self.emit_item(false_expr)
        pairs = list(zip(flatten_item(first), flatten_item(second), strict=True))
        kinds = [a.kind if a.kind == b.kind else self._find_common_kind(a, b) for a, b in pairs]
        lanes = [max(a.lanes, b.lanes) for a, b in pairs]
        slots = [self.allocate_slot(kind, each) for kind, each in zip(kinds, lanes, strict=True)]
        self._store_leaves(second, kinds, lanes, slots)
        self.jump(end)
        self.current_block = after_first
        self._store_leaves(first, kinds, lanes, slots)
        self.jump(end)
        self.begin_block(end)
        loaded = iter([self.load(place, kind, each) for kind, place, each in zip(kinds, slots, lanes, strict=True)])

        def load_again(item: KernelItem) -> KernelItem:
            if isinstance(item, Array):
                self.fail(node, "a condition cannot choose between arrays")
            return rebuild_like(item, map(load_again, item)) if isinstance(item, tuple) else next(loaded)

        return load_again(first)

    def _find_common_kind(self, a: Number, b: Number) -> str:
        """Return the kind to which both alternatives of a selection are converted."""
        kinds = {a.kind, b.kind}
        if FLOAT in kinds or UNSIGNED in kinds:
            return self.match_kinds(a, b)[0].kind
        return DOUBLE if DOUBLE in kinds else INT

    def _store_leaves(self, item: KernelItem, kinds: list[str], lanes: list[int], slots: list[Number]) -> None:
        """Store each number of an item in its stack slot, converted to the slot's kind and number of lanes."""
        for number, kind, each, place in zip(flatten_item(item), kinds, lanes, slots, strict=True):
            value = self.convert(number, kind)
            self.store_number(place, self.broadcast(value) if each > 1 else value)

    def emit_not(self, value: Number) -> Number:
        """Emit the negation of a condition, or the bitwise complement of a number, and return the result."""
        ones = Number(value.kind, "true" if value.kind == TRUTH else "-1")
        return self.op("xor", value.kind, value, self.broadcast(ones) if value.has_several_lanes else ones)

    @contextmanager
    def restrict_lanes(self, condition: Number) -> Iterator[None]:
        """Restrict the code emitted within the `with` block to the lanes in which `condition` is true."""
        outer_mask = self.mask
        assert outer_mask is not None
        self.mask = self.emit_logical_and(outer_mask, condition)
        yield
        self.mask = outer_mask

    def _emit_boolean_lanes(self, first: Number, is_and: bool, parts: list[ast.expr]) -> Number:
        """Emit `and` (if `is_and`) or `or` of conditions, of which the first differs between lanes, and return the result."""
        first = self.broadcast(first)
        with self.restrict_lanes(first if is_and else self.emit_not(first)):
            rest = self._emit_boolean(is_and, parts)
        if is_and:
            return self.emit_logical_and(first, rest)
        return self.op("or", TRUTH, *self.match_lanes(first, rest))

    def _emit_conditional_lanes(self, node: ast.expr, condition: Number, true_expr: ast.expr, false_expr: ast.expr) -> KernelItem:
        """Emit `true_expr if condition else false_expr` for a condition that differs between lanes. Both expressions are
        evaluated."""
        with self.restrict_lanes(condition):
            first = self.emit_item(true_expr)
        with self.restrict_lanes(self.emit_not(condition)):
            second = self.emit_item(false_expr)

        def select_lanes(a: KernelItem, b: KernelItem) -> KernelItem:
            if isinstance(a, tuple):
                return rebuild_like(a, (select_lanes(x, y) for x, y in zip(a, b, strict=True)))
            if isinstance(a, Array):
                self.fail(node, "a condition cannot choose between arrays")
            kind = a.kind if a.kind == b.kind else self._find_common_kind(a, b)
            return self.select(condition, self.convert(a, kind), self.convert(b, kind))

        return select_lanes(first, second)

    def _emit_attribute(self, node: ast.expr, owner: ast.expr, attribute: str) -> KernelItem:
        """Return an attribute of a module, a field of a record, or the `shape` or `size` of an array."""
        if isinstance(owner, ast.Name) and isinstance(self.module_names.get(owner.id), ModuleType):
            return make_literal_number(getattr(self.module_names[owner.id], attribute))
        value = self._emit_before_load(owner)
        if attribute in getattr(value, "_fields", ()):
            return getattr(value, attribute)
        if isinstance(value, Array) and attribute == "shape":
            return value.lengths
        if isinstance(value, Array) and attribute == "size":
            return self.count_elements(value)
        if hasattr(value, "_fields"):
            self._fail_no_field(node, type(value), attribute)
        self.fail(node, f"no `{attribute}`")

    def compute_offset(self, node: ast.AST, array: Array, index: ast.expr) -> Number:
        """Return the offset of the indexed element, counted in elements from the start of the array."""
        parts = index.elts if isinstance(index, ast.Tuple) else [index]
        if len(parts) != len(array.lengths):
            self.fail(node, "an array needs one index for each axis")
        return self.emit_index_offset(node, array, [self.emit_number(part) for part in parts])

    def _emit_index(self, node: ast.expr, container: KernelItem, index: ast.expr) -> KernelItem:
        """Return an element or slice of a tuple, or an element or row of an array."""
        if isinstance(container, tuple) and isinstance(index, ast.Slice):
            return container[slice(*(self._constant_index(node, end) for end in (index.lower, index.upper, index.step)))]
        if isinstance(container, tuple):
            at = self.emit_number(index)
            if at.literal_value is None:
                self.fail(node, "the index of a tuple must be a literal")
            return container[int(at.literal_value)]
        if not isinstance(container, Array):
            self.fail(node, "only arrays and tuples have elements")
        if not isinstance(index, ast.Tuple) and len(container.lengths) > 1:
            return self.get_row(node, container, self.emit_number(index))
        return self.load_element(container, self.compute_offset(node, container, index))

    def _constant_index(self, node: ast.AST, number: ast.expr | None) -> int | None:
        """Return the integer literal of a tuple index; None if it is absent."""
        if number is None:
            return None
        known = self.emit_number(number).literal_value
        if not isinstance(known, int):
            self.fail(node, "these must be literal integers")
        return known

    def _emit_call(self, node: ast.Call, function: ast.expr, arguments: list[ast.expr]) -> KernelItem:
        """Emit a call of a built-in function, a record class or a kernel function, and return its result."""
        known = self.resolve_name(node, function)
        if is_record(known):
            return self._build_record(node, known)
        if node.keywords:
            self.fail(node, "only records take arguments by name")
        if known is len:
            value = self.emit_item(arguments[0])
            return value.lengths[0] if isinstance(value, Array) else make_literal_number(len(value))
        if known is allocate_scratch:
            count, dtype = self.emit_number(arguments[0]), self.resolve_name(node, arguments[1])
            if count.literal_value is None or not isinstance(dtype, ScalarType):
                self.fail(node, "COUNT of scratch(COUNT, TYPE) must be a literal")
            return Array(dtype, self.allocate(int(count.literal_value), dtype.stored_type), (count,))
        inputs = [self.emit_item(each) for each in arguments]
        if known in (load_consecutive, prefetch, load3, store3):
            return self._load_elements(node, known, inputs)
        try:
            written = EMITTER_BY_FUNCTION.get(known)
        except TypeError:
            written = None
        if written is not None:
            if not all(isinstance(each, Number) for each in inputs):
                self.fail(node, "these must be numbers")
            return written(self, *inputs)
        return self.call_function(node, known, inputs)

    def _build_record(self, node: ast.Call, record: Any) -> KernelItem:
        """Return the record that a call of a record class creates from positional and keyword arguments."""
        names = record._fields
        if len(node.args) > len(names):
            self.fail(node, f"`{record.__name__}` has {len(names)} fields, not {len(node.args)}")
        fields = dict(zip(names, map(self.emit_item, node.args), strict=False))
        self._add_keyword_fields(node, record, fields)
        missing = [name for name in names if name not in fields]
        if missing:
            self.fail(node, f"`{record.__name__}` is given no `{missing[0]}`")
        return self._build_checked_record(node, record, fields)

    def _replace_fields(self, node: ast.Call, item: KernelItem) -> KernelItem:
        """Return a copy of a record with new values of some fields."""
        if not hasattr(item, "_fields") or node.args:
            self.fail(node, "`_replace` is a function of records, and takes fields by name")
        fields: dict[str, KernelItem] = {}
        self._add_keyword_fields(node, type(item), fields)
        return self._build_checked_record(node, type(item), {**item._asdict(), **fields})

    def _add_keyword_fields(self, node: ast.Call, record: Any, fields: dict[str, KernelItem]) -> None:
        """Add the fields that a call sets by keyword to `fields`."""
        for each in node.keywords:
            name = each.arg or "**"
            if name not in record._fields:
                self._fail_no_field(node, record, name)
            if name in fields:
                self.fail(node, f"`{name}` is given twice")
            fields[name] = self.emit_item(each.value)

    def _fail_no_field(self, node: ast.AST, record: Any, name: str) -> NoReturn:
        self.fail(node, f"`{record.__name__}` has no field `{name}`: its fields are {', '.join(record._fields)}")

    def _build_checked_record(self, node: ast.Call, record: Any, fields: dict[str, KernelItem]) -> KernelItem:
        types = get_field_types(record)._asdict()
        return record(**{name: self.fit_to_type(node, name, item, types[name]) for name, item in fields.items()})

    def fit_to_type(self, node: ast.AST, name: str, item: KernelItem, type_: Any) -> KernelItem:
        """Return an item as `type_`. A constant is converted; any other item must already have this type. `name`: the name for
        error messages."""
        if type_ is Any:
            return item
        if isinstance(type_, ScalarType) and isinstance(item, Number):
            if item.literal_value is None and item.kind != type_.kind:
                self.fail(node, f"`{name}` is {type_.kind}, but gets {item.kind}")
            return self.to_kind(item, type_.kind)
        if isinstance(type_, ArrayType) and isinstance(item, Array):
            strided = item.steps is not None
            if (type_.axes, type_.is_strided) == (len(item.lengths), strided) and type_.element_type in (item.element_type, Any):
                return item
        elif isinstance(type_, tuple) and type(item) is type(type_) and len(item) == len(type_):
            return rebuild_like(item, (self.fit_to_type(node, name, a, b) for a, b in zip(item, type_, strict=True)))
        self.fail(node, f"`{name}` gets a value of another type")

    def _load_elements(self, node: ast.Call, literal_value: Any, inputs: list[KernelItem]) -> KernelItem:
        """Emit a call of `load_consecutive`, and return the consecutive elements as a tuple."""
        if len(inputs) < 2 or not (isinstance(inputs[0], Array) and isinstance(inputs[1], Number)):
            self.fail(node, "this needs an array and an index")
        array, at, *others = inputs
        if literal_value is prefetch:
            return self.prefetch(array, at)
        if literal_value is load_consecutive:
            count = others[0].literal_value
            if not isinstance(count, int) or count % 4 or not 0 < count <= MAX_CONSECUTIVE_ELEMENTS:
                self.fail(node, f"this must be a multiple of 4 up to {MAX_CONSECUTIVE_ELEMENTS} as a literal")
            return self.load_consecutive(node, array, at, count)
        if len(array.lengths) != 2 or array.steps is not None or array.element_type.kind not in (DOUBLE, FLOAT):
            self.fail(node, "this must be a contiguous array (n, 3) of floats")
        if literal_value is load3:
            return self.load3(node, array, at)
        self.store3(node, array, at, others[0])
        self.unit.written_arrays.add(array.origin)
        return ()

    def resolve_name(self, node: ast.AST, name: ast.expr) -> Any:
        """Return the Python object that a global name refers to, in the kernel's module, an imported package or the built-ins."""
        if isinstance(name, ast.Attribute) and isinstance(name.value, ast.Name):
            package = self.module_names.get(name.value.id)
            if isinstance(package, ModuleType):
                return getattr(package, name.attr)
        if isinstance(name, ast.Name):
            if name.id in self.module_names:
                return self.module_names[name.id]
            if hasattr(builtins, name.id):
                return getattr(builtins, name.id)
        self.fail(node, f"`{ast.unparse(name)}` is not known")
