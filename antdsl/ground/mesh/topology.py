"""The topology of triangle meshes: frames of faces, links across edges, connected pieces, and smooth normals.

The input is vertices float64[n,3] and faces int32[m,3], in which one or more meshes are concatenated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.self_cuts import SelfIntersections, find_self_intersections
from antdsl.numerics import elementary, stored_tables
from antdsl.numerics.vectors import dot
from antdsl.scene.geometry.live_faces import find_faces_with_area, number_connected_components, number_welded_corners

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Index = NDArray[np.int64]

_RELATIVE_TOUCH_DISTANCE = 1e-9  # share of the extent; nearer faces touch
_RATE_OF_DEGENERATE_FACE = 1e12  # weight per mm across a face without width
_CREASE_COSINE = np.sqrt(0.5)  # cosine of 45 degrees; between faces at a larger angle, normals are not smoothed

NO_LINKED_EDGE = -1
_FLOAT_COLUMNS = tuple(
    ["corner", "edge1", "edge2", "normal", "axis1", "axis2", "rate1", "rate2", "shear", "edge_c", "edge_s", "smooth"]
)


@dataclass(frozen=True, slots=True, eq=False)
class MeshTopology:
    """The topology and shape of all m faces, as tables. Vectors are (3, m), so that each component is contiguous.

    - `is_live`: whether agents can stand on a face. `weld` (m, 3): a number for each corner; corners at one position share it.
    - A point of face f is `corner + b1 * edge1 + b2 * edge2`.
    - `axis1`, `axis2`, `normal`: the frame of a face. A direction (c, s) in it changes b1 by `c * rate1 - s * shear` and b2 by
      `s * rate2` per mm.
    - `edge_c`, `edge_s`: the direction of each half-edge in the frame. Half-edge 3f+k is opposite corner k, and goes from corner
      k+1 to k+2.
    - `link[side, 3f+k]`: the neighbour across half-edge 3f+k, or NO_LINKED_EDGE. `side` is 0 for an agent on the side of the
      normal, 1 for the other side. A link is 8 times the neighbouring face, plus 2 times its corner opposite the edge, plus 1 if
      its winding is opposite.
    - `piece`: the connected piece of each face. `side_groups` (2, m): a number for each side of a face; agents can walk between
      sides with the same number.
    - `smooth` (9, m): the smooth normals at the three corners."""

    is_live: NDArray[np.bool_]
    corner: Floats
    edge1: Floats
    edge2: Floats
    normal: Floats
    axis1: Floats
    axis2: Floats
    rate1: Floats
    rate2: Floats
    shear: Floats
    edge_c: Floats
    edge_s: Floats
    link: Ints
    piece: Ints
    piece_count: int
    cuts: SelfIntersections  # cuts between faces of one piece
    side_groups: (
        Ints  # (2, m): group number of each side (0: the normal's); sides that are reachable from each other share a number
    )
    has_forked_edges: bool  # whether the links of any edge differ between the two sides, as where more than two faces meet
    smooth: Floats  # (9, m): unit normal at corner 0, 1, 2
    weld: Ints  # (m, 3): vertex numbers of corners; corners at one position share a number

    def to_world_vectors(self, face: Index, c: Floats, s: Floats) -> Floats:
        """Return vectors (3, k) in world space, from their components `c` and `s` in the frames of faces."""
        return self.axis1.take(face, axis=1) * c + self.axis2.take(face, axis=1) * s

    def compute_weights(self, face: Index, place: Floats) -> tuple[Floats, Floats]:
        """Project nearby positions (3, k) onto faces. Return their barycentric weights, clamped to the triangles."""
        if not self.corner.shape[1]:
            return np.zeros(len(face)), np.zeros(len(face))
        off = place - self.corner.take(face, axis=1)
        c, s = dot(self.axis1.take(face, axis=1), off), dot(self.axis2.take(face, axis=1), off)
        b1, b2 = c * self.rate1.take(face) - s * self.shear.take(face) + 0.0, s * self.rate2.take(face) + 0.0  # no -0.0
        b1, b2 = np.clip(b1, 0.0, 1.0), np.clip(b2, 0.0, 1.0)
        total = np.maximum(b1 + b2, 1.0)
        return b1 / total, b2 / total

    def copy(self) -> MeshTopology:
        """Return a copy. Changing the shape of the copy does not change the original."""
        return replace(self, **{name: getattr(self, name).copy() for name in _FLOAT_COLUMNS})


def build_topology(vertices: Floats, faces: Ints, mesh: Ints, extent: float) -> MeshTopology:
    """Return the topology of faces. `mesh`: int32[m], the mesh of each face; only corners of the same mesh are joined. `extent`:
    the size of the ground (mm). The tables are stored for later runs."""
    inputs = (vertices, faces, mesh, extent)
    tables = stored_tables.get_or_compute("topology", len(faces), inputs, partial(_build_tables, *inputs))
    cut = SelfIntersections(tables.pop("first_cut"), tables.pop("cut_by"))
    link, piece = tables["link"], tables["piece"]
    return MeshTopology(
        **tables, piece_count=int(piece.max(initial=-1)) + 1, has_forked_edges=bool((link[0] != link[1]).any()), cuts=cut
    )


def _build_tables(vertices: Floats, faces: Ints, mesh: Ints, extent: float) -> stored_tables.Tables:
    """Return the arrays of a `MeshTopology` by field name. Those of its cuts are called `first_cut` and `cut_by`."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    weld = number_welded_corners(vertices, faces, mesh, extent)
    live = find_faces_with_area(weld, a, b, c)
    link = _link_edges(vertices, faces, weld, live)
    piece = _number_pieces(link, live)
    cut = find_self_intersections(vertices[faces], weld, piece, extent * _RELATIVE_TOUCH_DISTANCE)
    side_groups, shape = _group_face_sides(link, live, piece), _compute_shape_arrays(vertices, faces, weld, live)
    return {
        "is_live": live,
        "link": link,
        "piece": piece,
        "side_groups": side_groups,
        "weld": weld,
        "first_cut": cut.cut_starts,
        "cut_by": cut.cutting_faces,
        **shape,
    }


def update_face_shapes(table: MeshTopology, vertices: Floats, faces: Ints, rows: slice) -> None:
    """Update the arrays of `table` after vertices have moved. `rows`: the faces that moved, which are all faces of one mesh.

    Connections between faces do not change. A face that now has no area retains its normal and has zero width."""
    live, weld = table.is_live[rows], table.weld[rows]
    old_frames = {name: getattr(table, name)[:, rows].copy() for name in ("normal", "axis1", "axis2")}
    edges = {name: getattr(table, name).reshape(-1, 3)[rows].copy() for name in ("edge_c", "edge_s")}
    shape = _compute_shape_arrays(vertices, faces[rows], weld - weld.min(initial=0), live)
    flat = live & ~(np.isfinite(shape["rate1"]) & np.isfinite(shape["rate2"]) & (shape["rate2"] > 0))
    for name in _FLOAT_COLUMNS:
        array = getattr(table, name)
        if name in ("edge_c", "edge_s"):
            array.reshape(-1, 3)[rows] = shape[name].reshape(-1, 3)
        else:
            array[..., rows] = shape[name]
    if flat.any():
        at = np.flatnonzero(flat) + (rows.start or 0)
        for name, old in old_frames.items():
            getattr(table, name)[:, at] = old[:, flat]
        for name, old in edges.items():
            getattr(table, name).reshape(-1, 3)[at] = old[flat]
        table.rate1[at], table.rate2[at], table.shear[at] = _RATE_OF_DEGENERATE_FACE, _RATE_OF_DEGENERATE_FACE, 0.0
        table.smooth[:, at] = np.tile(table.normal[:, at], (3, 1))


def _compute_shape_arrays(vertices: Floats, faces: Ints, weld: Ints, is_live: NDArray[np.bool_]) -> dict[str, Floats]:
    """Return the arrays that depend on the positions of corners, by the names in _FLOAT_COLUMNS."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    edge1, edge2 = b - a, c - a
    across = np.cross(edge1, edge2)
    with np.errstate(all="ignore"):  # a moving face may lose its area
        normal = across / np.where(is_live, _compute_lengths(across), 1.0)[:, None]
        length1 = np.where(is_live, _compute_lengths(edge1), 1.0)
        axis1 = edge1 / length1[:, None]
        normal = np.where(np.isfinite(normal), normal, 0.0)
        axis2 = np.cross(normal, axis1)
        x2, y2 = (edge2 * axis1).sum(axis=1), np.where(is_live, (edge2 * axis2).sum(axis=1), 1.0)
        direction = _compute_edge_directions(length1, x2, y2)
        frame = [np.ascontiguousarray(v.T) for v in (a, edge1, edge2, normal, axis1, axis2)]
        smooth = _compute_smooth_normals(vertices, faces, weld, is_live, normal)
        rates = (1 / length1, 1 / y2, x2 / (y2 * length1))
    return dict(zip(_FLOAT_COLUMNS, (*frame, *rates, *direction, smooth), strict=True))


def _compute_lengths(v: Floats) -> Floats:
    length: Floats = np.sqrt((v * v).sum(axis=1))
    return length


def _compute_edge_directions(length1: Floats, x2: Floats, y2: Floats) -> tuple[Floats, Floats]:
    """Return the unit directions of all half-edges in the frames of their faces, as two arrays of 3m numbers."""
    c = np.stack([x2 - length1, -x2, length1], axis=1)
    s = np.stack([y2, -y2, np.zeros_like(y2)], axis=1)
    size = np.sqrt(c * c + s * s)
    size[size == 0] = 1.0
    return (c / size).ravel(), (s / size).ravel()


def _link_edges(vertices: Floats, faces: Ints, weld: Ints, is_live: NDArray[np.bool_]) -> Ints:
    """Return the links of all half-edges for both sides of the faces (2, 3m). The neighbour on a side is the next face around the
    edge on this side.

    More than two faces can meet at an edge, as where a wall stands on a floor. An agent then stays in the wedge between two of
    them."""
    m = len(faces)
    link = np.full((2, 3 * m), NO_LINKED_EDGE, np.int32)
    half = np.flatnonzero(np.repeat(is_live, 3))
    if not half.size:
        return link
    face, k = half // 3, half % 3
    one, two = weld[face, (k + 1) % 3], weld[face, (k + 2) % 3]
    key = (np.minimum(one, two).astype(np.int64) << 32) | np.maximum(one, two)
    along = np.where(one < two, 1.0, -1.0)
    start, end = vertices[faces[face, (k + 1) % 3]], vertices[faces[face, (k + 2) % 3]]
    edge = (end - start) * along[:, None]
    edge /= _compute_lengths(edge)[:, None]
    inward = vertices[faces[face, k]] - start
    inward -= (inward * edge).sum(axis=1)[:, None] * edge
    order = np.argsort(key, kind="stable")
    first = np.concatenate(([True], key[order][1:] != key[order][:-1]))
    group = np.empty(half.size, np.int64)
    group[order] = np.cumsum(first) - 1
    lead = order[first][group]  # one half-edge of each edge defines the direction and the zero of the angle
    axis, zero = edge[lead], inward[lead]
    angle = elementary.atan2_float64((np.cross(axis, zero) * inward).sum(axis=1), (zero * inward).sum(axis=1))
    order = np.lexsort((half, np.round(angle, 9), group))
    count = np.bincount(group)
    begin = np.cumsum(count) - count
    place = np.empty(half.size, np.int64)
    place[order] = np.arange(half.size)
    place -= begin[group]
    # The winding of a face decides whether a rotation from the face towards its normal increases the angle.
    upward = along > 0
    many = count[group] > 1
    for side in (0, 1):
        step = np.where(upward == (side == 0), 1, -1)
        beyond = order[begin[group] + (place + step) % count[group]]
        flip = (along[beyond] == along).astype(np.int64)  # faces with equal winding traverse their edge in opposite directions
        link[side, half[many]] = (8 * face[beyond] + 2 * k[beyond] + flip)[many]
    return link


def _number_pieces(link: Ints, is_live: NDArray[np.bool_]) -> Ints:
    """Return the number of each face's connected piece, or -1 for faces that are not live. Pieces are numbered from 0 in the
    order of their first faces."""
    half = np.flatnonzero(link[0] != NO_LINKED_EDGE)
    piece = number_connected_components(np.stack([half // 3, link[0, half] >> 3], axis=1), len(is_live))
    result = np.full(len(is_live), -1, np.int32)
    result[is_live] = np.unique(piece[is_live], return_inverse=True)[1]
    return result


def _group_face_sides(link: Ints, is_live: NDArray[np.bool_], piece: Ints) -> Ints:
    """Return a group number for each side of each face (2, m).

    Agents can walk between sides with the same number, which are connected across edges. The two sides of a sheet have different
    numbers, but those of a Möbius strip have the same. A piece without an open border has an unambiguous inside and outside, even
    where it cuts itself; all its sides share one number."""
    m = len(is_live)
    if not (link[0].reshape(-1, 3)[is_live] == NO_LINKED_EDGE).any():
        return np.zeros((2, m), np.int32)
    from_sides, to_sides = [], []
    for side in (0, 1):
        half = np.flatnonzero(link[side] != NO_LINKED_EDGE)
        beyond = link[side, half].astype(np.int64)
        from_sides.append(half // 3 + side * m)
        to_sides.append((beyond >> 3) + (side ^ (beyond & 1)) * m)
    shut = np.ones(int(piece.max(initial=-1)) + 1, bool)
    shut[piece[is_live & (link[0].reshape(-1, 3) == NO_LINKED_EDGE).any(axis=1)]] = False
    closed = np.flatnonzero(is_live)[shut[piece[is_live]]]
    one, two = np.concatenate([*from_sides, closed]), np.concatenate([*to_sides, closed + m])
    return number_connected_components(np.stack([one, two], axis=1), 2 * m).reshape(2, m)


def _compute_smooth_normals(vertices: Floats, faces: Ints, weld: Ints, is_live: NDArray[np.bool_], normal: Floats) -> Floats:
    """Return the smooth normals at the corners of faces, (9, m). Each is the mean normal of the faces around the corner, weighted
    by their angles there. Faces across a crease are excluded (Thürmer, Wüthrich, Computing Vertex Normals from Polygonal Facets,
    1998, p. 43-46)."""
    m = len(faces)
    corners = vertices[faces]
    weight = np.zeros((m, 3))
    for k in range(3):
        u, v = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        weight[:, k] = elementary.atan2_float64(_compute_lengths(np.cross(u, v)), (u * v).sum(axis=1))
    weight[~is_live] = 0.0
    points = int(weld.max(initial=-1)) + 1
    flat = weld.ravel()
    each = np.repeat(normal, 3, axis=0)
    total: Floats = np.stack([np.bincount(flat, weight.ravel() * each[:, axis], points) for axis in range(3)], axis=1)
    mean = total / np.maximum(_compute_lengths(total), 1e-300)[:, None]
    smooth = mean[flat]
    # If each face is within half the crease angle of the mean, any two are within the crease angle.
    sharp = np.bincount(flat, (smooth * each).sum(axis=1) < np.sqrt((1 + _CREASE_COSINE) / 2), points) > 0
    slow = np.flatnonzero(sharp[flat])
    if slow.size:
        slow = slow[np.argsort(flat[slow], kind="stable")]
        smooth[slow] = _compute_crease_normals(slow, flat, weight.ravel(), each)
    return np.ascontiguousarray(smooth.reshape(m, 9).T)


def _compute_crease_normals(corner: NDArray[np.int64], point: Ints, weight: Floats, normal: Floats) -> Floats:
    """Return the smooth normals of corners, which are sorted by their `point`. Each normal is the mean over all corners at the
    same point, except corners of faces beyond a crease."""
    count = np.bincount(point[corner])[point[corner]]
    begin = np.searchsorted(point[corner], point[corner], side="left")
    one = np.repeat(np.arange(corner.size), count)
    step = np.arange(one.size) - np.repeat(np.cumsum(count) - count, count)
    other = corner[begin[one] + step]
    cosine = (normal[corner[one]] * normal[other]).sum(axis=1)
    share = np.where(np.abs(cosine) >= _CREASE_COSINE, np.sign(cosine) * weight[other], 0.0)
    total: Floats = np.stack([np.bincount(one, share * normal[other][:, axis], corner.size) for axis in range(3)], axis=1)
    size = _compute_lengths(total)
    return np.where(size[:, None] > 0, total / np.maximum(size, 1e-300)[:, None], normal[corner])


def classify_normal_directions(normals: Floats) -> NDArray[np.int8]:
    """Return the axis direction nearest to each normal [n,3], int8[n]: 0 +x, 1 -x, 2 +y, 3 -y, 4 +z, 5 -z. Of equally near
    directions, the first is returned."""
    n = np.asarray(normals)
    axis = np.abs(n).argmax(axis=1)
    side: NDArray[np.int64] = 2 * axis + (n[np.arange(len(n)), axis] < 0)
    return side.astype(np.int8)
