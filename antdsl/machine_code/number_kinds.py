"""The kinds of numbers in machine code, such as float64, and the number of SIMD lanes."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

LANE_COUNT = 8  # agents, or iterations of a loop, per vector
F32, F64, BOOL, I8, I32, I64, PTR = "float", "double", "i1", "i8", "i32", "i64", "ptr"
KIND_BY_DTYPE: Mapping[Any, str] = {
    np.dtype(np.float32): F32, np.dtype(np.float64): F64, np.dtype(np.bool_): BOOL, np.dtype(np.int32): I32,
    np.dtype(np.int64): I64, np.dtype(np.uint64): I64, np.dtype(np.intp): I64, np.dtype(np.int8): I8, np.dtype(np.uint8): I8,
}  # fmt: skip
FLOAT_KINDS = (F32, F64)
BITS_BY_KIND = {BOOL: 1, I8: 8, I32: 32, I64: 64}


def format_literal(value: Any, kind: str) -> str:
    """Return a number as a literal in LLVM IR. Floats are written by their bits."""
    if kind in FLOAT_KINDS:
        number = float(np.float32(value)) if kind == F32 else float(value)
        return f"0x{struct.unpack('>Q', struct.pack('>d', number))[0]:016X}"
    if kind == BOOL:
        return "true" if value else "false"
    integer = int(value)
    return str(integer - (1 << 64) if kind == I64 and integer >= 1 << 63 else integer)
