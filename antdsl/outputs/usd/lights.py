"""The light of a scene as UsdLux: a distant light for the sun, a dome for the sky, and a sphere for each lamp.

The ratios of intensities are those of antdsl's own pictures, where a surface scatters its albedo times the light. A sphere of
radiance L and radius r has the irradiance pi L (r / d)^2 at a distance d. A dome of radiance L has pi L."""

from __future__ import annotations

from typing import Any

import numpy as np

from antdsl.casting.lamps import UNIT_DISTANCE_IN_RADII
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.lamps import Lamp, find_lamps
from antdsl.outputs.pictures.light import SKY_LIGHT, SUN_LIGHT, make_sun
from antdsl.outputs.pictures.model import Picture
from antdsl.outputs.usd.values import ROOT_PATH, StageOutput, ValueSamples
from antdsl.scene.geometry.usd import import_pxr_module
from antdsl.scene.thing_models import UP_VECTORS

_SUN_ANGLE_DEGREES = 3.4  # of the sun's disc, as in pictures


class LightWriter:
    """Writer of the lights. Lamps move with their items, and shrink with them."""

    def __init__(self, stage_output: StageOutput, gallery: Gallery) -> None:
        self._out, self._lamps, self._settings = stage_output, list[tuple[ValueSamples, ValueSamples]](), gallery.light
        stage, lux = stage_output.stage, import_pxr_module("UsdLux")
        import_pxr_module("UsdGeom").Scope.Define(stage, f"{ROOT_PATH}/lights")
        if self._settings.sun > 0:
            sun = lux.DistantLight.Define(stage, f"{ROOT_PATH}/lights/sun")
            sun.CreateAngleAttr(_SUN_ANGLE_DEGREES)
            sun.CreateNormalizeAttr(True)
            _set_colour(sun, SUN_LIGHT * self._settings.sun)
            up = np.asarray(UP_VECTORS[gallery.manifest.up], np.float64)
            towards = make_sun(up, self._settings).direction.astype(np.float64)
            gf = import_pxr_module("Gf")
            turn = gf.Rotation(gf.Vec3d(0, 0, 1), gf.Vec3d(*towards.tolist()))  # a distant light shines along its own -z
            sun.AddTransformOp().Set(gf.Matrix4d(turn, gf.Vec3d(0)))
        if self._settings.sky > 0:
            _set_colour(lux.DomeLight.Define(stage, f"{ROOT_PATH}/lights/sky"), SKY_LIGHT * (self._settings.sky / np.pi))

    def frame(self, frame: int, picture: Picture) -> None:
        """Write the lamps of a frame. Lamps that no longer exist get the radius 0."""
        lamps = find_lamps(picture.items, picture.up, picture.light.lamps)
        while len(self._lamps) < len(lamps):
            self._lamps.append(self._add_lamp(len(self._lamps), lamps[len(self._lamps)]))
        for number, (move, radius) in enumerate(self._lamps):
            if number < len(lamps):
                move.set(frame, lamps[number].centre)
            radius.set(frame, [lamps[number].radius if number < len(lamps) else 0.0])

    def _add_lamp(self, number: int, lamp: Lamp) -> tuple[ValueSamples, ValueSamples]:
        """Add the light of a lamp. Return its positions and its radii over time."""
        sphere = import_pxr_module("UsdLux").SphereLight.Define(self._out.stage, f"{ROOT_PATH}/lights/lamp_{number}")
        _set_colour(sphere, lamp.light * (lamp.strength * UNIT_DISTANCE_IN_RADII**2 / np.pi))
        vector = import_pxr_module("Gf").Vec3d
        move = self._out.add_samples(sphere.AddTranslateOp(), lambda v: vector(*v.tolist()))
        return move, self._out.add_samples(sphere.CreateRadiusAttr(), lambda v: float(v[0]))


def _set_colour(light: Any, colour: Any) -> None:
    """Set the colour and the intensity of a light. The largest component of the colour is 1."""
    strength = float(np.max(colour))
    light.CreateIntensityAttr(strength)
    light.CreateColorAttr(import_pxr_module("Gf").Vec3f(*(np.asarray(colour, np.float64) / max(strength, 1e-12)).tolist()))
