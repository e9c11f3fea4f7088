"""Where results are to go is tried before the work begins, so that hours of it are not lost to a name that cannot be written."""

from __future__ import annotations

import os
from pathlib import Path

import typer

from antdsl.cli.exits import Exit, Stop
from antdsl.whole import new_beside


def file_to_write(path: Path | None, flag: str) -> None:
    """Leave with words about `flag` where no file can be put at a path; None is fine. Nothing is left behind, and a file that is
    there stays as it is."""
    if path is None:
        return
    if path.is_dir():
        raise typer.BadParameter(f"`{path}` is a folder; name a file", param_hint=flag)
    if path.exists() and not path.is_file():
        raise typer.BadParameter(f"`{path}` is no regular file", param_hint=flag)
    if not path.absolute().parent.is_dir():
        raise typer.BadParameter(f"there is no folder `{path.parent}`", param_hint=flag)
    _try(path, path, flag)


def folder_to_write(path: Path | None, flag: str, *names: str) -> None:
    """The same for files of some names in a folder that is made where it is not there."""
    if path is None:
        return
    there = next(each for each in (path.absolute(), *path.absolute().parents) if os.path.lexists(each))
    if not there.is_dir():
        raise Stop(Exit.INPUT_OUTPUT, f"error: `{there}` is a file, and a folder is wanted there", f"name another with `{flag}`")
    for name in names:
        if (path / name).is_dir():
            words = f"error: `{path / name}` is a folder, and a file is to be put there"
            raise Stop(Exit.INPUT_OUTPUT, words, f"name another folder with `{flag}`")
    _try(there / "antdsl", path, flag)


def _try(beside: Path, path: Path, flag: str) -> None:
    try:
        new_beside(beside).unlink()
    except OSError as why:
        words = f"error: cannot write `{path}`: {(why.strerror or str(why)).lower()}"
        raise Stop(Exit.INPUT_OUTPUT, words, f"name another place with `{flag}`") from None
