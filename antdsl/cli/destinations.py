"""Checks of output paths, made before the work begins.

Output must be writable, so that hours of work are not lost, and must not overwrite any input."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, redirect_stdout
from pathlib import Path
from typing import TextIO

import typer

from antdsl.atomic_write import create_sibling_file, write_atomically
from antdsl.cli.exits import CommandError, ExitCode


def require_writable_file(path: Path | None, flag: str) -> None:
    """Exit with a message about `flag` if no file can be written to `path`. Do nothing if `path` is None. The check leaves no
    file behind and does not change existing files."""
    if path is None or is_standard_output(path) or _is_same_file(path, Path(os.devnull)):
        return
    if path.is_dir():
        raise typer.BadParameter(f"`{path}` is a folder; name a file", param_hint=flag)
    if path.exists() and not path.is_file():
        raise typer.BadParameter(f"`{path}` is not a regular file", param_hint=flag)
    if not path.absolute().parent.is_dir():
        raise typer.BadParameter(f"there is no folder `{path.parent}`", param_hint=flag)
    _require_writable(path, path, flag)


def is_standard_output(path: Path | None) -> bool:
    """Return whether a path means standard output, which is written as `-`."""
    return path is not None and str(path) in ("-", "/dev/stdout")


@contextmanager
def redirect_messages(*paths: Path | None) -> Iterator[TextIO]:
    """Redirect printed messages to standard error if one of these output paths is standard output. Yield the real standard
    output, for `write_result`."""
    output = sys.stdout
    with redirect_stdout(sys.stderr) if any(map(is_standard_output, paths)) else nullcontext():
        yield output


def write_result(path: Path | None, data: bytes, output: TextIO) -> None:
    """Write a result to `path` atomically, to `output` if `path` means standard output, or nowhere if `path` is None."""
    if path is None or _is_same_file(path, Path(os.devnull)):
        return
    if not is_standard_output(path):
        write_atomically(path, data)
        return
    output.flush()
    output.buffer.write(data)
    output.buffer.flush()


def choose_default_path(base: Path, *names: str, flag: str = "--out") -> Path:
    """Return the default output path of a command without the flag `flag`: `base` with `names` appended.

    Exit if one of `names` is a link, because a link could lead anywhere. Only the user may choose such a path."""
    from antdsl.atomic_write import find_first_link

    link = find_first_link(base, *names)
    if link is not None:
        words = f"error: `{link}` is a link, and results only follow links that you name"
        raise CommandError(ExitCode.INPUT_OUTPUT, words, f"name its target, or another path, with `{flag}`")
    return base.joinpath(*names)


def require_writable_folder(path: Path | None, flag: str, *names: str) -> None:
    """Exit with a message about `flag` if files called `names` cannot be written in a folder. A missing folder is created."""
    if path is None:
        return
    existing_parent = next(each for each in (path.absolute(), *path.absolute().parents) if os.path.lexists(each))
    if not existing_parent.is_dir():
        message = f"error: `{existing_parent}` is a file, but a folder is needed there"
        raise CommandError(ExitCode.INPUT_OUTPUT, message, f"name another with `{flag}`")
    for name in names:
        if (path / name).is_dir():
            words = f"error: `{path / name}` is a folder, but a file is needed there"
            raise CommandError(ExitCode.INPUT_OUTPUT, words, f"name another folder with `{flag}`")
    _require_writable(existing_parent / "antdsl", path, flag)


@contextmanager
def protect_inputs(
    files: Mapping[str, Path | None], folders: Mapping[str, tuple[Path | None, Iterable[str]]] | None = None
) -> Iterator[list[Path]]:
    """Exit if an output would overwrite another output or an input. Inputs are the files that are read while the context is
    active, those in the yielded list, and those that come with antdsl.

    `files`: the output files, by their flags.
    `folders`: the output folders by their flags, with the names of files that are written there.
    """
    from antdsl.resources import behaviours_folder
    from antdsl.scene.paths import record_requested_paths

    named_inputs: list[Path] = []
    with record_requested_paths() as sought_files:
        yield named_inputs
    inputs = [*named_inputs, *sought_files, *behaviours_folder().glob("*.ant")]
    results = {flag: path for flag, path in files.items() if path is not None and not _is_same_file(path, Path(os.devnull))}
    for flag, path in results.items():
        if not is_standard_output(path) and any(_is_same_file(path, each) for each in inputs):
            raise typer.BadParameter(f"`{path}` is an input and would be lost; name another file", param_hint=flag)
        others = [other for other in results if other != flag and _is_same_destination(path, results[other])]
        if others:
            raise typer.BadParameter(f"`{path}` is named by `{others[0]}` too; name another file", param_hint=flag)
    for flag, (folder, names) in (folders or {}).items():
        result_names = set(names)
        lost_files = (
            []
            if folder is None
            else [each for each in inputs if each.exists() and _find_first_name_below(each, folder) in result_names]
        )
        if lost_files:
            words = f"error: `{lost_files[0]}` is an input and would be lost"
            raise CommandError(ExitCode.USAGE, words, f"name another folder with `{flag}`")
        for other, path in results.items():
            if folder is not None and _find_first_name_below(path, folder) in result_names:
                raise typer.BadParameter(f"`{path}` is also a result of `{flag}`; name another file", param_hint=other)


def _is_same_file(path: Path, other: Path) -> bool:
    """Return whether two paths lead to the same existing file."""
    try:
        return os.path.samefile(path, other)
    except (OSError, ValueError):
        return False


def _is_same_destination(path: Path, other: Path) -> bool:
    """Return whether output to the two paths would go to the same file or stream."""
    return (
        (is_standard_output(path) and is_standard_output(other))
        or _is_same_file(path, other)
        or os.path.realpath(path) == os.path.realpath(other)
    )


def _find_first_name_below(path: Path, folder: Path) -> str | None:
    """Return the first component of `path` below `folder`, or None if `path` is not in `folder`."""
    real_path, start = Path(os.path.realpath(path)), os.path.realpath(folder)
    return real_path.relative_to(start).parts[0] if real_path != Path(start) and real_path.is_relative_to(start) else None


def _require_writable(probe_path: Path, path: Path, flag: str) -> None:
    """Exit with a message about `flag` if no file can be created next to `probe_path`. The message mentions `path` instead."""
    try:
        create_sibling_file(probe_path).unlink()
    except OSError as error:
        words = f"error: cannot write `{path}`: {(error.strerror or str(error)).lower()}"
        advice = "free space, or " if error.errno in (errno.ENOSPC, errno.EDQUOT) else ""
        raise CommandError(ExitCode.INPUT_OUTPUT, words, f"{advice}name another path with `{flag}`") from None
