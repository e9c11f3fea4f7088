"""Messages of the reader: what is written is read again, and anything else is a ProtocolError, whatever the bytes."""

from __future__ import annotations

import io
import json
import random
import struct
from typing import Any

import numpy as np
import pytest

from antdsl import limits
from antdsl.reader.protocol import (
    MESSAGE_MAGIC,
    ProtocolError,
    ReaderMessage,
    RefusalError,
    pack_texts,
    read_message,
    write_message,
)

ARRAYS = {"a": np.arange(12, dtype=np.float64).reshape(4, 3), "b": np.zeros((0, 3), np.int64), "c": np.array([7], ">u2")}


def written(document: dict[str, Any], arrays: dict[str, Any]) -> bytes:
    file = io.BytesIO()
    write_message(file, document, arrays)
    return file.getvalue()


def framed(header: Any, body: bytes = b"") -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<4sQ", MESSAGE_MAGIC, len(text)) + text + body


def test_messages_survive_writing_and_reading() -> None:
    message = read_message(io.BytesIO(written({"x": [1, "é"]}, ARRAYS)), 1000)
    assert message.document == {"x": [1, "é"]} and message.require_array("c", "u2", 1)[0] == 7
    assert all(np.array_equal(message.arrays[name], array) for name, array in ARRAYS.items())
    texts = ("", "é\0", "b" * 100)
    packed = read_message(io.BytesIO(written({}, pack_texts("t", texts))), 1000)
    assert packed.unpack_texts("t", 3) == texts
    for array in (np.array([1j]), np.array(["x"]), np.array([object()])):
        with pytest.raises(ValueError, match="cannot be sent"):
            written({}, {"a": array})


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"ant",
        b"GET / HTTP/1.1\r\n\r\n",
        struct.pack("<4sQ", MESSAGE_MAGIC, 1 << 62),
        framed([]),
        framed({}),
        framed(b"[" * 100_000),
        framed({"document": {}, "arrays": [["a", "<f8", [1 << 39]]]}),
        framed({"document": {}, "arrays": [["a", "<f8", [-1]]]}),
        framed({"document": {}, "arrays": [["a", "<f8", [2, 1 << 39, 1 << 39]]]}),
        framed({"document": {}, "arrays": [["a", "O", [1]]]}),
        framed({"document": {}, "arrays": [["a", "<f8", [1]]]}, b"1234"),
        framed({"document": {}, "arrays": [["a", "|V8", [1]]]}),
        framed({"document": {}, "arrays": [["a", "<f8", [0]], ["a", "<f8", [0]]]}),
        framed(b'{"document": {"x": NaN}, "arrays": []}'),
        framed({"document": {}, "arrays": [["a", "<f8", [True]]]}),
        framed({"document": {}, "arrays": [[["a"], "<f8", [0]]]}),
        framed({"document": {}, "arrays": [["a", ["<f8"], [0]]]}),
        framed(b'{"document": {"x": 1' + b"0" * 9000 + b'}, "arrays": []}'),
    ],
)
def test_invalid_messages_are_rejected(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        read_message(io.BytesIO(data), limits.MAX_READER_ARRAY_BYTES)


def test_any_bytes_are_a_message_or_rejected() -> None:
    draw, good = random.Random(1), written({"answer": {"names": ["a"], "unit": 1.5}}, ARRAYS)
    accepted = 0
    for _ in range(4000):
        data = bytearray(good)
        for _ in range(draw.randint(1, 6)):
            place = draw.randrange(len(data))
            data[place : place + draw.randint(0, 2)] = bytes(draw.choices(b'0129"[]{},:<fiu8x\xff\0', k=draw.randint(0, 3)))
        try:
            message = read_message(io.BytesIO(bytes(data)), 1 << 16)
            accepted += isinstance(message.document, dict)
        except ProtocolError:
            continue
    assert accepted  # changes within the numbers are values


@pytest.mark.parametrize(
    "use",
    [
        lambda m: m.require_array("missing", "f8", None), lambda m: m.require_array("a", "f4", None, 3),
        lambda m: m.require_array("a", "f8", 4), lambda m: m.require_array("a", "f8", 4, 4),
        lambda m: m.require_indices("i", "i8", 3, None), lambda m: m.require_indices("i", "i8", 9, None),
        lambda m: m.require_number("x"), lambda m: m.require_number("huge"), lambda m: m.require_texts("x"),
        lambda m: m.require_texts("many", 1),
        lambda m: m.unpack_texts("t"), lambda m: m.unpack_texts("u"), lambda m: m.unpack_texts("none"),
    ],
)  # fmt: skip
def test_values_are_checked_when_they_are_used(use: Any) -> None:
    texts = {"t:lengths": np.array([2, -1, 3]), "t:bytes": np.zeros(4, np.uint8)}
    texts |= {"u:lengths": np.array([1]), "u:bytes": np.array([255], np.uint8)}
    message = ReaderMessage({"x": True, "huge": 10**400, "many": ["a", "b"]}, {**ARRAYS, "i": np.array([-1, 5]), **texts})
    with pytest.raises(ProtocolError):
        use(message)


def test_a_refusal_has_a_known_code_and_printable_texts() -> None:
    sent = RefusalError("bad-usd", "a\x1b[31m" + "b" * 5000, None, "prim").make_document()
    parsed_refusal = RefusalError.from_document(sent, {"bad-usd"})
    assert parsed_refusal is not None and str(parsed_refusal).isprintable() and len(str(parsed_refusal)) <= 2000
    assert RefusalError.from_document(sent, {"bad-mesh"}) is None
    for document in (None, [], {}, {**sent, "message": 3}, {**sent, "help": []}, {**sent, "key": None}):
        assert RefusalError.from_document(document, {"bad-usd"}) is None
