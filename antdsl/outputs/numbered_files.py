"""Names of files of which there is one for each frame, and why a cache cannot be written in some form."""

from __future__ import annotations

import re
from pathlib import Path


class NoExport(Exception):
    """Why a cache cannot be written so, in words that stand alone; `help`: what to do."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.help = help


def numbered(path: Path, frame: int) -> Path:
    """The file of a frame: its number takes the place of `####`, with as many digits, or stands before the ending, with four."""
    found = re.search("#+", path.stem)
    if found:
        name = f"{path.stem[: found.start()]}{frame:0{len(found[0])}d}{path.stem[found.end() :]}"
        return path.with_name(name + path.suffix)
    return path.with_name(f"{path.stem}.{frame:04d}{path.suffix}")
