"""A solid as a sparse signed distance field: bricks of 16³ nodes near the surface, one flag per brick elsewhere.

Distances are negative inside; the zero level of the trilinear field is the surface. Positions are float64 in mm, distances
float32 in mm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.ground.solid import carving, trilinear, voxelising
from antdsl.ground.solid.bricks import NODES_PER_BRICK, NODES_PER_BRICK_SIDE, BrickGrid, UnusableMeshReason

BrickMesh = tuple[int, NDArray[np.float64], NDArray[np.int32]]

_VERTEX_STEPS_PER_VOXEL = 4096.0  # vertices are rounded to this part of a voxel, so that bricks agree at their common side
Floats = NDArray[np.float64]
Distances = NDArray[np.float32]
Arrays = dict[str, NDArray[Any]]

__all__ = ["UnusableMeshReason", "Volume"]


@dataclass(slots=True)
class Volume:
    """A solid that agents can dig. It is created by `from_mesh`; only `carve_balls` and `restore_changes` change it."""

    bricks: BrickGrid

    @staticmethod
    def from_mesh(
        vertices: Floats, faces: NDArray[np.integer[Any]], voxel: float, *, cap: int = limits.MAX_VOXELS
    ) -> Volume | UnusableMeshReason:
        """Return the solid inside a closed mesh with vertices float64[n,3] (mm) and faces int[m,3], sampled every `voxel` mm.

        A point is inside if its winding number is not 0; if faces have inconsistent winding, the number must be odd. `cap`: the
        greatest number of voxels in the mesh's bounding box. For a mesh that cannot be a solid, because it is open or has too
        many voxels, the result is an `UnusableMeshReason`."""
        bricks = voxelising.voxelise_mesh(np.asarray(vertices, np.float64), np.asarray(faces, np.int64), float(voxel), cap)
        return bricks if isinstance(bricks, UnusableMeshReason) else Volume(bricks)

    @property
    def voxel(self) -> float:
        """Return the distance between neighbouring nodes, mm."""
        return self.bricks.voxel

    @property
    def distance_band(self) -> tuple[float, float]:
        """Return the least and the greatest distance that the field stores, in mm. Beyond this band, the field is constant."""
        return self.bricks.min_distance, self.bricks.max_distance

    def make_dense_distances(self) -> NDArray[np.float32]:
        """Return the distances at all nodes of the grid, float32[x, y, z] mm. Node (0, 0, 0) is at `low`."""
        return self.bricks.to_dense()

    @property
    def low(self) -> Floats:
        """Return the lowest corner of the grid, float64[3] mm. The complete solid lies between `low` and `high`."""
        return self.bricks.origin.copy()

    @property
    def high(self) -> Floats:
        """Return the highest corner of the grid, float64[3] mm."""
        return self.bricks.origin + (np.array(self.bricks.node_counts) - 1) * self.bricks.voxel

    # ---- asking

    def sample_distances(self, points: Floats) -> Distances:
        """Return the trilinear signed distance float32[n] (mm) at points [n,3]. Far from the surface, it is the least or
        greatest distance of the band."""
        return trilinear.sample_distances(self.bricks, *_split_columns(points)).astype(np.float32)

    def sample_gradients(self, points: Floats) -> Distances:
        """Return the gradient float32[n,3] of the trilinear field at points [n,3]. Its length is about 1 near the surface, and 0
        where the field is flat."""
        return self.sample_with_gradients(points)[1]

    def sample_with_gradients(self, points: Floats) -> tuple[Distances, Distances]:
        """Return both the distances and the gradients at points [n,3]. This takes little more time than computing one of them."""
        distance, *gradient = trilinear.sample_with_gradients(self.bricks, *_split_columns(points))
        return distance.astype(np.float32), np.stack(gradient).astype(np.float32).T

    def compute_upright_normals(self, points: Floats, default_normals: Floats) -> Floats:
        """Return unit normals float64[n,3] that point out of the solid and vary smoothly along the surface. Bodies are oriented
        by these normals.

        Where the field is flat, they are `default_normals` ([3] or [n,3])."""
        slope = trilinear.sample_smooth_gradients(self.bricks, *_split_columns(points))
        size = np.sqrt((slope[0] * slope[0] + slope[1] * slope[1]) + slope[2] * slope[2])
        clear = size > 1e-3
        unit = np.stack([s / np.where(clear, size, 1.0) for s in slope], axis=1)
        return np.where(clear[:, None], unit, np.asarray(default_normals, np.float64))

    def project_to_surface(self, points: Floats, hints: Floats, reach: float | None = None) -> trilinear.SurfacePoints:
        """Return points on the surface near points [n,3], with normals that point out of the solid.

        `hints`: [n,3], unit vectors that point out of the expected surface, such as the agents' up. `is_in_reach` of the result
        is false in two cases: if the surface faces away from the hint, or if it is beyond `reach` (mm; None means two voxels)."""
        return trilinear.project_to_surface(self.bricks, points, hints, reach)

    # ---- digging

    def carve_balls(self, centres: Floats, radii: Floats, owners: NDArray[np.int64]) -> Floats:
        """Dig balls out of the solid, and return the volume that each ball removed, float64[k] (mm³). Centres [k,3] and radii [k]
        are in mm. `owners`: int64[k], the ids of the agents that dig.

        The distance of each node becomes max(distance, radius - distance from the centre), so the order of the balls does not
        matter. The loss of a voxel is attributed to the ball that reaches deepest there, or on a tie, to the ball with the lowest
        owner. The sum of the result equals the decrease of `measure_volume()`, to the last bit."""
        return carving.carve_balls(self.bricks, centres, radii, owners)

    def measure_volume(self) -> float:
        """Return the solid volume in mm³. The solid fraction of each voxel, in steps of 1/256, is estimated from the distance of
        the voxel's node."""
        return self.bricks.volume_steps * self.bricks.step_volume

    @property
    def removed_volume(self) -> float:
        """Return the volume dug so far, mm³."""
        return (self.bricks.start_volume_steps - self.bricks.volume_steps) * self.bricks.step_volume

    # ---- showing

    def iterate_brick_meshes(self, changed_only: bool = True) -> Iterator[tuple[int, Floats, NDArray[np.int32]]]:
        """Yield the surface as triangles, brick by brick: (key of the brick, vertices float64[n,3] in mm, faces int32[m,3] with
        winding seen from the air).

        With `changed_only`, only bricks that changed since the last call are yielded; the first call yields all bricks. A brick
        is also yielded if it has lost all its faces. Vertices on the side between two bricks have the same coordinates in both,
        so their meshes fit together."""
        return iterate_brick_meshes(self.bricks, changed_only)

    # ---- keeping

    def get_changes(self) -> Arrays:
        """Return the changes by digging, as arrays by name: the bricks that differ from those of `from_mesh`, and the solid
        volume in steps of `BrickGrid.step_volume`."""
        return self.bricks.get_changes()

    def restore_changes(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the state that `get_changes` returned for a volume from the same mesh. Raises ValueError if the arrays belong
        to another volume."""
        self.bricks.restore_changes(arrays)

    def compute_digest(self) -> bytes:
        """Return a digest of 32 bytes. Equal solids have equal digests. Only bricks that changed since the last call are read."""
        return self.bricks.compute_digest()

    @property
    def nbytes(self) -> int:
        """Return the memory of the arrays in bytes."""
        return self.bricks.nbytes


def _split_columns(points: Floats) -> tuple[Floats, Floats, Floats]:
    x, y, z = np.array(np.asarray(points, np.float64).reshape(-1, 3).T, order="C")
    return x, y, z


def iterate_brick_meshes(bricks: BrickGrid, changed_only: bool) -> Iterator[BrickMesh]:
    """Yield the surface as triangles, brick by brick. Same as `Volume.iterate_brick_meshes`."""
    chosen_bricks = np.flatnonzero(bricks.needs_meshing) if changed_only else np.arange(bricks.table.size)
    if not changed_only:
        chosen_bricks = np.flatnonzero(_find_bricks_to_mesh(bricks))
    for brick in chosen_bricks:
        bricks.needs_meshing[brick] = False
        yield _mesh_brick(bricks, int(brick))


def _find_bricks_to_mesh(bricks: BrickGrid) -> NDArray[np.bool_]:
    """Return a mask of the bricks in which some cell has at least one node that is stored."""
    stored = (bricks.table >= 2).reshape(bricks.shape)
    reach = stored.copy()
    for axis in range(3):
        moved = np.zeros_like(reach)
        ahead: list[slice] = [slice(None)] * 3
        behind: list[slice] = [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        moved[tuple(behind)] = reach[tuple(ahead)]
        reach |= moved
    return reach.ravel()


def load_corner_values(bricks: BrickGrid, brick: int) -> NDArray[np.float32]:
    """Return the values (17, 17, 17) at the corners of a brick's cells. A brick at the end of the grid has fewer values."""
    at = np.unravel_index(brick, bricks.shape)
    pool = bricks.values.reshape(-1, NODES_PER_BRICK)
    sizes = [NODES_PER_BRICK_SIDE + (1 if at[axis] + 1 < bricks.shape[axis] else 0) for axis in range(3)]
    result = np.empty(sizes, np.float32)
    table = bricks.table.reshape(bricks.shape)
    for a in range(2):
        for b in range(2):
            for c in range(2):
                into = tuple(
                    slice(NODES_PER_BRICK_SIDE * d, NODES_PER_BRICK_SIDE + d * (sizes[axis] - NODES_PER_BRICK_SIDE))
                    for axis, d in enumerate((a, b, c))
                )
                if result[into].size:
                    block = pool[table[at[0] + a, at[1] + b, at[2] + c]].reshape(
                        NODES_PER_BRICK_SIDE, NODES_PER_BRICK_SIDE, NODES_PER_BRICK_SIDE
                    )
                    result[into] = block[tuple(slice(0, s.stop - s.start) for s in into)]
    return result


def _mesh_brick(bricks: BrickGrid, brick: int) -> BrickMesh:
    """Return the key, vertices and faces of a brick, by marching cubes."""
    from skimage.measure import marching_cubes

    values = load_corner_values(bricks, brick)
    if not (values.min() < 0 < values.max()):
        return brick, np.empty((0, 3)), np.empty((0, 3), np.int32)
    cut: Any = marching_cubes
    vertices, faces, _, _ = cut(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    corner = np.stack(np.unravel_index(brick, bricks.shape)).astype(np.float64) * NODES_PER_BRICK_SIDE
    grid_points = np.round(vertices.astype(np.float64) * _VERTEX_STEPS_PER_VOXEL) / _VERTEX_STEPS_PER_VOXEL + corner
    return brick, bricks.origin + grid_points * bricks.voxel, np.ascontiguousarray(faces, np.int32)
