"""A glTF file as an agent definition: nodes are joints, meshes shapes, morph targets blend shapes, animations clips.

Kept of the nodes are the joints of skins, what is animated, what holds a mesh, and all above them, so that the world transform of
a joint is that of its node. Khronos Group, glTF 2.0 Specification, 2021, sections 3.5, 3.7 and 3.11."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.gltf_clips import read_clips
from antdsl.bodies.agents.gltf_file import Gltf
from antdsl.bodies.agents.layer import Binding, Layer
from antdsl.bodies.agents.problems import BodyError
from antdsl.bodies.agents.rig import Channel, Rig
from antdsl.bodies.agents.shape import Blend, Capture, Shape
from antdsl.bodies.agents.transforms import matrix_of, unit_quaternion

Floats = NDArray[np.float64]
LAYER = "body"
_EXPORT = "export it anew, as glTF 2.0"
_TRIANGLES, _STRIP, _FAN = 4, 5, 6


@dataclass(slots=True)
class GltfBody:
    """What is being read: `joint` is the name of each node by its number, `left_out` what is told of and not read."""

    file: Gltf
    joint: dict[int, str] = field(default_factory=dict)
    shapes: dict[str, Shape] = field(default_factory=dict)
    channels: dict[str, Channel] = field(default_factory=dict)
    weights: dict[int, tuple[str, ...]] = field(default_factory=dict)  # channels of each node's mesh
    materials: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    left_out: dict[str, None] = field(default_factory=dict)
    points: int = 0


def read_gltf(data: bytes, name: str, beside: Callable[[str, int], bytes], rate: float) -> tuple[Definition, list[str]]:
    """The definition in a file's bytes, and sentences about what of it is not read. Animations are sampled about `rate` times a
    second, so that each ends on a sample. `beside(path, cap)` reads a file beside it. BodyError says why there is none."""
    body = GltfBody(Gltf(data, beside))
    parents = _parents(body.file)
    kept = _kept(body.file, parents)
    body.joint = _unique_names(body.file, kept)
    rig = _rig(body, kept, parents)
    layer = _layer(body)
    rig = replace(rig, channels=tuple(body.channels.values()))
    clips = read_clips(body.file, body.joint, body.weights, rig, rate)
    found = Definition(
        name, rig, body.shapes, {LAYER: layer} if body.shapes else {}, {clip.name: clip for clip in clips},
        materials=body.materials, front=(0.0, 0.0, 1.0), up=(0.0, 1.0, 0.0), unit=1000.0,
    )  # fmt: skip
    return found, list(body.left_out)


# ---- rig


def _parents(file: Gltf) -> list[int]:
    """The parent of each node, -1 for a root; BodyError where they are no tree."""
    nodes = file.top("nodes")
    if len(nodes) > 16 * limits.JOINTS:
        raise BodyError(f"has {len(nodes):,} nodes, more than are read", code="too-large")
    parents = [-1] * len(nodes)
    for number, node in enumerate(nodes):
        for child in file.list(node, "children"):
            child = file.number_of(child, "node", len(nodes))
            if parents[child] >= 0 or child == number:
                raise BodyError(f"has a node {child} with two parents", _EXPORT, "bad-rig")
            parents[child] = number
    state = [0] * len(nodes)  # 1: being followed, 2: known to lead to a root
    for start in range(len(nodes)):
        way, node = [], start
        while node >= 0 and state[node] == 0:
            state[node] = 1
            way.append(node)
            node = parents[node]
        if node >= 0 and state[node] == 1:
            raise BodyError(f"has nodes that hang below each other in a circle, {node} among them", _EXPORT, "bad-rig")
        for each in way:
            state[each] = 2
    return parents


def _kept(file: Gltf, parents: list[int]) -> list[int]:
    """The nodes that become joints, parents before children, as the file's scene has them."""
    nodes = file.top("nodes")
    scenes = file.top("scenes")
    scene = file.index(file.tree, "scene", len(scenes)) or 0
    roots = [file.number_of(root, "node", len(nodes)) for root in file.list(scenes[scene], "nodes")] if scenes else []
    roots = roots or [number for number, parent in enumerate(parents) if parent < 0]
    wanted: set[int] = set()
    for number in _below(file, roots):
        if "mesh" in nodes[number] and "skin" not in nodes[number]:
            wanted.add(number)
    for skin in file.top("skins"):
        wanted.update(file.number_of(joint, "node", len(nodes)) for joint in file.list(skin, "joints"))
    for animation in file.top("animations"):
        for channel in file.objects(animation, "channels"):
            target = file.object(channel, "target")
            node = file.index(target, "node", len(nodes))
            if node is not None and target.get("path") != "weights":
                wanted.add(node)
    for number in list(wanted):
        above = parents[number]
        while above >= 0 and above not in wanted:
            wanted.add(above)
            above = parents[above]
    if not wanted:
        wanted.update(roots[:1])
    if not wanted:
        raise BodyError("has no nodes", _EXPORT)
    if len(wanted) > limits.JOINTS:
        raise BodyError(f"has {len(wanted):,} joints, more than {limits.JOINTS:,}", code="too-large")
    tops = [number for number in wanted if parents[number] < 0]
    order = sorted(tops, key=lambda number: (number not in roots, roots.index(number) if number in roots else number))
    return [number for number in _below(file, order) if number in wanted]


def _below(file: Gltf, roots: Iterable[int]) -> list[int]:
    """The nodes and all below them, parents first, children in the order of the file."""
    nodes, found = file.top("nodes"), []
    waiting = list(reversed(list(roots)))
    while waiting:
        found.append(waiting.pop())
        waiting += reversed(file.list(nodes[found[-1]], "children"))
        if len(found) > len(nodes):
            raise BodyError("has a scene that names a node twice", _EXPORT)
    return found


def _unique_names(file: Gltf, kept: list[int]) -> dict[int, str]:
    found: dict[int, str] = {}
    taken: set[str] = set()
    for number in kept:
        name = unused(file.name(file.top("nodes")[number], f"node{number}"), taken)
        taken.add(name)
        found[number] = name
    return found


def unused(name: str, taken: Iterable[str]) -> str:
    """A name that is not taken: itself, or with the first number that makes it so."""
    taken = taken if isinstance(taken, set | dict) else set(taken)
    made, count = name, 2
    while made in taken:
        made, count = f"{name}_{count}", count + 1
    return made


def _rig(body: GltfBody, kept: list[int], parents: list[int]) -> Rig:
    place = {number: count for count, number in enumerate(kept)}
    rest = np.array([local_matrix(body.file, body.file.top("nodes")[number]) for number in kept]).reshape(-1, 4, 4)
    return Rig(
        tuple(body.joint[number] for number in kept),
        np.array([place.get(parents[number], -1) for number in kept], np.int32),
        rest,
    )


def local_matrix(file: Gltf, node: dict[str, Any]) -> Floats:
    """The matrix float64[4, 4] of a node."""
    if "matrix" in node:
        found = file.floats(node, "matrix", tuple(np.eye(4).ravel())).reshape(4, 4).T
        return np.concatenate([found[:3], [[0.0, 0.0, 0.0, 1.0]]])
    translation, rotation, scale = local_parts(file, node)
    return matrix_of(translation, rotation, scale)


def local_parts(file: Gltf, node: dict[str, Any]) -> tuple[Floats, Floats, Floats]:
    """Translation, rotation and scale of a node that has no matrix."""
    rotation = unit_quaternion(file.floats(node, "rotation", (0.0, 0.0, 0.0, 1.0)))
    return file.floats(node, "translation", (0.0, 0.0, 0.0)), rotation, file.floats(node, "scale", (1.0, 1.0, 1.0))


# ---- shapes


def _layer(body: GltfBody) -> Layer:
    """The layer of all meshes, which are read into shapes on the way."""
    file = body.file
    nodes, meshes, skins = file.top("nodes"), file.top("meshes"), file.top("skins")
    known: dict[tuple[int, ...], str] = {}
    static, deforming = [], []
    scenes = file.top("scenes")
    roots = file.list(scenes[file.index(file.tree, "scene", len(scenes)) or 0], "nodes") if scenes else []
    shown = _below(file, roots) if roots else list(range(len(nodes)))
    for number in shown:
        node = nodes[number]
        mesh, skin = file.index(node, "mesh", len(meshes)), file.index(node, "skin", len(skins))
        if mesh is None:
            continue
        morphs = any("targets" in each for each in file.objects(meshes[mesh], "primitives"))
        key = (mesh, -1 if skin is None else skin, number if morphs else -1)
        if key not in known:
            name = unused(file.name(meshes[mesh], file.name(node, f"mesh{mesh}")), body.shapes)
            if not _shape(body, name, meshes[mesh], None if skin is None else skins[skin], node):
                continue
            known[key] = name
        shape = body.shapes[known[key]]
        if shape.blend is not None:
            body.weights[number] = shape.blend.channels
        if skin is None and not morphs:
            static.append(Binding(body.joint[number], shape.name))
        else:
            names = ["blendshape"] * morphs + ["linearskinning"] * (skin is not None)
            deforming.append(Binding("" if skin is not None else body.joint[number], shape.name, deformer="+".join(names)))
    return Layer(LAYER, tuple(static), tuple(deforming))


@dataclass(slots=True)
class _Pieces:
    """The primitives of a mesh, one after the other."""

    points: list[Floats] = field(default_factory=list)
    faces: list[NDArray[np.int64]] = field(default_factory=list)
    normals: list[Floats | None] = field(default_factory=list)
    uvs: list[Floats | None] = field(default_factory=list)
    material: list[int | None] = field(default_factory=list)
    joints: list[NDArray[np.int64]] = field(default_factory=list)
    weights: list[Floats] = field(default_factory=list)
    targets: list[list[tuple[Floats, Floats | None]]] = field(default_factory=list)
    further: list[dict[str, NDArray[Any]]] = field(default_factory=list)


def _shape(body: GltfBody, name: str, mesh: dict[str, Any], skin: dict[str, Any] | None, node: dict[str, Any]) -> bool:
    """Reads a mesh into the shape `name`, its morph targets into shapes of their own; False where it has no triangles."""
    file, pieces = body.file, _Pieces()
    for primitive in file.objects(mesh, "primitives"):
        _piece(body, pieces, primitive, skin is not None)
    if not pieces.points:
        body.left_out[f"the mesh `{name}` has no triangles"] = None
        return False
    counts = [len(points) for points in pieces.points]
    starts = np.cumsum([0, *counts[:-1]])
    faces = np.concatenate([f + start for f, start in zip(pieces.faces, starts, strict=True)]).astype(np.int32)
    points = np.concatenate(pieces.points).astype(np.float32)
    with_normals = all(each is not None for each in pieces.normals)
    normals = np.concatenate([each for each in pieces.normals if each is not None]).astype(np.float32) if with_normals else None
    uvs = None
    if any(each is not None for each in pieces.uvs):
        whole = [np.zeros((n, 2)) if each is None else each for each, n in zip(pieces.uvs, counts, strict=True)]
        uvs = np.concatenate(whole).astype(np.float32)
    materials, material = _materials(body, pieces)
    common = set.intersection(*(set(each) for each in pieces.further))
    further = {key: np.concatenate([each[key] for each in pieces.further]) for key in sorted(common)}
    shape = Shape(name, points, faces, normals, uvs, materials, material, further)
    if skin is not None:
        shape = replace(shape, capture=_capture(body, pieces, skin, name))
    body.shapes[name] = shape
    number = len(pieces.targets[0])
    if any(len(each) != number for each in pieces.targets):
        raise BodyError(f"has a mesh `{name}` whose primitives have different numbers of morph targets", _EXPORT)
    if number:
        body.shapes[name] = replace(shape, blend=_targets(body, shape, pieces, mesh, node))
    return True


def _piece(body: GltfBody, pieces: _Pieces, primitive: dict[str, Any], skinned: bool) -> None:
    file = body.file
    mode = primitive.get("mode", _TRIANGLES)
    if mode not in (_TRIANGLES, _STRIP, _FAN):
        body.left_out["points and lines of meshes are not read"] = None
        return
    if "KHR_draco_mesh_compression" in file.object(primitive, "extensions"):
        body.left_out["what is compressed with Draco is not read"] = None
        return
    given = file.object(primitive, "attributes")
    if "POSITION" not in given:
        body.left_out["a primitive of a mesh has no positions"] = None
        return
    points = file.accessor(given["POSITION"], 3).astype(np.float64)
    body.points += len(points) * (1 + len(file.list(primitive, "targets")))
    if body.points > limits.BODY_POINTS:
        raise BodyError(f"has more than {limits.BODY_POINTS:,} points, morph targets among them", code="too-large")
    if not np.isfinite(points).all() or (len(points) and np.abs(points).max() > 1e30):
        raise BodyError("has a point that is not finite", _EXPORT)
    corners = file.accessor(primitive["indices"], 1)[:, 0] if "indices" in primitive else np.arange(len(points))
    faces = _triangles(corners.astype(np.int64), mode)
    if len(faces) > limits.MESH_FACES:
        raise BodyError(f"has more than {limits.MESH_FACES:,} triangles", code="too-large")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(points)):
        raise BodyError("has a triangle that names a point which is not there", _EXPORT)
    if not len(faces):
        return

    def of_points(key: str, width: int) -> Floats | None:
        if key not in given:
            return None
        found = file.accessor(given[key], width)
        if len(found) != len(points) or not np.isfinite(found).all():
            raise BodyError(
                f"has `{key}` of {len(found):,} values for {len(points):,} points, or one that is not finite", _EXPORT
            )
        return found.astype(np.float64)

    pieces.points.append(points)
    pieces.faces.append(faces)
    pieces.normals.append(of_points("NORMAL", 3))
    pieces.uvs.append(of_points("TEXCOORD_0", 2))
    pieces.material.append(file.index(primitive, "material", len(file.top("materials"))))
    pieces.targets.append([])
    for target in file.objects(primitive, "targets"):
        moved = [_target(file, target, key, len(points)) for key in ("POSITION", "NORMAL")]
        pieces.targets[-1].append((np.zeros((len(points), 3)) if moved[0] is None else moved[0], moved[1]))
    pieces.further.append({})
    for key in given:
        if isinstance(key, str) and key.startswith("_") and key.strip("_"):
            values = file.accessor(given[key])
            if len(values) == len(points) and values.shape[1] == 1 and np.isfinite(values).all():
                whole = values.dtype == np.int64
                pieces.further[-1][key.strip("_").lower()] = values[:, 0].astype(np.int64 if whole else np.float32)
    if skinned:
        _follow(pieces, of_points, len(points))


def _target(file: Gltf, target: dict[str, Any], key: str, count: int) -> Floats | None:
    if key not in target:
        return None
    found = file.accessor(target[key], 3)
    if len(found) != count or not np.isfinite(found).all():
        raise BodyError(f"has a morph target of {len(found):,} values for {count:,} points, or one that is not finite", _EXPORT)
    return found.astype(np.float64)


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Triangles (n, 3) of a list, a strip or a fan of corners; those without an area are left out of strips."""
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if len(corners) < 3:
        return np.empty((0, 3), np.int64)
    if mode == _FAN:
        return np.stack([corners[1:-1], corners[2:], np.full(len(corners) - 2, corners[0])], axis=1)
    found = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    found[1::2] = found[1::2][:, [1, 0, 2]]
    apart = (found[:, 0] != found[:, 1]) & (found[:, 1] != found[:, 2]) & (found[:, 0] != found[:, 2])
    return found[apart]


def _follow(pieces: _Pieces, of_points: Callable[[str, int], Floats | None], count: int) -> None:
    """The joints of each point with their weights, in as many columns as the file has."""
    joints, weights = [], []
    while 4 * len(joints) < limits.CAPTURED:
        these, shares = of_points(f"JOINTS_{len(joints)}", 4), of_points(f"WEIGHTS_{len(joints)}", 4)
        if these is None or shares is None:
            break
        joints.append(these.astype(np.int64))
        weights.append(np.maximum(shares, 0.0))
    pieces.joints.append(np.concatenate(joints, axis=1) if joints else np.zeros((count, 4), np.int64))
    pieces.weights.append(np.concatenate(weights, axis=1) if weights else np.zeros((count, 4)))


def _capture(body: GltfBody, pieces: _Pieces, skin: dict[str, Any], name: str) -> Capture:
    file = body.file
    names = tuple(body.joint[number] for number in file.list(skin, "joints"))
    if not names:
        raise BodyError("has a skin without joints", _EXPORT)
    inverse = np.tile(np.eye(4), (len(names), 1, 1))
    if "inverseBindMatrices" in skin:
        found = file.accessor(skin["inverseBindMatrices"], 16)
        if len(found) < len(names) or not np.isfinite(found).all():
            raise BodyError(f"has {len(found)} inverse bind matrices for {len(names)} joints, or one not finite", _EXPORT)
        inverse = np.ascontiguousarray(found[: len(names)].astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1))
    columns = max(each.shape[1] for each in pieces.joints)
    joints = np.concatenate([np.pad(each, ((0, 0), (0, columns - each.shape[1]))) for each in pieces.joints])
    weights = np.concatenate([np.pad(each, ((0, 0), (0, columns - each.shape[1]))) for each in pieces.weights])
    joints, weights, lone = captured(joints, weights, len(names))
    if lone:
        body.left_out[f"{lone:,} points of `{name}` follow no joint, and were given to `{names[0]}`"] = None
    return Capture(names, joints, weights, inverse)


def captured(joints: NDArray[np.int64], weights: Floats, count: int) -> tuple[NDArray[np.int32], NDArray[np.float32], int]:
    """Joints int32[P, K] and weights float32[P, K] that add up to 1, columns that nobody needs left out; and how many points
    followed none of the `count` joints, which then follow the first. BodyError for a joint that is not there."""
    used = weights > 0
    if len(joints) and used.any() and (joints[used].min() < 0 or joints[used].max() >= count):
        raise BodyError(f"has a point that follows a joint which is not among the {count} of its skin", _EXPORT)
    joints = np.where(used, joints, 0)
    total = weights.sum(axis=1, keepdims=True)
    lone = total[:, 0] <= 0
    weights = np.where(lone[:, None], 0.0, weights / np.where(total > 0, total, 1.0))
    weights[lone, 0] = 1.0
    needed = (weights > 0).any(axis=0)
    needed[0] = True
    return joints[:, needed].astype(np.int32), weights[:, needed].astype(np.float32), int(lone.sum())


def _targets(body: GltfBody, shape: Shape, pieces: _Pieces, mesh: dict[str, Any], node: dict[str, Any]) -> Blend:
    """Shapes of the library for the morph targets of a mesh, and channels that weigh them."""
    file, number = body.file, len(pieces.targets[0])
    extras = mesh.get("extras")
    given = extras.get("targetNames") if isinstance(extras, dict) else None
    names = given if isinstance(given, list) and len(given) == number and all(isinstance(n, str) and n for n in given) else None
    weights = file.floats(node if "weights" in node else mesh, "weights", (0.0,) * number)
    shapes, channels = [], []
    for count in range(number):
        own = names[count][:200] if names else f"target{count}"
        name = unused(f"{shape.name}.{own}", body.shapes)
        channel = unused(name, body.channels)
        moved = np.concatenate([each[count][0] for each in pieces.targets])
        normals = shape.normals
        if normals is not None:
            turned = [
                np.zeros((len(p), 3)) if each[count][1] is None else each[count][1]
                for each, p in zip(pieces.targets, pieces.points, strict=True)
            ]
            normals = (normals + np.concatenate(turned)).astype(np.float32)  # type: ignore[arg-type]
        body.shapes[name] = Shape(name, (shape.points + moved).astype(np.float32), shape.faces, normals, shape.uvs)
        body.channels[channel] = Channel(channel, float(weights[count]))
        shapes.append(name)
        channels.append(channel)
    return Blend(tuple(shapes), tuple(channels), ("P", "N") if shape.normals is not None else ("P",))


def _materials(body: GltfBody, pieces: _Pieces) -> tuple[tuple[str, ...], NDArray[np.int32] | None]:
    """The names of a shape's materials, and the number of each triangle's; their base colours go to the definition."""
    file, known = body.file, body.file.top("materials")
    if not known or all(each is None for each in pieces.material):
        return (), None
    names: dict[str, None] = {}
    numbers = []
    for given, faces in zip(pieces.material, pieces.faces, strict=True):
        name = "default" if given is None else file.name(known[given], f"material{given}")
        colour = (1.0, 1.0, 1.0)
        if given is not None:
            pbr = file.object(known[given], "pbrMetallicRoughness")
            red, green, blue, _ = np.clip(file.floats(pbr, "baseColorFactor", (1.0, 1.0, 1.0, 1.0)), 0.0, 1.0)
            colour = (float(red), float(green), float(blue))
        body.materials.setdefault(name, colour)
        names.setdefault(name)
        numbers.append(np.full(len(faces), list(names).index(name), np.int32))
    return tuple(names), np.concatenate(numbers)
