"""Reads mesh files to `MeshData`. Counts are compared with the size of the file before anything is allocated.

This module also checks the results of all mesh readers for indices out of range, values that are not finite, and faces without
area."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.geometry.gltf_mesh import SiblingReader, read_gltf_mesh
from antdsl.scene.geometry.houdini_mesh import read_houdini, read_houdini_by_name
from antdsl.scene.geometry.import_notes import ImportNotes
from antdsl.scene.geometry.matrices import compute_cosine_and_sine
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.geometry.obj_file import read_obj
from antdsl.scene.geometry.ply import HeaderError
from antdsl.scene.geometry.ply_body import read_ply
from antdsl.scene.geometry.polygons import PolygonMesh, TooManyCornersError, triangulate_polygons
from antdsl.scene.geometry.stl_file import read_stl
from antdsl.scene.paths import PathRefused
from antdsl.scene.setting import MeshData
from antdsl.scene.staging.mesh_cache import cache_per_mesh

Floats = NDArray[np.float64]
Faces = NDArray[np.int64]

_MAX_COORDINATE_MM = 1e9  # mm; a thousand kilometres


@dataclass(frozen=True, slots=True, eq=False)
class RawMesh:
    """A mesh in the units and axes of its file. `dropped_faces`: the number of faces that were omitted because they have no
    area.

    `file_vertex_indices`, `file_face_indices`: the index of each vertex and face in the file.
    `file_counts`: the numbers of vertices and triangles in the file."""

    vertices: Floats
    faces: Faces
    dropped_faces: int
    file_vertex_indices: NDArray[np.int64]
    file_face_indices: NDArray[np.int64]
    file_counts: tuple[int, int]
    notes: ImportNotes = field(default_factory=ImportNotes)


def read_mesh(data: bytes, name: str, group: str | None = None, read_sibling: SiblingReader | None = None) -> RawMesh:
    """Return the triangles in a file's bytes. Raises MeshError with the reason if there are none.

    `group`: None reads everything. In an .obj file, it is the only group or object to read. In a glTF file, it is a node, which
    is read with all nodes below it. In a .geo or .bgeo file, it is the `name` of the primitives to read.
    `read_sibling(path, max_bytes)`: returns the bytes of a file in the same folder."""
    is_cached = len(data) <= _MAX_CACHED_BYTES and not name.lower().endswith(
        ".gltf"
    )  # buffers of .gltf files may be in other files
    return _read_cached_mesh(data, name, group) if is_cached else _read_and_check_mesh(data, name, group, read_sibling)


_MAX_CACHED_BYTES = 2 * limits.MIB  # cache for files that are read again by the next scene of a folder


@lru_cache(maxsize=16)
def _read_cached_mesh(data: bytes, name: str, group: str | None) -> RawMesh:
    """Return the mesh in a file's bytes. Small meshes are cached for later scenes, so the arrays must not be changed."""
    mesh = _read_and_check_mesh(data, name, group, None)
    for array in (mesh.vertices, mesh.faces, mesh.file_vertex_indices, mesh.file_face_indices):
        array.setflags(write=False)
    return mesh


def _read_and_check_mesh(data: bytes, name: str, group: str | None, read_sibling: SiblingReader | None) -> RawMesh:
    notes = ImportNotes()
    return check_mesh(*read_mesh_arrays(data, name, group, read_sibling, notes), notes)


def read_mesh_arrays(
    data: bytes, name: str, group: str | None = None, read_sibling: SiblingReader | None = None, notes: ImportNotes | None = None
) -> tuple[Floats, Faces]:
    """Return the vertices and all triangles of a file, without the checks of `check_mesh`.

    For the arguments, see `read_mesh`. `notes`: receives the elements that were omitted."""
    notes = ImportNotes() if notes is None else notes
    kind = name.rsplit(".", 1)[-1].lower() if "." in name else ""
    if kind not in MESH_SUFFIXES:
        raise MeshError(
            f"is not one of {', '.join('.' + k for k in MESH_SUFFIXES)}", "export it as a .glb, .ply, .obj or .stl file"
        )
    if group is not None and kind in READER_BY_SUFFIX:
        raise MeshError("has no groups, which only .obj, .geo, .bgeo and glTF files have", "leave `group` out")
    with _raise_mesh_errors():
        if kind in READER_BY_SUFFIX:
            return _triangulate_mesh(READER_BY_SUFFIX[kind](data, notes), notes)
        if kind in GROUP_READER_BY_SUFFIX:
            return _triangulate_mesh(GROUP_READER_BY_SUFFIX[kind](data, notes, group), notes)
        return _triangulate_mesh(read_gltf_mesh(data, notes, group, read_sibling or _reject_sibling), notes)


def read_named_meshes(data: bytes, name: str) -> dict[str, RawMesh]:
    """Return the meshes of a .geo or .bgeo file, by the names of their primitives. The result is empty for other files.

    Raises MeshError with the reason if the file cannot be read."""
    if not name.lower().endswith((".geo", ".bgeo")):
        return {}
    skipped, meshes = ImportNotes(), dict[str, RawMesh]()
    with _raise_mesh_errors():
        for each, mesh in read_houdini_by_name(data, skipped).items():
            notes = ImportNotes(skipped_elements=skipped.skipped_elements)
            meshes[each] = check_mesh(*_triangulate_mesh(mesh, notes), notes)
    return meshes


@contextmanager
def _raise_mesh_errors() -> Iterator[None]:
    """Convert errors of the readers of untrusted files to MeshError, within the context."""
    try:
        yield
    except (MeshError, PathRefused, MemoryError):
        raise
    except HeaderError as error:
        raise MeshError(str(error)) from None
    except TooManyCornersError as error:
        raise MeshError(str(error), "cut it into smaller faces in the program that made the mesh") from None
    except Exception as problem:  # a library may raise any error for an untrusted file
        raise MeshError(f"cannot be read ({type(problem).__name__})") from problem


def _triangulate_mesh(mesh: PolygonMesh, notes: ImportNotes) -> tuple[Floats, Faces]:
    """Return the vertices of a mesh, and triangles in place of its polygons."""
    wrong = np.flatnonzero((mesh.point_indices < 0) | (mesh.point_indices >= len(mesh.points)))
    if len(wrong):
        face = int(np.searchsorted(np.cumsum(mesh.corner_counts), wrong[0], side="right"))
        raise MeshError(f"has a face (number {face}) that names a missing vertex")
    if np.maximum(mesh.corner_counts - 2, 0).sum() > limits.MAX_MESH_FACES:
        raise MeshError(f"has more than {limits.MAX_MESH_FACES:,} faces", "use a lighter mesh")
    points = mesh.points
    bad = np.asarray((~np.isfinite(points) | (np.abs(points) >= 1e30)).any(axis=1))
    if bad.any():
        used = mesh.point_indices[bad[mesh.point_indices]]
        if len(used):
            raise MeshError(f"has a vertex (number {used[0]}) that is not a finite point")
    triangulation = triangulate_polygons(points, mesh.corner_counts, mesh.point_indices)
    small = mesh.corner_counts < 3
    notes.count_skipped("faces of fewer than three corners", int(small.sum()))
    notes.cut_polygons, notes.concave_polygons, notes.crossing_polygons = (
        triangulation.cut_count,
        triangulation.concave_count,
        len(triangulation.crossing_polygons),
    )
    notes.crossing_face = triangulation.crossing_polygons[0] if triangulation.crossing_polygons else 0
    notes.vertices, notes.triangles = len(points), len(triangulation.corners)
    return points, mesh.point_indices[triangulation.corners]


def check_mesh(vertices: Floats, faces: Faces, notes: ImportNotes | None = None) -> RawMesh:
    """Return vertices and faces after checks that all formats share. Raises MeshError with the reason if a check fails."""
    if len(vertices) == 0 or len(faces) == 0:
        raise MeshError("has no faces")
    if len(faces) > limits.MAX_MESH_FACES:
        raise MeshError(f"has {len(faces):,} faces, more than {limits.MAX_MESH_FACES:,}", "use a lighter mesh")
    bad = np.flatnonzero((faces < 0).any(axis=1) | (faces >= len(vertices)).any(axis=1))
    if len(bad):
        raise MeshError(f"has a face (number {bad[0]}) that names a missing vertex")
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True
    wrong = np.flatnonzero(used & ~(np.isfinite(vertices).all(axis=1) & (np.abs(vertices) < 1e30).all(axis=1)))
    if len(wrong):
        raise MeshError(f"has a vertex (number {wrong[0]}) that is not a finite point")
    corners = vertices[faces]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(a, b)
    area = np.sqrt((across * across).sum(axis=1))
    longest = np.maximum((a * a).sum(axis=1), (b * b).sum(axis=1))
    keep = area > 1e-12 * longest
    first = _find_first_rows(np.sort(faces, axis=1).astype(np.int64), len(vertices))
    single = np.zeros(len(faces), bool)
    single[first] = True
    keep &= single
    if not keep.any():
        raise MeshError("has no face with an area")
    sound_faces = faces[keep]
    # unused vertices would extend the bounding box
    numbers = np.full(len(vertices), -1, np.int64)
    used[:] = False
    used[sound_faces.ravel()] = True
    numbers[used] = np.arange(int(used.sum()))
    return RawMesh(
        np.ascontiguousarray(vertices[used]),
        numbers[sound_faces],
        int(len(faces) - len(sound_faces)),
        np.flatnonzero(used),
        np.flatnonzero(keep),
        (len(vertices), len(faces)),
        notes or ImportNotes("", len(vertices), len(faces)),
    )


def _find_first_rows(rows: Faces, bound: int) -> NDArray[np.int64]:
    """Return the index of the first occurrence of each distinct row of three integers.

    `bound`: a number that is larger than all integers in the rows. It allows combining each row into a single number, which is
    faster to sort."""
    if bound > 2**21:
        _, first = np.unique(rows, axis=0, return_index=True)
    else:
        _, first = np.unique((rows[:, 0] << 42) | (rows[:, 1] << 21) | rows[:, 2], return_index=True)
    return np.asarray(first, np.int64)


READER_BY_SUFFIX: dict[str, Callable[[bytes, ImportNotes], PolygonMesh]] = {"ply": read_ply, "stl": read_stl}
GLTF_SUFFIXES = ("gltf", "glb")
GROUP_READER_BY_SUFFIX: dict[str, Callable[[bytes, ImportNotes, str | None], PolygonMesh]] = {
    "obj": read_obj,
    "geo": read_houdini,
    "bgeo": read_houdini,
}
MESH_SUFFIXES = (*READER_BY_SUFFIX, *GROUP_READER_BY_SUFFIX, *GLTF_SUFFIXES)


def _reject_sibling(path: str, max_bytes: int) -> bytes:
    """Raise MeshError for a mesh file that refers to another file, because other files cannot be read."""
    raise MeshError("has a buffer in another file", "export it as .glb, which has its buffers inside")


def rotate_up_axis(points: Floats, own_up: str, scene_up: str) -> Floats:
    """Return a file's points, rotated about x so that the up axis `own_up` becomes `scene_up`."""
    if own_up == scene_up:
        return points
    x, y, z = points.T
    return np.column_stack((x, z, -y) if own_up == "z" else (x, -z, y))


def rotate_points(points: Floats, angles: tuple[float, float, float]) -> Floats:
    """Return points rotated about x, then y, then z. `angles`: in radians."""
    for axis, angle in enumerate(angles):
        if angle:
            c, s = compute_cosine_and_sine(angle)
            b, d = (axis + 1) % 3, (axis + 2) % 3
            turned = points.copy()
            turned[:, b] = c * points[:, b] - s * points[:, d]
            turned[:, d] = s * points[:, b] + c * points[:, d]
            points = turned
    return points


@cache_per_mesh
def transform_raw_mesh(
    mesh: RawMesh,
    *,
    factor: float,
    own_up: str,
    up: str,
    angles: tuple[float, float, float],
    position: tuple[float, float, float],
) -> MeshData:
    """Return a file's mesh as placed in the scene, in millimetres and the scene's axes. Raises MeshError if a vertex is too far
    out.

    If the transform mirrors, faces are reversed, so that the outside of the mesh remains its outside."""
    vertices = rotate_points(rotate_up_axis(mesh.vertices * factor, own_up, up), angles) + np.array(position)
    mesh_data = make_size_checked_mesh(vertices, mesh.faces[:, ::-1] if factor < 0 else mesh.faces)
    if not mesh.vertices.flags.writeable:
        for array in (mesh_data.vertices, mesh_data.faces):
            array.setflags(write=False)
    return mesh_data


def make_size_checked_mesh(vertices: Floats, faces: NDArray[np.integer]) -> MeshData:
    """Return vertices in mm and faces as a mesh. Raises MeshError if a vertex is too far out."""
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > _MAX_COORDINATE_MM:
        raise MeshError("is more than 1000 km from the origin", "move it with `at`, or check its `units`")
    return MeshData(np.ascontiguousarray(vertices), np.ascontiguousarray(faces, np.int32))


@cache_per_mesh
def compute_mesh_area(mesh: MeshData) -> float:
    """Return the area of all faces in mm²."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    return float(np.sqrt((across * across).sum(axis=1)).sum() / 2)
