"""Values of eight agents at once, as text in the intermediate language of LLVM.

`Lanes` answers to the operators and to the NumPy functions that the project's own kernels are written with (`meanings`): a
function of `numerics` that is called with lanes instead of arrays writes down its operations, in the order and with the
roundings that NumPy gives them. So each operation has one meaning for both."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from antdsl.machine_code.machine import Target

WIDTH = 8
F32, F64, BOOL, I8, I32, I64, PTR = "float", "double", "i1", "i8", "i32", "i64", "ptr"
TYPES: Mapping[Any, str] = {
    np.dtype(np.float32): F32, np.dtype(np.float64): F64, np.dtype(np.bool_): BOOL, np.dtype(np.int32): I32,
    np.dtype(np.int64): I64, np.dtype(np.uint64): I64, np.dtype(np.intp): I64, np.dtype(np.int8): I8, np.dtype(np.uint8): I8,
}  # fmt: skip
FLOATS = (F32, F64)
MANGLED = {F32: "f32", F64: "f64", BOOL: "i1", I8: "i8", I32: "i32", I64: "i64", PTR: "p0"}
BITS = {BOOL: 1, I8: 8, I32: 32, I64: 64}


def literal(value: Any, kind: str) -> str:
    """A number in the intermediate language; of a float the bits."""
    if kind in FLOATS:
        number = float(np.float32(value)) if kind == F32 else float(value)
        return f"0x{struct.unpack('>Q', struct.pack('>d', number))[0]:016X}"
    if kind == BOOL:
        return "true" if value else "false"
    whole = int(value)
    return str(whole - (1 << 64) if kind == I64 and whole >= 1 << 63 else whole)


class Lanes:
    """A value of each lane, or with `one` a single value; `name` is what the text calls it."""

    __slots__ = ("constant", "e", "kind", "name", "one")
    ndim = 1

    def __init__(self, e: Any, kind: str, name: str, *, one: bool = False, constant: bool = False) -> None:
        self.e, self.kind, self.name, self.one, self.constant = e, kind, name, one, constant

    @property
    def type(self) -> str:
        return self.kind if self.one else f"<{WIDTH} x {self.kind}>"

    @property
    def typed(self) -> str:
        return f"{self.type} {self.name}"

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method != "__call__" or any(value is not None for value in options.values()):
            return NotImplemented
        return self.e.meaning(ufunc, *inputs)

    def __array_function__(self, function: Any, types: Any, inputs: tuple[Any, ...], options: Mapping[str, Any]) -> Any:
        return NotImplemented if options else self.e.meaning(function, *inputs)

    def astype(self, dtype: Any) -> Lanes:
        found: Lanes = self.e.convert(self, TYPES[np.dtype(dtype)])
        return found

    def __add__(self, other: Any) -> Lanes:
        found: Lanes = self.e.arithmetic("add", self, other)
        return found

    def __radd__(self, other: Any) -> Lanes:
        found: Lanes = self.e.arithmetic("add", other, self)
        return found

    def __sub__(self, other: Any) -> Lanes:
        found: Lanes = self.e.arithmetic("sub", self, other)
        return found

    def __rsub__(self, other: Any) -> Lanes:
        found: Lanes = self.e.arithmetic("sub", other, self)
        return found

    def __mul__(self, other: Any) -> Lanes:
        found: Lanes = self.e.arithmetic("mul", self, other)
        return found

    def __rmul__(self, other: Any) -> Lanes:
        found: Lanes = self.e.arithmetic("mul", other, self)
        return found

    def __truediv__(self, other: Any) -> Lanes:
        found: Lanes = self.e.arithmetic("div", self, other)
        return found

    def __rtruediv__(self, other: Any) -> Lanes:
        found: Lanes = self.e.arithmetic("div", other, self)
        return found

    def __neg__(self) -> Lanes:
        found: Lanes = self.e.op(f"fneg {self.typed}", self.kind)
        return found

    def __and__(self, other: Any) -> Lanes:
        found: Lanes = self.e.bitwise("and", self, other)
        return found

    def __or__(self, other: Any) -> Lanes:
        found: Lanes = self.e.bitwise("or", self, other)
        return found

    def __xor__(self, other: Any) -> Lanes:
        found: Lanes = self.e.bitwise("xor", self, other)
        return found

    __rand__, __ror__, __rxor__ = __and__, __or__, __xor__

    def __rshift__(self, other: Any) -> Lanes:
        found: Lanes = self.e.bitwise("lshr", self, other)
        return found

    def __lshift__(self, other: Any) -> Lanes:
        found: Lanes = self.e.bitwise("shl", self, other)
        return found

    def __invert__(self) -> Lanes:
        found: Lanes = self.e.bitwise("xor", self, True if self.kind == BOOL else -1)
        return found

    def __lt__(self, other: Any) -> Lanes:
        found: Lanes = self.e.compare("lt", self, other)
        return found

    def __le__(self, other: Any) -> Lanes:
        found: Lanes = self.e.compare("le", self, other)
        return found

    def __gt__(self, other: Any) -> Lanes:
        found: Lanes = self.e.compare("gt", self, other)
        return found

    def __ge__(self, other: Any) -> Lanes:
        found: Lanes = self.e.compare("ge", self, other)
        return found

    def __eq__(self, other: object) -> Lanes:  # type: ignore[override]  # as arrays do
        found: Lanes = self.e.compare("eq", self, other)
        return found

    def __ne__(self, other: object) -> Lanes:  # type: ignore[override]
        found: Lanes = self.e.compare("ne", self, other)
        return found

    __hash__ = None  # type: ignore[assignment]


_NAMED = re.compile(r"@([\w.]+)")


class Module:
    """Functions and declarations of a compilation for a processor."""

    def __init__(self, target: Target) -> None:
        self.target = target
        self._declared: dict[str, str] = {}
        self.functions: dict[str, str] = {}

    def declare(self, name: str, result: str, arguments: list[str]) -> None:
        self._declared.setdefault(name, f"declare {result} @{name}({', '.join(arguments)})")

    def function(self, name: str, make: Callable[[], str]) -> None:
        """A function of that name, made where the module has none yet."""
        if name not in self.functions:
            self.functions[name] = ""  # in the making
            self.functions[name] = make()

    def text(self) -> str:
        """All of it."""
        return "\n".join((*self._declared.values(), *self.functions.values())) + "\n"

    def entries(self) -> list[str]:
        """The functions that are called from outside."""
        return [name for name, text in self.functions.items() if text.startswith("define void")]

    def unit(self, entry: str) -> str:
        """A function with all that it calls, which can be compiled without the others."""
        found, coming = {}, [entry]
        while coming:
            name = coming.pop()
            if name not in found and name in self.functions:
                found[name] = self.functions[name]
                coming += _NAMED.findall(found[name])
        named = {name for text in found.values() for name in _NAMED.findall(text)}
        declared = [text for name, text in self._declared.items() if name in named]
        return "\n".join((*declared, *(text for name, text in self.functions.items() if name in found))) + "\n"
