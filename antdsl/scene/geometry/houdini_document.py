"""Parses Houdini's geometry files (since version 12): JSON as text (`.geo`) or as binary tokens (`.bgeo`).

The binary form is that of the open readers houio (D. Koerner) and bgeo_reader (Laika). A token is one byte, followed by its
data. The magic number determines the byte order. Arrays of one type are stored as raw numbers."""

from __future__ import annotations

import json
import struct
from typing import Any, Literal

import numpy as np

from antdsl.scene.geometry.mesh_text import MeshError

_MAGIC_BY_ORDER: dict[Literal["<", ">"], bytes] = {"<": b"\x7fNSJb", ">": b"\x7fbJSN"}
_CLASSIC_MAGICS = (b"PGEOMETRY", b"BgeoV")
_COMPRESSED_MAGICS = {b"scf1": "Blosc", b"\x1f\x8b": "gzip"}
_MAP_BEGIN_TOKEN, _MAP_END_TOKEN, _ARRAY_BEGIN_TOKEN, _ARRAY_END_TOKEN, _UNIFORM_ARRAY_TOKEN = 0x7B, 0x7D, 0x5B, 0x5D, 0x40
_NULL_TOKEN, _BOOL_TOKEN, _FALSE_TOKEN, _TRUE_TOKEN = 0x00, 0x10, 0x30, 0x31
_STRING_TOKEN, _TEXT_DEFINITION_TOKEN, _TEXT_REFERENCE_TOKEN, _TEXT_REMOVAL_TOKEN = 0x27, 0x2B, 0x26, 0x2D
_NUMBER_TYPES = {
    0x11: "i1", 0x12: "i2", 0x13: "i4", 0x14: "i8", 0x18: "f2", 0x19: "f4", 0x1A: "f8", 0x21: "u1", 0x22: "u2",
}  # fmt: skip
_LENGTH_FORMATS = {0xF2: "H", 0xF4: "I", 0xF8: "Q"}
_MAX_DEPTH = 64
_SAVE_AGAIN_HELP = "save it again in Houdini as .bgeo or .geo"


class HoudiniDocument:
    """The content of a file.

    `root`: nested lists, dictionaries, texts, numbers and NumPy arrays. `byte_count`: the size of the file."""

    def __init__(self, data: bytes) -> None:
        self._data, self.byte_count, self._offset_by_text = data, len(data), dict[str, int]()
        if data.startswith(tuple(_MAGIC_BY_ORDER.values())):
            parser = _BinaryParser(data)
            self.root, self._offset_by_text = parser.read_value(parser.read_byte(), 0), parser.offset_by_text
            return
        for magic, name in _COMPRESSED_MAGICS.items():
            if data.startswith(magic):
                raise MeshError(f"is compressed with {name} (at byte 0)", _SAVE_AGAIN_HELP)
        if data.startswith(_CLASSIC_MAGICS):
            raise MeshError("has the classic form of Houdini 11 and earlier (at byte 0)", f"{_SAVE_AGAIN_HELP} (12 or later)")
        try:
            self.root = json.loads(data)
        except json.JSONDecodeError as error:
            offset = len(error.doc[: error.pos].encode("utf-8", "surrogatepass"))
            raise MeshError(f"is not JSON at byte {offset:,}: {error.msg}", _SAVE_AGAIN_HELP) from None
        except RecursionError:
            raise MeshError("has too many nested lists", _SAVE_AGAIN_HELP) from None
        except UnicodeDecodeError as error:
            raise MeshError(f"is neither JSON nor a .bgeo file (at byte {error.start:,})", _SAVE_AGAIN_HELP) from None

    def find_offset(self, text: str) -> int:
        """Return the byte offset at which a text first occurs as a value, or 0 if it does not occur."""
        return self._offset_by_text.get(text, max(self._data.find(json.dumps(text).encode()), 0))


class _BinaryParser:
    """Parser of binary tokens. Lengths are compared with the number of remaining bytes before anything is allocated.

    `offset_by_text`: the byte offset at which each text first occurs."""

    def __init__(self, data: bytes) -> None:
        self._data, self._offset = data, 5
        self._order = next(order for order, magic in _MAGIC_BY_ORDER.items() if data.startswith(magic))
        self._text_by_token = dict[int, str]()
        self.offset_by_text = dict[str, int]()

    def read_byte(self) -> int:
        """Return the next byte."""
        return self._take_bytes(1)[0]

    def _take_bytes(self, count: int) -> bytes:
        """Return the next `count` bytes. Raises MeshError if the file has fewer."""
        start, self._offset = self._offset, self._offset + count
        if self._offset > len(self._data):
            raise MeshError(f"ends within a value at byte {start:,}: a part of it is missing", _SAVE_AGAIN_HELP)
        return self._data[start : self._offset]

    def _read_length(self) -> int:
        """Read a non-negative integer, such as the length of a text or the number of a token.

        The file stores it as one byte if it is below 0xf1. Otherwise, a marker byte comes first, then an integer of 2, 4 or 8
        bytes."""
        first = self.read_byte()
        if first < 0xF1:
            return first
        if first not in _LENGTH_FORMATS:
            raise MeshError(f"has an unknown length {first:#x} at byte {self._offset - 1:,}", _SAVE_AGAIN_HELP)
        form = self._order + _LENGTH_FORMATS[first]
        length: int = struct.unpack(form, self._take_bytes(struct.calcsize(form)))[0]
        return length

    def _read_text(self) -> str:
        """Read the length of a text and the text. Return the text."""
        start = self._offset
        text = self._take_bytes(self._read_length()).decode("utf-8", "replace")
        self.offset_by_text.setdefault(text, start)
        return text

    def _skip_definitions(self, token: int) -> int:
        """Read all definitions and removals of tokens, starting with the token `token`. Return the first token that is something
        else."""
        while token in (_TEXT_DEFINITION_TOKEN, _TEXT_REMOVAL_TOKEN):
            number = self._read_length()
            if token == _TEXT_DEFINITION_TOKEN:
                self._text_by_token[number] = self._read_text()
            else:
                self._text_by_token.pop(number, None)
            token = self.read_byte()
        return token

    def read_value(self, token: int, depth: int) -> Any:
        """Return the value that starts with `token`. The caller has already read this token. `depth`: how many lists and maps
        enclose the value."""
        token, start = self._skip_definitions(token), self._offset - 1
        if depth > _MAX_DEPTH:
            raise MeshError(f"has more than {_MAX_DEPTH} nested lists at byte {start:,}", _SAVE_AGAIN_HELP)
        if token == _ARRAY_BEGIN_TOKEN:
            return self._read_list(depth)
        if token == _MAP_BEGIN_TOKEN:
            return self._read_map(depth)
        if token == _UNIFORM_ARRAY_TOKEN:
            return self._read_uniform_array()
        if token in (_STRING_TOKEN, _TEXT_REFERENCE_TOKEN):
            return self._read_text_item(token)
        if token in _NUMBER_TYPES:
            return self._read_numbers(token, 1)[0].item()
        if token == _BOOL_TOKEN:
            return self.read_byte() != 0
        if token in (_NULL_TOKEN, _FALSE_TOKEN, _TRUE_TOKEN):
            return None if token == _NULL_TOKEN else token == _TRUE_TOKEN
        raise MeshError(f"has an unknown token {token:#04x} at byte {start:,}", _SAVE_AGAIN_HELP)

    def _read_list(self, depth: int) -> list[Any]:
        """Read a list up to its end, and return its items."""
        items: list[Any] = []
        while (token := self._skip_definitions(self.read_byte())) != _ARRAY_END_TOKEN:
            items.append(self.read_value(token, depth + 1))
        return items

    def _read_map(self, depth: int) -> dict[str, Any]:
        """Read a map up to its end, and return its entries."""
        entries: dict[str, Any] = {}
        while (token := self._skip_definitions(self.read_byte())) != _MAP_END_TOKEN:
            if token not in (_STRING_TOKEN, _TEXT_REFERENCE_TOKEN):
                raise MeshError(f"has a key that is not text at byte {self._offset - 1:,}", _SAVE_AGAIN_HELP)
            key = self._read_text_item(token)
            entries[key] = self.read_value(self.read_byte(), depth + 1)
        return entries

    def _read_text_item(self, token: int) -> str:
        """Return a text item. It is either stored at the current position, or it is a reference to an earlier text. `token`: the
        token with which the item begins, which has already been read."""
        if token == _STRING_TOKEN:
            return self._read_text()
        start, number = self._offset - 1, self._read_length()
        if number not in self._text_by_token:
            raise MeshError(f"refers to a missing text (number {number}) at byte {start:,}", _SAVE_AGAIN_HELP)
        self.offset_by_text.setdefault(self._text_by_token[number], start)
        return self._text_by_token[number]

    def _read_numbers(self, token: int, count: int) -> np.ndarray[Any, Any]:
        """Return `count` numbers of one type."""
        kind = np.dtype(_NUMBER_TYPES[token]).newbyteorder(self._order)
        return np.frombuffer(self._take_bytes(count * kind.itemsize), kind)

    def _read_uniform_array(self) -> Any:
        """Return an array of numbers or bools, or a list of texts."""
        start, token = self._offset, self.read_byte()
        count = self._read_length()
        if token in _NUMBER_TYPES:
            return self._read_numbers(token, count)
        if token == _BOOL_TOKEN:  # words of 32 bits
            words = np.frombuffer(self._take_bytes(4 * -(-count // 32)), self._order + "u4")
            return np.unpackbits(words.astype("<u4").view(np.uint8), bitorder="little")[:count].astype(np.bool_)
        if token not in (_STRING_TOKEN, _TEXT_REFERENCE_TOKEN) or count > len(self._data) - self._offset:
            raise MeshError(
                f"has an array of {count:,} values of the unknown type {token:#04x} at byte {start:,}", _SAVE_AGAIN_HELP
            )
        return [self._read_text_item(token) for _ in range(count)]
