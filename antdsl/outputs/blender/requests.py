"""The request for pictures that Cycles renders: light and cameras in the units and axes of Blender (metres, z up).

Light is as strong as in antdsl's own pictures, where a surface with albedo a has the radiance a times the light. Cycles divides
this by pi, so the irradiances of sun and lamps are multiplied by pi."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.lamps import UNIT_DISTANCE_IN_RADII
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.lamps import Lamp, find_lamps
from antdsl.outputs.pictures.light import HORIZON_COLOUR, SKY_LIGHT, SUN_HALF_ANGLE_TANGENT, ZENITH_COLOUR, make_sun
from antdsl.outputs.pictures.model import Camera, Picture
from antdsl.outputs.scene_cameras import find_camera_axes
from antdsl.scene.scene_model import UNIT_MM
from antdsl.scene.setting import SENSOR_WIDTH_MM
from antdsl.scene.thing_models import UP_VECTORS

Array = NDArray[np.float64]


def to_blender_axes(vectors: Array, up: str) -> Array:
    """Return vectors (n, 3) of a scene in the axes of Blender. `up`: the up axis of the scene, `y` or `z`."""
    return vectors[:, [0, 2, 1]] * (1, -1, 1) if up == "y" else vectors


def describe_light(gallery: Gallery) -> dict[str, Any]:
    """Return sun and sky as request entries: direction to the sun, irradiance and angle (radians) of the sun, and radiances of
    the sky.

    `sky` is the light on surfaces. `horizon` and `zenith` are what the camera sees."""
    settings, up = gallery.light, gallery.manifest.up
    sun = make_sun(np.asarray(UP_VECTORS[up], np.float64), settings)
    return {
        "sun_direction": to_blender_axes(sun.direction[None].astype(np.float64), up)[0].tolist(),
        "sun_irradiance": (np.pi * sun.sunlight.astype(np.float64)).tolist(),
        "sun_angle": 2 * float(np.arctan(SUN_HALF_ANGLE_TANGENT)),
        **{
            name: (colour.astype(np.float64) * settings.sky).tolist()
            for name, colour in (("sky", SKY_LIGHT), ("horizon", HORIZON_COLOUR), ("zenith", ZENITH_COLOUR))
        },
    }


def describe_frame(gallery: Gallery, picture: Picture, cameras: Sequence[Camera]) -> dict[str, Any]:
    """Return the lamps and the cameras of a frame as request entries. With motion blur, `cameras` also has the camera of the next
    frame."""
    lamps = find_lamps(picture.items, picture.up, picture.light.lamps)
    return {
        "lamps": [_describe_lamp(gallery, lamp) for lamp in lamps],
        "cameras": [describe_camera(gallery, camera) for camera in cameras],
    }


def _describe_lamp(gallery: Gallery, lamp: Lamp) -> dict[str, Any]:
    """Return a lamp's centre and radius in metres, and its power in watts for red, green and blue.

    A sphere with the power P has the irradiance P / (4 pi d^2) at the distance d."""
    metres = UNIT_MM[gallery.manifest.units] / 1000
    radius = lamp.radius * metres
    power = 4 * np.pi**2 * lamp.strength * (UNIT_DISTANCE_IN_RADII * radius) ** 2 * lamp.light.astype(np.float64)
    centre = to_blender_axes(lamp.centre[None] * metres, gallery.manifest.up)[0]
    return {"centre": centre.tolist(), "radius": radius, "power": power.tolist()}


def describe_camera(gallery: Gallery, camera: Camera) -> dict[str, Any]:
    """Return a camera as a request entry: its matrix (4 rows, metres), its lens and its depth of field. The lens is the focal
    length for a sensor of SENSOR_WIDTH_MM, or the width of the view if rays are parallel. `f_stop` is None for a pinhole."""
    up, units = gallery.manifest.up, UNIT_MM[gallery.manifest.units]
    eye, axes = find_camera_axes(camera, up)
    matrix = np.eye(4)
    matrix[:3, :3] = to_blender_axes(axes, up).T
    matrix[:3, 3] = to_blender_axes(eye[None] * units / 1000, up)[0]
    aim = float(np.linalg.norm(np.subtract(camera.look_at, camera.at)))
    focal = camera.focal if camera.fov is None else SENSOR_WIDTH_MM / 2 / float(np.tan(np.radians(camera.fov) / 2))
    is_parallel = camera.parallel_width is not None
    return {
        "matrix": matrix.tolist(),
        "focal": focal,
        "parallel_width": None if camera.parallel_width is None else camera.parallel_width * units / 1000,
        "f_stop": focal / (camera.aperture * units) if camera.aperture > 0 and not is_parallel else None,
        "focus": (aim if camera.focus is None else camera.focus) * units / 1000,
        "reach": aim * units / 1000,
    }
