"""Words to the terminal from commands that do more than talk: where whoever reads them has had enough, the work goes on."""

from __future__ import annotations

import os
import sys
from typing import TextIO

import typer


def say(words: str = "", *, err: bool = False, newline: bool = True) -> None:
    """Print, as far as anybody reads it."""
    try:
        typer.echo(words, err=err, nl=newline)
    except BrokenPipeError:
        closed(sys.stderr if err else sys.stdout)


def closed(stream: TextIO) -> None:
    """Nobody reads what is printed any more: what comes goes nowhere. Python would complain again when it flushes at exit."""
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())
