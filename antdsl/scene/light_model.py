"""The key `light` of a scene: the sun, the sky and the haze of pictures, and how bright lamps are."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator

from antdsl.program.model import Dimension
from antdsl.scene.values import Angle, ScenePart, make_error, parse_any_quantity

MAX_STRENGTH = 1000.0  # times the usual light


def _parse_strength(value: Any) -> float:
    """Return a strength such as `50 %` or `300 %` as a factor."""
    quantity = parse_any_quantity(value)
    if quantity.dim != Dimension() or not 0 <= quantity.number <= MAX_STRENGTH:
        raise make_error(f"`{quantity.text}` is not a strength", f"write `50 %`, at most `{MAX_STRENGTH * 100:g} %`")
    return quantity.number


Strength = Annotated[float, BeforeValidator(_parse_strength)]


class Light(ScenePart):
    """The light of pictures. 100 % is the light that pictures have without this key.

    `sun`, `sky`, `haze`, `lamps`: strengths. Lamps are items with `look: light`; at a distance of ten radii a lamp of 100 % is as
    bright as the sun.
    `elevation`, `azimuth`: the direction to the sun, above the ground and about the scene's up."""

    sun: Strength = 1.0
    sky: Strength = 1.0
    haze: Strength = 1.0
    lamps: Strength = 1.0
    elevation: Angle | None = None
    azimuth: Angle | None = None
