"""A bounding box tree over triangles, which finds the first triangle that a short straight path hits. It computes in float64."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.face_table import CORNER_OFFSET, EDGE1_OFFSET, EDGE2_OFFSET, FLOATS_PER_FACE_ROW
from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, Array2, allocate_scratch, inlined, kernel_helper, prefetch
from antdsl.numerics.kernel_vectors import TriangleWeights, Vec3, cross, dot, load_vector, minus
from antdsl.numerics.sorting import compute_morton_codes

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

BOXES_PER_NODE = 4  # child boxes of a box
# Margin of corner weights for a hit, so that no path passes between two triangles at an edge
EDGE_TOLERANCE = 1e-9
MAX_STEP_EXTENSION_FACTOR = 1e6  # maximum factor by which a path is extended
MIN_PLANE_SINE = 1e-12  # sine between a path and a plane; below it, the path counts as parallel, without a hit
_GRID_STEPS_PER_AXIS = 1 << 21  # resolution of the Morton order along an axis
_MAX_OPEN_BOXES = 128  # size of the stack of boxes; a tree of 2**40 triangles needs less


class FaceBoxTree(NamedTuple):
    """The arrays of `FaceBoxes` for kernels."""

    triangle_order: Array1[I64]
    level_starts: Array1[I64]
    bounds: Array2[F64]


class FaceList(NamedTuple):
    """A buffer for face numbers: an array, and the index where the buffer begins."""

    face_numbers: Array1[I64]
    first_index: I64


class BoxHit(NamedTuple):
    """The first face on a path (-1 for none), the fraction of the path before it, and the barycentric weights of the hit."""

    face: I64
    path_fraction: F64
    weights: TriangleWeights


@dataclass(frozen=True, slots=True, eq=False)
class FaceBoxes:
    """A tree of boxes over triangles.

    - `triangle_order`: the triangle in each of the smallest boxes, which hold one triangle each
    - `level_starts`: level k has the boxes `level_starts[k]` to `level_starts[k + 1]` (exclusive). Each box of a level contains
      `BOXES_PER_NODE` boxes of the level below
    - `bounds` (n, 6): the least x, y, z of each box, then its greatest x, y, z"""

    triangle_order: Index
    level_starts: Index
    bounds: Floats

    @staticmethod
    def build(vertices: Floats, faces: NDArray[np.int32], live_faces: Index, group: NDArray[np.int32]) -> FaceBoxes:
        """Build the tree of the `live_faces` triangles.

        `group` int32[m]: a number for each triangle. Triangles with equal numbers are consecutive in the tree. They are in Morton
        order, so that neighbours share boxes (Lauterbach et al., Fast BVH Construction on GPUs, 2009, p. 376-378)."""
        order = live_faces[np.lexsort((_compute_morton_numbers(vertices[faces[live_faces]].mean(axis=1)), group[live_faces]))]
        counts = [live_faces.size]
        while counts[-1] > 1:
            counts.append(-(-counts[-1] // BOXES_PER_NODE))
        first = np.cumsum([0, *counts])
        boxes = FaceBoxes(order, first, np.empty((int(first[-1]), 6)))
        boxes.refit_boxes(vertices, faces)
        return boxes

    def refit_boxes(self, vertices: Floats, faces: NDArray[np.int32], first_moved: int = 0) -> None:
        """Update `bounds` after triangles have moved. The first `first_moved` triangles of `triangle_order` have not moved."""
        a, b, c = (vertices.take(faces[self.triangle_order[first_moved:], k], axis=0) for k in range(3))
        ends = np.concatenate([np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)], axis=1)
        self.bounds[first_moved : self.level_starts[1]] = ends
        for k in range(1, len(self.level_starts) - 1):
            first_moved //= BOXES_PER_NODE
            ends = self.bounds[self.level_starts[k - 1] + BOXES_PER_NODE * first_moved : self.level_starts[k]]
            ends = np.concatenate([ends, np.repeat(ends[-1:], -len(ends) % BOXES_PER_NODE, axis=0)]).reshape(
                -1, BOXES_PER_NODE, 6
            )
            rows = slice(self.level_starts[k] + first_moved, self.level_starts[k + 1])
            self.bounds[rows, :3], self.bounds[rows, 3:] = ends[:, :, :3].min(axis=1), ends[:, :, 3:].max(axis=1)

    def to_box_tree(self) -> FaceBoxTree:
        """Return the arrays for kernels."""
        return FaceBoxTree(self.triangle_order, self.level_starts, self.bounds)

    def find_overlapping_pairs(self, low: Floats, high: Floats) -> tuple[Index, Index]:
        """Return the overlapping pairs of a query box and a triangle's box, as two arrays: numbers of query boxes and triangles.

        `low`, `high` (3, k): the corners of the query boxes."""
        box_numbers, node = np.arange(low.shape[1]), np.zeros(low.shape[1], np.int64)
        if not self.triangle_order.size:
            return box_numbers[:0], node[:0]
        for k in range(len(self.level_starts) - 2, -1, -1):
            bounds = self.bounds.take(self.level_starts[k] + node, axis=0).T
            over = (bounds[0] <= high[0].take(box_numbers)) & (bounds[3] >= low[0].take(box_numbers))
            for axis in (1, 2):
                over &= (bounds[axis] <= high[axis].take(box_numbers)) & (bounds[3 + axis] >= low[axis].take(box_numbers))
            box_numbers, node = box_numbers[over], node[over]
            if k:
                node = (BOXES_PER_NODE * node[:, None] + np.arange(BOXES_PER_NODE)).ravel()
                real = node < self.level_starts[k] - self.level_starts[k - 1]
                box_numbers, node = np.repeat(box_numbers, BOXES_PER_NODE)[real], node[real]
        return box_numbers, self.triangle_order.take(node)


@kernel_helper
def list_faces_near_segment(
    pieces: Array1[I32],
    box_tree: FaceBoxTree,
    first_point: Vec3,
    second_point: Vec3,
    margin: F64,
    face: I64,
    piece: I64,
    face_list: FaceList,
) -> I64:
    """Write to `face_list` the triangles of which the boxes overlap a query box, and return their number.

    The query box is the box around `first_point` and `second_point`, extended by `margin` mm on all sides. A triangle is written
    as its index in `triangle_order`. `face` and the triangles of the piece `piece` are excluded."""
    order, first, bounds = box_tree
    numbers, behind = face_list
    count, waiting = 0, 0
    low_x, low_y, low_z = (
        min(first_point[0], second_point[0]) - margin,
        min(first_point[1], second_point[1]) - margin,
        min(first_point[2], second_point[2]) - margin,
    )
    high_x, high_y, high_z = (
        max(first_point[0], second_point[0]) + margin,
        max(first_point[1], second_point[1]) + margin,
        max(first_point[2], second_point[2]) + margin,
    )
    levels, nodes = allocate_scratch(_MAX_OPEN_BOXES, I64), allocate_scratch(_MAX_OPEN_BOXES, I64)
    if order.size:
        levels[0], nodes[0], waiting = first.size - 2, 0, 1
    while waiting:
        waiting -= 1
        level, node = levels[waiting], nodes[waiting]
        for child in range(node, min(node + BOXES_PER_NODE, first[level + 1] - first[level])):
            b = first[level] + child
            if is_disjoint(bounds, b, low_x, low_y, low_z, high_x, high_y, high_z):
                continue
            if level > 0:
                levels[waiting], nodes[waiting] = level - 1, BOXES_PER_NODE * child
                waiting += 1
                for line in (0, 8, 16):
                    prefetch(bounds, 6 * (first[level - 1] + BOXES_PER_NODE * child) + line)
            elif order[child] != face and pieces[order[child]] != piece:
                numbers[behind + count] = child
                count += 1
    return count


@kernel_helper
def find_first_face_hit(
    table: Array1[F64], box_tree: FaceBoxTree, face_list: FaceList, count: I64, origin: Vec3, step: Vec3, extension: F64
) -> BoxHit:
    """Return the first hit of the path from `origin` by `step`, extended by `extension` mm. Only the first `count` triangles of
    `face_list` are tested.

    `table`: the packed table of faces. Triangles can be hit from both sides, but not by a path in their plane. If hits are
    equally far, the triangle with the lower number is returned (Möller, Trumbore, Fast, Minimum Storage Ray/Triangle
    Intersection, 1997, p. 22-24)."""
    order, _, bounds = box_tree
    numbers, behind = face_list
    face, part, b1, b2 = -1, np.inf, 0.0, 0.0
    if count == 0:
        return BoxHit(face, part, (b1, b2))
    square = dot(step, step)
    long = 1.0 + min(extension / max(np.sqrt(square), 1e-300), MAX_STEP_EXTENSION_FACTOR)
    end_x, end_y, end_z = origin[0] + step[0] * long, origin[1] + step[1] * long, origin[2] + step[2] * long
    low_x, low_y, low_z = min(origin[0], end_x), min(origin[1], end_y), min(origin[2], end_z)
    high_x, high_y, high_z = max(origin[0], end_x), max(origin[1], end_y), max(origin[2], end_z)
    for k in range(count):
        b = numbers[behind + k]
        if is_disjoint(bounds, b, low_x, low_y, low_z, high_x, high_y, high_z):
            continue
        f = order[b]
        row = FLOATS_PER_FACE_ROW * f
        e1, e2, s = (
            load_vector(table, row + EDGE1_OFFSET),
            load_vector(table, row + EDGE2_OFFSET),
            minus(origin, load_vector(table, row + CORNER_OFFSET)),
        )
        p = cross(step, e2)
        det = dot(e1, p)
        if abs(det) <= MIN_PLANE_SINE * np.sqrt(square * dot(e1, e1) * dot(e2, e2)):
            continue
        q = cross(s, e1)
        u, v, t = dot(s, p) / det, dot(step, q) / det, dot(e2, q) / det
        hit = u >= -EDGE_TOLERANCE and v >= -EDGE_TOLERANCE and u + v <= 1.0 + EDGE_TOLERANCE and t >= 0 and t <= long
        if hit and (t < part or (t == part and f < face)):
            face, part, b1, b2 = f, t, u, v
    return BoxHit(face, part, (b1, b2))


@inlined
def is_disjoint(bounds: Array2[F64], b: I64, low_x: F64, low_y: F64, low_z: F64, high_x: F64, high_y: F64, high_z: F64) -> BOOL:
    """Return whether box `b` does not overlap the box from `low_x`, `low_y`, `low_z` to `high_x`, `high_y`, `high_z`. All axes
    are tested without branches, because both results are equally likely and branches would be mispredicted."""
    x = (bounds[b, 0] > high_x) | (bounds[b, 3] < low_x)
    y = (bounds[b, 1] > high_y) | (bounds[b, 4] < low_y)
    return x | y | (bounds[b, 2] > high_z) | (bounds[b, 5] < low_z)


def _compute_morton_numbers(positions: Floats) -> NDArray[np.uint64]:
    """Return the index of each position [n,3] on a Morton curve. Nearby positions have similar indices."""
    if not len(positions):
        return np.empty(0, np.uint64)
    low = positions.min(axis=0)
    size = max(float((positions.max(axis=0) - low).max()), 1e-300)
    cell = np.minimum((positions - low) / size * _GRID_STEPS_PER_AXIS, _GRID_STEPS_PER_AXIS - 1).astype(np.uint64)
    return compute_morton_codes(cell)
