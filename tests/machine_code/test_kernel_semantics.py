"""What kernels mean: the same interpreted and compiled, or rejected with file and line."""

from __future__ import annotations

import inspect
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from children import child_environment
from kernel_interpreter import interpret

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.kernels import (
    BOOL,
    F32,
    F64,
    I64,
    U64,
    Array1,
    KernelFault,
    NotInSubsetError,
    allocate_scratch,
    kernel,
    kernel_helper,
    simd_range,
)
from antdsl.machine_code.kernels.ir import InvalidCodeError, verify_functions
from antdsl.machine_code.kernels.kernel import Kernel, render_kernels
from antdsl.machine_code.kernels.kernel_unit import KernelUnit
from antdsl.machine_code.kernels.simd_loops import write_function
from antdsl.machine_code.kernels.values import Number

pytestmark = pytest.mark.skipif(not llvm_compiler.is_available(), reason="no machine code can be process here")
LEAST, MOST = -(2**63), 2**63 - 1


@kernel
def tenth_of_single(x: F32) -> F32:
    return x * 0.1


@kernel
def sum_of_singles(x: Array1[F32]) -> F32:
    total = 0.0
    for each in x:
        total += each
    return total


@kernel
def negative_index(a: Array1[F64]) -> F64:
    return a[-1]


@kernel
def last_but_one_number(x: I64) -> I64:
    return x + (9223372036854775807 + 1)


@kernel
def other_kind_of_variable(x: F32) -> F32:
    y = x
    y = 0.1
    return y


@kernel
def other_kind_of_result(x: I64) -> I64:
    if x > 0:
        return x
    return 0.5


@kernel
def by_no_number(x: I64) -> I64:
    return x // 0


@kernel
def shifted_too_far(x: I64) -> I64:
    return x << 64


@kernel
def outside_of_room(x: F64) -> F64:
    storage = allocate_scratch(4, F64)
    storage[4] = x
    return storage[0]


@kernel
def signed_and_unsigned(x: I64, y: U64) -> U64:
    return y if x > 0 else x


@kernel_helper
def halved(x: F64) -> F64:
    return x * 0.5


@kernel
def argument_of_another_type(x: F32) -> F64:
    return halved(x)


@kernel
def array_of_another_type(x: Array1[F32]) -> F64:
    return first_element(x)


@kernel_helper
def first_element(x: Array1[F64]) -> F64:
    return x[0]


@kernel
def result_of_another_type(x: F64) -> I64:
    return x


@kernel
def longer_result(x: F64) -> tuple[F64, F64]:
    return x, x, x  # type: ignore[return-value]


@kernel
def result_of_a_function_without_any(x: F64) -> None:
    return x  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("rejected", "line", "why"),
    [
        (tenth_of_single, 2, r"float32 cannot represent 0\.1"),
        (sum_of_singles, 4, "a float32 and a number of another type"),
        (negative_index, 2, "is negative or outside the axis"),
        (last_but_one_number, 2, "does not fit into int64"),
        (other_kind_of_variable, 3, r"float32 cannot represent 0\.1"),
        (other_kind_of_result, 4, "0.5 is not a number of type i64"),
        (by_no_number, 2, "division by 0"),
        (shifted_too_far, 2, "0 to 63"),
        (outside_of_room, 3, "is negative or outside the axis"),
        (signed_and_unsigned, 2, "a signed and an unsigned"),
        (argument_of_another_type, 2, "`x` is double, but gets float"),
        (array_of_another_type, 2, "`x` gets a value of another type"),
        (result_of_another_type, 2, "`return` is i64, but gets double"),
        (longer_result, 2, "`return` gets a value of another type"),
        (result_of_a_function_without_any, 2, "`return` gets a value of another type"),
    ],
    ids=lambda value: value.__name__ if isinstance(value, Kernel) else None,
)
def test_what_python_would_compute_otherwise_is_rejected_with_its_line(rejected: Kernel, line: int, why: str) -> None:
    start = inspect.getsourcelines(rejected.part.function)[1]
    for read in (lambda: rejected.text(), lambda: interpret(rejected)):
        with pytest.raises(NotInSubsetError, match=why) as output:
            read()
        assert f"{Path(__file__).name}, line {start + line}, " in str(output.value)


@kernel
def product(x: I64, y: I64) -> I64:
    return x * y


@kernel
def negative(x: I64) -> I64:
    return abs(x) + (-x)


@kernel
def reciprocal(x: F64) -> tuple[F64, F64]:
    return 1.0 / x, 1.0 / 0.0


@kernel
def integer(x: F64, y: F32) -> tuple[I64, I64, U64, U64]:
    return np.int64(x), np.int64(y), np.uint64(x), np.uint64(y)


@kernel
def quotient(x: I64, y: I64) -> tuple[I64, I64]:
    return x // y, x % y


@kernel
def shifts(x: I64, u: U64, k: I64) -> tuple[I64, I64, U64]:
    return x << k, x >> k, u >> (u & 127)


@kernel
def least_and_greatest(x: F64, y: F64) -> tuple[F64, F64, BOOL, BOOL]:
    return min(x, y), max(x, y), x != y, x <= y


NAN = float("nan")
CASES: list[tuple[Kernel, tuple[Any, ...], Any]] = [
    (product, (MOST, 2), -2), (product, (2**32, 2**31), LEAST), (negative, (LEAST,), 0), (reciprocal, (0.0,), (np.inf, np.inf)),
    (reciprocal, (-0.0,), (-np.inf, np.inf)), (integer, (NAN, NAN), (0, 0, 0, 0)),
    (integer, (1e300, -1e30), (MOST, LEAST, 2**64 - 1, 0)), (integer, (-np.inf, np.inf), (LEAST, MOST, 0, 2**64 - 1)),
    (integer, (-1.9, 2.9), (-1, 2, 0, 2)), (quotient, (-7, 2), (-4, 1)), (quotient, (7, -2), (-4, -1)),
    (quotient, (LEAST, -1), (LEAST, 0)), (shifts, (1, 2**63 + 65, 65), (2, 0, 2**62 + 32)), (shifts, (-8, 1, -63), (-16, -4, 0)),
    (least_and_greatest, (NAN, 1.0), (NAN, NAN, True, False)), (least_and_greatest, (1.0, NAN), (1.0, 1.0, True, False)),
    (least_and_greatest, (0.0, -0.0), (0.0, 0.0, False, True)),
]  # fmt: skip


@pytest.mark.parametrize(
    ("known", "passed", "expected"), CASES, ids=lambda value: value.__name__ if isinstance(value, Kernel) else None
)
def test_results_are_defined(known: Kernel, passed: tuple[Any, ...], expected: Any) -> None:
    assert repr(interpret(known, *passed)) == repr(known(*passed)) == repr(expected)


@kernel
def at_index(a: Array1[F64], k: I64) -> F64:
    return a[k]


@kernel
def without_value(a: Array1[F64]) -> F64:
    if a[0] > 0:
        output = a[0]
    return output


@kernel
def room_without_value(a: Array1[F64]) -> F64:
    storage = allocate_scratch(4, F64)
    storage[0] = a[0]
    return storage[1]


@pytest.mark.parametrize(
    ("run", "line"),
    [
        (lambda: interpret(at_index, np.ones(3), -1), "return a[k]"),
        (lambda: interpret(at_index, np.ones(3), 3), "return a[k]"),
        (lambda: interpret(at_index, np.ones(0), 0), "return a[k]"),
        (lambda: interpret(quotient, 1, 0), "return x // y, x % y"),
        (lambda: interpret(without_value, -np.ones(1)), "return output"),
        (lambda: interpret(room_without_value, np.ones(1)), "return storage[1]"),
    ],
)
def test_errors_of_the_interpreter_name_the_line(run: Any, line: str) -> None:
    with pytest.raises(KernelFault) as output:
        run()
    number = int(str(output.value).partition(", line ")[2].partition(":")[0])
    assert Path(__file__).read_text().splitlines()[number - 1].strip() == line
    assert str(output.value).startswith(__file__)


@kernel
def usual(a: Array1[F64], x: F32, begin: I64, end: I64) -> F64:
    total = 0.0
    for i in range(begin, end):
        total += a[i] * np.float64(x)
    return total


def test_the_verifier_finds_instructions_that_do_not_fit() -> None:
    unit = KernelUnit()
    name, _ = write_function(unit, quotient.part, [Number("i64", "%x"), Number("i64", "%y")])
    (function,) = unit.functions
    verify_functions(unit.functions)
    assert name == function.name
    body = function.blocks[0].body
    for k, each in enumerate(body):
        wrong = [each._replace(operands=tuple(replace(one, kind="float") for one in each.operands))]
        if each.result is not None:
            wrong += [each._replace(result=replace(each.result, kind="float")), each._replace(result=function.arguments[0])]
        for one in wrong:
            body[k] = one
            if one != each:
                with pytest.raises(InvalidCodeError):
                    verify_functions(unit.functions)
        body[k] = each
    first = next(k for k, each in enumerate(body) if each.result is not None)
    missing, late = body[:first] + body[first + 1 :], [*body[:first], *body[first + 1 : -1], body[first], body[-1]]
    for changed in (
        body[:-1],
        [body[-1], *body],
        missing,
        late,
        [*body[:-1], body[-1]._replace(op="jump", immediate=("nowhere",))],
    ):
        function.blocks[0] = function.blocks[0]._replace(body=changed)
        with pytest.raises(InvalidCodeError):
            verify_functions(unit.functions)


BAD = """
from functools import partial
import numpy as np
from antdsl.machine_code.kernels import F64, I64, Array1, KernelFault, kernel_helper, simd_range, kernel
from antdsl.numerics import parallel

@kernel_helper
def element(a, k):
    return a[k]

@kernel
def one(a: Array1[F64], rows: Array1[I64], to: Array1[F64], begin: I64, end: I64) -> I64:
    for i in simd_range(begin, end):
        to[i] = element(a, rows[i])
    return end - begin

@kernel
def divide(a: I64, b: I64) -> I64:
    return a // b

def outcome(run):
    try:
        return run()
    except KernelFault as fault:
        return fault

a, rows = np.ones(40), np.arange(40)
for wrong in (40, -1, 10**12, 5):
    rows[23] = wrong
    print(outcome(lambda: one(a, rows, np.zeros(40), 0, 40)))
many = np.zeros(100_000, np.int64)
many[77_777] = 40
print(outcome(lambda: parallel.run_in_parts(partial(one, a, many, np.zeros(len(many))), len(many), 2)))
rows[23] = 99
print(outcome(lambda: one(a, rows, np.zeros(9), 0, 9)), outcome(lambda: one(a, rows, np.zeros(9), 0, 16)))
print(outcome(lambda: divide(7, 0)), outcome(lambda: divide(7, 2)))
"""


def test_a_checked_build_raises_errors_with_file_and_line(tmp_path: Path) -> None:
    path = tmp_path / 'bad "kernels".py'
    path.write_text(BAD)
    variables = {**child_environment(), "ANTDSL_CHECKED_KERNELS": "1", "ANTDSL_NATIVE_CACHE": str(tmp_path / "kept")}
    process = subprocess.run([sys.executable, str(path)], env=variables, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    element, stored, divided = (BAD.splitlines().index(f"{line}") + 1 for line in (
        "    return a[k]", "        to[i] = element(a, rows[i])", "    return a // b"))  # fmt: skip
    read = f"{path}, line {element}: index out of range, or negative"
    outside = f"{path}, line {stored}: index out of range, or negative"
    assert process.stdout.splitlines() == [
        read, read, read, "40", read, f"9 {outside}", f"{path}, line {divided}: integer division by 0 3",
    ]  # fmt: skip


def test_checked_code_has_a_key_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.machine_code.kernels import source_key

    previous = usual.make_text_key(llvm_compiler.PORTABLE_TARGET)
    monkeypatch.setattr(source_key, "CHECKS_ENABLED", not source_key.CHECKS_ENABLED)
    assert usual.make_text_key(llvm_compiler.PORTABLE_TARGET) != previous
    assert render_kernels([usual], llvm_compiler.PORTABLE_TARGET, checked=True) != render_kernels(
        [usual], llvm_compiler.PORTABLE_TARGET, checked=False
    )


def test_checked_objects_have_line_tables_with_relative_file_names() -> None:
    import llvmlite.binding as llvm

    text = render_kernels([usual], llvm_compiler.PORTABLE_TARGET, checked=True)
    code = llvm_compiler.compile_object(text, llvm_compiler.PORTABLE_TARGET)
    sections = {each.name(): each.data() for each in llvm.ObjectFileRef.from_data(code).sections()}
    assert sections[b".debug_line"]
    assert f'!DIFile(filename: "tests/machine_code/{Path(__file__).name}", directory: "")' in text
    source, start = inspect.getsourcelines(usual.part.function)
    for k in range(2, len(source)):
        assert f"!DILocation(line: {start + k}, " in text, "of each statement"


def test_arrays_that_are_not_aligned_are_rejected() -> None:
    data = np.zeros(8 * 9, np.uint8)[1:-7].view(np.float64)
    with pytest.raises(ValueError, match="aligned"):
        usual(data, 1.0, 0, 8)


@kernel
def left_early(small: Array1[I64], x: Array1[I64], to: Array1[I64]) -> None:
    for i in simd_range(0, x.size):
        total = 0
        for each in small:
            if each > x[i]:
                break
            if each == 3:
                continue
            total += each
        to[i] = total + x[i]


def test_a_loop_over_an_array_is_left_by_single_lanes() -> None:
    small, x = np.arange(9), np.array([-1, 0, 2, 3, 4, 5, 20, 1, 7, 3])
    to = np.zeros(10, np.int64)
    left_early(small, x, to)
    assert list(to) == [sum(k for k in range(9) if k <= each and k != 3) + each for each in x]
