"""SIMD values with one lane for each of eight agents, and the builder of a plan's functions.

`Lanes` supports the operators and the NumPy functions of the project's formulas (`_EMITTER_BY_UFUNC`). A function of
`numerics` can be called with lanes instead of arrays. It then emits its operations, in the same order and with the same
rounding as in NumPy. So lanes and arrays give equal results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from antdsl.machine_code import number_kinds
from antdsl.machine_code.kernels.ir import Instruction, IrFunction, verify_functions
from antdsl.machine_code.kernels.rendering import render_function
from antdsl.machine_code.kernels.values import Number, format_llvm_type
from antdsl.machine_code.kernels.vectors import VectorBuilder
from antdsl.machine_code.llvm_module import LlvmModule
from antdsl.machine_code.number_kinds import BOOL, F32, F64, I8, I32, I64, LANE_COUNT, PTR, format_literal

_INTEGER_COMPARISONS = {"lt": "slt", "le": "sle", "gt": "sgt", "ge": "sge", "eq": "eq", "ne": "ne"}  # LLVM's names for integers
_ROUNDING_MAGIC = 6755399441055744.0  # after adding 1.5 * 2**52, the lowest bits are the rounded integer


def _make_operator(word: str, *, is_swapped: bool = False) -> Callable[[Lanes, Any], Lanes]:
    if is_swapped:
        return lambda self, other: self.builder.apply_binary(word, other, self)
    return lambda self, other: self.builder.apply_binary(word, self, other)


class Lanes(Number):
    """A number in a plan's function: one value per agent in eight lanes, or a single value that operators broadcast."""

    __slots__ = ("builder",)
    builder: LaneBuilder
    ndim = 1

    def __init__(self, e: LaneBuilder, kind: str, name: str, lanes: int, literal_value: Any) -> None:
        self.builder, self.kind, self.name, self.literal_value = e, kind, name, literal_value
        self.lanes, self.first_lane, self.type = lanes, None, format_llvm_type(kind, lanes)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or any(value is not None for value in options.values()):
            return NotImplemented
        return self.builder.apply_function(ufunc, *inputs)

    def __array_function__(self, function: Any, types: Any, inputs: tuple[Any, ...], options: Mapping[str, Any]) -> Any:
        return NotImplemented if options else self.builder.apply_function(function, *inputs)

    def astype(self, dtype: Any) -> Lanes:
        return self.builder.convert(self, number_kinds.KIND_BY_DTYPE[np.dtype(dtype)])

    def __neg__(self) -> Lanes:
        return self.builder.op("fneg", self.kind, self)

    def __invert__(self) -> Lanes:
        return self.builder.apply_binary("xor", self, True if self.kind == BOOL else -1)

    __add__, __radd__ = _make_operator("add"), _make_operator("add", is_swapped=True)
    __sub__, __rsub__ = _make_operator("sub"), _make_operator("sub", is_swapped=True)
    __mul__, __rmul__ = _make_operator("mul"), _make_operator("mul", is_swapped=True)
    __truediv__, __rtruediv__ = _make_operator("div"), _make_operator("div", is_swapped=True)
    __and__ = __rand__ = _make_operator("and")
    __or__ = __ror__ = _make_operator("or")
    __xor__ = __rxor__ = _make_operator("xor")
    __rshift__, __lshift__ = _make_operator("lshr"), _make_operator("shl")
    __lt__, __le__, __gt__, __ge__ = _make_operator("lt"), _make_operator("le"), _make_operator("gt"), _make_operator("ge")
    __eq__, __ne__ = _make_operator("eq"), _make_operator("ne")  # type: ignore[assignment]  # as arrays do
    __hash__ = None  # type: ignore[assignment]


class LaneBuilder(VectorBuilder[Lanes]):
    """Builder of one function of eight lanes. `known`: a stack of the reusable values in each open block."""

    def __init__(self, module: LlvmModule) -> None:
        super().__init__("plan", "plan")
        self.module = module
        self.known: list[dict[Any, Any]] = [{}]
        self._entry_instructions: list[Instruction] = []  # instructions at the start of the function

    def named_number(self, kind: str, name: str, lanes: int = 1, literal_value: Any = None) -> Lanes:
        return Lanes(self, kind, name, lanes, literal_value)

    def add_at_entry(self, op: str, kind: str, *operands: Number, x: Any = "") -> Lanes:
        """Add an instruction at the start of the function, and return its result, one number. `x`: the immediate constant."""
        output = self.named_number(kind, self.make_name("e"))
        self._entry_instructions.append(Instruction(op, output, operands, x, 0))
        return output

    def end(self, name: str, arguments: Sequence[Number], *results: Number, attribute: str = "", caller_text: str = "") -> None:
        """Add the function to the module as `name`. `caller_text`: the LLVM IR of the entry function that calls it."""
        self.emit_void("return", *results)
        self.blocks[0].body[:0] = self._entry_instructions
        result, full_name = results[0].type if results else "void", f"@{name}.inside" if caller_text else f"@{name}"
        definition = IrFunction(full_name, self.file, list(arguments), attribute, result, self.slots, self.blocks)
        verify_functions([definition], self.module.written_functions)
        self.module.functions[name] = caller_text + render_function(definition, self.module.declarations)
        self.module.written_functions[full_name] = replace(definition, slots=[], blocks=[])
        self.blocks, self._entry_instructions, self.known = [], [], []  # these objects refer to this builder

    @contextmanager
    def write_if(self, condition: Lanes) -> Iterator[None]:
        """Emit the code of the `with` block, to run only if `condition` (one value for all lanes) is true."""
        then, end = self.make_label("then"), self.make_label("done")
        self.branch(condition, then, end)
        self.begin_block(then)
        self.known.append({})
        yield
        self.known.pop()
        self.jump(end)
        self.begin_block(end)

    @contextmanager
    def write_loop(self, count: Lanes | int, step: int = 1) -> Iterator[Lanes]:
        """Emit a loop from 0 to before `count` (one value for all lanes). Yield its variable; the `with` block emits the body."""
        head, body, end = self.make_label("head"), self.make_label("body"), self.make_label("done")
        place = self.allocate_slot(I64)
        self.store_number(place, self.make_constant(0, I64, 1))
        self.jump(head)
        self.begin_block(head)
        number = self.load(place, I64)
        self.branch(number < count, body, end)
        self.begin_block(body)
        self.known.append({})
        yield number
        self.known.pop()
        self.store_number(place, number + step)
        self.jump(head)
        self.begin_block(end)

    def get_or_make(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return the value stored under `key` in this block or an enclosing one, or store and return the result of `make`."""
        for names in reversed(self.known):
            if key in names:
                return names[key]
        value = self.known[-1][key] = make()
        return value

    def call_function(self, name: str, kind: str, *arguments: Number, lanes: int = LANE_COUNT) -> Lanes:
        """Emit a call of the module's function `name`, and return the resulting number."""
        return self.op("call", kind, *arguments, x=f"@{name}", lanes=lanes)

    def apply_function(self, function: Any, *inputs: Any) -> Any:
        """Emit a NumPy function for lanes, and return the result; NotImplemented if the function is not supported."""
        return _EMITTER_BY_UFUNC[function](self, *inputs) if function in _EMITTER_BY_UFUNC else NotImplemented

    # --- values --------------------------------------------------------------------------------------------------------

    def make_constant(self, value: Any, kind: str, lanes: int = LANE_COUNT) -> Lanes:
        text = format_literal(value, kind)
        return self.named_number(kind, text if lanes == 1 else f"splat ({kind} {text})", lanes, value)

    def make_lane_numbers(self) -> Lanes:
        """Return the number of each lane: 0 in the first lane, 1 in the second, and so on."""
        return self.named_number(I64, f"<{', '.join(f'i64 {k}' for k in range(LANE_COUNT))}>", LANE_COUNT)

    def _as_operand(self, value: Any, model: Lanes) -> Lanes:
        """Return a value as an operand of an operation with `model`. A Python number takes the kind of `model`, as in NumPy."""
        if isinstance(value, Lanes):
            return value
        kind = model.kind
        if isinstance(value, np.generic):
            kind = number_kinds.KIND_BY_DTYPE[value.dtype]
        elif isinstance(value, float) and kind not in number_kinds.FLOAT_KINDS:
            kind = F64
        return self.make_constant(value, kind, model.lanes)

    def match_kinds(self, a: Any, b: Any) -> tuple[Lanes, Lanes]:
        """Convert two values to the common kind that NumPy would use. If one has eight lanes, the other is broadcast."""
        left, right = (a, self._as_operand(b, a)) if isinstance(a, Lanes) else (self._as_operand(a, b), b)
        if left.lanes != right.lanes:
            left, right = self.broadcast(left), self.broadcast(right)
        if left.kind == right.kind:
            return left, right
        kinds = {left.kind, right.kind}
        if F64 in kinds or kinds <= {F32, I32, I64}:
            kind = F64
        elif F32 in kinds:
            kind = F32
        else:
            kind = I64 if I64 in kinds else I32
        return self.convert(left, kind), self.convert(right, kind)

    def apply_binary(self, word: str, a: Any, b: Any) -> Lanes:
        """Emit an operation, and return its result. `word`: its name in `OPERATION_BY_NAME` without the letter for the kind."""
        left, right = self.match_kinds(a, b)
        row = f"f{word}" if left.kind in number_kinds.FLOAT_KINDS else _INTEGER_COMPARISONS.get(word, word)
        return self.op(row, BOOL if word in _INTEGER_COMPARISONS else left.kind, left, right)

    def emit_clamp(self, value: Lanes, low: Lanes, high: Lanes) -> Lanes:
        """Return a value clamped to the bounds `low` and `high`, which must not be NaN."""
        above = self.select_lanes(value > low, value, low)
        return self.select_lanes(above < high, above, high)

    def emit_is_nan(self, a: Lanes) -> Lanes:
        """Return whether a value is NaN."""
        return self.op("fno", BOOL, a, a)

    def select_lanes(self, condition: Lanes, true_value: Any, false_value: Any) -> Lanes:
        if not isinstance(true_value, Lanes) and not isinstance(false_value, Lanes):
            # as NumPy does for two Python numbers
            kind = F64 if isinstance(true_value, float) or isinstance(false_value, float) else I64
            true_value = self.make_constant(true_value, kind, condition.lanes)
        a, b = self.match_kinds(true_value, false_value)
        if condition.has_several_lanes or a.has_several_lanes:
            condition, a, b = self.broadcast(condition), self.broadcast(a), self.broadcast(b)
        return self.op("select", a.kind, condition, a, b)

    def convert(self, value: Lanes, kind: str) -> Lanes:
        """Convert a value as NumPy's `astype` does, except that floats outside an integer's range saturate and NaN becomes 0."""
        if value.kind == kind:
            return value
        if kind == BOOL:
            return value != 0
        if value.kind in number_kinds.FLOAT_KINDS:
            row = "fptosi" if kind not in number_kinds.FLOAT_KINDS else "fpext" if kind == F64 else "fptrunc"
        elif kind in number_kinds.FLOAT_KINDS:
            row = "uitofp" if value.kind == BOOL else "sitofp"
        elif number_kinds.BITS_BY_KIND[kind] < number_kinds.BITS_BY_KIND[value.kind]:
            row = "trunc"
        else:
            row = "zext" if value.kind == BOOL else "sext"
        return self.op(row, kind, value)

    def to_int32(self, value: Lanes) -> Lanes:
        """Convert a float64 with an integer value below 2**31 to i32. It adds 1.5 * 2**52 and takes the low bits of the sum.
        Other values give an unspecified number, but no undefined behaviour."""
        return self.convert(self.reinterpret_bits(value + _ROUNDING_MAGIC, I64), I32)

    def to_int64(self, value: Lanes) -> Lanes:
        """Convert a float64 to i64. Its value must be an integer below 2**51."""
        return self.reinterpret_bits(np.rint(value) + _ROUNDING_MAGIC, I64) - self.reinterpret_bits(
            self.make_constant(_ROUNDING_MAGIC, F64), I64
        )

    def reinterpret_bits(self, value: Lanes, kind: str) -> Lanes:
        """Return a value with the same bits, read as another kind of equal width."""
        return self.op("bitcast", kind, value)

    def any_lane(self, mask: Lanes) -> Lanes:
        """Return whether a mask is true in at least one lane."""
        return self.mask_to_i8(mask) != 0

    def mask_to_i8(self, mask: Lanes) -> Lanes:
        """Return a mask as one i8 with a bit per lane; the first lane is the lowest bit."""
        return self.op("lanes", I8, mask, lanes=1)

    def mask_to_i64(self, mask: Lanes) -> Lanes:
        """Return a mask as one i64 with a bit per lane; the first lane is the lowest bit."""
        return self.op("zext", I64, self.mask_to_i8(mask))

    def mask_from_i8(self, bits: Lanes) -> Lanes:
        """Return the mask of an i8 that has one bit per lane; the inverse of `mask_to_i8`."""
        return self.op("mask", BOOL, bits, lanes=LANE_COUNT)

    def emit_bit_test(self, word: Lanes, lane: Lanes) -> Lanes:
        """Return a mask: for each lane, whether the bit with the number `lane` of the single i64 `word` is 1."""
        return self.op("trunc", BOOL, word >> lane)

    def emit_lane_maximum(self, value: Lanes) -> Lanes:
        """Return the greatest of the eight lanes of an integer value."""
        return self.op("reduce.smax", value.kind, value, lanes=1)

    # --- memory --------------------------------------------------------------------------------------------------------

    def address(self, base: Number, index: Lanes | int, kind: str) -> Lanes:
        """Return the address of the element at `index`, which is a single number."""
        if isinstance(index, int):
            index = self.make_constant(index, I64, 1)
        return self.op("element", PTR, base, index, x=kind)

    def emit_offset_address(self, base: Number, offset: int) -> Lanes:
        """Return the address that is `offset` bytes after `base`."""
        return self.address(base, offset, I8)

    def load_lanes(self, base: Number, index: Lanes | int, kind: str) -> Lanes:
        """Load eight consecutive elements; the first is at `index`, a single number. For BOOL, bytes become conditions."""
        stored = I8 if kind == BOOL else kind
        value = self.op("load", stored, self.address(base, index, stored), x=", align 1", lanes=LANE_COUNT)
        return self.convert(value, kind)

    def store_lanes(self, base: Number, index: Lanes | int, value: Lanes) -> None:
        """Store eight consecutive elements; the first is at `index`, a single number. Conditions become bytes."""
        stored = self.to_stored_form(value)
        place = self.address(base, index, stored.kind)
        self.emit_void("store", self.broadcast(stored), place, x=", align 1")

    def store_masked(self, mask: Lanes, base: Number, index: Lanes, value: Lanes) -> None:
        """Store eight consecutive elements, but only lanes in `mask`. No other thread may write to any of them meanwhile."""
        stored = self.to_stored_form(value)
        place = self.address(base, index, stored.kind)
        old_value = self.op("load", stored.kind, place, x=", align 1", lanes=LANE_COUNT)
        self.emit_void("store", self.select_lanes(mask, stored, old_value), place, x=", align 1")

    def to_stored_form(self, value: Lanes) -> Lanes:
        """Return a condition as bytes, as arrays store it. Return any other value unchanged."""
        return self.convert(value, I8) if value.kind == BOOL else value

    def prefetch(self, place: Number) -> None:
        """Prefetch the memory at an address. Any address is allowed."""
        self.emit_void("prefetch", place)

    def load_scalar(self, base: Number, index: Lanes | int, kind: str) -> Lanes:
        stored = I8 if kind == BOOL else kind
        return self.convert(self.load(self.address(base, index, stored), stored), kind)

    def gather(self, base: Number, index: Lanes, kind: str) -> Lanes:
        """Load one element per lane, at the index of the lane, which must be within the array. It uses eight single loads,
        which are faster than the gather instruction of many processors."""
        stored = I8 if kind == BOOL else kind
        each = (self.load_scalar(base, self.convert(self.extract_lane(index, lane), I64), stored) for lane in range(LANE_COUNT))
        return self.convert(self.combine_lanes(each), kind)


def add_elementwise_function(module: LlvmModule, name: str, kinds: tuple[str, ...], formula: Callable[..., Any]) -> str:
    """Add a function that computes a NumPy formula for lanes to the module, unless it exists. Return its name."""
    if name not in module.functions:
        e = LaneBuilder(module)
        inputs = [e.named_number(kind, f"%x{k}", LANE_COUNT) for k, kind in enumerate(kinds)]
        e.end(name, inputs, formula(*inputs), attribute="noinline")
    return name


def _emit_minimum(e: LaneBuilder, a: Any, b: Any) -> Lanes:
    """Return the lesser of two numbers in each lane; NaN if one of them is NaN."""
    left, right = e.match_kinds(a, b)
    output = e.select_lanes(left > right, right, left)
    return output if right.literal_value is not None else e.select_lanes(e.emit_is_nan(right), right, output)


def _emit_maximum(e: LaneBuilder, a: Any, b: Any) -> Lanes:
    left, right = e.match_kinds(a, b)
    output = e.select_lanes(left < right, right, left)
    return output if right.literal_value is not None else e.select_lanes(e.emit_is_nan(right), right, output)


def _emit_fmin(e: LaneBuilder, a: Any, b: Any) -> Lanes:
    """Return the lesser of two numbers in each lane; if one of them is NaN, return the other."""
    left, right = e.match_kinds(a, b)
    return e.select_lanes(e.emit_is_nan(right), left, e.select_lanes(left < right, left, right))


def _emit_fmax(e: LaneBuilder, a: Any, b: Any) -> Lanes:
    left, right = e.match_kinds(a, b)
    return e.select_lanes(e.emit_is_nan(right), left, e.select_lanes(left > right, left, right))


def _emit_frexp(e: LaneBuilder, a: Lanes) -> tuple[Lanes, Lanes]:
    """Split a normal float64 into a fraction in [0.5, 1) and a power of two. Return the fraction and the exponent (i32)."""
    bits = e.reinterpret_bits(a, I64)
    power = e.convert((bits >> 52) & 0x7FF, I32) - 1022
    return e.reinterpret_bits((bits & ~(0x7FF << 52)) | (1022 << 52), F64), power


def _emit_ldexp(e: LaneBuilder, a: Lanes, power: Lanes) -> Lanes:
    """Return `a * 2**power`. `power`: an integer from -1022 to 1023."""
    return a * e.reinterpret_bits((e.convert(power, I64) + 1023) << 52, F64)


def _emit_fmod(e: LaneBuilder, a: Any, b: Any) -> Lanes:
    """Return the exact remainder of `a / b`, with the sign of `a`. The lanes run one by one unless each |a| is below |b|."""
    left, right = e.match_kinds(a, b)
    result = e.allocate_slot(left.kind, LANE_COUNT)
    e.store_number(result, left)
    with e.write_if(e.any_lane(~(_make_unary("fabs")(e, left) < _make_unary("fabs")(e, right)))):
        for lane in range(LANE_COUNT):
            rest = e.op("frem", left.kind, e.extract_lane(left, lane), e.extract_lane(right, lane))
            e.store_number(e.address(result, lane, left.kind), rest)
    return e.load(result, left.kind, LANE_COUNT)


def _make_unary(row: str) -> Callable[[LaneBuilder, Lanes], Lanes]:
    return lambda e, a: e.op(row, a.kind, a)


def _make_binary(word: str) -> Callable[[LaneBuilder, Any, Any], Lanes]:
    return lambda e, a, b: e.apply_binary(word, a, b)


# The code of NumPy functions on lanes. Results have the same bits as in NumPy, including NaN and signs of zero.
_EMITTER_BY_UFUNC: Mapping[Any, Callable[..., Any]] = {
    np.add: _make_binary("add"), np.subtract: _make_binary("sub"), np.multiply: _make_binary("mul"),
    np.true_divide: _make_binary("div"), np.less: _make_binary("lt"), np.less_equal: _make_binary("le"),
    np.greater: _make_binary("gt"), np.greater_equal: _make_binary("ge"),
    np.equal: _make_binary("eq"), np.not_equal: _make_binary("ne"),
    np.logical_and: _make_binary("and"), np.logical_or: _make_binary("or"), np.logical_not: lambda e, a: ~a,
    np.bitwise_and: _make_binary("and"), np.bitwise_or: _make_binary("or"), np.bitwise_xor: _make_binary("xor"),
    np.right_shift: _make_binary("lshr"), np.left_shift: _make_binary("shl"),
    np.negative: _make_unary("fneg"), np.absolute: _make_unary("fabs"), np.floor: _make_unary("floor"),
    np.rint: _make_unary("rint"), np.sqrt: _make_unary("sqrt"), np.frexp: _emit_frexp, np.ldexp: _emit_ldexp, np.fmod: _emit_fmod,
    np.minimum: _emit_minimum, np.maximum: _emit_maximum, np.fmin: _emit_fmin, np.fmax: _emit_fmax,
    np.clip: lambda e, a, low, high: _emit_minimum(e, _emit_maximum(e, a, low), high),
    np.isfinite: lambda e, a: e.op("fabs", a.kind, a) < np.inf,
    np.where: lambda e, condition, then, other: e.select_lanes(condition, then, other),
    np.ndim: lambda e, a: 1,
    np.all: lambda e, a: False,  # lane values are unknown at compile time
}  # fmt: skip
