"""Reads meshes of a glTF file as shapes: triangles, normals, texture coordinates, colours, skinning and morph targets. Khronos
Group, glTF 2.0 Specification, 2021, section 3.7."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import STATE_MATERIAL, BlendTargets, BodyError, Channel, SkinShape, SkinWeights
from antdsl.bodies.body import normalise_normals
from antdsl.bodies.files.gltf.gltf_textures import COLOUR_ATTRIBUTE, TextureError, Textures
from antdsl.scene.geometry.gltf_file import (
    TRIANGLE_FAN_PRIMITIVE_MODE,
    TRIANGLE_STRIP_PRIMITIVE_MODE,
    TRIANGLES_PRIMITIVE_MODE,
    GltfDocument,
    GltfError,
    make_primitive_triangles,
)

Floats = NDArray[np.float64]
_UNIT_LENGTH_TOLERANCE = 1e-6  # tolerance of the length 1 of normals; normals stored as integers deviate slightly
_EXPORT_HELP = "export the body again, as glTF 2.0"


@dataclass(slots=True)
class GltfBody:
    """The parts of a glTF import that were read so far.

    `joint_by_node`: the name of each node's joint, by node number.
    `omissions`: sentences about parts that are not read."""

    file: GltfDocument
    joint_by_node: dict[int, str] = field(default_factory=dict)
    shapes: dict[str, SkinShape] = field(default_factory=dict)
    channels: dict[str, Channel] = field(default_factory=dict)
    channels_by_node: dict[int, tuple[str, ...]] = field(default_factory=dict)  # channels of each node's mesh
    materials: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    omissions: dict[str, None] = field(default_factory=dict)
    point_count: int = 0
    textures: Textures = field(init=False)

    def __post_init__(self) -> None:
        self.textures = Textures(self.file)


def make_unused_name(name: str, used_names: Iterable[str]) -> str:
    """Return a name that is not in `used_names`: `name`, or `name` with the first free number appended."""
    used_names = used_names if isinstance(used_names, set | dict) else set(used_names)
    candidate, count = name, 2
    while candidate in used_names:
        candidate, count = f"{name}_{count}", count + 1
    return candidate


@dataclass(slots=True)
class _MeshPrimitives:
    """The values of all primitives of a mesh, one list entry per primitive. Points that several primitives share are stored once.

    `point_sets`: the distinct arrays of points. `index_by_points`: the index of each of these arrays, by the hash of its points.
    `point_indices`: for each primitive, the index of its points in `point_sets`."""

    index_by_points: dict[str, int] = field(default_factory=dict)
    point_indices: list[int] = field(default_factory=list)
    point_sets: list[Floats] = field(default_factory=list)
    faces: list[NDArray[np.int64]] = field(default_factory=list)
    normals: list[Floats | None] = field(default_factory=list)
    uvs: list[Floats | None] = field(default_factory=list)
    colours: list[Floats | None] = field(default_factory=list)
    material: list[int | None] = field(default_factory=list)
    joints: list[NDArray[np.int64]] = field(default_factory=list)
    weights: list[Floats] = field(default_factory=list)
    targets: list[list[tuple[Floats, Floats | None]]] = field(default_factory=list)
    extra_attributes: list[dict[str, NDArray[Any]]] = field(default_factory=list)


def read_shape(body: GltfBody, name: str, mesh: dict[str, Any], skin: dict[str, Any] | None, node: dict[str, Any]) -> bool:
    """Add a mesh to the library as the shape `name`, and its morph targets as more shapes. Return False if it has no
    triangles."""
    file, pieces = body.file, _MeshPrimitives()
    for primitive in file.get_objects(mesh, "primitives"):
        _read_piece(body, pieces, primitive, skin is not None)
    if not pieces.point_sets:
        body.omissions[f"the mesh `{name}` has no triangles"] = None
        return False
    counts = [len(points) for points in pieces.point_sets]
    starts = np.cumsum([0, *counts[:-1]])
    faces = np.concatenate([f + starts[of] for f, of in zip(pieces.faces, pieces.point_indices, strict=True)]).astype(np.int32)
    points = np.concatenate(pieces.point_sets).astype(np.float32)
    with_normals = all(each is not None for each in pieces.normals)
    normals = None
    if with_normals:
        normals = normalise_normals(np.concatenate([each for each in pieces.normals if each is not None]), _UNIT_LENGTH_TOLERANCE)
    uvs = None
    if any(each is not None for each in pieces.uvs):
        all_uvs = [np.zeros((n, 2)) if each is None else each for each, n in zip(pieces.uvs, counts, strict=True)]
        uvs = np.concatenate(all_uvs).astype(np.float32)
    materials, material = _read_materials(body, pieces)
    common = set.intersection(*(set(each) for each in pieces.extra_attributes))
    further = {key: np.concatenate([each[key] for each in pieces.extra_attributes]) for key in sorted(common)}
    colours = _compute_point_colours(body, pieces, counts)
    if colours is not None:
        further[COLOUR_ATTRIBUTE] = colours
    shape = SkinShape(name, points, faces, normals, uvs, materials, material, further)
    if skin is not None:
        shape = replace(shape, capture=_read_capture(body, pieces, skin, name))
    body.shapes[name] = shape
    number = len(pieces.targets[0])
    if any(len(each) != number for each in pieces.targets):
        raise BodyError(f"has a mesh `{name}` in which primitives have different numbers of morph targets", _EXPORT_HELP)
    if number:
        body.shapes[name] = replace(shape, blend=_read_targets(body, shape, pieces, mesh, node))
    return True


def _read_piece(body: GltfBody, pieces: _MeshPrimitives, primitive: dict[str, Any], skinned: bool) -> None:
    """Append the points, faces, normals, materials and morph targets of a primitive to `pieces`."""
    file = body.file
    if primitive.get("mode", TRIANGLES_PRIMITIVE_MODE) not in (
        TRIANGLES_PRIMITIVE_MODE,
        TRIANGLE_STRIP_PRIMITIVE_MODE,
        TRIANGLE_FAN_PRIMITIVE_MODE,
    ):
        body.omissions["points and lines of meshes are not read"] = None
        return
    if "KHR_draco_mesh_compression" in file.get_object(primitive, "extensions"):
        body.omissions["meshes compressed with Draco are not read"] = None
        return
    attributes = file.get_object(primitive, "attributes")
    if "POSITION" not in attributes:
        body.omissions["a primitive of a mesh has no positions, so it is not read"] = None
        return
    shared = repr((sorted(map(str, attributes.items())), file.get_list(primitive, "targets")))
    points = file.read_accessor(attributes["POSITION"], 3).astype(np.float64)
    if shared in pieces.index_by_points:
        _read_faces(
            body, pieces, primitive, make_primitive_triangles(file, primitive, len(points))[0], pieces.index_by_points[shared]
        )
        return
    body.point_count += len(points) * (1 + len(file.get_list(primitive, "targets")))
    if body.point_count > limits.MAX_BODY_POINTS:
        raise BodyError(f"has more than {limits.MAX_BODY_POINTS:,} points, including morph targets", code="too-large")
    if not np.isfinite(points).all() or (len(points) and np.abs(points).max() > 1e30):
        raise BodyError("has a point that is not finite", _EXPORT_HELP)
    if not _read_faces(
        body, pieces, primitive, make_primitive_triangles(file, primitive, len(points))[0], len(pieces.point_sets)
    ):
        return
    pieces.index_by_points[shared] = len(pieces.point_sets)

    def of_points(key: str, width: int) -> Floats | None:
        if key not in attributes:
            return None
        array = file.read_accessor(attributes[key], width)
        if len(array) != len(points) or not np.isfinite(array).all():
            raise BodyError(
                f"has the attribute `{key}` with {len(array):,} values for {len(points):,} points, or with a "
                "value that is not finite",
                _EXPORT_HELP,
            )
        return array.astype(np.float64)

    pieces.point_sets.append(points)
    pieces.normals.append(of_points("NORMAL", 3))
    pieces.uvs.append(of_points("TEXCOORD_0", 2))
    pieces.colours.append(_read_vertex_colours(file, attributes, len(points)))
    pieces.targets.append([])
    for target in file.get_objects(primitive, "targets"):
        moved = [_read_target(file, target, key, len(points)) for key in ("POSITION", "NORMAL")]
        pieces.targets[-1].append((np.zeros((len(points), 3)) if moved[0] is None else moved[0], moved[1]))
    pieces.extra_attributes.append({})
    for key in attributes:
        if isinstance(key, str) and key.startswith("_") and key.strip("_"):
            values = file.read_accessor(attributes[key])
            if len(values) == len(points) and values.shape[1] == 1 and np.isfinite(values).all():
                is_integer = values.dtype == np.int64
                pieces.extra_attributes[-1][key.strip("_").lower()] = values[:, 0].astype(np.int64 if is_integer else np.float32)
    if skinned:
        _read_joint_weights(pieces, of_points, len(points))


def _read_vertex_colours(file: GltfDocument, attributes: dict[str, Any], count: int) -> Floats | None:
    """Return the linear vertex colours [count, 3] of a primitive, or None if it has none, or none that can be used."""
    if "COLOR_0" not in attributes:
        return None
    values = file.read_accessor(attributes["COLOR_0"]).astype(np.float64)
    if values.shape[0] != count or values.shape[1] not in (3, 4) or not np.isfinite(values).all():
        raise BodyError("has vertex colours that do not match its points", _EXPORT_HELP)
    return np.clip(values[:, :3], 0.0, 1.0)


def _compute_point_colours(body: GltfBody, pieces: _MeshPrimitives, counts: list[int]) -> NDArray[np.float32] | None:
    """Return the linear colours of all points of a mesh, float32[P, 3], without the base colours of materials.

    Return None if no primitive has vertex colours or a texture. If a point belongs to several materials, the texture of the
    first material is used."""
    file, known, is_coloured = body.file, body.file.get_top_list("materials"), False
    colours = []
    for number, count in enumerate(counts):
        vertex_colours, uvs = pieces.colours[number], pieces.uvs[number]
        own = np.ones((count, 3)) if vertex_colours is None else vertex_colours
        is_coloured = is_coloured or vertex_colours is not None
        material = next((m for m, of in zip(pieces.material, pieces.point_indices, strict=True) if of == number), None)
        pbr = {} if material is None else file.get_object(known[material], "pbrMetallicRoughness")
        if material is not None and "baseColorTexture" in pbr:
            name = file.get_name(known[material], f"material{material}")
            try:
                if uvs is None:
                    raise TextureError("the mesh has no texture coordinates")
                own = own * body.textures.sample_colours(file.get_object(pbr, "baseColorTexture"), uvs)
                is_coloured = True
            except (TextureError, GltfError) as error:
                body.omissions[f"the texture of `{name}` is not read, only its base colour: {error}"] = None
        colours.append(own)
    return np.concatenate(colours).astype(np.float32) if is_coloured else None


def _read_faces(
    body: GltfBody, pieces: _MeshPrimitives, primitive: dict[str, Any], faces: NDArray[np.int64], point_set: int
) -> bool:
    """Append the triangles of a primitive. Return False if it has no triangles.

    `point_set`: the index of the primitive's points in `pieces.point_sets`."""
    if len(faces):
        pieces.faces.append(faces)
        pieces.point_indices.append(point_set)
        pieces.material.append(body.file.get_index(primitive, "material", len(body.file.get_top_list("materials"))))
    return len(faces) > 0


def _read_target(file: GltfDocument, target: dict[str, Any], key: str, count: int) -> Floats | None:
    """Return an attribute of a morph target [count, 3]; None if the target does not have it."""
    if key not in target:
        return None
    offsets = file.read_accessor(target[key], 3)
    if len(offsets) != count or not np.isfinite(offsets).all():
        raise BodyError(
            f"has a morph target with {len(offsets):,} values for {count:,} points, or with a value that is not finite",
            _EXPORT_HELP,
        )
    return offsets.astype(np.float64)


def _read_joint_weights(pieces: _MeshPrimitives, read_point_values: Callable[[str, int], Floats | None], count: int) -> None:
    """Append the joints that each point follows, and their weights, to `pieces`. A glTF file has four joints per point, or a
    multiple of four."""
    joints: list[NDArray[np.int64]] = []
    weights: list[Floats] = []
    while 4 * len(joints) < limits.MAX_JOINTS_PER_POINT:
        these, shares = read_point_values(f"JOINTS_{len(joints)}", 4), read_point_values(f"WEIGHTS_{len(joints)}", 4)
        if these is None or shares is None:
            break
        joints.append(these.astype(np.int64))
        weights.append(np.maximum(shares, 0.0))
    pieces.joints.append(np.concatenate(joints, axis=1) if joints else np.zeros((count, 4), np.int64))
    pieces.weights.append(np.concatenate(weights, axis=1) if weights else np.zeros((count, 4)))


def _read_capture(body: GltfBody, pieces: _MeshPrimitives, skin: dict[str, Any], name: str) -> SkinWeights:
    """Return the joints that the points of a skinned mesh follow, and their weights."""
    file = body.file
    names = tuple(body.joint_by_node[number] for number in file.get_list(skin, "joints"))
    if not names:
        raise BodyError("has a skin without joints", _EXPORT_HELP)
    inverse = np.tile(np.eye(4), (len(names), 1, 1))
    if "inverseBindMatrices" in skin:
        matrices = file.read_accessor(skin["inverseBindMatrices"], 16)
        if len(matrices) < len(names) or not np.isfinite(matrices).all():
            raise BodyError(
                f"has {len(matrices)} inverse bind matrices for {len(names)} joints, or a matrix that is not finite", _EXPORT_HELP
            )
        inverse = np.ascontiguousarray(matrices[: len(names)].astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1))
    columns = max(each.shape[1] for each in pieces.joints)
    joints = np.concatenate([np.pad(each, ((0, 0), (0, columns - each.shape[1]))) for each in pieces.joints])
    weights = np.concatenate([np.pad(each, ((0, 0), (0, columns - each.shape[1]))) for each in pieces.weights])
    joints, weights, lone = normalise_capture(joints, weights, len(names))
    if lone:
        body.omissions[f"{lone:,} points of `{name}` follow no joint; they now follow `{names[0]}`"] = None
    return SkinWeights(names, joints, weights, inverse)


def normalise_capture(
    joints: NDArray[np.int64], weights: Floats, count: int
) -> tuple[NDArray[np.int32], NDArray[np.float32], int]:
    """Scale the weights of each point so that they add up to 1. Return joints int32[P, K], weights float32[P, K], and the number
    of points without a joint.

    Unused columns are removed. A point that had no joint follows joint 0 in the result. `count`: the number of joints. Raises
    BodyError for a joint number out of range."""
    used = weights > 0
    if len(joints) and used.any() and (joints[used].min() < 0 or joints[used].max() >= count):
        raise BodyError(f"has a point that follows a joint outside of its skin, which has {count} joints", _EXPORT_HELP)
    joints = np.where(used, joints, 0)
    total = weights.sum(axis=1, keepdims=True)
    lone = np.asarray(total[:, 0] <= 0)
    weights = np.where(lone[:, None], np.arange(weights.shape[1]) == 0, weights / np.where(total > 0, total, 1.0))
    needed = (weights > 0).any(axis=0) | (np.arange(weights.shape[1]) == 0)
    return joints[:, needed].astype(np.int32), weights[:, needed].astype(np.float32), int(lone.sum())


def build_rigid_capture(joint: str, points: int) -> SkinWeights:
    """Return the weights of a shape that follows a single joint, with all of its points. The points must be in the space of this
    joint.

    This makes a shape with morph targets move with its joint. `points`: the number of points."""
    return SkinWeights((joint,), np.zeros((points, 1), np.int32), np.ones((points, 1), np.float32), np.eye(4)[None])


def _read_targets(
    body: GltfBody, shape: SkinShape, pieces: _MeshPrimitives, mesh: dict[str, Any], node: dict[str, Any]
) -> BlendTargets:
    """Add the morph targets of a mesh to the library as shapes, and add channels for their weights. Return the inputs of the
    blend shape."""
    file, number = body.file, len(pieces.targets[0])
    extras = mesh.get("extras")
    target_names = extras.get("targetNames") if isinstance(extras, dict) else None
    names = (
        target_names
        if isinstance(target_names, list) and len(target_names) == number and all(isinstance(n, str) and n for n in target_names)
        else None
    )
    weights = file.get_floats(node if "weights" in node else mesh, "weights", (0.0,) * number)
    shapes, channels = [], []
    for count in range(number):
        own = names[count][:200] if names else f"target{count}"
        name = make_unused_name(f"{shape.name}.{own}", body.shapes)
        channel = make_unused_name(name, body.channels)
        moved = np.concatenate([each[count][0] for each in pieces.targets])
        normals = shape.normals
        if normals is not None:
            turned = [
                np.zeros((len(p), 3)) if each[count][1] is None else each[count][1]
                for each, p in zip(pieces.targets, pieces.point_sets, strict=True)
            ]
            normals = (normals + np.concatenate(turned)).astype(np.float32)  # type: ignore[arg-type]
        body.shapes[name] = SkinShape(name, (shape.points + moved).astype(np.float32), shape.faces, normals, shape.uvs)
        body.channels[channel] = Channel(channel, float(weights[count]))
        shapes.append(name)
        channels.append(channel)
    return BlendTargets(tuple(shapes), tuple(channels), ("P", "N") if shape.normals is not None else ("P",))


def _read_materials(body: GltfBody, pieces: _MeshPrimitives) -> tuple[tuple[str, ...], NDArray[np.int32] | None]:
    """Return the names of a shape's materials, and the index of each triangle's material. Add the base colours to
    `body.materials`."""
    file, known = body.file, body.file.get_top_list("materials")
    if not known or all(each is None for each in pieces.material):
        return (), None
    names: dict[str, None] = {}
    numbers = []
    for material, faces in zip(pieces.material, pieces.faces, strict=True):
        name = "default" if material is None else file.get_name(known[material], f"material{material}")
        colour = (1.0, 1.0, 1.0)
        if material is not None:
            pbr = file.get_object(known[material], "pbrMetallicRoughness")
            red, green, blue, _ = np.clip(file.get_floats(pbr, "baseColorFactor", (1.0, 1.0, 1.0, 1.0)), 0.0, 1.0)
            colour = (float(red), float(green), float(blue))
        if name != STATE_MATERIAL:
            body.materials.setdefault(name, colour)
        names.setdefault(name)
        numbers.append(np.full(len(faces), list(names).index(name), np.int32))
    return tuple(names), np.concatenate(numbers)
