"""Small files of Houdini, written by the descriptions of the formats: a cube as polygons, a soup, and a packed library."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

CUBE_POINTS = [[x, y, z] for y in (-0.5, 0.5) for x, z in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
CUBE_FACES = [[1, 5, 4, 0], [2, 6, 5, 1], [3, 7, 6, 2], [0, 4, 7, 3], [2, 1, 0, 3], [5, 6, 7, 4]]
CLIP = """{
   rate = 30
   start = 0
   tracklength = 3
   tracks = 3
   {
      name = hand:tx
      lefttype = hold
      data = 0 1 2
   }
   {
      name = hand:ry
      data_rle = @2 0 90
   }
   {
      name = hand:rOrd
      data_rle = @3 0
   }
}
"""


def attribute(name: str, values: list[Any], size: int, **others: Any) -> list[Any]:
    stored = ["size", size, "storage", "fpreal32", *[part for pair in (others or {"tuples": values}).items() for part in pair]]
    return [["scope", "public", "type", "numeric", "name", name], ["size", size, "storage", "fpreal32", "values", stored]]


def texts(name: str, strings: list[str], indices: list[int]) -> list[Any]:
    stored = ["size", 1, "storage", "int32", "arrays", [indices]]
    return [["scope", "public", "type", "string", "name", name], ["size", 1, "strings", strings, "indices", stored]]


def geometry(
    points: list[Any], vertices: list[int], primitives: list[Any], primitive_attributes: list[Any] | None = None,
    point_attributes: list[Any] | None = None, shared: list[Any] | None = None, count: int = 1,
) -> list[Any]:  # fmt: skip
    own = point_attributes or [attribute("P", points, 3)]
    attributes = ["pointattributes", own, *(["primitiveattributes", primitive_attributes] if primitive_attributes else [])]
    return [
        "fileversion", "20.0.506", "hasindex", False, "pointcount", len(points), "vertexcount", len(vertices),
        "primitivecount", count, "topology", ["pointref", ["indices", vertices]], "attributes", attributes,
        "primitives", primitives, *(["sharedprimitivedata", shared] if shared else []),
    ]  # fmt: skip


def cube(**options: Any) -> list[Any]:
    run = [["type", "p_r"], ["s_v", 0, "n_p", 6, "r_v", [4, 6]]]
    return geometry(CUBE_POINTS, [corner for face in CUBE_FACES for corner in face], [run], count=6, **options)


def library() -> list[Any]:
    """Two packed geometries, `head` and `box`, which is moved and doubled; and a sphere."""
    packed = ["type", "run", "runtype", "PackedGeometry", "varyingfields", ["parameters", "vertex", "transform"], "uniformfields"]
    rows = [
        [{"embedded": "embed:1"}, 0, np.eye(3).ravel().tolist()],
        [{"embedded": "embed:1"}, 1, (2 * np.eye(3)).ravel().tolist()],
    ]
    sphere = [["type", "Sphere"], ["vertex", 2, "transform", [1, 0, 0, 0, 1, 0, 0, 0, 1]]]
    primitives = [[[*packed, {"pivot": [0, 0, 0]}], rows], sphere]
    shared = ["PackedGeometry", ["gu:embeddedgeo", "embed:1", cube()]]
    names = [texts("name", ["head", "box", "ball"], [0, 1, 2])]
    return geometry([[0, 0, 0], [10, 0, 0], [0, 5, 0]], [0, 1, 2], primitives, names, shared=shared, count=3)


def to_text(value: Any) -> bytes:
    return json.dumps(value).encode()


def to_binary(value: Any, order: str = "<") -> bytes:
    """The value as binary JSON: every text a token, every list of numbers an array of one type."""
    tokens: dict[str, int] = {}

    def length(count: int) -> bytes:
        return bytes([count]) if count < 0xF1 else b"\xf2" + struct.pack(order + "H", count)

    def text(value: str) -> bytes:
        data, new = value.encode(), value not in tokens
        number = length(tokens.setdefault(value, len(tokens)))
        return (b"\x2b" + number + length(len(data)) + data if new else b"") + b"\x26" + number

    def write(value: Any) -> bytes:
        if isinstance(value, str):
            return text(value)
        if isinstance(value, bool):
            return b"\x31" if value else b"\x30"
        if isinstance(value, int):
            return b"\x13" + struct.pack(order + "i", value)
        if isinstance(value, float):
            return b"\x1a" + struct.pack(order + "d", value)
        if isinstance(value, dict):
            return b"\x7b" + b"".join(text(key) + write(each) for key, each in value.items()) + b"\x7d"
        if value and all(isinstance(each, int | float) and not isinstance(each, bool) for each in value):
            kind, code = ("f4", b"\x19") if any(isinstance(each, float) for each in value) else ("u1", b"\x21")
            return b"\x40" + code + length(len(value)) + np.array(value).astype(order + kind).tobytes()
        return b"\x5b" + b"".join(write(each) for each in value) + b"\x5d"

    return {"<": b"\x7fNSJb", ">": b"\x7fbJSN"}[order] + write(value)
