"""A shot that was compiled in advance, and a description of the files and lines in which two shots differ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.loading import ParsedFileCache
from antdsl.pipeline import RunChoices, Shot
from antdsl.scene.document import DocumentNode, MappingNode, SequenceNode, decode_source
from antdsl.scene.notes.note_lines import is_note_source
from antdsl.scene.paths import PathRefused, read_user_file
from antdsl.source import Source

_MAX_NAMED_FILES = 3  # files reported by name


@dataclass(frozen=True, slots=True, eq=False)
class PrecompiledShot:
    """A shot, together with all inputs from which it was compiled."""

    shot: Shot
    report: Report
    choices: RunChoices
    replacement_texts: Mapping[Path, str]
    parsed_files: ParsedFileCache

    def is_current(self, choices: RunChoices, replacement_texts: Mapping[Path, str], parsed_files: ParsedFileCache) -> bool:
        """Return whether compiling the scene again would give the same shot. `parsed_files`: the current programs, in which equal
        texts are the same object."""
        return (
            (choices, replacement_texts) == (self.choices, self.replacement_texts)
            and parsed_files.keys() == self.parsed_files.keys()
            and all(parsed_files[place] is known for place, known in self.parsed_files.items())
            and all(_has_unchanged_text(source) for source in iterate_sources(self.shot.scene.document))
            and self._has_same_inputs()
        )

    def _has_same_inputs(self) -> bool:
        """Return whether meshes and other files that the scene names still have the bytes that were read."""
        roots = self.shot.scene.roots
        for name, known in self.shot.inputs.items():
            try:
                place = roots.resolve_path(name)
            except PathRefused:
                continue  # a value set by hand, or a file of the library
            if place.suffix == ".ant" or name in ("antdsl", "scene") or name.startswith(("--set ", "--note ", "set ")):
                continue
            try:
                data = roots.read_file(name, limits.MAX_MESH_BYTES)
            except PathRefused:
                return False  # the file was removed
            if blake2b(data, digest_size=16).hexdigest() != known:
                return False
        return True


def iterate_sources(document: DocumentNode) -> Iterator[Source]:
    """Yield the texts of all files that contribute to a scene, including the scenes that it extends."""
    known_sources: set[Source] = set()
    stack: list[DocumentNode] = [document]
    while stack:
        node = stack.pop()
        if node.span.source not in known_sources and not is_note_source(node.span.source.path):
            known_sources.add(node.span.source)
            yield node.span.source
        if isinstance(node, MappingNode):
            stack += node.entries.values()
        elif isinstance(node, SequenceNode):
            stack += node.items


def _has_unchanged_text(source: Source) -> bool:
    try:
        now, report = decode_source(read_user_file(Path(source.path), limits.MAX_SCENE_BYTES), source.path)
    except PathRefused:
        return False
    return report.ok and now.text == source.text


def describe_changed_files(old_shot: Shot, new_shot: Shot) -> str:
    """Return the files and lines in which two shots differ; "" if none differ.

    An example is `forager.ant line 34, scene.yaml lines 9–12`."""
    old_texts, new_texts = _collect_texts(old_shot), _collect_texts(new_shot)
    differences = [
        _describe_changed_lines(name, old_texts.get(name), text)
        for name, text in new_texts.items()
        if old_texts.get(name) != text
    ]
    others = {name for name in old_shot.inputs.keys() & new_shot.inputs.keys() if old_shot.inputs[name] != new_shot.inputs[name]}
    differences += sorted(name for name in others if name not in new_texts and Path(name).suffix)  # meshes and other files
    differences += [f"{name} was removed" for name in old_texts if name not in new_texts]
    remainder = f" and {len(differences) - _MAX_NAMED_FILES} more" if len(differences) > _MAX_NAMED_FILES else ""
    return ", ".join(differences[:_MAX_NAMED_FILES]) + remainder


def _collect_texts(shot: Shot) -> dict[str, str]:
    scenes = {Path(source.path).name: source.text for source in iterate_sources(shot.scene.document)}
    return {**scenes, **shot.loaded.text_by_name}


def _describe_changed_lines(name: str, old_text: str | None, new_text: str) -> str:
    """Return a file's name with the range of its changed lines."""
    if old_text is None:
        return f"{name} is new"
    old_lines, new_lines = old_text.splitlines(), new_text.splitlines()
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
