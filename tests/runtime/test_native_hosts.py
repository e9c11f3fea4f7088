"""Machine code on other hosts: without instructions, without llvmlite, at the end of memory, in memory that lies far apart, and
what it calls from outside."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import native_states
import plans
import pytest
from children import child_environment
from sampling import sampled

from antdsl.machine_code import llvm_compiler
from antdsl.runtime.backends.native import program_listing

pytestmark = pytest.mark.skipif(not llvm_compiler.is_available(), reason="llvmlite is not installed")

# What object files may look for: functions of C with results that IEEE 754 fixes to the last bit, and those that move bytes.
FROM_C = {"fmod", "fmodf", "floor", "floorf", "rint", "rintf", "memcpy", "memset"}
TARGETS = {
    "host": llvm_compiler.find_host_target,
    "oldest x86": lambda: native_states.PLAIN,
    "arm": lambda: llvm_compiler.Target("aarch64-unknown-linux-gnu", "generic", ""),
}
WITHOUT = {
    "NPY_DISABLE_CPU_FEATURES": "",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX,-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable",
    "OPENBLAS_CORETYPE": "Prescott",
}
NO_LLVMLITE = "import sys\nsys.modules['llvmlite'] = sys.modules['llvmlite.binding'] = None\n"
TESTS = Path(__file__).resolve().parents[1]


def ran(script: str, *arguments: str, **settings: str) -> subprocess.CompletedProcess[str]:
    """A script of the tests in a separate process."""
    usual = {k: v for k, v in child_environment(TESTS).items() if not k.startswith(("NPY_", "GLIBC_", "OPENBLAS_"))}
    return subprocess.run(
        [sys.executable, str(TESTS / script), *arguments], env={**usual, **settings}, capture_output=True, text=True
    )


@pytest.mark.skipif(sys.platform != "linux", reason="the pages are those of Linux")
def test_a_byte_behind_an_array_is_noticed() -> None:
    process = ran("guarded_memory.py", "--past")
    assert process.returncode < 0 and process.stdout == f"{bytes(5)!r}\n"


@pytest.mark.skipif(sys.platform != "linux", reason="the pages are those of Linux")
@pytest.mark.parametrize("what", ["2 0 9 100", pytest.param("2 2 1 7 8 9 70", marks=pytest.mark.slow)])
def test_nothing_behind_the_spare_rows_is_touched(what: str) -> None:
    process = ran("guarded_memory.py", *what.split(), ANTDSL_NATIVE_CACHE="")
    assert (process.returncode, process.stdout) == (0, "same\n"), process.stderr[-2000:]


@pytest.mark.skipif(sys.platform != "linux", reason="memory is given out as by Linux")
def test_code_finds_its_constants_in_a_process_of_gigabytes() -> None:
    process = ran("far_memory.py")
    assert (process.returncode, process.stdout) == (0, "same\n"), process.stderr[-2000:]


def undefined(code: bytes) -> set[str]:
    """Names that an object file (ELF of 64 bits) looks for elsewhere."""
    (table,), (_, count) = struct.unpack_from("<Q", code, 40), struct.unpack_from("<HH", code, 58)
    headers = [struct.unpack_from("<IIQQQQIIQQ", code, table + 64 * k) for k in range(count)]
    symbols = next(head for head in headers if head[1] == 2)
    names, begin, size = headers[symbols[6]][4], symbols[4], symbols[5]
    symbol_names = set()
    for name, _, _, section, _, _ in struct.iter_unpack("<IBBHQQ", code[begin : begin + size]):
        if name and not section:
            symbol_names.add(code[names + name : code.index(0, names + name)].decode())
    return symbol_names


@pytest.mark.skipif(sys.platform != "linux", reason="object files are those of ELF")
@pytest.mark.parametrize("name", sampled(TARGETS, ("oldest x86", "arm")))
def test_machine_code_calls_nothing_with_varying_bits(name: str) -> None:
    """Without some instruction LLVM makes a call of it; none of them may be one that libraries round in different ways."""
    target = TARGETS[name]()
    symbol_names = undefined(llvm_compiler.compile_object(program_listing.build_program(plans.rich(), target).text, target))
    assert "fmod" in symbol_names and symbol_names <= FROM_C


def test_intrinsics_of_a_processor_are_not_used_where_it_has_none() -> None:
    plan = plans.rich()
    assert "@llvm.x86.avx2" not in program_listing.build_program(plan, native_states.PLAIN).text
    assert "@llvm.x86" not in program_listing.build_program(plan, TARGETS["arm"]()).text


@pytest.fixture(scope="module")
def expected_states() -> str:
    """What every host has to give, as NumPy gives it."""
    return " ".join(native_states.of_plan("numpy"))


def lacking(*names: str) -> dict[str, str]:
    from numpy._core._multiarray_umath import __cpu_dispatch__

    return {name: WITHOUT[name] or " ".join(__cpu_dispatch__) for name in names}


@pytest.mark.skipif(
    not llvm_compiler.is_available() or not llvm_compiler.find_host_target().is_x86, reason="the instructions are those of x86"
)
@pytest.mark.parametrize(
    ("plain", "names"),
    [
        (True, tuple(WITHOUT)),
        *(pytest.param(False, (name,), marks=pytest.mark.slow) for name in WITHOUT),
        pytest.param(True, (), marks=pytest.mark.slow),
    ],
)
def test_instructions_change_no_state(plain: bool, names: tuple[str, ...], expected_states: str) -> None:
    """Those that LLVM may use, that NumPy, libm and BLAS choose between."""
    process = ran("native_states.py", *["--plain"] * plain, ANTDSL_NATIVE_CACHE="", **lacking(*names))
    assert process.stdout.splitlines() == ["as machine code", expected_states], process.stderr[-2000:]


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["moods/scene.yaml", "tunnel/scene.yaml", "worth/scene.yaml", "alarm/scene.yaml"])
def test_instructions_change_no_state_of_an_example(scene: str, expected_states: str) -> None:
    process = ran("native_states.py", "--plain", scene, ANTDSL_NATIVE_CACHE="", **lacking(*WITHOUT))
    assert process.stdout.splitlines()[2] == " ".join(native_states.of_scene(scene, "numpy")), process.stderr[-2000:]


def test_without_llvmlite_nothing_runs_and_the_message_names_the_package(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(NO_LLVMLITE, encoding="utf-8")
    process = ran("native_states.py", PYTHONPATH=child_environment(tmp_path, TESTS)["PYTHONPATH"])
    assert process.returncode and "MachineCodeUnavailableError: llvmlite is not installed" in process.stderr, process.stderr
