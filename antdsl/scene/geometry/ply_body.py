"""Reads the bodies of .ply files, text or binary, into one column per property. Each count is compared with the size of the
remaining file."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.geometry.arrays import convert_to_float64
from antdsl.scene.geometry.import_notes import ImportNotes
from antdsl.scene.geometry.mesh_text import MeshError, TextBlock, format_word, normalise_text, read_blocks
from antdsl.scene.geometry.ply import HeaderError, PlyElement, PlyHeader, read_header
from antdsl.scene.geometry.polygons import PolygonMesh, split_triangle_strips

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_INDEX_PROPERTY_NAMES = ("vertex_indices", "vertex_index", "vertexindices", "vertex_indexes")
_TOO_SHORT_MESSAGE = "is shorter than its header says"


@dataclass(frozen=True, slots=True, eq=False)
class PlyColumn:
    """The values of one property for all elements of one kind, in the order of the file.

    `counts`: for a list property, the number of values of each element."""

    values: NDArray[Any]
    counts: Integers | None = None


ColumnByName = Mapping[str, PlyColumn]


def read_ply(data: bytes, notes: ImportNotes) -> PolygonMesh:
    """Return the vertices and polygons of a file. Triangle strips are split into triangles. Raises HeaderError or MeshError with
    the reason."""
    header = read_header(data)
    notes.form = {"": "text", "<": "binary", ">": "binary (big-endian)"}[header.byte_order] + " .ply"
    named = {e.name.lower(): e for e in reversed(header.elements)}
    vertex, face, strips = (named.get(word) for word in ("vertex", "face", "tristrips"))
    requested_names: dict[int, Collection[str]] = {}
    if vertex is None or not any(e is not None and e.count for e in (face, strips)):
        raise HeaderError("has no faces")
    axes = {p.name.lower(): p.name for p in vertex.properties if not p.length_type}
    if not {"x", "y", "z"} <= axes.keys():
        raise HeaderError("has vertices without x, y and z")
    requested_names[id(vertex)] = [axes[axis] for axis in "xyz"]
    lists = {id(e): _find_corner_property(e) for e in (face, strips) if e is not None and e.count}
    requested_names |= {key: [name] for key, name in lists.items()}
    for element in header.elements:
        if element.count and id(element) not in requested_names:
            notes.count_skipped(f"element `{format_word(element.name.encode())}` ({element.count:,})")
    element_columns = read_elements(data, header, requested_names, notes)
    columns = element_columns[id(vertex)]
    # converting a signalling NaN causes a warning; values that are not finite are rejected later
    with np.errstate(invalid="ignore"):
        points = convert_to_float64(np.stack([columns[axes[axis]].values for axis in "xyz"], axis=1))
    counts, indices = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for shape in (face, strips):
        if shape is None or not shape.count:
            continue
        column = element_columns[id(shape)][lists[id(shape)]]
        assert column.counts is not None
        if shape is face:
            counts.append(column.counts)
            indices.append(column.values)
        else:
            triangles = split_triangle_strips(_insert_strip_restarts(column.values, column.counts))
            counts.append(np.full(len(triangles), 3))
            indices.append(triangles.reshape(-1))
    return PolygonMesh(points, np.concatenate(counts), np.concatenate(indices))


def _insert_strip_restarts(values: Integers, counts: Integers) -> Integers:
    """Return the corners of several strips, with -1 between strips."""
    return np.insert(values, np.cumsum(counts)[:-1], -1)


def _find_corner_property(element: PlyElement) -> str:
    """Return the name of the property that lists the corners of a face or strip."""
    lists = [p for p in element.properties if p.length_type]
    named = [p for p in lists if p.name.lower() in _INDEX_PROPERTY_NAMES] or lists
    if len(named) != 1:
        raise HeaderError("has faces without exactly one list of vertices")
    if named[0].value_type[0] == "f" or str(named[0].length_type)[0] == "f":
        raise HeaderError("has faces that name their vertices by numbers that are not whole")
    return named[0].name


def read_columns(data: bytes, header: PlyHeader, element: PlyElement, names: Sequence[str]) -> Floats:
    """Return properties of an element as numbers, float64[count, len(names)]. The properties must not be lists.

    Raises HeaderError if the body does not match the header."""
    try:
        columns = read_elements(data, header, {id(element): names}, ImportNotes())[id(element)]
    except MeshError as error:
        raise HeaderError(str(error)) from None
    return convert_to_float64(np.stack([columns[name].values for name in names], axis=1)).reshape(-1, len(names))


def read_elements(
    data: bytes, header: PlyHeader, requested_names: Mapping[int, Collection[str]], notes: ImportNotes
) -> dict[int, ColumnByName]:
    """Return the requested columns of a file. `requested_names`: for the `id()` of an element in the header, the names of its
    properties.

    The result has the same keys. Other columns are skipped."""
    for element in header.elements:
        names = [p.name for p in element.properties]
        if twice := next((name for k, name in enumerate(names) if name in names[:k]), None):
            words = f"names the property `{format_word(twice.encode())}` of `{format_word(element.name.encode())}` twice"
            raise HeaderError(words)
    read: _TextBody | _BinaryBody = _BinaryBody(data, header) if header.byte_order else _TextBody(data, header)
    element_columns: dict[int, ColumnByName] = {}
    for element in header.elements:
        if len(element_columns) == len(requested_names):
            break
        columns = read.read_columns(element, requested_names.get(id(element), ()))
        if id(element) in requested_names:
            element_columns[id(element)] = columns
    else:
        read.note_trailing_content(notes)
    return element_columns


class _TextBody:
    """A body in text form, with one line per element. Blank lines are skipped."""

    def __init__(self, data: bytes, header: PlyHeader) -> None:
        self._blocks = read_blocks(normalise_text(data[header.body_offset :]), header.line)
        self._partial_block: TextBlock | None = None

    def _read_lines(self, count: int) -> Iterator[TextBlock]:
        """Yield blocks with `count` lines in total, or fewer if the file ends."""
        while count > 0:
            block = (
                self._partial_block if self._partial_block is not None and len(self._partial_block) else next(self._blocks, None)
            )
            if block is None:
                return
            yield block.select_lines(0, count)
            self._partial_block = block.select_lines(count, len(block))
            count -= min(count, len(block))

    def note_trailing_content(self, notes: ImportNotes) -> None:
        """Add a note if the file has lines after the last element."""
        for block in ([self._partial_block] if self._partial_block is not None else []) + list(self._blocks):
            if len(block):
                notes.count_skipped("lines after the last element", len(block), int(block.line_numbers[0]))

    def read_columns(self, element: PlyElement, requested_names: Collection[str]) -> ColumnByName:
        """Return the requested columns of the next element, by property. Other columns are skipped."""
        parts: dict[str, list[PlyColumn]] = {name: [] for name in requested_names}
        count = 0
        for block in self._read_lines(element.count):
            count += len(block)
            if requested_names:
                self._read_block(block, element, parts)
        if count < element.count:
            what = format_word(element.name.encode())
            raise HeaderError(f"{_TOO_SHORT_MESSAGE}: it has {count:,} of {element.count:,} {what} lines")
        return {name: _join_columns(each) for name, each in parts.items()}

    def _read_block(self, block: TextBlock, element: PlyElement, parts: Mapping[str, list[PlyColumn]]) -> None:
        at, what = block.first_words, format_word(element.name.encode())
        stop = block.first_words + block.word_counts
        last = max(k for k, p in enumerate(element.properties) if p.name in parts)
        for p in element.properties[: last + 1] if any(p.length_type for p in element.properties) else element.properties:
            self._check_lines(block, at < stop, what)
            if p.length_type is None:
                if p.name in parts:
                    parts[p.name].append(PlyColumn(block.read_floats(at, f"`{format_word(p.name.encode())}` of a {what}")))
                at = at + 1
                continue
            count, is_integer = block.read_integers(at)
            self._check_lines(block, is_integer & (count >= 0), what)
            self._check_lines(block, at + 1 + count <= stop, what)
            if p.name in parts:
                within = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
                word_indices = np.repeat(at + 1, count) + within
                values, are_whole = block.read_integers(word_indices)
                if not are_whole.all():
                    line = block.find_line_number(int(word_indices[np.flatnonzero(~are_whole)[0]]))
                    self._check_lines(block, block.line_numbers != line, what)
                parts[p.name].append(PlyColumn(values, count))
            at = at + 1 + count
        if not any(p.length_type for p in element.properties):
            self._check_lines(block, at == stop, what)

    @staticmethod
    def _check_lines(block: TextBlock, is_valid: NDArray[np.bool_], noun: str) -> None:
        if not is_valid.all():
            k = int(np.flatnonzero(~is_valid)[0])
            text = format_word(b" ".join(block.get_line_words(k)[:6]))
            raise HeaderError(f"has an incomplete {noun} in line {block.line_numbers[k]:,}: `{text}`")


def _join_columns(parts: list[PlyColumn]) -> PlyColumn:
    if not parts:
        return PlyColumn(np.empty(0), np.empty(0, np.int64))
    counts = [part.counts for part in parts if part.counts is not None]
    return PlyColumn(np.concatenate([part.values for part in parts]), np.concatenate(counts) if counts else None)


class _BinaryBody:
    """A body in binary form, in which elements follow each other without gaps."""

    def __init__(self, data: bytes, header: PlyHeader) -> None:
        self._data, self._byte_order, self._offset = data, header.byte_order, header.body_offset

    def note_trailing_content(self, notes: ImportNotes) -> None:
        """Add a note if the file has bytes after the last element."""
        rest = len(self._data) - self._offset
        if self._data[self._offset :].strip(b"\0 \n\r\t\x1a"):  # the format has no padding
            notes.count_skipped(f"{rest:,} bytes after the last element")

    def read_columns(self, element: PlyElement, requested_names: Collection[str]) -> ColumnByName:
        """Return the requested columns of the next element, by property. Other columns are skipped."""
        if not element.count:
            return {p.name: PlyColumn(np.empty(0), np.empty(0, np.int64) if p.length_type else None) for p in element.properties}
        lengths = self._read_first_lengths(element)
        if lengths is None:
            return self._read_uneven_lists(element, requested_names)
        layout: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        for p in element.properties:
            if p.length_type is not None:
                layout += [
                    (f"{p.name}#", self._byte_order + p.length_type),
                    (p.name, self._byte_order + p.value_type, (lengths[p.name],)),
                ]
            else:
                layout.append((p.name, self._byte_order + p.value_type))
        kind = np.dtype(layout)
        if self._offset + element.count * kind.itemsize > len(self._data):
            return self._read_uneven_lists(element, requested_names)
        rows = np.frombuffer(self._data, kind, element.count, self._offset)
        if any((rows[f"{name}#"] != length).any() for name, length in lengths.items()):
            return self._read_uneven_lists(element, requested_names)
        self._offset += rows.nbytes
        found = {}
        for p in element.properties:
            if p.name in requested_names and p.length_type is None:
                found[p.name] = PlyColumn(rows[p.name])
            elif p.name in requested_names:
                found[p.name] = PlyColumn(rows[p.name].astype(np.int64).reshape(-1), np.full(element.count, lengths[p.name]))
        return found

    def _read_first_lengths(self, element: PlyElement) -> dict[str, int] | None:
        """Return the list lengths of the first element, by property, or None if they cannot be read.

        In most files, all elements have lists of the same lengths."""
        at, lengths = self._offset, {}
        for p in element.properties:
            if p.length_type is not None:
                length = self._read_count(p.length_type, at, element, 0)
                if length * np.dtype(p.value_type).itemsize > len(self._data) - at:
                    return None
                lengths[p.name] = length
                at += np.dtype(p.length_type).itemsize + length * np.dtype(p.value_type).itemsize
            else:
                at += np.dtype(p.value_type).itemsize
        return lengths

    def _read_count(self, kind: str, offset: int, element: PlyElement, row: int) -> int:
        if offset + np.dtype(kind).itemsize > len(self._data):
            raise HeaderError(f"{_TOO_SHORT_MESSAGE}: it ends within {format_word(element.name.encode())} {row}")
        count = np.frombuffer(self._data, self._byte_order + kind, 1, offset)[0]
        if not (count >= 0 and np.isfinite(count)):
            words = f"has a list of {count:,} values in its {format_word(element.name.encode())} {row}, more than the file has"
            raise HeaderError(words)
        return int(count)

    def _read_uneven_lists(self, element: PlyElement, requested_names: Collection[str]) -> ColumnByName:
        """Return list properties that have different lengths in different elements. The starts of all lists are located first;
        then all values are read at once."""
        data, at, name = self._data, self._offset, format_word(element.name.encode())
        starts: dict[str, list[int]] = {p.name: [] for p in element.properties if p.name in requested_names}
        counts: dict[str, list[int]] = {p.name: [] for p in element.properties if p.name in requested_names and p.length_type}
        steps = [_make_value_reader(self._byte_order, p.value_type, p.length_type) for p in element.properties]
        names = [p.name if p.name in requested_names else "" for p in element.properties]
        try:
            for row in range(element.count):
                for (size, read, head), key in zip(steps, names, strict=True):
                    count = 1
                    if read is not None:
                        count = int(read(data, at)[0])
                        at += head
                        if count < 0 or count * size > len(data) - at:
                            raise HeaderError(f"has a list of {count:,} values in its {name} {row}, more than the file has")
                    if key:
                        starts[key].append(at)
                        if read is not None:
                            counts[key].append(count)
                    at += count * size
                if at > len(data):
                    raise HeaderError(f"{_TOO_SHORT_MESSAGE}: it ends within {name} {row}")
        except (struct.error, OverflowError, ValueError):
            raise HeaderError(f"{_TOO_SHORT_MESSAGE}: it ends among its {name}s") from None
        self._offset = at
        columns = {}
        for p in element.properties:
            if p.name in requested_names:
                many = np.array(counts[p.name], np.int64) if p.length_type else np.ones(element.count, np.int64)
                values = self._gather_values(np.array(starts[p.name], np.int64), many, p.value_type)
                columns[p.name] = PlyColumn(values.astype(np.int64), many) if p.length_type else PlyColumn(values)
        return columns

    def _gather_values(self, start: Integers, count: Integers, kind: str) -> NDArray[Any]:
        size, total = np.dtype(kind).itemsize, int(count.sum())
        if total * size > limits.MAX_MESH_BYTES:
            raise HeaderError(_TOO_SHORT_MESSAGE)
        within = np.arange(total) - np.repeat(np.cumsum(count) - count, count)
        at = np.repeat(start, count) + within * size
        raw = np.frombuffer(self._data, np.uint8)[at[:, None] + np.arange(size)]
        return np.ascontiguousarray(raw).view(self._byte_order + kind)[:, 0]


_STRUCT_CODE_BY_DTYPE = {
    "i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f4": "f", "f8": "d",
}  # fmt: skip


def _make_value_reader(
    order: str, kind: str, count: str | None
) -> tuple[int, Callable[[bytes, int], tuple[Any, ...]] | None, int]:
    """Return three values: the size of a property's value in bytes, a function that reads the length of a list, and the size of
    this length.

    For a property that is not a list, the last two are None and 0. `kind`, `count`: the types of the value and of the length."""
    read = None if count is None else struct.Struct(order + _STRUCT_CODE_BY_DTYPE[count])
    return np.dtype(kind).itemsize, None if read is None else read.unpack_from, 0 if read is None else read.size
