"""Small glTF files of bodies, made from numbers: a skin of two joints with morph targets and animations of all three kinds."""

from __future__ import annotations

import json
import struct
from base64 import b64encode
from typing import Any

import numpy as np
from numpy.typing import NDArray

KINDS = {"f": 5126, "H": 5123, "B": 5121, "I": 5125}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Writer:
    """Collects accessors into one buffer."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def view(self, values: NDArray[Any], kind: str) -> int:
        self.data += bytes(-len(self.data) % 4)
        raw = np.asarray(values).astype(f"<{np.dtype(kind).str[1:]}").tobytes()
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw)})
        self.data += raw
        return len(self.views) - 1

    def add(self, values: Any, kind: str = "f", width: int | None = None, **fields: Any) -> int:
        rows = np.asarray(values, np.float64)
        rows = rows.reshape(-1, width or (1 if rows.ndim == 1 else rows.shape[1]))
        view = self.view(rows, kind)
        self.accessors.append(
            {"bufferView": view, "componentType": KINDS[kind], "count": len(rows), "type": TYPES[rows.shape[1]], **fields}
        )
        return len(self.accessors) - 1

    def tree(self, rest: dict[str, Any]) -> dict[str, Any]:
        buffer = {"byteLength": len(self.data)}
        return {"asset": {"version": "2.0"}, "buffers": [buffer], "bufferViews": self.views, "accessors": self.accessors, **rest}


def binary(tree: dict[str, Any], data: bytes) -> bytes:
    """A .glb file."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    data = bytes(data) + bytes(-len(data) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def text(tree: dict[str, Any], data: bytes) -> bytes:
    """A .gltf file with its buffer inside."""
    buffers = [{"byteLength": len(data), "uri": "data:application/octet-stream;base64," + b64encode(bytes(data)).decode()}]
    return json.dumps({**tree, "buffers": buffers}).encode()


HALF = float(np.sqrt(0.5))
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [1, 2, 0], [0, 4, 1]], np.float64)
JOINTS = [[0, 1, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]]
WEIGHTS = [[1, 0, 0, 0], [0.75, 0.25, 0, 0], [0.5, 0.5, 0, 0], [1, 0, 0, 0], [2, 0, 0, 0]]
SMILE = [[0, 0, 0], [0, 0, 0.5], [0, 0, 0], [0, 0, 0], [1, 0, 0]]


def arm() -> tuple[dict[str, Any], bytes]:
    """The JSON and the buffer of a body: `root` stands at (0, 1, 0), `elbow` 2 above it; the skin is bound 1 lower, in its own
    space. `bend`: LINEAR, the elbow turns by a quarter about z in a second; `hop`: STEP and CUBICSPLINE translations;
    `smile`: the weight of the morph target."""
    writer = Writer()
    positions = writer.add(POINTS)
    normals = writer.add(np.tile([0.0, 0.0, 1.0], (5, 1)))
    uvs = writer.add(POINTS[:, :2] / 4)
    joints, weights = writer.add(JOINTS, "B"), writer.add(WEIGHTS)
    faces = writer.add([0, 1, 2, 1, 3, 2, 2, 3, 4], "H")
    inverse = np.tile(np.eye(4), (2, 1, 1))
    inverse[1, :3, 3] = (0, -2, 0)
    bind = writer.add(inverse.transpose(0, 2, 1).reshape(-1, 16))
    moved = [number for number, row in enumerate(SMILE) if any(row)]
    sparse = {
        "count": len(moved),
        "indices": {"bufferView": writer.view(np.array(moved), "H"), "componentType": KINDS["H"]},
        "values": {"bufferView": writer.view(np.array([SMILE[number] for number in moved]), "f")},
    }
    writer.accessors.append({"componentType": KINDS["f"], "count": 5, "type": "VEC3", "sparse": sparse})
    smile = len(writer.accessors) - 1
    ids = writer.add([10, 11, 12, 13, 14], "I")
    turns = writer.add([[0, 0, 0, 1], [0, 0, HALF, HALF]])
    second = writer.add([0, 1])
    steps = writer.add([[0, 1, 0], [0, 3, 0]])
    spline = writer.add([[0, 0, 0], [0, 2, 0], [1, 0, 0], [0, 0, 0], [0, 2, 0], [0, 0, 0]], width=3)
    shares = writer.add([0, 1, 0.5])
    moments = writer.add([0, 0.5, 1])
    primitive = {
        "attributes": {
            "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs, "JOINTS_0": joints, "WEIGHTS_0": weights, "_ID": ids,
        },
        "indices": faces, "material": 0, "targets": [{"POSITION": smile}],
    }  # fmt: skip
    samplers = [
        {"input": second, "output": turns},
        {"input": second, "output": steps, "interpolation": "STEP"},
        {"input": second, "output": spline, "interpolation": "CUBICSPLINE"},
        {"input": moments, "output": shares},
    ]

    def animation(name: str, *channels: tuple[int, int, str]) -> dict[str, Any]:
        listed = [{"sampler": sampler, "target": {"node": node, "path": path}} for sampler, node, path in channels]
        return {"name": name, "samplers": samplers, "channels": listed}

    tree = writer.tree(
        {
            "scene": 0, "scenes": [{"nodes": [2, 0]}],
            "nodes": [
                {"name": "root", "translation": [0, 1, 0], "children": [1]},
                {"name": "elbow", "translation": [0, 2, 0]},
                {"name": "skin", "mesh": 0, "skin": 0, "translation": [99, 99, 99]},
            ],
            "skins": [{"joints": [0, 1], "inverseBindMatrices": bind}],
            "meshes": [{"name": "arm", "primitives": [primitive], "weights": [0.25], "extras": {"targetNames": ["smile"]}}],
            "materials": [{"name": "shell", "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.4, 0.2, 1]}}],
            "animations": [
                animation("bend", (0, 1, "rotation")),
                animation("hop", (1, 0, "translation"), (2, 1, "translation")),
                animation("smile", (3, 2, "weights")),
            ],
        }
    )  # fmt: skip
    return tree, bytes(writer.data)
