"""Reads an agent definition from a definition file in JSON, a glTF file or a USD file. All agents of a kind share the definition.

Definitions are cached as long as their files stay the same, because a preview opens its scene at every edit.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

from antdsl.bodies.agents.definition import Definition, with_language_names
from antdsl.bodies.files.definition_checks import Parts, check_definition
from antdsl.bodies.files.named_files import GLTF, USD, BodyFiles, file_ending
from antdsl.diagnostics import Report
from antdsl.scene.paths import RequestedPaths, Roots, record_request, record_sought, reopen
from antdsl.source import Span

MOST = 8  # number of cached definitions
Stamp = tuple[int, ...]


def read_definition(
    path: Path | str, roots: Roots | None = None, place: Span | None = None, *, prim: str = "", rate: float = 0.0
) -> tuple[Definition | None, Report]:
    """Return the definition in a .json, .glb, .gltf or USD file, or None, with the report.

    `path`: a `Path` was named by the user; its folder is the root of files that it names, unless `roots` is given. A text was
        named by a file at `place`, and lies below `roots`.
    `prim`: the prim of a USD file to read.
    `rate`: approximate samples per second of animations; 0 is the file's own frame rate, or 30.
    """
    report = Report()
    if isinstance(path, Path):
        text = path.name
        roots = roots or Roots(path.resolve().parent)
        files = BodyFiles(roots, report, named={text: path})
        display_path = str(path)
    else:
        text = display_path = path
        folder = text[: max(text.rfind("/"), text.find(":")) + 1]
        files = BodyFiles(roots or Roots(Path.cwd()), report, folder)
        text = text[len(folder) :]
    if files.is_closed_format(display_path, place):
        return None, report
    kind = file_ending(display_path)
    name = text.rpartition(".")[0] or "body"
    if kind in GLTF or kind in USD:
        definition = files.body(text, place, prim, rate)
        if definition is None:
            return None, report
        return check_definition(Parts(definition, span=place, measured=not definition.length), report), report
    if kind != "json":
        kinds = ", ".join(f".{each}" for each in ("json", *GLTF, *USD))
        report.error("wrong-kind", f"`{display_path[-80:]}` is no file of a body", place, f"one of {kinds} is read")
        return None, report
    from antdsl.bodies.files.definition_document import read_document  # imported late: most commands read no definition

    root = files.read_part(text, "a definition", place)
    parts = None if root is None else read_document(root, files, name)
    return (None if parts is None else check_definition(parts, report)), report


@dataclass(frozen=True, slots=True, eq=False)
class CachedDefinition:
    """A definition, and the files that it was read from: for each path, its root and its stamp (size, time and file number)."""

    definition: Definition
    files: dict[Path, tuple[Path | None, Stamp]]


_cached: OrderedDict[tuple[object, ...], CachedDefinition] = OrderedDict()


def load_definition(text: str, roots: Roots, place: Span) -> tuple[Definition | None, Report]:
    """Return the result of `read_definition` for a path in a scene, with names in the spelling of the language. A definition that
    was read without findings is cached."""
    key = (text, str(roots.folder), *((name, str(folder)) for name, folder in sorted(roots.granted.items())))
    known = _cached.get(key)
    if known is not None and all(_stamp(path, root) == stamp for path, (root, stamp) in known.files.items()):
        _cached.move_to_end(key)
        for path, (root, _) in known.files.items():
            record_request(path, root)
        return known.definition, Report()
    with record_sought() as files:
        definition, report = read_definition(text, roots, place)
    definition = None if definition is None else with_language_names(definition)
    _cached.pop(key, None)
    stamps = _file_stamps(files)
    if definition is not None and not report.sorted() and all(stamp is not None for _, stamp in stamps.values()):
        _cached[key] = CachedDefinition(
            definition, {path: (root, stamp) for path, (root, stamp) in stamps.items() if stamp is not None}
        )
        while len(_cached) > MOST:
            _cached.popitem(last=False)
    return definition, report


def _file_stamps(files: RequestedPaths) -> dict[Path, tuple[Path | None, Stamp | None]]:
    """Return the root and the current stamp of each file that was read."""
    return {path: (root, _stamp(path, root)) for path, root in files.items()}


def _stamp(path: Path, root: Path | None) -> Stamp | None:
    """Return a stamp that changes when a file changes, or None if there is no file."""
    try:
        handle = reopen(path, root)
    except OSError:
        return None
    try:
        status = os.fstat(handle)
    finally:
        os.close(handle)
    return status.st_size, status.st_mtime_ns, status.st_ino, status.st_ctime_ns
