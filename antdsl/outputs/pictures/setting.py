"""All that stands still, as one ray scene: the solids, the cut edge below open ground, and the table under it all."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.body import vertex_normals
from antdsl.casting.picture_rays import PictureRays
from antdsl.outputs.pictures import looks
from antdsl.outputs.pictures.camera import View
from antdsl.outputs.pictures.light import decoded
from antdsl.outputs.pictures.looks import Scales
from antdsl.outputs.pictures.model import Solid
from antdsl.outputs.pictures.pebbles import litter
from antdsl.outputs.pictures.shading_rows import Floats

Array = NDArray[np.float64]


BELOW = 0.03  # how far the table lies below the lowest point, as a share of the extent: room for the cut edge of a floor
_STANDS = 0.001  # the same where there is no floor: things stand on the table


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A mesh of one `kind` (its place in KINDS), `painted` (n, 4) where it has colours of its own."""

    vertices: Array
    faces: NDArray[np.int32]
    kind: int
    painted: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """`rays` over `faces` (m, 3); per vertex a smooth `normal` (n, 3) and `painted` (n, 4: linear colour, whether it holds);
    per face its `kind`. `middle` and `extent` (diagonal) of the solids, `base` the height of the table along `up`."""

    rays: PictureRays
    faces: NDArray[np.int32]
    normal: Floats
    painted: Floats
    kind: NDArray[np.uint8]
    middle: Array
    extent: float
    base: float
    up: Floats
    parts: tuple[Part, ...]


def setting(solids: tuple[Solid, ...], up: Array) -> Setting:
    """The solids made ready for rays; without any there is only the table."""
    parts: list[Part] = []
    everything = np.concatenate([solid.vertices for solid in solids if len(solid.vertices)] or [np.zeros((1, 3))])
    low, high = everything.min(axis=0), everything.max(axis=0)
    extent = float(np.linalg.norm(high - low)) or 1.0
    floors = [solid.kind == "ground" and is_floor(solid.vertices, solid.faces, up) for solid in solids]
    base = float((everything @ up).min()) - (BELOW if any(floors) else _STANDS) * extent
    for solid, floor in zip(solids, floors, strict=True):
        if not len(solid.faces):
            continue
        painted = None
        if solid.colour is not None:
            painted = np.ones((len(solid.vertices), 4), np.float32)
            painted[:, :3] = decoded(np.asarray(solid.colour, np.float32))
            painted[~np.isfinite(painted).all(axis=1)] = 0
        vertices = np.asarray(solid.vertices, np.float64)
        kind = "figure" if solid.kind == "ground" and not floor else solid.kind
        parts.append(Part(vertices, solid.faces, looks.KINDS.index(kind), painted))
        if floor:
            parts += _edges(vertices, solid.faces, up, base)
    middle = (low + high) / 2
    parts.append(_table(middle, up, base, 30 * extent))
    return _assembled(tuple(parts), middle, extent, base, up)


def with_litter(still: Setting, view: View, scales: Scales) -> Setting:
    """The setting with pebbles on its grounds where `view` is near enough to see them, else the same."""
    up = still.up.astype(np.float64)
    made = [litter(part.vertices, part.faces, up, view, scales) for part in still.parts if part.kind == looks.GROUND]
    grains = [Part(points, faces, looks.GRAIN) for points, faces in filter(None, made)]
    return _assembled(still.parts + tuple(grains), still.middle, still.extent, still.base, up) if grains else still


def _assembled(parts: tuple[Part, ...], middle: Array, extent: float, base: float, up: Array) -> Setting:
    counts = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, counts[:-1], strict=True)]).astype(np.int32)
    normal = np.concatenate([vertex_normals(part.vertices, part.faces) for part in parts])
    kind = np.concatenate([np.full(len(part.faces), part.kind, np.uint8) for part in parts])
    painted = np.concatenate(
        [np.zeros((len(part.vertices), 4), np.float32) if part.painted is None else part.painted for part in parts]
    )
    return Setting(PictureRays(vertices, faces), faces, normal, painted, kind, middle, extent, base, up.astype(np.float32), parts)


def is_floor(vertices: Array, faces: NDArray[np.int32], up: Array) -> bool:
    """Whether most of a surface faces up; one that closes on itself, as an animal does, is none."""
    corners = np.asarray(vertices, np.float64)[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float((across @ up).sum()) >= 0.5 * float(np.linalg.norm(across, axis=1).sum())


def _edges(vertices: Array, faces: NDArray[np.int32], up: Array, base: float) -> list[Part]:
    """Walls from the open border of a floor down to the table."""
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
    return [Part(points, walls, looks.EDGE)]


def _table(middle: Array, up: Array, base: float, reach: float) -> Part:
    centre = middle - up * (float(middle @ up) - base)
    first = np.roll(up, 1) - up * float(np.roll(up, 1) @ up)
    first = first / np.linalg.norm(first)
    second = np.cross(up, first)
    points = np.stack([centre + reach * (a * first + b * second) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return Part(points, np.array([[0, 1, 2], [0, 2, 3]], np.int32), looks.TABLE)
