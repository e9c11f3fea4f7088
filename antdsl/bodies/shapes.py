"""Small meshes computed from numbers: spheres, stones, and the shapes of items.

The items are an apple, a ring (a donut), a crumb of bread, a lump of sugar, a nest mound, and a plain ball.
"""

from collections.abc import Callable
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

MeshArrays = tuple[NDArray[np.float64], NDArray[np.int32]]


ColouredMesh = tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float32]]  # vertices, faces, display colour per vertex


def _build_apple() -> ColouredMesh:
    """Return a red and golden apple with a stem."""
    vertices, faces = build_sphere(4)
    flat = np.hypot(vertices[:, 0], vertices[:, 2])
    turn = np.arctan2(vertices[:, 2], vertices[:, 0])
    high = vertices[:, 1]
    top = np.exp(-((flat / 0.32) ** 2)) * np.where(high > 0, 0.42, 0.22) * np.sign(high)
    shoulder = 1 + 0.05 * np.cos(5 * turn) * (1 - high) / 2
    body = np.stack([vertices[:, 0] * shoulder, high * 0.9 - top, vertices[:, 2] * shoulder], axis=1)
    blush = np.clip(0.5 + 0.55 * compute_wave_noise(vertices, 41, 1.5, 2), 0, 1)[:, None]
    streak = np.clip(0.5 + 0.5 * np.sin(17 * turn + 4 * compute_wave_noise(vertices, 42, 1.2, 1)), 0, 1)[:, None] * 0.25
    red, gold = np.array([0.74, 0.11, 0.10]), np.array([0.90, 0.68, 0.22])
    near_top = np.exp(-(((flat - 0.05) / 0.34) ** 2))[:, None] * (high > 0)[:, None]
    colour = red + (gold - red) * np.clip(0.55 * (1 - blush) + streak * 0.5 + 0.8 * near_top, 0, 1)
    stem_points, stem_faces = build_sphere(1)
    bend = 0.10 * (stem_points[:, 1] + 1) ** 2
    stem = np.stack([stem_points[:, 0] * 0.045 + bend * 0.5, 0.72 + 0.22 * stem_points[:, 1], stem_points[:, 2] * 0.045], axis=1)
    points, triangles = join_meshes([(body, faces), (stem, stem_faces)])
    shade = np.concatenate([colour, np.full((len(stem), 3), (0.33, 0.22, 0.13))])
    points[:, 1] += 0.78
    return points, triangles, shade.astype(np.float32)


def _build_ring() -> ColouredMesh:
    """Return a glazed ring: outer radius 1, tube radius 0.38, icing on the upper half with a wavy border, and sprinkles."""
    around, across = 48, 20
    u = np.arange(around) * 2 * np.pi / around
    v = np.arange(across) * 2 * np.pi / across
    big, small = np.meshgrid(u, v, indexing="ij")
    radius = 0.62 + 0.38 * np.cos(small)
    points = np.stack([radius * np.cos(big), 0.36 * np.sin(small), radius * np.sin(big)], axis=2).reshape(-1, 3)
    border = 0.02 + 0.10 * np.sin(7 * big) * 0.5 + 0.05 * np.sin(11 * big + 1)
    iced = (points[:, 1] > border.reshape(-1)).astype(np.float64)[:, None]
    points *= 1 + 0.035 * iced
    row, column = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a = (row * across + column).reshape(-1)
    b = (row * across + (column + 1) % across).reshape(-1)
    c, d = (a + across) % (around * across), (b + across) % (around * across)
    faces = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)]).astype(np.int32)
    dough, icing = np.array([0.80, 0.56, 0.30]), np.array([0.93, 0.52, 0.64])
    parts: list[MeshArrays] = [(points, faces)]
    shades = [dough + (icing - dough) * iced]
    draw = np.random.Generator(np.random.Philox(51))
    hues = np.array([(0.98, 0.96, 0.92), (0.97, 0.83, 0.25), (0.36, 0.68, 0.86), (0.45, 0.76, 0.42), (0.85, 0.26, 0.24)])
    for k in range(34):
        turn, side, own = draw.uniform(0, 2 * np.pi), draw.uniform(0.35, np.pi - 0.35), draw.uniform(0, np.pi)
        grain, triangles = build_sphere(0)
        grain = grain * np.array([0.075, 0.022, 0.022])
        grain = np.stack(
            [
                grain[:, 0] * np.cos(own) - grain[:, 2] * np.sin(own),
                grain[:, 1],
                grain[:, 0] * np.sin(own) + grain[:, 2] * np.cos(own),
            ],
            1,
        )
        reach = 0.62 + 0.40 * np.cos(side)
        parts.append((grain + np.array([reach * np.cos(turn), 0.385 * np.sin(side), reach * np.sin(turn)]), triangles))
        shades.append(np.tile(hues[k % len(hues)], (len(grain), 1)))
    vertices, triangles = join_meshes(parts)
    vertices[:, 1] += 0.30
    return vertices, triangles, np.concatenate(shades).astype(np.float32)


def _build_mound() -> ColouredMesh:
    """Return a low ring of loose soil with a dark hole, as ants pile it up around a nest entrance. It is lower than an ant, so
    that it hides no ant."""
    rings, around = 22, 40
    reach = np.linspace(0, 1.25, rings)
    turn = np.arange(around) * 2 * np.pi / around
    r, t = np.meshgrid(reach, turn, indexing="ij")
    crest = 0.52
    outside = 0.07 * np.exp(-(((r - crest) / 0.34) ** 2))
    inside = 0.07 * np.exp(-(((r - crest) / 0.22) ** 2)) - 0.07 * np.exp(-((r / 0.20) ** 2))
    high = np.where(r > crest, outside, np.maximum(inside, 0.012))  # the ground continues below, so a hole is not visible
    points = np.stack([r * np.cos(t), high, r * np.sin(t)], axis=2).reshape(-1, 3)
    soft = np.clip(r.reshape(-1) / 0.25, 0, 1)
    points[:, 1] += 0.012 * compute_wave_noise(points * np.array([1, 0, 1]), 61, 0.35, 2) * soft
    points[:, 1] -= np.clip(r.reshape(-1) - 0.9, 0, None) * 0.35
    row, column = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    a, b = (row * around + column).reshape(-1), (row * around + (column + 1) % around).reshape(-1)
    faces = np.concatenate([np.stack([a, b, b + around], 1), np.stack([a, b + around, a + around], 1)]).astype(np.int32)
    depth = np.clip((r.reshape(-1) - 0.10) / 0.22, 0.0, 1.0)[:, None]
    soil, dark = np.array([0.60, 0.46, 0.33]), np.array([0.07, 0.05, 0.04])
    tone = 1 + 0.10 * compute_wave_noise(points, 62, 0.22, 2)[:, None]
    return points, faces, np.clip((dark + (soil - dark) * depth) * tone, 0, 1).astype(np.float32)


def _build_crumb() -> ColouredMesh:
    """Return a crumb of bread: broken faces, pores, and crust on one side."""
    vertices, faces = build_sphere(5)
    draw = np.random.Generator(np.random.Philox(71))
    directions = draw.normal(size=(13, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # The shape is cut by planes with worn edges.
    cut = (vertices @ directions.T) / draw.uniform(0.66, 0.92, 13)
    size = np.minimum(1.0, 1 / np.maximum((np.maximum(cut, 0) ** 14).sum(axis=1) ** (1 / 14), 1e-9))
    rough = compute_wave_noise(vertices, 72, 0.75, 3)
    pore = np.clip(compute_wave_noise(vertices, 73, 0.34, 1) - 0.25, 0, 1) + 0.6 * np.clip(
        compute_wave_noise(vertices, 74, 0.17, 1) - 0.3, 0, 1
    )
    points = vertices * (size * (1 + 0.03 * rough - 0.075 * pore))[:, None]
    points *= 1.06 / np.hypot(points[:, 0], points[:, 2]).max()
    points[:, 1] -= points[:, 1].min() + 0.06
    crust = np.clip(4 * (vertices @ directions[0] - 0.45) + 0.5 * rough, 0, 1)[:, None]
    white, brown, dark = np.array([0.90, 0.76, 0.52]), np.array([0.56, 0.30, 0.12]), np.array([0.66, 0.46, 0.25])
    inside = white + (dark - white) * np.clip(1.6 * pore + 0.15 * rough, 0, 1)[:, None]
    return points, faces, np.clip(inside + (brown - inside) * crust, 0, 1).astype(np.float32)


def _build_cube() -> ColouredMesh:
    """Return a lump of sugar: a grainy block with worn edges."""
    vertices, faces = build_sphere(5)
    norm = (np.abs(vertices) ** 9).sum(axis=1) ** (1 / 9)
    grain = compute_wave_noise(vertices, 81, 0.09, 2)
    points = vertices / norm[:, None] * (1 + 0.018 * grain)[:, None] * np.array([0.78, 0.66, 0.72])
    points[:, 1] -= points[:, 1].min()
    tone = 0.93 + 0.06 * grain
    return points, faces, np.clip(tone[:, None] * np.array([1.0, 0.985, 0.95]), 0, 1).astype(np.float32)


def _build_ball() -> ColouredMesh:
    """Return a plain ball of radius 1 with its lowest point at y = -0.15."""
    vertices, faces = build_sphere(3)
    vertices[:, 1] += 0.85
    return vertices, faces, np.full((len(vertices), 3), (0.86, 0.80, 0.62), np.float32)


ITEM_SHAPES: dict[str, Callable[[], ColouredMesh]] = {
    "apple": _build_apple,
    "ring": _build_ring,
    "crumb": _build_crumb,
    "cube": _build_cube,
    "mound": _build_mound,
    "sphere": _build_ball,
}

# Words in an item's name and the shape that they mean; the first match counts.
_SHAPE_WORDS: tuple[tuple[str, str], ...] = (
    ("apple", "apple"),
    ("fruit", "apple"),
    ("donut", "ring"),
    ("doughnut", "ring"),
    ("ring", "ring"),
    ("sugar", "cube"),
    ("crumb", "crumb"),
    ("bread", "crumb"),
    ("food", "crumb"),  # for any name
    ("nest", "mound"),
    ("home", "mound"),
    ("camp", "mound"),
    ("hill", "mound"),
    ("heap", "mound"),
    ("door", "none"),  # names of positions, not of objects
    ("room", "none"),
)


@cache
def build_item_mesh(shape: str) -> ColouredMesh:
    """Return vertices, faces and display colours (0 to 1) of the named shape."""
    arrays = ITEM_SHAPES[shape]()
    for array in arrays:
        array.setflags(write=False)
    return arrays


def choose_item_shape(kind: str, name: str) -> str:
    """Return the shape that suits items of a `kind` (`food`, `nest`) with this `name` (`apple`)."""
    return next((shape for text in (name, kind) for word, shape in _SHAPE_WORDS if word in text.lower()), "sphere")


@lru_cache(maxsize=8)
def _build_icosphere(detail: int) -> MeshArrays:
    """Return a unit sphere: an icosahedron with each triangle divided into four, `detail` times."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=detail, radius=1.0)
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return vertices, faces


def build_sphere(detail: int = 2) -> MeshArrays:
    """Return the unit sphere around the origin, with 20 · 4^detail triangles."""
    vertices, faces = _build_icosphere(detail)
    return vertices.copy(), faces.copy()


def compute_wave_noise(
    points: NDArray[np.float64], seed: int, wavelength: float, octaves: int, *, fade: float = 0.5, count: int = 7
) -> NDArray[np.float64]:
    """Return smooth noise of about unit size at `points` (n, d): a sum of `count` sines per octave, in random directions. Each
    octave has half the wavelength and `fade` times the height of the previous one."""
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


def build_stone(seed: int, radii: tuple[float, float, float], *, detail: int = 2, roughness: float = 0.16) -> MeshArrays:
    """Return an irregular stone around the origin with approximately these half axes: a sphere cut flat by planes, then dented by
    noise."""
    vertices, faces = build_sphere(detail)
    draw = np.random.Generator(np.random.Philox(seed))
    cuts = draw.normal(size=(9, 3))
    cuts /= np.linalg.norm(cuts, axis=1, keepdims=True)
    depth = draw.uniform(0.72, 0.95, size=9)
    reach = vertices @ cuts.T
    allowed = np.where(reach > 1e-6, depth / np.maximum(reach, 1e-6), 2.0).min(axis=1)
    radius = np.minimum(1.0, allowed) * (1.0 + roughness * 0.5 * compute_wave_noise(vertices, seed + 1, 1.6, 3))
    return vertices * radius[:, None] * np.asarray(radii, np.float64), faces


def build_flat_grid(x: NDArray[np.float64], z: NDArray[np.float64]) -> MeshArrays:
    """Return a flat grid over the lines `x` (a,) and `z` (b,) at y = 0. It has a · b vertices; the z index runs fastest, and
    faces look up."""
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


def join_meshes(parts: list[MeshArrays]) -> MeshArrays:
    """Return one mesh that contains all parts."""
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts[:-1], strict=True)])
    return vertices, faces.astype(np.int32)
