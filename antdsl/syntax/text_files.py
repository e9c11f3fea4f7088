"""Opens untrusted files without blocking, without exhausting memory and without guessing the encoding. Writes files atomically;
writing follows links and preserves the permissions of an existing file."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from antdsl import limits
from antdsl.atomic_write import atomic_file
from antdsl.diagnostics.model import Report
from antdsl.safe_read import FileTooLargeError, NotRegularFileError, open_regular_file, read_handle
from antdsl.source import Source, Span
from antdsl.syntax.editions import FIRST_LINE

# First bytes of other file formats.
_OTHER_FILE_SIGNATURES = (
    (b"PK\x03\x04", "a zip archive"),
    (b"PXR-USDC", "a USD scene"),
    (b"#usda", "a USD scene"),
    (b"\x89PNG", "a picture"),
    (b"\xff\xd8\xff", "a picture"),
    (b"GIF8", "a picture"),
    (b"%PDF", "a PDF"),
    (b"ply\n", "a mesh"),
    (b"ply\r\n", "a mesh"),
    (b"glTF", "a mesh"),
    (b"\x93NUMPY", "an array"),
    (b"\x7fELF", "a program"),
    (b"\x1f\x8b", "a compressed file"),
    (b"---\n", "YAML"),
    (b"%YAML", "YAML"),
    (b"<?xml", "XML"),
    (b"<!DOCTYPE", "a web page"),
    (b"\xff\xfe", "UTF-16 text"),
    (b"\xfe\xff", "UTF-16 text"),
)


def read_program_file(path: str | os.PathLike[str], handle: int | None = None) -> tuple[Source | None, Report]:
    """Read a `.ant` file. It must be a regular file with at most 256 KiB of UTF-8; a byte order mark is dropped, and line ends
    become LF. `handle`: the file descriptor if the file is already open. It is closed.

    Returns None, and a report with the reason, if the file cannot be read. Never raises an exception, whatever `path` names."""
    report = Report()
    name = os.fspath(path)
    data = _read_file(name, handle, report)
    if data is None:
        return None, report
    return decode_program(name, data)


def decode_program(name: str, data: bytes) -> tuple[Source | None, Report]:
    """Decode the bytes of a program by the rules of `read_program_file`. Returns None and errors if that is impossible.

    `name`: the name of the program in messages."""
    report = Report()
    if len(data) > limits.MAX_PROGRAM_BYTES:
        _report_too_large(name, report)
        return None, report
    for magic, kind in _OTHER_FILE_SIGNATURES:
        if data.startswith(magic):
            report.error("not-an-ant-file", f"`{name}` looks like {kind}", None, _suggest_regular_file(kind))
            return None, report
    text = _decode_text(name, data, report)
    if text is None:
        return None, report
    return Source(name, text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")), report


def _suggest_regular_file(kind: str) -> str:
    return "save it as UTF-8" if kind.startswith("UTF-16") else f"name a text file that begins with `{FIRST_LINE}`"


def _read_file(name: str, handle: int | None, report: Report) -> bytes | None:
    if "\0" in name:
        report.error("cannot-read", "file name contains a null character", None, "name a `.ant` file")
        return None
    try:
        return read_handle(open_regular_file(name) if handle is None else handle, limits.MAX_PROGRAM_BYTES)
    except FileTooLargeError:
        _report_too_large(name, report)
    except NotRegularFileError as why:
        report.error("cannot-read", f"`{name}` is {why.kind}", None, "name a `.ant` file")
    except OSError as error:
        reason = (error.strerror or "unknown reason").lower()
        report.error("cannot-read", f"cannot read `{name}`: {reason}", None, "check the name, and whether you may read the file")
    return None


def _report_too_large(name: str, report: Report) -> None:
    max_kib = limits.MAX_PROGRAM_BYTES // limits.KIB
    help = 'split the file, and bring in the parts with `use "./part.ant" as part`'
    report.error("file-too-large", f"`{name}` is larger than {max_kib} KiB", None, help)


def _decode_text(name: str, data: bytes, report: Report) -> str | None:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        display_source = Source(name, data.decode("utf-8", errors="replace"))
        place = len(data[: error.start].decode("utf-8"))
        message = f"byte {error.start} is not UTF-8 text"
        help = "save the file as UTF-8 in your editor"
        report.error("not-utf8", message, Span(display_source, place, place + 1), help)
        return None


def write_program_file(path: Path, text: str) -> None:
    """Replace the content of an existing file by a text, with an atomic write. Readers see either the old or the new text, even
    after a crash. Raises OSError if writing fails; the old file is then unchanged."""
    place = path.resolve(strict=True)
    if not os.access(place, os.W_OK):
        # the folder allows a replacement, but the file itself is read-only
        raise PermissionError(13, "permission denied", str(path))
    with atomic_file(place) as file:
        if os.chmod in os.supports_fd:  # before it has content
            os.chmod(file.fileno(), stat.S_IMODE(place.stat().st_mode))
        file.write(text.encode("utf-8"))
