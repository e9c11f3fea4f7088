"""Meshes made on the spot for tests: terrain, boxes, balls, plates. Each is (vertices float64[n,3], faces int32[m,3]) in mm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Mesh = tuple[np.ndarray, np.ndarray]


def grid(size: float, cells: int, height: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None) -> Mesh:
    """A square sheet around the origin, y up, its faces seen from above; 2·cells² triangles."""
    line = np.linspace(-size / 2, size / 2, cells + 1)
    x, z = (a.ravel() for a in np.meshgrid(line, line, indexing="ij"))
    y = np.zeros_like(x) if height is None else height(x, z)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
    a = i * (cells + 1) + j
    b, c, d = a + cells + 1, a + cells + 2, a + 1
    faces = np.concatenate([np.stack([a, d, c], axis=1), np.stack([a, c, b], axis=1)])
    return np.stack([x, y, z], axis=1), faces.astype(np.int32)


def hills(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    return 14 * np.sin(x / 37) * np.cos(z / 29) + 6 * np.sin((x + 2 * z) / 61)


def terrain(size: float = 400.0, cells: int = 60) -> Mesh:
    return grid(size, cells, hills)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    """A closed box, its faces seen from outside."""
    vertices = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])], np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)


def ball(radius: float, at: tuple[float, float, float] = (0, 0, 0), rings: int = 16) -> Mesh:
    """A closed ball of rings and sectors, its faces seen from outside."""
    sectors = 2 * rings
    up = np.pi * np.arange(1, rings) / rings
    around = 2 * np.pi * np.arange(sectors) / sectors
    body = np.stack(
        [np.outer(np.sin(up), np.cos(around)), np.outer(np.cos(up), np.ones(sectors)), np.outer(np.sin(up), np.sin(around))],
        axis=2,
    )
    vertices = np.concatenate([[[0, 1, 0]], body.reshape(-1, 3), [[0, -1, 0]]]) * radius + np.array(at)
    faces = []
    last = len(vertices) - 1
    for s in range(sectors):
        t = (s + 1) % sectors
        faces.append((0, 1 + t, 1 + s))
        faces.append((last, last - sectors + s, last - sectors + t))
        for r in range(rings - 2):
            a, b = 1 + r * sectors, 1 + (r + 1) * sectors
            faces += [(a + s, a + t, b + t), (a + s, b + t, b + s)]
    return vertices, np.array(faces, np.int32)


def outward(mesh: Mesh) -> bool:
    """Whether the faces of a closed mesh are seen from outside."""
    v = mesh[0][mesh[1]]
    return float((np.cross(v[:, 0], v[:, 1]) * v[:, 2]).sum()) > 0
