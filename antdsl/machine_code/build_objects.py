"""`python -m antdsl.machine_code.build_objects [--host]`: compile all kernels and LLVM IR texts of the package in advance.

For each target in `shipped_objects`, it writes one file into the installation. With `--host`, it writes only the file for this
machine's target. The build and the installation of the package run it. It needs only NumPy and llvmlite. Objects with keys
that already exist are not compiled again; to start from scratch, delete the folder. The same sources and LLVM give the same
bytes: no file depends on the time, a path or the compilation order."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path

from antdsl.atomic_write import write_atomically
from antdsl.child_processes import isolate_search_paths
from antdsl.machine_code import library, llvm_compiler, shipped_objects

_MAX_PROCESSES = 8  # each process takes 200 MB, and 2 s to import the kernels
_QualifiedName = tuple[str, str]  # module and name of an entry
_CompileTask = tuple[_QualifiedName, tuple[str, ...]]  # an entry, and the names of its targets


def build_object_files(folder: Path, entries: Sequence[library.LibraryEntry], targets: Iterable[str], processes: int = 1) -> int:
    """Write one file of compiled objects per target into `folder`, and return the number of newly compiled objects. The folder
    is created if needed. `entries`: the kernels and texts to compile; with more than one process, they must be entries of the
    package. `targets`: names in `TARGET_BY_NAME`. Objects that are already in the folder are not compiled again."""
    keys: dict[str, dict[_QualifiedName, str]] = {}
    objects_by_target: dict[str, dict[str, bytes]] = {}
    for name in targets:
        target = shipped_objects.TARGET_BY_NAME[name]
        stored = shipped_objects.ObjectFile(shipped_objects.make_objects_path(folder, name))
        keys[name] = {
            _get_qualified_name(each): shipped_objects.compute_shipped_key(named, target)
            for each in entries
            if (named := each.make_text_key(target))
        }
        objects_by_target[name] = {key: code for key in keys[name].values() if (code := stored.get(key)) is not None}
    tasks: list[_CompileTask] = []
    for each in entries:
        place = _get_qualified_name(each)
        missing = tuple(name for name in keys if place in keys[name] and keys[name][place] not in objects_by_target[name])
        if missing:
            tasks.append((place, missing))
    for (place, names), codes in zip(tasks, _compile_tasks(tasks, entries, processes), strict=True):
        for name, code in zip(names, codes, strict=True):
            objects_by_target[name][keys[name][place]] = code
    folder.mkdir(parents=True, exist_ok=True)
    for name, codes_by_key in objects_by_target.items():
        write_atomically(shipped_objects.make_objects_path(folder, name), shipped_objects.pack_objects(codes_by_key))
    shipped_objects.close_files()
    return sum(len(names) for _, names in tasks)


def _get_qualified_name(entry: library.LibraryEntry) -> _QualifiedName:
    """Return the module name and the name of a kernel or LLVM IR text."""
    return entry.__module__, entry.__name__


def _compile_tasks(tasks: list[_CompileTask], entries: Sequence[library.LibraryEntry], processes: int) -> Iterator[list[bytes]]:
    """Compile tasks. Yield one list per task, in order: the object code for each of the task's targets."""
    if processes < 2 or len(tasks) < 2:
        known = {_get_qualified_name(each): each for each in entries}
        for place, names in tasks:
            yield _compile_for_targets(known[place], names)
        return
    with ProcessPoolExecutor(min(processes, len(tasks)), multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(_compile_task, tasks)


def _compile_task(task: _CompileTask) -> list[bytes]:
    """Compile one kernel or text for each target of the task. Return one object code per target. Runs in a worker process."""
    place, names = task
    return _compile_for_targets(_load_library()[place], names)


@cache
def _load_library() -> dict[_QualifiedName, library.LibraryEntry]:
    """Return the package's kernels and texts by (module, name), for use in a worker process."""
    return {_get_qualified_name(each): each for each in library.load_entries()}


def _compile_for_targets(entry: library.LibraryEntry, names: tuple[str, ...]) -> list[bytes]:
    """Return the object code of an entry, compiled for each of the targets `names`."""
    return [
        llvm_compiler.compile_object(entry.text(shipped_objects.TARGET_BY_NAME[name]), shipped_objects.TARGET_BY_NAME[name])
        for name in names
    ]


def main() -> int:
    """Run the command. Return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m antdsl.machine_code.build_objects", description=__doc__)
    parser.add_argument("--host", action="store_true", help="compile only for this machine")
    host = parser.parse_args().host
    isolate_search_paths()  # set before processes start
    why = llvm_compiler.find_unavailability_reason()
    targets = list(shipped_objects.TARGET_BY_NAME)
    if host and not why:
        own = shipped_objects.find_target_name(llvm_compiler.find_host_target())
        why = (
            ""
            if own
            else f"this machine ({llvm_compiler.find_host_target().triple}, {llvm_compiler.find_host_target().cpu}) "
            f"is not one of {', '.join(targets)}"
        )
        targets = [own] if own else []
    if why:
        print(f"kernels are not compiled in advance, but when they are first used: {why}", file=sys.stderr)
        return 1
    start = time.monotonic()
    entries = library.load_entries()
    core_count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    count = build_object_files(shipped_objects.OBJECTS_FOLDER, entries, targets, min(core_count, _MAX_PROCESSES))
    size = sum(shipped_objects.make_objects_path(shipped_objects.OBJECTS_FOLDER, name).stat().st_size for name in targets)
    words = f"{len(entries)} kernels and texts for {', '.join(targets)}: {size / 1e6:.1f} MB"
    print(f"{words}; {count} of them were compiled in {time.monotonic() - start:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
