"""How much memory a process can still have."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from math import inf
from pathlib import Path

from antdsl.numerics.control_groups import GROUPS, OWN, group_folders

_SYSTEM = Path("/proc/meminfo")


def address_space() -> float:
    """Bytes of address space that this process, and each one that it starts, may have; infinite without a limit."""
    try:
        import resource
    except ImportError:  # Windows
        return inf
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    return inf if most == resource.RLIM_INFINITY else most


def available_memory() -> int | None:
    """Bytes that this process can still have without swapping, its control groups' limits included; None where the system does
    not say, as on others than Linux."""
    found: list[int] = []
    with suppress(OSError, ValueError, StopIteration):
        lines = _SYSTEM.read_text(encoding="ascii", errors="replace").splitlines()
        found.append(next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")))
    with suppress(OSError):
        found += left(OWN.read_text(encoding="utf-8", errors="surrogateescape"), GROUPS)
    return min(found, default=None)


def left(own: str, groups: Path) -> Iterator[int]:
    """Bytes that each control group with a limit has left; `own` and `groups` as `group_folders` has them. Files that the
    system keeps in memory count as free, since it drops them when it has to."""
    for folder, is_first in group_folders(own, groups, "memory"):
        names = ("memory.limit_in_bytes", "memory.usage_in_bytes") if is_first else ("memory.max", "memory.current")
        with suppress(OSError, ValueError):  # a limit of `max` is none
            most, used = (int((folder / name).read_text()) for name in names)
            yield max(0, most - used + _files(folder))


def _files(folder: Path) -> int:
    words = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
    return sum(int(words.get(name, 0)) for name in ("active_file", "inactive_file"))
