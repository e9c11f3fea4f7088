"""All static surfaces as one ray scene: the solids, the cut edge below open ground, and the table below everything.

Near a close camera, the ground has grains and pebbles, to give a sense of scale. They exist only in pictures, and are sunk into
the ground so far that agents walk over them."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import compute_vertex_normals
from antdsl.bodies.shapes import build_stone, join_meshes
from antdsl.casting.picture_rays import PictureRays
from antdsl.outputs.pictures import surface_materials
from antdsl.outputs.pictures.camera import CameraView
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Solid
from antdsl.outputs.pictures.shading_rows import Floats
from antdsl.outputs.pictures.surface_materials import PictureScales

_PEBBLE_SHAPES = 8
_MAX_PEBBLES = 8_000  # maximum number of pebbles per size class
_MAX_PEBBLES_PER_FACE = 48  # maximum number of pebbles of a size class on one triangle
_PEBBLE_CLASSES = 3  # size classes in a picture; in each, radii are between a power of two and the next one
_MAX_PEBBLE_RADIUS = 0.066  # radius in body lengths
_PEBBLES_PER_SQUARE_RADIUS = 0.009  # mean number of pebbles of a class on an area of one squared radius
_PEBBLE_RANGE_PER_RADIUS = 500  # distance from the camera up to which a pebble is drawn, in its radii
_PEBBLE_HEIGHT_PER_RADIUS = 0.15  # height of a pebble above the ground; feet sink in at most that deep
Array = NDArray[np.float64]


# Depth of the table below the lowest point, as a share of the extent: space for the cut edge of a floor
TABLE_DEPTH_SHARE = 0.03
_TABLE_DEPTH_SHARE_WITHOUT_FLOOR = 0.001  # the same without a floor: things are on the table


@dataclass(frozen=True, slots=True, eq=False)
class SettingPart:
    """A mesh of one `kind` (an index in KIND_NAMES).

    `vertex_colours` (n, 4): the linear colour of each vertex, and its weight. None for a mesh without such colours."""

    vertices: Array
    faces: NDArray[np.int32]
    kind: int
    vertex_colours: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StaticSetting:
    """The ray scene of all static surfaces.

    `rays`: the ray scene with the faces `faces` (m, 3). `normal` (n, 3): smooth normals of vertices. `vertex_colours` (n, 4): the
    linear colour of each vertex, and its weight (0 or 1). `kind` (m,): the kind of each face, an index in KIND_NAMES. `centre`,
    `extent`: centre and diagonal of the solids. `table_height`: the height of the table along `up`."""

    rays: PictureRays
    faces: NDArray[np.int32]
    normal: Floats
    vertex_colours: Floats
    kind: NDArray[np.uint8]
    centre: Array
    extent: float
    table_height: float
    up: Floats
    parts: tuple[SettingPart, ...]


def make_setting(solids: tuple[Solid, ...], up: Array) -> StaticSetting:
    """Return the ray scene of the solids. Without solids, it contains only the table."""
    parts: list[SettingPart] = []
    everything = np.concatenate([solid.vertices for solid in solids if len(solid.vertices)] or [np.zeros((1, 3))])
    low, high = everything.min(axis=0), everything.max(axis=0)
    extent = float(np.linalg.norm(high - low)) or 1.0
    floors = [solid.kind == "ground" and is_floor(solid.vertices, solid.faces, up) for solid in solids]
    base = float((everything @ up).min()) - (TABLE_DEPTH_SHARE if any(floors) else _TABLE_DEPTH_SHARE_WITHOUT_FLOOR) * extent
    for solid, floor in zip(solids, floors, strict=True):
        if not len(solid.faces):
            continue
        painted = None
        if solid.colour is not None:
            painted = np.ones((len(solid.vertices), 4), np.float32)
            painted[:, :3] = decode_srgb(np.asarray(solid.colour, np.float32))
            painted[~np.isfinite(painted).all(axis=1)] = 0
        vertices = np.asarray(solid.vertices, np.float64)
        kind = "figure" if solid.kind == "ground" and not floor else solid.kind
        parts.append(SettingPart(vertices, solid.faces, surface_materials.KIND_NAMES.index(kind), painted))
        if floor:
            parts += _make_edge_walls(vertices, solid.faces, up, base)
    middle = (low + high) / 2
    parts.append(_make_table(middle, up, base, 30 * extent))
    return _assemble_setting(tuple(parts), middle, extent, base, up)


def add_pebbles(setting: StaticSetting, view: CameraView, scales: PictureScales) -> StaticSetting:
    """Return the setting with pebbles on its ground. If `view` is too far away to show them, return the setting unchanged."""
    up = setting.up.astype(np.float64)
    pebbles = [
        scatter_pebbles(part.vertices, part.faces, up, view, scales)
        for part in setting.parts
        if part.kind == surface_materials.GROUND_KIND
    ]
    grains = [SettingPart(points, faces, surface_materials.GRAIN_KIND) for points, faces in filter(None, pebbles)]
    return (
        _assemble_setting(setting.parts + tuple(grains), setting.centre, setting.extent, setting.table_height, up)
        if grains
        else setting
    )


def _assemble_setting(parts: tuple[SettingPart, ...], middle: Array, extent: float, base: float, up: Array) -> StaticSetting:
    """Return the ray scene of the given parts and the table. `base`: the height of the table along `up`."""
    counts = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, counts[:-1], strict=True)]).astype(np.int32)
    normal = np.concatenate([compute_vertex_normals(part.vertices, part.faces) for part in parts])
    kind = np.concatenate([np.full(len(part.faces), part.kind, np.uint8) for part in parts])
    painted = np.concatenate(
        [np.zeros((len(part.vertices), 4), np.float32) if part.vertex_colours is None else part.vertex_colours for part in parts]
    )
    return StaticSetting(
        PictureRays(vertices, faces), faces, normal, painted, kind, middle, extent, base, up.astype(np.float32), parts
    )


def is_floor(vertices: Array, faces: NDArray[np.int32], up: Array) -> bool:
    """Return whether most of a surface faces upwards. A closed surface, such as that of an animal, is not a floor."""
    corners = np.asarray(vertices, np.float64)[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float((across @ up).sum()) >= 0.5 * float(np.linalg.norm(across, axis=1).sum())


def _make_edge_walls(vertices: Array, faces: NDArray[np.int32], up: Array, base: float) -> list[SettingPart]:
    """Return walls that go from the open border of a floor down to the table at height `base`."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    key = np.minimum(pairs[:, 0], pairs[:, 1]) * len(vertices) + np.maximum(pairs[:, 0], pairs[:, 1])
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    border = pairs[first[count == 1]]
    if not len(border):
        return []
    top = vertices[border].reshape(-1, 3)
    foot = top - up * (top @ up - base)[:, None]
    points = np.concatenate([top, foot])
    a = np.arange(0, len(top), 2)
    b, c, d = a + 1, a + len(top), a + len(top) + 1
    walls = np.concatenate([np.stack([b, a, c], axis=1), np.stack([b, c, d], axis=1)]).astype(np.int32)
    return [SettingPart(points, walls, surface_materials.EDGE_KIND)]


def _make_table(middle: Array, up: Array, base: float, reach: float) -> SettingPart:
    """Return the table: a square at height `base` along `up`. `reach`: half the length of its edge."""
    centre = middle - up * (float(middle @ up) - base)
    first = np.roll(up, 1) - up * float(np.roll(up, 1) @ up)
    first = first / np.linalg.norm(first)
    second = np.cross(up, first)
    points = np.stack([centre + reach * (a * first + b * second) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return SettingPart(points, np.array([[0, 1, 2], [0, 2, 3]], np.int32), surface_materials.TABLE_KIND)


@cache
def _make_pebble_shapes(detail: int) -> tuple[Array, NDArray[np.int32]]:
    """Return pebbles of unit size (k, n, 3), and the faces that they have in common."""
    stones = [build_stone(70 + k, (1.0, 0.62, 0.8), detail=detail, roughness=0.2) for k in range(_PEBBLE_SHAPES)]
    return np.stack([vertices for vertices, _ in stones]), stones[0][1]


def scatter_pebbles(
    vertices: Array, faces: NDArray[np.int32], up: Array, view: CameraView, scales: PictureScales
) -> tuple[Array, NDArray[np.int32]] | None:
    """Return the pebbles on the ground near the camera as one mesh. None if no pebble would be larger than a speck.

    The pebbles of a size class on a triangle depend on neither camera nor crowd, so all pictures of a ground show the same ones.
    Pebbles are sunk into the ground, because agents walk as if there were none."""
    corners = vertices[faces]
    away = np.linalg.norm(corners.mean(axis=1) - view.eye, axis=1)
    if not len(faces):
        return None
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1) / 2
    is_level = (across @ up) > 1.1 * area
    normal = across / np.maximum(2 * area, 1e-300)[:, None]
    largest = int(np.floor(np.log2(_MAX_PEBBLE_RADIUS * scales.grain))) - 1
    meshes = []
    for size_class in range(largest, largest - _PEBBLE_CLASSES, -1):
        radius = 2.0**size_class
        if view.compute_pixel_size(np.maximum(away.min(), 1e-9)) > 2 * radius:
            break
        face, chance = _draw_pebbles(np.where(is_level, area, 0.0), away, size_class)
        if not len(face):
            continue
        u, v = chance[:, 0], chance[:, 1]
        over = u + v > 1
        u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
        place = corners[face, 0] * (1 - u - v)[:, None] + corners[face, 1] * u[:, None] + corners[face, 2] * v[:, None]
        detail = 1 if size_class == largest else 0
        meshes.append(_place_pebbles(place, normal[face], radius * 2 ** chance[:, 2], chance, detail))
    return join_meshes(meshes) if meshes else None


def _draw_pebbles(area: Array, camera_distances: Array, size_class: int) -> tuple[NDArray[np.int64], Array]:
    """Return the triangle of each pebble of a size class near the camera, and five random numbers for each pebble.

    `area`: the area of each triangle, 0 if it has no pebbles. `camera_distances`: the distance of each triangle from the
    camera."""
    radius, own = 2.0**size_class, np.arange(len(area))
    patch, rest = _draw_random_numbers(own, np.full(len(area), _MAX_PEBBLES_PER_FACE), size_class)[:, :2].T
    mean = area * (_PEBBLES_PER_SQUARE_RADIUS / radius**2) * (0.35 + 1.3 * patch**2)
    count = np.minimum(mean + rest, _MAX_PEBBLES_PER_FACE).astype(np.int64)
    near = np.flatnonzero((camera_distances < _PEBBLE_RANGE_PER_RADIUS * radius) & (count > 0))
    near = near[np.argsort(camera_distances[near], kind="stable")]
    near = near[: int(np.searchsorted(np.cumsum(count[near]), _MAX_PEBBLES))]
    face = np.repeat(near, count[near])
    rank = np.arange(len(face)) - np.repeat(np.cumsum(count[near]) - count[near], count[near])
    return face, _draw_random_numbers(face, rank, size_class)


def _draw_random_numbers(face: NDArray[np.int64], rank: NDArray[np.int64], size_class: int) -> Array:
    """Return five random numbers from 0 to 1 for each pebble. They depend only on its triangle, its rank there, and its size
    class."""
    own = (face * (_MAX_PEBBLES_PER_FACE + 1) + rank).astype(np.uint64)[:, None]
    key: NDArray[np.uint64] = np.add(own * np.uint64(5), np.arange(5, dtype=np.uint64), dtype=np.uint64)
    key ^= np.uint64((size_class + 1024) << 48)
    # The finaliser of SplitMix64 (Steele et al., Fast Splittable Pseudorandom Number Generators, OOPSLA 2014).
    key = (key ^ np.right_shift(key, np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ np.right_shift(key, np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    key = np.right_shift(key ^ np.right_shift(key, np.uint64(31)), np.uint64(11))
    return np.asarray(key.astype(np.float64) * 2.0**-53)


def _place_pebbles(positions: Array, normal: Array, size: Array, chance: Array, detail: int) -> tuple[Array, NDArray[np.int32]]:
    """Return the mesh of pebbles at `positions`, sunk into the ground along `normal`. `chance`: five random numbers per
    pebble."""
    shapes, faces = _make_pebble_shapes(detail)
    side = np.cross(normal, np.array([0.31, 0.72, 0.62]))
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-12)
    other = np.cross(side, normal)
    turn = chance[:, 3:4] * 2 * np.pi
    first, second = np.cos(turn) * side + np.sin(turn) * other, np.cos(turn) * other - np.sin(turn) * side
    local = shapes[(chance[:, 4] * _PEBBLE_SHAPES).astype(np.int64)]
    local[:, :, 1] += _PEBBLE_HEIGHT_PER_RADIUS - local[:, :, 1].max(axis=1, keepdims=True)
    local *= size[:, None, None]
    points = local[:, :, :1] * first[:, None] + local[:, :, 1:2] * normal[:, None] + local[:, :, 2:] * second[:, None]
    points += positions[:, None]
    triangles = faces[None] + (np.arange(len(positions), dtype=np.int32) * shapes.shape[1])[:, None, None]
    return points.reshape(-1, 3), triangles.reshape(-1, 3).astype(np.int32)
