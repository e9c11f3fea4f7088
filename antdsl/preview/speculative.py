"""A shot that was made ahead of time, and whether it is still what the files would give."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.loading import Parsed
from antdsl.pipeline import Choices, Shot
from antdsl.scene.document import MappingNode, Node, SequenceNode, decode
from antdsl.scene.paths import PathRefused, read_named
from antdsl.source import Source


@dataclass(frozen=True, slots=True, eq=False)
class Foreseen:
    """A shot with all that it was made of."""

    shot: Shot
    report: Report
    choices: Choices
    instead: Mapping[Path, str]
    parsed: Parsed

    def holds(self, choices: Choices, instead: Mapping[Path, str], parsed: Parsed) -> bool:
        """Whether the same would come out again. `parsed` has the programs as they are now: same objects for same texts."""
        return (
            (choices, instead) == (self.choices, self.instead)
            and parsed.keys() == self.parsed.keys()
            and all(parsed[place] is known for place, known in self.parsed.items())
            and all(_same_text(source) for source in sources(self.shot.scene.document))
            and self._same_inputs()
        )

    def _same_inputs(self) -> bool:
        """Whether meshes and whatever else the scene names have the bytes that were read."""
        roots = self.shot.scene.roots
        for name, known in self.shot.inputs.items():
            try:
                place = roots.path(name)
            except PathRefused:
                continue  # a value, or a file of the library
            if place.suffix == ".ant" or name in ("antdsl", "scene") or name.startswith(("--set ", "set ")):
                continue
            try:
                data = roots.read(name, limits.MESH_BYTES)
            except PathRefused:
                return False  # it is gone
            if blake2b(data, digest_size=16).hexdigest() != known:
                return False
        return True


def sources(document: Node) -> Iterator[Source]:
    """The texts that parts of a scene stand in: one that is extended is among them."""
    found: set[Source] = set()
    stack: list[Node] = [document]
    while stack:
        node = stack.pop()
        if node.span.source not in found:
            found.add(node.span.source)
            yield node.span.source
        if isinstance(node, MappingNode):
            stack += node.entries.values()
        elif isinstance(node, SequenceNode):
            stack += node.items


def _same_text(source: Source) -> bool:
    try:
        now, report = decode(read_named(Path(source.path), limits.SCENE_BYTES), source.path)
    except PathRefused:
        return False
    return report.ok and now.text == source.text
