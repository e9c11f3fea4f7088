"""How much of the machine there is to use."""

from __future__ import annotations

import os
from functools import cache

EACH = 4  # parts of machine code for each of several threads: who comes late, or has slow ones, takes fewer


@cache
def cores() -> int:
    """How many threads may run at once here."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
