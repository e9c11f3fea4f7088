"""Writes glTF 2.0 files: accessors in sequence in one buffer, and the parts that refer to them. Khronos Group, glTF 2.0
Specification, 2021, sections 3.6 (accessors, alignment, bounds) and 4 (.glb)."""

from __future__ import annotations

import json
import struct
from base64 import b64encode
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.blend_shapes import attribute_difference, knots_of, match_points, shares_of, values_of
from antdsl.bodies.agents.definition import Definition, Shape
from antdsl.bodies.body import unit_normals
from antdsl.bodies.files.gltf_textures import COLOUR

VERTICES, INDICES = 34962, 34963  # `target` of a buffer view
_COMPONENTS = {"f4": 5126, "u2": 5123, "u4": 5125}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_JSON, _BIN = 0x4E4F534A, 0x004E4942

Entry = dict[str, Any]


class GltfWriter:
    """The lists of a file's parts, and its buffer."""

    def __init__(self, generator: str) -> None:
        self.data = bytearray()
        self._asset = {"version": "2.0", "generator": generator}
        self._lists: dict[str, list[Entry]] = {}

    def add(self, key: str, entry: Entry) -> int:
        """Add a part to one of the lists (`nodes`, `meshes`) and return its number."""
        self._lists.setdefault(key, []).append(entry)
        return len(self._lists[key]) - 1

    def entry(self, key: str, number: int) -> Entry:
        """Return a part that was added, so that the caller can extend it."""
        return self._lists[key][number]

    def accessor(self, values: NDArray[Any], kind: str = "f4", target: int = 0, bounds: bool = False) -> int:
        """Add an accessor with values (n,) or (n, k) as `f4`, `u2` or `u4`, and return its number. `bounds`: write the least and
        greatest value of each column; positions and times must have these."""
        rows = np.ascontiguousarray(values, f"<{kind}").reshape(len(values), -1)
        self.data += bytes(-len(self.data) % 4)
        raw = rows.tobytes()
        view: Entry = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw)}
        self.data += raw
        entry: Entry = {
            "bufferView": self.add("bufferViews", view | ({"target": target} if target else {})),
            "componentType": _COMPONENTS[kind], "count": len(rows), "type": _TYPES[rows.shape[1]],
        }  # fmt: skip
        if bounds:
            entry |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return self.add("accessors", entry)

    def bytes(self, text: bool, **top_entries: Any) -> bytes:
        """Return the bytes of the file: a .gltf with an embedded buffer if `text`, else a .glb. `top_entries`: `scene` and
        `extras`."""
        data = bytes(self.data) + bytes(-len(self.data) % 4)
        lists = {key: entries for key, entries in self._lists.items() if entries}
        buffer: Entry = {"byteLength": len(data)}
        if text:
            buffer["uri"] = "data:application/octet-stream;base64," + b64encode(data).decode("ascii")
        tree = {"asset": self._asset, **top_entries, **({"buffers": [buffer]} if data else {}), **lists}
        said = json.dumps(tree, separators=(",", ":"), allow_nan=False, ensure_ascii=text).encode()
        if text:
            return said + b"\n"
        said += b" " * (-len(said) % 4)
        chunks = struct.pack("<II", len(said), _JSON) + said
        if data:
            chunks += struct.pack("<II", len(data), _BIN) + data
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


class ShapeParts:
    """The accessors of a shape. All meshes of the shape share them: their `primitives` differ only in materials."""

    def __init__(self, writer: GltfWriter, body: Definition, shape: Shape, normals: NDArray[np.float32] | None) -> None:
        self.writer, self.shape = writer, shape
        self.attributes = {"POSITION": writer.accessor(shape.points, "f4", VERTICES, bounds=True)}
        if normals is not None:
            self.attributes["NORMAL"] = writer.accessor(unit_normals(normals), "f4", VERTICES)
        if shape.uvs is not None:
            self.attributes["TEXCOORD_0"] = writer.accessor(shape.uvs, "f4", VERTICES)
        colours = shape.attributes.get(COLOUR)
        if colours is not None and colours.shape == (len(shape.points), 3):
            self.attributes["COLOR_0"] = writer.accessor(np.asarray(colours, np.float32), "f4", VERTICES)
        for name, values in shape.attributes.items():
            if values.ndim == 1:
                is_integer = values.dtype.kind == "i" and len(values) and values.min() >= 0 and values.max() < 2**32
                if is_integer or values.dtype.kind == "f":
                    self.attributes[f"_{name.upper()}"] = writer.accessor(values, "u4" if is_integer else "f4", VERTICES)
        self._add_capture()
        self.targets = Targets(body, shape) if shape.blend is not None else None
        self._moved = [] if self.targets is None else [self._add_target(*each) for each in self.targets.moved]
        self._kinds = self._by_material()

    def _add_capture(self) -> None:
        """Write the joints that points follow, in sets of four, sorted by descending weight."""
        capture = self.shape.capture
        if capture is None:
            return
        count = capture.joints.shape[1]
        order = np.argsort(-capture.weights, axis=1, kind="stable")
        joints, weights = (np.take_along_axis(each, order, axis=1) for each in (capture.joints, capture.weights))
        for k in range(0, count, 4):
            influences = [np.pad(each[:, k : k + 4], ((0, 0), (0, max(0, k + 4 - count)))) for each in (joints, weights)]
            influences[0][influences[1] <= 0] = 0
            self.attributes[f"JOINTS_{k // 4}"] = self.writer.accessor(influences[0], "u2", VERTICES)
            self.attributes[f"WEIGHTS_{k // 4}"] = self.writer.accessor(influences[1], "f4", VERTICES)

    def _add_target(self, points: NDArray[np.float32], normals: NDArray[np.float32] | None) -> Entry:
        """Add the accessors of a morph target and return its entry. `points`, `normals`: offsets from the base."""
        entry = {"POSITION": self.writer.accessor(points, "f4", VERTICES, bounds=True)}
        if normals is not None and "NORMAL" in self.attributes:
            entry["NORMAL"] = self.writer.accessor(normals, "f4", VERTICES)
        return entry

    def _by_material(self) -> list[tuple[str, int]]:
        """Return the materials of the triangles by ascending number, each with the accessor of its triangles' corners."""
        shape = self.shape
        names = shape.materials or ("",)
        of = np.zeros(len(shape.faces), np.int64) if shape.material is None else shape.material.astype(np.int64)
        kind = "u2" if len(shape.points) < 65535 else "u4"
        return [
            (names[number], self.writer.accessor(shape.faces[of == number].reshape(-1), kind, INDICES))
            for number in sorted(set(of.tolist()))
        ]

    def mesh(self, name: str, materials: dict[str, int]) -> int:
        """Add a mesh and return its number. `materials`: numbers by name; a name that is not in it gets no material."""
        primitives = []
        for material, indices in self._kinds:
            primitive: Entry = {"attributes": self.attributes, "indices": indices}
            if material in materials:
                primitive["material"] = materials[material]
            if self._moved:
                primitive["targets"] = self._moved
            primitives.append(primitive)
        entry: Entry = {"name": name, "primitives": primitives}
        if self.targets is not None:
            entry["extras"] = {"targetNames": list(self.targets.names)}
        return self.writer.add("meshes", entry)

    def add_skin(self, nodes: dict[str, int], top: int) -> int:
        """Add the skin with which the shape follows its joints, and return its number. `nodes`: node numbers of joints by
        name."""
        capture = self.shape.capture
        assert capture is not None
        if not hasattr(self, "_inverse"):
            self._inverse = self.writer.accessor(capture.inverse.transpose(0, 2, 1).reshape(-1, 16))
        joints = [nodes[name] for name in capture.names]
        return self.writer.add("skins", {"joints": joints, "inverseBindMatrices": self._inverse, "skeleton": top})


class Targets:
    """The morph targets of a blend shape, and their weights at given channel values. A target is the difference of an input, or
    of an in-between, from the base. glTF adds targets linearly. An in-between is a separate target, weighted by its share in
    `blend_shapes`."""

    def __init__(self, body: Definition, shape: Shape) -> None:
        assert shape.blend is not None
        self.names: list[str] = []
        self.moved: list[tuple[NDArray[np.float32], NDArray[np.float32] | None]] = []
        self._inputs: list[tuple[int, NDArray[np.float64]]] = []  # channel, weights of its shapes
        self.plain = True  # exactly one target per channel
        for name, channel in zip(shape.blend.shapes, shape.blend.channels, strict=True):
            targets, knots = knots_of(body, name)
            self._inputs.append((body.rig.channel(channel), knots))
            self.plain &= len(targets) == 1
            for target in targets:
                self.names.append(target.name)
                moved = [self._attribute_offset(shape, target, each, each in shape.blend.attributes) for each in "PN"]
                assert moved[0] is not None
                self.moved.append((moved[0], moved[1]))

    @staticmethod
    def _attribute_offset(shape: Shape, target: Shape, which: str, blended: bool) -> NDArray[np.float32] | None:
        """Return the offsets (P, 3) of attribute `which`; zeros or None if it is not blended."""
        if not blended or values_of(shape, which) is None or values_of(target, which) is None:
            return np.zeros((len(shape.points), 3), np.float32) if which == "P" else None
        assert shape.blend is not None
        base_points, target_points = match_points(shape, target, shape.blend.point_id)
        offsets = np.zeros((len(shape.points), 3), np.float32)
        offsets[base_points] = attribute_difference(shape, target, which, base_points, target_points).T
        return offsets

    def weights(self, channels: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the weights (n, targets) at values `channels` (n, C) of the rig's channels."""
        shares = [shares_of(channels[:, number], knots) for number, knots in self._inputs]
        return np.concatenate(shares).T if shares else np.zeros((len(channels), 0), np.float32)
