"""A shot that was compiled ahead of time, and the changed files and lines between two shots."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.loading import ParsedFileCache
from antdsl.pipeline import RunChoices, Shot
from antdsl.scene.document import DocumentNode, MappingNode, SequenceNode, decode
from antdsl.scene.paths import PathRefused, read_named
from antdsl.source import Source

_MAX_NAMED_FILES = 3  # files reported by name


@dataclass(frozen=True, slots=True, eq=False)
class PrecompiledShot:
    """A shot with all inputs from which it was compiled."""

    shot: Shot
    report: Report
    choices: RunChoices
    instead: Mapping[Path, str]
    parsed: ParsedFileCache

    def is_current(self, choices: RunChoices, instead: Mapping[Path, str], parsed: ParsedFileCache) -> bool:
        """Return whether opening the scene again would give the same shot. `parsed` has the current programs; equal texts give
        identical objects."""
        return (
            (choices, instead) == (self.choices, self.instead)
            and parsed.keys() == self.parsed.keys()
            and all(parsed[place] is known for place, known in self.parsed.items())
            and all(_is_same_text(source) for source in sources(self.shot.scene.document))
            and self._has_same_inputs()
        )

    def _has_same_inputs(self) -> bool:
        """Return whether meshes and other files that the scene names have the same bytes as when they were read."""
        roots = self.shot.scene.roots
        for name, known in self.shot.inputs.items():
            try:
                place = roots.path(name)
            except PathRefused:
                continue  # a value, or a file of the library
            if place.suffix == ".ant" or name in ("antdsl", "scene") or name.startswith(("--set ", "set ")):
                continue
            try:
                data = roots.read(name, limits.MAX_MESH_BYTES)
            except PathRefused:
                return False  # it is gone
            if blake2b(data, digest_size=16).hexdigest() != known:
                return False
        return True


def sources(document: DocumentNode) -> Iterator[Source]:
    """Yield the texts that contain parts of a scene, including those of scenes that it extends."""
    known_sources: set[Source] = set()
    stack: list[DocumentNode] = [document]
    while stack:
        node = stack.pop()
        if node.span.source not in known_sources:
            known_sources.add(node.span.source)
            yield node.span.source
        if isinstance(node, MappingNode):
            stack += node.entries.values()
        elif isinstance(node, SequenceNode):
            stack += node.items


def _is_same_text(source: Source) -> bool:
    try:
        now, report = decode(read_named(Path(source.path), limits.MAX_SCENE_BYTES), source.path)
    except PathRefused:
        return False
    return report.ok and now.text == source.text


def changed_files_text(old: Shot, new: Shot) -> str:
    """Return the files in which two shots differ, with lines; "" if none differs.

    An example is `forager.ant line 34, scene.yaml lines 9–12`."""
    old_texts, new_texts = _texts(old), _texts(new)
    differences = [
        _changed_lines_text(name, old_texts.get(name), text) for name, text in new_texts.items() if old_texts.get(name) != text
    ]
    others = {name for name in old.inputs.keys() & new.inputs.keys() if old.inputs[name] != new.inputs[name]}
    differences += sorted(name for name in others if name not in new_texts and Path(name).suffix)  # meshes and such
    differences += [f"{name} was removed" for name in old_texts if name not in new_texts]
    remainder = f" and {len(differences) - _MAX_NAMED_FILES} more" if len(differences) > _MAX_NAMED_FILES else ""
    return ", ".join(differences[:_MAX_NAMED_FILES]) + remainder


def _texts(shot: Shot) -> dict[str, str]:
    scenes = {Path(source.path).name: source.text for source in sources(shot.scene.document)}
    return {**scenes, **shot.loaded.texts}


def _changed_lines_text(name: str, old: str | None, new: str) -> str:
    """Return a file's name and its range of changed lines."""
    if old is None:
        return f"{name} is new"
    old_lines, new_lines = old.splitlines(), new.splitlines()
    start, most = 0, min(len(old_lines), len(new_lines))
    while start < most and old_lines[start] == new_lines[start]:
        start += 1
    end = 0
    while end < most - start and old_lines[-1 - end] == new_lines[-1 - end]:
        end += 1
    first, last = start + 1, len(new_lines) - end
    if last < first:
        removed_count = len(old_lines) - len(new_lines)
        lines = "line" if removed_count == 1 else "lines"
        return f"{name}: {removed_count} {lines} gone after line {start}" if removed_count else name
    return f"{name} line {first}" if first == last else f"{name} lines {first}–{last}"
