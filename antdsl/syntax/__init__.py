"""Reads and formats program text. `read_program_file` opens a file safely, and `parse` makes a `File` of its text. `format`
writes a text in the standard layout, and `write_program_file` replaces a file.

`scan_tokens` makes tokens, `brackets` pairs them, `blocks` divides the text into lines and blocks. Then each line is parsed
separately with lark's tables, so that an error affects only its line. `grammar` makes these tables, and `parse_tables` loads
them. `builder` makes the `nodes`. Messages about mistakes are in `mistakes`; the layout is in `formatting`. For an editor,
`incremental_parser` parses only what changed."""

from pathlib import Path

from antdsl.diagnostics.model import Report
from antdsl.source import Source
from antdsl.syntax.parser import parse
from antdsl.syntax.text_files import decode_program, read_program_file

__all__ = ["decode_program", "format", "parse", "read_program_file", "write"]

# Most callers only parse, so formatting and writing are imported when called.


def format(source: Source) -> tuple[str | None, Report]:
    """Return the text in the standard layout, and the report of parsing; see `formatting.layout.format`."""
    from antdsl.syntax.formatting import layout

    return layout.format(source)


def write(path: Path, text: str) -> None:
    """Replace the file `path` with a text by an atomic write; see `text_files.write`."""
    from antdsl.syntax import text_files

    text_files.write_program_file(path, text)
