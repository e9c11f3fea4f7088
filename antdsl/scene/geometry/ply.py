"""Headers of .ply files: their elements and properties, checked against the size of the file."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from antdsl import limits
from antdsl.scene.geometry.mesh_text import format_word

DTYPE_BY_TYPE = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
    "int64": "i8", "uint64": "u8",
}  # fmt: skip
_BYTE_ORDER_BY_FORMAT = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_ELEMENTS = 32
_LINE_END_PATTERN = re.compile(rb"\r\n|\r|\n")


class HeaderError(Exception):
    """Error for an invalid header. The message is a reason that fits after the file's name."""


@dataclass(frozen=True, slots=True)
class PlyProperty:
    """A property of an element. `length_type`: for a list, the type of its length; None for a single value."""

    name: str
    value_type: str
    length_type: str | None = None


@dataclass(frozen=True, slots=True)
class PlyElement:
    """A kind of element in a file, such as `vertex`. `count`: the number of elements of this kind."""

    name: str
    count: int
    properties: tuple[PlyProperty, ...]

    def compute_min_bytes(self) -> int:
        """Return the smallest number of bytes that one element can have. A list is counted as empty, with only its length."""
        return sum(np.dtype(p.length_type or p.value_type).itemsize for p in self.properties)


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """The header of a file.

    `byte_order`: the byte order, `<` or `>`; empty for text.
    `body_offset`: the byte offset at which the elements begin.
    `line`: the line of the file at which the elements begin."""

    byte_order: str
    elements: tuple[PlyElement, ...]
    body_offset: int
    line: int


def read_header(data: bytes) -> PlyHeader:
    """Return the header of a .ply file. Raises HeaderError if it is invalid, or if its counts exceed the size of the file."""
    lines, body = _split_header_lines(data)
    order: str | None = None
    elements: list[PlyElement] = []
    for line in lines:
        words = line.decode("ascii", "replace").split()
        head = words[0].lower() if words else "comment"
        if head in ("comment", "obj_info"):
            continue
        if head == "format" and len(words) == 3 and words[1].lower() in _BYTE_ORDER_BY_FORMAT:
            order = _BYTE_ORDER_BY_FORMAT[words[1].lower()]
        elif head == "element" and len(words) == 3 and re.fullmatch("[0-9]{1,12}", words[2]) and len(elements) < _MAX_ELEMENTS:
            elements.append(PlyElement(words[1], int(words[2]), ()))
        elif head == "property" and elements and (parsed_property := _parse_property(words[1:])):
            last = elements[-1]
            elements[-1] = PlyElement(last.name, last.count, (*last.properties, parsed_property))
        else:
            raise HeaderError(f"has a header line that is not understood: `{format_word(line, 40)}`")
    if order is None:
        raise HeaderError("has no format line")
    header = PlyHeader(order, tuple(elements), body, len(lines) + 3)
    _check_element_counts(header, len(data))
    return header


def _split_header_lines(data: bytes) -> tuple[list[bytes], int]:
    """Return the lines between `ply` and `end_header`, and the offset at which the body begins. If these words occur in
    comments, they are ignored."""
    head = data[: 64 * limits.KIB]
    at = 3 if head.startswith(b"\xef\xbb\xbf") else 0
    lines: list[bytes] = []
    ends: list[bytes] = []
    while end := _LINE_END_PATTERN.search(head, at):
        line, at = head[at : end.start()].strip(), end.end()
        ends.append(end[0])
        if len(ends) == 1:
            if line.lower() != b"ply":
                break
        elif line.lower() == b"end_header":
            # if lines end with a carriage return alone, a line feed is the first byte of the body
            return lines, end.start() + (1 if end[0] == b"\r\n" and ends[0] == b"\r" else len(end[0]))
        else:
            lines.append(line)
    if head.startswith((b"\xff\xfe", b"\xfe\xff", b"p\0l\0")):
        raise HeaderError("is text in UTF-16, but must be plain ASCII text")
    raise HeaderError("is not a .ply file")


def _parse_property(words: list[str]) -> PlyProperty | None:
    kinds = [word.lower() for word in words[:-1]]
    if len(words) == 4 and kinds[0] == "list" and kinds[1] in DTYPE_BY_TYPE and kinds[2] in DTYPE_BY_TYPE:
        return PlyProperty(words[3], DTYPE_BY_TYPE[kinds[2]], DTYPE_BY_TYPE[kinds[1]])
    return PlyProperty(words[1], DTYPE_BY_TYPE[kinds[0]]) if len(words) == 2 and kinds[0] in DTYPE_BY_TYPE else None


def _check_element_counts(header: PlyHeader, size: int) -> None:
    counts = {element.name: element.count for element in header.elements}
    for name, words, most in (("face", "faces", limits.MAX_MESH_FACES), ("vertex", "vertices", 3 * limits.MAX_MESH_FACES)):
        if counts.get(name, 0) > most:
            raise HeaderError(f"says it has {counts[name]:,} {words}, more than {most:,}")
    least = sum(element.count * (element.compute_min_bytes() if header.byte_order else 1) for element in header.elements)
    if least > size - header.body_offset:
        raise HeaderError(f"says it has {sum(counts.values()):,} elements, too many for a file of {size:,} bytes")
