"""Reads an agent definition from a JSON definition file, a glTF file or a USD file.

Definitions are cached until their files change, because a preview opens its scene again at every edit."""

from __future__ import annotations

import os
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

from antdsl.bodies.agents.definition import Definition, use_language_names
from antdsl.bodies.files.definition_checks import LocatedDefinition, check_definition
from antdsl.bodies.files.named_files import GLTF_ENDINGS, USD_ENDINGS, BodyFiles, get_file_ending
from antdsl.diagnostics import Report
from antdsl.scene.paths import RequestedPaths, Roots, record_request, record_requested_paths, reopen_file
from antdsl.source import Span

MAX_CACHED_DEFINITIONS = 8  # number of cached definitions
FileStamp = tuple[int, ...]


def read_definition(
    path: Path | str, roots: Roots | None = None, place: Span | None = None, *, prim: str = "", rate: float = 0.0
) -> tuple[Definition | None, Report]:
    """Return the definition in a .json, .glb, .gltf or USD file, and the report. The definition is None after an error.

    `path`: a `Path` is a file that the user named. The files to which it refers must be in its folder, unless `roots` is given.
    A text is a path below `roots` that a scene names at `place`.
    `prim`: the prim of a USD file to read.
    `rate`: approximate samples per second of animations; 0 is the file's own frame rate, or 30."""
    report = Report()
    if isinstance(path, Path):
        text = path.name
        roots = roots or Roots(path.resolve().parent)
        files = BodyFiles(roots, report, path_by_text={text: path})
        display_path = str(path)
    else:
        text = display_path = path
        folder = text[: max(text.rfind("/"), text.find(":")) + 1]
        files = BodyFiles(roots or Roots(Path.cwd()), report, folder)
        text = text[len(folder) :]
    if files.is_closed_format(display_path, place):
        return None, report
    kind = get_file_ending(display_path)
    name = text.rpartition(".")[0] or "body"
    if kind in GLTF_ENDINGS or kind in USD_ENDINGS:
        definition = files.read_body(text, place, prim, rate)
        if definition is None:
            return None, report
        return check_definition(LocatedDefinition(definition, span=place, needs_length=not definition.length), report), report
    if kind != "json":
        kinds = ", ".join(f".{each}" for each in ("json", *GLTF_ENDINGS, *USD_ENDINGS))
        report.error(
            "wrong-kind", f"`{display_path[-80:]}` is not a body file", place, f"use a file of one of these types: {kinds}"
        )
        return None, report
    from antdsl.bodies.files.definition_document import read_document  # imported late: most commands read no definition

    root = files.read_part(text, "a definition", place)
    parts = None if root is None else read_document(root, files, name)
    return (None if parts is None else check_definition(parts, report)), report


@dataclass(frozen=True, slots=True, eq=False)
class CachedDefinition:
    """A definition, and the files that it was read from.

    `files`: for each path, its root and its stamp: size, times and inode number, which show whether the file has changed."""

    definition: Definition
    files: dict[Path, tuple[Path | None, FileStamp]]


_definition_cache: OrderedDict[tuple[object, ...], CachedDefinition] = OrderedDict()


def load_definition(text: str, roots: Roots, place: Span) -> tuple[Definition | None, Report]:
    """Return the results of `read_definition` for a path in a scene, with names converted to the spelling of the language.

    A definition without findings is cached."""
    key = (text, str(roots.folder), *((name, str(folder)) for name, folder in sorted(roots.folder_by_name.items())))
    known = _definition_cache.get(key)
    if known is not None and all(_compute_stamp(path, root) == stamp for path, (root, stamp) in known.files.items()):
        _definition_cache.move_to_end(key)
        for path, (root, _) in known.files.items():
            record_request(path, root)
        return known.definition, Report()
    with record_requested_paths() as files:
        definition, report = read_definition(text, roots, place)
    definition = None if definition is None else use_language_names(definition)
    _definition_cache.pop(key, None)
    stamps = _compute_file_stamps(files)
    if definition is not None and not report.sort_by_place() and all(stamp is not None for _, stamp in stamps.values()):
        _definition_cache[key] = CachedDefinition(
            definition, {path: (root, stamp) for path, (root, stamp) in stamps.items() if stamp is not None}
        )
        while len(_definition_cache) > MAX_CACHED_DEFINITIONS:
            _definition_cache.popitem(last=False)
    return definition, report


def _compute_file_stamps(files: RequestedPaths) -> dict[Path, tuple[Path | None, FileStamp | None]]:
    """Return the root and the current stamp of each file that was read."""
    return {path: (root, _compute_stamp(path, root)) for path, root in files.items()}


def _compute_stamp(path: Path, root: Path | None) -> FileStamp | None:
    """Return the size, times and inode number of a file, which show whether it has changed; None if it cannot be opened."""
    try:
        handle = reopen_file(path, root)
    except OSError:
        return None
    try:
        status = os.fstat(handle)
    finally:
        os.close(handle)
    return status.st_size, status.st_mtime_ns, status.st_ino, status.st_ctime_ns
