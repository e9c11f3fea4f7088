"""Short names of files for the page, which must never receive a path of this machine.

This module also converts positions in texts to UTF-16 units, which browsers use."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from antdsl.diagnostics import Diagnostic
from antdsl.resources import find_library_file
from antdsl.safe_read import read_handle
from antdsl.scene.document import decode_source
from antdsl.syntax import text_files

MAX_SHOWN_TEXT_BYTES = 1 << 20  # of one file that is shown


class FileNames:
    """Short names of files. A file below the scene's folder has its relative path, a library file a name like `<steering>`, and
    any other file its last path component."""

    def __init__(self, scene: Path) -> None:
        self._folder = Path(os.path.realpath(scene)).parent
        self._folder_prefixes = [os.path.join(each, "") for each in (self._folder, scene.parent) if os.path.isabs(each)]
        self._name_by_path: dict[Path, str] = {}

    def get_short_name(self, path: str | Path) -> str:
        """Return the short name of a file. Different files have different names."""
        text = os.fspath(path)
        if text.startswith("<"):
            return text
        real = Path(os.path.realpath(text))
        if real not in self._name_by_path:
            name = real.relative_to(self._folder).as_posix() if real.is_relative_to(self._folder) else real.name
            if is_library_file(real):
                name = f"<{real.stem}>"
            name = name.encode("utf-8", "replace").decode()  # a name need not be text, and what is sent has to be
            taken, number, plain = set(self._name_by_path.values()), 1, name
            while name in taken:
                number += 1
                name = f"{plain} ({number})"
            self._name_by_path[real] = name
        return self._name_by_path[real]

    def make_problem_message(self, diagnostic: Diagnostic) -> dict[str, Any]:
        """Return the message about a finding with its location. The file is null if the finding has no location."""
        fields: dict[str, Any] = {
            "code": diagnostic.code, "severity": diagnostic.severity, "message": self.shorten_paths(diagnostic.message),
            "help": self.shorten_paths(diagnostic.help or ""),
            "file": None, "start": 0, "end": 0, "line": 0, "column": 0,
        }  # fmt: skip
        if diagnostic.span is not None:
            text = diagnostic.span.source.text
            line, column = diagnostic.span.source.find_line_column(diagnostic.span.start)
            fields |= {
                "file": self.get_short_name(diagnostic.span.source.path), "line": line, "column": column,
                "start": count_utf16_units(text[: diagnostic.span.start]),
                "end": count_utf16_units(text[: diagnostic.span.end]),
            }  # fmt: skip
        return fields

    def shorten_paths(self, text: str) -> str:
        """Return a text in which the path of the scene's folder is removed from all file names."""
        for prefix in self._folder_prefixes:
            text = text.replace(prefix, "")
        return text


def is_library_file(path: Path) -> bool:
    """Return whether a file comes with antdsl."""
    library = find_library_file(path.stem) if path.suffix == ".ant" else None
    return library is not None and Path(os.path.realpath(library)) == path


def count_utf16_units(text: str) -> int:
    """Return the length of a text in UTF-16 units, as a browser counts it. Every line end counts as one unit."""
    text = text.replace("\r\n", "\n")
    return len(text) + sum(letter > "\uffff" for letter in text)


def read_file_text(path: Path, open_file: Callable[[Path], int]) -> str | None:
    """Return the text of a program or scene file, even if it has errors; None if there is no such file.

    Line ends are normalized as by the readers of programs and scenes. `open_file`: returns a handle on a regular file, or raises
    OSError."""
    try:
        data = read_handle(open_file(path), MAX_SHOWN_TEXT_BYTES)
    except OSError:
        return None
    source, _ = text_files.decode_program(str(path), data) if path.suffix == ".ant" else decode_source(data, str(path))
    text = source.text if source is not None else data.decode("utf-8", "replace").removeprefix("\ufeff")
    return text.replace("\r\n", "\n").replace("\r", "\n")
