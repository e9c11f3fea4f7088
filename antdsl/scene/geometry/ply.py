"""Headers of .ply files, held against the size of the file, and the common kind of body: binary, all faces triangles."""

from __future__ import annotations

import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.geometry.mesh_text import lines_of, number_of, shown

KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


class HeaderError(Exception):
    """Why a header is not accepted, in words that fit after the file's name."""


@dataclass(frozen=True, slots=True)
class Property:
    """`count` is the kind of a list's own count, None where there is one value."""

    name: str
    kind: str
    count: str | None = None


@dataclass(frozen=True, slots=True)
class Element:
    name: str
    count: int
    properties: tuple[Property, ...]

    def least(self) -> int:
        """Bytes that one of these takes at least; an empty list is its count alone."""
        return sum(np.dtype(p.count or p.kind).itemsize for p in self.properties)


@dataclass(frozen=True, slots=True)
class Header:
    """`order` is `<` or `>`, empty for text; `body` is where the elements begin."""

    order: str
    elements: tuple[Element, ...]
    body: int


def read_header(data: bytes) -> Header:
    """The header of a .ply file whose counts fit the size of the file; HeaderError says why not."""
    end = data.find(b"end_header", 0, 64 * limits.KIB)
    if not data.startswith(b"ply") or end < 0:
        raise HeaderError("is not a .ply file")
    order: str | None = None
    elements: list[Element] = []
    for line in data[:end].decode("ascii", "replace").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in _FORMATS:
            order = _FORMATS[words[1]]
        elif words[0] == "element" and len(words) == 3 and re.fullmatch("[0-9]{1,12}", words[2]) and len(elements) < 16:
            elements.append(Element(words[1], int(words[2]), ()))
        elif words[0] == "property" and elements and (found := _property(words[1:])):
            last = elements[-1]
            elements[-1] = Element(last.name, last.count, (*last.properties, found))
        else:
            raise HeaderError(f"has a header line that is not understood: `{shown(line.encode(), 40)}`")
    if order is None:
        raise HeaderError("does not say its format")
    header = Header(order, tuple(elements), data.find(b"\n", end) + 1)
    _fits(header, len(data))
    return header


def _property(words: list[str]) -> Property | None:
    if len(words) == 4 and words[0] == "list" and words[1] in KINDS and words[2] in KINDS:
        return Property(words[3], KINDS[words[2]], KINDS[words[1]])
    return Property(words[1], KINDS[words[0]]) if len(words) == 2 and words[0] in KINDS else None


def _fits(header: Header, size: int) -> None:
    counts = {element.name: element.count for element in header.elements}
    for name, words, most in (("face", "faces", limits.MESH_FACES), ("vertex", "vertices", 3 * limits.MESH_FACES)):
        if counts.get(name, 0) > most:
            raise HeaderError(f"says it has {counts[name]:,} {words}, more than {most:,}")
    least = sum(element.count * (element.least() if header.order else 1) for element in header.elements)
    if least > size - header.body:
        raise HeaderError(f"says it has {sum(counts.values()):,} elements, too many for a file of {size:,} bytes")


def read_triangles(data: bytes, header: Header) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Vertices and faces of a binary file with vertices first and triangles next; None for any other, which a slower reader
    can try."""
    if not header.order or [element.name for element in header.elements[:2]] != ["vertex", "face"]:
        return None
    vertex, face = header.elements[:2]
    lists = [p for p in face.properties if p.count]
    if any(p.count for p in vertex.properties) or len(lists) != 1 or not {"x", "y", "z"} <= {p.name for p in vertex.properties}:
        return None
    points = rows_of(data, header, header.body, vertex, [(p.name, p.kind) for p in vertex.properties])
    layout = [
        entry
        for p in face.properties
        for entry in ([("#", p.count), *((f"#{k}", p.kind) for k in "abc")] if p.count else [(p.name, p.kind)])
    ]
    if points is None:
        return None
    rows = rows_of(data, header, header.body + points.nbytes, face, layout)
    if rows is None or (rows["#"] != 3).any():
        return None
    return (
        np.stack([points[axis] for axis in "xyz"], axis=1).astype(np.float64),
        np.stack([rows[f"#{k}"] for k in "abc"], axis=1).astype(np.int64),
    )


def rows_of(data: bytes, header: Header, start: int, element: Element, layout: list[tuple[str, str]]) -> NDArray[np.void] | None:
    if len({name for name, _ in layout}) != len(layout):
        return None
    kind = np.dtype([(name, header.order + word) for name, word in layout])
    if start + element.count * kind.itemsize > len(data):
        return None
    return np.frombuffer(data, kind, element.count, start)


def read_columns(data: bytes, header: Header, element: Element, names: Sequence[str]) -> NDArray[np.float64]:
    """Some single-valued properties of one element, (count, len(names)); HeaderError where the body is not as the header says."""
    before = header.elements[: header.elements.index(element)]
    if not header.order:
        return _text_columns(data, header, element, names, sum(e.count for e in before))
    if any(p.count for e in (*before, element) for p in e.properties):
        raise HeaderError(f"has lists among or before what is painted on its {element.name}s, where they cannot be passed over")
    start = header.body + sum(e.count * e.least() for e in before)
    rows = rows_of(data, header, start, element, [(p.name, p.kind) for p in element.properties])
    if rows is None:
        raise HeaderError("is shorter than its header says, or names a property twice")
    return np.stack([rows[name] for name in names], axis=1).astype(np.float64)


def _text_columns(data: bytes, header: Header, element: Element, names: Sequence[str], skip: int) -> NDArray[np.float64]:
    """As `read_columns`, of a text file: one line an element; only after its lists the place of a value is not known."""
    order = [p.name for p in element.properties]
    lists = [k for k, p in enumerate(element.properties) if p.count]
    at = [order.index(name) for name in names]
    if lists and max(at) > lists[0]:
        raise HeaderError(f"has a list before what is painted on its {element.name}s")
    every = lines_of(data, header.body, 1 + data.count(b"\n", 0, header.body))
    numbers = array("d")
    for number, line in islice((each for each in every if not each[1].isspace()), skip, skip + element.count):
        words = line.split()
        try:
            numbers.extend([number_of(words[k]) for k in at])
        except (ValueError, IndexError):
            raise HeaderError(f"has a line {number} whose values are not numbers") from None
    if len(numbers) < element.count * len(at):
        raise HeaderError("is shorter than its header says")
    return np.array(numbers, np.float64).reshape(-1, len(at))
