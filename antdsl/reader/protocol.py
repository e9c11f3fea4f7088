"""Messages between a process and its reader: a JSON header of limited size, then raw arrays.

Layout: 4 bytes magic, 8 bytes for the length of the header (little endian), the header, the bytes of each array in order. The
header is `{"document": …, "arrays": [[name, dtype, shape], …]}`. Only listed types are allowed, so a message cannot name code to
run."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import prod
from typing import IO, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.diagnostics.model import replace_unprintable

_MAX_TEXT_CHARACTERS = 2000
MESSAGE_MAGIC = b"ant1"
ALLOWED_DTYPES = ("|u1", "<u2", "<i4", "<i8", "<f4", "<f8")
_PREFIX_STRUCT = struct.Struct("<4sQ")
_READ_BLOCK_BYTES = 64 * limits.MIB  # bytes allocated before more have arrived
_MAX_ARRAYS = 4096
_MAX_AXES = 8
_MAX_NUMBER = 1.7e308

Arrays = Mapping[str, NDArray[Any]]


class ProtocolError(Exception):
    """Error for bytes that are not a valid message."""


class PipeError(ProtocolError):
    """Error if the other side closed the pipe before a message was complete."""


@dataclass(frozen=True, slots=True, eq=False)
class ReaderMessage:
    """A message: a JSON object (`document`), and arrays by name."""

    document: dict[str, Any]
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)

    def require_array(self, name: str, dtype: str, *shape: int | None) -> NDArray[Any]:
        """Return an array that must have exactly this type and shape. None in `shape` allows any length. Raises ProtocolError if
        the array is missing or different."""
        found = self.arrays.get(name)
        if found is None or found.dtype != np.dtype(dtype) or found.ndim != len(shape):
            raise ProtocolError(f"`{name}` is not an array of the requested type")
        if any(want is not None and want != have for want, have in zip(shape, found.shape, strict=True)):
            raise ProtocolError(f"`{name}` does not have the requested shape")
        return found

    def require_indices(self, name: str, dtype: str, count: int, *shape: int | None, lowest: int = 0) -> NDArray[Any]:
        """Return an array of indices, checked as by `require_array`. Raises ProtocolError unless every index is at least
        `lowest` and less than `count`."""
        array = self.require_array(name, dtype, *shape)
        if array.size and (array.min() < lowest or array.max() >= count):
            raise ProtocolError(f"`{name}` has an index that is out of range")
        return array

    def require_number(self, name: str) -> float:
        """Return a number of the document. Raises ProtocolError if it is missing or not a finite number."""
        found = self.document.get(name)
        if isinstance(found, bool) or not isinstance(found, int | float) or not -_MAX_NUMBER < found < _MAX_NUMBER:
            raise ProtocolError(f"`{name}` is not a finite number")
        return float(found)

    def require_texts(self, name: str, max_count: int = 1_000_000) -> list[str]:
        """Return a list of texts of the document. Raises ProtocolError if it is something else or has more than `max_count`
        texts."""
        found = self.document.get(name)
        if not isinstance(found, list) or len(found) > max_count or not all(isinstance(each, str) for each in found):
            raise ProtocolError(f"`{name}` is not a list of texts")
        return found

    def unpack_texts(self, name: str, count: int | None = None) -> tuple[str, ...]:
        """Return the texts that `pack_texts` has packed into two arrays. Raises ProtocolError unless there are `count` texts."""
        lengths = self.require_array(f"{name}:lengths", "<i8", count)
        blob = self.require_array(f"{name}:bytes", "|u1", None)
        if len(lengths) and (lengths.min() < 0 or lengths.max() > len(blob)):
            raise ProtocolError(f"`{name}` has a length that is out of range")
        if int(lengths.sum()) != len(blob) or len(lengths) > limits.MAX_AGENTS:
            raise ProtocolError(f"`{name}` does not have as many bytes as its lengths state")
        data, ends = blob.tobytes(), np.cumsum(lengths).tolist()
        try:
            return tuple(data[end - size : end].decode() for end, size in zip(ends, lengths.tolist(), strict=True))
        except UnicodeDecodeError:
            raise ProtocolError(f"`{name}` is not UTF-8") from None


def pack_texts(name: str, texts: tuple[str, ...] | list[str]) -> dict[str, NDArray[Any]]:
    """Return many texts as two arrays of a message: the bytes of all texts, and the length of each text."""
    encoded = [text.encode("utf-8", "replace") for text in texts]
    return {
        f"{name}:lengths": np.array([len(each) for each in encoded], np.int64),
        f"{name}:bytes": np.frombuffer(b"".join(encoded), np.uint8),
    }


def write_message(file: IO[bytes], document: Mapping[str, Any], arrays: Arrays) -> None:
    """Write a message to a stream. Raises ValueError if the document is not JSON or is too large, or if an array has an
    unsupported type."""
    array_entries, parts = [], []
    for name, array in arrays.items():
        little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        if little.dtype.str not in ALLOWED_DTYPES:
            raise ValueError(f"arrays of the type {little.dtype.str} cannot be sent")
        array_entries.append([name, little.dtype.str, list(array.shape)])
        parts.append(little)
    header = json.dumps({"document": document, "arrays": array_entries}, allow_nan=False).encode("ascii")
    if len(header) > limits.MAX_READER_HEADER_BYTES:
        raise ValueError("the document of a message is too large")
    file.write(_PREFIX_STRUCT.pack(MESSAGE_MAGIC, len(header)) + header)
    for part in parts:
        if part.size:
            file.write(part.reshape(-1).view(np.uint8).data)
    file.flush()


def read_message(file: IO[bytes], max_array_bytes: int) -> ReaderMessage:
    """Return the next message from a stream. Raises ProtocolError if it is invalid or its arrays exceed `max_array_bytes` in
    total."""
    magic, length = _PREFIX_STRUCT.unpack(_read_bytes(file, _PREFIX_STRUCT.size).tobytes())
    if magic != MESSAGE_MAGIC or length > limits.MAX_READER_HEADER_BYTES:
        raise ProtocolError("a message begins with the wrong bytes")
    try:
        header = json.loads(_read_bytes(file, length).tobytes(), parse_constant=_reject_json_constant)
    except (ValueError, RecursionError):
        raise ProtocolError("the header of a message is not JSON") from None
    if not isinstance(header, dict) or not isinstance(header.get("document"), dict) or not isinstance(header.get("arrays"), list):
        raise ProtocolError("the header of a message has the wrong keys")
    plan = [_parse_array_entry(entry) for entry in header["arrays"]]
    if (
        len(plan) > _MAX_ARRAYS
        or sum(size for *_, size in plan) > max_array_bytes
        or len({name for name, *_ in plan}) != len(plan)
    ):
        raise ProtocolError("a message has more or larger arrays than are accepted")
    arrays = {}
    for name, dtype, shape, size in plan:
        native = np.dtype(dtype).newbyteorder("=")
        arrays[name] = _read_bytes(file, size).view(dtype).astype(native, copy=False).reshape(shape)
    return ReaderMessage(header["document"], arrays)


def _parse_array_entry(entry: object) -> tuple[str, str, tuple[int, ...], int]:
    """Return the name, type, shape and size in bytes of an array that a header lists."""
    if not isinstance(entry, list) or len(entry) != 3:
        raise ProtocolError("the header of a message describes an array in an unknown format")
    name, dtype, shape = entry
    if not isinstance(name, str) or dtype not in ALLOWED_DTYPES or not isinstance(shape, list) or len(shape) > _MAX_AXES:
        raise ProtocolError("the header of a message describes an array in an unknown format")
    if not all(isinstance(side, int) and not isinstance(side, bool) and 0 <= side < 1 << 40 for side in shape):
        raise ProtocolError("the header of a message gives an array invalid dimensions")
    return name, dtype, tuple(shape), prod(shape) * np.dtype(dtype).itemsize


def _read_bytes(file: IO[bytes], size: int) -> NDArray[np.uint8]:
    """Read exactly `size` bytes. The memory that this uses grows with the bytes that arrive, not with the announced size."""
    buffer = np.empty(min(size, _READ_BLOCK_BYTES), np.uint8)
    filled = 0
    while filled < size:
        if filled == len(buffer):
            buffer = np.concatenate([buffer, np.empty(min(size - filled, len(buffer)), np.uint8)])
        count = file.readinto(buffer[filled:].data)  # type: ignore[attr-defined]
        if not count:
            raise PipeError("a message ends early")
        filled += count
    return buffer


def _reject_json_constant(word: str) -> NoReturn:
    raise ValueError(word)


class RefusalError(Exception):
    """An error by which the reader says why it does not read something.

    - `code`: the code of a diagnostic; the text of the error is its message
    - `help`: what to do instead
    - `key`: the scene key that is concerned
    - `subject`: what the message is about: "" for the complete file, or a word on which the requester and the reading function
      agree
    """

    def __init__(self, code: str, message: str, help: str | None = None, key: str = "", subject: str = "") -> None:
        super().__init__(message)
        self.code, self.help, self.key, self.subject = code, help, key, subject

    def make_document(self) -> dict[str, Any]:
        """Return the error as a document that can be sent to the requester."""
        return {"code": self.code, "message": str(self), "help": self.help, "key": self.key, "about": self.subject}

    @classmethod
    def from_document(cls, document: Any, codes: Any) -> RefusalError | None:
        """Return the error in a document from the reader. Return None if the document is no error, or if the error's code is not
        in `codes`."""
        if not isinstance(document, dict):
            return None
        texts = {name: document.get(name) for name in ("code", "message", "key", "about")}
        help = document.get("help")
        if not all(isinstance(text, str) for text in texts.values()) or not isinstance(help, str | None):
            return None
        if texts["code"] not in codes:
            return None
        return cls(
            str(texts["code"]), clean_for_display(str(texts["message"])), None if help is None else clean_for_display(help),
            str(texts["key"])[:80],
            str(texts["about"])[:80],
        )  # fmt: skip


def clean_for_display(text: str) -> str:
    """Return a text from the reader in a form that is safe for messages: printable and not too long."""
    line = replace_unprintable(text[: _MAX_TEXT_CHARACTERS + 1])
    return line if len(line) <= _MAX_TEXT_CHARACTERS else line[: _MAX_TEXT_CHARACTERS - 1] + "…"
