"""The types for annotations in kernels, and their LLVM types."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

# Kinds of values; only the name distinguishes u64 from i64.
DOUBLE, FLOAT, INT, UNSIGNED, TRUTH = "double", "float", "i64", "u64", "i1"
LLVM_TYPE_BY_KIND = {DOUBLE: "double", FLOAT: "float", INT: "i64", UNSIGNED: "i64", TRUTH: "i1"}


@dataclass(frozen=True, slots=True)
class ScalarType:
    """The type of a number. `dtype`: its NumPy type in arrays. `stored_type`: the LLVM type of an array element. `kind`: the kind
    of number that kernels compute with."""

    name: str
    dtype: np.dtype[Any]
    stored_type: str
    kind: str

    @property
    def loaded_kind(self) -> str:
        """Return the kind of a number just loaded from memory, before it is converted to the kind that kernels compute with."""
        return self.kind if LLVM_TYPE_BY_KIND[self.kind] == self.stored_type else self.stored_type


@dataclass(frozen=True, slots=True)
class ArrayType:
    """The type of an array: its number of axes and the type of its elements. `is_strided`: each axis has its own stride;
    otherwise the array must be contiguous."""

    axes: int
    element_type: ScalarType
    is_strided: bool = False


if TYPE_CHECKING:
    F64: TypeAlias = Any
    F32: TypeAlias = Any
    I64: TypeAlias = Any
    I32: TypeAlias = Any
    I16: TypeAlias = Any
    I8: TypeAlias = Any
    U64: TypeAlias = Any
    U32: TypeAlias = Any
    U8: TypeAlias = Any
    BOOL: TypeAlias = Any

    DtypeVariable = TypeVar("DtypeVariable", bound=np.generic)
    Array1: TypeAlias = NDArray[DtypeVariable]
    Array2: TypeAlias = NDArray[DtypeVariable]
    Array3: TypeAlias = NDArray[DtypeVariable]
    Strided2: TypeAlias = NDArray[DtypeVariable]

else:

    def _scalar(name: str, dtype: Any, stored_kind: str, kind: str) -> ScalarType:
        return ScalarType(name, np.dtype(dtype), stored_kind, kind)

    F64, F32 = _scalar("F64", np.float64, "double", DOUBLE), _scalar("F32", np.float32, "float", FLOAT)
    I64, I32 = _scalar("I64", np.int64, "i64", INT), _scalar("I32", np.int32, "i32", INT)
    I16, I8 = _scalar("I16", np.int16, "i16", INT), _scalar("I8", np.int8, "i8", INT)
    U64, U32 = _scalar("U64", np.uint64, "i64", UNSIGNED), _scalar("U32", np.uint32, "i32", INT)
    U8, BOOL = _scalar("U8", np.uint8, "i8", INT), _scalar("BOOL", np.bool_, "i8", TRUTH)

    class _Axes:
        def __init__(self, axes: int, strided: bool = False) -> None:
            self.axes, self.is_strided = axes, strided

        def __getitem__(self, element_type: ScalarType) -> ArrayType:
            return ArrayType(self.axes, element_type, self.is_strided)

    Array1, Array2, Array3, Strided2 = _Axes(1), _Axes(2), _Axes(3), _Axes(2, True)
