"""Hashes by which damage to a cache is found. The file `hashes.jsonl` has, for each frame, one of the whole state, one of the
frame's file, and one of its checkpoint's file; the manifest has that of `static.npz`.

A file's hash is made of its headers alone, which have the CRC-32 of each array: a file that is written has those anyway, so that
it costs next to nothing. One content that is damaged passes for whole once in 2^32. Caches from before that was so have hashes of
all bytes, without the name of the way before them; they are held against these as ever. Neither is meant to find forgeries."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from antdsl import limits
from antdsl.bounded import blocks, open_regular, read_bounded
from antdsl.outputs.cache.npz import FILE_BYTES
from antdsl.outputs.cache.zip_parts import NotStored, Stored, read_headers

HASHES = "hashes.jsonl"
_BYTES = 400 * limits.FRAMES


@dataclass(frozen=True, slots=True)
class Line:
    """`hash`: of the state; `feet`: of the state of all feet, empty where none are worked out; `file`: of the frame's number,
    those hashes and its file, so that neither a damaged file nor a damaged line passes; `checkpoint`: the same of its
    checkpoint. Empty in a cache from before that was written, or where there is no checkpoint."""

    hash: str
    file: str
    checkpoint: str = ""
    feet: str = ""

    def text(self, frame: int) -> bytes:
        """The line for a frame."""
        words = {"frame": frame, "hash": self.hash, "file": self.file}
        more = {"checkpoint": self.checkpoint, "feet": self.feet}
        return json.dumps(words | {name: text for name, text in more.items() if text}).encode() + b"\n"


def line_of(frame: int, state: str, file: Stored, feet: str = "") -> Line:
    """The line for a frame with the state of a hash, which is written as this file, and with a hash of its feet."""
    return Line(state, _told(_of_frame(frame, state) + _of_feet(feet), file.headers), feet=feet)


def with_checkpoint(frame: int, line: Line, file: Stored) -> Line:
    """The line for a frame whose checkpoint is written as this file. It follows the one that the frame has already, and counts
    in its stead."""
    return replace(line, checkpoint=_told(_of_checkpoint(frame, line.hash) + _of_feet(line.feet), file.headers))


def hash_of_static(file: Stored) -> str:
    """The hash of `static.npz`, which is written as this file."""
    return _told(_STATIC, file.headers)


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
            frame, state, file, point = entry["frame"], entry["hash"], entry.get("file", ""), entry.get("checkpoint", "")
            feet = entry.get("feet", "")
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            break
        if not isinstance(frame, int) or not all(isinstance(word, str) for word in (state, file, point, feet)):
            break
        found[frame] = Line(state, file, point, feet)
    return found


def damage(path: Path, frame: int, line: Line | None) -> str | None:
    """What is wrong with the file of a frame, in words that stand alone; None where it has the bytes that were written."""
    if line is None:
        return _differs(path, b"", "")
    return _differs(path, _of_frame(frame, line.hash) + _feet_within(line.file, line.feet), line.file)


def checkpoint_damage(path: Path, frame: int, line: Line | None) -> str | None:
    """The same for a checkpoint; one from before hashes of them were kept has nothing wrong that could be known here."""
    if line is None:
        return _differs(path, b"", "")
    if not line.checkpoint and not line.file.startswith(_BY_HEADERS):
        return None
    return _differs(path, _of_checkpoint(frame, line.hash) + _feet_within(line.checkpoint, line.feet), line.checkpoint)


def static_damage(path: Path, wanted: str) -> str | None:
    """The same for `static.npz`, of which the manifest has the hash."""
    return _differs(path, _STATIC, wanted)


def _differs(path: Path, begin: bytes, wanted: str) -> str | None:
    """`wanted`: what `_told` said of `begin` and the headers of the file, or the hash of `begin` and all its bytes; empty where
    there is none."""
    try:
        handle = open_regular(path, follow=False)
    except FileNotFoundError:
        return f"`{path}` is not there"
    except OSError as why:
        return f"`{path}` cannot be read: {(why.strerror or str(why)).lower()}"
    try:
        if not wanted:
            return f"`{path}` has no hash in `{HASHES}`"
        held = blocks(handle, FILE_BYTES)
        told = _told(begin, read_headers(held)) if wanted.startswith(_BY_HEADERS) else _hashed(begin, held)
    except NotStored:
        told = ""
    except OSError as why:
        return f"`{path}` cannot be read: {(why.strerror or str(why)).lower()}"
    finally:
        os.close(handle)
    return None if told == wanted else f"`{path}` is not what was written there"


_STATIC = b"static "
_BY_HEADERS = "headers:"


def _of_frame(frame: int, state: str) -> bytes:
    return f"{frame} {state} ".encode()


def _of_checkpoint(frame: int, state: str) -> bytes:
    return f"checkpoint {frame} {state} ".encode()


def _of_feet(feet: str) -> bytes:
    return f"{feet} ".encode() if feet else b""


def _feet_within(wanted: str, feet: str) -> bytes:
    """What a hash has of that of the feet: nothing where it is one of all bytes of a file."""
    return _of_feet(feet) if wanted.startswith(_BY_HEADERS) else b""


def _told(begin: bytes, headers: Iterable[bytes]) -> str:
    """The hash of `begin` and the headers of a file, behind the name of the way in which it was made."""
    return _BY_HEADERS + _hashed(begin, headers)


def _hashed(begin: bytes, data: Iterable[bytes]) -> str:
    hashed = sha256(begin)
    for part in data:
        hashed.update(part)
    return hashed.hexdigest()[:32]
