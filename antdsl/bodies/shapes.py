"""Small meshes made from numbers: spheres, stones, food, a nest mound, marks for agents without a body of their own.

Every shape is `(vertices float64 (n, 3), faces int32 (m, 3))`, y up, counter-clockwise seen from outside."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Mesh = tuple[NDArray[np.float64], NDArray[np.int32]]


@lru_cache(maxsize=8)
def _icosphere(detail: int) -> Mesh:
    import trimesh

    made = trimesh.creation.icosphere(subdivisions=detail, radius=1.0)
    vertices, faces = np.asarray(made.vertices, np.float64), np.asarray(made.faces, np.int32)
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return vertices, faces


def sphere(detail: int = 2) -> Mesh:
    """Unit sphere of 20 · 4^detail triangles around the origin."""
    vertices, faces = _icosphere(detail)
    return vertices.copy(), faces.copy()


def waves(
    points: NDArray[np.float64], seed: int, wavelength: float, octaves: int, *, fade: float = 0.5, count: int = 7
) -> NDArray[np.float64]:
    """Smooth noise of about unit size at `points` (n, d): sines in random directions, an octave half as long, `fade` as high."""
    draw = np.random.Generator(np.random.Philox(seed))
    total = np.zeros(len(points))
    for octave in range(octaves):
        towards = draw.normal(size=(count, points.shape[1]))
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        stretch = draw.uniform(0.75, 1.35, size=count)
        phase = draw.uniform(0.0, 2.0 * np.pi, size=count)
        turns = 2.0 * np.pi * 2.0**octave / wavelength * stretch
        total += fade**octave * np.sin(points @ (towards * turns[:, None]).T + phase).sum(axis=1) / np.sqrt(count / 2.0)
    return total


def stone(seed: int, radii: tuple[float, float, float], *, detail: int = 2, roughness: float = 0.16) -> Mesh:
    """An irregular stone around the origin with about these half axes: a sphere cut flat by planes, then dented by noise."""
    vertices, faces = sphere(detail)
    draw = np.random.Generator(np.random.Philox(seed))
    cuts = draw.normal(size=(9, 3))
    cuts /= np.linalg.norm(cuts, axis=1, keepdims=True)
    depth = draw.uniform(0.72, 0.95, size=9)
    reach = vertices @ cuts.T
    allowed = np.where(reach > 1e-6, depth / np.maximum(reach, 1e-6), 2.0).min(axis=1)
    radius = np.minimum(1.0, allowed) * (1.0 + roughness * 0.5 * waves(vertices, seed + 1, 1.6, 3))
    return vertices * radius[:, None] * np.asarray(radii, np.float64), faces


def sheet(x: NDArray[np.float64], z: NDArray[np.float64]) -> Mesh:
    """Flat grid over the lines `x` (a,) and `z` (b,) at y = 0: a · b vertices, the z index runs fastest, faces look up."""
    a, b = len(x), len(z)
    grid = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)
    vertices = np.stack([grid[:, 0], np.zeros(a * b), grid[:, 1]], axis=1)
    corner = (np.arange(a - 1)[:, None] * b + np.arange(b - 1)[None, :]).reshape(-1)
    # The diagonal turns from cell to cell, so that slopes show no grain.
    even = ((corner // b + corner % b) % 2 == 0)[:, None]
    p, q, r, s = corner, corner + 1, corner + b + 1, corner + b
    first = np.where(even, np.stack([p, q, r], 1), np.stack([p, q, s], 1))
    second = np.where(even, np.stack([p, r, s], 1), np.stack([q, r, s], 1))
    return vertices, np.concatenate([first, second], axis=1).reshape(-1, 3).astype(np.int32)


def joined(parts: list[Mesh]) -> Mesh:
    """One mesh of several."""
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts[:-1], strict=True)])
    return vertices, faces.astype(np.int32)
