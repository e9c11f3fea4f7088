"""The values of a kernel's expressions during translation: numbers, arrays, and tuples or records of these."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from antdsl.machine_code.kernels.records import rebuild_like
from antdsl.machine_code.kernels.types import DOUBLE, FLOAT, INT, LLVM_TYPE_BY_KIND, TRUTH, UNSIGNED, ScalarType
from antdsl.machine_code.number_kinds import F32, F64, I64, format_literal

KernelItem = Any  # Number, Array, or a tuple or record of items
_INTRINSIC_SUFFIXES = {"double": "f64", "float": "f32", "ptr": "p0"}


@dataclass(slots=True, unsafe_hash=True)
class Number:
    """A number in the LLVM IR of a function.

    - `kind`, `name`: its kind, and its name in the LLVM IR
    - `literal_value`: its value if it is a literal, else None
    - `lanes`: its number of lanes
    - `first_lane`: the number in the first lane if the value increases by one from lane to lane; else None
    - `type`: its LLVM type

    Numbers never change. The class is not `frozen`, because that would make numbers slow to create."""

    kind: str
    name: str
    literal_value: int | float | bool | None = None
    lanes: int = 1
    first_lane: Number | None = None
    type: str = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self.type = format_llvm_type(self.kind, self.lanes)

    @property
    def has_several_lanes(self) -> bool:
        """Return whether the number has several lanes."""
        return self.lanes > 1

    @property
    def lane_type(self) -> str:
        """Return the LLVM type of one lane."""
        return LLVM_TYPE_BY_KIND.get(self.kind, self.kind)

    @property
    def typed_name(self) -> str:
        """Return the LLVM type and the name, as an operand in LLVM IR."""
        return f"{self.type} {self.name}"

    @property
    def intrinsic_suffix(self) -> str:
        """Return the type suffix of LLVM intrinsics for numbers of this type."""
        one = _INTRINSIC_SUFFIXES.get(self.lane_type, self.lane_type)
        return f"v{self.lanes}{one}" if self.lanes > 1 else one


@cache
def format_llvm_type(kind: str, lanes: int = 1) -> str:
    """Return the LLVM type of numbers of a kind with `lanes` lanes."""
    one = LLVM_TYPE_BY_KIND.get(kind, kind)
    return f"<{lanes} x {one}>" if lanes > 1 else one


@dataclass(frozen=True, slots=True)
class Array:
    """An array in the LLVM IR of a function.

    `lengths`: the lengths of its axes. `steps`: the stride along each axis, in elements; None if the array is contiguous.
    `origin`: the number of the kernel's array argument; -1 for scratch memory."""

    element_type: ScalarType
    address: Number
    lengths: tuple[Number, ...]
    steps: tuple[Number, ...] | None = None
    origin: int = -1  # number of the kernel's argument, -1 for scratch


def make_literal_number(value: Any) -> Number:
    """Return a Python bool, int or float, or a NumPy scalar, as a literal number. Raises TypeError for any other value."""
    if isinstance(value, bool):
        return Number(TRUTH, "true" if value else "false", value)
    kind = type(value).__name__
    if kind == "uint64":
        return Number(UNSIGNED, format_literal(value, I64), int(value))
    if isinstance(value, float):  # includes np.float64
        return Number(DOUBLE, format_literal(value, F64), float(value))
    if isinstance(value, int) or kind in ("int64", "int32", "intp"):
        integer = int(value)
        return Number(UNSIGNED if integer >= 1 << 63 else INT, format_literal(integer, I64), integer)
    if kind == "float32":
        return Number(FLOAT, format_literal(value, F32))
    if kind == "bool":  # of NumPy
        return Number(TRUTH, "true" if value else "false", bool(value))
    raise TypeError(f"{value!r} is not a number of a kernel")


def flatten_item(item: KernelItem) -> Iterator[Number]:
    """Yield all numbers in an item, in order. An array yields its address, its lengths and its strides."""
    if isinstance(item, tuple):
        for each in item:
            yield from flatten_item(each)
    elif isinstance(item, Array):
        yield item.address
        yield from item.lengths
        yield from item.steps or ()
    else:
        yield item


def has_arrays(item: KernelItem) -> bool:
    """Return whether an item is an array or contains one."""
    return any(map(has_arrays, item)) if isinstance(item, tuple) else isinstance(item, Array)


def make_type_key(item: KernelItem) -> str:
    """Return a text that identifies the types in an item. A function is translated once for all arguments with equal texts."""
    if isinstance(item, tuple):
        record = "" if type(item) is tuple else f"{type(item).__module__}.{type(item).__qualname__}"
        return f"{record}({','.join(make_type_key(each) for each in item)})"
    if isinstance(item, Array):
        return f"[{item.element_type.name}{len(item.lengths)}{'s' if item.steps else ''}.{item.origin}]"
    return f"{item.kind}{item.lanes}" if item.has_several_lanes else str(item.kind)


def rename_item(item: KernelItem, names: Iterator[str]) -> KernelItem:
    """Return a copy of an item with its numbers renamed to `names`, in order."""
    if isinstance(item, tuple):
        return rebuild_like(item, (rename_item(each, names) for each in item))
    if isinstance(item, Array):
        address = Number("ptr", next(names))
        lengths = tuple(Number(INT, next(names)) for _ in item.lengths)
        steps = None if item.steps is None else tuple(Number(INT, next(names)) for _ in item.steps)
        return Array(item.element_type, address, lengths, steps, item.origin)
    return Number(item.kind, next(names), lanes=item.lanes)
