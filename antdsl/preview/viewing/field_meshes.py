"""Where a field is shown: the ground, cut as fine as its cells, and a square for each cell that lies on no mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import vertex_normals
from antdsl.runtime import World
from antdsl.runtime.carrying import vertices_at
from antdsl.runtime.fields.growing import GrowingCells

Floats = NDArray[np.float64]

_MOST = 150_000  # vertices of one field's mesh, about: finer cells are shown more coarsely
_NEAREST = 4  # cells that a vertex is mixed from
_BESIDE = 1.5  # cells' sizes from the nearest vertex on from which a cell gets a square of its own
_SOFT = 0.15  # of a cell: nearer than so a vertex counts as in the middle


@dataclass(frozen=True, slots=True, eq=False)
class FieldMesh:
    """Vertices float32 (n, 3), faces uint32 (m, 3); each vertex shows the cells `cell` int64 (n, 4), mixed by `share` (n, 4)."""

    position: NDArray[np.float32]
    face: NDArray[np.uint32]
    cell: NDArray[np.int64]
    share: NDArray[np.float32]

    def shown(self, values: Floats) -> NDArray[np.float32]:
        """What the vertices show of the cells' values."""
        found: NDArray[np.float32] = np.einsum("nk,nk->n", values.astype(np.float32)[self.cell], self.share)
        return found


def cells_in_use(field: Any) -> int:
    """Cells that are somewhere: ground that is dug has room for more."""
    return field.cells.used if isinstance(field.cells, GrowingCells) else len(field.cells)


def field_mesh(world: World, name: str) -> FieldMesh:
    """The mesh of a field as the world stands."""
    cells = world.fields[name].cells
    count = cells_in_use(world.fields[name])
    places, normals = cells.position[:count], cells.normal[:count]
    parts = [_ground(world, name, cells.cell, places, normals)]
    vertices = parts[0][0]
    lone = np.arange(count)
    if len(vertices) and count:
        from scipy.spatial import cKDTree

        lone = np.flatnonzero(cKDTree(vertices).query(places)[0] > _BESIDE * max(cells.cell, parts[0][4]))
    parts.append((*_squares(places[lone], normals[lone], cells.cell, lone), 0.0))
    shift = len(vertices)
    faces = np.concatenate([parts[0][1], parts[1][1] + shift])
    return FieldMesh(
        np.concatenate([parts[0][0], parts[1][0]]).astype(np.float32),
        faces.astype(np.uint32),
        np.concatenate([parts[0][2], parts[1][2]]),
        np.concatenate([parts[0][3], parts[1][3]]).astype(np.float32),
    )


_Part = tuple[Floats, NDArray[np.int64], NDArray[np.int64], Floats]


def _ground(world: World, name: str, cell: float, places: Floats, normals: Floats) -> tuple[*_Part, float]:
    """The field's meshes, cut to edges of about a cell, and how long the edges are at most."""
    asked = world.plan.fields[name].surfaces
    setting = world.setting
    made = [each for each in setting.surfaces if not asked or each in asked]
    empty = np.empty((0, 3)), np.empty((0, 3), np.int64), np.empty((0, _NEAREST), np.int64), np.empty((0, _NEAREST)), 0.0
    if not made or not len(places):
        return empty
    found: list[tuple[Floats, NDArray[np.int64]]] = []
    for each in made:
        moves = each in setting.moves.meshes
        vertices = vertices_at(world, each, setting.moves.first) if moves else setting.surfaces[each].vertices - world.origin
        found.append((vertices, setting.surfaces[each].faces.astype(np.int64)))
    area = sum(float(_area(vertices, faces)) for vertices, faces in found)
    edge = max(cell, float(np.sqrt(area / (0.5 * _MOST))))
    points, faces = _joined([_cut(vertices, faces, edge) for vertices, faces in found])
    way = vertex_normals(points, faces.astype(np.int32)).astype(np.float64)
    near, share = _mixed(points, way, places, normals, cell)
    return points, faces, near, share, edge


def _area(vertices: Floats, faces: NDArray[np.int64]) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _cut(vertices: Floats, faces: NDArray[np.int64], edge: float) -> tuple[Floats, NDArray[np.int64]]:
    from trimesh.remesh import subdivide_to_size

    points, triangles = subdivide_to_size(vertices, faces, edge, max_iter=20)[:2]  # type: ignore[no-untyped-call]
    return np.asarray(points, np.float64), np.asarray(triangles, np.int64)


def _joined(parts: list[tuple[Floats, NDArray[np.int64]]]) -> tuple[Floats, NDArray[np.int64]]:
    shift = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([faces + start for (_, faces), start in zip(parts, shift, strict=False)]),
    )


def _mixed(points: Floats, way: Floats, places: Floats, normals: Floats, cell: float) -> tuple[NDArray[np.int64], Floats]:
    """The cells next to points on their side, and the share of each: less the further off."""
    from scipy.spatial import cKDTree

    distance, near = cKDTree(places).query(points, k=[min(k, len(places)) for k in range(1, _NEAREST + 1)])
    same = np.einsum("nkd,nd->nk", normals[near], way) > 0
    share = np.where(same, 1 / (distance**2 + (_SOFT * cell) ** 2), 0.0)
    share[(distance > 2 * cell) & (distance > distance[:, :1])] = 0.0
    total = share.sum(axis=1, keepdims=True)
    return near.astype(np.int64), np.where(total > 0, share / np.maximum(total, 1e-300), 0.0)


def _squares(places: Floats, normals: Floats, cell: float, which: NDArray[np.int64]) -> _Part:
    """A square for each cell, across its normal."""
    other = np.where(np.abs(normals[:, :1]) < 0.9, np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]))
    right = np.cross(normals, other)
    right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-12)
    above = np.cross(normals, right)
    half = cell / 2
    corners = [places + half * (i * right + k * above) for i, k in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    first = np.arange(len(places))[:, None] * 4
    faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])]).astype(np.int64)
    share = np.zeros((len(places) * 4, _NEAREST))
    share[:, 0] = 1.0
    return np.stack(corners, axis=1).reshape(-1, 3), faces, np.repeat(which, 4 * _NEAREST).reshape(-1, _NEAREST), share
