"""Reads all meshes of a glTF file (.gltf, .glb) as one mesh, in metres with y up.

The transforms of nodes are applied. Triangles, strips and fans are read. Khronos Group, glTF 2.0 Specification, 2021, sections
3.5 and 3.7."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.diagnostics.model import replace_unprintable
from antdsl.scene.geometry import gltf_file
from antdsl.scene.geometry.import_notes import ImportNotes
from antdsl.scene.geometry.matrices import (
    apply_transforms,
    compose_transforms,
    compute_determinant,
    make_identity_transforms,
    make_transform,
)
from antdsl.scene.geometry.mesh_text import MAX_VERTICES, MeshError
from antdsl.scene.geometry.polygons import PolygonMesh

Floats = NDArray[np.float64]
SiblingReader = Callable[[str, int], bytes]

_DRACO_EXTENSION = "KHR_draco_mesh_compression"
_INSTANCING_EXTENSION = "EXT_mesh_gpu_instancing"
_VISIBILITY_EXTENSION = "KHR_node_visibility"
_NON_SURFACE_MODES = ("points", "lines", "lines", "lines")


def read_gltf_mesh(data: bytes, notes: ImportNotes, node_name: str | None, read_sibling: SiblingReader) -> PolygonMesh:
    """Return all meshes of the file's scene as one mesh. Raises MeshError with the reason if this fails.

    `node_name`: read only nodes with this name or with a mesh of this name, and all nodes below them. None reads everything.
    `read_sibling(path, max_bytes)`: returns the bytes of a file in the same folder."""
    notes.form = "binary glTF" if data[:4] == b"glTF" else "glTF"
    try:
        with np.errstate(all="ignore"):
            return _read_scene(gltf_file.GltfDocument(data, read_sibling), notes, node_name)
    except gltf_file.GltfError as error:
        raise MeshError(str(error), error.help) from None


def _read_scene(file: gltf_file.GltfDocument, notes: ImportNotes, node_name: str | None) -> PolygonMesh:
    nodes, meshes = file.get_top_list("nodes"), file.get_top_list("meshes")
    parents = gltf_file.find_node_parents(file)
    roots = gltf_file.find_scene_roots(file) or [number for number, parent in enumerate(parents) if parent < 0]
    scene_nodes = gltf_file.find_nodes_below(file, roots)
    chosen = set(scene_nodes) if node_name is None else _find_named_nodes(file, scene_nodes, node_name)
    notes.count_skipped("animations", len(file.get_top_list("animations")))
    in_scene = set(scene_nodes)
    others = [number for number, node in enumerate(nodes) if "mesh" in node and number not in in_scene]
    if node_name is None and others:
        notes.count_skipped("nodes with a mesh outside of the scene", len(others))
    hidden = set(
        gltf_file.find_nodes_below(file, _find_topmost_nodes([n for n in scene_nodes if _is_hidden(file, nodes[n])], parents))
    )
    unseen = sum("mesh" in nodes[number] for number in hidden & chosen)
    notes.count_skipped(f"nodes with a mesh that are not visible ({_VISIBILITY_EXTENSION})", unseen)
    chosen -= hidden
    transforms: dict[int, Floats] = {}
    points: list[Floats] = []
    faces: list[NDArray[np.int64]] = []
    count = 0
    for number in scene_nodes:
        node = nodes[number]
        above = transforms.get(parents[number], make_identity_transforms())
        transforms[number] = compose_transforms(above, _compute_node_transform(file, node))
        mesh = file.get_index(node, "mesh", len(meshes))
        if number not in chosen or mesh is None:
            continue
        transform = transforms[number]
        if "skin" in node:  # the specification ignores the transform of the node itself
            notes.count_skipped(f"the skin of `{file.get_name(node, 'a node')}`: its mesh is read as it was modelled")
            transform = make_identity_transforms()
        if _INSTANCING_EXTENSION in file.get_object(node, "extensions"):
            notes.count_skipped("instances of a mesh (EXT_mesh_gpu_instancing)")
        for primitive in file.get_objects(meshes[mesh], "primitives"):
            geometry = _read_primitive(file, primitive, notes)
            if geometry is None:
                continue
            own, triangles = geometry
            points.append(apply_transforms(transform, own))
            faces.append((triangles[:, [0, 2, 1]] if compute_determinant(transform) < 0 else triangles) + count)
            count += len(own)
            if count > MAX_VERTICES or sum(map(len, faces)) > limits.MAX_MESH_FACES:
                raise MeshError(f"has more than {limits.MAX_MESH_FACES:,} faces", "use a lighter mesh")
    if not points:
        return PolygonMesh(np.empty((0, 3)), np.empty(0, np.int64), np.empty(0, np.int64))
    return PolygonMesh.from_triangles(np.concatenate(points), np.concatenate(faces))


def _is_hidden(file: gltf_file.GltfDocument, node: dict[str, Any]) -> bool:
    return file.get_object(file.get_object(node, "extensions"), _VISIBILITY_EXTENSION).get("visible", True) is False


def _find_topmost_nodes(numbers: list[int], parents: list[int]) -> list[int]:
    """Return the nodes in `numbers` that are not descendants of another node in `numbers`."""
    chosen, tops = set(numbers), []
    for number in numbers:
        above = parents[number]
        while above >= 0 and above not in chosen:
            above = parents[above]
        if above < 0:
            tops.append(number)
    return tops


def _compute_node_transform(file: gltf_file.GltfDocument, node: dict[str, Any]) -> Floats:
    """Return the transform (3, 4) from a node's space to the space of its parent."""
    if "matrix" in node:
        return file.get_floats(node, "matrix", tuple(np.eye(4).ravel())).reshape(4, 4).T[:3]
    return make_transform(
        file.get_floats(node, "translation", (0.0, 0.0, 0.0)),
        file.get_floats(node, "rotation", (0.0, 0.0, 0.0, 1.0)),
        file.get_floats(node, "scale", (1.0, 1.0, 1.0)),
    )


def _find_named_nodes(file: gltf_file.GltfDocument, scene_nodes: list[int], node_name: str) -> set[int]:
    """Return the nodes with the name `node_name`, the nodes with a mesh of this name, and all nodes below them."""
    from antdsl.diagnostics.suggestion import find_nearest_name

    nodes, meshes = file.get_top_list("nodes"), file.get_top_list("meshes")
    names: dict[str, list[int]] = {}
    for number in scene_nodes:
        mesh = file.get_index(nodes[number], "mesh", len(meshes))
        of = {file.get_name(nodes[number], ""), "" if mesh is None else file.get_name(meshes[mesh], "")}
        for name in of - {""}:
            names.setdefault(name, []).append(number)
    if node_name not in names:
        near = find_nearest_name(node_name, names)
        known = ", ".join(f"`{name[:40]}`" for name in list(names)[:8]) or "no names"
        raise MeshError(f"has no node `{node_name[:60]}`: " + (f"did you mean `{near}`?" if near else f"it has {known}"), None)
    chosen: set[int] = set()
    for number in names[node_name]:
        if number not in chosen:
            chosen.update(gltf_file.find_nodes_below(file, [number]))
    return chosen


def _read_primitive(
    file: gltf_file.GltfDocument, primitive: dict[str, Any], notes: ImportNotes
) -> tuple[Floats, NDArray[np.int64]] | None:
    """Return the points and triangles of a primitive. If it has no readable triangles, add a note and return None."""
    mode = primitive.get("mode", gltf_file.TRIANGLES_PRIMITIVE_MODE)
    if mode not in (
        gltf_file.TRIANGLES_PRIMITIVE_MODE,
        gltf_file.TRIANGLE_STRIP_PRIMITIVE_MODE,
        gltf_file.TRIANGLE_FAN_PRIMITIVE_MODE,
    ):
        known = isinstance(mode, int) and not isinstance(mode, bool) and 0 <= mode < len(_NON_SURFACE_MODES)
        notes.count_skipped(
            f"primitives of {_NON_SURFACE_MODES[mode]}"
            if known
            else f"primitives of the unknown mode `{replace_unprintable(str(mode)[:20])}`"
        )
        return None
    if _DRACO_EXTENSION in file.get_object(primitive, "extensions"):
        raise gltf_file.GltfError("is compressed with Draco, which is not read", "export it without compression")
    attributes = file.get_object(primitive, "attributes")
    if "POSITION" not in attributes:
        notes.count_skipped("primitives without positions")
        return None
    points = file.read_accessor(attributes["POSITION"], 3).astype(np.float64)
    notes.count_skipped("morph targets", len(file.get_list(primitive, "targets")))
    triangles, over = gltf_file.make_primitive_triangles(file, primitive, len(points))
    notes.count_skipped("corners of an incomplete triangle", over)
    return points, triangles
