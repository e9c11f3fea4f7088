"""Text → tree: `read` opens a file safely, `parse` makes a `File` of its text. `format` writes a text in the one layout, `write`
puts it in the file's place."""

from antdsl.syntax.formatting import format
from antdsl.syntax.parser import parse
from antdsl.syntax.reading import read, read_bytes
from antdsl.syntax.writing import write

__all__ = ["format", "parse", "read", "read_bytes", "write"]
