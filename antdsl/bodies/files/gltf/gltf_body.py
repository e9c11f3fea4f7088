"""Reads a glTF file as an agent definition. Nodes become joints, meshes become shapes, animations become clips.

Morph targets become blend shapes. A node becomes a joint if it is a skin's joint, is animated, has an unskinned mesh, or is above
such a node. So the world transform of a joint equals that of its node. Khronos Group, glTF 2.0 Specification, 2021, sections 3.5,
3.7 and 3.11.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import Binding, BodyError, Definition, Layer, Rig
from antdsl.bodies.agents.transforms import compose_matrix, normalise_quaternion
from antdsl.bodies.files.gltf.gltf_clips import read_clips
from antdsl.bodies.files.gltf.gltf_settings import apply_body_extras
from antdsl.bodies.files.gltf.gltf_shapes import GltfBody, build_rigid_capture, make_unused_name, read_shape
from antdsl.scene.geometry.gltf_file import GltfDocument, GltfError, find_node_parents, find_nodes_below, find_scene_roots

Floats = NDArray[np.float64]
BASE_LAYER = "body"
_EXPORT_HELP = "export the body again, as glTF 2.0"


def read_gltf(
    data: bytes, name: str, read_sibling: Callable[[str, int], bytes], rate: float, pose: Rig | None = None
) -> tuple[Definition, list[str]]:
    """Return the definition in a file's bytes, and sentences about the parts that are not read. Raises BodyError for a damaged
    file.

    `read_sibling(path, cap)`: a function that returns at most `cap` bytes of a file. `path` is relative to this file.
    `rate`: approximate samples per second of animations; it is adjusted so that each animation ends on a sample.
    `pose`: a rig. If an animation has no keys for a joint, the joint has its rest pose in this rig. If
    the rig lacks the joint, it has its rest pose in the file."""
    with np.errstate(all="ignore"):  # values that are not finite are reported where they are used
        try:
            return _read_definition(data, name, read_sibling, rate, pose)
        except GltfError as error:
            raise BodyError(str(error), error.help, error.code or "bad-body") from None


def _read_definition(
    data: bytes, name: str, read_sibling: Callable[[str, int], bytes], rate: float, pose: Rig | None
) -> tuple[Definition, list[str]]:
    """Return the results of `read_gltf`. Raises GltfError or BodyError."""
    body = GltfBody(GltfDocument(data, read_sibling))
    parents = find_node_parents(body.file)
    joint_nodes = _find_joint_nodes(body.file, parents)
    body.joint_by_node = _assign_unique_names(body.file, joint_nodes)
    rig = _build_rig(body, joint_nodes, parents)
    layer = _read_layer(body)
    rig = replace(rig, channels=tuple(body.channels.values()))
    clips = read_clips(body.file, body.joint_by_node, body.channels_by_node, _replace_rest_pose(rig, pose), rate)
    definition = Definition(
        name, rig, body.shapes, {BASE_LAYER: layer} if body.shapes else {}, {clip.name: clip for clip in clips},
        materials=body.materials, front=(0.0, 0.0, 1.0), up=(0.0, 1.0, 0.0), unit=1000.0,
    )  # fmt: skip
    return apply_body_extras(definition, body.file.tree.get("extras")), list(body.omissions)


# ---- rig


def _find_joint_nodes(file: GltfDocument, parents: list[int]) -> list[int]:
    """Return the numbers of the nodes that become joints, parents before children, in the order of the scene."""
    nodes = file.get_top_list("nodes")
    roots = find_scene_roots(file) or [number for number, parent in enumerate(parents) if parent < 0]
    joint_nodes: set[int] = set()
    for number in find_nodes_below(file, roots):
        if "mesh" in nodes[number] and "skin" not in nodes[number]:
            joint_nodes.add(number)
    for skin in file.get_top_list("skins"):
        joint_nodes.update(file.check_index(joint, "node", len(nodes)) for joint in file.get_list(skin, "joints"))
    for animation in file.get_top_list("animations"):
        for channel in file.get_objects(animation, "channels"):
            target = file.get_object(channel, "target")
            node = file.get_index(target, "node", len(nodes))
            if node is not None and target.get("path") != "weights":
                joint_nodes.add(node)
    for number in list(joint_nodes):
        above = parents[number]
        while above >= 0 and above not in joint_nodes:
            joint_nodes.add(above)
            above = parents[above]
    if not joint_nodes:
        joint_nodes.update(roots[:1])
    if not joint_nodes:
        raise BodyError("has no nodes", _EXPORT_HELP)
    if len(joint_nodes) > limits.MAX_RIG_JOINTS:
        raise BodyError(f"has {len(joint_nodes):,} joints, more than {limits.MAX_RIG_JOINTS:,}", code="too-large")
    tops = [number for number in joint_nodes if parents[number] < 0]
    order = sorted(tops, key=lambda number: (number not in roots, roots.index(number) if number in roots else number))
    return [number for number in find_nodes_below(file, order) if number in joint_nodes]


def _assign_unique_names(file: GltfDocument, joint_nodes: list[int]) -> dict[int, str]:
    """Return a unique name for each joint node, by node number."""
    names: dict[int, str] = {}
    taken: set[str] = set()
    for number in joint_nodes:
        name = make_unused_name(file.get_name(file.get_top_list("nodes")[number], f"node{number}"), taken)
        taken.add(name)
        names[number] = name
    return names


def _build_rig(body: GltfBody, joint_nodes: list[int], parents: list[int]) -> Rig:
    """Return a rig with one joint for each of `joint_nodes`, in their rest pose. `parents`: the parent of each node, -1 for
    none."""
    place = {number: count for count, number in enumerate(joint_nodes)}
    rest = np.array([read_local_matrix(body.file, body.file.get_top_list("nodes")[number]) for number in joint_nodes]).reshape(
        -1, 4, 4
    )
    return Rig(
        tuple(body.joint_by_node[number] for number in joint_nodes),
        np.array([place.get(parents[number], -1) for number in joint_nodes], np.int32),
        rest,
    )


def _replace_rest_pose(rig: Rig, pose: Rig | None) -> Rig:
    """Return the rig with the rest pose of `pose` for every joint that both have."""
    if pose is None:
        return rig
    rest, known = rig.rest_matrices.copy(), {name: number for number, name in enumerate(pose.names)}
    for number, name in enumerate(rig.names):
        if name in known:
            rest[number] = pose.rest_matrices[known[name]]
    return replace(rig, rest_matrices=rest)


def read_local_matrix(file: GltfDocument, node: dict[str, Any]) -> Floats:
    """Return the local matrix float64[4, 4] of a node."""
    if "matrix" in node:
        matrix = file.get_floats(node, "matrix", tuple(np.eye(4).ravel())).reshape(4, 4).T
        return np.concatenate([matrix[:3], [[0.0, 0.0, 0.0, 1.0]]])
    translation, rotation, scale = read_local_parts(file, node)
    return compose_matrix(translation, rotation, scale)


def read_local_parts(file: GltfDocument, node: dict[str, Any]) -> tuple[Floats, Floats, Floats]:
    """Return translation, rotation and scale of a node that has no matrix."""
    rotation = normalise_quaternion(file.get_floats(node, "rotation", (0.0, 0.0, 0.0, 1.0)))
    return file.get_floats(node, "translation", (0.0, 0.0, 0.0)), rotation, file.get_floats(node, "scale", (1.0, 1.0, 1.0))


# ---- shapes


def _read_layer(body: GltfBody) -> Layer:
    """Read all meshes into shapes, and return the layer that binds them."""
    file = body.file
    nodes, meshes, skins = file.get_top_list("nodes"), file.get_top_list("meshes"), file.get_top_list("skins")
    known: dict[tuple[int, ...], str] = {}
    static, deforming = [], []
    roots = find_scene_roots(file)
    scene_nodes = find_nodes_below(file, roots) if roots else list(range(len(nodes)))
    for number in scene_nodes:
        node = nodes[number]
        mesh, skin = file.get_index(node, "mesh", len(meshes)), file.get_index(node, "skin", len(skins))
        if mesh is None:
            continue
        morphs = any("targets" in each for each in file.get_objects(meshes[mesh], "primitives"))
        key = (mesh, -1 if skin is None else skin, number if morphs else -1)
        if key not in known:
            name = make_unused_name(file.get_name(meshes[mesh], file.get_name(node, f"mesh{mesh}")), body.shapes)
            if not read_shape(body, name, meshes[mesh], None if skin is None else skins[skin], node):
                continue
            known[key] = name
        shape = body.shapes[known[key]]
        if shape.blend is not None:
            body.channels_by_node[number] = shape.blend.channels
        if skin is None and not morphs:
            static.append(Binding(body.joint_by_node[number], shape.name))
            continue
        if skin is None:
            body.shapes[shape.name] = replace(shape, capture=build_rigid_capture(body.joint_by_node[number], len(shape.points)))
        deforming.append(Binding("", shape.name, deformer="blendshape+linearskinning" if morphs else "linearskinning"))
    return Layer(BASE_LAYER, tuple(static), tuple(deforming))
