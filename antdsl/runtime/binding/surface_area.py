"""Random points on surfaces, on faces of any orientation. They are distributed evenly, or with a density that a map defines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.faces import find_nearest_on_triangle
from antdsl.ground.protocol import Flags, Floats, Footing
from antdsl.numerics import vectors as vec
from antdsl.runtime.world import World
from antdsl.scene.setting import PointMm

_MAX_BURIED_SHARE_OF_VOXEL = 0.05  # deeper below a solid's surface, there is no ground to stand on
_FACE_EDGE_BISECTIONS = 24  # bisections of face edges that extend beyond a ball
_THIN_TRIANGLE_RATIO = 64.0  # a triangle is thin above this ratio: longest edge squared / twice the area
_CORNER_WEIGHTS = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
# The four triangles that the middles of the edges make, by the corners 0 1 2 and the middles 3 (of 0 1), 4 (of 1 2), 5 (of 2 0).
_SUBTRIANGLE_CORNERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])


@dataclass(frozen=True, slots=True, eq=False)
class SampledFaceArea:
    """The m triangles on which positions are drawn. Each is one of k faces, or a part of it.

    `first_corner`, `edge1`, `edge2` (k, 3; mm): the first corner of each face relative to the world's origin, and the two edges
    from it. `clipping_ball`: the centre and the radius (mm) of the ball in which positions must be, or None."""

    world: World
    mesh_numbers: NDArray[np.int32]  # (k) the mesh of each face; numbers of solids follow those of meshes
    face_in_mesh: NDArray[np.int32]  # (k) number of the face in the mesh
    first_corner: Floats
    edge1: Floats
    edge2: Floats
    triangle_face: NDArray[np.int64]  # (m) the face of each triangle
    weights: Floats  # (m, 3, 2) weights b1 and b2 of the triangle's corners in its face
    cumulative_area: Floats  # (3m) cumulative area times density, for each corner of each triangle
    total_area: float  # mm²
    clipping_ball: tuple[Floats, float] | None

    def draw_points(
        self, u: NDArray[np.float32], *draws: NDArray[np.float32]
    ) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
        """Return random points: faces (n), weights b1 (n) and b2 (n), and positions (n, 3; mm). `u`: four random numbers per
        point. A linear density in a triangle is a mixture of three densities, each proportional to the weight of one corner. The
        gaps between sorted random numbers, with two gaps merged, have these densities (L. Devroye, Non-Uniform Random Variate
        Generation, 1986, V.2, XI.4). Without triangles, the face is -1 and the position 0."""
        if not len(self.cumulative_area):
            return np.full(len(u), -1), np.zeros(len(u)), np.zeros(len(u)), np.zeros((len(u), 3))
        pick = np.searchsorted(self.cumulative_area, u.astype(np.float64) * self.cumulative_area[-1], side="right")
        pick = np.minimum(pick, len(self.cumulative_area) - 1)
        part, corner = pick // 3, pick % 3
        _, two, three = np.sort(draws, axis=0).astype(np.float64)
        much, rest, last = two, three - two, 1 - three
        c1 = np.where(corner == 1, much, rest)
        c2 = np.where(corner == 2, much, last)
        c0 = 1.0 - c1 - c2
        own = self.weights[part]
        b1, b2 = ((own[:, 0, k] * c0 + own[:, 1, k] * c1) + own[:, 2, k] * c2 for k in range(2))
        face = self.triangle_face[part]
        place = self.first_corner[face] + b1[:, None] * self.edge1[face] + b2[:, None] * self.edge2[face]
        return face, b1, b2, place

    def draw_footings(self, *draws: NDArray[np.float32]) -> tuple[Footing, Floats, Flags]:
        """Return the footings of random points, the normals of their faces (n, 3), and a mask of points where an agent can stand.
        Agents can stand on points that are inside the ball and outside all solids."""
        face, b1, b2, place = self.draw_points(*draws)
        if not len(self.cumulative_area):
            return Footing.create_unplaced(len(face)), np.array(np.broadcast_to(self.world.up, place.shape)), face >= 0
        can_stand = np.ones(len(face), np.bool_)
        if self.clipping_ball is not None:
            middle, radius = self.clipping_ball
            away = place - middle
            can_stand &= away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1] + away[:, 2] * away[:, 2] <= radius * radius
        across = vec.cross(vec.split_columns(self.edge1[face], np.float64), vec.split_columns(self.edge2[face], np.float64))
        up = vec.stack_rows(vec.scale(across, 1.0 / np.maximum(vec.length(across), 1e-300)))
        mesh = self.mesh_numbers[face]
        footing = Footing.from_faces(mesh, self.face_in_mesh[face], b1, b2)
        if not self.world.solids:
            return footing, up, can_stand
        return self._snap_to_solids(footing, place, up, can_stand)

    def _snap_to_solids(self, on_mesh: Footing, place: Floats, up: Floats, can_stand: Flags) -> tuple[Footing, Floats, Flags]:
        """Move points on a solid to the current surface of the solid. Return the same values as `draw_footings`."""
        ground, footing = self.world.ground, on_mesh.with_position_columns()
        first = len(ground.names) - len(self.world.solids)
        for k, (name, volume) in enumerate(self.world.solids.items()):
            rows = np.flatnonzero(on_mesh.mesh == first + k)
            if rows.size:
                landed, _ = ground.find_nearest(place[rows], [name])
                footing.write_rows(rows, landed)
                can_stand[rows] &= landed.mesh == first + k
                up[rows] = ground.normal(landed)
            on_meshes = on_mesh.mesh < first
            can_stand[on_meshes] &= volume.sample_distances(place[on_meshes]) >= -_MAX_BURIED_SHARE_OF_VOXEL * volume.voxel
        return footing, up, can_stand


def collect_face_area(
    world: World, names: tuple[str, ...], density: str | None, around: PointMm | None, radius: float | None
) -> SampledFaceArea:
    """Return the faces of the surfaces and solids `names`, at their current positions, for drawing positions.

    `around`, `radius` (mm): the ball in which positions must be. If it contains no face, it is enlarged until it extends by its
    original radius beyond the nearest face. `density`: the map that gives the density of positions."""
    mesh, local, corner, edge1, edge2, weight = _collect_faces(world, names, density)
    face, weights = np.arange(len(mesh)), np.broadcast_to(_CORNER_WEIGHTS, (len(mesh), 3, 2))
    ball = None
    if around is not None and radius is not None and len(mesh):
        middle = np.asarray(around, np.float64) - world.origin
        corners = np.stack([corner, corner + edge1, corner + edge2], axis=1)
        near = find_nearest_on_triangle(np.broadcast_to(middle, corner.shape), corners)
        away = float(vec.length(vec.split_columns(near - middle, np.float64)).min())
        ball = (middle, radius if away <= radius else away + radius)
        face, weights = _triangulate_ball_faces(ball, corner, edge1, edge2)
    double = vec.length(vec.cross(vec.split_columns(edge1, np.float64), vec.split_columns(edge2, np.float64)))
    span1, span2 = weights[:, 1] - weights[:, 0], weights[:, 2] - weights[:, 0]
    size = double[face] * np.abs(span1[:, 0] * span2[:, 1] - span1[:, 1] * span2[:, 0])
    b1, b2 = weights[:, :, 0], weights[:, :, 1]
    dense = (weight[face, :1] * (1.0 - b1 - b2) + weight[face, 1:2] * b1) + weight[face, 2:] * b2
    cumulative = np.cumsum((dense * size[:, None]).ravel())
    total = float(size[(dense > 0).any(axis=1)].sum() / 2.0)
    return SampledFaceArea(world, mesh, local, corner, edge1, edge2, face, weights, cumulative, total, ball)


_FaceArrays = tuple[NDArray[np.int32], NDArray[np.int32], Floats, Floats, Floats, Floats]


def _collect_faces(world: World, surface_names: tuple[str, ...], density: str | None) -> _FaceArrays:
    """Return all faces with an area above 0 of the surfaces `surface_names`, as six arrays.

    The arrays are: the mesh, the face's number in the mesh, the first corner, the two edges from it, and the density at the
    corners (k, 3)."""
    ground = world.ground.meshes
    face_groups: list[_FaceArrays] = []
    if ground is not None:
        _, _, mesh, table = ground.triangles
        rows = np.flatnonzero(table.is_live & np.isin(mesh, [k for k, name in enumerate(ground.names) if name in surface_names]))
        first = np.searchsorted(mesh, np.arange(len(ground.names)))
        weight = np.ones((len(rows), 3))
        if density is not None:
            weight = np.maximum(world.maps[density].corner_values, 0.0).T[rows]
        corner, edge1, edge2 = (np.ascontiguousarray(v[:, rows].T) for v in (table.corner, table.edge1, table.edge2))
        face_groups.append((mesh[rows], (rows - first[mesh[rows]]).astype(np.int32), corner, edge1, edge2, weight))
    names = list(world.setting.surfaces)
    for k, (name, solid) in enumerate(world.setting.solids.items()):
        if name in surface_names and density is None:
            corners = solid.mesh.vertices[solid.mesh.faces] - world.origin
            n = len(corners)
            which = np.full(n, len(names) + k, np.int32)
            a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
            face_groups.append((which, np.arange(n, dtype=np.int32), a, b - a, c - a, np.ones((n, 3))))
    meshes, locals_, *vectors = zip(*face_groups, strict=True)
    corner, edge1, edge2, weight = (np.concatenate(v) for v in vectors)
    return np.concatenate(meshes), np.concatenate(locals_), corner, edge1, edge2, weight


def _triangulate_ball_faces(
    ball: tuple[Floats, float], corner: Floats, edge1: Floats, edge2: Floats
) -> tuple[NDArray[np.int64], Floats]:
    """Return triangles that cover the part of the faces inside a ball: the face of each (m), and its corners' weights (m, 3, 2).

    A triangle that extends beyond the ball is divided into four, until it is smaller than half the radius."""
    middle, radius = ball
    face, weights = np.arange(len(corner)), np.broadcast_to(_CORNER_WEIGHTS, (len(corner), 3, 2))
    pieces: list[tuple[NDArray[np.int64], Floats]] = []
    for step in range(_FACE_EDGE_BISECTIONS):
        at = corner[face][:, None] + weights[:, :, :1] * edge1[face][:, None] + weights[:, :, 1:] * edge2[face][:, None]
        centre = at.mean(axis=1)
        reach = np.sqrt(((at - centre[:, None]) ** 2).sum(axis=2).max(axis=1))
        near = np.sqrt(((centre - middle) ** 2).sum(axis=1)) <= reach + radius
        small = near & ((reach <= radius / 4) | (step == _FACE_EDGE_BISECTIONS - 1))
        pieces.append((face[small], weights[small]))
        large = near & ~small
        face, weights = face[large], weights[large]
        if not len(face):
            break
        face, weights = _subdivide_triangles(face, weights, at[large])
    faces, parts = zip(*pieces, strict=True)
    return np.concatenate(faces), np.concatenate(parts)


def _subdivide_triangles(face: NDArray[np.int64], weights: Floats, corners: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Divide each triangle into four at the midpoints of its edges. Return the faces and the corners' weights of the parts.

    `face`, `weights`: the face of each triangle, and the weights of its corners. `corners` (m, 3, 3): its corners (mm). Thin
    triangles are only divided into two, at the midpoint of the longest edge. Otherwise the number of parts in the ball would grow
    without limit."""
    sides = ((np.roll(corners, -1, axis=1) - corners) ** 2).sum(axis=2)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    thin = sides.max(axis=1) > _THIN_TRIANGLE_RATIO * np.sqrt((across * across).sum(axis=1))
    middles = (weights + np.roll(weights, -1, axis=1)) / 2
    quarters = np.concatenate([weights, middles], axis=1)[~thin][:, _SUBTRIANGLE_CORNERS].reshape(-1, 3, 2)
    row, first = np.flatnonzero(thin), sides[thin].argmax(axis=1)
    one, two, three = (weights[row, (first + k) % 3] for k in range(3))
    middle = middles[row, first]
    halves = [np.stack(half, axis=1) for half in ((one, middle, three), (middle, two, three))]
    return np.concatenate([np.repeat(face[~thin], 4), np.tile(face[thin], 2)]), np.concatenate([quarters, *halves])
