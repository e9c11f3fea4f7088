"""When kernels are begun with, and what becomes of the code that another run has kept."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from compilers import need_kernels

from antdsl.machine_code import codes, machine
from antdsl.numerics import compiled

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
    need_kernels()
    for name, text in (("kernel_other", OTHER), ("kernel_value", KERNEL)):
        (tmp_path / f"{name}.py").write_text(text)
    (tmp_path / "kept").mkdir(mode=0o700)
    monkeypatch.setenv("ANTDSL_NATIVE_CACHE", str(tmp_path / "kept"))
    codes.forget()
    yield tmp_path
    codes.forget()


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
    codes.forget()
    return module.value


def test_kept_kernels_are_used_until_a_number_elsewhere_changes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    compile_ = machine.object_code
    monkeypatch.setattr(machine, "object_code", lambda *text: made.append(text) or compile_(*text))
    for number, hit in ((1.0, False), (1.0, True), (5.0, False), (5.0, True)):
        kernel = load(folder, monkeypatch, number)
        assert kernel.kept() == hit
        made.clear()
        assert kernel(2.0) == 4 + 2 * number
        assert bool(made) != hit and kernel.kept()


@pytest.fixture
def unstarted(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"_running": False, "_spent": 0.0, "_long": False, "_kept": lambda: True}.items():
        monkeypatch.setattr(compiled, name, value)


@pytest.mark.usefixtures("unstarted")
def test_a_small_crowd_gets_kernels_once_it_has_cost_as_much_as_they_do(monkeypatch: pytest.MonkeyPatch) -> None:
    begun = []
    for _ in range(100):
        compiled.begin_step(30)
        begun.append(compiled.wanted(30))
        compiled.end_step(0.01)
    assert begun.index(True) == pytest.approx(compiled._LOADING / 0.01, abs=1)
    assert compiled.wanted(1) and not compiled.wanted(0)


@pytest.mark.usefixtures("unstarted")
def test_kernels_that_have_to_be_compiled_first_are_waited_for_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "_kept", lambda: False)
    compiled.end_step(compiled._COMPILING * 0.9)
    compiled.begin_step(30)
    assert not compiled.wanted(30)
    compiled.end_step(compiled._COMPILING * 0.2)
    compiled.begin_step(30)
    assert compiled.wanted(30)


@pytest.mark.usefixtures("unstarted")
def test_a_large_crowd_begins_with_kernels_and_its_set_up_does_not() -> None:
    assert not compiled.wanted(compiled.LEAST)
    compiled.begin_step(compiled.LEAST)
    assert compiled.wanted(1)


@pytest.mark.usefixtures("unstarted")
def test_a_large_world_is_made_ready_with_kernels() -> None:
    assert compiled.wanted(1_000_000)
    assert compiled.wanted(1)
