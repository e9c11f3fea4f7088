"""Writes glTF 2.0 files: one buffer with all accessors, and the parts that refer to them. Khronos Group, glTF 2.0 Specification,
2021, sections 3.6 (accessors, alignment, bounds) and 4 (.glb)."""

from __future__ import annotations

import json
import struct
from base64 import b64encode
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.blend_shapes import (
    compute_attribute_offsets,
    compute_knot_shares,
    get_point_attribute,
    list_blend_knots,
    match_points,
)
from antdsl.bodies.agents.definition import Definition, SkinShape
from antdsl.bodies.body import normalise_normals
from antdsl.bodies.files.gltf.gltf_textures import COLOUR_ATTRIBUTE

VERTEX_BUFFER_TARGET, INDEX_BUFFER_TARGET = 34962, 34963  # `target` of a buffer view
_COMPONENT_CODES = {"f4": 5126, "u2": 5123, "u4": 5125, "i2": 5122}
_ACCESSOR_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_JSON_CHUNK_TYPE, _BINARY_CHUNK_TYPE = 0x4E4F534A, 0x004E4942

JsonEntry = dict[str, Any]


class GltfWriter:
    """Writer of one glTF file. It collects the lists of parts and the bytes of the buffer."""

    def __init__(self, generator: str) -> None:
        self.data = bytearray()
        self._asset = {"version": "2.0", "generator": generator}
        self._lists: dict[str, list[JsonEntry]] = {}
        self._extensions: dict[str, JsonEntry] = {}
        self._packed_view: int | None = None  # the buffer view of packed accessors
        self._accessors: dict[tuple[Any, ...], int] = {}  # by their values and use

    def add_part(self, key: str, entry: JsonEntry) -> int:
        """Add a part to one of the lists (`nodes`, `meshes`) and return its number."""
        self._lists.setdefault(key, []).append(entry)
        return len(self._lists[key]) - 1

    def get_part(self, key: str, number: int) -> JsonEntry:
        """Return the part with this number in the list `key`. The caller may extend it."""
        return self._lists[key][number]

    def add_extension(self, name: str, entry: JsonEntry) -> None:
        """Add an entry for the extension `name` at the top level of the file. The extension is marked as optional: readers that
        do not know it may ignore it."""
        self._extensions[name] = entry

    def add_accessor(
        self, values: NDArray[Any], kind: str = "f4", target: int = 0, bounds: bool = False, *, is_packed: bool = False
    ) -> int:
        """Return the number of an accessor for the values (n,) or (n, k). An equal accessor is reused, else a new one is added.

        `kind`: the type in the file, `f4`, `u2`, `u4` or normalized `i2`. `bounds`: whether to write the least and greatest value
        of each column; glTF requires it for positions and times. `is_packed`: whether the accessor may share the buffer view of
        the previous packed accessor, if the two are adjacent."""
        rows = np.ascontiguousarray(values, f"<{kind}").reshape(len(values), -1)
        raw = rows.tobytes()
        key = kind, rows.shape[1], target, bounds, is_packed, blake2b(raw, digest_size=16).digest()
        if key not in self._accessors:
            self._accessors[key] = self._add_accessor(rows, raw, kind, target, bounds, is_packed)
        return self._accessors[key]

    def _add_accessor(self, rows: NDArray[Any], raw: bytes, kind: str, target: int, bounds: bool, is_packed: bool) -> int:
        self.data += bytes(-len(self.data) % 4)
        start = len(self.data)
        self.data += raw
        entry: JsonEntry = {
            "bufferView": self._add_view(start, len(raw), target, is_packed), "componentType": _COMPONENT_CODES[kind],
            "count": len(rows), "type": _ACCESSOR_TYPES[rows.shape[1]],
        }  # fmt: skip
        if offset := start - self.get_part("bufferViews", entry["bufferView"])["byteOffset"]:
            entry["byteOffset"] = offset
        if kind == "i2":
            entry["normalized"] = True
        if bounds:
            entry |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return self.add_part("accessors", entry)

    def _add_view(self, start: int, size: int, target: int, is_packed: bool) -> int:
        """Return the number of a buffer view that contains `size` bytes from `start`. If both this view and the last one are
        packed, the last one is extended. Otherwise, a new view is added."""
        views = self._lists.get("bufferViews", [])
        if is_packed and self._packed_view is not None and self._packed_view == len(views) - 1:
            views[-1]["byteLength"] = start + size - views[-1]["byteOffset"]
            return self._packed_view
        view: JsonEntry = {"buffer": 0, "byteOffset": start, "byteLength": size}
        number = self.add_part("bufferViews", view | ({"target": target} if target else {}))
        self._packed_view = number if is_packed else self._packed_view
        return number

    def to_bytes(self, as_text: bool, **top_entries: Any) -> bytes:
        """Return the bytes of the file: a .gltf with an embedded buffer if `as_text`, else a .glb. `top_entries`: `scene` and
        `extras`."""
        data = bytes(self.data) + bytes(-len(self.data) % 4)
        lists = {key: entries for key, entries in self._lists.items() if entries}
        buffer: JsonEntry = {"byteLength": len(data)}
        if as_text:
            buffer["uri"] = "data:application/octet-stream;base64," + b64encode(data).decode("ascii")
        if self._extensions:
            top_entries |= {"extensionsUsed": sorted(self._extensions), "extensions": self._extensions}
        tree = {"asset": self._asset, **top_entries, **({"buffers": [buffer]} if data else {}), **lists}
        said = json.dumps(tree, separators=(",", ":"), allow_nan=False, ensure_ascii=as_text).encode()
        if as_text:
            return said + b"\n"
        said += b" " * (-len(said) % 4)
        chunks = struct.pack("<II", len(said), _JSON_CHUNK_TYPE) + said
        if data:
            chunks += struct.pack("<II", len(data), _BINARY_CHUNK_TYPE) + data
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


class GltfShapeWriter:
    """Writer of a shape's accessors and meshes. All meshes of the shape share the accessors and differ only in materials."""

    def __init__(self, writer: GltfWriter, body: Definition, shape: SkinShape, normals: NDArray[np.float32] | None) -> None:
        self.writer, self.shape = writer, shape
        self.attributes = {"POSITION": writer.add_accessor(shape.points, "f4", VERTEX_BUFFER_TARGET, bounds=True)}
        if normals is not None:
            self.attributes["NORMAL"] = writer.add_accessor(normalise_normals(normals), "f4", VERTEX_BUFFER_TARGET)
        if shape.uvs is not None:
            self.attributes["TEXCOORD_0"] = writer.add_accessor(shape.uvs, "f4", VERTEX_BUFFER_TARGET)
        colours = shape.attributes.get(COLOUR_ATTRIBUTE)
        if colours is not None and colours.shape == (len(shape.points), 3):
            self.attributes["COLOR_0"] = writer.add_accessor(np.asarray(colours, np.float32), "f4", VERTEX_BUFFER_TARGET)
        for name, values in shape.attributes.items():
            if values.ndim == 1:
                is_integer = values.dtype.kind == "i" and len(values) and values.min() >= 0 and values.max() < 2**32
                if is_integer or values.dtype.kind == "f":
                    self.attributes[f"_{name.upper()}"] = writer.add_accessor(
                        values, "u4" if is_integer else "f4", VERTEX_BUFFER_TARGET
                    )
        self._add_capture()
        self.targets = MorphTargetWriter(body, shape) if shape.blend is not None else None
        self._target_entries = [] if self.targets is None else [self._add_target(*each) for each in self.targets.offsets]
        self._indices_by_material = self._add_material_triangles()

    def _add_capture(self) -> None:
        """Add accessors for the joints that points follow, and for the weights of these joints.

        Each pair of accessors has four joints per point. Joints are in descending order of weight."""
        capture = self.shape.capture
        if capture is None:
            return
        count = capture.joints.shape[1]
        sums = capture.weights.copy()
        for k in range(1, count):  # a joint's first column gets the weights of the others
            same = capture.joints[:, :k] == capture.joints[:, k : k + 1]
            first, is_repeated = np.argmax(same, axis=1), same.any(axis=1)
            sums[np.flatnonzero(is_repeated), first[is_repeated]] += sums[is_repeated, k]
            sums[is_repeated, k] = 0
        order = np.argsort(-sums, axis=1, kind="stable")
        joints, weights = (np.take_along_axis(each, order, axis=1) for each in (capture.joints, sums))
        for k in range(0, count, 4):
            influences = [np.pad(each[:, k : k + 4], ((0, 0), (0, max(0, k + 4 - count)))) for each in (joints, weights)]
            influences[0][influences[1] <= 0] = 0
            self.attributes[f"JOINTS_{k // 4}"] = self.writer.add_accessor(influences[0], "u2", VERTEX_BUFFER_TARGET)
            self.attributes[f"WEIGHTS_{k // 4}"] = self.writer.add_accessor(influences[1], "f4", VERTEX_BUFFER_TARGET)

    def _add_target(self, points: NDArray[np.float32], normals: NDArray[np.float32] | None) -> JsonEntry:
        """Add the accessors of a morph target and return its entry. `points`, `normals`: offsets from the base."""
        entry = {"POSITION": self.writer.add_accessor(points, "f4", VERTEX_BUFFER_TARGET, bounds=True)}
        if normals is not None and "NORMAL" in self.attributes:
            entry["NORMAL"] = self.writer.add_accessor(normals, "f4", VERTEX_BUFFER_TARGET)
        return entry

    def _add_material_triangles(self) -> list[tuple[str, int]]:
        """Return (material, accessor) pairs in order of material number. The accessor holds the vertex indices of the material's
        triangles."""
        shape = self.shape
        names = shape.materials or ("",)
        of = np.zeros(len(shape.faces), np.int64) if shape.material is None else shape.material.astype(np.int64)
        kind = "u2" if len(shape.points) < 65535 else "u4"
        return [
            (names[number], self.writer.add_accessor(shape.faces[of == number].reshape(-1), kind, INDEX_BUFFER_TARGET))
            for number in sorted(set(of.tolist()))
        ]

    def add_mesh(self, name: str, materials: dict[str, int]) -> int:
        """Add a mesh of the shape and return its number. `materials`: the numbers of materials by name. Triangles with other
        materials get no material."""
        primitives = []
        for material, indices in self._indices_by_material:
            primitive: JsonEntry = {"attributes": self.attributes, "indices": indices}
            if material in materials:
                primitive["material"] = materials[material]
            if self._target_entries:
                primitive["targets"] = self._target_entries
            primitives.append(primitive)
        entry: JsonEntry = {"name": name, "primitives": primitives}
        if self.targets is not None:
            entry["extras"] = {"targetNames": list(self.targets.names)}
        return self.writer.add_part("meshes", entry)

    def measure_radii(self, joints: tuple[str, ...]) -> NDArray[np.float64]:
        """Return, for each of `joints`, its largest distance from a point that follows it. Offsets by morph targets are taken
        into account."""
        capture, shape = self.shape.capture, self.shape
        assert capture is not None
        at = np.einsum("pkij,pj->pki", capture.inverse_matrices[capture.joints][..., :3, :3], shape.points.astype(np.float64))
        at += capture.inverse_matrices[capture.joints][..., :3, 3]
        distances = np.where(capture.weights > 0, np.sqrt((at**2).sum(axis=2)) + self._measure_offsets(), 0.0)
        captured = np.zeros(len(capture.names))
        np.maximum.at(captured, capture.joints, distances)
        by_name = dict(zip(capture.names, captured.tolist(), strict=True))
        return np.array([by_name.get(name, 0.0) for name in joints])

    def measure_radius(self) -> float:
        """Return the largest distance of a point from the origin. Offsets by morph targets are taken into account."""
        distances = np.sqrt((self.shape.points.astype(np.float64) ** 2).sum(axis=1))
        return float(distances.max(initial=0.0)) + self._measure_offsets()

    def _measure_offsets(self) -> float:
        """Return an upper bound of the distance that morph targets move a point if all weights are at most 1."""
        targets = [] if self.targets is None else self.targets.offsets
        return sum(float(np.sqrt((offsets**2).sum(axis=1)).max(initial=0.0)) for offsets, _ in targets)

    @property
    def capsule_joints(self) -> tuple[str, ...]:
        """Return the names of the joints that move at least one point of the shape."""
        capture = self.shape.capture
        assert capture is not None
        return tuple(capture.names[k] for k in np.unique(capture.joints[capture.weights > 0]).tolist())

    def add_skin(self, nodes: dict[str, int], top: int) -> int:
        """Add the skin of the shape, and return its number.

        `nodes`: node numbers of joints by name. `top`: the node above the joints."""
        capture = self.shape.capture
        assert capture is not None
        inverse = self.writer.add_accessor(capture.inverse_matrices.transpose(0, 2, 1).reshape(-1, 16))
        joints = [nodes[name] for name in capture.names]
        return self.writer.add_part("skins", {"joints": joints, "inverseBindMatrices": inverse, "skeleton": top})


class MorphTargetWriter:
    """Writer of the morph targets of a blend shape. It also computes the weights of the targets from channel values.

    Each input and each in-between becomes one target: its offset from the base. In-betweens need separate targets because glTF
    can only add up weighted targets. `compute_knot_shares` gives the weights."""

    def __init__(self, body: Definition, shape: SkinShape) -> None:
        assert shape.blend is not None
        self.names: list[str] = []
        self.offsets: list[tuple[NDArray[np.float32], NDArray[np.float32] | None]] = []
        self._inputs: list[tuple[int, NDArray[np.float64]]] = []  # channel, and weights of its shapes
        self.is_one_per_channel = True  # whether there is exactly one target per channel
        for name, channel in zip(shape.blend.shapes, shape.blend.channels, strict=True):
            targets, knots = list_blend_knots(body, name)
            self._inputs.append((body.rig.find_channel(channel), knots))
            self.is_one_per_channel &= len(targets) == 1
            for target in targets:
                self.names.append(target.name)
                moved = [self._compute_offset(shape, target, each, each in shape.blend.attributes) for each in "PN"]
                assert moved[0] is not None
                self.offsets.append((moved[0], moved[1]))

    @staticmethod
    def _compute_offset(shape: SkinShape, target: SkinShape, attribute: str, is_blended: bool) -> NDArray[np.float32] | None:
        """Return the offsets (P, 3) of `attribute` from a shape to a target. If the attribute is not blended, return zeros for
        `P` and None for `N`."""
        if not is_blended or get_point_attribute(shape, attribute) is None or get_point_attribute(target, attribute) is None:
            return np.zeros((len(shape.points), 3), np.float32) if attribute == "P" else None
        assert shape.blend is not None
        base_points, target_points = match_points(shape, target, shape.blend.point_id)
        offsets = np.zeros((len(shape.points), 3), np.float32)
        offsets[base_points] = compute_attribute_offsets(shape, target, attribute, base_points, target_points).T
        return offsets

    def compute_weights(self, channels: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the weights (n, targets) of the morph targets of n agents or samples. `channels`: (n, C), the values of the
        rig's channels."""
        shares = [compute_knot_shares(channels[:, number], knots) for number, knots in self._inputs]
        return np.concatenate(shares).T if shares else np.zeros((len(channels), 0), np.float32)
