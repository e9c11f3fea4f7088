"""Opening files: what is an error and why, and what is corrected on the way."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from antdsl import limits
from antdsl.diagnostics.codes import CODE_DESCRIPTIONS
from antdsl.syntax import parse, read_program_file


def refused(path: Path | str) -> tuple[str, str]:
    source, report = read_program_file(path)
    assert source is None and len(report.errors) == 1
    (error,) = report.errors
    assert error.code in CODE_DESCRIPTIONS and error.help
    return error.code, error.message


def test_a_file_is_read_with_its_name(tmp_path: Path) -> None:
    path = tmp_path / "a.ant"
    path.write_bytes("\ufeffant 1\r\nspecies a { load = 0 }\rspecies b { load = 0 } # é".encode())
    source, report = read_program_file(path)
    assert source is not None and report.ok
    assert source.path == str(path) and source.text == "ant 1\nspecies a { load = 0 }\nspecies b { load = 0 } # é"
    file, report = parse(source)
    assert report.diagnostics == [] and len(file.items) == 2


@pytest.mark.parametrize(
    ("data", "code", "words"),
    [
        (b"ant 1\nspecies \xff {", "not-utf8", "byte 14 is not UTF-8"),
        ("species déjà".encode("latin-1"), "not-utf8", "byte 9"),
        ("ant 1".encode("utf-16"), "not-an-ant-file", "UTF-16"),
        (b"PK\x03\x04rest", "not-an-ant-file", "zip archive"),
        (b"PXR-USDC\0\0", "not-an-ant-file", "USD scene"),
        (b"\x89PNG\r\n", "not-an-ant-file", "picture"),
        (b"ply\nformat ascii 1.0\n", "not-an-ant-file", "mesh"),
        (b"x" * (limits.MAX_PROGRAM_BYTES + 1), "file-too-large", "256 KiB"),
    ],
)
def test_other_files_are_rejected(tmp_path: Path, data: bytes, code: str, words: str) -> None:
    path = tmp_path / "a.ant"
    path.write_bytes(data)
    error_code, message = refused(path)
    assert error_code == code and words in message


def test_the_location_of_an_invalid_byte_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.ant"
    path.write_bytes("ant 1\n# é\nx \xff".encode("latin-1"))
    path.write_bytes(b"ant 1\n# \xc3\xa9\nx \xff")
    _, report = read_program_file(path)
    assert str(report.errors[0].span) == f"{path}:3:3"


def test_largest_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.ant"
    path.write_bytes(b"#" * limits.MAX_PROGRAM_BYTES)
    assert read_program_file(path)[0] is not None


def test_no_file_folder_and_pipe(tmp_path: Path) -> None:
    assert refused(tmp_path / "none.ant") == ("cannot-read", f"cannot read `{tmp_path}/none.ant`: no such file or directory")
    folder = tmp_path / "folder.ant"
    folder.mkdir()
    assert refused(folder) == ("cannot-read", f"`{folder}` is a folder")
    pipe = tmp_path / "pipe.ant"
    os.mkfifo(pipe)
    assert refused(pipe)[1] == f"`{pipe}` is not a regular file"
    assert refused("a\0b.ant")[0] == "cannot-read"
    assert refused("/dev/zero")[1] == "`/dev/zero` is not a regular file"
