"""What models of a scene have in common: mappings of known keys, points, and places at frames."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Tag

from antdsl import limits
from antdsl.scene.values import Angle, Length, Name, whole

Point = tuple[Length, Length, Length]


class Part(BaseModel):
    """A mapping of the scene: keys that are not listed are refused."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, populate_by_name=False, arbitrary_types_allowed=True, hide_input_in_errors=True
    )


class PlaceKey(Part):
    """Where a thing is at one frame; between keys it goes evenly, before the first and after the last it rests."""

    at: Point | None = None
    rotate: tuple[Angle, Angle, Angle] | None = None


Keys = dict[Annotated[int, BeforeValidator(whole(-limits.FRAMES, limits.FRAMES * 1000))], PlaceKey]


def _point_or_name(value: Any) -> str:
    return "point" if isinstance(value, list) else "named"


PointOrName = Annotated[Annotated[Point, Tag("point")] | Annotated[Name, Tag("named")], Discriminator(_point_or_name)]
