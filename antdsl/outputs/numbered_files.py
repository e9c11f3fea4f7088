"""Names for files of single frames, and the error for caches that cannot be exported in some form."""

from __future__ import annotations

import re
from pathlib import Path


class ExportUnavailable(Exception):
    """Error for a cache that cannot be exported in this form. The message is a complete explanation. `help`: a remedy."""

    def __init__(self, message: str, help: str = "") -> None:
        super().__init__(message)
        self.help = help


def make_numbered_path(path: Path, frame: int) -> Path:
    """Return the path of the file of a frame. The frame number replaces `####`, padded to as many digits.

    If the name has no `####`, the number is inserted before the suffix, with four digits."""
    match = re.search("#+", path.stem)
    if match:
        name = f"{path.stem[: match.start()]}{frame:0{len(match[0])}d}{path.stem[match.end() :]}"
        return path.with_name(name + path.suffix)
    return path.with_name(f"{path.stem}.{frame:04d}{path.suffix}")
