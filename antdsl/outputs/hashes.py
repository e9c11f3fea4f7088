"""The file `hashes.jsonl` of a cache: for each frame a hash of the whole state, and one of the frame's file, by which damage is
found."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from antdsl import limits
from antdsl.bounded import blocks, open_regular, read_bounded
from antdsl.outputs.npz import FILE_BYTES

if TYPE_CHECKING:
    from hashlib import _Hash

HASHES = "hashes.jsonl"
_BYTES = 250 * limits.FRAMES


@dataclass(frozen=True, slots=True)
class Line:
    """`hash`: of the state; `file`: of the frame's number, that hash and the bytes of its file, so that neither a damaged file
    nor a damaged line passes. Empty in a cache from before that was written."""

    hash: str
    file: str

    def text(self, frame: int) -> bytes:
        """The line for a frame."""
        return json.dumps({"frame": frame, "hash": self.hash, "file": self.file}).encode() + b"\n"


def line_of(frame: int, state: str, data: bytes) -> Line:
    """The line for a frame with the state of a hash, whose file has these bytes."""
    hashed = _begun(frame, state)
    hashed.update(data)
    return Line(state, hashed.hexdigest()[:32])


def read_lines(path: Path) -> dict[int, Line]:
    """The lines by frame, as far as they are whole. Empty where there are none to be read."""
    found: dict[int, Line] = {}
    try:
        text = read_bounded(path, _BYTES, follow=False).decode("utf-8", "replace")
    except OSError:
        return found
    for line in text.split("\n")[:-1]:
        try:
            entry = json.loads(line)
            frame, state, file = entry["frame"], entry["hash"], entry.get("file", "")
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            break
        if not isinstance(frame, int) or not isinstance(state, str) or not isinstance(file, str):
            break
        found[frame] = Line(state, file)
    return found


def damage(path: Path, frame: int, line: Line | None) -> str | None:
    """What is wrong with the file of a frame, in words that stand alone; None where it has the bytes that were written."""
    try:
        handle = open_regular(path, follow=False)
    except FileNotFoundError:
        return f"`{path}` is not there"
    except OSError as why:
        return f"`{path}` cannot be read: {(why.strerror or str(why)).lower()}"
    try:
        if line is None or not line.file:
            return f"`{path}` has no hash in `{HASHES}`"
        hashed = _begun(frame, line.hash)
        for block in blocks(handle, FILE_BYTES):
            hashed.update(block)
    except OSError as why:
        return f"`{path}` cannot be read: {(why.strerror or str(why)).lower()}"
    finally:
        os.close(handle)
    return None if hashed.hexdigest()[:32] == line.file else f"`{path}` is not what was written there"


def _begun(frame: int, state: str) -> _Hash:
    return sha256(f"{frame} {state} ".encode())
