"""Links where results go by default. A project may bring a link named `out`, and nobody has chosen what it leads to."""

from __future__ import annotations

import os
from pathlib import Path


def is_link(path: Path) -> bool:
    """Whether a path is a link itself, on Windows a junction too; false where nothing is there."""
    try:
        status = os.lstat(path)
    except OSError:
        return False
    return os.path.islink(path) or bool(getattr(status, "st_reparse_tag", False))


def first_link(base: Path, *names: str) -> Path | None:
    """The first of `base/NAME`, `base/NAME/NAME`, … that is a link, or None. Links in `base` are those of whoever named it."""
    path = base
    for name in names:
        path /= name
        if is_link(path):
            return path
    return None
