"""Reads the resources that are available to this process (cores and memory), and the processor's name.

On Linux, control groups (cgroups) limit a process. The limits of its group and of all enclosing groups apply."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from math import inf
from pathlib import Path, PurePosixPath

_CPUINFO_FILE = Path("/proc/cpuinfo")  # Linux
_PROCESS_FOLDER = Path("/proc/self")  # Linux
_MEMINFO_FILE = Path("/proc/meminfo")
CGROUPS_FOLDER, PROCESS_CGROUP_FILE = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
PARTS_PER_THREAD = 4  # a thread that starts late or has slow parts takes fewer


@cache
def count_available_cores() -> int:
    """Return how many threads can run at once: the number of cores that this process may use. Limits of control groups
    (containers) apply, and fractions are rounded up."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        process_groups = PROCESS_CGROUP_FILE.read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:
        return available
    return max(1, min([available, *map(math.ceil, iterate_core_limits(process_groups, CGROUPS_FOLDER))]))


def iterate_core_limits(process_groups: str, groups_folder: Path) -> Iterator[float]:
    """Yield the limits, in cores, of a process's control group and of the groups that contain it. Groups without a limit are
    left out.

    - `process_groups`: Linux's list of the process's groups, one line `number:controllers:path` each
    - `groups_folder`: the folder of all groups

    See the Linux kernel documentation: Control Group v2, `cpu.max`; CFS Bandwidth Control, for version 1."""
    for folder, is_first in iterate_group_folders(process_groups, groups_folder, "cpu"):
        with suppress(OSError, ValueError):
            quota, period = _read_quota_v1(folder) if is_first else _read_quota_v2(folder)
            if quota > 0 and period > 0:
                yield quota / period


def _read_quota_v1(folder: Path) -> tuple[int, int]:
    """Return quota and period (µs) of a version 1 control group. A quota of -1 means no limit."""
    quota, period = (int((folder / f"cpu.cfs_{name}_us").read_text()) for name in ("quota", "period"))
    return quota, period  # a quota of -1 means no limit


def _read_quota_v2(folder: Path) -> tuple[int, int]:
    """Return quota and period (µs) of a version 2 control group."""
    quota, period = (folder / "cpu.max").read_text().split()  # a quota of `max` means no limit
    return int(quota), int(period)


def iterate_group_folders(process_groups: str, groups_folder: Path, controller: str) -> Iterator[tuple[Path, bool]]:
    """Yield the folder of each control group in which `controller` limits a process, and whether it is a version 1 group.

    - `process_groups`: Linux's list of the process's groups, one line `number:controllers:path` each
    - `groups_folder`: the folder of all groups"""
    for line in process_groups.splitlines():
        controllers, _, path = line.partition(":")[2].partition(":")
        if controllers and controller not in controllers.split(","):
            continue
        root = groups_folder / controller if controllers else groups_folder
        parts = [part for part in PurePosixPath(path).parts if part not in ("/", "..")]
        for depth in range(len(parts) + 1):
            yield root.joinpath(*parts[:depth]), bool(controllers)


def get_address_space_limit() -> float:
    """Return the limit of this process's address space in bytes; infinite if there is none. Child processes inherit the limit."""
    try:
        import resource
    except ImportError:  # Windows
        return inf
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return inf if limit == resource.RLIM_INFINITY else limit


def measure_available_memory() -> int | None:
    """Return how many bytes this process can still allocate without swapping, within the limits of its control groups. None if
    the system does not report it (only Linux does)."""
    limits: list[int] = []
    with suppress(OSError, ValueError, StopIteration):
        lines = _MEMINFO_FILE.read_text(encoding="ascii", errors="replace").splitlines()
        limits.append(next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")))
    with suppress(OSError):
        limits += iterate_free_group_memory(
            PROCESS_CGROUP_FILE.read_text(encoding="utf-8", errors="surrogateescape"), CGROUPS_FOLDER
        )
    return min(limits, default=None)


def iterate_free_group_memory(process_groups: str, groups_folder: Path) -> Iterator[int]:
    """Yield the number of bytes left in each control group that has a limit.

    Cached files count as free, because the system drops them when necessary. `process_groups`, `groups_folder`: as for
    `iterate_group_folders`."""
    for folder, is_first in iterate_group_folders(process_groups, groups_folder, "memory"):
        names = ("memory.limit_in_bytes", "memory.usage_in_bytes") if is_first else ("memory.max", "memory.current")
        with suppress(OSError, ValueError):  # a limit of `max` means no limit
            limit, usage = (int((folder / name).read_text()) for name in names)
            yield max(0, limit - usage + _read_reclaimable_bytes(folder))


def _read_reclaimable_bytes(folder: Path) -> int:
    """Return how many bytes of a control group are cached files, which the system can drop."""
    words = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
    return sum(int(words.get(name, 0)) for name in ("active_file", "inactive_file"))


def measure_peak_memory() -> int:
    """Return the peak memory of this process in bytes; 0 where the system does not report it."""
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


def measure_memory() -> tuple[int, int]:
    """Return the current and the peak memory of this process in bytes.

    If the system reports only the peak, both values are the peak. The peak may include that of the parent process."""
    try:
        amounts = _read_kilobyte_lines(_PROCESS_FOLDER / "status")
        return 1024 * amounts["VmRSS"], 1024 * amounts["VmHWM"]
    except (OSError, KeyError):
        return measure_peak_memory(), measure_peak_memory()


def _read_kilobyte_lines(path: Path) -> dict[str, int]:
    """Return the sizes (kB) by name in a file of lines such as `VmRSS: 123 kB`."""
    amounts = {}
    for line in path.read_text(encoding="ascii", errors="replace").splitlines():
        name, _, value = line.partition(":")
        words = value.split()
        if len(words) == 2 and words[1] == "kB" and words[0].isdigit():
            amounts[name] = int(words[0])
    return amounts


@cache
def read_processor_name() -> str:
    """Return the processor's name as the system reports it."""
    import platform  # imported late, because the import is slow

    try:
        lines = _CPUINFO_FILE.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown processor"
