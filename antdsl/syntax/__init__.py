"""Reads and formats program text. `read_program_file` opens a file safely, and `parse` makes a `File` of its text. `format`
returns a text in the standard layout, and `write_program_file` replaces a file.

Parsing has these steps. `scan_tokens` makes tokens, `brackets` pairs brackets, and `blocks` divides the text into lines and
blocks. Each line is then parsed separately with lark's tables, so that an error affects only its line. `grammar` makes these
tables, and `parse_tables` loads them. `builder` makes the `nodes`. The other parts are `mistakes`, which explains errors,
`formatting`, and `incremental_parser`, which parses only what changed, for an editor."""

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
    """Replace the content of the file `path` by a text, with an atomic write; see `text_files.write`."""
    from antdsl.syntax import text_files

    text_files.write_program_file(path, text)
