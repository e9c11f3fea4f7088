"""Text → tree: `read` opens a file safely, `parse` makes a `File` of its text."""

from antdsl.syntax.parser import parse
from antdsl.syntax.reading import read

__all__ = ["parse", "read"]
