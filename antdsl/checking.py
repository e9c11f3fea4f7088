"""Checks of many files, on all cores if the system can fork processes that share loaded modules.

The results equal those of checking one file after the other."""

from __future__ import annotations

import gc
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from antdsl import syntax
from antdsl.atomic_write import write_parts
from antdsl.cpu_budget import CpuBudgetSpentError, limit_cpu_seconds
from antdsl.diagnostics import Report
from antdsl.diagnostics.transfer import decode_reports, encode_reports
from antdsl.files import load_sources
from antdsl.loading import SharedParsedFiles
from antdsl.pipeline import RunChoices, check_path
from antdsl.program.model import Program
from antdsl.safe_read import resolve_path
from antdsl.source import Source, Span

# So few files are checked sooner than a process begins.
MIN_FILES_FOR_PROCESSES = 12
MAX_PROCESSES = 8
MAX_FILE_GROUPS = 256  # that a byte can name; what is beyond is checked in the end


@dataclass(slots=True)
class CheckResult:
    """The results of checking files.

    `reports`: the report of each file, in the order of the files.
    `sources`: the texts that were read.
    `programs`: the programs, if requested.
    `cpu_seconds`: the limit of processor time per file; 0 means no limit."""

    reports: dict[Path, Report] = field(default_factory=dict)
    sources: list[Source] = field(default_factory=list)
    programs: dict[Path, Program] = field(default_factory=dict)
    cpu_seconds: float = 0.0

    def merge_result(self, other: CheckResult) -> None:
        """Add the results of another check."""
        self.reports |= other.reports
        self.programs |= other.programs
        known = {source.path for source in self.sources}
        self.sources += [source for source in other.sources if source.path not in known]


def check_files(
    files: Sequence[Path],
    choices: RunChoices,
    *,
    strict: bool = False,
    cores: int = 1,
    programs: bool = False,
    cpu_seconds: float = 0.0,
) -> CheckResult:
    """Check each file as `check_path` does, on `cores` cores.

    `strict`: whether to add the findings of `check --strict`.
    `programs`: whether to return the programs too; this requires `cores` = 1.
    `cpu_seconds`: the limit of processor time per file; a file that exceeds it is reported. 0 means no limit."""
    result = CheckResult(cpu_seconds=cpu_seconds)
    groups = _group_files(files)
    parsed = SharedParsedFiles()
    if programs or choices.grants or len(files) < MIN_FILES_FOR_PROCESSES or len(groups) < 3 or cores < 2 or not _can_fork():
        _check_sequentially(files, choices, strict, parsed, result, programs)
    else:
        _check_in_processes(groups, choices, strict, min(cores, MAX_PROCESSES), parsed, result)
    # Here is what was left over, or was taken by a process that was ended from outside.
    _check_sequentially([file for file in files if file not in result.reports], choices, strict, parsed, result)
    result.merge_result(CheckResult(sources=load_sources(files, parsed)))
    result.sources.sort(key=lambda source: source.path)
    return result


def check_text(data: bytes, choices: RunChoices, *, strict: bool = False, cpu_seconds: float = 0.0) -> CheckResult:
    """Check the text of one program that is not in a file. Files that the program uses are looked up from the
    working directory."""
    path, parsed, result = Path("<stdin>.ant"), SharedParsedFiles(), CheckResult(cpu_seconds=cpu_seconds)
    source, report = syntax.decode_program("<stdin>", data)
    if source is None:
        result.reports[path] = report
        return result
    file, findings = syntax.parse(source)
    report.extend(findings)
    parsed[os.path.realpath(path)] = file, report
    _check_sequentially([path], choices, strict, parsed, result, programs=True)
    result.sources.append(source)
    return result


def _check_in_processes(
    groups: list[list[Path]], choices: RunChoices, strict: bool, cores: int, parsed_files: SharedParsedFiles, result: CheckResult
) -> None:
    """Check groups of files in parallel processes. Each process takes the number of the next unchecked group from a pipe."""
    # The first is checked before the others are shared out: all that is imported and the library are then there once.
    _check_sequentially(groups[0], choices, strict, parsed_files, result)
    gc.freeze()  # so that no process copies what it has not changed, only to look for garbage in it
    # A process that is ready takes the next group, the heaviest first: one byte of a pipe is the right to one group.
    groups = groups[:0:-1][:MAX_FILE_GROUPS]
    mine, theirs = os.pipe()
    os.write(theirs, bytes(range(len(groups))))
    os.close(theirs)
    children: list[tuple[int, int]] = []
    try:
        check = partial(_check_in_child, groups, mine, choices, strict, parsed_files, result.cpu_seconds)
        for _ in range(min(cores, len(groups)) - 1):
            children.append(_start_child(check))
        _check_claimed_groups(groups, mine, choices, strict, parsed_files, result)
        while children:
            result.merge_result(_collect_child_result(*children.pop(0)))
    finally:
        os.close(mine)
        for process, pipe in children:  # of a check that was interrupted
            os.close(pipe)
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)


def _check_claimed_groups(
    groups: Sequence[list[Path]],
    claim_pipe: int,
    choices: RunChoices,
    strict: bool,
    parsed_files: SharedParsedFiles,
    result: CheckResult,
) -> None:
    """Check groups of files until none is left. `claim_pipe`: a pipe from which the number of the next group is read."""
    while claim := os.read(claim_pipe, 1):
        _check_sequentially(groups[claim[0]], choices, strict, parsed_files, result)


def _check_sequentially(
    files: Iterable[Path],
    choices: RunChoices,
    strict: bool,
    parsed_files: SharedParsedFiles,
    result: CheckResult,
    programs: bool = False,
) -> None:
    """Check files one after the other, and store their reports in `result`. `programs`: also store their programs."""
    for file in files:
        try:
            with limit_cpu_seconds(result.cpu_seconds):
                program, result.reports[file] = check_path(file, choices, strict=strict, parsed=parsed_files)
        except CpuBudgetSpentError as spent:
            program, result.reports[file] = None, _make_overdue_report(file, result.cpu_seconds, spent)
        if programs and program is not None:
            result.programs[file] = program


def _make_overdue_report(file: Path, seconds: float, budget_error: CpuBudgetSpentError) -> Report:
    """Return the report on a file that exceeded its processor time. It names the file and the stage of the check that was
    running."""
    modules = [each.f_globals.get("__name__", "") for each, _ in traceback.walk_tb(budget_error.__traceback__)]
    stages = [name.split(".")[1] for name in modules if name.startswith("antdsl.") and name != __name__]
    stage = next((each for each in reversed(stages) if each in _STAGE_PHRASES), "")
    words = f" while {_STAGE_PHRASES[stage]}" if stage else ""
    report = Report()
    message = f"the check stopped{words}: it took more than {seconds:g} s of processor time"
    help = "make the file or its meshes smaller, or allow more time with `--cpu-limit`"
    report.error("too-large", message, Span(Source(str(file), ""), 0, 0), help)
    return report


_STAGE_PHRASES = {
    "syntax": "parsing the text",
    "program": "checking the program",
    "scene": "reading the scene and its meshes",
    "ground": "examining its meshes",
    "bodies": "reading its bodies",
    "plan": "making the plan",
    "passes": "making the plan",
}


def _group_files(files: Sequence[Path]) -> list[list[Path]]:
    """Return groups of files that may use each other. A group has the files of a folder and of all folders below it. Small groups
    come first."""
    groups: dict[Path, list[Path]] = {}
    tops: list[Path] = []
    for folder in sorted({resolve_path(file).parent for file in files}):
        if not tops or not folder.is_relative_to(tops[-1]):
            tops.append(folder)
        groups.setdefault(tops[-1], [])
    for file in files:
        folder = resolve_path(file).parent
        groups[next(top for top in reversed(tops) if folder.is_relative_to(top))].append(file)
    return sorted(groups.values(), key=_estimate_check_cost)


def _estimate_check_cost(files: Iterable[Path]) -> int:
    """Return an estimate of the time for checking files, in arbitrary units."""
    weight = 0
    for file in files:
        with suppress(OSError):
            weight += 4000 + file.stat().st_size
    return weight


def _can_fork() -> bool:
    """Return whether this process can fork safely: only on Linux, and only if no ray-tracing library with threads is loaded."""
    return sys.platform == "linux" and "open3d" not in sys.modules


def _start_child(check: Callable[[int], None]) -> tuple[int, int]:
    """Start a child process that runs `check`, with the pipe for its result as argument. Return the id of the process, and a
    handle from which the result can be read."""
    ours, theirs = os.pipe()
    process = os.fork()
    if process == 0:
        code = 1
        try:
            os.close(ours)
            check(theirs)
            code = 0
            if "antdsl.reader.client" in sys.modules:
                from antdsl.reader.client import end_reader

                end_reader()
        finally:
            os._exit(code)  # nothing that the parent has begun is ended twice
    os.close(theirs)
    return process, ours


def _check_in_child(
    groups: Sequence[list[Path]],
    claim_pipe: int,
    choices: RunChoices,
    strict: bool,
    parsed_files: SharedParsedFiles,
    cpu_seconds: float,
    result_pipe: int,
) -> None:
    """Check groups in a child process, and write the encoded reports to `result_pipe`."""
    results = CheckResult(cpu_seconds=cpu_seconds)
    _check_claimed_groups(groups, claim_pipe, choices, strict, parsed_files, results)
    write_parts(
        result_pipe, [encode_reports(results.reports, load_sources((), parsed_files))]
    )  # scenes are read once, by the parent


def _collect_child_result(process: int, result_pipe: int) -> CheckResult:
    """Return the result of a child process. It is empty if the child ended before its answer was complete."""
    results = CheckResult()
    with os.fdopen(result_pipe, "rb") as file, suppress(ValueError):
        results.reports, results.sources = decode_reports(file.read())
    os.waitpid(process, 0)
    return results
