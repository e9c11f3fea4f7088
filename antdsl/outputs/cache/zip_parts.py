"""A zip file without compression as parts in memory that are it end to end: what lies in its members is not copied.

By the application note of the format (PKWARE, .ZIP File Format Specification 6.3.10), as Python's `zipfile` writes it to the
byte, in a tenth of its time: what is known of a member before it is written stands in one header."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from struct import Struct

from antdsl.numerics.check_sums import crc32

Parts = Sequence[bytes | memoryview]

LIMIT = (1 << 31) - 1  # what is longer, or begins later, is told in eight bytes
MOST = (1 << 16) - 1  # members; how many more there are is told so too
_ELSEWHERE = 0xFFFFFFFF  # in four bytes: it stands in eight of the extra field
_PLAIN, _LONG = 20, 45  # the version of the format that a reader has to know
_UTF8 = 0x800
_TIME, _DATE = 0, 1 << 5 | 1  # 1 January 1980: the same arrays give the same bytes, whenever they are written
_SYSTEM = 0 if sys.platform == "win32" else 3
_ATTRIBUTES = 0o600 << 16
_LOCAL = Struct("<4s5H3L2H")
_CENTRAL = Struct("<4s4B4H3L5H2L")
_END = Struct("<4s4H2LH")
_LONG_END = Struct("<4sQ2H2L4Q")
_LOCATOR = Struct("<4sLQL")


def stored(members: Iterable[tuple[str, bytes, memoryview]]) -> Parts:
    """The parts of a file with these members, in order: of each its name, and its content as a head and the rest. `rest` is a
    part as it is, so nothing of it may change until the parts have been used."""
    parts: list[bytes | memoryview] = []
    entries: list[bytes] = []
    at = 0
    for name, head, rest in members:
        words, size, check = name.encode(), len(head) + len(rest), crc32(rest, crc32(head))
        flags = 0 if name.isascii() else _UTF8
        told, version, extra = (size, _PLAIN, b"") if size <= LIMIT else (_ELSEWHERE, _LONG, _longs(size, size))
        local = _LOCAL.pack(
            b"PK\3\4", version, flags, 0, _TIME, _DATE, check, told, told, len(words), len(extra)
        )  # fmt: skip
        parts += (local + words + extra + head, rest)
        entries.append(_entry(words, flags, check, size, at))
        at += len(parts[-2]) + len(rest)
    return [*parts, b"".join(entries) + _end(len(entries), sum(map(len, entries)), at)]


def _entry(words: bytes, flags: int, check: int, size: int, at: int) -> bytes:
    """What the directory says of a member that begins at a place."""
    longs = [size, size] if size > LIMIT else []
    told, place = (_ELSEWHERE if longs else size), at
    if at > LIMIT:
        longs, place = [*longs, at], _ELSEWHERE
    version, extra = (_LONG, _longs(*longs)) if longs else (_PLAIN, b"")
    return _CENTRAL.pack(
        b"PK\1\2", version, _SYSTEM, version, 0, flags, 0, _TIME, _DATE, check, told, told,
        len(words), len(extra), 0, 0, 0, _ATTRIBUTES, place,
    ) + words + extra  # fmt: skip


def _end(count: int, size: int, at: int) -> bytes:
    """What stands after the directory, which has so many entries and bytes and begins at a place."""
    found = b""
    if count > MOST or at > LIMIT or size > LIMIT:
        found = _LONG_END.pack(b"PK\6\6", 44, _LONG, _LONG, 0, 0, count, count, size, at)
        found += _LOCATOR.pack(b"PK\6\7", 0, at + size, 1)
        count, size, at = min(count, MOST), min(size, _ELSEWHERE), min(at, _ELSEWHERE)
    return found + _END.pack(b"PK\5\6", 0, 0, count, count, size, at, 0)


def _longs(*numbers: int) -> bytes:
    """The extra field with numbers of eight bytes."""
    return Struct(f"<2H{len(numbers)}Q").pack(1, 8 * len(numbers), *numbers)
