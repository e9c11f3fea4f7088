"""Random kernels that are interpreted and compiled: `python tests/machine_code/random_kernels.py --count 20000 --seed 1`.

Each kernel runs on arrays of several lengths with extreme values. All that it writes and returns has to have the same bits from
the interpreter, which runs one turn after another, and from machine code, which has eight in lanes. NaN equals NaN. A part of the
kernels may index outside an array or divide by 0: there the checked build has to raise what the interpreter raises. `--target`
compiles for a target of the package, and `--lanes 1` without lanes. Code for a level of x86-64 that this processor has runs
here. Code for aarch64 runs under `qemu-aarch64` (`emulated_kernels.py`). Exit code 1 where something differs; the kernel is
printed."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from random import Random
from typing import Any
from unittest.mock import patch

import numpy as np

from antdsl.machine_code import llvm_compiler, shipped_objects
from antdsl.machine_code.kernels import KernelFault, NotInSubsetError
from antdsl.machine_code.kernels.ir import InvalidCodeError
from antdsl.machine_code.kernels.kernel import Kernel, render_kernels
from antdsl.machine_code.kernels.kernel_unit import KernelUnit
from antdsl.machine_code.number_kinds import LANE_COUNT

sys.path.insert(0, str(Path(__file__).parent))
from emulated_kernels import EmulatedCode, missing_program
from kernel_interpreter import KernelInterpreter
from random_kernel_source import OUTPUTS, module_of

BATCH = 40  # kernels of one module
DARING_EVERY = 8  # of so many batches one is daring
LENGTHS = (0, 1, 7, 8, 9, 17)
DTYPES = {
    "F64": np.float64, "F32": np.float32, "I64": np.int64, "U64": np.uint64, "BOOL": np.bool_, "I32": np.int32, "I16": np.int16,
    "U8": np.uint8,
}  # fmt: skip
_FLOATS = [
    0.0, -0.0, 1.0, -1.0, 0.5, 1.5, 2.5, -2.5, np.nan, np.inf, -np.inf, 5e-324, -5e-324, 2.2e-308, 1e-40, 1.7e308, -3.4e38,
    2.0**24, 2.0**24 + 1, 2.0**31, 2.0**53, 2.0**53 + 2, 2.0**62, 2.0**63, -(2.0**63), 2.0**64, 1e300, 1e-300, 0.1, 3.14159,
    0.49999999999999994,
]  # fmt: skip
_WHOLES = [
    0, 1, -1, 2, 3, -3, 7, 63, 64, 2**31 - 1, 2**31, -(2**31), 2**32, 2**53 - 1, 2**53, 2**53 + 1, -(2**53) - 1, 2**63 - 1,
    -(2**63), -(2**63) + 1, 255, 256, -129, 32768,
]  # fmt: skip


def numbers(rng: np.random.Generator, name: str, count: int) -> np.ndarray:
    """Random numbers of a type, half of them extreme ones."""
    extreme = rng.random(count) < 0.5
    with np.errstate(all="ignore"):
        if name in ("F64", "F32"):
            usual = rng.normal(size=count) * 10 ** rng.uniform(-2, 3, count)
            return np.where(extreme, rng.choice(_FLOATS, count), usual).astype(DTYPES[name])
        if name == "BOOL":
            return rng.random(count) < 0.5
        output = np.where(extreme, rng.choice(np.array(_WHOLES), count), rng.integers(-20, 20, count))
        return output.astype(DTYPES[name])


def inputs(seed: int, length: int) -> dict[str, Any]:
    """The arguments of a kernel, in the order of its parameters."""
    rng = np.random.default_rng(seed)
    output: dict[str, Any] = {}
    for name in ("F64", "F32", "I64", "U64", "BOOL", "I32", "I16", "U8"):
        output[f"in_{name}"] = numbers(rng, name, length)
    output["rows"] = numbers(rng, "F64", 3 * length).reshape(-1, 3)
    output["rows32"] = numbers(rng, "F32", 3 * length).reshape(-1, 3)
    turned = numbers(rng, "F64", 3 * length).reshape(3, -1).T
    output["strided"] = turned[::-1, ::-1] if seed % 2 else turned
    output["cube"] = numbers(rng, "F64", 4 * length).reshape(-1, 2, 2)
    output["table"], output["table32"] = numbers(rng, "F64", 64), numbers(rng, "F32", 64)
    output["small"] = numbers(rng, "I64", 3)
    output["ahead"] = numbers(rng, "F64", length + 4)
    output["order"] = rng.permutation(length)
    for name in OUTPUTS:
        output[f"out_{name}"] = numbers(rng, name, length)
    output["out_rows"] = numbers(rng, "F64", 3 * length).reshape(-1, 3)
    output["x"], output["y"] = float(numbers(rng, "F64", 1)[0]), float(numbers(rng, "F32", 1)[0])
    output["w"], output["v"], output["q"] = int(rng.choice(_WHOLES)), int(numbers(rng, "U64", 1)[0]), bool(seed % 3)
    output["begin"], output["end"] = (min(3, length) if seed % 5 == 0 else 0), length
    return output


def outcome(run: Any, passed: dict[str, Any]) -> tuple[str, list[Any]]:
    """The message of the error if there is one, and all that a kernel wrote and returned. The arrays are copied before."""
    own = {name: value.copy(order="K") if isinstance(value, np.ndarray) else value for name, value in passed.items()}
    own["strided"] = passed["strided"]  # a copy would not have its steps
    try:
        output = run(*own.values())
    except KernelFault as fault:
        return str(fault), []
    return "", [
        *(value for name, value in own.items() if name.startswith("out_")),
        np.array(output, np.float64 if output is None else None),
    ]


def equal(one: Any, other: Any) -> bool:
    """Whether two arrays have the same bits, or NaN both."""
    if one.dtype != other.dtype or one.shape != other.shape:
        return False
    if one.dtype.kind != "f":
        return bool((one == other).all())
    same = one.view(f"u{one.itemsize}") == other.view(f"u{one.itemsize}")
    return bool((same | (np.isnan(one) & np.isnan(other))).all())


def load(source: str, folder: Path) -> list[Kernel]:
    """The kernels of a module, from its source."""
    path = folder / "drawn_kernels.py"
    path.write_text(source)
    spec = importlib.util.spec_from_file_location("drawn_kernels", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["drawn_kernels"] = module  # where the fields of its records are looked up
    spec.loader.exec_module(module)
    import linecache

    linecache.checkcache(str(path))
    return [value for value in vars(module).values() if isinstance(value, Kernel)]


def can_run(target: llvm_compiler.Target) -> bool:
    """Whether code for a target can run on this machine, or in the emulator."""
    host = llvm_compiler.find_host_target()
    if target.is_arm:
        return host.is_arm or not missing_program()
    return (
        target.is_x86
        and host.is_x86
        and shipped_objects._list_present_features(target) <= shipped_objects._list_present_features(host)
    )


@contextmanager
def callers(
    kernels: Sequence[Kernel], target: llvm_compiler.Target, lanes: int, daring: bool
) -> Iterator[Callable[[Kernel], Callable[..., Any]]]:
    """Compile kernels; the function that returns what calls one of them."""
    module = importlib.import_module("antdsl.machine_code.kernels.kernel")
    with patch.object(module, "KernelUnit", partial(KernelUnit, lanes=lanes)):
        text = render_kernels(kernels, target, checked=daring)
    code = llvm_compiler.compile_object(text, target)
    if target.is_arm == llvm_compiler.find_host_target().is_arm:
        loaded = llvm_compiler.load_object(code)
        yield lambda kernel: kernel.make_caller(loaded, checked=daring)
    else:
        with tempfile.TemporaryDirectory() as folder, EmulatedCode(kernels, text, code, Path(folder)) as emulated:
            yield emulated.caller


def differences(kernels: Sequence[Kernel], seed: int, daring: bool, target: llvm_compiler.Target, lanes: int) -> Iterator[str]:
    """Compare kernels; yield what differs."""
    try:
        with callers(kernels, target, lanes, daring) as caller:
            for number, kernel in enumerate(kernels):
                yield from _differences_of_one(kernel, caller(kernel), seed, number, daring)
    except (NotInSubsetError, InvalidCodeError, RuntimeError) as problem:
        if len(kernels) == 1 and daring and isinstance(problem, NotInSubsetError):
            return  # an index of an unrolled loop is certainly outside: the compiler reports the fault
        if len(kernels) == 1:
            yield f"{kernels[0].__name__}, failed: {problem}"
        else:
            for each in kernels:
                yield from differences([each], seed, daring, target, lanes)


def _differences_of_one(kernel: Kernel, compiled: Any, seed: int, number: int, daring: bool) -> Iterator[str]:
    interpreted = KernelInterpreter(kernel)
    for length in (17, LENGTHS[(seed + number) % len(LENGTHS)]):
        passed = inputs(1000 * seed + number + length, length)
        (fault, expected), (raised, output) = outcome(interpreted, passed), outcome(compiled, passed)
        if daring and (fault or raised):
            if bool(fault) != bool(raised) or ("simd_range" not in kernel.__doc__ and fault != raised):
                yield f"{kernel.__name__}, length {length}: {fault or 'no error'} interpreted, {raised or 'none'} compiled"
        elif fault:
            yield f"{kernel.__name__}, length {length}: {fault}"
        elif not all(equal(a, b) for a, b in zip(expected, output, strict=True)):
            pairs = [(a, b) for a, b in zip(expected, output, strict=True) if not equal(a, b)]
            yield f"{kernel.__name__}, length {length}: interpreted\n{pairs[0][0]}\ncompiled\n{pairs[0][1]}"


def compare(count: int, seed: int, target: str = "", show: bool = True, lanes: int = LANE_COUNT) -> list[str]:
    """Draw so many kernels and compare them; return what differs, with the sources.

    Kernels for a target that nothing can run here are only compiled. The emulator runs no daring ones: the checked build reports
    to this process."""
    output: list[str] = []
    compiled_for = shipped_objects.TARGET_BY_NAME[target] if target else llvm_compiler.find_host_target()
    runs = can_run(compiled_for)
    with tempfile.TemporaryDirectory() as name:
        for batch in range(0, count, BATCH):
            daring = (
                batch // BATCH % DARING_EVERY == DARING_EVERY - 1
                and compiled_for.is_arm == llvm_compiler.find_host_target().is_arm
            )
            source = module_of(Random(f"{seed} {batch}"), min(BATCH, count - batch), daring)
            kernels = load(source, Path(name))
            if not runs:
                llvm_compiler.compile_object(render_kernels(kernels, compiled_for), compiled_for)
                continue
            for each in differences(kernels, seed + batch, daring, compiled_for, lanes):
                output.append(f"seed {seed}, batch {batch}: {each}\n{_source(source, each.split(',')[0])}")
                if show:
                    print(output[-1], flush=True)
            if show and batch // BATCH % 25 == 24:
                print(f"{batch + BATCH} kernels, {len(output)} differences, {time.process_time():.0f} s of CPU", flush=True)
    return output


def _source(source: str, name: str) -> str:
    """A kernel's part of its module, with the helpers before it."""
    parts = source.split("\n\n\n")
    helpers = [part for part in parts if f"def {name}_" in part]
    return "\n\n".join([*helpers, *(part for part in parts if f"def {name}(" in part)])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--target",
        choices=list(shipped_objects.TARGET_BY_NAME),
        default="",
        help="compile for a target; run where that is possible",
    )
    parser.add_argument("--lanes", type=int, choices=(1, LANE_COUNT), default=LANE_COUNT)
    options = parser.parse_args()
    if options.target and not can_run(shipped_objects.TARGET_BY_NAME[options.target]):
        print(f"nothing here runs code for {options.target}: kernels are only compiled")
    output = compare(options.count, options.seed, options.target, lanes=options.lanes)
    print(f"{options.count} kernels, {len(output)} differences, {time.process_time():.0f} s of CPU")
    return 1 if output else 0


if __name__ == "__main__":
    sys.exit(main())
