"""When kernels are compiled, and what becomes of the code that another run has stored."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from antdsl.machine_code import code_cache, llvm_compiler
from antdsl.machine_code.kernels import source_key
from antdsl.machine_code.kernels.kernel import Kernel

OTHER = """from antdsl.machine_code.kernels import inlined
from kernel_numbers import NUMBER
@inlined
def twice(x):
    return 2 * x + NUMBER
"""
KERNEL = """from antdsl.machine_code.kernels import F64, kernel
from kernel_numbers import NUMBER
from kernel_other import twice
@kernel
def value(x: F64) -> F64:
    return twice(x) + NUMBER
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    for name, text in (("kernel_other", OTHER), ("kernel_value", KERNEL)):
        (tmp_path / f"{name}.py").write_text(text)
    (tmp_path / "kept").mkdir(mode=0o700)
    monkeypatch.setenv("ANTDSL_NATIVE_CACHE", str(tmp_path / "kept"))
    code_cache.release_unused_code()
    yield tmp_path
    code_cache.release_unused_code()


def load(folder: Path, monkeypatch: pytest.MonkeyPatch, number: float = 1.0) -> Any:
    """The kernel, as in a process that begins, with a number that stands in a third module."""
    numbers = ModuleType("kernel_numbers")
    numbers.NUMBER = number  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "kernel_numbers", numbers)
    for name in ("kernel_other", "kernel_value"):
        spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, name, module)
        spec.loader.exec_module(module)
    code_cache.release_unused_code()
    return module.value


def test_stored_kernels_are_used_until_a_constant_changes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compilations = []
    compile_ = llvm_compiler.compile_object
    monkeypatch.setattr(llvm_compiler, "compile_object", lambda *text: compilations.append(text) or compile_(*text))
    for number, hit in ((1.0, False), (1.0, True), (5.0, False), (5.0, True)):
        kernel = load(folder, monkeypatch, number)
        assert kernel.has_code() == hit
        compilations.clear()
        assert kernel(2.0) == 4 + 2 * number
        assert bool(compilations) != hit and kernel.has_code()


CHANGES: list[tuple[str, str, str, float, bool]] = [  # file, what is there, what instead; what comes out; whether of stored code
    ("kernel_other", "2 * x", "2 * x", 6.0, True),
    ("kernel_other", "return 2 * x", "return 3 * x", 8.0, False),  # as long as before
    ("kernel_value", "return twice(x) + NUMBER", "return twice(x) - NUMBER", 4.0, False),
    ("kernel_value", "import NUMBER\n", "import NUMBER as LEFT\nNUMBER = (LEFT, 9.0)[1]\n", 14.0, False),
    ("kernel_value", "from kernel_other import twice\n", "from kernel_other import other as twice\n", 8.0, False),
    ("kernel_value", "x: F64", "x: I64", 6.0, False),
]


@pytest.mark.parametrize(("file", "old", "new", "expected", "hit"), CHANGES)
def test_kernel_keys_contain_all_reached_sources(
    folder: Path, monkeypatch: pytest.MonkeyPatch, file: str, old: str, new: str, expected: float, hit: bool
) -> None:
    other = folder / "kernel_other.py"
    other.write_text(OTHER + "@inlined\ndef other(x):\n    return 3 * x + NUMBER\n")
    value = folder / "kernel_value.py"
    value.write_text(KERNEL.replace("import F64", "import F64, I64"))
    assert load(folder, monkeypatch)(2) == 6
    text = (folder / f"{file}.py").read_text()
    assert old in text
    (folder / f"{file}.py").write_text(text.replace(old, new))
    kernel, written, write = load(folder, monkeypatch), [], Kernel.text
    monkeypatch.setattr(Kernel, "text", lambda self, *target: written.append(self) or write(self, *target))
    assert kernel.has_code() == hit and not written
    assert kernel(2) == expected
    assert len(written) == (not hit), "code that is kept is used without its text, other code is written"


def test_kernel_keys_contain_the_compiler_sources(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load(folder, monkeypatch)(2)
    monkeypatch.setattr(source_key, "_hash_compiler_sources", lambda: "another version")
    assert not load(folder, monkeypatch).has_code()


def test_kernels_with_unknown_names_are_keyed_by_text(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = KERNEL.replace("return twice(x)", "numbers = twice(x)\n    return numbers") + "numbers = {}\n"
    (folder / "kernel_value.py").write_text(text)
    kernel = load(folder, monkeypatch)
    assert source_key.compute_source_key(kernel.part, []) is None
    assert not kernel.has_code() and kernel(2) == 6 and load(folder, monkeypatch).has_code()
