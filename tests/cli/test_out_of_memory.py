"""No memory is reported as such, with exit code 3, whichever library finds out."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from pathlib import Path
from types import FunctionType
from unittest.mock import patch

import commands
import pytest
from cases.hostile.usd import GOOD
from children import child_environment

from antdsl.cli import app
from antdsl.cli.exits import CommandError, is_out_of_memory, report_failures


class ArrayMemoryError(MemoryError):
    """As NumPy's."""


PROBLEMS = (
    MemoryError(),
    ArrayMemoryError("Unable to allocate 8.00 GiB for an array"),
    RuntimeError("std::bad_alloc"),
    RuntimeError("can't start new thread"),
    OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)),
    ImportError("libopenblas.so: failed to map segment from shared object"),
)


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda each: f"{type(each).__name__} {each}")
def test_out_of_memory_has_exit_code_3(tmp_path: Path, problem: Exception) -> None:
    with patch.object(type(app), "__call__", side_effect=problem):
        result = commands.run("doctor", cwd=tmp_path)
    assert result.returncode == 3 and result.stderr.startswith("error: out of memory")


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda each: f"{type(each).__name__} {each}")
def test_out_of_memory_while_writing_names_the_resume_command(problem: Exception) -> None:
    with pytest.raises(CommandError) as stop, report_failures("the export stopped", "continue with: antdsl run"):
        raise problem
    assert stop.value.code == 3 and stop.value.message.startswith("error: out of memory")
    assert stop.value.hint.endswith("continue with: antdsl run")


def test_bugs_while_writing_stay_bugs() -> None:
    with pytest.raises(KeyError), report_failures("the export stopped"):
        raise KeyError("x")


def test_consequences_of_out_of_memory_are_out_of_memory() -> None:
    try:
        try:
            raise MemoryError
        except MemoryError as cause:
            raise ValueError("no array") from cause
    except ValueError as problem:
        assert is_out_of_memory(problem)


def test_handled_out_of_memory_errors_do_not_count() -> None:
    try:
        try:
            raise MemoryError
        except MemoryError:
            raise ValueError("no array") from None
    except ValueError as problem:
        assert not is_out_of_memory(problem)


def test_a_lack_of_resources_counts_only_for_process_starts() -> None:
    def start() -> None:
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    for module in ("subprocess", "multiprocessing.popen_fork", "antdsl.checking"):
        with pytest.raises(BlockingIOError) as error_info:
            FunctionType(start.__code__, {**globals(), "__name__": module})()
        assert is_out_of_memory(error_info.value)
    reads, writes = os.pipe()
    os.set_blocking(reads, False)
    with pytest.raises(BlockingIOError) as error_info:
        os.read(reads, 1)
    os.close(reads)
    os.close(writes)
    assert error_info.value.errno == errno.EAGAIN and not is_out_of_memory(error_info.value)
    assert is_out_of_memory(RuntimeError("Resource temporarily unavailable")), "a C++ library that gets no thread"


@pytest.mark.parametrize("problem", [RuntimeError("wrong"), ValueError("std::bad_alloc is a word"), KeyError("x"), None])
def test_other_errors_are_not_out_of_memory(problem: Exception | None) -> None:
    assert not is_out_of_memory(problem)


@pytest.mark.slow
@pytest.mark.parametrize("mebibytes", [250, 350, 500, 700, 1000, 1500, 2500])
def test_a_run_with_little_memory_ends_with_a_message(tmp_path: Path, mebibytes: int) -> None:
    assert commands.run("new", "project", cwd=tmp_path).returncode == 0
    result = limited(
        tmp_path, mebibytes, "run", "project/scene.yaml", "--frames", "1..3", "--threads", "2", OPENBLAS_NUM_THREADS="2"
    )
    assert result.returncode in (0, 3), result.stderr[-2000:]
    assert "bug in antdsl" not in result.stderr
    assert result.returncode == 0 or "error: " in result.stderr


@pytest.mark.parametrize("command", [("check", "x.yaml"), ("run", "x.yaml")])
def test_too_little_address_space_is_refused_before_libraries_end_the_process(tmp_path: Path, command: tuple[str, ...]) -> None:
    result = limited(tmp_path, 150, *command)
    assert result.returncode == 3 and result.stderr.startswith(
        "error: out of memory: this process may have 150 MiB of address space"
    )
    assert limited(tmp_path, 150, "--version").returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("mebibytes", [256, 390, 680, 1200])
def test_out_of_memory_does_not_report_a_damaged_usd_file(tmp_path: Path, mebibytes: int) -> None:
    pytest.importorskip("pxr")
    assert commands.run("new", "project", cwd=tmp_path).returncode == 0
    scene = tmp_path / "project" / "scene.yaml"
    text = scene.read_text()
    assert "{mesh: ground.ply}" in text
    scene.write_text(text.replace("{mesh: ground.ply}", "{usd: ground.usda, prim: /ground}"))
    (tmp_path / "project" / "ground.usda").write_text(GOOD)
    result = limited(tmp_path, mebibytes, "check", "project/scene.yaml")
    assert (result.returncode == 0) or (result.returncode == 3 and "error: out of memory" in result.stderr), (
        result.stdout + result.stderr
    )


def limited(folder: Path, mebibytes: int, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """A command with limited address space."""
    size = mebibytes << 20
    return subprocess.run(
        [sys.executable, "-m", "antdsl", *words],
        cwd=folder,
        env=child_environment(**variables),
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (size, size)),
    )
