"""Open and non-manifold surfaces that are worse than what comes out of modelling programs, millimetres, for bodies of 4 mm; and
an account, apart from the walk's own tables, of which sides of which faces lead to which."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from meshes import Mesh, grid
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Index = NDArray[np.int64]


def joined(parts: list[Mesh]) -> Mesh:
    shift = np.cumsum([0, *(len(v) for v, _ in parts)])
    faces = [np.asarray(f) + s for (_, f), s in zip(parts, shift, strict=False)]
    return np.concatenate([v for v, _ in parts]), np.concatenate(faces).astype(np.int32)


def turned(mesh: Mesh, axis: tuple[float, float, float], angle: float, by: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    """About an axis by an angle in degrees, and moved."""
    k, t = np.array(axis, float) / np.linalg.norm(axis), np.radians(angle)
    v = mesh[0]
    spun = v * np.cos(t) + np.cross(k, v) * np.sin(t) + np.outer(v @ k, k) * (1 - np.cos(t))
    return spun + np.array(by, float), mesh[1]


def sheet(size: float, cells: int, **how: tuple[float, float, float]) -> Mesh:
    return turned(grid(size, cells), (0, 1, 0), 0.0, **how)


def triangle_strip(points: Floats, across: Floats) -> Mesh:
    """Two rows of points, `across` apart, and the triangles between them."""
    k = np.arange(len(points) - 1)
    n = len(points)
    faces = np.concatenate([np.stack([k, k + 1, n + k], axis=1), np.stack([k + 1, n + k + 1, n + k], axis=1)])
    return np.concatenate([points, points + across]), faces.astype(np.int32)


def tees() -> Mesh:
    """Walls that stand on a floor, hang a little above it, or go a little into it, at vertices that the floor has not."""
    walls = [
        turned(grid(18.0, cells), (0, 0, 1), 90.0, (x, 9.0 + high, z))
        for x, z, high, cells in ((-12, 0, 0.0, 5), (-3, 2, 0.02, 3), (4, -3, -0.3, 7), (11, 0, -9.0, 4), (15.01, 1, 0.3, 2))
    ]
    beside = [sheet(10.0, 3, by=(25.0, 0.0, 3.1)), sheet(10.0, 5, by=(-25.05, 0.4, 0)), sheet(10.0, 2, by=(1.7, -1.1, 25.03))]
    return joined([grid(40.0, 8), *walls, *beside])


def bows() -> Mesh:
    """Triangles that touch at vertices only, point to point, around points on a line."""
    rng, parts = np.random.default_rng(1), []
    for at in np.linspace(-12, 12, 7):
        for angle in np.arange(9) * 40.0 + rng.uniform(0, 9, 9):
            lean, wide = rng.uniform(-25, 25), rng.uniform(4, 16)
            tip = np.array([[0.0, 0, 0], [7, 0, -7 * np.tan(np.radians(wide))], [7, 0, 7 * np.tan(np.radians(wide))]])
            leaf = turned((tip, np.array([[0, 1, 2]])), (0, 0, 1), lean)
            parts.append(turned(leaf, (0, 1, 0), angle, (at * 1.2, 0.3 * at, 0)))
    return joined(parts)


def layers() -> Mesh:
    """Sheets that nearly lie in each other, shifted, tilted or both."""
    gaps = (0.0, 0.001, 0.01, 0.03, 0.1, 0.4, 1.5)
    return joined(
        [
            turned(grid(20.0, 3 + k), (1, 0, 0.3 * k), 0.02 * k, (0.9 * k, sum(gaps[: k + 1]), -0.7 * k * (-1) ** k))
            for k in range(len(gaps))
        ]
    )


def slivers() -> Mesh:
    """Bands of triangles a thousandth to a third of a millimetre wide between large ones, folded back, crossing themselves."""
    rng, parts = np.random.default_rng(3), []
    for n in range(9):
        at, rows = np.zeros(3), []
        for k in range(14):
            direction = rng.normal(size=3)
            at = at + direction / np.linalg.norm(direction) * (
                rng.choice([0.001, 0.03, 0.16, 0.3]) if k % 3 else rng.uniform(2, 5)
            )
            rows.append(at)
        across = rng.normal(size=3)
        across *= rng.choice([0.15, 4.0]) / np.linalg.norm(across)
        vertices, faces = triangle_strip(np.array(rows), across)
        vertices[len(rows) :] += rng.normal(0, 0.2, (len(rows), 3))
        parts.append((vertices + np.array([5.0 * (n % 3), 3.0 * (n // 3), 0.0]), faces))
    return joined(parts)


def book() -> Mesh:
    """Pages of welded spines, three to seven of each, cut into other numbers of triangles than their neighbours further out."""
    parts = []
    for n, pages in enumerate((3, 4, 5, 7)):
        for k in range(pages):
            angle = 360.0 * k / pages + 13 * (k % 2)
            page, outer = (
                triangle_strip(
                    np.stack([np.linspace(-9, 9, cuts), np.zeros(cuts), np.full(cuts, at)], axis=1), np.array([0.0, 0, wide])
                )
                for cuts, at, wide in ((4, 0.0, 5.0), (6 + k, 5.0, 4.0))
            )
            parts.append(turned(joined([page, outer]), (1, 0, 0), angle, (0, 0, 21.0 * n)))
    return joined(parts)


def soup(n: int = 160, size: float = 22.0) -> Mesh:
    """Triangles anywhere, through each other."""
    rng = np.random.default_rng(5)
    corners = rng.uniform(-size / 2, size / 2, (n, 1, 3)) + rng.normal(size=(n, 3, 3)) * rng.uniform(0.3, 4, (n, 1, 1))
    return corners.reshape(-1, 3), np.arange(3 * n, dtype=np.int32).reshape(-1, 3)


def ribbon() -> Mesh:
    """Six triangles of a ribbon that is folded back upon itself at a twisted sliver, so that its ends cross."""
    points = [[-8, 2, 0], [0, 5.5, 0.3], [0.7, 2.2, 1.3], [-1.7, 4.9, -1.3], [0.4, 1.5, 0], [-1.7, 4.74, -1.3]]
    points += [[0.4, 1.66, 0], [-1.2, 1.66, 0.5]]
    faces = [[2, 1, 3], [2, 3, 4], [3, 5, 4], [4, 5, 6], [7, 6, 5], [0, 7, 5]]
    return np.array(points, float), np.array(faces, np.int32)


WORSE: dict[str, Callable[[], Mesh]] = {
    "tees": tees,
    "bows": bows,
    "layers": layers,
    "slivers": slivers,
    "book": book,
    "soup": soup,
    "ribbon": ribbon,
}


@dataclass(frozen=True)
class Connectivity:
    """Of each side (0 that of the normal) of each face the number (2, m) of all that edges lead to from there; the number of what
    hangs together by edges (m); and which of these have a border."""

    side_component: Index
    part: Index
    open: NDArray[np.bool_]


def find_connectivity(mesh: Mesh) -> Connectivity:
    """By union-find over the two sides of each face: around each edge the faces stand in an order, and each leads to the next on
    the side that looks at it. Vertices nearer than a millionth of the size are one; of faces on one three the first counts."""
    vertices, faces = mesh
    m, weld = len(faces), _welded(vertices)[faces]
    parent = np.arange(3 * m)

    def find(a: int) -> int:
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        return int(a)

    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    known_keys = set()
    for f, (a, b, c) in enumerate(weld.tolist()):
        key = tuple(sorted((a, b, c)))
        size = np.linalg.norm(np.cross(*(vertices[faces[f, 1:]] - vertices[faces[f, 0]])))
        long = max(np.linalg.norm(vertices[faces[f, k]] - vertices[faces[f, k - 1]]) for k in range(3))
        if len(set(key)) < 3 or key in known_keys or size <= 1e-7 * long * long:
            continue
        known_keys.add(key)
        for k, (one, two) in enumerate(((b, c), (c, a), (a, b))):
            edges.setdefault((min(one, two), max(one, two)), []).append((f, k))
    border = np.zeros(m, bool)
    for around in edges.values():
        border[around[0][0]] |= len(around) == 1
        if len(around) > 1:
            for one, two in _pairs(vertices, faces, weld, around):
                parent[find(one)] = find(two)
                parent[find(2 * m + one % m)] = find(2 * m + two % m)
    root = np.array([find(a) for a in range(3 * m)])
    part = root[2 * m :]
    return Connectivity(root[: 2 * m].reshape(2, m), part, np.isin(part, part[border]))


def _welded(vertices: Floats) -> Index:
    """Numbers of vertices, those of one place being one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    near = cKDTree(vertices).query_pairs(1e-6 * np.ptp(vertices, axis=0).max(), output_type="ndarray")
    n = len(vertices)
    return connected_components(coo_array((np.ones(len(near)), near.T), (n, n)), directed=False)[1].astype(np.int64)


def _pairs(vertices: Floats, faces: Index, weld: Index, around: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Which sides (face, plus m for the back) look at each other around an edge."""
    m = len(faces)
    f, k = around[0]
    start, end = vertices[faces[f, (k + 1) % 3]], vertices[faces[f, (k + 2) % 3]]
    first = weld[f, (k + 1) % 3]
    axis = (end - start) / np.linalg.norm(end - start)
    angles, fronts = [], []
    x = y = None
    for g, j in around:
        p, q, apex = (vertices[faces[g, (j + s) % 3]] for s in (1, 2, 0))
        if weld[g, (j + 1) % 3] != first:
            p, q = q, p
        inward = apex - p - ((apex - p) @ axis) * axis
        if x is None:
            x = inward / np.linalg.norm(inward)
            y = np.cross(axis, x)
        angles.append(round(float(np.arctan2(inward @ y, inward @ x)), 9))
        normal = np.cross(vertices[faces[g, 1]] - vertices[faces[g, 0]], vertices[faces[g, 2]] - vertices[faces[g, 0]])
        fronts.append(normal @ np.cross(axis, inward) > 0)  # whether the front looks the way that angles grow
    order = sorted(range(len(around)), key=lambda n: (angles[n], 3 * around[n][0] + around[n][1]))
    pairs = []
    for n, one in enumerate(order):
        two = order[(n + 1) % len(order)]
        pairs.append((around[one][0] + (0 if fronts[one] else m), around[two][0] + (m if fronts[two] else 0)))
    return pairs
