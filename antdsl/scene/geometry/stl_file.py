"""Reads .stl files, binary or text, as triangles in which corners at equal positions are merged."""

from __future__ import annotations

import re
import struct

import numpy as np

from antdsl import limits
from antdsl.scene.geometry import mesh_text
from antdsl.scene.geometry.arrays import convert_to_float64
from antdsl.scene.geometry.import_notes import ImportNotes
from antdsl.scene.geometry.matrices import find_distinct_points
from antdsl.scene.geometry.polygons import PolygonMesh

_BINARY_HEADER_BYTES, _BYTES_PER_BINARY_FACE = 84, 50  # bytes before the first face, and bytes per face
_BEFORE_SOLID_PATTERN = re.compile(rb"\A(?:\xef\xbb\xbf)?(?:\s|#[^\r\n]*[\r\n])*")
_MISSING_PART_MESSAGE = "is not a .stl file, or a part of it is missing"


def read_stl(data: bytes, notes: ImportNotes) -> PolygonMesh:
    """Return the triangles of a file. Raises MeshError with the reason."""
    corners = _read_text_corners(data, notes) if _is_text(data) else _read_binary_corners(data, notes)
    wrong = np.flatnonzero(~np.isfinite(corners).all(axis=1))
    if len(wrong):
        raise mesh_text.MeshError(f"has a corner (of face {wrong[0] // 3}) that is not a finite point")
    order, new, which = find_distinct_points(corners)
    return PolygonMesh.from_triangles(corners[order[new]], which.reshape(-1, 3))


def _is_text(data: bytes) -> bool:
    """Return whether a file is text. A binary file may also begin with `solid`, but contains bytes that do not occur in text."""
    if (
        len(data) >= _BINARY_HEADER_BYTES
        and len(data) == _BINARY_HEADER_BYTES + _BYTES_PER_BINARY_FACE * struct.unpack_from("<I", data, 80)[0]
    ):
        return False
    head = data[: 64 * limits.KIB]
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        mesh_text.check_text(head)
    solid = _BEFORE_SOLID_PATTERN.sub(b"", head, count=1)[:5].lower() == b"solid"
    return solid and b"\0" not in head and b"facet" in head.lower()


def _read_binary_corners(data: bytes, notes: ImportNotes) -> mesh_text.Floats:
    notes.form = "binary .stl"
    if len(data) < _BINARY_HEADER_BYTES:
        raise mesh_text.MeshError(_MISSING_PART_MESSAGE)
    count = int(struct.unpack_from("<I", data, 80)[0])
    rest = len(data) - _BINARY_HEADER_BYTES - _BYTES_PER_BINARY_FACE * count
    if rest < 0:
        capacity = (len(data) - _BINARY_HEADER_BYTES) // _BYTES_PER_BINARY_FACE
        raise mesh_text.MeshError(
            f"{_MISSING_PART_MESSAGE}: it says it has {count:,} faces, and {capacity:,} fit in its {len(data):,} bytes"
        )
    mesh_text.check_count(count, limits.MAX_MESH_FACES, "faces")
    tail = data[len(data) - rest :]
    is_padding = not tail.strip(b"\0 \n\r\t\x1a")
    if rest >= _BYTES_PER_BINARY_FACE and rest % _BYTES_PER_BINARY_FACE == 0 and not is_padding:
        raise mesh_text.MeshError(f"says it has {count:,} faces, and has {count + rest // _BYTES_PER_BINARY_FACE:,}")
    if not is_padding:
        notes.count_skipped(f"{rest:,} bytes after the last face")
    rows = np.frombuffer(
        data, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("pad", "<u2")]), count, _BINARY_HEADER_BYTES
    )
    return convert_to_float64(rows["corners"].reshape(-1, 3))


_FACET_LINE, _VERTEX_LINE, _FACET_END_LINE, _LOOP_LINE, _SOLID_LINE, _OTHER_LINE = range(6)
_LINE_KIND_BY_KEYWORD = {
    b"facet": _FACET_LINE, b"vertex": _VERTEX_LINE, b"endfacet": _FACET_END_LINE, b"outer": _LOOP_LINE, b"endloop": _LOOP_LINE,
    b"solid": _SOLID_LINE,
    b"endsolid": _SOLID_LINE,
}  # fmt: skip


def _read_text_corners(data: bytes, notes: ImportNotes) -> mesh_text.Floats:
    notes.form = "text .stl"
    corners, kinds, numbers, last = [np.empty((0, 3))], [np.empty(0, np.int64)], [np.empty(0, np.int64)], 0
    for block in mesh_text.read_blocks(mesh_text.normalise_text(data)):
        letters = block.find_line_keywords()
        kind = np.full(len(block), _OTHER_LINE)
        for word, code in _LINE_KIND_BY_KEYWORD.items():
            kind[letters == word] = code
        vertex = kind == _VERTEX_LINE
        short = np.flatnonzero(vertex & (block.word_counts < 4))
        if len(short):
            raise mesh_text.MeshError(f"has a corner of fewer than three numbers in line {block.line_numbers[short[0]]:,}")
        corners.append(block.read_floats(block.first_words[vertex][:, None] + np.arange(1, 4), "a corner"))
        if (kind == _OTHER_LINE).any():
            _check_unknown_lines(
                block.line_numbers,
                kind,
                [mesh_text.format_word(b" ".join(block.get_line_words(int(k)))) for k in np.flatnonzero(kind == _OTHER_LINE)],
                notes,
            )
        used = (kind != _LOOP_LINE) & (kind != _SOLID_LINE) & (kind != _OTHER_LINE)
        kinds.append(kind[used])
        numbers.append(block.line_numbers[used])
        last = int(block.line_numbers[-1]) if len(block) else last
        mesh_text.check_count(sum(map(len, corners)) // 3, limits.MAX_MESH_FACES, "faces")
    _check_facets(np.concatenate(kinds), np.concatenate(numbers), last)
    return np.concatenate(corners)


def _check_unknown_lines(number: mesh_text.Integers, kind: mesh_text.Integers, words: list[str], notes: ImportNotes) -> None:
    """Raise MeshError for an unknown line within a facet. Add notes about unknown lines elsewhere."""
    others = np.flatnonzero(kind == _OTHER_LINE)
    opened = np.cumsum((kind == _FACET_LINE).astype(np.int64) - (kind == _FACET_END_LINE))
    for place, text in zip(others.tolist(), words, strict=True):
        if opened[place] > 0:
            raise mesh_text.MeshError(f"has a line {number[place]:,} that is not understood: `{text}`")
        notes.count_skipped(f"an invalid line: `{text}`", 1, int(number[place]))


def _check_facets(kinds: mesh_text.Integers, numbers: mesh_text.Integers, last: int) -> None:
    """Raise MeshError unless the lines are a repetition of: facet, three corners, end of facet."""
    expected_kinds = np.resize(np.array([_FACET_LINE, _VERTEX_LINE, _VERTEX_LINE, _VERTEX_LINE, _FACET_END_LINE]), len(kinds))
    wrong = np.flatnonzero(kinds != expected_kinds)
    if not len(wrong):
        if len(kinds) % 5:
            raise mesh_text.MeshError(f"ends in line {last:,} with a facet without three corners: a part of it is missing")
        return
    k = int(wrong[0])
    if expected_kinds[k] == _FACET_LINE and kinds[k] == _VERTEX_LINE:
        raise mesh_text.MeshError(f"has a corner outside of a facet in line {numbers[k]:,}")
    k += int((kinds[k:] != _VERTEX_LINE).argmax())
    raise mesh_text.MeshError(f"has a facet without three corners before line {numbers[k]:,}")
