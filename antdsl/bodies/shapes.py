"""Builds small procedural meshes: spheres, stones, and the shapes of items.

`ITEM_SHAPES` has a function for each item shape.
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
    """Return a low ring of loose soil with a dark hole, like the entrance of an ants' nest. It is lower than an ant, so that it
    hides no ants."""
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
    """Return a sugar cube: a grainy block with worn edges."""
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


def _build_globe() -> ColouredMesh:
    """Return a white sphere of radius 1 around the origin."""
    vertices, faces = build_sphere(3)
    return vertices, faces, np.ones((len(vertices), 3), np.float32)


def _build_leaf() -> ColouredMesh:
    """Return a leaf that lies on the ground: pointed, curled, with a midrib and a stalk. It is 2 long."""
    along, across = 28, 13
    u, v = np.meshgrid(np.linspace(0, 1, along), np.linspace(-1, 1, across), indexing="ij")
    half = 0.52 * np.sin(np.pi * u**0.8) ** 0.75 * (1 + 0.05 * np.cos(22 * np.pi * u))
    x, z = 2 * u - 1, v * half
    vein = np.cos(15 * (x - 0.8 * np.abs(z)) * np.pi / 2)
    high = 0.10 + 0.22 * z**2 + 0.10 * np.sin(2.2 * u + 0.3) + 0.012 * vein * (np.abs(v) < 0.95)
    top = np.stack([x, high, z], axis=2).reshape(-1, 3)
    faces = _triangulate_grid(along, across)
    rib = np.exp(-((z / 0.035) ** 2)) + 0.45 * np.clip(vein - 0.75, 0, 1) * 4 * np.exp(-np.abs(z))
    tone = 0.5 + 0.5 * compute_wave_noise(top, 91, 0.9, 2)
    green, pale, brown = np.array([0.28, 0.46, 0.12]), np.array([0.58, 0.66, 0.28]), np.array([0.50, 0.40, 0.16])
    colour = green + (pale - green) * np.clip(rib.reshape(-1), 0, 1)[:, None]
    colour = colour + (brown - colour) * np.clip(1.2 * np.abs(v.reshape(-1)) ** 6 * tone, 0, 0.7)[:, None]
    bottom = top - [0, 0.03, 0]
    stalk_points, stalk_faces = build_sphere(1)
    stalk = stalk_points * [0.18, 0.03, 0.03] + [-1.1, 0.14, 0]
    points, triangles = join_meshes([(top, faces), (bottom, faces[:, ::-1]), (stalk, stalk_faces)])
    shade = np.concatenate([colour, 0.85 * colour + 0.1, np.tile(pale, (len(stalk), 1))])
    return points, triangles, np.clip(shade, 0, 1).astype(np.float32)


def _build_stick() -> ColouredMesh:
    """Return a dry twig with a fork, lying on the ground. It is 2 long."""
    parts, shades = [], []
    for start, end, width in (
        ((-1.0, 0.11, 0.0), (1.0, 0.16, 0.08), 0.11),
        ((0.1, 0.15, 0.03), (0.75, 0.42, -0.45), 0.07),
        ((-0.45, 0.13, 0.02), (-0.2, 0.3, 0.3), 0.05),
    ):
        around, along = 12, 18
        u, turn = np.meshgrid(np.linspace(0, 1, along), np.arange(around + 1) * 2 * np.pi / around, indexing="ij")
        first, last = np.array(start), np.array(end)
        axis = (last - first) / np.sqrt(((last - first) ** 2).sum())
        side = np.cross(axis, [0.0, 1.0, 0.0])
        side /= np.sqrt((side**2).sum())
        reach = width * (1 - 0.45 * u) * np.where((u == 0) | (u == 1), 0.02, 1.0)
        bend = 0.05 * np.sin(np.pi * u)
        ring = np.cos(turn)[..., None] * side + np.sin(turn)[..., None] * np.cross(side, axis)
        points = (first + (last - first) * u[..., None] + bend[..., None] * side + reach[..., None] * ring).reshape(-1, 3)
        points += 0.012 * compute_wave_noise(points * [0.3, 1, 1], 92, 0.12, 2)[:, None] * ring.reshape(-1, 3)
        parts.append((points, _triangulate_grid(along, around + 1)[:, ::-1]))
        tone = 1 + 0.25 * compute_wave_noise(points * [0.3, 1, 1], 93, 0.1, 2)[:, None]
        shades.append(np.array([0.43, 0.33, 0.24]) * tone)
    vertices, triangles = join_meshes(parts)
    return vertices, triangles, np.clip(np.concatenate(shades), 0, 1).astype(np.float32)


def _build_seed() -> ColouredMesh:
    """Return a striped seed, pointed at one end. It is 2 long."""
    vertices, faces = build_sphere(4)
    taper = 1 - 0.45 * np.clip(vertices[:, 0], 0, 1) ** 1.5
    points = vertices * np.array([1.0, 0.36, 0.52]) * np.stack([np.ones(len(taper)), taper, taper], axis=1)
    points[:, 1] += 0.33
    stripe = np.clip(1.6 * np.cos(9 * np.arctan2(vertices[:, 2], vertices[:, 1])) - 0.4, 0, 1)[:, None]
    dark, pale = np.array([0.20, 0.17, 0.15]), np.array([0.80, 0.74, 0.62])
    tone = 1 + 0.08 * compute_wave_noise(vertices, 94, 0.3, 2)[:, None]
    return points, faces, np.clip((dark + (pale - dark) * stripe) * tone, 0, 1).astype(np.float32)


def _build_stone() -> ColouredMesh:
    """Return a grey stone, sunk a little into the ground."""
    points, faces = build_stone(95, (1.0, 0.7, 0.85), detail=3, roughness=0.12)
    points = points - [0, points[:, 1].min() + 0.15, 0]
    tone = 1 + 0.10 * compute_wave_noise(points, 96, 0.5, 3)[:, None]
    return points, faces, np.clip(np.array([0.55, 0.54, 0.52]) * tone, 0, 1).astype(np.float32)


def _build_egg() -> ColouredMesh:
    """Return a pale egg, as ants carry them: an ellipsoid that lies on its side."""
    vertices, faces = build_sphere(3)
    points = vertices * np.array([1.0, 0.55, 0.55]) + [0, 0.5, 0]
    return points, faces, np.tile(np.array([0.93, 0.90, 0.82], np.float32), (len(points), 1))


def _build_lamp() -> ColouredMesh:
    """Return a glowing bulb on a short post."""
    bulb, bulb_faces = build_sphere(3)
    post, post_faces = build_sphere(2)
    parts = [(bulb * 0.92 + [0, 1.75, 0], bulb_faces), (post * [0.15, 0.6, 0.15] + [0, 0.45, 0], post_faces)]
    points, faces = join_meshes([*parts, (post * [0.6, 0.1, 0.6], post_faces)])
    shade = np.concatenate([np.tile([1.0, 0.93, 0.72], (len(bulb), 1)), np.tile([0.20, 0.20, 0.22], (2 * len(post), 1))])
    return points, faces, shade.astype(np.float32)


def _build_flag() -> ColouredMesh:
    """Return a small flag on a post, such as marks a position."""
    post, post_faces = build_sphere(2)
    u, v = np.meshgrid(np.linspace(0, 1, 14), np.linspace(0, 1, 7), indexing="ij")
    wave = 0.10 * u * np.sin(7 * u + 1.5 * v)
    front = np.stack([0.05 + 0.95 * u, 1.3 + 0.6 * v - 0.08 * u, wave], axis=2).reshape(-1, 3)
    faces = _triangulate_grid(14, 7)
    points, triangles = join_meshes(
        [(post * [0.045, 1.0, 0.045] + [0, 0.95, 0], post_faces), (front, faces), (front - [0, 0, 0.01], faces[:, ::-1])]
    )
    stripe = (v.reshape(-1) > 0.5)[:, None]
    cloth = np.where(stripe, [[0.80, 0.16, 0.12]], [[0.93, 0.91, 0.86]])
    shade = np.concatenate([np.tile([0.45, 0.34, 0.24], (len(post), 1)), cloth, cloth])
    return points, triangles, shade.astype(np.float32)


def _triangulate_grid(rows: int, columns: int) -> NDArray[np.int32]:
    """Return the triangles of a grid of points that are listed row by row. They face the direction rows × columns by the
    left-hand rule."""
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (row * columns + column).reshape(-1)
    b, c, d = a + 1, a + columns, a + columns + 1
    return np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)]).astype(np.int32)


ITEM_SHAPES: dict[str, Callable[[], ColouredMesh]] = {
    "apple": _build_apple,
    "ring": _build_ring,
    "crumb": _build_crumb,
    "cube": _build_cube,
    "mound": _build_mound,
    "leaf": _build_leaf,
    "stick": _build_stick,
    "seed": _build_seed,
    "stone": _build_stone,
    "egg": _build_egg,
    "lamp": _build_lamp,
    "flag": _build_flag,
    "sphere": _build_ball,
    "globe": _build_globe,
}


@cache
def build_item_mesh(shape: str) -> ColouredMesh:
    """Return the vertices, faces and display colours (0 to 1) of the item shape called `shape`."""
    arrays = ITEM_SHAPES[shape]()
    for array in arrays:
        array.setflags(write=False)
    return arrays


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
    """Return smooth noise (n,) with an amplitude of about 1 at `points` (n, d). Each octave is a sum of `count` sine waves in
    random directions.

    Each octave has half the wavelength and `fade` times the amplitude of the previous octave."""
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
    """Return an irregular stone around the origin. `radii`: its approximate half axes.

    It is a sphere that is flattened by several planes and then dented by noise."""
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
    """Return a horizontal grid at y = 0 with vertices at all pairs of `x` (a,) and `z` (b,).

    The a · b vertices are ordered by x, then by z. Faces point up."""
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
    """Return one mesh that contains all meshes of `parts`."""
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts[:-1], strict=True)])
    return vertices, faces.astype(np.int32)
