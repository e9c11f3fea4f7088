"""Finds the areas of a ground where it may rise ahead of a body.

These areas are near inner creases, and where two pieces of the ground are close to each other."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial, reduce
from operator import or_

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.grid_filters import filter_maximum, filter_minimum
from antdsl.casting.rasterise import iterate_triangle_cells
from antdsl.casting.rays import RayScene
from antdsl.ground.mesh.topology import NO_LINKED_EDGE, MeshTopology
from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, Array3, Strided2, float_to_bits, inlined, kernel
from antdsl.numerics import elementary, parallel, stored_tables
from antdsl.numerics.vectors import dot

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Ints = NDArray[np.int32]

_SAMPLES_PER_CREASE = 5  # points along a crease from which distances are measured
_MAX_SEPARATE_PIECES = 64  # with more pieces, each face counts as near another
_MAX_RELATIVE_DISTANCE = 0.1  # share of the size of the other pieces
_RELATIVE_DISTANCE_NOISE = 1e-4  # share of the ground's extent; exceeds the error of float32 distances
_MAX_CELLS_PER_AXIS = 192  # cells along the longest side of a ground
_SMOOTH_EDGE_COSINE = 0.7071067811865476  # cosine of the largest angle between faces at a smooth edge
_MIN_BEND_ANGLE = np.radians(14.0)  # radians; a body on smoothed ground does not touch a smaller rise
_MIN_WIDE_FACE_TURN = np.radians(5.0)  # radians; at an edge of a wide face that turns less, a body does not touch the ground
_BEND_NEIGHBOUR_RINGS = 2  # rings of faces around such an edge; smoothed normals are off the normals of all faces at its ends
_WIDE_FACE_BODY_LENGTHS = 0.6  # body lengths; a face of this height has at most one edge below either half of a body
_MAX_CURVATURE_PER_BODY = (
    0.84  # radians per body length; on ground that curves more, feet would turn faster than a body by default
)
_NO_PIECE = np.iinfo(np.int32).max
_POSITIONS_PER_THREAD = 512  # fewer positions are not worth another thread
_EXPONENT_BIAS = 1022  # offset from the exponent bits of a float64 to the exponent of np.frexp


def find_inner_creases(table: MeshTopology, corners: Floats) -> Index:
    """Return the half-edges that are inner creases for an agent on either side of the face.

    At an inner crease, the next face rises at a larger angle than at a smooth edge."""
    is_crease = np.zeros(table.link.shape[1], np.bool_)
    for side, sign in ((0, 1.0), (1, -1.0)):
        half = np.flatnonzero(table.link[side] != NO_LINKED_EDGE)
        face, link = half // 3, table.link[side, half]
        other_face, k, flip = link >> 3, (link >> 1) & 3, link & 1
        up = table.normal.take(face, axis=1) * sign
        beyond = table.normal.take(other_face, axis=1) * np.where(flip, -sign, sign)
        far = corners[other_face, k].T - corners[face, (half % 3 + 1) % 3].T
        is_rising = up[0] * far[0] + up[1] * far[1] + up[2] * far[2] > 0
        sharp = up[0] * beyond[0] + up[1] * beyond[1] + up[2] * beyond[2] < _SMOOTH_EDGE_COSINE
        is_crease[half[is_rising & sharp]] = True
    return np.flatnonzero(is_crease)


def find_sharp_edges(table: MeshTopology, corners: Floats) -> Index:
    """Return the half-edges at which the ground bends, up or down, by a larger angle than at a smooth edge."""
    half, cosine, _ = _measure_edge_turns(table)
    return half[cosine < _SMOOTH_EDGE_COSINE]


def find_bend_edges(table: MeshTopology, corners: Floats, size: float) -> tuple[Index, NDArray[np.bool_]]:
    """Return the half-edges at which a body may touch rising ground or must tilt ahead of its feet, and a mask bool[m] of faces.

    The mask is true for wide faces at or near an edge at which the ground bends. `size`: the size of the body (mm). A body covers
    several narrow faces at once, so their edges count at smaller angles too."""
    half, cosine, face = _measure_edge_turns(table)
    length = np.sqrt(((corners[face, (half % 3 + 2) % 3] - corners[face, (half % 3 + 1) % 3]) ** 2).sum(axis=1))
    area = np.sqrt((np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) ** 2).sum(axis=1))
    height = np.full(len(corners), np.inf)
    np.minimum.at(height, face, area[face] / np.maximum(length, 1e-300))
    reach = _WIDE_FACE_BODY_LENGTHS * size
    is_wide, height = height >= reach, np.minimum(height[face], height[table.link[0, half] >> 3])
    turn = _MIN_BEND_ANGLE * np.minimum(height / reach, 1.0)
    far = corners[table.link[0, half] >> 3, (table.link[0, half] >> 1) & 3].T - corners[face, (half % 3 + 1) % 3].T
    climbs = dot(table.normal.take(face, axis=1), far) > 0
    # Agents may stand on either side of a sheet: an edge that descends on one side rises on the other.
    climbs |= bool((table.link[0].reshape(-1, 3)[table.is_live] == NO_LINKED_EDGE).any())
    bends, wide = (cosine < elementary.cos(turn.astype(np.float32))) & climbs, height >= reach
    curls = cosine < elementary.cos((_MAX_CURVATURE_PER_BODY * np.minimum(height / size, 1.0)).astype(np.float32))
    has_bend = np.zeros(len(corners), np.bool_)
    has_bend[face[wide & (cosine < elementary.cos(np.float32(_MIN_WIDE_FACE_TURN)))]] = True
    for _ in range(_BEND_NEIGHBOUR_RINGS):
        has_bend[face[has_bend[table.link[0, half] >> 3]]] = True
    return half[(bends & ~wide) | curls], has_bend & is_wide


def _measure_edge_turns(table: MeshTopology) -> tuple[Index, Floats, Index]:
    """Return the half-edges with a link to another face. For each, also return the cosine of the angle between the two faces, and
    the face of the half-edge."""
    half = np.flatnonzero(table.link[0] != NO_LINKED_EDGE)
    face, link = half // 3, table.link[0, half]
    beyond = table.normal.take(link >> 3, axis=1) * np.where(link & 1, -1.0, 1.0)
    return half, dot(table.normal.take(face, axis=1), beyond), face


class CreaseMap:
    """A grid of the cells near an inner crease, near another piece of the ground, or near a face that cuts its own piece.

    - `corners` float64[m,3,3]: the corners of the faces
    - `table`: the topology of the faces
    - `face_mask`: which faces to consider
    - `half`: the half-edges that count as creases"""

    def __init__(self, corners: Floats, table: MeshTopology, face_mask: NDArray[np.bool_], half: Index) -> None:
        live = np.flatnonzero(table.is_live & face_mask)
        self._near_cells_by_rung: dict[int, NDArray[np.bool_]] = {}
        self._low = corners[live].min(axis=(0, 1)) if live.size else np.zeros(3)
        size = (corners[live].max(axis=(0, 1)) if live.size else np.zeros(3)) - self._low
        self._width = max(float(size.max()) / _MAX_CELLS_PER_AXIS, 1e-9)
        self._shape = np.floor(size / self._width).astype(np.int64) + 1
        self._lowest_rung = int(np.frexp(self._width)[1])
        # least and greatest distance (mm) that is distinguished
        self.reach_range = (self._width, float(self._shape.max()) * self._width)
        self._inputs = (corners, table, face_mask, half)

    @cached_property
    def _crease_and_piece_grids(self) -> tuple[NDArray[np.bool_], Ints, Ints] | tuple[NDArray[np.bool_]]:
        """Return a mask of the cells that contain a crease or a cut face. If the ground has several pieces, also return the least
        and the greatest piece number in each cell."""
        corners, table, minded, half = self._inputs
        live = np.flatnonzero(table.is_live & minded)
        half = half[minded[half // 3]]
        one, two = (corners[half // 3, (half % 3 + k) % 3] for k in (1, 2))
        sharp = self._mark_cells(np.stack([one, two, two], axis=1))
        sharp |= self._mark_cells(corners[np.flatnonzero(table.cuts.is_cut & minded)])
        if len(np.unique(table.piece[live])) < 2:
            return (sharp,)
        least, most = np.full(self._shape, _NO_PIECE, np.int32), np.full(self._shape, -1, np.int32)
        for cell, which in iterate_triangle_cells((corners[live] - self._low) / self._width, exact=False):
            at = tuple(np.clip(cell, 0, self._shape - 1).T)
            np.minimum.at(least, at, table.piece[live[which]])
            np.maximum.at(most, at, table.piece[live[which]])
        return sharp, least, most

    def _mark_cells(self, corners: Floats) -> NDArray[np.bool_]:
        """Return a mask of the cells that triangles touch."""
        is_marked = np.zeros(self._shape, np.bool_)
        if len(corners):
            for cell, _ in iterate_triangle_cells((corners - self._low) / self._width, exact=False):
                is_marked[tuple(np.clip(cell, 0, self._shape - 1).T)] = True
        return is_marked

    def find_rows_near_creases(
        self, rows: Index, distance_levels: Index, used_levels: int, place: Floats, threads: int
    ) -> NDArray[np.bool_]:
        """Return a mask of the `rows` that may be near a crease, another piece of the ground, or a cut. `place` (n, 3): the
        positions. No row that is near one is omitted.

        `distance_levels`: the level of a reach is its binary exponent minus that of the cell width. Rows of level -1 count as
        near; others are tested with the grid of their level. `used_levels`: bit k is set if level k occurs. The result for a
        position and a reach does not depend on the other rows."""
        for rung in range(used_levels.bit_length()):
            if used_levels >> rung & 1:
                work = partial(
                    mark_rows_in_near_cells,
                    rows,
                    distance_levels,
                    rung,
                    place,
                    self._low,
                    self._width,
                    self._get_cells_within(self._lowest_rung + rung),
                )
                parallel.run_in_parts(work, len(rows), threads, _POSITIONS_PER_THREAD)
        is_near: NDArray[np.bool_] = distance_levels == -1
        return is_near

    def _get_cells_within(self, distance_level: int) -> NDArray[np.bool_]:
        """Return a mask of the cells within 2**distance_level mm of a crease, another piece of the ground, or a cut."""
        if distance_level not in self._near_cells_by_rung:
            rings = int(min(np.ceil(np.ldexp(1.0, distance_level) / self._width) + 1, self._shape.max()))
            corners, table, minded, half = self._inputs
            inputs = (corners, table.is_live, table.link, table.piece, table.cuts.is_cut, minded, half, float(rings))
            tables = stored_tables.get_or_compute(
                "cells near creases", len(corners), inputs, partial(self._expand_crease_cells, rings)
            )
            self._near_cells_by_rung[distance_level] = tables["near"]
        return self._near_cells_by_rung[distance_level]

    def _expand_crease_cells(self, rings: int) -> stored_tables.Tables:
        """Return a mask of the cells within `rings` cells of a crease, another piece of the ground, or a cut."""
        sharp, *pieces = self._crease_and_piece_grids
        is_near: NDArray[np.bool_] = filter_maximum(sharp, rings) if sharp.any() else sharp
        if pieces:
            least, most = filter_minimum(pieces[0], rings), filter_maximum(pieces[1], rings)
            is_near = is_near | ((least != most) & (most >= 0))
        return {"near": is_near}


def _get_slope_clearance(corners: Floats, table: MeshTopology, half: Index) -> Floats:
    """Return the result of `compute_slope_clearance`. The result is stored for later runs."""
    inputs = (corners, table.is_live, table.link, table.piece, table.cuts.is_cut, half)
    tables = stored_tables.get_or_compute(
        "clear of rises", len(corners), inputs, lambda: {"clear": compute_slope_clearance(corners, table, half)}
    )
    clear: Floats = tables["clear"]
    return clear


def compute_slope_clearance(corners: Floats, table: MeshTopology, half: Index) -> Floats:
    """Return a distance (mm) around each face, float64[m], within which there is no crease, no other piece of the ground and no
    cut face.

    `half`: the half-edges that are creases. The distance is 0 for a cut face, and infinite on a ground without creases, other
    pieces and cuts."""
    from scipy.spatial import cKDTree

    middle = corners.mean(axis=1)
    radius = np.sqrt(((corners - middle[:, None]) ** 2).sum(axis=2).max(axis=1))
    distances = np.full(len(corners), np.inf)
    if half.size:
        one, two = (corners[half // 3, (half % 3 + k) % 3] for k in (1, 2))
        part = np.linspace(0.0, 1.0, _SAMPLES_PER_CREASE)[:, None, None]
        reach = np.sqrt(((two - one) ** 2).sum(axis=1).max()) / (2 * (_SAMPLES_PER_CREASE - 1))
        samples = (one + part * (two - one)).reshape(-1, 3)  # most points occur twice, from both sides of the crease
        samples = samples[np.lexsort(samples.T)]
        fresh = np.concatenate(([True], (samples[1:] != samples[:-1]).any(axis=1)))
        distances = cKDTree(samples[fresh]).query(middle)[0] - radius - reach
    pieces, cut = np.unique(table.piece[table.is_live]).astype(np.int64), np.flatnonzero(table.cuts.is_cut)
    error = radius + _RELATIVE_DISTANCE_NOISE * (
        float((corners.max(axis=(0, 1)) - corners.min(axis=(0, 1))).max()) if len(corners) else 0
    )
    if pieces.size > _MAX_SEPARATE_PIECES:
        distances[:] = 0.0
    elif pieces.size > 1:
        distances = np.minimum(distances, _measure_piece_distance(corners, table.piece, pieces, middle, error))
    if cut.size:
        distances = np.minimum(distances, _build_ray_scene(corners[cut]).find_closest(middle)[3] - error)
        distances[cut] = 0.0
    clear: Floats = np.maximum(distances, 0.0)
    return clear


def _measure_piece_distance(corners: Floats, piece: Ints, pieces: Index, middle: Floats, error: Floats) -> Floats:
    """Return the distance (mm) from the centre of each face, `middle`, to the nearest other piece, minus `error`, float64[m]. It
    is infinite for faces without a piece.

    Each piece has its own ray scene. For each face, the piece with the nearest box is measured first, and then only pieces with
    boxes that are nearer than this result. So even with many pieces, about two are measured per face."""
    distances = np.full(len(corners), np.inf)
    own = [np.flatnonzero(piece == each) for each in pieces]
    low, high = (np.stack([ends(corners[rows], axis=(0, 1)) for rows in own]) for ends in (np.min, np.max))
    near = []
    for k, rows in enumerate(own):
        # Farther away than a tenth of the others' size, the distance to their box is sufficient.
        others = np.arange(len(own)) != k
        least, most = low[others].min(axis=0), high[others].max(axis=0)
        away = _measure_box_distance(middle[rows].T, least, most)
        far = away - error[rows] > _MAX_RELATIVE_DISTANCE * float((most - least).max())
        distances[rows[far]] = (away - error[rows])[far]
        near.append(rows[~far])
    rows = np.concatenate(near)
    at = middle[rows]
    along = np.ascontiguousarray(at.T)
    bound = np.stack([_measure_box_distance(along, least, most) for least, most in zip(low, high, strict=True)])
    bound[np.searchsorted(pieces, piece[rows]), np.arange(rows.size)] = np.inf
    begin, best = bound.argmin(axis=0), np.full(rows.size, np.inf)
    scenes = [_build_ray_scene(corners[each]) for each in own]
    for first in (True, False):
        for k, scene in enumerate(scenes):
            chosen_rows = np.flatnonzero(begin == k if first else (begin != k) & (bound[k] < best))
            best[chosen_rows] = np.minimum(best[chosen_rows], scene.find_closest(at[chosen_rows])[3])
    distances[rows] = best - error[rows]
    return distances


def _build_ray_scene(corners: Floats) -> RayScene:
    """Return a ray scene of faces with the given corners, float64[k,3,3]."""
    return RayScene(corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3))


def _measure_box_distance(positions: Floats, low: Floats, high: Floats) -> Floats:
    """Return the distance of positions (3, n) from the box with the corners `low` and `high`. It is 0 inside the box."""
    x, y, z = (np.maximum(np.maximum(a - p, p - b), 0.0) for p, a, b in zip(positions, low, high, strict=True))
    away: Floats = np.sqrt(x * x + y * y + z * z)
    return away


class SlopeMap:
    """A map of where the ground may rise ahead of agents.

    - `corners` float64[m,3,3]: the corners of the faces
    - `table`: the topology of the faces
    - `moving_masks`: for each moving mesh, a mask bool[m] of its faces
    - `half`: the half-edges that are creases"""

    def __init__(self, corners: Floats, table: MeshTopology, moving_masks: Sequence[NDArray[np.bool_]], half: Index) -> None:
        still = np.ones(len(corners), np.bool_)
        for own in moving_masks:
            still &= ~own
        self._face_clearances = _get_slope_clearance(corners, table, half) if not moving_masks else np.zeros(len(corners))
        self._min_clearance = float(self._face_clearances.min(initial=np.inf))
        self._face_sizes: Floats = np.sqrt(((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1))
        self._crease_map = CreaseMap(corners, table, still, half)

    def find_rows_near_slopes(
        self,
        mesh: Ints,
        face: Ints,
        first: Index,
        place: Floats,
        reach: Floats,
        moving_boxes: Sequence[tuple[Floats, Floats]],
        threads: int = 1,
    ) -> Index:
        """Return the rows of agents that may have a rise within `reach`, as defined by `MeshGround.find_rows_near_slopes`.

        - `mesh`, `face`: the mesh of each agent (-1 for none), and its face in the mesh
        - `first`: the first face number of each mesh
        - `moving_boxes`: the lowest and highest corner of each moving mesh"""
        if self._min_clearance > 0 and not moving_boxes and not np.fmax.reduce(reach, initial=0.0) >= self._min_clearance:
            return np.empty(0, np.int64)  # no face has a rise within the reach
        rows, rungs = np.empty((2, len(reach)), np.int64)
        on = (mesh, face, first, self._face_clearances, self._face_sizes, reach, *self._crease_map.reach_range)
        parts = parallel.run_in_parts(partial(find_candidates_near_slopes, *on, rows, rungs), len(reach), threads)
        rows, rungs = parallel.join_parts(parts, rows, rungs)
        if not len(rows):
            return rows
        is_near = self._crease_map.find_rows_near_creases(
            rows, rungs, reduce(or_, [each for _, _, each in parts]), place, threads
        )
        for low, high in moving_boxes:
            at, wide = place.take(rows, axis=0), reach[rows, None]
            is_near |= ((at >= low - wide) & (at <= high + wide)).all(axis=1)
        return rows[is_near]


@inlined
def _compute_distance_level(reach: F64, width: F64, largest: F64) -> I64:
    """Return the binary exponent of a reach, as `np.frexp` gives it. The reach is first limited to `width` .. `largest`."""
    return ((float_to_bits(min(max(reach, width), largest)) >> 52) & 0x7FF) - _EXPONENT_BIAS


@kernel
def find_candidates_near_slopes(
    mesh: Array1[I32],
    face: Array1[I32],
    first_faces: Array1[I64],
    face_clearances: Array1[F64],
    face_sizes: Array1[F64],
    reach: Array1[F64],
    width: F64,
    largest: F64,
    rows: Array1[I64],
    distance_levels: Array1[I64],
    begin: I64,
    end: I64,
) -> tuple[I64, I64, I64]:
    """Write the rows of agents that may have a rise within `reach`. Agents `begin` to `end` (exclusive) are tested.

    Both result arrays are written from index `begin` on. A level is -1, except for an agent on a face larger than its reach: it
    gets the level of the reach in `CreaseMap`. Returns `begin`, the number of rows, and a bit for each level that occurs."""
    count, rung_bits = begin, 0
    lowest = _compute_distance_level(width, width, largest)
    for i in range(begin, end):
        if mesh[i] < 0 or mesh[i] >= first_faces.size - 1 or face[i] < 0 or not reach[i] > 0:
            continue
        f = first_faces[mesh[i]] + face[i]
        if not face_clearances[f] <= reach[i]:
            continue
        rung = -1
        if face_sizes[f] > reach[i]:
            rung = _compute_distance_level(reach[i], width, largest) - lowest
            rung_bits = rung_bits | (1 << rung)
        rows[count], distance_levels[count] = i, rung
        count += 1
    return begin, count - begin, rung_bits


@kernel
def mark_rows_in_near_cells(
    rows: Array1[I64],
    distance_levels: Array1[I64],
    distance_level: I64,
    place: Strided2[F64],
    low: Array1[F64],
    width: F64,
    is_near_slope: Array3[BOOL],
    begin: I64,
    end: I64,
) -> None:
    """Replace the entries of `distance_levels` that equal `distance_level` by results: -1 for a position in a cell of
    `is_near_slope`, else -2.

    Only the entries `begin` to `end` (exclusive) are changed."""
    for k in range(begin, end):
        if distance_levels[k] != distance_level:
            continue
        i = rows[k]
        x = int(min(max(np.floor((place[i, 0] - low[0]) / width), 0.0), float(is_near_slope.shape[0] - 1)))
        y = int(min(max(np.floor((place[i, 1] - low[1]) / width), 0.0), float(is_near_slope.shape[1] - 1)))
        z = int(min(max(np.floor((place[i, 2] - low[2]) / width), 0.0), float(is_near_slope.shape[2] - 1)))
        distance_levels[k] = -1 if is_near_slope[x, y, z] else -2
