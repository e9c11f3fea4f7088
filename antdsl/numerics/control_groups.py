"""The control groups (cgroups) of Linux that limit what a process may use: its own, and those around it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path, PurePosixPath

GROUPS, OWN = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def group_folders(own: str, groups: Path, controller: str) -> Iterator[tuple[Path, bool]]:
    """Folders of the groups that a controller limits a process by, and whether they are of the first version of control groups.

    `own`: what Linux says of the process's groups, a line `number:controllers:path` each. `groups`: the folder of all groups."""
    for line in own.splitlines():
        controllers, _, path = line.partition(":")[2].partition(":")
        if controllers and controller not in controllers.split(","):
            continue
        root = groups / controller if controllers else groups
        parts = [part for part in PurePosixPath(path).parts if part not in ("/", "..")]
        for depth in range(len(parts) + 1):
            yield root.joinpath(*parts[:depth]), bool(controllers)
