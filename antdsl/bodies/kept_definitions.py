"""Agent definitions that were read, kept as long as their files stay as they are: a preview opens its scene at every edit."""

from __future__ import annotations

import os
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.reading import read_definition
from antdsl.bodies.agents.spoken import spoken
from antdsl.diagnostics import Report
from antdsl.scene.paths import Roots, Sought, note, open_again, sought
from antdsl.source import Span

MOST = 8  # definitions kept
Stamp = tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A definition with all files that it was read from: the root of each, and what its size, time and number were."""

    definition: Definition
    files: dict[Path, tuple[Path | None, Stamp]]


_kept: OrderedDict[tuple[object, ...], Kept] = OrderedDict()


def definition_at(text: str, roots: Roots, place: Span) -> tuple[Definition | None, Report]:
    """As `read_definition` of a path that a scene names, with names as the language writes them; one that was read before
    without a complaint is not read again."""
    key = (text, str(roots.folder), *((name, str(folder)) for name, folder in sorted(roots.granted.items())))
    known = _kept.get(key)
    if known is not None and all(_stamp(path, root) == stamp for path, (root, stamp) in known.files.items()):
        _kept.move_to_end(key)
        for path, (root, _) in known.files.items():
            note(path, root)
        return known.definition, Report()
    with sought() as files:
        found, report = read_definition(text, roots, place)
    found = None if found is None else spoken(found)
    _kept.pop(key, None)
    stamps = _stamps(files)
    if found is not None and not report.sorted() and all(stamp is not None for _, stamp in stamps.values()):
        _kept[key] = Kept(found, {path: (root, stamp) for path, (root, stamp) in stamps.items() if stamp is not None})
        while len(_kept) > MOST:
            _kept.popitem(last=False)
    return found, report


def _stamps(files: Sought) -> dict[Path, tuple[Path | None, Stamp | None]]:
    return {path: (root, _stamp(path, root)) for path, root in files.items()}


def _stamp(path: Path, root: Path | None) -> Stamp | None:
    """What tells that a file was changed; None where it is not there."""
    try:
        handle = open_again(path, root)
    except OSError:
        return None
    try:
        told = os.fstat(handle)
    finally:
        os.close(handle)
    return told.st_size, told.st_mtime_ns, told.st_ino, told.st_ctime_ns
