"""How much of the machine there is to use."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

from antdsl.numerics.control_groups import GROUPS, OWN, group_folders

EACH = 4  # parts of machine code for each of several threads: who comes late, or has slow ones, takes fewer


@cache
def cores() -> int:
    """How many threads may run at once here: no more than the cores that this process may run on, and than what its control group
    (that of a container, say) may use of them, rounded up."""
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        own = OWN.read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:
        return there
    return max(1, min([there, *map(math.ceil, allowed(own, GROUPS))]))


def allowed(own: str, groups: Path) -> Iterator[float]:
    """How many cores' time the control groups of a process may use: its own, and those around it, as far as they have a limit.

    `own`: what Linux tells of the process's groups, a line `number:controllers:path` each; `groups`: the folder that all are in
    (Linux kernel documentation, Control Group v2, `cpu.max`; CFS Bandwidth Control, of the first version)."""
    for folder, is_first in group_folders(own, groups, "cpu"):
        with suppress(OSError, ValueError):
            quota, period = _first(folder) if is_first else _second(folder)
            if quota > 0 and period > 0:
                yield quota / period


def _first(folder: Path) -> tuple[int, int]:
    quota, period = (int((folder / f"cpu.cfs_{name}_us").read_text()) for name in ("quota", "period"))
    return quota, period  # a quota of -1 is none


def _second(folder: Path) -> tuple[int, int]:
    quota, period = (folder / "cpu.max").read_text().split()  # a quota of `max` is none
    return int(quota), int(period)
