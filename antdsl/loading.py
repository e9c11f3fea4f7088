"""The loader of program texts: the named programs, and the files that their lines `use steering` and `use "./mine.ant"` name.

Each file is read and parsed once, and its hash is stored for the cache."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from antdsl import limits, syntax
from antdsl.diagnostics import Label, Report
from antdsl.resources import find_library_file
from antdsl.scene.paths import PathRefused, Roots
from antdsl.source import Source, Span
from antdsl.syntax import nodes

if TYPE_CHECKING:
    from antdsl.program.model import Program

ParsedFileCache = dict[str, tuple[nodes.File, Report]]


class SharedParsedFiles(ParsedFileCache):
    """A cache of parsed files, for checking many files that do not change meanwhile.

    `check_results`: the results of checking programs, so that a program that several scenes name is checked once. Each result
    also has the names of the libraries that the program uses.
    """

    def __init__(self) -> None:
        super().__init__()
        self.check_results: dict[tuple[object, ...], tuple[Program, Report, tuple[str, ...]]] = {}


def find_library(name: str) -> nodes.File | None:
    """Return the parsed library file behind `use NAME`, or None if there is none. The same object is returned as long as the
    text of the file does not change."""
    return LoadedSources(Path()).find_library(name)


@lru_cache(maxsize=64)
def _parse_library(name: str, text: str) -> tuple[nodes.File, Report]:
    """Return a parsed library file and its report. The result is cached, because parsing takes longer than checking the few
    parts that most programs use."""
    return syntax.parse(Source(name, text))


@dataclass(slots=True)
class LoadedSources:
    """Programs and the files that they use.

    `module_by_path`: the used files, by the path that `use` names.
    `text_by_name`: all texts, by their path below `folder`; a library file has a name like `<steering>`.
    `parse_cache`: a cache that several LoadedSources may share, so that each file is read once and findings have one location.
    """

    folder: Path
    files: list[nodes.File] = field(default_factory=list)
    module_by_path: dict[str, nodes.File] = field(default_factory=dict)
    text_by_name: dict[str, str] = field(default_factory=dict)
    report: Report = field(default_factory=Report)
    parse_cache: ParsedFileCache = field(default_factory=dict)
    _library_files: dict[str, nodes.File | None] = field(default_factory=dict)
    _module_paths: dict[str, Path] = field(default_factory=dict)
    _total_bytes: int = 0

    def find_library(self, name: str) -> nodes.File | None:
        """Return the parsed library file behind `use NAME`, or None if there is none."""
        if name not in self._library_files:
            path = find_library_file(name)
            self._library_files[name] = None if path is None else self._parse_file(path, f"<{name}>", is_library=True)
        return self._library_files[name]

    def list_library_names(self) -> tuple[str, ...]:
        """Return the names of the library files that programs have requested."""
        return tuple(self._library_files)

    def add_file(self, path: Path) -> nodes.File | None:
        """Add a program that the user has named, and return it; None if it cannot be read. The program may have any path, but
        the files that it uses must be below its folder."""
        file = self._parse_file(path, str(path))
        if file is not None:
            self.files.append(file)
            self._load_used_files(file, Roots(path.resolve().parent), 1, (path.resolve(),))
        return file

    def add_scene_program(self, text: str, roots: Roots, span: Span) -> nodes.File | None:
        """Add a program that a scene names, and return it; None if it cannot be read. It may access the same files as the
        scene."""
        path = self._locate_program(text, roots, span)
        if path is None:
            return None
        file = self._parse_file(path, display_path(path), span, (roots, text))
        if file is not None:
            self.files.append(file)
            self._load_used_files(file, Roots(path.parent, roots.folder_by_name), 1, (path,))
        return file

    def hash_texts(self) -> dict[str, str]:
        """Return a hash of the text of each file, by the name under which the file was read."""
        return {
            name: hashlib.blake2b(text.encode(), digest_size=16).hexdigest() for name, text in sorted(self.text_by_name.items())
        }

    def _make_text_key(self, path: Path) -> str:
        """Return the key of a file's text: the path relative to `folder`, or the full path if the file is not below `folder`."""
        full, folder = path.resolve(), self.folder.resolve()
        return full.relative_to(folder).as_posix() if full.is_relative_to(folder) else full.as_posix()

    def _locate_program(self, text: str, roots: Roots, span: Span) -> Path | None:
        """Return the path of a program that a scene or a `use` line names. If the program cannot be used, report the reason and
        return None."""
        if not text.endswith(".ant"):
            self.report.error("bad-path", f"`{text[:80]}` is not an .ant file", span, "name a file that ends in `.ant`")
            return None
        try:
            roots.measure_file_size(text)
            return roots.resolve_path(text)
        except PathRefused as error:
            self.report.error(error.code, str(error), span, error.help)
            return None

    def _parse_file(
        self,
        path: Path,
        name: str,
        span: Span | None = None,
        origin: tuple[Roots, str] | None = None,
        *,
        is_library: bool = False,
    ) -> nodes.File | None:
        """Return a file in parsed form. If the file cannot be read, report the reason and return None.

        `name`: the display name of a library file. `span`: the location of findings about the file itself. `origin`: the roots
        that may contain the file, and its path there; None for library files and for files that the user has named."""
        place = os.path.realpath(path)
        if place in self.parse_cache:
            file, report = self.parse_cache[place]
        else:
            try:
                source, report = syntax.read_program_file(path, None if origin is None else origin[0].open_file(origin[1]))
            except PathRefused as error:  # it has changed since it was looked for
                self.report.error(error.code, str(error), span, error.help)
                return None
            if source is None:
                self.report.extend(report)
                return None
            file, findings = _parse_library(name, source.text) if is_library else syntax.parse(Source(name, source.text))
            report.extend(findings)
            self.parse_cache[place] = file, report
        source = file.source
        if not is_library:
            self._total_bytes += len(source.text)
            if self._total_bytes > limits.MAX_PROJECT_BYTES:
                self.report.error("too-large", f"the programs together have more than {limits.MAX_PROJECT_BYTES:,} bytes", span)
                return None
        self.text_by_name[name if is_library else self._make_text_key(path)] = source.text
        self.report.extend(report)
        return file

    def _load_used_files(self, file: nodes.File, roots: Roots, depth: int, using_files: tuple[Path, ...]) -> None:
        """Load the files that a file uses. `depth`: the number of nested uses. `using_files`: the chain of files that leads to
        this file by `use` lines."""
        for use in find_use_lines(file):
            if use.path is None:
                continue
            text, span = use.path.text, use.path.span
            if depth > limits.MAX_USE_DEPTH or len(self.module_by_path) >= limits.MAX_USED_FILES:
                self.report.error("too-large", "this program uses too many files", span, "use fewer files")
                return
            path = self._locate_program(text, roots, span)
            if path is None:
                continue
            if path in using_files:
                cycle_text = " -> ".join(p.name for p in (*using_files[using_files.index(path) :], path))
                self.report.error(
                    "use-cycle", f"files use each other in a circle: {cycle_text}", span, "remove one of the `use` lines"
                )
                continue
            known = self.module_by_path.get(text)
            if known is not None:
                if self._module_paths[text] != path:
                    labels = (Label(Span(known.source, 0, 1), "the other file"),)
                    self.report.error(
                        "use-cycle", f"`{text}` names two different files", span, "give one of them another name", labels=labels
                    )
                continue
            module = self._parse_file(path, display_path(path), span, (roots, text))
            if module is not None:
                self.module_by_path[text], self._module_paths[text] = module, path
                self._load_used_files(module, Roots(path.parent, roots.folder_by_name), depth + 1, (*using_files, path))


def find_use_lines(file: nodes.File) -> tuple[nodes.Use, ...]:
    """Return the `use` lines of a file."""
    return tuple(item for item in file.items if isinstance(item, nodes.Use))


def display_path(path: Path) -> str:
    """Return a path for display: relative to the working directory if the path is below it."""
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)
