"""The files of an editing session. Open documents override the files on disk. They are checked in the same way as by `antdsl
check`."""

from __future__ import annotations

import os
import re
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

from antdsl import limits, syntax
from antdsl.diagnostics import Diagnostic, Report
from antdsl.diagnostics.ignore_comments import apply_ignore_comments
from antdsl.files import find_files
from antdsl.loading import ParsedFileCache
from antdsl.lsp.names import NameOccurrence, ProgramNames, collect_names, find_occurrences
from antdsl.lsp.scenes import SceneIndex, build_scene_index
from antdsl.lsp.text import DocumentText, TextRange, normalise_line_ends
from antdsl.pipeline import check_scene_text, compile_files
from antdsl.program.memo import CheckResultCache
from antdsl.program.names.bindings import NameBindings
from antdsl.safe_read import resolve_path
from antdsl.source import Source, Span
from antdsl.syntax import nodes
from antdsl.syntax.incremental_parser import IncrementalParser

if TYPE_CHECKING:
    from antdsl.program.model import Program
    from antdsl.scene import Scene

PROGRAM_SUFFIX = ".ant"
NO_BINDINGS = NameBindings()
_MAX_OCCURRENCES_AT_OFFSET = 8  # maximum number of symbols that one word can refer to
# keys that occur in scenes and in few other files
_SCENE_KEY_PATTERN = re.compile(r"^(?:antdsl|crowd|extends)[ \t]*:", re.MULTILINE)


@dataclass(frozen=True)
class NameIndex:
    """The names of a document in text order, and the offset at which each starts."""

    occurrences: list[NameOccurrence]
    start_offsets: list[int]

    @cached_property
    def meaning_by_offset(self) -> dict[int, tuple[str, bool]]:
        """Return, by the start offset of each word, the kind of its symbol, and whether the symbol is declared by this word."""
        pairs = zip(reversed(self.start_offsets), reversed(self.occurrences), strict=True)
        return {start: (str(each.key[0]), each.is_declaration) for start, each in pairs}


@dataclass(eq=False)
class OpenDocument:
    """A file in its current state, as open in the editor or as on disk.

    - `find_bindings`: a function that returns the bindings of the file and of all files that it uses.
    - `file_stamp`: two numbers that identify the version of the file on disk; None for an open buffer.
    - `version`: the version number that the editor gave to an open buffer.
    - `last_valid_scene`: the names in the last valid text of the scene. They are used while the text is not valid YAML."""

    path: Path
    text: DocumentText
    find_bindings: Callable[[Path], NameBindings]
    file_stamp: tuple[int, int] | None = None
    version: int | None = None
    last_valid_scene: SceneIndex | None = None  # index of the previous text, used while this text is not valid YAML
    parser: IncrementalParser = field(default_factory=IncrementalParser)  # parses successive versions of an open buffer
    _cached_index: tuple[NameBindings, NameIndex] | None = None

    @property
    def is_program(self) -> bool:
        """Return whether the file is a program; otherwise it is a scene."""
        return self.path.suffix == PROGRAM_SUFFIX

    @cached_property
    def parsed(self) -> tuple[nodes.File, Report]:
        """Return the parsed program and its syntax errors."""
        return self.parser.parse(Source(str(self.path), self.text.text))

    @cached_property
    def names(self) -> ProgramNames:
        """Return the names that the program declares."""
        return collect_names(self.path, self.parsed[0])

    @cached_property
    def used_files(self) -> list[Path]:
        """Return the files that the program names in its `use "PATH"` lines."""
        paths = (item.path for item in self.parsed[0].items if isinstance(item, nodes.Use))
        return [resolve_path(self.path.parent.joinpath(path.text)) for path in paths if path is not None]

    @property
    def index(self) -> NameIndex:
        """Return the index of the document's names. It is rebuilt when a new check has changed the bindings."""
        bindings = self.find_bindings(self.path) if self.is_program else NO_BINDINGS
        if self._cached_index is None or self._cached_index[0] is not bindings:
            name_occurrences = find_occurrences(self.names, bindings) if self.is_program else self.scene.occurrences
            name_occurrences = sorted(name_occurrences, key=lambda occurrence: self.find_start(occurrence.span))
            self._cached_index = bindings, NameIndex(name_occurrences, [self.find_start(each.span) for each in name_occurrences])
        return self._cached_index[1]

    @property
    def occurrences(self) -> list[NameOccurrence]:
        """Return all names in the document, in text order."""
        return self.index.occurrences

    @cached_property
    def scene(self) -> SceneIndex:
        """Return the names of the scene. While its text is invalid YAML, its files and items are those of the last valid text."""
        index = build_scene_index(self.path, self.text.text)
        if index.document is None and self.last_valid_scene is not None:
            index.files, index.items, index.fps = (
                self.last_valid_scene.files,
                self.last_valid_scene.items,
                self.last_valid_scene.fps,
            )
        return index

    def find_start(self, span: Span) -> int:
        """Return the start offset of a span in this document's text."""
        return self._find_file_span(span).start

    def find_end(self, span: Span) -> int:
        """Return the end offset of a span in this document's text."""
        return self._find_file_span(span).end

    def _find_file_span(self, span: Span) -> Span:
        """Convert a span in a separately parsed part of a program to a span in the complete file."""
        return self.parsed[0].file_span(span) if self.is_program else span

    def find_range(self, span: Span) -> TextRange:
        """Return the start and the end of a span as lines and columns."""
        return self.text.find_range(self.find_start(span), self.find_end(span))

    def find_occurrences(self, offset: int) -> list[NameOccurrence]:
        """Return the names at an offset. Names that start at the offset or contain it come before names that end there."""
        index = self.index
        name_occurrences: list[NameOccurrence] = []
        for number in range(bisect_right(index.start_offsets, offset) - 1, -1, -1):
            each = index.occurrences[number]
            if self.find_end(each.span) < offset or len(name_occurrences) > _MAX_OCCURRENCES_AT_OFFSET:
                break
            name_occurrences.insert(0, each)
        return sorted(name_occurrences, key=lambda occurrence: self.find_end(occurrence.span) == offset)

    def find_word_at(self, offset: int) -> tuple[int, int]:
        """Return the start and end offsets of the word at an offset."""
        text, start, end = self.text.text, offset, offset
        while start > 0 and (text[start - 1].isalnum() or text[start - 1] == "_"):
            start -= 1
        while end < len(text) and (text[end].isalnum() or text[end] == "_"):
            end += 1
        return start, end


@dataclass(frozen=True, slots=True)
class DocumentCheck:
    """The result of checking a document. `program`, `scene`: the checked program or scene; None if errors prevented it."""

    program: Program | None
    scene: Scene | None
    report: Report


@dataclass(eq=False)
class Workspace:
    """All files of the session. `roots`: the folders that the editor has opened. `open_documents`: the open documents by real
    path."""

    roots: list[Path] = field(default_factory=list)
    encoding: str = "utf-16"
    open_documents: dict[Path, OpenDocument] = field(default_factory=dict)
    _disk_documents: dict[Path, OpenDocument] = field(default_factory=dict)
    _check_by_path: dict[Path, tuple[object, DocumentCheck]] = field(default_factory=dict)
    _last_good_programs: dict[Path, Program] = field(default_factory=dict)
    _check_memos: dict[Path, CheckResultCache] = field(default_factory=dict)
    _file_search: tuple[float, list[Path]] = (0.0, [])  # time until which the list is valid, and the files

    # --- documents ---

    def put_document(self, path: Path, text: str, version: int | None = None) -> OpenDocument:
        """Add an open buffer, or replace the text of an existing one."""
        document = self.open_documents[path] = OpenDocument(
            path, DocumentText(normalise_line_ends(text), self.encoding), self.find_bindings, None, version
        )
        return document

    def change_document(self, path: Path, text: DocumentText, version: int | None) -> OpenDocument:
        """Replace the text of an open buffer after an edit."""
        previous_document = self.open_documents.get(path)
        earlier = previous_document.scene if previous_document is not None and not previous_document.is_program else None
        parts = previous_document.parser if previous_document is not None else IncrementalParser()
        document = self.open_documents[path] = OpenDocument(path, text, self.find_bindings, None, version, earlier, parts)
        return document

    def close_document(self, path: Path) -> None:
        """Remove an open buffer. From then on, the file on disk is used."""
        self.open_documents.pop(path, None)
        self._check_by_path.pop(path, None)
        self._last_good_programs.pop(path, None)
        self._check_memos.pop(path, None)

    def find_document(self, path: Path) -> OpenDocument | None:
        """Return a file as it is open in the editor, or else as it is on disk. Return None if it cannot be read."""
        open_document = self.open_documents.get(path)
        if open_document is not None:
            return open_document
        try:
            status = os.stat(path)
        except (OSError, ValueError):
            self._disk_documents.pop(path, None)
            return None
        stamp = (status.st_mtime_ns, status.st_size)
        stored = self._disk_documents.get(path)
        if stored is None or stored.file_stamp != stamp:
            source, _ = syntax.read_program_file(path)
            if source is None:
                return None
            stored = self._disk_documents[path] = OpenDocument(
                path, DocumentText(source.text, self.encoding), self.find_bindings, stamp
            )
        return stored

    def locate_span(self, span: Span) -> tuple[OpenDocument, TextRange] | None:
        """Return the document that contains a span, and the lines and columns of the span; None if the document cannot be
        read."""
        for document in (*self.open_documents.values(), *self._disk_documents.values()):
            if document.is_program and "parsed" in document.__dict__:
                file = document.parsed[0]
                if span.source is file.source or span.source in file.parts:
                    return document, document.find_range(span)
        named_document = self.find_document(Path(os.path.realpath(span.source.path)))
        return (named_document, named_document.find_range(span)) if named_document is not None else None

    # --- checking ---

    def check_document(self, path: Path) -> DocumentCheck | None:
        """Return the result of checking a document; None if there is no document.

        The result is cached until the document, or a file that it depends on, changes."""
        document = self.find_document(path)
        if document is None:
            return None
        stored = self._check_by_path.get(path)
        if stored is not None and stored[0] == self._find_dependency_state(path):
            return stored[1]
        result = self._check_program(document) if document.is_program else self._check_scene(document)
        if result.program is not None and result.report.ok:
            self._last_good_programs[path] = result.program
        self._check_by_path[path] = (self._find_dependency_state(path), result)
        return result

    def _find_dependency_state(self, path: Path) -> object:
        """Return a value that changes whenever the document or one of its dependencies changes."""
        return [(each, self.find_document(each)) for each in self.find_linked_files(path)]

    def find_bindings(self, path: Path) -> NameBindings:
        """Return the resolved names of a program, even if parts of its text are invalid."""
        result = self.check_document(path)
        return NO_BINDINGS if result is None or result.program is None else result.program.bindings

    def find_last_good_program(self, path: Path) -> Program | None:
        """Return the program from the document's last check without errors; None if there was no such check. It answers queries
        while the text is edited."""
        result = self.check_document(path)
        return self._last_good_programs.get(path) or (result.program if result is not None else None)

    def find_parsed_files(self, path: Path) -> ParsedFileCache:
        """Return the cache of parsed files that the checks use. Documents that are open in the editor replace files on disk."""
        programs: ParsedFileCache = {}
        for each in {*self.open_documents, *self.find_linked_files(path), *self._list_libraries()}:
            document = self.find_document(each)
            if document is not None and document.is_program:
                file, report = document.parsed
                programs[str(each)] = (file, report)
        return programs

    def _list_libraries(self) -> list[Path]:
        from antdsl.resources import behaviours_folder

        return [Path(os.path.realpath(path)) for path in behaviours_folder().glob("*.ant")]

    def _check_program(self, document: OpenDocument) -> DocumentCheck:
        """Check a program with all files that it uses."""
        # a text that was parsed completely shares nothing with the previous text, which may return
        has_parts = document.path in self.open_documents and document.parsed[0].parts
        memo = self._check_memos.setdefault(document.path, CheckResultCache()) if has_parts else None
        program, report = compile_files([document.path], parsed=self.find_parsed_files(document.path), memo=memo)
        return DocumentCheck(program, None, report)

    def _check_scene(self, document: OpenDocument) -> DocumentCheck:
        """Check a scene with its programs."""
        texts = {each.path: each.text.text.encode("utf-8", "surrogatepass") for each in (document, *self.open_documents.values())}
        texts = {path: data for path, data in texts.items() if path.suffix != PROGRAM_SUFFIX}
        scene, program, report = check_scene_text(document.path, texts, parsed=self.find_parsed_files(document.path))
        return DocumentCheck(program, scene, report)

    def find_diagnostics(self, path: Path) -> list[Diagnostic]:
        """Return the findings in this document. A finding about the complete document has no span. A YAML file that is not a
        scene has no findings. Editors send every YAML file to the server."""
        document = self.find_document(path)
        if document is not None and not document.is_program and not _SCENE_KEY_PATTERN.search(document.text.text):
            return []
        result = self.check_document(path)
        if result is None:
            return []
        document, own_path = self.find_document(path), str(path)
        diagnostics = [
            d for d in result.report.sort_by_place() if d.span is None or os.path.realpath(d.span.source.path) == own_path
        ]
        if document is None:
            return diagnostics
        return apply_ignore_comments(
            Report(diagnostics), [Source(own_path, document.text.text)], has_no_errors=result.report.ok, meshes_checked=False
        ).sort_by_place()

    # --- which files belong together ---

    def find_linked_files(self, path: Path) -> list[Path]:
        """Return a file, the files that it names, and all files named in those."""
        paths: dict[Path, None] = {}
        stack = [path]
        while stack:
            each = stack.pop()
            if each in paths or len(paths) > limits.MAX_USED_FILES:
                continue
            paths[each] = None
            document = self.find_document(each)
            if document is not None:
                stack += document.used_files if document.is_program else document.scene.files
        return list(paths)

    def find_related_files(self, path: Path) -> list[Path]:
        """Return all files that may refer to names of this file. They are linked to it by `use` or by a common scene."""
        links = {each: set(self.find_linked_files(each)) for each in self.list_files()}
        links.setdefault(path, set(self.find_linked_files(path)))
        members = set(links[path]) | {path}
        has_grown = True
        while has_grown:
            has_grown = False
            for linked in links.values():
                if linked & members and not linked <= members:
                    members |= linked
                    has_grown = True
        return sorted(members)

    def find_extending_scenes(self, path: Path) -> list[Path]:
        """Return a scene, its base scenes, and all scenes that extend one of them."""
        linked_files = {
            each: {p for p in self.find_linked_files(each) if p.suffix != PROGRAM_SUFFIX}
            for each in self.list_files()
            if each.suffix != PROGRAM_SUFFIX
        }
        own_files = linked_files.get(path, {p for p in self.find_linked_files(path) if p.suffix != PROGRAM_SUFFIX})
        others = {each for each, linked in linked_files.items() if linked & own_files} | own_files
        return [path, *sorted(others - {path})]

    def find_scenes_using(self, path: Path) -> list[Path]:
        """Return the open scenes that use the program at `path`, and the open scenes that extend the scene at `path`."""
        return [each for each in self.open_documents if each != path and path in self.find_linked_files(each)]

    def list_files(self) -> list[Path]:
        """Return the programs and scenes below the editor's folders, and all open ones.

        The folders are not searched at every request. A result is valid for twenty times the duration of its search, or until
        the editor reports a change."""
        time = monotonic()
        if time >= self._file_search[0]:
            paths, _ = find_files(root for root in self.roots if root.is_dir())
            real = [Path(os.path.realpath(each)) for each in paths]
            self._file_search = (monotonic() + 20 * (monotonic() - time), real)
        return list(dict.fromkeys([*self.open_documents, *self._file_search[1]]))

    def invalidate_file_list(self) -> None:
        """Discard the cached lists of files, because files may have been added or removed."""
        self._file_search = (0.0, [])
