"""Mesh files to `MeshData`: counts are held against the file's size before anything is allocated, and what a reader of meshes
would let pass (indices out of range, values that are not finite, faces without area) is looked at here."""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.kept import once_a_mesh
from antdsl.scene.matrices import cosine_and_sine
from antdsl.scene.ply import HeaderError, read_header, read_triangles
from antdsl.scene.setting import MeshData

Floats = NDArray[np.float64]
Faces = NDArray[np.int64]

_FARTHEST = 1e9  # mm; a thousand kilometres


class MeshError(Exception):
    """Why a file is no usable mesh, in words that fit after its name; `help` says what to do about it."""

    def __init__(self, message: str, help: str | None = "export it anew, as triangles or polygons in a .ply, .obj or .stl file"):
        super().__init__(message)
        self.help = help


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
            return _read_obj(data, group)
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


def _number(text: bytes) -> float:
    if len(text) > 40 or b"_" in text:
        raise ValueError(text)
    return float(text)


def _read_obj(data: bytes, group: str | None = None) -> tuple[Floats, Faces]:
    """Vertices and faces of a Wavefront file, of one group or object where one is named; materials, normals and everything else
    are passed over, polygons cut into fans."""
    if b"\0" in data[:4096]:
        raise MeshError("is not a text file")
    points: list[tuple[float, float, float]] = []
    triangles: list[tuple[int, int, int]] = []
    names: dict[str, None] = {}
    in_group, in_object = group is None, False
    for line_number, line in enumerate(data.split(b"\n"), 1):
        if line[:2] in (b"v ", b"v\t"):
            try:
                x, y, z = (_number(word) for word in line.split()[1:4])
            except ValueError:
                raise MeshError(f"has no three numbers after `v` in line {line_number}") from None
            points.append((x, y, z))
        elif group is not None and line.split(None, 1)[:1] == [b"g"]:
            words = line.decode("utf-8", "replace").split()[1:] or ["default"]
            names |= dict.fromkeys(words)
            in_group = group in words
        elif group is not None and line[:2] == b"o ":
            word = line[2:].decode("utf-8", "replace").strip()
            names[word] = None
            in_object = group == word
        elif line[:2] in (b"f ", b"f\t") and (in_group or in_object):
            corners = [_obj_index(word, len(points), line_number) for word in line.split()[1:]]
            if len(corners) < 3:
                raise MeshError(f"has a face of fewer than three corners in line {line_number}")
            triangles.extend((corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1))
            if len(triangles) > limits.MESH_FACES:
                raise MeshError(f"has more than {limits.MESH_FACES:,} faces", "use a lighter mesh")
    if group is not None and not triangles:
        raise MeshError(_no_group(group, list(names)), None)
    return np.array(points, np.float64).reshape(-1, 3), np.array(triangles, np.int64).reshape(-1, 3)


def _no_group(group: str, names: list[str]) -> str:
    from antdsl.diagnostics.suggestion import nearest_name

    if group in names:
        return f"has no faces in its group `{group}`"
    near = nearest_name(group, names)
    there = f"did you mean `{near}`?" if near else "it has " + (", ".join(f"`{n[:40]}`" for n in names[:8]) or "no groups")
    return f"has no group `{group[:60]}`: {there}"


def _obj_index(word: bytes, count: int, line_number: int) -> int:
    parts = word.split(b"/")
    if len(parts) > 3 or not re.fullmatch(rb"-?[0-9]{1,10}", parts[0]) or int(parts[0]) == 0:
        raise MeshError(f"has a corner `{word[:20].decode('ascii', 'replace')}` that is no vertex number in line {line_number}")
    index = int(parts[0])
    index = index - 1 if index > 0 else count + index
    if index < 0 or index >= count:
        raise MeshError(f"names a vertex {int(parts[0])} that is not there in line {line_number}")
    return index


def _read_ply(data: bytes) -> tuple[Floats, Faces]:
    """A .ply file, after its header was held against the size of the file."""
    try:
        header = read_header(data)
    except HeaderError as why:
        raise MeshError(str(why)) from None
    found = read_triangles(data, header)
    return _through_trimesh(data, "ply") if found is None else found


def _read_stl(data: bytes) -> tuple[Floats, Faces]:
    """A .stl file, binary or text, with the corners that lie at one point joined."""
    if len(data) >= 84 and len(data) == 84 + 50 * struct.unpack_from("<I", data, 80)[0]:
        count = struct.unpack_from("<I", data, 80)[0]
        if count > limits.MESH_FACES:
            raise MeshError(f"says it has {count:,} faces, more than {limits.MESH_FACES:,}", "use a lighter mesh")
        rows = np.frombuffer(data, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("pad", "<u2")]), count, 84)
        corners = rows["corners"].reshape(-1, 3).astype(np.float64)
    elif data.lstrip()[:5] == b"solid" and b"facet" in data[: 64 * limits.KIB]:
        words = re.findall(rb"vertex\s+(\S{1,40})\s+(\S{1,40})\s+(\S{1,40})", data)
        if not words or len(words) % 3:
            raise MeshError("has a facet without three corners")
        try:
            corners = np.array([[_number(w) for w in row] for row in words], np.float64)
        except ValueError:
            raise MeshError("has a corner that is not three numbers") from None
    else:
        raise MeshError("is not a .stl file, or a part of it is missing")
    if not np.isfinite(corners).all():
        raise MeshError("has a corner that is not a finite point")
    vertices, inverse = np.unique(corners, axis=0, return_inverse=True)
    return vertices, inverse.reshape(-1, 3).astype(np.int64)


def _through_trimesh(data: bytes, kind: str) -> tuple[Floats, Faces]:
    import trimesh

    # process=False keeps the order of vertices; no resolver is given, so no other file can be opened
    mesh = trimesh.load(io.BytesIO(data), file_type=kind, process=False, force="mesh", skip_materials=True, maintain_order=True)
    faces = np.asarray(getattr(mesh, "faces", np.empty((0, 3))), np.int64).reshape(-1, 3)
    return np.asarray(getattr(mesh, "vertices", np.empty((0, 3))), np.float64).reshape(-1, 3), faces


READERS: dict[str, Callable[[bytes], tuple[Floats, Faces]]] = {"ply": _read_ply, "obj": _read_obj, "stl": _read_stl}


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
