"""What a line of a scene's crowd may say: who, how many, where they begin, and a way that they are led."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag

from antdsl import limits
from antdsl.program.tables.vocabulary import LENGTH
from antdsl.scene.library_bodies import BODY_WORDS
from antdsl.scene.quantities import Quantity
from antdsl.scene.values import (
    FilePath,
    Name,
    Part,
    PointOrName,
    PositiveLength,
    PositiveSpeed,
    Word,
    number,
    one_of,
    positive,
    whole,
    word_or,
    word_or_file,
)

NONE = "none"  # of the layers of a part, the one that is none
# Of the library of bodies.
Body = Annotated[str, BeforeValidator(word_or_file(*BODY_WORDS))]
Apart = Annotated[Quantity | str, BeforeValidator(word_or("even", positive(LENGTH)))]
Along = Annotated[float, BeforeValidator(number(-1e6, 1e6))]
By = Annotated[str, BeforeValidator(one_of("above", "area"))]


class UsdPlaces(Part):
    """Places of a USD file: the points or empties below a prim, or all empties of a kind, by itself the species' name."""

    usd: FilePath
    prim: Word | None = None
    kind: Word | None = None


def _file_or_usd(value: Any) -> str:
    return "usd-places" if isinstance(value, dict) else "points-file"


class Placement(Part):
    """Where a crowd begins: scattered on a surface (all of it, by the `density` that a map paints, or within `radius` of a point
    or an item, by itself of the scene's origin), at given points, or where lines from a point or an item end, `inside`
    of something. `by` says whether they are dropped onto it from above or spread over its area, undersides too. `apart`: how
    far from each other at least, or as `even` as there is room for. `seed` takes the place of the scene's."""

    on: Name | None = None
    inside: PointOrName | None = None
    around: PointOrName | None = None
    radius: PositiveLength | None = None
    points: (
        Annotated[Annotated[FilePath, Tag("points-file")] | Annotated[UsdPlaces, Tag("usd-places")], Discriminator(_file_or_usd)]
        | None
    ) = None
    density: Name | None = None
    by: By = "above"
    apart: Apart | None = None
    seed: Annotated[int, BeforeValidator(whole(0, 2**64 - 1))] | None = None


class Walk(Part):
    """A way that agents are led instead of deciding for themselves: in a direction of the scene's axes, at one speed, and when
    they have gone so far they stand."""

    direction: tuple[Along, Along, Along]
    speed: PositiveSpeed
    length: PositiveLength


class AnyOf(Part):
    """One of several layers, or `none`, for each agent by chance; a layer that is named twice comes twice as often."""

    any: Annotated[tuple[Name, ...], Field(min_length=1, max_length=limits.LAYERS_WORN)]


def _layer_or_any(value: Any) -> str:
    return "any" if isinstance(value, dict) else "layer"


Worn = Annotated[Annotated[Name, Tag("layer")] | Annotated[AnyOf, Tag("any")], Discriminator(_layer_or_any)]


class CrowdLine(Part):
    """Agents of one species. `body` is what pictures draw, a word or a file of an agent definition; by itself it goes by the
    species' name. `wear`: layers of the body that they show beside its own."""

    species: Name
    source: FilePath = Field(alias="from")
    count: Annotated[int, BeforeValidator(whole(0, limits.AGENTS))]
    place: Placement = Placement()
    walk: Walk | None = None
    body: Body | None = None
    wear: Annotated[tuple[Worn, ...], Field(max_length=limits.LAYERS_WORN)] = ()

    def layers(self) -> tuple[tuple[str, ...], ...]:
        """What they wear: for each part the layers of which an agent has one, "" for none."""
        chosen = (each.any if isinstance(each, AnyOf) else (each,) for each in self.wear)
        return tuple(tuple("" if name == NONE else name for name in names) for names in chosen)
