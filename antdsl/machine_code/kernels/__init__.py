"""Kernels: loops over arrays that are written in a subset of Python and run as machine code.

`@kernel` marks a function that is called with arrays, `@inlined` and `@called` functions that kernels call, for any types. The
function's text is read (`ast`) and written in LLVM's language (`statements`, `expressions`, `functions`), once for the types that
its annotations name; nothing of it runs in Python. Its operations are those of the text in their order, so its bits are those of
the same operations of NumPy.

The subset: whole numbers of 64 bits, float64, float32 and conditions; tuples; arrays of one to three axes, read and written by
index (never negative); `for` over `range`, `independent`, arrays and tuples; `while`, `if`, `break`, `continue`, `return`; the
functions of `functions`. A variable keeps the type of its first value. Nothing mixes float32 with float64 or whole numbers: a
number of the text takes the type of the other one, if float32 has it. Whole numbers wrap around, division by 0.0 is that of IEEE
754, and casts to whole numbers saturate. Loops over `range` of up to four numbers of the text are
written out. `independent(begin, end)` says that no turn reads what another one writes, and lets several be done at once. Indices
are not checked: what calls a kernel answers for them."""

from antdsl.machine_code.kernels.checks import KernelFault
from antdsl.machine_code.kernels.functions import (
    as_bits,
    as_float,
    consecutive,
    fetch_ahead,
    independent,
    put_three,
    scratch,
    three,
    whole,
)
from antdsl.machine_code.kernels.ir import NotInSubset
from antdsl.machine_code.kernels.kernel import called, inlined, kernel
from antdsl.machine_code.kernels.types import (
    BOOL,
    F32,
    F64,
    I8,
    I16,
    I32,
    I64,
    U8,
    U32,
    U64,
    Array1,
    Array2,
    Array3,
    Strided2,
)

__all__ = [
    "BOOL", "F32", "F64", "I8", "I16", "I32", "I64", "U8", "U32", "U64", "Array1", "Array2", "Array3", "KernelFault",
    "NotInSubset", "Strided2", "as_bits", "as_float", "called", "consecutive", "fetch_ahead", "independent", "inlined", "kernel",
    "put_three", "scratch", "three", "whole",
]  # fmt: skip
