"""Text → file: whole or not at all, through links, with the rights that the file has."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from antdsl.whole import whole


def write(path: Path, text: str) -> None:
    """Put a text in the place of a file that is there. Whoever reads it meanwhile, and whoever comes after a crash, sees the old
    text or the new one. Raises OSError where that cannot be done; the old file is left as it was."""
    place = path.resolve(strict=True)
    if not os.access(place, os.W_OK):
        # the folder would let us put another file in its place, but this one is not to be changed
        raise PermissionError(13, "permission denied", str(path))
    with whole(place) as part:
        shutil.copymode(place, part)  # before anything is in it: nobody reads it meanwhile who could not read the file
        with open(part, "wb") as file:
            file.write(text.encode("utf-8"))
            file.flush()
            os.fsync(file.fileno())
