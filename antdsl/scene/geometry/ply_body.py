"""Vertices and faces of any .ply file, text or binary, polygons of whatever kinds: element by element, each count held against
what is left of the file before it is used."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from antdsl.scene.geometry.mesh_text import MeshError, fan, lines_of, number_of, points_of, shown, triangles_of
from antdsl.scene.geometry.ply import Element, Header, HeaderError, rows_of

Floats = NDArray[np.float64]
Faces = NDArray[np.int64]

_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_INDEX = ("vertex_indices", "vertex_index")


def read_faces(data: bytes, header: Header) -> tuple[Floats, Faces]:
    """Vertices and triangles; HeaderError or MeshError where the body is not as the header says."""
    vertex = next((e for e in header.elements if e.name == "vertex"), None)
    face = next((e for e in header.elements if e.name == "face"), None)
    if vertex is None or face is None or not face.count:
        raise HeaderError("has no faces")
    if not {"x", "y", "z"} <= {p.name for p in vertex.properties if not p.count}:
        raise HeaderError("has vertices without x, y and z")
    _corners_of(face)
    read = _Binary(data, header) if header.order else _Text(data, header)
    points, triangles = np.empty((0, 3)), array("q")
    for element in header.elements[: max(header.elements.index(vertex), header.elements.index(face)) + 1]:
        if element is vertex:
            points = read.points(element)
        elif element is face:
            for corners in read.lists(element, _corners_of(face)):
                if len(corners) > 2:  # points and lines have no area
                    fan(triangles, corners)
        else:
            read.skip(element)
    return points, triangles_of(triangles)


def _corners_of(face: Element) -> int:
    """Which property of a face lists its corners."""
    lists = [k for k, p in enumerate(face.properties) if p.count]
    named = [k for k in lists if face.properties[k].name in _INDEX] or lists
    if len(named) != 1:
        raise HeaderError("has faces that do not list their vertices once")
    if face.properties[named[0]].kind[0] == "f" or face.properties[named[0]].count in ("f4", "f8"):
        raise HeaderError("has faces that name their vertices by numbers that are not whole")
    return named[0]


class _Text:
    """One line an element; blank lines are passed over."""

    def __init__(self, data: bytes, header: Header) -> None:
        lines = lines_of(data, header.body, 1 + data.count(b"\n", 0, header.body))
        self._lines = ((number, line) for number, line in lines if not line.isspace())

    def _rows(self, element: Element) -> Iterator[tuple[int, list[bytes]]]:
        count = 0
        for number, line in islice(self._lines, element.count):
            count += 1
            yield number, line.split()
        if count < element.count:
            raise HeaderError(f"is shorter than its header says: it has {count:,} of {element.count:,} {element.name} lines")

    def skip(self, element: Element) -> None:
        for _ in self._rows(element):
            pass

    def points(self, element: Element) -> Floats:
        numbers = array("d")
        names = [p.name for p in element.properties]
        simple = not any(p.count for p in element.properties)
        at = [names.index(axis) for axis in "xyz"]
        for number, words in self._rows(element):
            places = at if simple else self._places(element, words, number)
            try:
                if simple and len(words) != len(names):
                    raise ValueError
                numbers.extend([number_of(words[places[k] if not simple else k]) for k in at])
            except (ValueError, IndexError):
                raise HeaderError(f"has no whole vertex in line {number}") from None
        return points_of(numbers)

    def lists(self, element: Element, which: int) -> Iterator[list[int]]:
        for number, words in self._rows(element):
            place = 0 if which == 0 else self._places(element, words, number)[which]
            try:
                count = _whole(words[place])
                corners = [_whole(word) for word in words[place + 1 : place + 1 + count]] if count >= 0 else []
                if len(corners) != count:
                    raise ValueError
            except (ValueError, IndexError):
                words_shown = shown(b" ".join(words[:6]))
                raise HeaderError(f"has no whole face in line {number}: `{words_shown}`") from None
            yield corners

    @staticmethod
    def _places(element: Element, words: list[bytes], number: int) -> list[int]:
        """At which word each property begins."""
        found, at = [], 0
        for each in element.properties:
            found.append(at)
            try:
                at += 1 if each.count is None else 1 + max(_whole(words[at]), 0)
            except (ValueError, IndexError):
                raise HeaderError(f"has a line {number} that is shorter than its header says") from None
        return found


def _whole(word: bytes) -> int:
    if len(word) > 20 or not word.removeprefix(b"-").isdigit():
        raise ValueError(word)
    return int(word)


class _Binary:
    def __init__(self, data: bytes, header: Header) -> None:
        self._data, self._header, self._at = data, header, header.body

    def skip(self, element: Element) -> None:
        if any(p.count for p in element.properties):
            for _ in self.lists(element, -1):
                pass
        else:
            self._at += element.count * element.least()

    def points(self, element: Element) -> Floats:
        if any(p.count for p in element.properties):
            raise HeaderError("has vertices with lists, which are not read")
        rows = rows_of(self._data, self._header, self._at, element, [(p.name, p.kind) for p in element.properties])
        if rows is None:
            raise HeaderError("is shorter than its header says, or names a property twice")
        self._at += rows.nbytes
        return np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)

    def lists(self, element: Element, which: int) -> Iterator[list[int]]:
        """Each element's list of the number `which`; of none, empty ones."""
        order, data, at = self._header.order, self._data, self._at
        single = [(struct.Struct(order + _CODES[p.kind]), None) for p in element.properties]
        counts = [None if p.count is None else struct.Struct(order + _CODES[p.count]) for p in element.properties]
        try:
            for row in range(element.count):
                corners: list[int] = []
                for k, (one, _) in enumerate(single):
                    each = counts[k]
                    if each is None:
                        at += one.size
                        continue
                    count = int(each.unpack_from(data, at)[0])
                    at += each.size
                    if count < 0 or count * one.size > len(data) - at:
                        raise HeaderError(f"has a list of {count:,} values in its {element.name} {row}, more than the file has")
                    if k == which:
                        corners = list(struct.unpack_from(f"{order}{count}{one.format[-1]}", data, at))
                    at += count * one.size
                if at > len(data):
                    raise HeaderError(f"is shorter than its header says: it ends in its {element.name} {row}")
                yield corners
        except (struct.error, OverflowError, ValueError):
            raise HeaderError(f"is shorter than its header says: it ends among its {element.name}s") from None
        self._at = at


__all__ = ["MeshError", "read_faces"]
