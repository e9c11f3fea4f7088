"""Default values of options, read from the user's file `defaults.toml`. `docs/commands.md` describes this file.

Projects cannot set defaults. Options can grant folders or contact other machines, and a project may come from a stranger.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from antdsl.cli.exits import CommandError, ExitCode

PATH_VARIABLE = "ANTDSL_DEFAULTS"  # names another file; empty: no file
_MAX_FILE_BYTES = 1 << 16
_ADVICE = "write sections of commands with their options, such as:\n[run]\nthreads = 4"


def find_defaults_path() -> Path | None:
    """Return the path of the user's file of defaults, or None if there is none."""
    from antdsl.user_folders import config_folder

    if (named_path := os.environ.get(PATH_VARIABLE)) is not None:
        return Path(named_path) if named_path else None
    try:
        path = config_folder() / "antdsl" / "defaults.toml"
    except OSError:
        return None
    return path if path.is_file() else None


def add_defaults(path: Path, group: Any, words: list[str]) -> list[str]:
    """Return the words of a command line, with the default arguments from a file inserted before the user's own arguments.

    So the user's arguments override the defaults. `group`: Typer's group of all commands. Raises CommandError with the line if
    the file cannot be read, or contains an invalid name or value."""
    arguments_by_command = _read_arguments(path, group)
    place = next((number for number, word in enumerate(words) if word in group.commands), None)
    if place is None:
        return words
    return [*words[: place + 1], *arguments_by_command.get(words[place], ()), *words[place + 1 :]]


def _read_arguments(path: Path, group: Any) -> dict[str, list[str]]:
    """Return the default arguments in a file, by command name."""
    import tomllib

    from antdsl.safe_read import read_size_limited

    try:
        text = read_size_limited(path, _MAX_FILE_BYTES).decode()
        sections = tomllib.loads(text)
    except (OSError, ValueError) as problem:
        reason = getattr(problem, "strerror", None) or str(problem)
        raise CommandError(ExitCode.USAGE, f"error: `{path}` cannot be read: {reason}", _ADVICE) from None
    arguments_by_command: dict[str, list[str]] = {}
    for name, values in sections.items():
        if name not in group.commands or not isinstance(values, dict):
            raise _make_error(path, text, name, "", f"`{name}` is not a command", group.commands)
        options = {flag[2:]: option for option in group.commands[name].params for flag in option.opts if flag.startswith("--")}
        arguments = arguments_by_command[name] = []
        for key, value in values.items():
            if key not in options:
                raise _make_error(path, text, name, key, f"`antdsl {name}` has no option `--{key}`", options)
            option = options[key]
            needed = "`true` or `false`" if option.is_flag else "a list, `[…]`" if option.multiple else "a text or a number"
            types = bool if option.is_flag else list if option.multiple else (str, int, float)
            if not isinstance(value, types) or (isinstance(value, bool) and not option.is_flag):
                raise _make_error(path, text, name, key, f"`{key}` needs {needed}", ())
            if option.is_flag:
                arguments += [f"--{key}"] if value else option.secondary_opts[:1]
            else:
                arguments += [f"--{key}={each}" for each in (value if isinstance(value, list) else [value])]
    return arguments_by_command


def _make_error(path: Path, text: str, section: str, key: str, message: str, names: Iterable[str]) -> CommandError:
    """Return an error about a section of the defaults file, or about a key in it, with its line. `names`: the valid names."""
    from antdsl.diagnostics.suggestion import find_nearest_name

    line_number, is_in_section = 1, False
    for number, line in enumerate(text.splitlines(), 1):
        if re.match(rf"\s*\[?\s*[\"']?{re.escape(section)}[\"']?\s*[\].=]", line):
            line_number, is_in_section = number, True
        if is_in_section and key and re.search(rf"(^|[.\s])[\"']?{re.escape(key)}[\"']?\s*=", line):
            line_number = number
            break
    near = find_nearest_name(key or section, names)
    return CommandError(ExitCode.USAGE, f"error: {path}:{line_number}: {message}", f"did you mean `{near}`?" if near else _ADVICE)


def run_with_defaults(app: Any) -> None:
    """Run the command line of a Typer application, with the user's default arguments if there are any."""
    path = find_defaults_path()
    if path is None:
        app(standalone_mode=True, prog_name="antdsl")
        return
    from typer.main import get_command

    group: Any = get_command(app)
    words = add_defaults(path, group, sys.argv[1:])
    try:
        group(args=words, standalone_mode=True, prog_name="antdsl")
    except SystemExit as leave:
        if leave.code == ExitCode.USAGE and words != sys.argv[1:]:
            print(f"note: some options come from {path}", file=sys.stderr)
        raise
