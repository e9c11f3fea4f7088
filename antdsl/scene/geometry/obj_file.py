"""Reads Wavefront .obj files: vertices, and the polygons of all groups or of one group. Other geometry is counted, not read."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.geometry import mesh_text
from antdsl.scene.geometry.import_notes import ImportNotes
from antdsl.scene.geometry.polygons import PolygonMesh

# Keywords without geometry: names, materials, and numbers that belong to vertices.
_IGNORED_KEYWORDS = frozenset(
    b"vn vt g o s mg usemtl mtllib usemap maplib shadow_obj trace_obj lod bevel c_interp d_interp".split()
)
_SKIPPED_ELEMENT_NAMES = {b"l": "lines", b"p": "points", b"curv": "curves", b"curv2": "curves", b"surf": "surfaces"}
_FREE_FORM_KEYWORDS = frozenset(b"vp cstype deg bmat step parm trim hole scrv sp end con stech ctech bzp bsp cdc cdp res".split())


def read_obj(data: bytes, notes: ImportNotes, group: str | None = None) -> PolygonMesh:
    """Return the vertices and polygons of a file. Raises MeshError with the reason if this fails.

    `group`: the name of the only group or object to read; None for all."""
    notes.form = "Wavefront .obj"
    mesh_text.check_text(data)
    reader = _ObjReader(notes, group)
    for block in mesh_text.read_blocks(mesh_text.normalise_text(data, wavefront=True)):
        reader.read_block(block)
    return reader.make_mesh()


@dataclass(slots=True)
class _ObjReader:
    """The state of reading a file block by block.

    `group`: the only group or object to read; None for all.
    `points`: arrays of positions. `vertex_indices`: the vertex of each corner of the polygons. `corner_counts`, `polygon_lines`:
    the number of corners and the line of each polygon.
    `vertex_count`, `corner_count`: the totals so far. `group_names`: the groups and objects of the file."""

    notes: ImportNotes
    group: str | None
    points: list[mesh_text.Floats] = field(default_factory=list)
    vertex_indices: list[mesh_text.Integers] = field(default_factory=list)
    corner_counts: list[mesh_text.Integers] = field(default_factory=list)
    polygon_lines: list[mesh_text.Integers] = field(default_factory=list)
    vertex_count: int = 0
    corner_count: int = 0
    group_names: dict[str, None] = field(default_factory=dict)
    is_in_group: bool = False
    is_in_object: bool = False

    def read_block(self, block: mesh_text.TextBlock) -> None:
        """Read the lines of a block."""
        kind = block.find_line_keywords()
        vertex, face = kind == b"v", (kind == b"f") | (kind == b"fo")
        vertex_counts = self.vertex_count + np.cumsum(vertex)
        if vertex.any():
            self._read_vertices(block.line_numbers[vertex], block.first_words[vertex], block.word_counts[vertex], block)
        within = np.ones(len(block), np.bool_) if self.group is None else self._select_group_lines(block, kind)
        chosen = face & within
        if chosen.any():
            self._read_faces(block, np.flatnonzero(chosen), vertex_counts[chosen])
        rest = within & ~(vertex | face | (kind == b"vn") | (kind == b"vt"))
        for k in np.flatnonzero(rest).tolist():
            word = block.get_line_words(k)[0].lower()
            if word in _IGNORED_KEYWORDS:
                continue
            line = int(block.line_numbers[k])
            if word in _SKIPPED_ELEMENT_NAMES:
                self.notes.count_skipped(f"{_SKIPPED_ELEMENT_NAMES[word]} (`{word.decode()}`)", 1, line)
            elif word in _FREE_FORM_KEYWORDS:
                self.notes.count_skipped("free-form geometry", 1, line)
            else:
                self.notes.count_skipped(f"unknown keyword `{mesh_text.format_word(word)}`", 1, line)

    def _read_vertices(
        self, number: mesh_text.Integers, first: mesh_text.Integers, count: mesh_text.Integers, block: mesh_text.TextBlock
    ) -> None:
        short = np.flatnonzero(count < 4)
        if len(short):
            raise mesh_text.MeshError(f"has a vertex of fewer than three numbers in line {number[short[0]]:,}")
        self.vertex_count += len(first)
        mesh_text.check_count(self.vertex_count, mesh_text.MAX_VERTICES, "vertices")
        self.points.append(block.read_floats(first[:, None] + np.arange(1, 4), "a vertex"))

    def _read_faces(self, block: mesh_text.TextBlock, lines: mesh_text.Integers, vertex_counts: mesh_text.Integers) -> None:
        count = block.word_counts[lines] - 1
        number = block.line_numbers[lines]
        short = np.flatnonzero(count < 3)
        if len(short):
            raise mesh_text.MeshError(f"has a face of fewer than three corners in line {number[short[0]]:,}")
        self.corner_count += int(count.sum())
        mesh_text.check_count(self.corner_count // 3, limits.MAX_MESH_FACES, "faces")
        within = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        at = np.repeat(block.first_words[lines] + 1, count) + within
        index, is_integer = block.read_integers(at, slash=True)
        wrong = np.flatnonzero(~is_integer | (index == 0))
        if len(wrong):
            word = mesh_text.format_word(block.words[at[wrong[0]]])
            line = block.find_line_number(int(at[wrong[0]]))
            raise mesh_text.MeshError(f"has a corner `{word}` that is no vertex number in line {line:,}")
        back = np.repeat(vertex_counts, count)
        absent = np.flatnonzero(index < -back)
        if len(absent):
            raise mesh_text.MeshError(_describe_missing_vertex(int(index[absent[0]]), block.find_line_number(int(at[absent[0]]))))
        self.vertex_indices.append(np.where(index < 0, back + index, index - 1))
        self.corner_counts.append(count)
        self.polygon_lines.append(number)

    def _select_group_lines(self, block: mesh_text.TextBlock, kind: NDArray[np.bytes_]) -> NDArray[np.bool_]:
        """Return whether each line of a block belongs to the requested group or object."""
        is_chosen = np.zeros(len(block), np.bool_)
        begin = 0
        for k in np.flatnonzero((kind == b"g") | (kind == b"o")).tolist():
            is_chosen[begin:k] = self.is_in_group or self.is_in_object
            words = [word.decode("utf-8", "replace") for word in block.get_line_words(k)[1:]]
            if kind[k] == b"g":
                words = words or ["default"]
                self.is_in_group = self.group in words
            else:
                words = [" ".join(words)]
                self.is_in_object = self.group == words[0]
            if len(self.group_names) < 1000:
                self.group_names.update(dict.fromkeys(word[:60] for word in words[:100]))
            begin = k
        is_chosen[begin:] = self.is_in_group or self.is_in_object
        return is_chosen

    def make_mesh(self) -> PolygonMesh:
        """Return the mesh of all lines that have been read."""
        if self.group is not None and not self.corner_counts:
            raise mesh_text.MeshError(_describe_missing_group(self.group, list(self.group_names)), None)
        points = np.concatenate(self.points) if self.points else np.empty((0, 3))
        indices = np.concatenate(self.vertex_indices) if self.vertex_indices else np.empty(0, np.int64)
        counts = np.concatenate(self.corner_counts) if self.corner_counts else np.empty(0, np.int64)
        absent = np.flatnonzero(indices >= len(points))
        if len(absent):
            face = int(np.searchsorted(np.cumsum(counts), absent[0], side="right"))
            raise mesh_text.MeshError(
                _describe_missing_vertex(int(indices[absent[0]]) + 1, int(np.concatenate(self.polygon_lines)[face]))
            )
        return PolygonMesh(points, counts, indices)


def _describe_missing_vertex(vertex: int, line: int) -> str:
    return f"names the missing vertex {vertex} in line {line:,}"


def _describe_missing_group(group: str, names: list[str]) -> str:
    from antdsl.diagnostics.suggestion import find_nearest_name

    if group in names:
        return f"has no faces in its group `{group}`"
    near = find_nearest_name(group, names)
    hint = f"did you mean `{near}`?" if near else "it has " + (", ".join(f"`{n[:40]}`" for n in names[:8]) or "no groups")
    return f"has no group `{group[:60]}`: {hint}"
