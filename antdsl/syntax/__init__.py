"""Text → tree: `read` opens a file safely, `parse` makes a `File` of its text, `format` writes the text in the one layout."""

from antdsl.syntax.formatting import format
from antdsl.syntax.parser import parse
from antdsl.syntax.reading import read

__all__ = ["format", "parse", "read"]
