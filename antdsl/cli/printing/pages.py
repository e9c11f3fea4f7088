"""Display of documentation pages, such as the page of a diagnostic code. They are formatted on a terminal, and plain Markdown
elsewhere."""

from __future__ import annotations

import sys

from antdsl.cli.printing.messages import print_result
from antdsl.diagnostics.codes import CODE_DESCRIPTIONS
from antdsl.resources import find_code_page


def print_code_page(code: str) -> None:
    """Print the documentation page of a diagnostic code. If the pages are not installed, print the code's one-line meaning."""
    path = find_code_page(code)
    print_markdown(f"# {code}\n\n{CODE_DESCRIPTIONS[code]}\n" if path is None else path.read_text(encoding="utf-8"))


def print_markdown(text: str) -> None:
    """Print Markdown text, formatted if the output is a terminal."""
    if not sys.stdout.isatty():
        print_result(text.rstrip("\n"))
        return
    from rich.console import Console
    from rich.markdown import Markdown

    Console(highlight=False).print(Markdown(text, code_theme="ansi_dark"))
