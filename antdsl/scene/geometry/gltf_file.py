"""Reads glTF 2.0 files (.gltf, .glb): their JSON, and their accessors as arrays.

Counts, offsets and sizes are compared with the buffers and the limits before anything is allocated. Khronos Group, glTF 2.0
Specification, 2021, sections 3.6 and 4."""

from __future__ import annotations

import binascii
import json
import struct
from base64 import b64decode
from collections.abc import Callable, Iterable
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.diagnostics.model import replace_unprintable
from antdsl.scene.geometry.arrays import convert_to_float64
from antdsl.scene.geometry.polygons import split_triangle_strips

_DTYPE_BY_COMPONENT = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPONENTS_BY_TYPE = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_EXPORT_AGAIN_HELP = "export it again, as glTF 2.0"
_MAX_NODES = 65_536
TRIANGLES_PRIMITIVE_MODE, TRIANGLE_STRIP_PRIMITIVE_MODE, TRIANGLE_FAN_PRIMITIVE_MODE = 4, 5, 6  # modes of primitives
# Extensions that a reader must support to understand a file at all. Others change the appearance and are ignored.
_UNSUPPORTED_EXTENSIONS = {
    "KHR_draco_mesh_compression": "Draco",
    "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
}
_IGNORED_EXTENSIONS = (
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_materials_",
    "KHR_lights_punctual",
    "EXT_texture_",
    "KHR_texture_",
)


class GltfError(Exception):
    """Error for a file that cannot be used. The message is a reason that fits after the file's name.

    `code`: the diagnostic's code, if it differs from the reader's usual one. `help`: what to do instead."""

    def __init__(self, message: str, help: str | None = None, code: str = "") -> None:
        super().__init__(message)
        self.help, self.code = help, code


class GltfDocument:
    """A glTF file with checked access to its JSON. Every access validates indices and types, and raises GltfError with the
    reason."""

    def __init__(self, data: bytes, read_sibling: Callable[[str, int], bytes]) -> None:
        """Parse the bytes of a file. `read_sibling(path, max_bytes)`: returns the bytes of a file in the same folder, which has
        at most `max_bytes` bytes."""
        text, self._binary = _split_chunks(data)
        self.tree = _parse_json(text)
        self._read_sibling = read_sibling
        self._remaining_bytes = limits.MAX_BODY_FILE_BYTES
        self._buffers: dict[int, bytes] = {}
        self._cached_accessors: dict[int, NDArray[Any]] = {}
        self._decoded_bytes = 0
        self._top_lists: dict[str, list[dict[str, Any]]] = {}
        version = str(self.get_object(self.tree, "asset").get("version", ""))
        if not version.startswith("2."):
            raise GltfError(f"is glTF {version[:10] or 'without a version'}; only 2.0 is supported", _EXPORT_AGAIN_HELP)
        for name in map(str, self.get_list(self.tree, "extensionsRequired")):
            if name in _UNSUPPORTED_EXTENSIONS:
                raise GltfError(
                    f"is compressed with {_UNSUPPORTED_EXTENSIONS[name]}, which is not read", "export it without compression"
                )
            if not name.startswith(_IGNORED_EXTENSIONS):
                raise GltfError(f"needs the extension `{name[:60]}`, which is not read", "export it without")

    # ---- JSON

    def get_object(self, holder: dict[str, Any], key: str) -> dict[str, Any]:
        """Return the object at a key of `holder`. It is empty if the key is absent."""
        value = holder.get(key, {})
        if not isinstance(value, dict):
            raise GltfError(f"has a `{key}` that is not an object", _EXPORT_AGAIN_HELP)
        return value

    def get_list(self, holder: dict[str, Any], key: str) -> list[Any]:
        """Return the list at a key of `holder`. It is empty if the key is absent."""
        items = holder.get(key, [])
        if not isinstance(items, list):
            raise GltfError(f"has `{key}` that are not a list", _EXPORT_AGAIN_HELP)
        return items

    def get_objects(self, holder: dict[str, Any], key: str) -> list[dict[str, Any]]:
        """Return the list of objects at a key of `holder`. It is empty if the key is absent."""
        items = self.get_list(holder, key)
        if not all(isinstance(each, dict) for each in items):
            raise GltfError(f"has `{key}` that are not objects", _EXPORT_AGAIN_HELP)
        return items

    def get_index(self, holder: dict[str, Any], key: str, count: int) -> int | None:
        """Return the index at a key, or None if the key is absent. Raises GltfError unless the index is below `count`."""
        return None if key not in holder else self.check_index(holder[key], key, count)

    def check_index(self, value: Any, kind: str, count: int) -> int:
        """Return a value as an index. Raises GltfError unless it is below `count`. `kind`: the kind of index, for messages."""
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
            raise GltfError(f"names `{kind}` {str(value)[:20]}, but has only {count:,}", _EXPORT_AGAIN_HELP)
        return value

    def get_top_list(self, key: str) -> list[dict[str, Any]]:
        """Return a top-level list of the file, such as `nodes`. It is checked on first use."""
        if key not in self._top_lists:
            self._top_lists[key] = self.get_objects(self.tree, key)
        return self._top_lists[key]

    def get_floats(self, holder: dict[str, Any], key: str, default: tuple[float, ...]) -> NDArray[np.float64]:
        """Return the numbers at a key, or `default` if the key is absent. There must be as many numbers as in `default`."""
        numbers = holder.get(key, default)
        right = isinstance(numbers, list | tuple) and len(numbers) == len(default)
        if not right or not all(isinstance(x, int | float) and not isinstance(x, bool) and abs(x) < 1e30 for x in numbers):
            raise GltfError(f"has a `{key}` that is not {len(default)} numbers", _EXPORT_AGAIN_HELP)
        return np.array(numbers, np.float64)

    def get_name(self, holder: dict[str, Any], default: str) -> str:
        """Return the name of an object in a form that is safe to display and write, or `default` if it has no name."""
        text = holder.get("name")
        if not isinstance(text, str) or not text.strip():
            return default
        return replace_unprintable(text[:200])

    # ---- arrays

    def read_accessor(self, number: Any, width: int | None = None) -> NDArray[Any]:
        """Return the values (count, width) of an accessor: float64 for floats and for normalized integers, int64 otherwise."""
        accessors = self.get_top_list("accessors")
        number = self.check_index(number, "accessor", len(accessors))
        if number not in self._cached_accessors:
            self._cached_accessors[number] = self._decode_accessor(accessors[number], number)
        values = self._cached_accessors[number]
        if width is not None and values.shape[1] != width:
            raise GltfError(f"has an accessor {number} of {values.shape[1]} numbers where {width} are needed", _EXPORT_AGAIN_HELP)
        return values

    def _decode_accessor(self, accessor: dict[str, Any], number: int) -> NDArray[Any]:
        kind, width = (
            _DTYPE_BY_COMPONENT.get(_check_integer(accessor.get("componentType"))),
            _COMPONENTS_BY_TYPE.get(str(accessor.get("type"))),
        )
        count = accessor.get("count")
        if kind is None or width is None or isinstance(count, bool) or not isinstance(count, int) or count < 0:
            raise GltfError(f"has an accessor {number} of a kind that is not known", _EXPORT_AGAIN_HELP)
        size = np.dtype(kind).itemsize * width
        self._decoded_bytes += count * max(size, 8 * width)
        if self._decoded_bytes > 4 * limits.MAX_BODY_FILE_BYTES:
            raise GltfError(f"has an accessor {number} of {count:,} values, more than the limit", code="too-large")
        if width == 16 and np.dtype(kind).itemsize < 4:
            raise GltfError(f"has an accessor {number} of a kind that is not known", _EXPORT_AGAIN_HELP)
        if "bufferView" in accessor:
            raw = self._read_rows(accessor["bufferView"], accessor.get("byteOffset", 0), count, kind, width)
        else:
            raw = np.zeros((count, width), kind)
        if "sparse" in accessor:
            raw = self._apply_sparse_values(self.get_object(accessor, "sparse"), raw, kind, width)
        if kind == "<f4":
            return convert_to_float64(raw)
        integers = raw.astype(np.int64)
        if accessor.get("normalized") is not True:
            return integers
        return np.maximum(integers / float(np.iinfo(kind).max), -1.0)

    def _apply_sparse_values(self, sparse: dict[str, Any], raw: NDArray[Any], kind: str, width: int) -> NDArray[Any]:
        indices, values, count = self.get_object(sparse, "indices"), self.get_object(sparse, "values"), sparse.get("count")
        index_kind = _DTYPE_BY_COMPONENT.get(_check_integer(indices.get("componentType")))
        if index_kind is None or isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= len(raw):
            raise GltfError("has a sparse accessor that is invalid", _EXPORT_AGAIN_HELP)
        rows = self._read_rows(indices.get("bufferView"), indices.get("byteOffset", 0), count, index_kind, 1)[:, 0].astype(
            np.int64
        )
        if len(rows) and (rows.min() < 0 or rows.max() >= len(raw)):
            raise GltfError("has a sparse accessor that refers to missing values", _EXPORT_AGAIN_HELP)
        dense_values = raw.copy()
        dense_values[rows] = self._read_rows(values.get("bufferView"), values.get("byteOffset", 0), count, kind, width)
        return dense_values

    def _read_rows(self, view: Any, start: Any, count: int, kind: str, width: int) -> NDArray[Any]:
        """Return `count` rows of a buffer view. `start`: the byte at which the first row begins."""
        views = self.get_top_list("bufferViews")
        buffer_view = views[self.check_index(view, "bufferView", len(views))]
        offset, length, stride = buffer_view.get("byteOffset", 0), buffer_view.get("byteLength"), buffer_view.get("byteStride", 0)
        size = np.dtype(kind).itemsize * width
        for value in (start, offset, length, stride):
            if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**40:
                raise GltfError("has a buffer view that is invalid", _EXPORT_AGAIN_HELP)
        stride = stride or size
        if stride < size or (count and start + stride * (count - 1) + size > length):
            raise GltfError(f"has a buffer view of {length:,} bytes, too few for its content", "a part of it is missing")
        data = self._read_buffer(buffer_view.get("buffer"))
        if offset + length > len(data):
            raise GltfError(f"has a buffer of {len(data):,} bytes, too few for what is in it", "a part of it is missing")
        if not count:
            return np.empty((0, width), kind)
        raw = np.ndarray((count, width), kind, data, offset + start, (stride, np.dtype(kind).itemsize))
        return np.ascontiguousarray(raw)

    def read_image_bytes(self, number: int) -> bytes:
        """Return the bytes of an image, from a buffer or from a file in the folder of the glTF file."""
        image = self.get_top_list("images")[number]
        if "bufferView" not in image:
            return self._fetch_buffer(image, number)
        views = self.get_top_list("bufferViews")
        length = views[self.check_index(image["bufferView"], "bufferView", len(views))].get("byteLength")
        if isinstance(length, bool) or not isinstance(length, int) or length < 0:
            raise GltfError("has a buffer view that is invalid", _EXPORT_AGAIN_HELP)
        return self._read_rows(image["bufferView"], 0, length, "u1", 1).tobytes()

    def _read_buffer(self, number: Any) -> bytes:
        buffers = self.get_top_list("buffers")
        number = self.check_index(number, "buffer", len(buffers))
        if number not in self._buffers:
            data = self._fetch_buffer(buffers[number], number)
            self._remaining_bytes -= len(data)
            if self._remaining_bytes < 0:
                raise GltfError(f"has buffers of more than {limits.MAX_BODY_FILE_BYTES:,} bytes", code="too-large")
            self._buffers[number] = data
        return self._buffers[number]

    def _fetch_buffer(self, buffer: dict[str, Any], number: int) -> bytes:
        uri = buffer.get("uri")
        if uri is None and number == 0 and self._binary is not None:
            return self._binary
        if not isinstance(uri, str):
            raise GltfError(f"has a buffer {number} without data", "a part of it is missing")
        if uri[:5].lower() == "data:":
            head, comma, body = uri.partition(",")
            if not comma or not head.lower().endswith(";base64"):
                raise GltfError(f"has a buffer {number} that is not written as base64", _EXPORT_AGAIN_HELP)
            try:
                return b64decode(body, validate=True)
            except (binascii.Error, ValueError):
                raise GltfError(f"has a buffer {number} that is not written as base64", _EXPORT_AGAIN_HELP) from None
        return self._read_sibling(unquote(uri), self._remaining_bytes)


def _check_integer(value: Any) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) else -1


def _split_chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """Return the bytes of the JSON and, for a .glb file, of the binary chunk."""
    if data[:4] != b"glTF":
        return data, None
    if len(data) < 20:
        raise GltfError("ends before its header", "a part of it is missing")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise GltfError(f"is a binary glTF {version}; only version 2 is supported", _EXPORT_AGAIN_HELP)
    if length > len(data):
        raise GltfError(f"declares {length:,} bytes, and has {len(data):,}", "a part of it is missing")
    chunks: list[tuple[int, bytes]] = []
    at = 12
    while at + 8 <= length and len(chunks) < 64:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise GltfError("has a chunk that extends beyond its end", "a part of it is missing")
        chunks.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    if not chunks or chunks[0][0] != 0x4E4F534A:
        raise GltfError("has no JSON", _EXPORT_AGAIN_HELP)
    binary = next((body for kind, body in chunks[1:] if kind == 0x004E4942), None)
    return chunks[0][1], binary


def _parse_json(text: bytes) -> dict[str, Any]:
    if len(text) > limits.MAX_BODY_JSON_BYTES:
        words = f"has more than {limits.MAX_BODY_JSON_BYTES:,} bytes of JSON"
        raise GltfError(words, "write its buffers to a .bin file", "too-large")
    try:
        document = json.loads(text.decode("utf-8-sig"), parse_constant=_reject_json_constant)
    except (ValueError, RecursionError):
        raise GltfError("is not glTF: its JSON cannot be read", _EXPORT_AGAIN_HELP) from None
    if not isinstance(document, dict):
        raise GltfError("is not glTF: its JSON is not an object", _EXPORT_AGAIN_HELP)
    return document


def _reject_json_constant(word: str) -> float:
    raise ValueError(word)


# ---- nodes


def find_node_parents(file: GltfDocument) -> list[int]:
    """Return the parent of each node, or -1 for a root. Raises GltfError if the nodes are not a forest of trees."""
    nodes = file.get_top_list("nodes")
    if len(nodes) > _MAX_NODES:
        raise GltfError(f"has {len(nodes):,} nodes, more than the limit", code="too-large")
    parents = [-1] * len(nodes)
    for number, node in enumerate(nodes):
        for child in file.get_list(node, "children"):
            child = file.check_index(child, "node", len(nodes))
            if parents[child] >= 0 or child == number:
                raise GltfError(f"has a node {child} with two parents", _EXPORT_AGAIN_HELP, "bad-rig")
            parents[child] = number
    state = [0] * len(nodes)  # 1: on the current path, 2: known to lead to a root
    for start in range(len(nodes)):
        path: list[int] = []
        at = start
        while at >= 0 and state[at] == 0:
            state[at] = 1
            path.append(at)
            at = parents[at]
        if at >= 0 and state[at] == 1:
            raise GltfError(f"has nodes that hang below each other in a circle, {at} among them", _EXPORT_AGAIN_HELP, "bad-rig")
        for each in path:
            state[each] = 2
    return parents


def find_scene_roots(file: GltfDocument) -> list[int]:
    """Return the root nodes of the file's scene. The result is empty if the file has no scene."""
    nodes, scenes = file.get_top_list("nodes"), file.get_top_list("scenes")
    scene = file.get_index(file.tree, "scene", len(scenes)) or 0
    return [file.check_index(root, "node", len(nodes)) for root in file.get_list(scenes[scene], "nodes")] if scenes else []


def find_nodes_below(file: GltfDocument, roots: Iterable[int]) -> list[int]:
    """Return `roots` and all of their descendants. Each node comes after its parent. Children are in the order of the file."""
    nodes, ordered_nodes = file.get_top_list("nodes"), []
    visited: set[int] = set()
    waiting = list(reversed(list(roots)))
    while waiting:
        ordered_nodes.append(waiting.pop())
        waiting += reversed(file.get_list(nodes[ordered_nodes[-1]], "children"))
        if ordered_nodes[-1] in visited:
            raise GltfError("has a scene that names a node twice", _EXPORT_AGAIN_HELP)
        visited.add(ordered_nodes[-1])
    return ordered_nodes


# ---- triangles


def make_primitive_triangles(file: GltfDocument, primitive: dict[str, Any], points: int) -> tuple[NDArray[np.int64], int]:
    """Return the triangles (n, 3) of a primitive with `points` points. The primitive is a list, a strip or a fan of triangles.

    Also return how many corners are left over at the end, because they are too few for another triangle."""
    corners = file.read_accessor(primitive["indices"], 1)[:, 0].astype(np.int64) if "indices" in primitive else np.arange(points)
    mode = primitive.get("mode", TRIANGLES_PRIMITIVE_MODE)
    if mode == TRIANGLE_STRIP_PRIMITIVE_MODE:
        triangles = split_triangle_strips(corners)
    elif mode == TRIANGLES_PRIMITIVE_MODE or len(corners) < 3:
        triangles = corners[: len(corners) // 3 * 3].reshape(-1, 3)
    else:
        triangles = np.stack([corners[1:-1], corners[2:], np.full(len(corners) - 2, corners[0])], axis=1)
    over = len(corners) % 3 if mode == TRIANGLES_PRIMITIVE_MODE or len(corners) < 3 else 0
    if len(triangles) > limits.MAX_MESH_FACES:
        raise GltfError(f"has more than {limits.MAX_MESH_FACES:,} triangles", code="too-large")
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= points):
        raise GltfError("has a triangle that names a missing point", _EXPORT_AGAIN_HELP)
    return triangles, over
