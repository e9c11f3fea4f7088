"""Rays for pictures. For speed, they use Open3D's float32 results without checks. The simulation uses `RayScene` instead."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.open3d_module import load_open3d

_RAYS_PER_CHUNK = 1 << 17  # rays per chunk


@dataclass(frozen=True, slots=True, eq=False)
class PictureHits:
    """The first hits of n rays.

    - `t` float32[n]: the distance of the hit, in lengths of the ray's direction (infinite without a hit)
    - `face` int32[n]: the face (-1 without a hit)
    - `u`, `v` float32[n]: the weights of the face's second and third corner
    - `normal` float32[n,3]: the face's unit normal, on the side of the ray's origin"""

    t: NDArray[np.float32]
    face: NDArray[np.int32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    normal: NDArray[np.float32]

    def select_rows(self, rows: Any) -> PictureHits:
        """Return the hits of the given rows, which may be indices or a slice."""
        return PictureHits(*(getattr(self, each.name)[rows] for each in fields(self)))


class PictureRays:
    """Triangles (vertices [n,3], faces [m,3]) for the rays of a camera.

    Positions are converted to float32 relative to the centre of the mesh. The result for a ray is bit-identical for any number of
    threads, and does not depend on other rays."""

    def __init__(self, vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> None:
        self.faces = len(faces)
        if not self.faces:
            return
        self.origin = (vertices.min(axis=0).astype(np.float64) + vertices.max(axis=0)) / 2
        # Built by one thread, so that the tree is the same on all machines of one kind.
        self._scene = load_open3d().t.geometry.RaycastingScene(nthreads=1)
        points = (vertices - self.origin.astype(vertices.dtype)).astype(np.float32)
        self._scene.add_triangles(_to_tensor(points), _to_tensor(faces.astype(np.uint32)))

    def find_first_hits(self, origin: NDArray[Any], direction: NDArray[np.float32], threads: int = 1) -> PictureHits:
        """Return the first hit of each ray from `origin` [n,3] or [3] along `direction` [n,3]."""
        n = len(direction)
        t, face = np.full(n, np.inf, np.float32), np.full(n, -1, np.int32)
        u, v, normal = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros((n, 3), np.float32)
        for start in range(0, n if self.faces else 0, _RAYS_PER_CHUNK):
            chunk = slice(start, min(start + _RAYS_PER_CHUNK, n))
            answer = self._scene.cast_rays(_to_tensor(self._prepare_rays(origin, direction, chunk)), nthreads=threads)
            t[chunk] = answer["t_hit"].numpy()
            reported_faces = answer["primitive_ids"].numpy()
            face[chunk] = np.where(np.isfinite(t[chunk]), reported_faces, 0).astype(np.int32) - ~np.isfinite(t[chunk])
            u[chunk], v[chunk] = answer["primitive_uvs"].numpy().T
            normal[chunk] = answer["primitive_normals"].numpy()
        faces_away = (normal[:, 0] * direction[:, 0] + normal[:, 1] * direction[:, 1]) + normal[:, 2] * direction[:, 2] > 0
        normal[faces_away] *= -1
        return PictureHits(t, face, u, v, normal)

    def find_occluded_rays(
        self, origin: NDArray[Any], direction: NDArray[np.float32], max_parameter: float = np.inf, threads: int = 1
    ) -> NDArray[np.bool_]:
        """Return whether each ray hits anything within `max_parameter` lengths of its direction."""
        n = len(direction)
        is_occluded = np.zeros(n, np.bool_)
        for start in range(0, n if self.faces else 0, _RAYS_PER_CHUNK):
            chunk = slice(start, min(start + _RAYS_PER_CHUNK, n))
            rays = _to_tensor(self._prepare_rays(origin, direction, chunk))
            is_occluded[chunk] = self._scene.test_occlusions(rays, tnear=0.0, tfar=max_parameter, nthreads=threads).numpy()
        return is_occluded

    def _prepare_rays(self, origin: NDArray[Any], direction: NDArray[np.float32], rows: slice) -> NDArray[np.float32]:
        """Return the rays `rows` in Open3D's form, float32[k,6]: origin relative to the centre of the mesh, and direction."""
        rays = np.empty((rows.stop - rows.start, 6), np.float32)
        np.subtract(origin if origin.ndim == 1 else origin[rows], self.origin, out=rays[:, :3], casting="unsafe")
        rays[:, 3:] = direction[rows]
        return rays


def _to_tensor(array: NDArray[Any]) -> Any:
    return load_open3d().core.Tensor.from_numpy(np.ascontiguousarray(array))
