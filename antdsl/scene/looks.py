"""The looks of surfaces: the words for `look` in scenes, and the materials in pictures, USD and glTF, with one row for each
kind.

The module also chooses the shapes of items from words in their names."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class SurfaceLook(NamedTuple):
    """A kind of surface.

    `colour`: the mean colour (sRGB display values, 0 to 1), for files without the pattern that pictures show.
    `roughness`, `metalness`: 0 to 1, as in glTF 2.0.
    `bumps`: the height of the surface grain, relative to that of soil.
    `shows_fields`: whether pictures may show the colour of a pheromone on it.
    `look`: the word in scenes that selects it; None if only pictures select it.
    `words`: parts of mesh names; a mesh with such a name has this look by default."""

    colour: tuple[float, float, float]
    roughness: float
    metalness: float = 0.0
    bumps: float = 0.0
    shows_fields: bool = True
    look: str | None = None
    words: tuple[str, ...] = ()


SURFACE_KINDS: dict[str, SurfaceLook] = {
    "ground": SurfaceLook((0.70, 0.65, 0.53), 0.95, bumps=1.0),
    "stone": SurfaceLook((0.57, 0.56, 0.55), 0.9, bumps=0.8, shows_fields=False, look="stone", words=("stone",)),
    "boulder": SurfaceLook((0.60, 0.575, 0.545), 0.9, bumps=0.9, words=("boulder", "rock")),
    "hill": SurfaceLook((0.55, 0.42, 0.30), 0.95, bumps=1.2, look="soil", words=("hill",)),
    "table": SurfaceLook((0.80, 0.80, 0.79), 0.6, shows_fields=False),
    "edge": SurfaceLook((0.42, 0.33, 0.25), 0.95, bumps=0.9, shows_fields=False),
    "grain": SurfaceLook((0.64, 0.58, 0.49), 0.9, bumps=0.8, shows_fields=False),
    "figure": SurfaceLook((0.80, 0.73, 0.64), 0.8, bumps=0.45),
    "metal": SurfaceLook((0.70, 0.71, 0.73), 0.25, 1.0, bumps=0.05, look="metal"),
    "leaf": SurfaceLook((0.35, 0.51, 0.19), 0.5, bumps=0.25, look="leaf", words=("leaf",)),
    "light": SurfaceLook((1.0, 0.93, 0.78), 1.0, shows_fields=False, look="light"),
    "wood": SurfaceLook((0.65, 0.48, 0.30), 0.6, bumps=0.15, look="wood", words=("plank", "wood")),
    "bark": SurfaceLook((0.40, 0.31, 0.24), 0.95, bumps=1.2, look="bark", words=("bark", "trunk", "twig", "branch")),
    "sand": SurfaceLook((0.80, 0.71, 0.54), 0.95, bumps=0.7, look="sand", words=("sand", "dune")),
    "grass": SurfaceLook((0.44, 0.48, 0.22), 0.8, bumps=1.0, look="grass", words=("grass", "meadow", "lawn")),
    "food": SurfaceLook((0.83, 0.66, 0.41), 0.7, bumps=0.5, look="food"),
}
INVISIBLE_LOOK, LAMP_LOOK_WORD = "none", "light"
LAMP_SHAPE = "globe"  # of things of the kind `lamp`
KIND_BY_LOOK = {row.look: name for name, row in SURFACE_KINDS.items() if row.look is not None}
LOOK_WORDS = (*KIND_BY_LOOK, INVISIBLE_LOOK)


def is_lamp_look(look: str | None) -> bool:
    """Return whether items with the look `look` emit light."""
    return look == LAMP_LOOK_WORD


def compute_remaining_share(amounts: Iterable[tuple[float, float]]) -> float:
    """Return the fraction (0 to 1) of its initial amount that an item still has. It is 1 for an item that had nothing initially.

    `amounts`: the initial and the current amount of each attribute. Only the first attribute with an initial amount is used."""
    return next((min(max(now / first, 0.0), 1.0) for first, now in amounts if first > 0), 1.0)


def compute_drawn_radius(radius: float, remaining_share: float) -> float:
    """Return the radius at which an item is drawn, so that its drawn volume is the fraction `remaining_share` of the full
    volume."""
    return float(radius * min(max(remaining_share, 0.0), 1.0) ** (1 / 3))


def find_kind_by_name(mesh: str) -> str | None:
    """Return the kind of surface that fits the name of a mesh, because the name contains one of the kind's words. If several
    kinds fit, return the first one in the table. Return None if no kind fits."""
    name = mesh.lower()
    return next((kind for kind, row in SURFACE_KINDS.items() if any(word in name for word in row.words)), None)


# Words in an item's name and the shape that they mean; the first match counts.
_SHAPE_WORDS: tuple[tuple[str, str], ...] = (
    ("apple", "apple"),
    ("fruit", "apple"),
    ("donut", "ring"),
    ("doughnut", "ring"),
    ("ring", "ring"),
    ("sugar", "cube"),
    ("leaf", "leaf"),
    ("leaves", "leaf"),
    ("seed", "seed"),
    ("grain", "seed"),
    ("twig", "stick"),
    ("stick", "stick"),
    ("branch", "stick"),
    ("log", "stick"),
    ("stone", "stone"),
    ("rock", "stone"),
    ("pebble", "stone"),
    ("egg", "egg"),
    ("brood", "egg"),
    ("larva", "egg"),
    ("lamp", "lamp"),
    ("bulb", "lamp"),
    ("exit", "flag"),
    ("gate", "flag"),
    ("goal", "flag"),
    ("target", "flag"),
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


def choose_item_shape(kind: str, name: str) -> str:
    """Return the shape that fits items of the kind `kind` (such as `food`) with the name `name` (such as `apple`)."""
    return next((shape for text in (name, kind) for word, shape in _SHAPE_WORDS if word in text.lower()), "sphere")


def choose_drawn_shape(kind: str, name: str, look: str | None) -> str:
    """Return the shape in which an item is drawn, or `none` if it is not drawn. An item with a look but no shape is a sphere."""
    if look == INVISIBLE_LOOK:
        return "none"
    shape = choose_item_shape(kind, name)
    return "sphere" if shape == "none" and look is not None else shape
