"""Packets of the fields that a page displays: values on a mesh, sent a few times per second.

The mesh of a field is the ground, cut into faces about as large as a cell. A cell that is on no mesh is displayed as a square."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import compute_vertex_normals
from antdsl.fields.growing import GrowingCells
from antdsl.fields.vector_field import list_program_fields
from antdsl.plan.field_components import name_field_components
from antdsl.preview.binary_packets import pack_arrays
from antdsl.preview.viewing.view_state import SlotPackets, ViewState
from antdsl.runtime import World
from antdsl.runtime.moving.moving_geometry import compute_vertices

Floats = NDArray[np.float64]

_MAX_MESH_VERTICES = 150_000  # vertices of one field's mesh, about: finer cells are shown more coarsely
_CELLS_PER_VERTEX = 4  # cells that a vertex is mixed from
_MAX_VERTEX_DISTANCE_CELLS = 1.5  # cells' sizes from the nearest vertex on from which a cell gets its own square
_CENTRE_SOFTNESS = 0.15  # of a cell: nearer than so a vertex counts as in the middle
_UPDATE_INTERVAL_SECONDS = 0.125  # seconds between two showings while it plays
_MESH_INTERVAL_SECONDS = 1.0  # the same of meshes that grow
_DEFAULT_FULL_VALUE = 100.0  # what is shown as full where a field has no limit
# The values that a byte can tell: 1 is the least of them, 255 is so many powers of ten more
MIN_BYTE_VALUE, BYTE_DECADES = 1e-8, 16


def choose_full_value(limit: float) -> float:
    """Return the value that a page first displays in full colour. It depends only on the program, so a frame always looks the
    same."""
    return float(limit) if np.isfinite(limit) and limit > 1e-3 else _DEFAULT_FULL_VALUE


def encode_bytes(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return values on a logarithmic scale with steps of 16 %; 0 for values below `MIN_BYTE_VALUE`."""
    is_present = values >= MIN_BYTE_VALUE
    level = 1 + np.log10(np.where(is_present, values, MIN_BYTE_VALUE) / MIN_BYTE_VALUE) * (254 / BYTE_DECADES)
    return np.where(is_present, np.clip(np.rint(level), 1, 255), 0).astype(np.uint8)


class FieldPackets:
    """A maker of the packets for the slots `fieldmesh:NAME` and `field:NAME`. A field has one byte per vertex, see
    `encode_bytes`."""

    def __init__(self) -> None:
        self._world: World | None = None
        self._mesh_source_by_field: dict[str, tuple[object, int, float]] = {}  # what a mesh was made of, and when
        self._moving_meshes: set[str] = set()  # meshes
        self._meshes: dict[str, FieldMesh] = {}
        self._last_frame_by_field: dict[str, int] = {}  # the frame shown last
        self._last_sent_time = -1.0

    def make_packets(self, view_state: ViewState) -> SlotPackets:
        """Yield the packets of field meshes and values that changed. Their rate is limited."""
        world = view_state.world
        field_names = sorted(view_state.interest.fields & list_program_fields(world).keys())
        if world is not self._world:  # the same cells, often, and other values
            self._world = world
            self._last_frame_by_field = dict.fromkeys(self._last_frame_by_field, -1)
            moving = set(world.setting.motion.meshes)
            if moving != self._moving_meshes:
                self._moving_meshes = moving
                self._mesh_source_by_field.clear()
        for removed_name in self._meshes.keys() - set(field_names):  # a new request sends it again
            del self._meshes[removed_name]
            self._mesh_source_by_field.pop(removed_name, None)
            self._last_frame_by_field.pop(removed_name, None)
        if not field_names or (
            view_state.is_advancing
            and view_state.time - self._last_sent_time < _UPDATE_INTERVAL_SECONDS
            and self._last_frame_by_field.keys() >= set(field_names)
        ):
            return
        self._last_sent_time = view_state.time
        for name in field_names:
            yield from self._make_field_packets(view_state, name)

    def _make_field_packets(self, view_state: ViewState, name: str) -> SlotPackets:
        world, field = view_state.world, list_program_fields(view_state.world)[name]
        made_of, count, when = self._mesh_source_by_field.get(name, (None, 0, -_MESH_INTERVAL_SECONDS))
        grown = count != count_used_cells(field) and (
            view_state.time - when >= _MESH_INTERVAL_SECONDS or not view_state.is_advancing
        )
        if made_of is not field.cells or grown:
            mesh = make_field_mesh(world, name)
            self._meshes[name], self._mesh_source_by_field[name] = mesh, (field.cells, count_used_cells(field), view_state.time)
            self._last_frame_by_field.pop(name, None)
        if self._last_frame_by_field.get(name) == world.frame:
            return
        mesh = self._meshes[name]
        if name not in self._last_frame_by_field or mesh.moving_vertices:
            slot = f"fieldmesh:{name}"
            yield slot, pack_arrays(slot, {"position": mesh.compute_positions(world), "face": mesh.face})
        self._last_frame_by_field[name] = world.frame
        value = encode_bytes(mesh.compute_values(field.amounts))
        yield f"field:{name}", pack_arrays(f"field:{name}", {"value": value}, frame=world.frame)


@dataclass(frozen=True, slots=True, eq=False)
class MovingVertices:
    """Vertices of a field mesh that move with a moving mesh. `first`: the index of the first of these vertices in the field
    mesh. `corners` int64 (k, 3): the three vertices of the moving mesh around each vertex. `weights` (k, 3): their
    barycentric weights."""

    mesh: str
    first: int
    corners: NDArray[np.int64]
    weights: Floats


@dataclass(frozen=True, slots=True, eq=False)
class FieldMesh:
    """The mesh of a field, with n vertices and m faces.

    `position`: float32 (n, 3), the positions at the first frame.
    `face`: uint32 (m, 3), the vertices of each face.
    `cell_indices`: int64 (n, 4), the cells that each vertex displays, blended by `cell_weights` (n, 4).
    `moving_vertices`: the vertices that move.
    """

    position: NDArray[np.float32]
    face: NDArray[np.uint32]
    cell_indices: NDArray[np.int64]
    cell_weights: NDArray[np.float32]
    moving_vertices: tuple[MovingVertices, ...] = ()

    def compute_positions(self, world: World) -> NDArray[np.float32]:
        """Return the positions of the vertices at the world's current frame."""
        positions = self.position.copy() if self.moving_vertices else self.position
        for each in self.moving_vertices:
            corners = compute_vertices(world, each.mesh, world.frame)[each.corners]
            positions[each.first : each.first + len(each.corners)] = np.einsum("nkd,nk->nd", corners, each.weights)
        return positions

    def compute_values(self, values: Floats) -> NDArray[np.float32]:
        """Return the value of each vertex, blended from the values of the cells that the vertex displays."""
        result: NDArray[np.float32] = np.einsum("nk,nk->n", values.astype(np.float32)[self.cell_indices], self.cell_weights)
        return result


def count_used_cells(field: Any) -> int:
    """Return the number of cells that have a position. Fields on a diggable ground have spare cells at the end."""
    return field.cells.used_count if isinstance(field.cells, GrowingCells) else len(field.cells)


def make_field_mesh(world: World, name: str) -> FieldMesh:
    """Return the mesh on which a field is displayed, for the current state of the world."""
    field = list_program_fields(world)[name]
    cells, count = field.cells, count_used_cells(field)
    positions, normals = cells.position[:count], cells.normal[:count]
    points, faces, carried, edge = _cut_ground(world, name, cells.cell)
    if len(points) and count:
        from scipy.spatial import cKDTree

        point_normals = compute_vertex_normals(points, faces.astype(np.int32)).astype(np.float64)
        near, share = _find_cell_weights(points, point_normals, positions, normals, cells.cell)
        lone = np.flatnonzero(cKDTree(points).query(positions)[0] > _MAX_VERTEX_DISTANCE_CELLS * max(cells.cell, edge))
    else:
        near, share, lone = np.empty((0, _CELLS_PER_VERTEX), np.int64), np.empty((0, _CELLS_PER_VERTEX)), np.arange(count)
        points, faces, carried = np.empty((0, 3)), np.empty((0, 3), np.int64), ()
    corners, squares, own, square_share = _make_squares(positions[lone], normals[lone], cells.cell, lone)
    return FieldMesh(
        np.concatenate([points, corners]).astype(np.float32),
        np.concatenate([faces, squares + len(points)]).astype(np.uint32),
        np.concatenate([near, own]),
        np.concatenate([share, square_share]).astype(np.float32),
        carried,
    )


def _cut_ground(world: World, name: str, cell: float) -> tuple[Floats, NDArray[np.int64], tuple[MovingVertices, ...], float]:
    """Return the meshes that carry the field, at the first frame, cut until edges are about as long as a cell.

    The results are the vertices, the faces, the moving vertices, and the length of the longest edge."""
    stored_name = name if name in world.plan.fields else name_field_components(name)[0]
    requested_names, setting = world.plan.fields[stored_name].surfaces, world.setting
    mesh_names = [each for each in setting.surfaces if not requested_names or each in requested_names]
    rest = [setting.surfaces[each].vertices - world.origin for each in mesh_names]
    faces = [setting.surfaces[each].faces.astype(np.int64) for each in mesh_names]
    area = sum(_compute_area(*mesh) for mesh in zip(rest, faces, strict=True))
    edge = max(cell, float(np.sqrt(area / (0.5 * _MAX_MESH_VERTICES))))
    parts, carried, first = [], [], 0
    for each, vertices, triangles in zip(mesh_names, rest, faces, strict=True):
        points, cut, of = _cut_mesh(vertices, triangles, edge)
        if each in setting.motion.meshes:
            carried.append(_make_moving_vertices(each, first, points, cut, of, vertices, triangles))
        parts.append((points, cut + first))
        first += len(points)
    if not parts:
        return np.empty((0, 3)), np.empty((0, 3), np.int64), (), edge
    return np.concatenate([p for p, _ in parts]), np.concatenate([f for _, f in parts]), tuple(carried), edge


def _compute_area(vertices: Floats, faces: NDArray[np.int64]) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _cut_mesh(vertices: Floats, faces: NDArray[np.int64], edge: float) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Return the vertices and faces of a refined mesh, and for each new face the index of its original face."""
    from trimesh.remesh import subdivide_to_size

    points, cut, of = subdivide_to_size(vertices, faces, edge, max_iter=20, return_index=True)  # type: ignore[no-untyped-call]
    return np.asarray(points, np.float64), np.asarray(cut, np.int64), np.asarray(of, np.int64)


def _make_moving_vertices(
    name: str,
    first: int,
    points: Floats,
    cut_faces: NDArray[np.int64],
    source_faces: NDArray[np.int64],
    vertices: Floats,
    faces: NDArray[np.int64],
) -> MovingVertices:
    """Return the vertices of a field mesh that move with the mesh `name`. For each point, a triangle of that mesh and the
    barycentric weights of the point in the triangle are stored."""
    from trimesh.triangles import points_to_barycentric

    face = np.zeros(len(points), np.int64)
    face[cut_faces] = source_faces[:, None]
    weight = points_to_barycentric(vertices[faces[face]], points)  # type: ignore[no-untyped-call]
    return MovingVertices(name, first, faces[face], np.asarray(weight, np.float64))


def _find_cell_weights(
    points: Floats, point_normals: Floats, positions: Floats, normals: Floats, cell: float
) -> tuple[NDArray[np.int64], Floats]:
    """Return, for each point, the nearest cells on the side that the point faces, and the weights of these cells. Weights
    decrease with distance."""
    from scipy.spatial import cKDTree

    distance, near = cKDTree(positions).query(points, k=[min(k, len(positions)) for k in range(1, _CELLS_PER_VERTEX + 1)])
    same = np.einsum("nkd,nd->nk", normals[near], point_normals) > 0
    share = np.where(same, 1 / (distance**2 + (_CENTRE_SOFTNESS * cell) ** 2), 0.0)
    share[(distance > 2 * cell) & (distance > distance[:, :1])] = 0.0
    total = share.sum(axis=1, keepdims=True)
    return near.astype(np.int64), np.where(total > 0, share / np.maximum(total, 1e-300), 0.0)


def _make_squares(
    positions: Floats, normals: Floats, cell: float, cell_indices: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64], Floats]:
    """Return a square for each of the cells `cell_indices`, perpendicular to the cell's normal.

    The results are the vertices, the faces, and for each vertex its cells with their weights."""
    other = np.where(np.abs(normals[:, :1]) < 0.9, np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]))
    right = np.cross(normals, other)
    right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-12)
    above = np.cross(normals, right)
    half = cell / 2
    corners = [positions + half * (i * right + k * above) for i, k in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    first = np.arange(len(positions))[:, None] * 4
    faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])]).astype(np.int64)
    share = np.zeros((len(positions) * 4, _CELLS_PER_VERTEX))
    share[:, 0] = 1.0
    return (
        np.stack(corners, axis=1).reshape(-1, 3),
        faces,
        np.repeat(cell_indices, 4 * _CELLS_PER_VERTEX).reshape(-1, _CELLS_PER_VERTEX),
        share,
    )
