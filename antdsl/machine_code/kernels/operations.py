"""The table of all operations of kernels and plans: their types, their LLVM IR, and what they compute for one lane, in Python.

The types are LLVM's. Its integer types have no sign; instead, some operations are signed or unsigned (`sdiv`, `udiv`).
Operations on numbers work lane by lane, so one table entry covers both the scalar and the vector form. Results are exact, or
rounded once to nearest, ties to even:

- Integers wrap around. Shift counts are 0 to 63 (`arithmetic` takes them modulo 64).
- Floats follow IEEE 754, with denormals. No operation is fused. The sign and the payload of a NaN are not defined.
- Comparisons with NaN are false, except `fne`.
- Casts of floats to integers truncate and saturate; NaN becomes 0."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

DTYPE_BY_TYPE: Final[Mapping[str, Any]] = {
    "double": np.float64, "float": np.float32, "i64": np.int64, "i32": np.int32, "i16": np.int16, "i8": np.int8, "i1": np.bool_,
}  # fmt: skip
# Classes of types: floats, integers, conditions, addresses; numbers, and all types.
TYPES_BY_CLASS: Final[Mapping[str, frozenset[str]]] = {
    "f": frozenset({"double", "float"}),
    "i": frozenset({"i64", "i32", "i16", "i8"}),
    "b": frozenset({"i1"}),
    "p": frozenset({"ptr"}),
}


class Operation(NamedTuple):
    """One operation of kernels and plans.

    - `operand_types`: one letter per operand, for the types it may have; `=` is the type of the first operand, `n` any number,
      `v` any type
    - `result_type`: the letter for the type of the result; `2` is the type of the second operand
    - `text`: the LLVM IR, with format fields for the operands, the result `r` and the immediate constant `x`
    - `meaning`: a function of NumPy scalars that computes the result; if it is None, the interpreter implements the operation
    - `is_lanewise`: whether each lane of the result depends only on the same lane of the operands
    - `extra_types`: the parameter types after the operands in the declaration of an LLVM function"""

    operand_types: str
    result_type: str
    text: str
    meaning: Callable[..., Any] | None = None
    is_lanewise: bool = True
    extra_types: str = ""


def to_unsigned(a: Any) -> int:
    """Return the value of an integer with its bits read as unsigned."""
    ones: int = (1 << 8 * a.dtype.itemsize) - 1
    return int(a) & ones


def _apply_unsigned(function: Callable[[int, int], Any]) -> Callable[[Any, Any], Any]:
    """Return a function that reads its signed integers as unsigned and calls `function` with them."""
    return lambda a, b: wrap_to_dtype(function(to_unsigned(a), to_unsigned(b)), a.dtype)


def wrap_to_dtype(number: int | bool, dtype: Any = np.int64) -> Any:
    """Return an integer wrapped to the number of bits of `dtype`. A condition (bool) is returned unchanged."""
    if isinstance(number, bool):
        return np.bool_(number)
    dtype = np.dtype(dtype)
    half = 1 << 8 * dtype.itemsize - 1
    return dtype.type((number + half) % (2 * half) - half)


def _divide_truncating(a: Any, b: Any) -> Any:
    """Return the quotient of two integers, rounded toward zero."""
    x, y = int(a), int(b)
    return wrap_to_dtype(abs(x) // abs(y) * (1 if (x < 0) == (y < 0) else -1), a.dtype)


def _remainder_truncating(a: Any, b: Any) -> Any:
    """Return the remainder of a division that rounds toward zero."""
    x, y = int(a), int(b)
    return wrap_to_dtype(abs(x) % abs(y) * (-1 if x < 0 else 1), a.dtype)


def _make_saturating_cast(is_signed: bool) -> Callable[[Any, Any], Any]:
    """Return a function that casts a float to an integer. It truncates, saturates, and converts NaN to 0."""

    def cast_saturating(a: Any, dtype: Any) -> Any:
        bounds, number = np.iinfo(dtype if is_signed else f"u{np.dtype(dtype).itemsize}"), float(a)
        least, most = int(bounds.min), int(bounds.max)
        if math.isnan(number):
            return wrap_to_dtype(0, dtype)
        return wrap_to_dtype(most if number >= most else least if number <= least else int(number), dtype)

    return cast_saturating


def _truncate_bits(a: Any, dtype: Any) -> Any:
    """Return the low bits of an integer as a number of `dtype`."""
    return np.bool_(int(a) & 1) if np.dtype(dtype) == np.bool_ else a.astype(dtype)


def _reinterpret_bits(a: Any, dtype: Any) -> Any:
    """Return the number of type `dtype` that has the same bits as `a`."""
    return a.view(dtype)


def _cast_to_dtype(a: Any, dtype: Any) -> Any:
    return a.astype(dtype)


def _cast_unsigned(a: Any, dtype: Any) -> Any:
    """Return an integer, with its bits read as unsigned, cast to `dtype`."""
    return (a if a.dtype == np.bool_ else a.view(f"u{a.dtype.itemsize}")).astype(dtype)


def _make_binary_operations(operand_types: str, meanings: Mapping[str, Callable[..., Any]]) -> dict[str, Operation]:
    """Return operations with two operands, by their LLVM names. `meanings`: for each name, the function of NumPy scalars that
    computes the result."""
    return {
        name: Operation(operand_types, "=", name + " {0.typed_name}, {1.name}", meaning) for name, meaning in meanings.items()
    }


def _make_comparisons(
    operand_types: str, prefix: str, word: str, sign: str, meanings: Mapping[str, Callable[..., Any]]
) -> dict[str, Operation]:
    """Return the comparisons by name. `prefix`: the start of their names in the table. `word` and `sign`: parts of their LLVM
    names."""
    return {
        f"{prefix}{name}": Operation(operand_types, "b", f"{word} {sign}{name}" + " {0.typed_name}, {1.name}", meaning)
        for name, meaning in meanings.items()
    }


def _make_casts(operand_types: str, result_type: str, meanings: Mapping[str, Callable[..., Any]]) -> dict[str, Operation]:
    """Return the casts by name. `meanings`: for each name, a function of a number and the result type."""
    return {
        name: Operation(operand_types, result_type, name + " {0.typed_name} to {r.type}", meaning)
        for name, meaning in meanings.items()
    }


def _make_functions(operand_types: str, meanings: Mapping[str, Callable[..., Any]]) -> dict[str, Operation]:
    """Return the operations that call an LLVM function, by the function's name."""
    arguments = ", ".join(f"{{{k}.typed_name}}" for k in range(len(operand_types)))
    text = "call {r.type} @llvm.NAME.{0.intrinsic_suffix}(" + arguments + ")"
    return {name: Operation(operand_types, "=", text.replace("NAME", name), meaning) for name, meaning in meanings.items()}


def _make_reductions(operand_types: str, meanings: Mapping[str, Callable[..., Any]]) -> dict[str, Operation]:
    """Return the operations that reduce all lanes to one number, by name. `meanings`: for each name, a function that combines
    two numbers."""
    text = "call {r.type} @llvm.vector.reduce.NAME.{0.intrinsic_suffix}({0.typed_name})"
    return {
        f"reduce.{name}": Operation(operand_types, operand_types, text.replace("NAME", name), meaning, is_lanewise=False)
        for name, meaning in meanings.items()
    }


def _count_trailing_zeros(a: Any) -> Any:
    """Return the number of trailing zero bits of a nonzero integer."""
    return a.dtype.type((int(a) & -int(a)).bit_length() - 1)


_ORDER_OPERATORS: Final = {"lt": operator.lt, "le": operator.le, "gt": operator.gt, "ge": operator.ge}
OPERATION_BY_NAME: Final[Mapping[str, Operation]] = {
    **_make_binary_operations("f=", {"fadd": operator.add, "fsub": operator.sub, "fmul": operator.mul, "fdiv": operator.truediv}),
    **_make_binary_operations("f=", {"frem": np.fmod}),
    **_make_functions("f", {"sqrt": np.sqrt, "floor": np.floor, "ceil": np.ceil, "rint": np.rint, "fabs": np.abs}),
    "fneg": Operation("f", "=", "fneg {0.typed_name}", operator.neg),
    **_make_binary_operations(
        "i=",
        {
            "add": operator.add,
            "sub": operator.sub,
            "mul": operator.mul,
            "sdiv": _divide_truncating,
            "srem": _remainder_truncating,
        },
    ),
    **_make_binary_operations(
        "i=",
        {
            "udiv": _apply_unsigned(operator.floordiv),
            "urem": _apply_unsigned(operator.mod),
            "lshr": _apply_unsigned(operator.rshift),
        },
    ),
    **_make_functions("i", {"ctpop": lambda a: a.dtype.type(to_unsigned(a).bit_count())}),
    **_make_functions("i=", {"smin": min}),
    "cttz": Operation(
        "i",
        "=",
        "call {r.type} @llvm.cttz.{0.intrinsic_suffix}({0.typed_name}, i1 true)",
        _count_trailing_zeros,
        extra_types=", i1",
    ),
    **_make_binary_operations("i=", {"shl": operator.lshift, "ashr": operator.rshift}),
    **_make_binary_operations("n=", {"and": operator.and_, "or": operator.or_, "xor": operator.xor}),
    **_make_comparisons("f=", "f", "fcmp", "o", {**_ORDER_OPERATORS, "eq": operator.eq}),
    **_make_comparisons("f=", "f", "fcmp", "u", {"ne": operator.ne, "no": lambda a, b: (a != a) | (b != b)}),
    **_make_comparisons("i=", "s", "icmp", "s", _ORDER_OPERATORS),
    **_make_comparisons("i=", "u", "icmp", "u", {name: _apply_unsigned(function) for name, function in _ORDER_OPERATORS.items()}),
    **_make_comparisons("n=", "", "icmp", "", {"eq": operator.eq, "ne": operator.ne}),
    "select": Operation("bvv", "2", "select {0.typed_name}, {1.typed_name}, {2.typed_name}", lambda c, a, b: a if c else b),
    **_make_casts("i", "i", {"sext": _cast_to_dtype}),
    **_make_casts("i", "n", {"trunc": _truncate_bits}),
    **_make_casts("n", "n", {"zext": _cast_unsigned, "uitofp": _cast_unsigned, "bitcast": _reinterpret_bits}),
    **_make_casts("i", "f", {"sitofp": _cast_to_dtype}),
    **_make_casts("f", "f", {"fpext": _cast_to_dtype, "fptrunc": _cast_to_dtype}),
    "fptosi": Operation(
        "f",
        "i",
        "call {r.type} @llvm.fptosi.sat.{r.intrinsic_suffix}.{0.intrinsic_suffix}({0.typed_name})",
        _make_saturating_cast(True),
    ),
    "fptoui": Operation(
        "f",
        "i",
        "call {r.type} @llvm.fptoui.sat.{r.intrinsic_suffix}.{0.intrinsic_suffix}({0.typed_name})",
        _make_saturating_cast(False),
    ),
    # Memory. `x`: the type of an element or of a stack slot, or the alignment of a load or store.
    "alloca": Operation("", "p", "alloca {x}", is_lanewise=False),
    "element": Operation("pi", "p", "getelementptr {x}, {0.typed_name}, {1.typed_name}", is_lanewise=False),
    "load": Operation("p", "v", "load {r.type}, {0.typed_name}{x}", is_lanewise=False),
    "store": Operation("vp", "", "store {0.typed_name}, {1.typed_name}{x}", is_lanewise=False),
    "volatile": Operation("vp", "", "store volatile {0.typed_name}, {1.typed_name}", is_lanewise=False),
    "atomic.add": Operation("pi", "2", "atomicrmw add {0.typed_name}, {1.typed_name} monotonic", operator.add, is_lanewise=False),
    "atomic.max": Operation("pi", "2", "atomicrmw max {0.typed_name}, {1.typed_name} monotonic", max, is_lanewise=False),
    "is_null": Operation("p", "b", "icmp eq {0.typed_name}, null"),
    "prefetch": Operation(
        "p",
        "",
        "call void @llvm.prefetch.p0({0.typed_name}, i32 0, i32 3, i32 1)",
        is_lanewise=False,
        extra_types=", i32, i32, i32",
    ),
    # Lanes. `x`: one or several lane numbers.
    "insertelement": Operation("vv", "=", "insertelement {0.typed_name}, {1.typed_name}, i64 {x}", is_lanewise=False),
    "extractelement": Operation("v", "v", "extractelement {0.typed_name}, i64 {x}", is_lanewise=False),
    "shufflevector": Operation("v=", "v", "shufflevector {0.typed_name}, {1.typed_name}, {x}", is_lanewise=False),
    "lanes": Operation("b", "i8", "bitcast {0.typed_name} to {r.type}", is_lanewise=False),
    "mask": Operation("i", "b", "bitcast {0.typed_name} to {r.type}", is_lanewise=False),
    **_make_reductions("i", {"smax": max, "add": operator.add}),
    **_make_reductions("f", {"fmin": np.fmin, "fmax": np.fmax}),
    "permd": Operation(
        "ii", "=", "call {r.type} @llvm.x86.avx2.permd({0.typed_name}, {1.typed_name})", is_lanewise=False
    ),  # of AVX2
    # Calls, and structures of several results. `x`: the name of a function, or the index of a result.
    "call": Operation("*", "v", "call {r.type} {x}({all})", is_lanewise=False),
    "extractvalue": Operation("v", "v", "extractvalue {0.typed_name}, {x}", is_lanewise=False),
    "insertvalue": Operation("vv", "=", "insertvalue {0.typed_name}, {1.typed_name}, {x}", is_lanewise=False),
    # Ends of blocks. `x`: the labels of the next blocks.
    "jump": Operation("", "", "br label %{x[0]}", is_lanewise=False),
    "branch": Operation("b", "", "br {0.typed_name}, label %{x[0]}, label %{x[1]}", is_lanewise=False),
    "return": Operation("*", "", "ret {all}", is_lanewise=False),
    # Time: the processor's counter, a wait for all earlier instructions, and a barrier against reordering.
    "ticks": Operation("", "i", "call {r.type} @llvm.readcyclecounter()", lambda: np.int64(0), is_lanewise=False),
    "wait": Operation("", "", "call void @llvm.x86.sse2.lfence()", is_lanewise=False),  # of x86
    "border": Operation("", "", 'call void asm sideeffect "", ""()', is_lanewise=False),
    # Checks of the checked build and of the interpreter (`checks`). `x`: the number of consecutive elements.
    "index": Operation("ii*", "", "", is_lanewise=False),
    "span": Operation("i*", "", "", is_lanewise=False),
    "divisor": Operation("i*", "", "", is_lanewise=False),
}
BLOCK_ENDS: Final = frozenset({"jump", "branch", "return"})
