"""Sun, sky, haze, and the tone curve from light to display values. All values are linear light in float32, up to
`apply_tone_curve`."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.pictures.shading_rows import Floats
from antdsl.scene.light_model import DEFAULT_LIGHT, LightSettings

SUN_LIGHT = np.array([2.65, 2.36, 1.95], np.float32)
SKY_LIGHT = np.array([0.50, 0.62, 0.84], np.float32)
BOUNCE_LIGHT = np.array([0.34, 0.28, 0.21], np.float32)
ZENITH_COLOUR = np.array([0.30, 0.58, 1.05], np.float32)
HORIZON_COLOUR = np.array([1.12, 1.20, 1.24], np.float32)
_SRGB_TABLE_STEPS = 1 << 14  # linear values with an entry in the table; the error is less than half a byte in dark tones
HEADLAMP_LIGHT = np.array([0.95, 0.84, 0.68], np.float32)  # a lamp at the camera
LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722], np.float32)  # luminance weights of linear sRGB
SUN_HALF_ANGLE_TANGENT = 0.03  # wider than the real sun, for soft edges


@dataclass(frozen=True, slots=True, eq=False)
class SunLight:
    """The sun and the sky.

    `direction`: the unit vector towards the sun. `first_axis`, `second_axis`: unit vectors perpendicular to it. `up`: the up
    direction of the world. `settings`: the strengths of sun, sky and haze."""

    direction: Floats
    first_axis: Floats
    second_axis: Floats
    up: Floats
    settings: LightSettings

    @property
    def sunlight(self) -> Floats:
        """Return the light (3,) of the sun."""
        return SUN_LIGHT * np.float32(self.settings.sun)

    def aim_rays(self, points: Floats, numbers: NDArray[np.integer], count: int) -> Floats:
        """Return directions (n, 3) to points on the sun's disc. `numbers` (n,): the indices of these among `count` points."""
        return np.asarray(self.sample_disc(count)[numbers])

    def sample_disc(self, count: int) -> Floats:
        """Return directions (count, 3) to points that cover the sun's disc evenly. Consecutive points are far apart."""
        k = np.arange(count)
        angle = k * (np.pi * (3 - np.sqrt(5)))
        radius = np.sqrt((k + 0.5) / count) * SUN_HALF_ANGLE_TANGENT
        directions = (
            self.direction
            + (radius * np.cos(angle))[:, None] * self.first_axis
            + (radius * np.sin(angle))[:, None] * self.second_axis
        )
        return np.asarray(directions, np.float32)


def make_sun(up: NDArray[np.float64], settings: LightSettings = DEFAULT_LIGHT) -> SunLight:
    """Return the sun and the sky for a world with the up direction `up`."""
    upward = up / np.linalg.norm(up)
    first = np.roll(upward, 1) - upward * float(np.dot(np.roll(upward, 1), upward))
    first /= np.linalg.norm(first)
    second = np.cross(upward, first)
    turn, high = np.radians(settings.azimuth), np.radians(settings.elevation)
    towards = np.cos(high) * (np.cos(turn) * first + np.sin(turn) * second) + np.sin(high) * upward
    a = np.cross(towards, upward)
    a /= np.linalg.norm(a)
    direction, side, other, axis = (v.astype(np.float32) for v in (towards, a, np.cross(a, towards), upward))
    return SunLight(direction, side, other, axis, settings)


def compute_ambient_light(upness: Floats, sun: SunLight) -> Floats:
    """Return the ambient light (n, 3) from sky and ground on surfaces. `upness` (n,): the vertical component of their normals, −1
    to 1."""
    share = (0.5 + 0.5 * upness)[:, None]
    return (SKY_LIGHT * share + BOUNCE_LIGHT * (1 - share)) * np.float32(sun.settings.sky)


def compute_sky_light(direction: Floats, sun: SunLight) -> Floats:
    """Return the light (n, 3) of the sky in directions (n, 3)."""
    high = direction @ sun.up
    share = np.sqrt(np.clip(high, 0.0, 1.0))[:, None]
    glow = np.clip(direction @ sun.direction, 0.0, 1.0)[:, None]
    glare = np.array([0.22, 0.17, 0.10], np.float32) * np.float32(sun.settings.sun) * glow**8
    light: Floats = (HORIZON_COLOUR * (1 - share) + ZENITH_COLOUR * share) * np.float32(sun.settings.sky) + glare
    return light


def compute_environment_light(direction: Floats, sun: SunLight) -> Floats:
    """Return the light (n, 3) that a mirror reflects from directions (n, 3): sky above the horizon, ground below."""
    high = (direction @ sun.up)[:, None]
    share = np.sqrt(np.clip(high, 0.0, 1.0))
    above = HORIZON_COLOUR * (1 - share) + ZENITH_COLOUR * share
    light = BOUNCE_LIGHT + (above - BOUNCE_LIGHT) * np.clip(0.5 + 4 * high, 0.0, 1.0)
    return np.asarray(light * np.float32(sun.settings.sky), np.float32)


def apply_haze(colour: Floats, distances: Floats, direction: Floats, sun: SunLight, reach: float) -> Floats:
    """Return colours (n, 3) as seen through haze. `distances` (n,): the thickness of the haze. Haze is thin in downward
    directions.

    At about 0.7 · `reach`, haze hides half of the colour."""
    level = 1 - np.clip(-(direction @ sun.up), 0.0, 1.0)
    amount = (1 - np.exp(-distances * np.float32(sun.settings.haze / reach))) * level * level * level
    through: Floats = colour + (HORIZON_COLOUR * np.float32(sun.settings.sky) - colour) * amount[:, None]
    return through


def apply_tone_curve(light: Floats) -> Floats:
    """Return display-linear values from 0 to 1: linear for dark and middle tones, softly compressed above 0.7."""
    light = np.maximum(light * np.float32(0.62), 0)
    knee = np.float32(0.7)
    over = np.maximum(light - knee, 0)
    return np.where(light > knee, knee + (1 - knee) * (1 - np.exp(-over / (1 - knee))), light)


def encode_srgb(linear: Floats) -> NDArray[np.uint8]:
    """Return display-linear values as sRGB bytes."""
    return _make_srgb_table().take((np.clip(linear, 0, 1) * np.float32(_SRGB_TABLE_STEPS) + np.float32(0.5)).astype(np.int32))


@cache
def _make_srgb_table() -> NDArray[np.uint8]:
    """Return the sRGB bytes of evenly spaced linear values from 0 to 1."""
    return np.asarray(encode_srgb_values(np.arange(_SRGB_TABLE_STEPS + 1) / _SRGB_TABLE_STEPS) * 255 + 0.5, np.uint8)


def encode_srgb_values(linear: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return linear values (0 to 1) as sRGB display values (0 to 1)."""
    linear = np.asarray(linear, np.float64)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)


def decode_srgb(display: NDArray[np.floating] | tuple[float, ...]) -> Floats:
    """Return sRGB display values (0 to 1) as linear values."""
    value = np.asarray(display, np.float32)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)
