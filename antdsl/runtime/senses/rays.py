"""The one door to Open3D: rays, occlusions, closest points and feelers against triangles, same bits for any batch or threads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.senses.distance_grid import DistanceGrid

Vectors = NDArray[np.float64]
Mesh = tuple[Vectors, NDArray[np.int32]]

_NO_FACE = 0xFFFFFFFF
_CROWD = 2_000  # places asked about at once, from which on finer distances pay
_BRIEF_CELLS = 1000
FAR = 2000.0  # mm; nearer to zero float32 is a ten-thousandth of a millimetre at worst


@dataclass(frozen=True, slots=True)
class Hits:
    """What each ray met. `t` counts lengths of the direction (inf = nothing), `mesh` and `face` are -1 for nothing.

    `u v` are the weights of the face's second and third corner. `normal` float32[n,3] is the face's unit normal, turned
    towards the ray's origin (0 for nothing).
    """

    t: NDArray[np.float32]
    mesh: NDArray[np.int32]
    face: NDArray[np.int32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    normal: NDArray[np.float32]

    @property
    def hit(self) -> NDArray[np.bool_]:
        return self.face >= 0


@dataclass(frozen=True, slots=True)
class FeelerHits:
    """What feelers touched: `hit`, its distance `t` (mm, inf = nothing) and the face's normal towards the asker."""

    hit: NDArray[np.bool_]
    t: NDArray[np.float32]
    nx: NDArray[np.float32]
    ny: NDArray[np.float32]
    nz: NDArray[np.float32]


@cache
def _open3d() -> Any:
    try:
        import open3d
    except (ImportError, OSError) as problem:
        raise ImportError(
            f"open3d cannot be loaded ({problem}): install the package `open3d-cpu`; on a bare Linux system it also needs "
            "the system packages libegl1 libgl1 libusb-1.0-0"
        ) from problem
    return open3d


class RayScene:
    """Triangle meshes that rays can be cast at. Vertices are float64[n,3], faces int[m,3]; lengths in millimetres.

    The scene works in float32, far from the world's origin around the middle of its meshes, so that nothing is lost. One that is
    `brief`, asked for a single step, knows less well who is far from it, and is made faster.
    """

    _cells: int | None = None

    def __init__(self, vertices: Vectors, faces: NDArray[np.int32], brief: bool = False) -> None:
        self._cells = _BRIEF_CELLS if brief else None
        self._fill([(vertices, faces)])

    @classmethod
    def of(cls, meshes: Sequence[Mesh]) -> RayScene:
        """A scene of several meshes; `Hits.mesh` counts them from 0."""
        scene = cls.__new__(cls)
        scene._fill(meshes)
        return scene

    def _fill(self, meshes: Sequence[Mesh]) -> None:
        arrays = [(np.asarray(v, np.float64).reshape(-1, 3), np.asarray(f, np.int32).reshape(-1, 3)) for v, f in meshes]
        counts = np.array([len(f) for _, f in arrays], np.int64)
        before = np.cumsum([0, *(len(v) for v, _ in arrays)])
        vertices = np.concatenate([v for v, _ in arrays]) if arrays else np.empty((0, 3))
        faces = (
            np.concatenate([f + b for (_, f), b in zip(arrays, before[:-1], strict=True)])
            if arrays
            else np.empty((0, 3), np.int64)
        )
        self._first_face = np.cumsum(np.concatenate(([0], counts)))
        self._mesh_of_face = np.repeat(np.arange(len(arrays), dtype=np.int32), counts)
        self._faces = faces.astype(np.int32)
        used = vertices[faces.ravel()]
        middle = (used.min(axis=0) + used.max(axis=0)) / 2 if used.size else np.zeros(3)
        # Whole metres, and none at all near zero: one more stone at the rim moves no bit of a ray at the others.
        self.origin = np.round(middle / 1000.0) * 1000.0 if np.abs(middle).max() > FAR else np.zeros(3)
        self._vertices = vertices
        corners = vertices[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        self._normals = (normal / np.where(length > 0, length, 1.0)).astype(np.float32)
        self._scene: Any = None
        self._grid: DistanceGrid | None = None
        self._refined = False
        if len(faces):
            # Built by one thread, so that the tree is the same on every machine.
            self._scene = _open3d().t.geometry.RaycastingScene(nthreads=1)
            self._scene.add_triangles(
                self._tensor((vertices - self.origin).astype(np.float32)), self._tensor(faces.astype(np.uint32))
            )

    @staticmethod
    def _tensor(array: NDArray[Any]) -> Any:
        return _open3d().core.Tensor.from_numpy(np.ascontiguousarray(array))

    def _rays(self, origin: Vectors, direction: Vectors) -> NDArray[np.float32]:
        rays = np.empty((len(origin), 6), np.float32)
        np.subtract(origin, self.origin, out=rays[:, :3], casting="unsafe")
        rays[:, 3:] = direction
        return rays

    def cast(self, origin: Vectors, direction: Vectors, threads: int = 1) -> Hits:
        """First hit of each ray from `origin` [n,3] along `direction` [n,3] (any length)."""
        rays = self._rays(origin, direction)
        t, face, uv = self._cast(rays, threads)
        found = np.flatnonzero(face >= 0)
        mesh = np.full(len(rays), -1, np.int32)
        mesh[found] = self._mesh_of_face[face[found]]
        local = face.copy()
        local[found] -= self._first_face[mesh[found]].astype(np.int32)
        normal = np.zeros((len(rays), 3), np.float32)
        normal[found] = self._towards(face[found], rays[found, 3:])
        return Hits(t, mesh, local, uv[:, 0], uv[:, 1], normal)

    def _cast(
        self, rays: NDArray[np.float32], threads: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32]]:
        """t, face over all meshes (-1 = none), uv of prepared rays."""
        n = len(rays)
        if self._scene is None or n == 0:
            return np.full(n, np.inf, np.float32), np.full(n, -1, np.int32), np.zeros((n, 2), np.float32)
        answer = self._scene.cast_rays(self._tensor(rays), nthreads=threads)
        t = answer["t_hit"].numpy()
        face = answer["primitive_ids"].numpy()
        return (
            t,
            np.where((face == _NO_FACE) | ~np.isfinite(t), -1, face.astype(np.int64)).astype(np.int32),
            answer["primitive_uvs"].numpy(),
        )

    def _towards(self, face: NDArray[np.int32], direction: NDArray[np.float32]) -> NDArray[np.float32]:
        """Normals of faces, turned against the direction of the rays that met them."""
        normal = self._normals[face]
        along = (normal[:, 0] * direction[:, 0] + normal[:, 1] * direction[:, 1]) + normal[:, 2] * direction[:, 2]
        return np.where(along[:, None] > 0, -normal, normal)

    def occluded(self, origin: Vectors, direction: Vectors, far: float = np.inf, threads: int = 1) -> NDArray[np.bool_]:
        """Whether anything lies on each ray before `far` lengths of its direction."""
        return self._occluded(self._rays(origin, direction), far, threads)

    def _occluded(self, rays: NDArray[np.float32], far: float, threads: int) -> NDArray[np.bool_]:
        if self._scene is None or len(rays) == 0:
            return np.zeros(len(rays), bool)
        return self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=far, nthreads=threads).numpy()

    def closest(
        self, points: Vectors, threads: int = 1
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], Vectors, NDArray[np.float64]]:
        """Nearest surface of each point [n,3]: mesh, face, place [n,3] in float64 on that face, distance [n].

        Slow far from the surface (10 to 30 rays' worth each): for the few that nothing else finds.
        """
        n = len(points)
        if self._scene is None or n == 0:
            nothing = np.full(n, -1, np.int32)
            return nothing, nothing.copy(), np.array(points, np.float64).reshape(-1, 3), np.full(n, np.inf)
        local = (np.asarray(points, np.float64) - self.origin).astype(np.float32)
        face = self._scene.compute_closest_points(self._tensor(local), nthreads=threads)["primitive_ids"].numpy().astype(np.int32)
        place = nearest_on_triangle(np.asarray(points, np.float64), self._vertices[self._faces[face]])
        mesh = self._mesh_of_face[face]
        distance = np.sqrt(((place - points) ** 2).sum(axis=1))
        return mesh, (face - self._first_face[mesh]).astype(np.int32), place, distance

    def depth(self, points: Vectors, threads: int = 1) -> NDArray[np.float64]:
        """How far inside each point [n,3] is, mm: the way out for those from which most of three rays leave by an odd number of
        faces, 0 for the others. Meshes are taken to be closed."""
        deep = np.zeros(len(points))
        if self._scene is not None and len(points):
            local = self._tensor((np.asarray(points, np.float64) - self.origin).astype(np.float32))
            inside = np.flatnonzero(self._scene.compute_occupancy(local, nthreads=threads, nsamples=3).numpy() > 0.5)
            deep[inside] = self.closest(points[inside], threads)[3]
        return deep

    def clearance(self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any]) -> NDArray[np.float32]:
        """A distance (mm, float32[n]) within which places have no face; 0 when near, inf without faces."""
        if self._scene is None:
            return np.full(len(x), np.inf, np.float32)
        if self._grid is None:
            self._grid = self._distances()
        if len(x) >= _CROWD and not self._refined and self._cells is None:
            self._refined = True
            self._grid.refine(lambda places: self.closest(places)[3])
        return self._grid.at_least(x, y, z)

    def _distances(self) -> DistanceGrid:
        args = () if self._cells is None else (self._cells,)
        return DistanceGrid(self._vertices, self._faces, *args)

    def feelers(
        self,
        x: NDArray[Any],
        y: NDArray[Any],
        z: NDArray[Any],
        dx: NDArray[Any],
        dy: NDArray[Any],
        dz: NDArray[Any],
        reach: NDArray[Any] | float,
        threads: int = 1,
    ) -> FeelerHits:
        """What lies within `reach` (mm, one or float[n]) of places along unit directions, all 1-D arrays of one length.

        Whoever is too far from everything to touch it is not asked (performance: most agents), and gets the same answer.
        """
        n = len(x)
        reach = np.broadcast_to(np.asarray(reach, np.float32), (n,))
        t = np.full(n, np.inf, np.float32)
        normal = np.zeros((3, n), np.float32)
        near = self._reachable(x, y, z, dx, dy, dz, reach)
        if near.size:
            length = reach[near]
            rays = np.empty((near.size, 6), np.float32)
            for axis, (place, step) in enumerate(((x, dx), (y, dy), (z, dz))):
                rays[:, axis] = place[near] - self.origin[axis]
                rays[:, 3 + axis] = step[near] * length
            met, part, face = self._limited(rays, threads)
            near = near[met]
            t[near] = part * length[met]
            normal[:, near] = self._towards(face, rays[met, 3:]).T
        return FeelerHits(np.isfinite(t), t, *normal)

    def _limited(
        self, rays: NDArray[np.float32], threads: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int32]]:
        """Which rays hit within one length of their direction, with t and face over all meshes of these.

        A ray that hits nothing costs the whole scene's length unless it has an end, which only occlusions know.
        """
        maybe = np.flatnonzero(self._occluded(rays, 1.0 + 1e-4, threads))
        t, face, _ = self._cast(rays[maybe], threads)
        met = np.flatnonzero((face >= 0) & (t <= 1.0))
        return maybe[met], t[met], face[met]

    def cast_within(
        self, origin: Vectors, step: Vectors, threads: int = 1
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]:
        """Which rays hit something between `origin` [n,3] and `origin + step`: their numbers, ascending, and t, mesh, face."""
        which, t, face = self._limited(self._rays(origin, step), threads)
        mesh = self._mesh_of_face[face]
        return which, t, mesh, (face - self._first_face[mesh]).astype(np.int32)

    def near(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """The nearest face within `reach` (mm, one or float[n]) of places, 1-D arrays: distance, and unit way to the asker."""
        n = len(x)
        reach = np.broadcast_to(np.asarray(reach, np.float32), (n,))
        t = np.full(n, np.inf, np.float32)
        normal = np.zeros((3, n), np.float32)
        if self._scene is not None and n:
            if self._grid is None:
                self._grid = self._distances()
            asked = np.flatnonzero(self._grid.at_least(x, y, z) <= reach)
            points = np.stack([x[asked], y[asked], z[asked]], axis=1).astype(np.float64)
            _, _, place, distance = self.closest(points, threads)
            met = np.flatnonzero(distance.astype(np.float32) <= reach[asked])
            away = (points[met] - place[met]) / np.maximum(distance[met], 1e-12)[:, None]
            t[asked[met]] = distance[met]
            normal[:, asked[met]] = away.T
        return FeelerHits(np.isfinite(t), t, *normal)

    def apart(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], threads: int = 1
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """How far (mm, float32[n]) places are out of the meshes, below 0 inside, and the unit way out, float32[3,n].

        Inside is behind the nearest face; slow far from the surface."""
        points = np.stack([x, y, z], axis=1).astype(np.float64)
        mesh, face, place, distance = self.closest(points, threads)
        if self._scene is None or not len(points):
            return distance.astype(np.float32), np.zeros((3, len(points)), np.float32)
        normal = self._normals[face + self._first_face[mesh]].astype(np.float64)
        away = points - place
        side = np.where((away * normal).sum(axis=1) < 0, -1.0, 1.0)
        touching = distance < 1e-6
        out = np.where(touching[:, None], normal, away * (side / np.maximum(distance, 1e-6))[:, None])
        return (distance * side).astype(np.float32), np.ascontiguousarray(out.T, np.float32)

    def _reachable(
        self,
        x: NDArray[Any],
        y: NDArray[Any],
        z: NDArray[Any],
        dx: NDArray[Any],
        dy: NDArray[Any],
        dz: NDArray[Any],
        reach: NDArray[Any],
    ) -> NDArray[np.int64]:
        """Rays that may hit: those whose ball around the middle of the feeler is not known to be empty."""
        if self._scene is None:
            return np.empty(0, np.int64)
        if self._grid is None:
            self._grid = self._distances()
        half = reach * np.float32(0.5)
        least = self._grid.at_least(x + dx * half, y + dy * half, z + dz * half)
        return np.flatnonzero(least <= half * np.float32(1 + 1e-4) + np.float32(1e-4))


def nearest_on_triangle(points: Vectors, corners: NDArray[np.float64]) -> Vectors:
    """Nearest point of each triangle [n,3,3] to each point [n,3] (Ericson, Real-Time Collision Detection, 2005, p. 136-142)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    best = np.empty_like(points)
    gap = np.full(len(points), np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        edge = q - p
        length = (edge * edge).sum(axis=1)
        s = np.clip(((points - p) * edge).sum(axis=1) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        place = p + s[:, None] * edge
        here = ((place - points) ** 2).sum(axis=1)
        closer = here < gap
        best[closer], gap[closer] = place[closer], here[closer]
    u, v, w = b - a, c - a, points - a
    uu, uv, vv = (u * u).sum(axis=1), (u * v).sum(axis=1), (v * v).sum(axis=1)
    wu, wv = (w * u).sum(axis=1), (w * v).sum(axis=1)
    size = uu * vv - uv * uv
    flat = size <= 0
    size = np.where(flat, 1.0, size)
    s, t = (vv * wu - uv * wv) / size, (uu * wv - uv * wu) / size
    inside = ~flat & (s >= 0) & (t >= 0) & (s + t <= 1)
    best[inside] = (a + s[:, None] * u + t[:, None] * v)[inside]
    return best
