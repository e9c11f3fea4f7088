"""How much memory a process has used."""

from __future__ import annotations

import sys
from pathlib import Path

_ABOUT = Path("/proc/self")  # Linux


def peak_memory() -> int:
    """The most memory that this process has used at once, in bytes; 0 where the system does not say."""
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


def memory() -> tuple[int, int]:
    """What this process uses now, and the most that it has used since it was started, in bytes. Where the system tells the most
    alone, that twice: it may be that of the process which started this one."""
    try:
        whole = _kilobytes(_ABOUT / "status")
        return 1024 * whole["VmRSS"], 1024 * whole["VmHWM"]
    except (OSError, KeyError):
        return peak_memory(), peak_memory()


def _kilobytes(path: Path) -> dict[str, int]:
    """The amounts in a file with lines such as `VmRSS:  123 kB`."""
    found = {}
    for line in path.read_text(encoding="ascii", errors="replace").splitlines():
        name, _, value = line.partition(":")
        words = value.split()
        if len(words) == 2 and words[1] == "kB" and words[0].isdigit():
            found[name] = int(words[0])
    return found
