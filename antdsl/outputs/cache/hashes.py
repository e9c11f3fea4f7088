"""Hashes that detect damage to a cache.

For each frame, `hashes.jsonl` contains hashes of the complete state, the frame file and the checkpoint file. The manifest
contains the hash of `static.npz`.

The hash of a file covers only its headers, which contain the CRC-32 of each array. These are computed for the file in any case,
so the hash costs almost nothing. Damage to content is missed with a probability of 2^-32.

Older caches have hashes of all bytes, without the name of the method in front. They are checked with these. Neither kind detects
forgeries."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from antdsl import limits
from antdsl.outputs.cache.npz import MAX_FILE_BYTES
from antdsl.outputs.cache.zip_parts import NotStored, StoredFile, read_headers
from antdsl.safe_read import open_regular_file, read_blocks, read_size_limited

HASHES_FILE_NAME = "hashes.jsonl"
_MAX_FILE_BYTES = 400 * limits.MAX_FRAMES


@dataclass(frozen=True, slots=True)
class HashLine:
    """The hashes of a frame. In caches of older versions, some of these are empty.

    `hash`: the hash of the state. `feet`: the hash of all feet; empty if no feet are computed. `file`: the hash of the frame's
    number, `hash`, `feet` and the frame file. Damage to the file or to the line changes it. `checkpoint`: the same for the
    checkpoint file; empty if the frame has no checkpoint."""

    hash: str
    file: str
    checkpoint: str = ""
    feet: str = ""

    def text(self, frame: int) -> bytes:
        """Return the line for this frame in `hashes.jsonl`, as JSON text."""
        words = {"frame": frame, "hash": self.hash, "file": self.file}
        optional = {"checkpoint": self.checkpoint, "feet": self.feet}
        return json.dumps(words | {name: text for name, text in optional.items() if text}).encode() + b"\n"


def make_line(frame: int, state: str, file: StoredFile, feet: str = "") -> HashLine:
    """Return the hashes of a frame. `state`: its state hash. `file`: its file. `feet`: the hash of all feet."""
    return HashLine(state, _hash_headers(_make_frame_prefix(frame, state) + _make_feet_prefix(feet), file.headers), feet=feet)


def add_checkpoint_hash(frame: int, line: HashLine, file: StoredFile) -> HashLine:
    """Return the hashes of a frame with the hash of its checkpoint file added.

    The line with these hashes is appended to the file, and replaces the frame's earlier line."""
    return replace(
        line, checkpoint=_hash_headers(_make_checkpoint_prefix(frame, line.hash) + _make_feet_prefix(line.feet), file.headers)
    )


def hash_static_file(file: StoredFile) -> str:
    """Return the hash of `static.npz`, computed before the file is written."""
    return _hash_headers(_STATIC_PREFIX, file.headers)


def read_lines(path: Path) -> dict[int, HashLine]:
    """Return the hashes in the complete lines of a file, by frame. Empty if no line can be read."""
    lines: dict[int, HashLine] = {}
    try:
        text = read_size_limited(path, _MAX_FILE_BYTES, follows_links=False).decode("utf-8", "replace")
    except OSError:
        return lines
    for line in text.split("\n")[:-1]:
        try:
            entry = json.loads(line)
            frame, state, file, point = entry["frame"], entry["hash"], entry.get("file", ""), entry.get("checkpoint", "")
            feet = entry.get("feet", "")
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            break
        if not isinstance(frame, int) or not all(isinstance(word, str) for word in (state, file, point, feet)):
            break
        lines[frame] = HashLine(state, file, point, feet)
    return lines


def find_frame_damage(path: Path, frame: int, line: HashLine | None) -> str | None:
    """Return a complete message about damage to a frame's file. None if the file has the bytes that were written."""
    if line is None:
        return _find_hash_problem(path, b"", "")
    return _find_hash_problem(path, _make_frame_prefix(frame, line.hash) + _make_feet_input(line.file, line.feet), line.file)


def find_checkpoint_damage(path: Path, frame: int, line: HashLine | None) -> str | None:
    """Return a message about damage to a checkpoint. None if there is none, or if the cache has no hash of the checkpoint."""
    if line is None:
        return _find_hash_problem(path, b"", "")
    if not line.checkpoint and not line.file.startswith(_HEADER_METHOD_PREFIX):
        return None
    return _find_hash_problem(
        path, _make_checkpoint_prefix(frame, line.hash) + _make_feet_input(line.checkpoint, line.feet), line.checkpoint
    )


def find_static_damage(path: Path, expected_hash: str) -> str | None:
    """Return a message about damage to `static.npz`. None if the file has the hash that the manifest contains,
    `expected_hash`."""
    return _find_hash_problem(path, _STATIC_PREFIX, expected_hash)


def _find_hash_problem(path: Path, prefix: bytes, expected_hash: str) -> str | None:
    """Return a message if a file does not have the expected hash, else None.

    `expected_hash`: the result of `_hash_headers` for `prefix` and the headers of the file. In older caches, it is the hash of
    `prefix` and all bytes of the file. Empty if no hash is known."""
    try:
        handle = open_regular_file(path, follows_links=False)
    except FileNotFoundError:
        return f"`{path}` does not exist"
    except OSError as error:
        return f"`{path}` cannot be read: {(error.strerror or str(error)).lower()}"
    try:
        if not expected_hash:
            return f"`{path}` has no hash in `{HASHES_FILE_NAME}`"
        held = read_blocks(handle, MAX_FILE_BYTES)
        actual = (
            _hash_headers(prefix, read_headers(held))
            if expected_hash.startswith(_HEADER_METHOD_PREFIX)
            else _hash_bytes(prefix, held)
        )
    except NotStored:
        actual = ""
    except OSError as error:
        return f"`{path}` cannot be read: {(error.strerror or str(error)).lower()}"
    finally:
        os.close(handle)
    return None if actual == expected_hash else f"`{path}` was changed or damaged after it was written"


_STATIC_PREFIX = b"static "
_HEADER_METHOD_PREFIX = "headers:"


def _make_frame_prefix(frame: int, state: str) -> bytes:
    """Return the bytes that are hashed before the headers of a frame file."""
    return f"{frame} {state} ".encode()


def _make_checkpoint_prefix(frame: int, state: str) -> bytes:
    """Return the bytes that are hashed before the headers of a checkpoint file."""
    return f"checkpoint {frame} {state} ".encode()


def _make_feet_prefix(feet: str) -> bytes:
    """Return the bytes with the hash of the feet that are hashed before the headers of a frame file."""
    return f"{feet} ".encode() if feet else b""


def _make_feet_input(expected_hash: str, feet: str) -> bytes:
    """Return the bytes for the feet in the hash of a frame file. Empty if `expected_hash` is of the older method, which hashes
    all bytes."""
    return _make_feet_prefix(feet) if expected_hash.startswith(_HEADER_METHOD_PREFIX) else b""


def _hash_headers(prefix: bytes, headers: Iterable[bytes]) -> str:
    """Return a hash of `prefix` and the headers of a file, as text that begins with the name of the method."""
    return _HEADER_METHOD_PREFIX + _hash_bytes(prefix, headers)


def _hash_bytes(prefix: bytes, data: Iterable[bytes]) -> str:
    """Return the hash of `prefix` and `data`."""
    hashed = sha256(prefix)
    for part in data:
        hashed.update(part)
    return hashed.hexdigest()[:32]
