"""Zip files of parts are what `zipfile` writes, to the byte, and are read where sizes need eight bytes; they are written whole
however few bytes the system takes at once."""

from __future__ import annotations

import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from antdsl.atomic_write import write_atomically
from antdsl.outputs.cache import npz, zip_parts
from antdsl.outputs.cache.zip_parts import NotStored, StoredFile, make_member_form, make_stored_file, read_headers

MEMBERS = [
    ("frame.npy", b"head", np.int64(7).tobytes()), ("P.npy", b"a head of its own", bytes(range(256)) * 40),
    ("nothing.npy", b"head", b""), ("größe.npy", b"", b"x"), ("clips.ant.main.turns.npy", b"h", b"\0" * 999),
]  # fmt: skip


def build_zip(count: int = len(MEMBERS)) -> StoredFile:
    return make_stored_file((make_member_form(name, head, len(rest)), memoryview(rest)) for name, head, rest in MEMBERS[:count])


def parts() -> list[bytes | memoryview]:
    return list(build_zip().parts)


def cut(data: bytes, most: int) -> list[bytes]:
    return [data[k : k + most] for k in range(0, len(data), most)]


@pytest.mark.parametrize("count", range(len(MEMBERS) + 1))
def test_a_file_is_that_of_zipfile(count: int) -> None:
    expected = io.BytesIO()
    with zipfile.ZipFile(expected, "w", zipfile.ZIP_STORED) as file:
        for name, head, rest in MEMBERS[:count]:
            with file.open(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), "w") as member:
                member.write(head)
                member.write(rest)
    assert b"".join(build_zip(count).parts) == expected.getvalue()


@pytest.mark.parametrize("limit", [0, 30, 5000, 20000])
def test_what_is_longer_than_four_bytes_tell_is_read(limit: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zip_parts, "MAX_SHORT_SIZE", limit)
    monkeypatch.setattr(zip_parts, "MAX_SHORT_COUNT", 3 if limit else 1 << 16)
    with zipfile.ZipFile(io.BytesIO(b"".join(parts()))) as file:
        assert file.testzip() is None and file.namelist() == [name for name, _, _ in MEMBERS]
        assert all(file.read(name) == head + rest for name, head, rest in MEMBERS)


@pytest.mark.parametrize("limit", [0, 30, None])
@pytest.mark.parametrize("most", [1, 3, 64, 1 << 20])
def test_headers_are_read_from_blocks_of_any_length(limit: int | None, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    if limit is not None:
        monkeypatch.setattr(zip_parts, "MAX_SHORT_SIZE", limit)
    for count in range(len(MEMBERS) + 1):
        file = build_zip(count)
        data = b"".join(file.parts)
        assert b"".join(read_headers(iter(cut(data, most)))) == b"".join(file.headers)
        assert len(data) == sum(map(len, file.headers)) + sum(len(head) + len(rest) for _, head, rest in MEMBERS[:count])


def test_who_knows_the_headers_sees_every_bit_that_differs_and_every_cut() -> None:
    file = make_stored_file((make_member_form(name, head, len(rest[:40])), memoryview(rest[:40])) for name, head, rest in MEMBERS)
    data, headers = b"".join(file.parts), b"".join(file.headers)

    def has_change(other: bytes) -> bool:
        try:
            return b"".join(read_headers(iter(cut(other, 100)))) != headers
        except NotStored:
            return True

    assert not has_change(data)
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        assert has_change(bytes(changed)), bit
    assert all(has_change(data[:length]) for length in range(len(data))) and has_change(data + b"x")


def test_the_rest_of_a_member_is_not_copied() -> None:
    array = np.arange(10)
    npz_data = npz.make_npz_file({"a": array})
    assert any(isinstance(part, memoryview) and np.shares_memory(np.frombuffer(part, np.uint8), array) for part in npz_data.parts)


@pytest.mark.parametrize("part_size", [1, 7, 300, None])
@pytest.mark.parametrize("most", [1, 3, 1000])
def test_parts_are_written_whole(part_size: int | None, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`part_size`: bytes that the system takes at once; None where it takes no parts."""
    monkeypatch.setattr("antdsl.atomic_write._PARTS_PER_WRITE", most)
    if part_size is None:
        monkeypatch.delattr(os, "writev", raising=False)
    else:
        monkeypatch.setattr(os, "writev", lambda file, buffers: os.write(file, b"".join(buffers)[:part_size]), raising=False)
    write_atomically(tmp_path / "a.npz", parts(), sync=True)
    assert (tmp_path / "a.npz").read_bytes() == b"".join(parts())
    write_atomically(tmp_path / "a.npz", b"shorter", sync=False)
    assert (tmp_path / "a.npz").read_bytes() == b"shorter" and [p.name for p in tmp_path.iterdir()] == ["a.npz"]
