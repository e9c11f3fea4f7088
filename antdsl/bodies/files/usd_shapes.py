"""Reads meshes of a USD file as shapes, including material colours, skinning and blend shapes.

Faces are cut into triangles, and points are split where normals or texture coordinates differ."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import BlendTargets, BodyError, Channel, InBetweens, SkinShape, SkinWeights
from antdsl.bodies.files.gltf.gltf_shapes import make_unused_name, normalise_capture
from antdsl.scene.geometry.polygons import TooManyCornersError, triangulate_polygons
from antdsl.scene.geometry.usd.child.stage import OpenStage
from antdsl.scene.geometry.usd.errors import import_pxr_module

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_EXPORT_HELP = "export it again"


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """The skin of a mesh: the joints that it follows.

    `names`: the names of the joints.
    `inverse_matrices`: matrices from the mesh's space to that of each joint.
    `query`: the UsdSkel query that gives the weights.
    """

    names: tuple[str, ...]
    inverse_matrices: Floats
    query: Any


@dataclass(slots=True)
class UsdBody:
    """The parts of a USD import that were read so far. `omissions`: sentences about parts that are not read."""

    stage: OpenStage
    joint_names: list[str] = field(default_factory=list)
    joint_parents: list[int] = field(default_factory=list)
    rest_matrices: list[Floats] = field(default_factory=list)
    channels: dict[str, Channel] = field(default_factory=dict)
    shapes: dict[str, SkinShape] = field(default_factory=dict)
    materials: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    omissions: dict[str, None] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)  # the custom data of animations by the name of the clip
    point_count: int = 0

    def add_joint(self, name: str, parent: int, rest: Floats) -> int:
        """Add a joint under a name that no other joint has, and return its number."""
        if len(self.joint_names) >= limits.MAX_RIG_JOINTS:
            raise BodyError(f"has more than {limits.MAX_RIG_JOINTS:,} joints", code="too-large")
        if not np.isfinite(rest).all():
            raise BodyError(f"has a joint `{name}` with a transform that is not finite", "export it again")
        self.joint_names.append(make_unused_name(name, self.joint_names))
        self.joint_parents.append(parent)
        self.rest_matrices.append(rest)
        return len(self.joint_names) - 1


def read_usd_shape(body: UsdBody, prim: Any, skin: Skin | None) -> SkinShape | None:
    """Return the shape of a mesh prim, or None if the mesh has no faces. Add the shape and its blend shapes to the library."""
    mesh, time = import_pxr_module("UsdGeom").Mesh(prim), body.stage.first_time
    points = _to_rows(mesh.GetPointsAttr().Get(time), 3)
    _count_points(body, len(points))
    if not np.isfinite(points).all() or (len(points) and np.abs(points).max() > 1e30):
        raise BodyError(f"has a mesh `{prim.GetPath()}` with a point that is not finite", _EXPORT_HELP)
    corners, triangles, face = _triangulate_faces(mesh, prim, time, points)
    if not len(triangles):
        body.omissions[f"the mesh `{prim.GetPath()}` has no faces"] = None
        return None
    attributes = {"N": _read_normals(mesh, prim, time, points, corners), "uv": _read_uvs(prim, time, len(points), corners)}
    source, triangles, point_attributes = _split_points(corners, triangles, attributes)
    _count_points(body, max(0, len(source) - len(points)))
    name = make_unused_name(prim.GetName(), body.shapes)
    materials, material = _read_materials(body, prim, face)
    normals, uvs = (
        None if point_attributes[key] is None else np.asarray(point_attributes[key], np.float32) for key in ("N", "uv")
    )
    shape = SkinShape(
        name, points[source].astype(np.float32), triangles.astype(np.int32), normals, uvs, materials, material,
        {"vertex": source},
    )  # fmt: skip
    if skin is not None:
        shape = replace(shape, capture=_read_capture(body, prim, skin, len(points), source, time))
    body.shapes[name] = shape
    blend = _read_blend_shapes(body, shape, prim, points, source)
    if blend is not None:
        body.shapes[name] = shape = replace(shape, blend=blend)
    return shape


def _count_points(body: UsdBody, new_points: int) -> None:
    """Add `new_points` to the body's number of points. Raises BodyError if it exceeds the limit."""
    body.point_count += new_points
    if body.point_count > limits.MAX_BODY_POINTS:
        raise BodyError(f"has more than {limits.MAX_BODY_POINTS:,} points, including blend shapes", code="too-large")


def _to_rows(raw_values: Any, width: int) -> Floats:
    """Return the values as an array float64[n, width]. Raises BodyError if their number is not a multiple of `width`."""
    values = np.array([] if raw_values is None else raw_values, np.float64)
    if values.size % width:
        raise BodyError(f"has a list of numbers that is not a multiple of {width} long", _EXPORT_HELP)
    return values.reshape(-1, width)


def _triangulate_faces(mesh: Any, prim: Any, time: Any, points: Floats) -> tuple[Integers, Integers, Integers]:
    """Triangulate the faces. Return the point of each face corner, the triangles (n, 3) as indices of corners, and the face of
    each triangle."""
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(time) or [], np.int64)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(time) or [], np.int64)
    if len(corners) > 3 * limits.MAX_MESH_FACES or len(counts) > limits.MAX_MESH_FACES:
        raise BodyError(f"has a mesh `{prim.GetPath()}` of more than {limits.MAX_MESH_FACES:,} faces", code="too-large")
    right = counts.sum() == len(corners) and (not len(counts) or counts.min() >= 0)
    if not right or (len(corners) and (corners.min() < 0 or corners.max() >= len(points))):
        raise BodyError(f"has a mesh `{prim.GetPath()}` with faces that refer to missing points", _EXPORT_HELP)
    try:
        cut = triangulate_polygons(points, counts, corners)
    except TooManyCornersError as error:
        raise BodyError(f"has a mesh `{prim.GetPath()}` that {error}", "cut the face into smaller faces", "too-large") from None
    triangles, face = cut.corners, cut.polygon_indices
    if str(mesh.GetOrientationAttr().Get(time)) == "leftHanded":
        triangles = triangles[:, ::-1]
    return corners, triangles, face


def _read_normals(mesh: Any, prim: Any, time: Any, points: Floats, corners: Integers) -> Floats | None:
    """Return the normal [corners, 3] of each face corner, or None if there are no usable normals."""
    primvar = import_pxr_module("UsdGeom").PrimvarsAPI(prim).GetPrimvar("normals")
    if primvar and primvar.HasValue():
        return _expand_to_corners(primvar.ComputeFlattened(time), str(primvar.GetInterpolation()), 3, len(points), corners)
    return _expand_to_corners(mesh.GetNormalsAttr().Get(time), str(mesh.GetNormalsInterpolation()), 3, len(points), corners)


def _read_uvs(prim: Any, time: Any, points: int, corners: Integers) -> Floats | None:
    """Return the texture coordinates [corners, 2] of each face corner: from the primvar `st`, else from the first suitable one.
    Return None if there are none."""
    primvars = import_pxr_module("UsdGeom").PrimvarsAPI(prim).GetPrimvarsWithValues()
    known = [each for each in primvars if str(each.GetTypeName()) in ("texCoord2f[]", "texCoord2d[]", "texCoord2h[]", "float2[]")]
    known.sort(key=lambda primvar: primvar.GetPrimvarName() != "st")
    if not known:
        return None
    return _expand_to_corners(known[0].ComputeFlattened(time), str(known[0].GetInterpolation()), 2, points, corners)


def _expand_to_corners(raw_values: Any, interpolation: str, width: int, points: int, corners: Integers) -> Floats | None:
    """Return the values [corners, width] of face corners. Return None if values are not finite or do not match
    `interpolation`."""
    values = _to_rows(raw_values, width)
    if not len(values) or not np.isfinite(values).all():
        return None
    if interpolation in ("vertex", "varying") and len(values) == points:
        return np.asarray(values[corners])
    if interpolation == "faceVarying" and len(values) == len(corners):
        return values
    return None


def _split_points(
    corners: Integers, triangles: Integers, attributes: dict[str, Floats | None]
) -> tuple[Integers, Integers, dict[str, Floats | None]]:
    """Return the points of a shape as indices of the file's points, the triangles (n, 3) of these points, and their attributes.

    A point of the file becomes several points if its face corners have different attributes."""
    columns = [corners[:, None].astype(np.float64), *(each for each in attributes.values() if each is not None)]
    rows = np.concatenate(columns, axis=1)
    _, first, number = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    point_attributes = {key: None if each is None else each[first] for key, each in attributes.items()}
    return corners[first], number.reshape(-1)[triangles], point_attributes


def _read_capture(body: UsdBody, prim: Any, skin: Skin, points: int, source: Integers, time: Any) -> SkinWeights:
    """Return the joints that the points of a mesh follow, and their weights.

    `points`: the number of points in the file. `source`: for each point of the shape, its index in the file."""
    influences = skin.query.ComputeVaryingJointInfluences(points, time)
    each = int(skin.query.GetNumInfluencesPerComponent())
    if not influences or each < 1 or each > limits.MAX_JOINTS_PER_POINT or any(len(part) != points * each for part in influences):
        raise BodyError(f"has a mesh `{prim.GetPath()}` without joints and weights for each of its points", _EXPORT_HELP)
    joints = np.array(influences[0], np.int64).reshape(points, each)
    weights = np.array(influences[1], np.float64).reshape(points, each)
    if not np.isfinite(weights).all():
        raise BodyError(f"has a mesh `{prim.GetPath()}` with a weight that is not finite", _EXPORT_HELP)
    point_joints, shares, lone = normalise_capture(joints, np.maximum(weights, 0.0), len(skin.names))
    if lone:
        body.omissions[f"{lone:,} points of `{prim.GetPath()}` follow no joint; they now follow `{skin.names[0]}`"] = None
    return SkinWeights(skin.names, point_joints[source], shares[source], skin.inverse_matrices)


def _read_blend_shapes(body: UsdBody, shape: SkinShape, prim: Any, points: Floats, source: Integers) -> BlendTargets | None:
    """Add the blend shapes of a mesh to the library as shapes. Each is weighted by a channel of the same name."""
    skel = import_pxr_module("UsdSkel")
    binding = skel.BindingAPI(prim)
    tokens = [str(each) for each in binding.GetBlendShapesAttr().Get() or []]
    targets = binding.GetBlendShapeTargetsRel().GetForwardedTargets()
    if not tokens or len(tokens) != len(targets):
        return None
    names = []
    for token, path in zip(tokens, targets, strict=True):
        blend_shape = skel.BlendShape(prim.GetStage().GetPrimAtPath(path))
        if not blend_shape:
            raise BodyError(f"has a mesh `{prim.GetPath()}` that names a blend shape `{path}` which is missing", _EXPORT_HELP)
        indices = blend_shape.GetPointIndicesAttr().Get()
        rows = np.arange(len(points)) if indices is None or not len(indices) else np.array(indices, np.int64)
        name = _add_blend_target(body, shape, make_unused_name(f"{shape.name}.{token}", body.shapes), source, points, rows,
                      blend_shape.GetOffsetsAttr().Get(), blend_shape.GetNormalOffsetsAttr().Get())  # fmt: skip
        inner: list[tuple[float, str]] = []
        for each in blend_shape.GetInbetweens():
            weight = each.GetWeight()
            if weight is None or not np.isfinite(weight) or weight in (0.0, 1.0):
                body.omissions[
                    f"an in-between of `{path}` is not read: it has no weight, or a weight that is reserved for complete shapes"
                ] = None
                continue
            own = make_unused_name(f"{name}.{each.GetAttr().GetName().rpartition(':')[2]}", body.shapes)
            inner.append(
                (
                    float(weight),
                    _add_blend_target(body, shape, own, source, points, rows, each.GetOffsets(), each.GetNormalOffsets()),
                )
            )
        if inner:
            inner.sort()
            between = InBetweens(tuple(each for _, each in inner), tuple(weight for weight, _ in inner))
            body.shapes[name] = replace(body.shapes[name], in_betweens=between)
        names.append(name)
        body.channels.setdefault(token, Channel(token))
    return BlendTargets(tuple(names), tuple(tokens), ("P", "N") if shape.normals is not None else ("P",))


def _add_blend_target(
    body: UsdBody,
    shape: SkinShape,
    name: str,
    source: Integers,
    points: Floats,
    rows: Integers,
    offsets: Any,
    normal_offsets: Any,
) -> str:
    """Add a copy of a shape to the library and return its name. Some points of the copy are moved by `offsets`. `rows`: the
    indices of these points in the file."""
    _count_points(body, len(source))
    moves = _to_rows(offsets, 3)
    right = len(moves) == len(rows) and (not len(rows) or (rows.min() >= 0 and rows.max() < len(points)))
    if not right or not np.isfinite(moves).all():
        raise BodyError(f"has a blend shape `{name}` with offsets that do not fit its mesh", _EXPORT_HELP)
    displacements = np.zeros_like(points)
    displacements[rows] = moves
    normals = shape.normals
    turns = _to_rows(normal_offsets, 3)
    if normals is not None and len(turns) == len(rows) and np.isfinite(turns).all():
        of_points = np.zeros_like(points)
        of_points[rows] = turns
        normals = (normals + of_points[source]).astype(np.float32)
    body.shapes[name] = SkinShape(
        name,
        (points + displacements)[source].astype(np.float32),
        shape.faces,
        normals,
        shape.uvs,
        attributes=dict(shape.attributes),
    )
    return name


# ---- colours


def _read_materials(body: UsdBody, prim: Any, face: Integers) -> tuple[tuple[str, ...], NDArray[np.int32] | None]:
    """Return the names of a mesh's materials, and the index of each triangle's material. Add the colours to the definition.
    `face`: the face of each triangle."""
    names: list[str] = []

    def number_material(bound: Any) -> int:
        name, colour = bound
        body.materials.setdefault(name, colour)
        if name not in names:
            names.append(name)
        return names.index(name)

    mesh_material = _read_bound_material(body, prim) or _read_display_colour(prim)
    subsets = import_pxr_module("UsdShade").MaterialBindingAPI(prim).GetMaterialBindSubsets()
    if mesh_material is None and not subsets:
        return (), None
    most = int(face.max()) + 1
    of_face = np.full(most, number_material(mesh_material or ("default", (1.0, 1.0, 1.0))), np.int32)
    for subset in subsets:
        bound = _read_bound_material(body, subset.GetPrim())
        if bound is not None:
            rows = np.array(subset.GetIndicesAttr().Get(body.stage.first_time) or [], np.int64)
            of_face[rows[(rows >= 0) & (rows < most)]] = number_material(bound)
    return tuple(names), of_face[face]


def _read_bound_material(body: UsdBody, prim: Any) -> tuple[str, tuple[float, float, float]] | None:
    """Return the name and base colour of the material that is bound to a prim, or None. A colour from a texture becomes white."""
    material = import_pxr_module("UsdShade").MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    if not material:
        return None
    shader = material.ComputeSurfaceSource()[0]
    colour_input = shader.GetInput("diffuseColor") if shader else None
    value = colour_input.Get() if colour_input else None
    if colour_input and colour_input.HasConnectedSource():
        body.omissions[f"the texture of `{material.GetPath()}` is not read"] = None
    colour = (1.0, 1.0, 1.0) if value is None or len(value) != 3 else tuple(float(min(max(c, 0.0), 1.0)) for c in value)
    return material.GetPrim().GetName(), (colour[0], colour[1], colour[2])


def _read_display_colour(prim: Any) -> tuple[str, tuple[float, float, float]] | None:
    """Return a mesh's display colour and a material name for it, or None if the mesh does not have exactly one display colour."""
    primvar = import_pxr_module("UsdGeom").Gprim(prim).GetDisplayColorPrimvar()
    value = primvar.Get() if primvar and primvar.HasValue() else None
    if value is None or len(value) != 1:
        return None
    red, green, blue = (float(min(max(c, 0.0), 1.0)) for c in value[0])
    return f"{prim.GetName()}_colour", (red, green, blue)
