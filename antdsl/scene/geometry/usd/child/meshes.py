"""Reads and joins the meshes at and below a prim: triangles in mm and the scene's axes, their motion, and painted values on
vertices."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.reader.sandbox import raise_memory_limit
from antdsl.scene.geometry.matrices import (
    apply_transforms,
    compose_transforms,
    compute_determinants,
    find_invertible,
    invert_transforms,
    make_identity_transforms,
)
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.geometry.polygons import TooManyCornersError, triangulate_polygons
from antdsl.scene.geometry.usd.child.shapes import (
    BAKE_HELP,
    PlacedUsdMesh,
    check_motion_bytes,
    find_placed_meshes,
    list_unread_types,
)
from antdsl.scene.geometry.usd.child.stage import Floats, OpenStage
from antdsl.scene.geometry.usd.errors import UsdError, import_pxr_module

Faces = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class JoinedMesh:
    """The joined meshes of a prim.

    `vertices` float64 (n, 3): in mm and the scene's axes.
    `faces` int64 (m, 3): in the order of the file.
    `motion_arrays`: the arrays of a `MeshMotion`, by name; None if the mesh is static.
    `values`: by the name of a primvar, numbers (n,), or vectors (n, 3) rotated with their mesh.
    `unread_shape_types`: types of shapes that are not read."""

    vertices: Floats
    faces: Faces
    motion_arrays: dict[str, NDArray[Any]] | None
    values: dict[str, Floats]
    unread_shape_types: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _MeshShape:
    """A mesh prim, with the transforms of all of its copies in the scene.

    `points`: its vertices at the first frame. `is_deformed`: whether the vertices move relative to the prim."""

    placed_mesh: PlacedUsdMesh
    points: Floats
    faces: Faces
    is_deformed: bool

    @property
    def count(self) -> int:
        """Return how many times the mesh appears in the scene."""
        return len(self.placed_mesh.transforms)


def join_meshes(stage: OpenStage, primvars: Iterable[str] = ()) -> JoinedMesh:
    """Return all meshes at and below the stage's prim, joined into one. `primvars`: the names of the primvars to read.

    Raises UsdError if there are no meshes, and MeshError if they are unusable."""
    path = stage.prim.GetPath()
    shapes, faces, points = [], 0, 0
    for placed in find_placed_meshes(stage):
        shape = _read_shape(stage, placed)
        faces += len(shape.faces) * shape.count
        points += len(shape.points) * shape.count
        if faces > limits.MAX_MESH_FACES or points > 3 * limits.MAX_MESH_FACES:
            words = f"the meshes below `{path}` have {faces:,} faces and {points:,} points"
            most = f"more than {limits.MAX_MESH_FACES:,} faces or {3 * limits.MAX_MESH_FACES:,} points are not supported"
            raise UsdError("too-large", f"{words}; {most}", "name a part of it")
        if len(shape.faces):
            shapes.append(shape)
    passed_over = tuple(list_unread_types(stage))
    if not shapes:
        also = f", only {', '.join(passed_over)}" if passed_over else ""
        raise UsdError("no-such-prim", f"there is no mesh at or below `{path}`{also}", _find_hidden_reason(stage))
    raise_memory_limit(6 * 24 * (faces + points))
    values = {name: np.concatenate([_read_values(stage, shape, name) for shape in shapes]) for name in primvars}
    return JoinedMesh(*_join_shapes(shapes), _make_moves(stage, shapes), values, passed_over)


def _read_shape(stage: OpenStage, placed_mesh: PlacedUsdMesh) -> _MeshShape:
    """Return the points and triangles of a mesh prim. Holes and left-handed orientation are taken into account, subdivision is
    not."""
    prim, mesh = placed_mesh.prim, import_pxr_module("UsdGeom").Mesh(placed_mesh.prim)
    path = prim.GetPath()
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(stage.first_time) or [], np.int64)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(stage.first_time) or [], np.int64)
    points = _read_points(mesh, stage.times[0])
    if counts.sum() != len(corners) or (counts < 0).any():
        raise MeshError(f"has at `{path}` a number of corners that does not match its faces")
    if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        raise MeshError(f"has at `{path}` a face that names a missing point")
    for attribute in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()):
        if len(stage.times) > 1 and attribute.ValueMightBeTimeVarying():
            _check_same_faces(stage, attribute, path)
    is_filled = np.ones(len(counts), np.bool_)
    holes = np.array(mesh.GetHoleIndicesAttr().Get(stage.first_time) or [], np.int64)
    is_filled[holes[(holes >= 0) & (holes < len(counts))]] = False
    faces = _make_triangles(
        points, counts, corners, is_filled, mesh.GetOrientationAttr().Get(stage.first_time) == "leftHanded", path
    )
    is_deformed = len(stage.times) > 1 and mesh.GetPointsAttr().ValueMightBeTimeVarying()
    return _MeshShape(placed_mesh, points, faces, is_deformed)


def _read_points(mesh: Any, time: float) -> Floats:
    values = mesh.GetPointsAttr().Get(import_pxr_module("Usd").TimeCode(time))
    return np.array([] if values is None else values, np.float64).reshape(-1, 3)


def _check_same_faces(stage: OpenStage, attribute: Any, path: Any) -> None:
    first = attribute.Get(stage.first_time)
    for time in stage.times[1:]:
        if attribute.Get(import_pxr_module("Usd").TimeCode(time)) != first:
            raise UsdError("moving-topology", f"the mesh `{path}` has other faces at other frames", BAKE_HELP)


def _make_triangles(
    points: Floats,
    counts: NDArray[np.int64],
    corners: NDArray[np.int64],
    is_filled: NDArray[np.bool_],
    is_reversed: bool,
    path: Any,
) -> Faces:
    """Return the triangles (m, 3) of the polygons for which `is_filled` is true.

    If `is_reversed` is true, the corners of each polygon are read in reverse order, starting with its first corner."""
    at = np.arange(len(corners))
    if is_reversed:
        start, count = np.repeat(np.cumsum(counts) - counts, counts), np.repeat(counts, counts)
        at = start + (start - at) % np.maximum(count, 1)
    filled_corners = corners[at[np.repeat(is_filled, counts)]]
    if len(filled_corners) and not np.isfinite(points[filled_corners]).all():
        raise MeshError(f"has at `{path}` a vertex that is not a finite point")
    try:
        return np.asarray(filled_corners[triangulate_polygons(points, counts[is_filled], filled_corners).corners])
    except TooManyCornersError as error:
        raise MeshError(f"has at `{path}` a part that {error}", "cut it into smaller faces in the program that made it") from None


def _join_shapes(shapes: list[_MeshShape]) -> tuple[Floats, Faces]:
    """Return the vertices and faces of every copy of every shape at the first frame. The faces of mirrored copies are reversed,
    so that their outside remains outside."""
    vertices, faces, vertex_count = [], [], 0
    for shape in shapes:
        transforms, count = shape.placed_mesh.transforms[:, 0], len(shape.points)
        vertices.append(apply_transforms(transforms[:, None], shape.points).reshape(-1, 3))
        is_mirrored = compute_determinants(transforms) < 0
        turned = np.where(is_mirrored[:, None, None], shape.faces[:, [0, 2, 1]], shape.faces)
        faces.append((turned + (vertex_count + count * np.arange(len(transforms)))[:, None, None]).reshape(-1, 3))
        vertex_count += count * len(transforms)
    return np.concatenate(vertices), np.concatenate(faces)


def _make_moves(stage: OpenStage, shapes: list[_MeshShape]) -> dict[str, NDArray[Any]] | None:
    """Return the arrays of a `MeshMotion`, or None if nothing moves. Each moving copy of a shape has one track.

    The vertices of a copy move individually if the mesh deforms, or if the first transform of the copy has no inverse."""
    frames = len(stage.times)
    if not any(shape.is_deformed or shape.placed_mesh.transforms.shape[1] > 1 for shape in shapes):
        return None
    separate_copies = [_find_separate_copies(shape) for shape in shapes]
    sizes = [
        len(shape.points) * frames * 24 * int(separate.sum())
        + shape.placed_mesh.transforms.shape[1] * 96 * int((~separate).sum())
        for shape, separate in zip(shapes, separate_copies, strict=True)
    ]
    check_motion_bytes(sum(sizes), "what moves")
    tracks, group, deformed, vertex_count, count = [make_identity_transforms(1, frames)], [], [], 0, 1
    for shape, separate in zip(shapes, separate_copies, strict=True):
        transforms, points = shape.placed_mesh.transforms, len(shape.points)
        is_first = (transforms == transforms[:, :1]).all(axis=(2, 3))
        moved = ~separate & ~is_first.all(axis=1)
        number = np.where(moved, count + np.cumsum(moved) - 1, 0)
        group.append(np.repeat(number.astype(np.int32), points))
        if moved.any():
            track = compose_transforms(transforms[moved], invert_transforms(transforms[moved, 0])[:, None])
            track[is_first[moved]] = make_identity_transforms()  # so that vertices at rest are exact
            tracks.append(track)
            count += len(track)
        deformed.append((vertex_count + points * np.flatnonzero(separate)[:, None] + np.arange(points)).ravel())
        vertex_count += points * len(transforms)
    numbers = np.concatenate(deformed)
    offsets = np.empty((frames if len(numbers) else 0, len(numbers), 3))
    for k in range(len(offsets)):
        offsets[k] = np.concatenate(
            [
                _compute_separate_offsets(stage, shape, separate, k)
                for shape, separate in zip(shapes, separate_copies, strict=True)
                if separate.any()
            ]
        )
    if count == 1 and not len(numbers):
        return None
    return {"group": np.concatenate(group), "tracks": np.concatenate(tracks), "bent": numbers, "offsets": offsets}


def _find_separate_copies(shape: _MeshShape) -> NDArray[np.bool_]:
    """Return, for each copy of a shape, whether its vertices move individually rather than all with one transform."""
    transforms = shape.placed_mesh.transforms
    if shape.is_deformed:
        return np.ones(len(transforms), np.bool_)
    return ~find_invertible(transforms[:, 0]) if transforms.shape[1] > 1 else np.zeros(len(transforms), np.bool_)


def _compute_separate_offsets(stage: OpenStage, shape: _MeshShape, is_separate: NDArray[np.bool_], k: int) -> Floats:
    """Return the offsets of vertices from their rest positions at frame `k`, for the copies in `is_separate`."""
    points = (
        _read_points(import_pxr_module("UsdGeom").Mesh(shape.placed_mesh.prim), stage.times[k])
        if shape.is_deformed
        else shape.points
    )
    if len(points) != len(shape.points):
        path = shape.placed_mesh.prim.GetPath()
        raise UsdError("moving-topology", f"the number of points of the mesh `{path}` changes between frames", BAKE_HELP)
    transforms = shape.placed_mesh.transforms[is_separate]
    shift = apply_transforms(transforms[:, min(k, transforms.shape[1] - 1), None], points) - apply_transforms(
        transforms[:, 0, None], shape.points
    )
    return shift.reshape(-1, 3)


def _read_values(stage: OpenStage, shape: _MeshShape, name: str) -> Floats:
    """Return the values of a primvar at the points of a shape, for one copy after the other. Vectors are rotated with their copy
    and retain their length."""
    prim = shape.placed_mesh.prim
    primvar = import_pxr_module("UsdGeom").PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue():
        raise UsdError("no-such-prim", f"`{prim.GetPath()}` has no primvar `{name}`", f"paint `primvars:{name}` on it")
    values = np.array(primvar.ComputeFlattened(stage.first_time), np.float64)
    values = values.reshape(-1, 1) if values.ndim == 1 and not _is_vector(primvar) else values.reshape(-1, values.shape[-1])
    if primvar.GetInterpolation() == "constant" and len(values) == 1:
        values = np.repeat(values, len(shape.points), axis=0)
    if len(values) != len(shape.points):
        words = f"the primvar `{name}` of `{prim.GetPath()}` has {len(values):,} values for {len(shape.points):,} points"
        raise UsdError("bad-usd", words, "paint it on the points (interpolation `vertex`)")
    if values.shape[1] == 3:
        return _rotate_vectors(shape.placed_mesh.transforms[:, 0, None], values).reshape(-1, 3)
    return np.tile(values[:, 0], shape.count)


def _is_vector(primvar: Any) -> bool:
    return "3" in str(primvar.GetTypeName())


def _rotate_vectors(transforms: Floats, vectors: Floats) -> Floats:
    turned = apply_transforms(np.concatenate([transforms[..., :3], np.zeros((*transforms.shape[:-1], 1))], axis=-1), vectors)
    long, size = (np.sqrt((v * v).sum(axis=-1, keepdims=True)) for v in (vectors, turned))
    return np.asarray(turned * (long / np.where(size > 0, size, 1.0)))


def _find_hidden_reason(stage: OpenStage) -> str | None:
    """Return help text about why a prim has no readable meshes: they do not exist, are invisible, or have another purpose."""
    usd, geom = import_pxr_module("Usd"), import_pxr_module("UsdGeom")
    every = [p for p in usd.PrimRange(stage.prim, usd.TraverseInstanceProxies()) if p.IsA(geom.Mesh)]
    if not every:
        return "name a prim that holds meshes"
    purposes = {str(geom.Imageable(p).ComputePurpose()) for p in every} - {"default", stage.purpose}
    if purposes & {"proxy", "render"}:
        return f"its meshes are of the purpose `{min(purposes)}`: write `purpose: {min(purposes & {'proxy', 'render'})}`"
    return "its meshes are invisible or guides"
