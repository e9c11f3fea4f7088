"""Vertices that lie nearer to each other than a tolerance are moved to one place; and what keeps a solid open, measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.scene.geometry.closed import odd_edges
from antdsl.scene.geometry.live_faces import components
from antdsl.scene.geometry.matrices import different

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Faces = NDArray[np.int32]

_PAIRS, _NEIGHBOURS = 1 << 21, 32  # pairs of near places that are listed at most, and for each place on average
_FLAT = 1e-9  # of the extent: bodies that are less thick have no volume
_TRIES = 4  # tolerances that are tried to close gaps, each twice as large


class WeldError(Exception):
    """Why vertices are not welded, in words that fit after the tolerance."""


def welded(vertices: Floats, tolerance: float) -> tuple[Floats, int]:
    """Vertices (n, 3) of which those nearer to each other than `tolerance`, or joined by others between them, lie where the
    first of them does; and how many were moved. Their numbers stay as they are.

    WeldError where so many lie so near that a list of the pairs would take more memory than the mesh by far."""
    from scipy.spatial import KDTree

    order, new, which = different(vertices)
    points = vertices[order[new]]
    tree = KDTree(points)
    if int(tree.count_neighbors(tree, tolerance)) - len(points) > 2 * max(_PAIRS, _NEIGHBOURS * len(points)):
        raise WeldError("is farther than from each vertex to dozens of others")
    pairs = tree.query_pairs(tolerance, output_type="ndarray")
    if not len(pairs):
        return vertices, 0
    number = components(pairs, len(points))[which]
    first = np.full(int(number.max()) + 1, len(vertices))
    np.minimum.at(first, number, np.arange(len(vertices)))  # the first in the file, whatever the library's numbers
    made = vertices[first[number]]
    return made, int((made != vertices).any(axis=1).sum())


def edge_lengths(vertices: Floats, faces: Faces) -> Floats:
    """Lengths (m, 3) of the edges of faces."""
    corners = vertices[faces]
    edges = corners - np.roll(corners, -1, axis=1)
    return np.asarray(np.sqrt((edges * edges).sum(axis=2)))


def has_three_places(vertices: Floats, faces: Faces) -> NDArray[np.bool_]:
    """Which faces have their three corners at three places."""
    return np.asarray((edge_lengths(vertices, faces) > 0).all(axis=1))


def is_flat(vertices: Floats, faces: Faces) -> bool:
    """Whether all faces lie in one plane, that of the largest of them: a body of them has no volume."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.sqrt((across * across).sum(axis=1))
    largest = int(size.argmax())
    if not size[largest]:
        return True
    away = ((corners - corners[largest, 0]) * (across[largest] / size[largest])).sum(axis=2)
    return bool(np.abs(away).max() <= _FLAT * np.ptp(corners.reshape(-1, 3), axis=0).max())


@dataclass(frozen=True, slots=True)
class Openings:
    """What keeps a mesh from being closed. `gap`: a tolerance, one digit of mm, at which welding closes it, and `width` the
    widest gap that it closes; else 0. `holes`: pieces of border; the largest has `edges` of at most `longest` mm."""

    gap: float
    width: float
    holes: int
    edges: int
    longest: float


def openings(vertices: Floats, faces: Faces, grain: float) -> Openings:
    """Measure what is open. `grain`: places nearer than this are one."""
    from scipy.spatial import KDTree

    edges, places = odd_edges(vertices, faces, grain)
    ends = places[edges]
    lengths = np.sqrt(((ends[:, 0] - ends[:, 1]) ** 2).sum(axis=1))
    rim = np.unique(edges)
    near = KDTree(places[rim]).query(places[rim], k=min(2, len(rim)))[0]
    near = near[:, -1] if near.ndim == 2 else near
    most = float(np.median(edge_lengths(vertices, faces))) / 4
    narrow = near[near < most]
    gap = width = float(narrow.max()) if len(narrow) else 0.0
    for _ in range(_TRIES if gap else 0):
        gap = one_digit_up(gap)
        if gap > most:
            break
        try:
            moved = welded(vertices, gap)[0]
        except WeldError:
            break
        if has_three_places(moved, faces).any() and not is_flat(moved, faces) and not len(odd_edges(moved, faces, grain)[0]):
            return Openings(gap, width, 0, 0, 0.0)
        gap *= 2
    _, piece, count = np.unique(components(edges, len(places))[edges[:, 0]], return_inverse=True, return_counts=True)
    largest = int(count.argmax())
    return Openings(0.0, 0.0, len(count), int(count[largest]), float(lengths[piece == largest].max()))


def one_digit_down(x: float) -> float:
    """The number of one digit before x, or x itself: 0.17 gives 0.1."""
    digits, _, power = f"{x:.15e}".partition("e")
    return float(f"{digits[0]}e{power}")


def one_digit_up(x: float) -> float:
    """The next number of one digit beyond x: 0.17 gives 0.2, and 0.2 gives 0.3."""
    digits, _, power = f"{x:.15e}".partition("e")
    return float(f"{int(digits[0]) + 1}e{power}")
