"""Colour and grain of static surfaces: soil, rock, the cut edge of the ground, and the table below it.

Soil and stone use solid noise from small tables: smooth values with gradients, and packed grains."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.imaging.surface_noise import (
    PATTERN_ROTATION,
    GrainedSamples,
    add_bumps,
    add_grains,
    compute_value_noise,
    make_grain_table,
    make_noise_table,
)
from antdsl.outputs.pictures.light import SunLight, compute_environment_light, decode_srgb
from antdsl.outputs.pictures.shading_rows import Floats, compute_dot_products, normalise_rows
from antdsl.scene.looks import SURFACE_KINDS

KIND_NAMES = tuple(SURFACE_KINDS)
GROUND_KIND, HILL_KIND, TABLE_KIND, EDGE_KIND, GRAIN_KIND, FIGURE_KIND, METAL_KIND, LEAF_KIND, LIGHT_KIND = (
    KIND_NAMES.index(name) for name in ("ground", "hill", "table", "edge", "grain", "figure", "metal", "leaf", "light")
)
# kinds of surfaces that can show a field's colour
TRAIL_KINDS = tuple(number for number, row in enumerate(SURFACE_KINDS.values()) if row.shows_fields)
_BUMPS = np.array([row.bumps for row in SURFACE_KINDS.values()], np.float32)

SOIL_COLOUR = decode_srgb((0.68, 0.60, 0.48))
_DRY_SOIL_COLOUR = decode_srgb((0.755, 0.70, 0.59))
_MOSS_COLOUR = decode_srgb((0.56, 0.585, 0.42))
_ROCK_COLOUR = decode_srgb((0.50, 0.465, 0.42))
_STONE_COLOURS = decode_srgb(np.array([(0.57, 0.565, 0.56), (0.50, 0.515, 0.54), (0.64, 0.60, 0.55)]))
_BOULDER_COLOUR = decode_srgb((0.60, 0.575, 0.545))
_LICHEN_COLOUR = decode_srgb((0.70, 0.70, 0.58))
_HILL_COLOUR = decode_srgb(SURFACE_KINDS["hill"].colour)
_EARTH_COLOUR = decode_srgb(SURFACE_KINDS["edge"].colour)
_CLAY_COLOUR = decode_srgb((0.78, 0.70, 0.61))
_PALE_CLAY_COLOUR = decode_srgb((0.84, 0.775, 0.69))
_TABLE_COLOUR = decode_srgb(SURFACE_KINDS["table"].colour)
STEEL_COLOUR, LIGHT_COLOUR = (decode_srgb(SURFACE_KINDS[kind].colour) for kind in ("metal", "light"))
_LEAF_COLOUR = decode_srgb((0.33, 0.50, 0.17))
_LEAF_VEIN_COLOUR = decode_srgb((0.52, 0.64, 0.30))
_WOOD_COLOUR, _LATE_WOOD_COLOUR = decode_srgb((0.70, 0.52, 0.33)), decode_srgb((0.47, 0.30, 0.17))
_BARK_COLOUR, _FURROW_COLOUR = decode_srgb((0.47, 0.38, 0.30)), decode_srgb((0.19, 0.14, 0.11))
_SAND_COLOUR = decode_srgb(SURFACE_KINDS["sand"].colour)
_GRASS_COLOUR, _DRY_GRASS_COLOUR = decode_srgb((0.29, 0.42, 0.14)), decode_srgb((0.55, 0.54, 0.26))
_CRUMB_COLOUR, _CRUST_COLOUR = decode_srgb((0.86, 0.70, 0.44)), decode_srgb((0.56, 0.33, 0.16))
_QUARTZ_COLOUR, _BASALT_COLOUR = decode_srgb((0.86, 0.82, 0.74)), decode_srgb((0.40, 0.36, 0.32))
# kinds of surfaces made of grains
_IS_GRAINY = np.array([name in ("ground", "hill", "edge", "sand") for name in KIND_NAMES], np.float32)
LIGHT_BRIGHTNESS = 2.6  # brightness of a light source; several times that of a white surface in the sun


@dataclass(frozen=True, slots=True)
class PictureScales:
    """Reference lengths of a picture, in world units. `extent`: the diagonal of the complete scene. `grain`: about one body
    length."""

    extent: float
    grain: float


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMaterial:
    """The material of n samples of static surfaces: linear `albedo` (n, 3), and the `normal` (n, 3) including grain."""

    albedo: Floats
    normal: Floats


def make_surface_material(
    kind: NDArray[np.uint8],
    points: Floats,
    normal: Floats,
    up: Floats,
    pixel_width: Floats,
    scales: PictureScales,
    vertex_colours: Floats,
) -> SurfaceMaterial:
    """Return the material of n samples.

    `kind` (n,): indices in KIND_NAMES. `points`, `normal` (n, 3): positions and smooth normals. `pixel_width` (n,): the width
    of a pixel at the sample, in world units. `vertex_colours` (n, 4): the colour of the mesh at the sample, and its weight (0
    or 1)."""
    upness = normal @ up
    large, _ = compute_value_noise(points, scales.extent / 9, 1)
    patch, _ = compute_value_noise(points, scales.extent / 34, 2)
    albedo = np.empty_like(points)
    for code in np.unique(kind):
        rows = np.flatnonzero(kind == code)
        albedo[rows] = _COLOUR_FUNCTIONS[int(code)](points[rows], upness[rows], large[rows], patch[rows], up, scales)
    own = np.flatnonzero(vertex_colours[:, 3] > 0)
    albedo[own] += (vertex_colours[own, :3] - albedo[own]) * vertex_colours[own, 3:]
    return _add_grain(albedo, normal, kind, points, pixel_width, scales)


def make_soil_material(
    albedo: Floats, normal: Floats, points: Floats, pixel_width: Floats, scales: PictureScales
) -> SurfaceMaterial:
    """Return the material of loose soil with the colour `albedo` (n, 3), including grain."""
    return _add_grain(albedo, normal, np.full(len(points), HILL_KIND, np.uint8), points, pixel_width, scales)


def _add_grain(
    albedo: Floats, normal: Floats, kind: NDArray[np.uint8], points: Floats, pixel: Floats, scales: PictureScales
) -> SurfaceMaterial:
    """Return the material of a surface with bumps and specks: bumps, and grains of sand on soil, with patches of coarse grains.

    Grain of each size is added only where pixels are small enough to show it."""
    count = len(points)
    points, pixel = np.ascontiguousarray(points, np.float32), np.ascontiguousarray(pixel, np.float32)
    bumpy = GrainedSamples(points, normal, albedo, pixel, _BUMPS[kind])
    for wavelength, height, speck, seed in (
        (2.4, 0.30, 0.10, 5),
        (0.6, 0.34, 0.14, 6),
        (0.14, 0.40, 0.22, 7),
        (0.04, 0.42, 0.34, 8),
        (0.012, 0.42, 0.30, 11),
    ):
        length = np.float32(wavelength * scales.grain)
        add_bumps(bumpy, PATTERN_ROTATION, make_noise_table(seed), length, np.float32(height), np.float32(speck), 0, count)
    loose = bumpy._replace(share=_IS_GRAINY[kind])
    quartz, basalt = tuple(_QUARTZ_COLOUR), tuple(_BASALT_COLOUR)
    for size, share, seed in ((0.11, 0.16, 21), (0.042, 0.42, 22), (0.016, 0.85, 23), (0.006, 1.0, 24)):
        length, tables = np.float32(size * scales.grain), (make_grain_table(seed), make_noise_table(seed + 10))
        add_grains(loose, PATTERN_ROTATION, *tables, length, np.float32(share), quartz, basalt, 0, count)
    return SurfaceMaterial(albedo, normalise_rows(normal))


def _mix_colours(first_colour: Floats, second_colour: Floats, share: Floats) -> Floats:
    """Return a mix of two colours. `share`: the fraction of the second colour."""
    mixed: Floats = first_colour + (second_colour - first_colour) * np.clip(share, 0.0, 1.0)[:, None]
    return mixed


def _colour_ground(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    colour = _mix_colours(SOIL_COLOUR, _DRY_SOIL_COLOUR, 0.5 + 0.9 * noise)
    colour = _mix_colours(colour, _MOSS_COLOUR, (0.55 * patch - 0.75 * noise - 0.12) * 1.6 * np.clip(upness * 4 - 2.6, 0, 1))
    return _mix_colours(colour, _ROCK_COLOUR, (0.86 - upness + 0.10 * patch) * 4.0)


def _colour_stone(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    tone = np.clip(1.0 + 1.2 * noise, 0.0, 2.0)
    first = _mix_colours(_STONE_COLOURS[0], _STONE_COLOURS[1], 1 - tone)
    return _mix_colours(first, _STONE_COLOURS[2], tone - 1) * (1 + 0.12 * patch)[:, None]


def _colour_boulder(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    bands = np.sin((points @ up) * np.float32(2 * np.pi / (scales.extent / 60)) + 3 * patch)
    colour = _BOULDER_COLOUR * (1 + 0.07 * bands + 0.08 * patch)[:, None]
    return _mix_colours(colour, _LICHEN_COLOUR, (patch + 0.5 * noise - 0.35) * 1.8 * np.clip(upness, 0, 1))


def _colour_hill(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    return _HILL_COLOUR * (1 + 0.14 * patch + 0.10 * noise)[:, None]


def _colour_table(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    return np.broadcast_to(_TABLE_COLOUR, points.shape)


def _colour_edge(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    layers = np.sin((points @ up) * np.float32(2 * np.pi / (scales.extent / 70)) + 2.2 * patch + 3 * noise)
    colour: Floats = _EARTH_COLOUR * (1 + 0.16 * layers + 0.10 * patch)[:, None]
    return colour


def _colour_grain(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    tone, _ = compute_value_noise(points, scales.grain * 0.9, 9)
    return _mix_colours(_mix_colours(SOIL_COLOUR, _ROCK_COLOUR, 0.45 - 1.4 * tone), _DRY_SOIL_COLOUR * 1.1, 1.6 * tone)


def _colour_figure(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    return _mix_colours(_CLAY_COLOUR, _PALE_CLAY_COLOUR, 0.5 + 0.5 * noise + 0.25 * patch)


def _colour_metal(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    return 0.30 * STEEL_COLOUR * (1 + 0.08 * patch)[:, None]


def _colour_leaf(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    fine, _ = compute_value_noise(points, scales.extent / 90, 12)
    return _mix_colours(
        _LEAF_COLOUR * (1 + 0.22 * patch + 0.15 * noise)[:, None], _LEAF_VEIN_COLOUR, np.clip(1 - 7 * np.abs(fine), 0, 1) * 0.6
    )


def _colour_light(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    return np.broadcast_to(LIGHT_COLOUR, points.shape)


def _colour_wood(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    """Return the colour of planed wood: annual rings around a long axis, made wavy by noise."""
    axis = PATTERN_ROTATION[0]
    across = points - (points @ axis)[:, None] * axis
    rings = np.linalg.norm(across, axis=1) / np.float32(scales.grain * 0.35) + 1.4 * noise + 0.5 * patch
    share = (rings % 1.0) ** 2
    fine, _ = compute_value_noise(points, scales.grain * 0.25, 13)
    return _mix_colours(_WOOD_COLOUR * (1 + 0.10 * patch + 0.06 * fine)[:, None], _LATE_WOOD_COLOUR, 0.75 * share)


def _colour_bark(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    """Return the colour of bark: dark furrows between plates, with lichen in patches."""
    ridge, _ = compute_value_noise(points * (1 - 0.75 * up), scales.grain * 1.1, 14)
    fine, _ = compute_value_noise(points * (1 - 0.6 * up), scales.grain * 0.35, 15)
    plate = _mix_colours(_FURROW_COLOUR, _BARK_COLOUR, 1.3 * np.sqrt(np.abs(ridge + 0.3 * fine)))
    return _mix_colours(plate * (1 + 0.15 * noise)[:, None], _LICHEN_COLOUR, (patch + 0.4 * noise - 0.5) * 0.9)


def _colour_sand(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    return _SAND_COLOUR * (1 + 0.08 * patch + 0.07 * noise)[:, None]


def _colour_grass(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    blades, _ = compute_value_noise(points * (1 - 0.8 * up), scales.grain * 0.3, 16)
    green = _mix_colours(_GRASS_COLOUR, _DRY_GRASS_COLOUR, 0.45 + 0.6 * patch + 0.5 * noise)
    bare = _mix_colours(green * (1 + 0.35 * blades)[:, None], SOIL_COLOUR, 1.5 * (0.7 * patch - noise - 0.6))
    return _mix_colours(bare, _ROCK_COLOUR, (0.7 - upness) * 3.0)


def _colour_food(points: Floats, upness: Floats, noise: Floats, patch: Floats, up: Floats, scales: PictureScales) -> Floats:
    pores, _ = compute_value_noise(points, scales.grain * 0.4, 17)
    return _mix_colours(_CRUMB_COLOUR * (1 + 0.10 * patch)[:, None], _CRUST_COLOUR, 0.5 * noise + 0.6 * np.clip(pores, 0, 1))


_COLOUR_FUNCTION_BY_KIND = {
    "ground": _colour_ground,
    "stone": _colour_stone,
    "boulder": _colour_boulder,
    "hill": _colour_hill,
    "table": _colour_table,
    "edge": _colour_edge,
    "grain": _colour_grain,
    "figure": _colour_figure,
    "metal": _colour_metal,
    "leaf": _colour_leaf,
    "light": _colour_light,
    "wood": _colour_wood,
    "bark": _colour_bark,
    "sand": _colour_sand,
    "grass": _colour_grass,
    "food": _colour_food,
}
_COLOUR_FUNCTIONS = tuple(_COLOUR_FUNCTION_BY_KIND[name] for name in KIND_NAMES)


def compute_glow(kind: NDArray[np.uint8], look: SurfaceMaterial, direction: Floats, sun: SunLight) -> Floats:
    """Return the light (n, 3) that samples send along rays in addition to scattered light. `direction`: the rays from the camera.

    It consists of reflections from metal and leaves, and of emission."""
    light = np.zeros((len(kind), 3), np.float32)
    for code, colour, least in ((METAL_KIND, STEEL_COLOUR, 0.75), (LEAF_KIND, np.ones(3, np.float32), 0.04)):
        rows = np.flatnonzero(kind == code)
        if len(rows):
            normal, ray = look.normal[rows], direction[rows]
            light[rows] = compute_reflection(normal, ray, sun) * compute_reflected_share(normal, ray, least)[:, None] * colour
    light[kind == LIGHT_KIND] = LIGHT_COLOUR * LIGHT_BRIGHTNESS
    return light


def compute_reflection(normal: Floats, direction: Floats, sun: SunLight) -> Floats:
    """Return the reflections (n, 3) of sky and ground on surfaces with `normal` (n, 3), for rays with `direction` (n, 3)."""
    back = np.clip(-compute_dot_products(normal, direction), 0, 1)
    return compute_environment_light(direction + normal * (2 * back)[:, None], sun)


def compute_reflected_share(normal: Floats, direction: Floats, min_share: float) -> Floats:
    """Return the fraction (n,) of light that is reflected: `min_share` for perpendicular rays, up to 1 at a grazing angle.

    Source: Schlick, Computer Graphics Forum 13(3), 1994."""
    return np.asarray(
        min_share + (1 - min_share) * (1 - np.clip(-compute_dot_products(normal, direction), 0, 1)) ** 5, np.float32
    )
