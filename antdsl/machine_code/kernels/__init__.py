"""Kernels: loops over arrays that are written in a subset of Python and run as machine code.

`@kernel` marks a function that is called with arrays, `@inlined` and `@called` functions that kernels call, for any types. The
function is parsed (`ast`) and translated to typed instructions (`statements`, `expressions`, `side_by_side`), once for the types
of its annotations. The instructions are its definition: `ir` verifies them, and `rendering` writes them in LLVM's language. The
interpreter of the tests runs them one turn after another. The table of all operations is in `operations`.

The subset has i64, u64, float64, float32 and bool; tuples; records; arrays of one to three axes, read and written by index. It
has `for` over `range`, `independent`, arrays and tuples; `while`, `if`, `break`, `continue`, `return`; the functions of
`functions`. Loops over `range` of up to four constants are unrolled. `independent(begin, end)` says that no turn reads what
another one writes, and runs eight turns in the lanes of a register.

A record is a `typing.NamedTuple` class of a module, with fields that have types of kernels. It can be a parameter (an annotation
names the class), a variable, an argument and a result, as a tuple can. `grid.first[cell]` reads a field, `Hit(face, distance=0)`
builds a record from fields in their order or by name. `hit._replace(face=0)` gives another one, and `(0, *hit)` spreads fields in
a tuple. A field has the type that the class names: a constant takes it, and `Any` allows every type. Fields have no default value
here. The Python caller passes a record or a tuple of the same length, and gets the numbers of a returned record as a flat tuple.

Annotations of functions that kernels call, and of results, are checked when a kernel is written. A number or an array has the
type that the annotation names, a constant can take it. Helpers for several types of numbers have `Any`.

Semantics, where Python or NumPy might give something else:

- A variable keeps the type of its first value. float32 never mixes with float64 or integers: convert explicitly. A constant
  takes the type of the other operand if float32 has that number; otherwise it is an error.
- i64 and u64 wrap around. A result of constants that does not fit is an error. Shift counts are taken modulo 64.
- `//` rounds down, and the least i64 divided by -1 wraps around. Division by 0 is an error: the interpreter and the checked
  build report it, other builds divide by 1.
- Floats follow IEEE 754: `1.0 / 0.0` is infinity. The sign and the bits of a NaN are not defined.
- Casts of floats to integers truncate and saturate; NaN becomes 0.
- `min(a, b)` is `b if b < a else a`, `max(a, b)` is `b if b > a else a`: the first value where one is NaN or both are zeros.
- An index is 0 or more and below the length of its axis. The interpreter and the checked build report others.
- In an `independent` loop, a loop-invariant index, or the turn's number plus such a number, must be in range for inactive lanes
  too.
- Reading a variable or an element of `scratch` before anything was stored to it is an error that only the interpreter reports."""

from antdsl.machine_code.kernels.checks import KernelFault
from antdsl.machine_code.kernels.functions import (
    as_bits,
    as_float,
    fetch_ahead,
    independent,
    load_consecutive,
    nearest_integer,
    put_three,
    scratch,
    three,
)
from antdsl.machine_code.kernels.ir import NotInSubset
from antdsl.machine_code.kernels.kernel import called, inlined, kernel
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I8, I16, I32, I64, U8, U32, U64, Array1, Array2, Array3, Strided2

__all__ = [
    "BOOL",
    "F32",
    "F64",
    "I8",
    "I16",
    "I32",
    "I64",
    "U8",
    "U32",
    "U64",
    "Array1",
    "Array2",
    "Array3",
    "KernelFault",
    "NotInSubset",
    "Strided2",
    "as_bits",
    "as_float",
    "called",
    "fetch_ahead",
    "independent",
    "inlined",
    "kernel",
    "load_consecutive",
    "nearest_integer",
    "put_three",
    "scratch",
    "three",
]  # fmt: skip
