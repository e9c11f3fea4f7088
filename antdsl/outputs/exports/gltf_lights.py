"""The light of a scene in a glTF file: the sun and the lamps, by the extension `KHR_lights_punctual` (Khronos Group, 2018).

In pictures, a surface scatters its albedo times the light, so a light of 1 is an irradiance of pi W/m². glTF uses lux and
candela. One watt is converted to 683 lumens, which Blender also assumes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.transforms import matrix_to_quaternion
from antdsl.casting.lamps import UNIT_DISTANCE_IN_RADII, place_bulb
from antdsl.outputs.exports.gltf_stage import GltfStage
from antdsl.outputs.pictures.lamps import find_lamps
from antdsl.outputs.pictures.light import SUN_LIGHT, make_sun
from antdsl.outputs.pictures.model import Picture
from antdsl.scene.scene_model import UNIT_MM
from antdsl.scene.thing_models import UP_VECTORS

_EXTENSION = "KHR_lights_punctual"
_LUX_PER_LIGHT = float(np.pi) * 683


def add_lights(stage: GltfStage, picture: Picture) -> None:
    """Write the sun, and a point light for each lamp of the first picture. The lights move with their items, but do not fade when
    these shrink."""
    lights: dict[int, dict[str, Any]] = {}  # by node
    settings, up = picture.light, np.asarray(UP_VECTORS[stage.gallery.manifest.up], np.float64)
    if settings.sun > 0:
        sun = make_sun(up, settings)
        axes = np.stack([sun.first_axis, np.cross(sun.direction, sun.first_axis), sun.direction], axis=1)
        turn = matrix_to_quaternion(axes.astype(np.float64))  # a light of glTF shines along its own -z
        lights[stage.add_child(None, "sun", turn=turn)] = {
            "type": "directional", **_make_strength(SUN_LIGHT * settings.sun, 1.0)
        }  # fmt: skip
    metres = UNIT_MM[stage.gallery.manifest.units] / 1000
    for index, item in enumerate(picture.items):
        for lamp in find_lamps([item], picture.up, settings.lamps):
            centre, _ = place_bulb(item.shape, np.zeros(3), 1.0, up)
            candela = (UNIT_DISTANCE_IN_RADII * item.drawn_radius * metres) ** 2
            lights[stage.add_child(index, f"{item.name} light", move=centre)] = {
                "type": "point", **_make_strength(lamp.light * lamp.strength, candela)
            }  # fmt: skip
    if lights:
        stage.writer.add_extension(_EXTENSION, {"lights": list(lights.values())})
        for number, node in enumerate(lights):
            stage.writer.get_part("nodes", node)["extensions"] = {_EXTENSION: {"light": number}}


def _make_strength(colour: NDArray[np.floating], factor: float) -> dict[str, Any]:
    """Return the colour and the intensity of a light as glTF entries. The greatest component of the colour is 1."""
    greatest = float(np.max(colour))
    return {"color": [round(float(part) / greatest, 6) for part in colour], "intensity": _LUX_PER_LIGHT * greatest * factor}
