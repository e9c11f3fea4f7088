"""Contents of a line of a scene's crowd: species, count, starting places, and an optional walk."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag

from antdsl import limits
from antdsl.program.tables.vocabulary import LENGTH_DIMENSION
from antdsl.scene.library_bodies import BODY_WORDS
from antdsl.scene.quantities import Quantity
from antdsl.scene.values import (
    FilePath,
    Part,
    PointOrName,
    PositiveLength,
    PositiveSpeed,
    SceneName,
    SceneWord,
    integer,
    number,
    one_of,
    positive,
    word_or,
    word_or_file,
)

NO_LAYER = "none"  # of the layers of a part, the one that is none
# Of the library of bodies.
BodyText = Annotated[str, BeforeValidator(word_or_file(*BODY_WORDS))]
SpacingValue = Annotated[Quantity | str, BeforeValidator(word_or("even", positive(LENGTH_DIMENSION)))]
DirectionComponent = Annotated[float, BeforeValidator(number(-1e6, 1e6))]
PlacementMethod = Annotated[str, BeforeValidator(one_of("above", "area"))]


class UsdPlaces(Part):
    """Positions from a USD file: the points or empties below a prim, or all empties of a kind (default: the species' name)."""

    usd: FilePath
    prim: SceneWord | None = None
    kind: SceneWord | None = None


def _file_or_usd(value: Any) -> str:
    return "usd-places" if isinstance(value, dict) else "points-file"


class Placement(Part):
    """Where a crowd begins. It is scattered on a surface, at given points, where lines from a point or an item end, or `inside`
    something. Scattering covers all of the surface, by the `density` that a map paints, or within `radius` of a point or an item
    (default: the scene's origin). `by`: whether agents are dropped onto it from above or spread over its area, undersides
    included. `apart`: least distance from each other, or as `even` as space allows. `seed` replaces the scene's."""

    on: SceneName | None = None
    inside: PointOrName | None = None
    around: PointOrName | None = None
    radius: PositiveLength | None = None
    points: (
        Annotated[Annotated[FilePath, Tag("points-file")] | Annotated[UsdPlaces, Tag("usd-places")], Discriminator(_file_or_usd)]
        | None
    ) = None
    density: SceneName | None = None
    by: PlacementMethod = "above"
    apart: SpacingValue | None = None
    seed: Annotated[int, BeforeValidator(integer(0, 2**64 - 1))] | None = None


class Walk(Part):
    """A walk that replaces the decisions of agents: along a direction of the scene's axes, at one speed, for a given length; then
    they stand."""

    direction: tuple[DirectionComponent, DirectionComponent, DirectionComponent]
    speed: PositiveSpeed
    length: PositiveLength


class AnyOf(Part):
    """One of several layers, or `none`, drawn for each agent. A layer that is listed twice is twice as likely."""

    any: Annotated[tuple[SceneName, ...], Field(min_length=1, max_length=limits.MAX_WORN_LAYERS)]


def _layer_or_any(value: Any) -> str:
    return "any" if isinstance(value, dict) else "layer"


WornLayer = Annotated[Annotated[SceneName, Tag("layer")] | Annotated[AnyOf, Tag("any")], Discriminator(_layer_or_any)]


class CrowdLine(Part):
    """Agents of one species. `body`: what pictures draw, a word or a file of an agent definition; by default it depends on the
    species' name. `wear`: additional layers of the body that they show."""

    species: SceneName
    source: FilePath = Field(alias="from")
    count: Annotated[int, BeforeValidator(integer(0, limits.MAX_AGENTS))]
    place: Placement = Placement()
    walk: Walk | None = None
    body: BodyText | None = None
    wear: Annotated[tuple[WornLayer, ...], Field(max_length=limits.MAX_WORN_LAYERS)] = ()

    def layers(self) -> tuple[tuple[str, ...], ...]:
        """Return what the agents wear: for each part the layers of which an agent has one, "" for none."""
        chosen = (each.any if isinstance(each, AnyOf) else (each,) for each in self.wear)
        return tuple(tuple("" if name == NO_LAYER else name for name in names) for names in chosen)
