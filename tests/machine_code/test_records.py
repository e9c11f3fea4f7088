"""Records of kernels: how they are built, read, passed on and returned, and which mistakes are found."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from kernel_interpreter import interpret

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.kernels import (
    F32,
    F64,
    I64,
    Array1,
    Array2,
    NotInSubsetError,
    inlined,
    kernel,
    kernel_helper,
    simd_range,
    source_key,
)
from antdsl.machine_code.kernels.kernel import Kernel

pytestmark = pytest.mark.skipif(not llvm_compiler.is_available(), reason="no machine code can be made here")


class Point(NamedTuple):
    x: F64
    y: F64


class Grid(NamedTuple):
    values: Array1[F64]
    part: I64  # as helpers have one
    corner: Point


class Other(NamedTuple):
    x: F64
    y: F64


ORIGIN = Point(0.5, 0.25)


@kernel
def read_fields(grid: Grid, k: I64) -> F64:
    return grid.values[k] * grid.part + grid.corner.x - grid[2].y


@kernel
def build(x: F64, y: F64) -> tuple[F64, F64]:
    a, b = Point(x, y=y + ORIGIN.y), Point(y=x, x=1)
    return a.x + b.x, a[1] - b[1]


@kernel
def give_record(x: F64) -> Point:
    if x > 0:
        return Point(x, 2)
    return Point(x=0, y=x)


@kernel
def choose(x: F64) -> Point:
    point = Point(x, 1.0) if x > 0 else Point(2.0, x)
    point = point._replace(y=point.y + point.x)
    if point.y > 4:
        point = Point(4, point.y)
    return point


@kernel_helper
def stepped(point: Point, by: F64) -> Point:
    point = point._replace(x=point.x + by)
    if point.x > 5:
        return Point(5.0, point.y)
    return point


@inlined
def total(point: Point) -> F64:
    first, second = point
    return first + second


@kernel
def in_lanes(grid: Grid, output: Array1[F64], begin: I64, end: I64) -> None:
    for i in simd_range(begin, end):
        point = stepped(Point(grid.values[i], i * 0.5), grid.corner.x)
        if point.y > 3:
            point = point._replace(x=-1)
        output[i] = total(point)


@kernel
def spread(point: Point, x: F64) -> F64:
    total = 0.0
    for each in (x, *point, *(x, 3)):
        total = 2 * total + each
    return total


ROW = np.arange(19) * 0.75
CASES: list[tuple[Kernel, tuple[Any, ...], Any]] = [
    (read_fields, (Grid(ROW, 3, Point(10.0, 4.0)), 2), 2 * 0.75 * 3 + 10 - 4),
    (read_fields, ((ROW, 3, (10.0, 4.0)), 2), 2 * 0.75 * 3 + 10 - 4),
    (build, (3.0, 2.0), (4.0, -0.75)),
    (give_record, (3.0,), (3.0, 2.0)),
    (give_record, (-3.0,), (0.0, -3.0)),
    (spread, (Point(2.0, 3.0), 1.0), 1 * 16 + 2 * 8 + 3 * 4 + 1 * 2 + 3.0),
    (choose, (3.0,), (3.0, 4.0)),
    (choose, (5.0,), (4.0, 6.0)),
    (choose, (-1.0,), (2.0, 1.0)),
]


@pytest.mark.parametrize(("known", "passed", "expected"), CASES, ids=lambda each: getattr(each, "__name__", None))
def test_records_are_read_built_and_returned(known: Kernel, passed: tuple[Any, ...], expected: Any) -> None:
    assert interpret(known, *passed) == known(*passed) == expected


def test_records_in_lanes_and_through_functions() -> None:
    output, interpreted = np.zeros(19), np.zeros(19)
    grid = Grid(ROW, 0, Point(1.5, 0.0))
    in_lanes(grid, output, 0, 19)
    interpret(in_lanes, grid, interpreted, 0, 19)
    expected = [(-1.0 if i * 0.5 > 3 else min(i * 0.75 + 1.5, 5.0)) + i * 0.5 for i in range(19)]
    assert output.tolist() == interpreted.tolist() == expected


def test_a_record_is_read_by_machine_code_as_a_tuple_is(monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.machine_code.kernels import kernel_calls

    def fail(*_: Any) -> Any:
        raise AssertionError("the call is left to Python")

    monkeypatch.setattr(kernel_calls, "_make_python_caller", lambda *_: fail)
    monkeypatch.setattr(read_fields, "_loaded_call", None)
    monkeypatch.setattr(read_fields, "__call__", read_fields._first_call)
    assert read_fields(Grid(ROW, 3, Point(10.0, 4.0)), 2) == 10.5
    with pytest.raises(AssertionError, match="left to Python"):
        read_fields([ROW, 3, (10.0, 4.0)], 2)
    with pytest.raises(AssertionError, match="left to Python"):
        read_fields((ROW, 3, (10.0, 4.0, 5.0)), 2)


@kernel
def unknown_field(grid: Grid) -> F64:
    return grid.corner.z


@kernel
def unknown_name(x: F64) -> F64:
    return Point(x, z=x).x


@kernel
def too_many(x: F64) -> F64:
    return Point(x, x, x).x


@kernel
def too_few(x: F64) -> F64:
    return Point(x).x


@kernel
def given_twice(x: F64) -> F64:
    return Point(x, x=x).x  # type: ignore[misc]


@kernel
def other_number(x: F32) -> F64:
    return Point(x, 0.0).x


@kernel
def no_such_constant(x: F64) -> I64:
    return Grid(scratch_of(x), 0.5, ORIGIN).part


@inlined
def scratch_of(x: F64) -> Any:
    return x


@kernel
def array_of_two_axes(rows: Array2[F64]) -> I64:
    return Grid(rows, 1, ORIGIN).part  # type: ignore[arg-type]


@kernel
def other_record(values: Array1[F64]) -> I64:
    return Grid(values, 1, Other(1.0, 2.0)).part  # type: ignore[arg-type]


@kernel
def other_record_returned(x: F64) -> Any:
    if x > 0:
        return Other(x, x)
    return Point(x, x)


@kernel
def other_record_assigned(x: F64) -> F64:
    point: Any = Point(x, x)
    point = Other(x, x)
    return point.x


@kernel
def replaced_field(x: F64) -> F64:
    return Point(x, x)._replace(z=x).x  # type: ignore[call-arg]


@kernel
def replaced_tuple(x: F64) -> F64:
    pair: Any = (x, x)
    return pair._replace(x=x)[0]


@kernel
def spread_number(x: F64) -> F64:
    return (1.0, *x)[0]


@kernel
def named_argument(x: F64) -> F64:
    return total(point=Point(x, x))


@kernel
def returned_array(values: Array1[F64]) -> Any:
    return Grid(values, 1, ORIGIN)


@pytest.mark.parametrize(
    ("rejected", "line", "why"),
    [
        (unknown_field, 2, "`Point` has no field `z`: its fields are x, y"),
        (unknown_name, 2, "`Point` has no field `z`: its fields are x, y"),
        (too_many, 2, "`Point` has 2 fields, not 3"),
        (too_few, 2, "`Point` is given no `y`"),
        (given_twice, 2, "`x` is given twice"),
        (other_number, 2, "`x` is double, but gets float"),
        (no_such_constant, 2, "`values` gets a value of another type"),
        (array_of_two_axes, 2, "`values` gets a value of another type"),
        (other_record, 2, "`corner` gets a value of another type"),
        (other_record_returned, 4, "returns another type than an earlier `return`"),
        (other_record_assigned, 3, "`point` gets a value of another type"),
        (replaced_field, 2, "`Point` has no field `z`"),
        (replaced_tuple, 3, "`_replace` is a function of records"),
        (spread_number, 2, "`*` expands only tuples and records"),
        (named_argument, 2, "only records take arguments by name"),
        (returned_array, 2, "a kernel cannot return arrays"),
    ],
    ids=lambda value: value.__name__ if isinstance(value, Kernel) else None,
)
def test_mistakes_are_found_with_their_line(rejected: Kernel, line: int, why: str) -> None:
    start = inspect.getsourcelines(rejected.part.function)[1]
    with pytest.raises(NotInSubsetError, match=why) as output:
        rejected.text()
    assert f"{Path(__file__).name}, line {start + line}, " in str(output.value)


def test_the_key_of_stored_code_depends_on_the_fields(monkeypatch: pytest.MonkeyPatch) -> None:
    class Wide(NamedTuple):
        y: F64
        x: F64

    previous = source_key.compute_source_key(build.part, build.types())
    assert previous is not None and previous != source_key.compute_source_key(read_fields.part, read_fields.types())
    monkeypatch.setitem(globals(), "Point", Wide)
    assert source_key.compute_source_key(build.part, build.types()) != previous
    swapped = Wide._make(build.types())
    assert source_key.compute_source_key(build.part, [swapped]) != source_key.compute_source_key(build.part, [tuple(swapped)])


def test_a_field_without_a_type_of_kernels_is_an_error() -> None:
    class Wrong(NamedTuple):
        name: str

    def takes(wrong: Any) -> None: ...

    takes.__annotations__["wrong"] = Wrong
    with pytest.raises(TypeError, match="`str` is not a type of `kernels`"):
        Kernel(takes).text()  # type: ignore[arg-type]
