"""Kernels that are kept for the next run: what becomes of their files fails no run, and old ones are not used."""

from __future__ import annotations

import errno
import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from antdsl.numerics import compiled

pytestmark = pytest.mark.skipif(not compiled.available(), reason="needs numba")

OTHER = """from antdsl.numerics.kernel_cache import njit
from kernel_numbers import NUMBER
@njit(cache=True, inline="always")
def twice(x):
    return 2 * x + NUMBER
"""
KERNEL = """from antdsl.numerics.kernel_cache import njit
from kernel_numbers import NUMBER
from kernel_other import twice
@njit(cache=True)
def value(x):
    return twice(x) + NUMBER
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    import numba

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "kept"))
    for name, text in (("kernel_other", OTHER), ("kernel_value", KERNEL)):
        (tmp_path / f"{name}.py").write_text(text)
    return tmp_path


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
    return module.value


def hits(kernel: Any) -> int:
    return sum(kernel.stats.cache_hits.values())


def test_kept_kernels_are_used_until_a_number_elsewhere_changes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, hit in ((1.0, 0), (1.0, 1), (5.0, 0), (5.0, 1)):
        kernel = load(folder, monkeypatch, number)
        assert kernel(2.0) == 4 + 2 * number
        assert hits(kernel) == hit


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("size", [0, 40])
def test_a_file_that_was_cut_short_is_made_anew(folder: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, size: int) -> None:
    assert load(folder, monkeypatch)(2.0) == 6
    files = list((folder / "kept").rglob(f"*value*.{suffix}"))
    assert files
    for file in files:
        file.write_bytes(file.read_bytes()[:size])
    for hit in (0, 1):
        kernel = load(folder, monkeypatch)
        assert kernel(2.0) == 6 and hits(kernel) == hit


def test_a_full_disk_fails_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from numba.core.caching import IndexDataCacheFile

    def full(*args: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(IndexDataCacheFile, "save", full)
    kernel = load(folder, monkeypatch)
    assert kernel(2.0) == 6 and hits(kernel) == 0


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
