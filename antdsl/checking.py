"""Checks many files, on all cores where the system can share out what is loaded; what is found is the same as one by one."""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

from antdsl.diagnostics import Report
from antdsl.loading import CheckedOnce
from antdsl.pipeline import Choices, check_path, sources
from antdsl.program.model import Program
from antdsl.source import Source

# So few files are checked sooner than a process begins.
WORTH_SHARING = 12


@dataclass(slots=True)
class Checked:
    """What was found in files: a report each, in their order, the texts that were looked at, and the programs, where they were
    asked for."""

    reports: dict[Path, Report] = field(default_factory=dict)
    sources: list[Source] = field(default_factory=list)
    programs: dict[Path, Program] = field(default_factory=dict)

    def add(self, other: Checked) -> None:
        self.reports |= other.reports
        self.programs |= other.programs
        known = {source.path for source in self.sources}
        self.sources += [source for source in other.sources if source.path not in known]


def check_all(files: Sequence[Path], choices: Choices, *, strict: bool = False, programs: bool = False) -> Checked:
    """Check each file as `check_path` does. With `programs` they are given too, which takes one process."""
    result = Checked()
    groups = _groups(files)
    cores = _cores()
    if programs or choices.grants or len(files) < WORTH_SHARING or len(groups) < 2 or cores < 2:
        _check(files, choices, strict, CheckedOnce(), result, programs)
        return result
    # The first is checked before the others are shared out: all that is imported and the library are then there once.
    parsed = CheckedOnce()
    _check(groups[0], choices, strict, parsed, result)
    gc.freeze()  # so that no process copies what it has not changed, only to look for garbage in it
    shares = _shares(groups[1:], cores)
    helpers = [_begin(share, choices, strict, parsed) for share in shares[1:]]
    _check(shares[0], choices, strict, parsed, result)
    for share, (process, pipe) in zip(shares[1:], helpers, strict=True):
        found = _end(process, pipe)
        if found is None:  # it was ended from outside: what it was to do is done here
            _check(share, choices, strict, parsed, result)
        else:
            result.add(found)
    return result


def _check(
    files: Iterable[Path], choices: Choices, strict: bool, parsed: CheckedOnce, result: Checked, programs: bool = False
) -> None:
    files = list(files)
    for file in files:
        program, result.reports[file] = check_path(file, choices, strict=strict, parsed=parsed)
        if programs and program is not None:
            result.programs[file] = program
    result.add(Checked(sources=sources(files, parsed)))


def _groups(files: Sequence[Path]) -> list[list[Path]]:
    """Files that may use each other stand together: those of a folder and of all folders below it. Small groups come first."""
    groups: dict[Path, list[Path]] = {}
    tops: list[Path] = []
    for folder in sorted({file.resolve().parent for file in files}):
        if not tops or not folder.is_relative_to(tops[-1]):
            tops.append(folder)
        groups.setdefault(tops[-1], [])
    for file in files:
        folder = file.resolve().parent
        groups[next(top for top in reversed(tops) if folder.is_relative_to(top))].append(file)
    return sorted(groups.values(), key=_weight)


def _weight(files: Iterable[Path]) -> int:
    weight = 0
    for file in files:
        with suppress(OSError):
            weight += 4000 + file.stat().st_size
    return weight


def _shares(groups: list[list[Path]], cores: int) -> list[list[Path]]:
    """At most one share a core, about equally heavy; the heaviest groups are dealt out first."""
    shares: list[list[Path]] = [[] for _ in range(min(cores, len(groups)))]
    weights = [0] * len(shares)
    for group in reversed(groups):
        least = weights.index(min(weights))
        shares[least] += group
        weights[least] += _weight(group)
    return shares


def _cores() -> int:
    """How many processes may be forked: one where forking is not safe (macOS, threads of a ray library)."""
    if sys.platform != "linux" or "open3d" in sys.modules:
        return 1
    return min(len(os.sched_getaffinity(0)), 8)


def _begin(
    files: list[Path], choices: Choices, strict: bool, parsed: CheckedOnce
) -> tuple[multiprocessing.process.BaseProcess, Connection]:
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(theirs, files, choices, strict, parsed), daemon=True)
    process.start()
    theirs.close()
    return process, ours


def _work(pipe: Connection, files: list[Path], choices: Choices, strict: bool, parsed: CheckedOnce) -> None:
    found = Checked()
    _check(files, choices, strict, parsed, found)
    pipe.send(found)
    pipe.close()


def _end(process: multiprocessing.process.BaseProcess, pipe: Connection) -> Checked | None:
    """What a process found; None if it ended without a word."""
    try:
        found: Checked | None = pipe.recv()
    except EOFError:
        found = None
    pipe.close()
    process.join()
    return found
