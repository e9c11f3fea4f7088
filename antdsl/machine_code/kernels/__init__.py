"""Kernels: loops over arrays that are written in a subset of Python and run as machine code.

`@kernel` marks a function that Python code calls with arrays. `@inlined` and `@kernel_helper` mark functions that kernels call
with any types. A kernel is parsed (`ast`) and translated once, for its annotated types, to typed instructions (`statements`,
`expressions`, `simd_loops`). The instructions define the meaning of the kernel. `ir` verifies them, and `rendering` writes
them as LLVM IR. For tests, an interpreter runs them one iteration at a time. `operations` has the table of all operations.

The subset has i64, u64, float64, float32 and bool; tuples; records; and arrays of one to three axes, read and written by
index. It has `for` over `range`, `simd_range`, arrays and tuples; `while`, `if`, `break`, `continue`, `return`; and the
functions of `kernel_functions`. Loops over `range` of up to four constants are unrolled. `simd_range(begin, end)` states that
no iteration reads what another one writes. Eight iterations then run at once in the SIMD lanes of a register.

A record is a `typing.NamedTuple` class of a module, with fields of kernel types. Like a tuple, it can be a parameter (with the
class as annotation), a variable, an argument or a result. `grid.first[cell]` reads a field. `Hit(face, distance=0)` builds a
record from fields in order or by name. `hit._replace(face=0)` returns a changed record, and `(0, *hit)` unpacks the fields
into a tuple. A field has the type that the class declares; a constant is converted to it. `Any` allows every type. Fields have
no default values in kernels. A Python caller passes a record, or a tuple of the same length. A returned record arrives in
Python as a flat tuple of its numbers.

When a kernel is translated, the annotations of its results and of the functions that it calls are checked. A number or an
array must have the annotated type; a constant is converted to it. Helpers that accept several number types have the annotation
`Any`.

Semantics in cases where Python or NumPy might give a different result:

- A variable keeps the type of its first value. float32 never mixes with float64 or integers: convert explicitly. A constant
  takes the type of the other operand; a constant that float32 cannot represent exactly is an error.
- i64 and u64 wrap around. A constant expression with a result that does not fit is an error. Shift counts are taken modulo 64.
- `//` rounds down, and the least i64 divided by -1 wraps around. Division by 0 is an error: the interpreter and the checked
  build report it, other builds divide by 1.
- Floats follow IEEE 754: `1.0 / 0.0` is infinity. The sign and the bits of a NaN are not defined.
- Casts of floats to integers truncate and saturate; NaN becomes 0.
- `min(a, b)` is `b if b < a else a`, `max(a, b)` is `b if b > a else a`. So the result is `a` if one is NaN or both are zeros.
- An index is at least 0 and below the length of its axis. The interpreter and the checked build report other indices.
- In a `simd_range` loop, an index is loop-invariant, or the loop variable plus a loop-invariant number. Such an index must be
  in range for inactive lanes too.
- Reading a variable or an element of `allocate_scratch` before anything was stored to it is an error that only the interpreter
  reports."""

from antdsl.machine_code.kernels.checks import KernelFault
from antdsl.machine_code.kernels.ir import NotInSubsetError
from antdsl.machine_code.kernels.kernel import inlined, kernel, kernel_helper
from antdsl.machine_code.kernels.kernel_functions import (
    allocate_scratch,
    bits_to_float,
    float_to_bits,
    load3,
    load_consecutive,
    prefetch,
    round_to_int,
    simd_range,
    store3,
)
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
    "NotInSubsetError",
    "Strided2",
    "allocate_scratch",
    "bits_to_float",
    "float_to_bits",
    "inlined",
    "kernel",
    "kernel_helper",
    "load3",
    "load_consecutive",
    "prefetch",
    "round_to_int",
    "simd_range",
    "store3",
]  # fmt: skip
