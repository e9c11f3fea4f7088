"""What tells one machine from another: the processor's name."""

from __future__ import annotations

import platform
from functools import cache
from pathlib import Path

_PROCESSORS = Path("/proc/cpuinfo")  # Linux


@cache
def processor() -> str:
    """The processor's name as the system tells it."""
    try:
        lines = _PROCESSORS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown processor"
