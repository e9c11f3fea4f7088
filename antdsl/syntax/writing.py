"""Text → file: whole or not at all, through links, with the rights that the file has."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from antdsl.whole import whole_file


def write(path: Path, text: str) -> None:
    """Put a text in the place of a file that is there. Whoever reads it meanwhile, and whoever comes after a crash, sees the old
    text or the new one. Raises OSError where that cannot be done; the old file is left as it was."""
    place = path.resolve(strict=True)
    if not os.access(place, os.W_OK):
        # the folder would let us put another file in its place, but this one is not to be changed
        raise PermissionError(13, "permission denied", str(path))
    with whole_file(place) as file:
        if os.chmod in os.supports_fd:  # before there is anything in it to read
            os.chmod(file.fileno(), stat.S_IMODE(place.stat().st_mode))
        file.write(text.encode("utf-8"))
