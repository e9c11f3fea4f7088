"""The key `light` of a scene: the sun, the sky and the haze of pictures, and how bright lamps are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from antdsl.program.model import Dimension
from antdsl.scene.values import Angle, ScenePart, make_value_error, parse_any_quantity, parse_number_between

MAX_LIGHT_STRENGTH = 1000.0  # times the usual light
_LightFactor = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Degrees = Annotated[float, Field(allow_inf_nan=False)]


@dataclass(frozen=True, slots=True)
class LightSettings:
    """The light of a picture, as caches store it: the strengths of sun, sky, haze and lamps, and the direction to the sun in
    degrees."""

    sun: _LightFactor = 1.0
    sky: _LightFactor = 1.0
    haze: _LightFactor = 1.0
    lamps: _LightFactor = 1.0
    elevation: _Degrees = 40.0
    azimuth: _Degrees = 280.0


DEFAULT_LIGHT = LightSettings()


def _parse_strength(value: Any) -> float:
    """Return the factor for a strength such as `50 %` or `300 %`."""
    quantity = parse_any_quantity(value)
    if quantity.dim != Dimension() or not 0 <= quantity.number <= MAX_LIGHT_STRENGTH:
        raise make_value_error(f"`{quantity.text}` is not a strength", f"write `50 %`, at most `{MAX_LIGHT_STRENGTH * 100:g} %`")
    return quantity.number


_ColourChannel = Annotated[float, BeforeValidator(parse_number_between(0, 1))]
LightColour = tuple[_ColourChannel, _ColourChannel, _ColourChannel]  # display values of red, green and blue
LightStrength = Annotated[float, BeforeValidator(_parse_strength)]


class LightModel(ScenePart):
    """The light in pictures. At 100 %, the light is as it is without this key.

    `sun`, `sky`: the strength of the light from the sun and from the sky.
    `haze`, `lamps`: the strength of the haze, and of the lamps. A lamp is an item with `look: light`. At a distance of ten
    times its radius, a lamp of 100 % is as bright as the sun.
    `elevation`, `azimuth`: the direction to the sun, as angles above the ground and around the scene's up axis."""

    sun: LightStrength = DEFAULT_LIGHT.sun
    sky: LightStrength = DEFAULT_LIGHT.sky
    haze: LightStrength = DEFAULT_LIGHT.haze
    lamps: LightStrength = DEFAULT_LIGHT.lamps
    elevation: Angle | None = None
    azimuth: Angle | None = None

    def make_settings(self) -> LightSettings:
        """Return the strengths, and the direction to the sun in degrees."""
        elevation, azimuth = (
            default if angle is None else math.degrees(angle.number)
            for angle, default in ((self.elevation, DEFAULT_LIGHT.elevation), (self.azimuth, DEFAULT_LIGHT.azimuth))
        )
        return LightSettings(self.sun, self.sky, self.haze, self.lamps, elevation, azimuth)
