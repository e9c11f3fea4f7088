"""Meshes as text, line by line: .obj files and text .stl files. Never more than a line is taken apart at once, numbers go into
plain arrays, and every complaint has its line."""

from __future__ import annotations

import io
import re
from array import array
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from antdsl import limits

Floats = NDArray[np.float64]
Faces = NDArray[np.int64]

LINE_BYTES = limits.MIB
_VERTICES = 3 * limits.MESH_FACES
_EXPORT = "export it anew, as triangles or polygons in a .ply, .obj or .stl file"


class MeshError(Exception):
    """Why a file is no usable mesh, in words that fit after its name; `help` says what to do about it."""

    def __init__(self, message: str, help: str | None = _EXPORT) -> None:
        super().__init__(message)
        self.help = help


def lines_of(data: bytes, start: int = 0, first: int = 1) -> Iterator[tuple[int, bytes]]:
    """The lines of a text from `start` on, each with its number; MeshError for one that is longer than any mesh's."""
    if b"\r" in data[:4096] and b"\n" not in data[:4096]:
        data = data.replace(b"\r", b"\n")  # line ends of old
    file = io.BytesIO(data)
    file.seek(start)
    number = first
    while line := file.readline(LINE_BYTES + 1):
        if len(line) > LINE_BYTES:
            raise MeshError(f"has a line {number} of more than {LINE_BYTES:,} bytes")
        yield number, line
        number += 1


def number_of(word: bytes) -> float:
    """A decimal number; ValueError for anything else, also what Python alone takes for one."""
    if len(word) > 40 or b"_" in word:
        raise ValueError(word)
    return float(word)


def shown(word: bytes, most: int = 20) -> str:
    """A word of a stranger's file, as it can stand in a message."""
    text = word[:most].decode("ascii", "replace")
    return "".join(c if c.isprintable() else "\ufffd" for c in text)


def checked_count(count: int, most: int, what: str) -> None:
    """MeshError where there is more than may be."""
    if count > most:
        raise MeshError(f"has more than {most:,} {what}", "use a lighter mesh")


def points_of(numbers: array[float]) -> Floats:
    """Three numbers a row, as an array of its own."""
    return np.frombuffer(numbers, np.float64).reshape(-1, 3) if numbers else np.empty((0, 3))


def triangles_of(numbers: array[int]) -> Faces:
    return np.frombuffer(numbers, np.int64).reshape(-1, 3) if numbers else np.empty((0, 3), np.int64)


def fan(triangles: array[int], corners: list[int]) -> None:
    """A polygon cut into triangles from its first corner."""
    for i in range(1, len(corners) - 1):
        triangles.extend((corners[0], corners[i], corners[i + 1]))
    checked_count(len(triangles) // 3, limits.MESH_FACES, "faces")


# --- .obj --------------------------------------------------------------------------------------------------------------


def read_obj(data: bytes, group: str | None = None) -> tuple[Floats, Faces]:
    """Vertices and faces of a Wavefront file, of one group or object where one is named; materials, normals and everything else
    are passed over, polygons cut into fans."""
    if b"\0" in data[:4096]:
        raise MeshError("is not a text file")
    points, triangles = array("d"), array("q")
    names: dict[str, None] = {}
    in_group, in_object = group is None, False
    for number, line in lines_of(data):
        if line[:2] in (b"v ", b"v\t"):
            points.extend(_vertex(line, number))
            checked_count(len(points) // 3, _VERTICES, "vertices")
        elif group is not None and line.split(None, 1)[:1] == [b"g"]:
            words = line.decode("utf-8", "replace").split()[1:] or ["default"]
            _note(names, words)
            in_group = group in words
        elif group is not None and line[:2] == b"o ":
            word = line[2:].decode("utf-8", "replace").strip()
            _note(names, [word])
            in_object = group == word
        elif line[:2] in (b"f ", b"f\t") and (in_group or in_object):
            corners = [_corner(word, len(points) // 3, number) for word in line.split()[1:]]
            if len(corners) < 3:
                raise MeshError(f"has a face of fewer than three corners in line {number}")
            fan(triangles, corners)
    if group is not None and not triangles:
        raise MeshError(_no_group(group, list(names)), None)
    return points_of(points), triangles_of(triangles)


def _note(names: dict[str, None], words: list[str]) -> None:
    """Names of groups, to be told where another is asked for."""
    if len(names) < 1000:
        names.update(dict.fromkeys(word[:60] for word in words[:100]))


def _vertex(line: bytes, number: int) -> tuple[float, float, float]:
    try:
        x, y, z = (number_of(word) for word in line.split(None, 4)[1:4])
    except ValueError:
        raise MeshError(f"has no three numbers after `{shown(line.split(None, 1)[0])}` in line {number}") from None
    return x, y, z


def _no_group(group: str, names: list[str]) -> str:
    from antdsl.diagnostics.suggestion import nearest_name

    if group in names:
        return f"has no faces in its group `{group}`"
    near = nearest_name(group, names)
    there = f"did you mean `{near}`?" if near else "it has " + (", ".join(f"`{n[:40]}`" for n in names[:8]) or "no groups")
    return f"has no group `{group[:60]}`: {there}"


def _corner(word: bytes, count: int, number: int) -> int:
    parts = word.split(b"/", 3)
    if len(parts) > 3 or not re.fullmatch(rb"-?[0-9]{1,10}", parts[0]) or int(parts[0]) == 0:
        raise MeshError(f"has a corner `{shown(word)}` that is no vertex number in line {number}")
    index = int(parts[0])
    index = index - 1 if index > 0 else count + index
    if index < 0 or index >= count:
        raise MeshError(f"names a vertex {int(parts[0])} that is not there in line {number}")
    return index


# --- text .stl ---------------------------------------------------------------------------------------------------------


def read_stl_text(data: bytes) -> Floats:
    """The corners of all facets of a text .stl file (3 n, 3), in order."""
    corners = array("d")
    in_facet, before, number = False, 0, 0
    for number, line in lines_of(data):
        word = line.split(None, 1)[:1]
        kind = word[0].lower() if word else b""
        if kind == b"vertex":
            if not in_facet:
                raise MeshError(f"has a corner outside of a facet in line {number}")
            corners.extend(_vertex(line, number))
            checked_count(len(corners) // 9, limits.MESH_FACES, "faces")
        elif kind in (b"facet", b"endfacet"):
            if in_facet == (kind == b"facet") or len(corners) != before + 9 * in_facet:
                raise MeshError(f"has a facet without three corners before line {number}")
            in_facet, before = kind == b"facet", len(corners)
        elif in_facet and kind not in (b"outer", b"endloop", b""):
            raise MeshError(f"has a line {number} that is not understood: `{shown(line.strip())}`")
    if in_facet:
        raise MeshError(f"ends in line {number} with a facet without three corners: a part of it is missing")
    return points_of(corners)
