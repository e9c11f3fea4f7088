"""An uncompressed zip file as consecutive parts in memory, without copies of its members' contents.

The format follows its specification (PKWARE, .ZIP File Format Specification 6.3.10). The bytes are the same as those of Python's
`zipfile`, but are written 10 times as fast. Everything that is known about a member beforehand is prepared once, in its form.

In this module, the headers of a file are all its bytes, including the directory, except the contents of its members. They contain
the CRC-32 of each content. So a hash of the headers is enough to detect damage anywhere in the file."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from struct import Struct

from antdsl.atomic_write import BytesParts
from antdsl.numerics.check_sums import compute_crc32

MAX_SHORT_SIZE = (1 << 31) - 1  # larger sizes and offsets are written in eight bytes
MAX_SHORT_COUNT = (1 << 16) - 1  # members; the format stores larger counts in eight bytes
_LONG_VALUE_MARK = 0xFFFFFFFF  # marks a value that is in eight bytes of the extra field
_PLAIN_VERSION, _LONG_VERSION = 20, 45  # the version of the format that a reader must support
_UTF8_FLAG = 0x800
_FIXED_TIME, _FIXED_DATE = 0, 1 << 5 | 1  # 1 January 1980, so that equal arrays give equal bytes at any time
_SYSTEM_CODE = 0 if sys.platform == "win32" else 3
_FILE_ATTRIBUTES = 0o600 << 16
_MEMBER_SIGNATURE = b"PK\3\4"
_LOCAL_HEADER = Struct("<4s5H3L2H")
_DIRECTORY_ENTRY = Struct("<4s4B4H3L5H2L")
_LOCAL_CRC_OFFSET, _ENTRY_CRC_OFFSET, _ENTRY_OFFSET_OFFSET = (
    14,
    16,
    42,
)  # offsets of the CRC-32 in the headers, and of the member's offset in its entry
_LONG_SIZE_FIELD = Struct("<2H2Q")
_END_RECORD = Struct("<4s4H2LH")
_LONG_END_RECORD = Struct("<4sQ2H2L4Q")
_LONG_END_LOCATOR = Struct("<4sLQL")


class NotStored(Exception):
    """Error for a zip file with compressed members, or with content that does not match its header."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredFile:
    """A zip file that has not been written yet.

    `parts`: its bytes, as consecutive pieces. `headers`: all bytes except the contents of its members."""

    parts: BytesParts
    headers: Sequence[bytes]


def make_stored_file(members: Iterable[tuple[MemberForm, memoryview]]) -> StoredFile:
    """Return the zip file with these members, in order. A member consists of its form, and the bytes of its content after the
    form's `head`.

    Contents are not copied. They must not change until the parts are written."""
    parts: list[bytes | memoryview] = []
    headers: list[bytes] = []
    entries: list[bytes] = []
    at = 0
    for form, rest in members:
        check = compute_crc32(rest, form.head_crc).to_bytes(4, "little")
        prefix, suffix = form.header
        header = prefix + check + suffix
        headers.append(header)
        parts += (header + form.head, rest)
        entries.append(_make_directory_entry(form, check, at))
        at += len(header) + form.size
    directory = b"".join(entries)
    headers.append(directory + _make_end_record(len(entries), len(directory), at))
    return StoredFile([*parts, headers[-1]], headers)


@dataclass(frozen=True, slots=True, eq=False)
class MemberForm:
    """The bytes that are equal for all members with the same name, head and size.

    `head`: the first bytes of the content. `size`: the length of the content. `head_crc`: the CRC-32 of the head. `header`: the
    fixed bytes of the member's header, before and after the CRC-32. `entry`: the fixed bytes of its directory entry, before,
    between and after the CRC-32 and the offset."""

    head: bytes
    size: int
    head_crc: int
    name_bytes: bytes
    flags: int
    header: tuple[bytes, bytes]
    entry: tuple[bytes, bytes, bytes]


def make_member_form(name: str, head: bytes, content_size: int) -> MemberForm:
    """Return the form of members that have `content_size` bytes after the head."""
    words, size = name.encode(), len(head) + content_size
    flags = 0 if name.isascii() else _UTF8_FLAG
    size_field, version, extra = (
        (size, _PLAIN_VERSION, b"") if size <= MAX_SHORT_SIZE else (_LONG_VALUE_MARK, _LONG_VERSION, _make_long_field(size, size))
    )
    local = (
        _LOCAL_HEADER.pack(
            _MEMBER_SIGNATURE, version, flags, 0, _FIXED_TIME, _FIXED_DATE, 0, size_field, size_field, len(words), len(extra)
        )
        + words
        + extra
    )
    prefix, suffix = _split_around_field(_make_blank_entry(words, flags, size, 0), _ENTRY_CRC_OFFSET)
    entry = prefix, *_split_around_field(suffix, _ENTRY_OFFSET_OFFSET - _ENTRY_CRC_OFFSET - 4)
    return MemberForm(head, size, compute_crc32(head), words, flags, _split_around_field(local, _LOCAL_CRC_OFFSET), entry)


def _split_around_field(record: bytes, offset: int) -> tuple[bytes, bytes]:
    """Return the bytes of a record before and after its four-byte field at `offset`."""
    return record[:offset], record[offset + 4 :]


def read_headers(blocks: Iterator[bytes]) -> Iterator[bytes]:
    """Yield the headers of a file in pieces. Check the contents between them against their CRC-32.

    `blocks`: the bytes of the file, in blocks of any length. Raises NotStored if a checksum is wrong, or if `make_stored_file`
    cannot have made the file."""
    file = _BlockReader(blocks)
    while (mark := file.read_up_to(len(_MEMBER_SIGNATURE))) == _MEMBER_SIGNATURE:
        local = mark + file.read_exactly(_LOCAL_HEADER.size - len(_MEMBER_SIGNATURE))
        check, size, _, words, extra = _LOCAL_HEADER.unpack(local)[6:]
        tail = file.read_exactly(words + extra)
        yield local + tail
        if size == _LONG_VALUE_MARK:
            if extra != _LONG_SIZE_FIELD.size:
                raise NotStored
            size = _LONG_SIZE_FIELD.unpack(tail[words:])[2]
        if file.read_crc(size) != check:
            raise NotStored
    yield mark
    yield from file.read_rest()


class _BlockReader:
    """Reader of pieces of any length, from bytes that arrive in blocks."""

    def __init__(self, blocks: Iterator[bytes]) -> None:
        self._blocks = blocks
        self._remainder = memoryview(b"")

    def _read_next(self, max_bytes: int) -> memoryview:
        """Return at least one and at most `max_bytes` of the next bytes. Empty at the end of the file."""
        if not self._remainder:
            self._remainder = memoryview(next(self._blocks, b""))
        block, self._remainder = self._remainder[:max_bytes], self._remainder[max_bytes:]
        return block

    def read_up_to(self, count: int) -> bytes:
        """Return the next `count` bytes, or all that are left if there are fewer."""
        data = b""
        while len(data) < count and (piece := self._read_next(count - len(data))):
            data += piece
        return data

    def read_exactly(self, count: int) -> bytes:
        """Return the next `count` bytes. Raises NotStored if fewer are left."""
        data = self.read_up_to(count)
        if len(data) < count:
            raise NotStored
        return data

    def read_crc(self, count: int) -> int:
        """Return the CRC-32 of the next `count` bytes. Raises NotStored if fewer are left."""
        checksum = 0
        while count:
            piece = self._read_next(count)
            if not piece:
                raise NotStored
            checksum, count = compute_crc32(piece, checksum), count - len(piece)
        return checksum

    def read_rest(self) -> Iterator[bytes]:
        """Yield all remaining bytes."""
        yield bytes(self._remainder)
        yield from self._blocks


def _make_directory_entry(form: MemberForm, crc: bytes, offset: int) -> bytes:
    """Return the directory entry of a member. `crc`: the bytes of its CRC-32. `offset`: its position in the file."""
    if offset <= MAX_SHORT_SIZE:
        prefix, suffix, rest = form.entry
        return prefix + crc + suffix + offset.to_bytes(4, "little") + rest
    prefix, suffix = _split_around_field(_make_blank_entry(form.name_bytes, form.flags, form.size, offset), _ENTRY_CRC_OFFSET)
    return prefix + crc + suffix


def _make_blank_entry(name_bytes: bytes, flags: int, size: int, offset: int) -> bytes:
    """Return the directory entry of a member at `offset`, with 0 in place of the CRC-32."""
    longs = [size, size] if size > MAX_SHORT_SIZE else []
    size_field, place = (_LONG_VALUE_MARK if longs else size), offset
    if offset > MAX_SHORT_SIZE:
        longs, place = [*longs, offset], _LONG_VALUE_MARK
    version, extra = (_LONG_VERSION, _make_long_field(*longs)) if longs else (_PLAIN_VERSION, b"")
    return _DIRECTORY_ENTRY.pack(
        b"PK\1\2", version, _SYSTEM_CODE, version, 0, flags, 0, _FIXED_TIME, _FIXED_DATE, 0, size_field, size_field,
        len(name_bytes), len(extra), 0, 0, 0, _FILE_ATTRIBUTES, place,
    ) + name_bytes + extra  # fmt: skip


def _make_end_record(count: int, size: int, offset: int) -> bytes:
    """Return the end record of a zip file. `count`, `size`: the number of entries and bytes of the directory. `offset`: its
    position."""
    records = b""
    if count > MAX_SHORT_COUNT or offset > MAX_SHORT_SIZE or size > MAX_SHORT_SIZE:
        records = _LONG_END_RECORD.pack(b"PK\6\6", 44, _LONG_VERSION, _LONG_VERSION, 0, 0, count, count, size, offset)
        records += _LONG_END_LOCATOR.pack(b"PK\6\7", 0, offset + size, 1)
        count, size, offset = min(count, MAX_SHORT_COUNT), min(size, _LONG_VALUE_MARK), min(offset, _LONG_VALUE_MARK)
    return records + _END_RECORD.pack(b"PK\5\6", 0, 0, count, count, size, offset, 0)


def _make_long_field(*numbers: int) -> bytes:
    """Return the extra field of a header that contains numbers of eight bytes."""
    return Struct(f"<2H{len(numbers)}Q").pack(1, 8 * len(numbers), *numbers)
