"""Mesh files to `MeshData`: counts are held against the file's size before anything is allocated, and what a reader of meshes
would let pass (indices out of range, values that are not finite, faces without area) is looked at here."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.geometry.matrices import cosine_and_sine
from antdsl.scene.geometry.mesh_text import MeshError, read_obj, read_stl_text
from antdsl.scene.geometry.ply import HeaderError, read_header, read_triangles
from antdsl.scene.geometry.ply_body import read_faces
from antdsl.scene.setting import MeshData
from antdsl.scene.staging.cached import once_a_mesh

Floats = NDArray[np.float64]
Faces = NDArray[np.int64]

_FARTHEST = 1e9  # mm; a thousand kilometres


@dataclass(frozen=True, slots=True, eq=False)
class RawMesh:
    """Vertices in the file's units and axes, and how many faces without area were left out.

    `own_vertices` and `own_faces` are their numbers in the file, which has `counts` vertices and triangles."""

    vertices: Floats
    faces: Faces
    dropped: int
    own_vertices: NDArray[np.int64]
    own_faces: NDArray[np.int64]
    counts: tuple[int, int]


def read_mesh(data: bytes, name: str, group: str | None = None) -> RawMesh:
    """The triangles of an .obj, .ply or .stl file's bytes, of an .obj those of one `group` where it is given; MeshError says why
    there are none."""
    return _read(data, name, group) if len(data) <= _KEPT_BYTES else sound(*mesh_arrays(data, name, group))


_KEPT_BYTES = 2 * limits.MIB  # of a file that is read again for the next scene of a folder


@lru_cache(maxsize=16)
def _read(data: bytes, name: str, group: str | None) -> RawMesh:
    """Small meshes that several scenes share are read once. Nobody may change their arrays."""
    mesh = sound(*mesh_arrays(data, name, group))
    for array in (mesh.vertices, mesh.faces, mesh.own_vertices, mesh.own_faces):
        array.setflags(write=False)
    return mesh


def mesh_arrays(data: bytes, name: str, group: str | None = None) -> tuple[Floats, Faces]:
    """As `read_mesh`, all that the file has, nothing looked at but what reading needs."""
    kind = name.rsplit(".", 1)[-1].lower() if "." in name else ""
    reader = READERS.get(kind)
    if reader is None:
        raise MeshError(f"is not one of {', '.join('.' + k for k in READERS)}")
    try:
        if group is not None:
            if kind != "obj":
                raise MeshError("has no groups, as only .obj files do", "leave `group` out")
            return read_obj(data, group)
        return reader(data)
    except MeshError:
        raise
    except Exception as problem:  # a reader of other people's making meets a file of other people's making
        raise MeshError(f"cannot be read ({type(problem).__name__})") from problem


def sound(vertices: Floats, faces: Faces) -> RawMesh:
    """The checks that hold for every format."""
    if len(vertices) == 0 or len(faces) == 0:
        raise MeshError("has no faces")
    if len(faces) > limits.MESH_FACES:
        raise MeshError(f"has {len(faces):,} faces, more than {limits.MESH_FACES:,}", "use a lighter mesh")
    bad = np.flatnonzero((faces < 0).any(axis=1) | (faces >= len(vertices)).any(axis=1))
    if len(bad):
        raise MeshError(f"has a face (number {bad[0]}) that names a vertex which is not there")
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
    first = _first_of_each(np.sort(faces, axis=1).astype(np.int64), len(vertices))
    single = np.zeros(len(faces), bool)
    single[first] = True
    keep &= single
    if not keep.any():
        raise MeshError("has no face with an area")
    kept = faces[keep]
    # vertices that no face uses would stretch the bounding box
    numbers = np.full(len(vertices), -1, np.int64)
    used[:] = False
    used[kept.ravel()] = True
    numbers[used] = np.arange(int(used.sum()))
    return RawMesh(
        np.ascontiguousarray(vertices[used]),
        numbers[kept],
        int(len(faces) - len(kept)),
        np.flatnonzero(used),
        np.flatnonzero(keep),
        (len(vertices), len(faces)),
    )


def _first_of_each(rows: Faces, bound: int) -> NDArray[np.int64]:
    """Where each row of three numbers below `bound` stands first. As one number they are compared sooner."""
    if bound > 2**21:
        _, first = np.unique(rows, axis=0, return_index=True)
    else:
        _, first = np.unique((rows[:, 0] << 42) | (rows[:, 1] << 21) | rows[:, 2], return_index=True)
    return np.asarray(first, np.int64)


def _read_ply(data: bytes) -> tuple[Floats, Faces]:
    """A .ply file, after its header was held against the size of the file."""
    try:
        header = read_header(data)
        found = read_triangles(data, header)
        return read_faces(data, header) if found is None else found
    except HeaderError as why:
        raise MeshError(str(why)) from None


def _read_stl(data: bytes) -> tuple[Floats, Faces]:
    """A .stl file, binary or text, with the corners that lie at one point joined."""
    if len(data) >= 84 and len(data) == 84 + 50 * struct.unpack_from("<I", data, 80)[0]:
        count = struct.unpack_from("<I", data, 80)[0]
        if count > limits.MESH_FACES:
            raise MeshError(f"says it has {count:,} faces, more than {limits.MESH_FACES:,}", "use a lighter mesh")
        rows = np.frombuffer(data, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("pad", "<u2")]), count, 84)
        corners = rows["corners"].reshape(-1, 3).astype(np.float64)
    elif data[: 64 * limits.KIB].lstrip()[:5].lower() == b"solid" and b"facet" in data[: 64 * limits.KIB].lower():
        corners = read_stl_text(data)
    else:
        raise MeshError("is not a .stl file, or a part of it is missing")
    wrong = np.flatnonzero(~np.isfinite(corners).all(axis=1))
    if len(wrong):
        raise MeshError(f"has a corner (of face {wrong[0] // 3}) that is not a finite point")
    vertices, inverse = np.unique(corners, axis=0, return_inverse=True)
    return vertices, inverse.reshape(-1, 3).astype(np.int64)


READERS: dict[str, Callable[[bytes], tuple[Floats, Faces]]] = {"ply": _read_ply, "obj": read_obj, "stl": _read_stl}


def turned_up(points: Floats, own: str, wanted: str) -> Floats:
    """Points of a file whose up axis is `own` in a scene whose up axis is `wanted`: a quarter turn about x."""
    if own == wanted:
        return points
    x, y, z = points.T
    return np.column_stack((x, z, -y) if own == "z" else (x, -z, y))


def rotated(points: Floats, angles: tuple[float, float, float]) -> Floats:
    """Points turned about x, then y, then z, by radians."""
    for axis, angle in enumerate(angles):
        if angle:
            c, s = cosine_and_sine(angle)
            b, d = (axis + 1) % 3, (axis + 2) % 3
            turned = points.copy()
            turned[:, b] = c * points[:, b] - s * points[:, d]
            turned[:, d] = s * points[:, b] + c * points[:, d]
            points = turned
    return points


@once_a_mesh
def placed(
    mesh: RawMesh, *, factor: float, own_up: str, up: str, angles: tuple[float, float, float], at: tuple[float, float, float]
) -> MeshData:
    """A file's mesh in the scene: millimetres, the scene's axes. A mirrored mesh keeps its outside outside. MeshError when
    it lies too far out."""
    vertices = rotated(turned_up(mesh.vertices * factor, own_up, up), angles) + np.array(at)
    made = within_reach(vertices, mesh.faces[:, ::-1] if factor < 0 else mesh.faces)
    if not mesh.vertices.flags.writeable:
        for array in (made.vertices, made.faces):
            array.setflags(write=False)
    return made


def within_reach(vertices: Floats, faces: NDArray[np.integer]) -> MeshData:
    """Vertices in mm as a mesh; MeshError when one lies too far out."""
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > _FARTHEST:
        raise MeshError("lies more than a thousand kilometres out", "move it with `at`, or check its `units`")
    return MeshData(np.ascontiguousarray(vertices), np.ascontiguousarray(faces, np.int32))
