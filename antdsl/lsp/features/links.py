"""Links from a document to the files that it names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from antdsl.lsp.workspace import OpenDocument
from antdsl.safe_read import resolve_path
from antdsl.source import Span
from antdsl.syntax import nodes


class FileLink(NamedTuple):
    """A piece of text that names an existing file."""

    span: Span
    path: Path


def find_links(document: OpenDocument) -> Iterator[FileLink]:
    """Yield links for the file names in a program or a scene. Names of missing files give no link."""
    for link in _list_program_links(document) if document.is_program else _list_scene_links(document):
        if link.path.is_file():
            yield link


def _list_program_links(document: OpenDocument) -> Iterator[FileLink]:
    """Yield links to the files of `use` lines, and to the scenes of specs."""
    folder = document.path.parent
    for item in document.parsed[0].items:
        if isinstance(item, nodes.Use):
            if item.path is not None:
                yield FileLink(item.path.span, resolve_path(folder / item.path.text))
            elif item.library is not None and (path := document.names.libraries.get(item.library.text)) is not None:
                yield FileLink(item.library.span, path.resolve())
        elif isinstance(item, nodes.Spec) and item.scene is not None:
            yield FileLink(item.scene.span, resolve_path(folder / item.scene.text))


def _list_scene_links(document: OpenDocument) -> Iterator[FileLink]:
    """Yield links to the programs, meshes and other files that a scene names."""
    for name in document.scene.occurrences:
        if name.key[0] == "file":
            yield FileLink(name.span, Path(str(name.key[1])))
