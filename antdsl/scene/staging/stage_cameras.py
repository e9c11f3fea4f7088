"""Staging of cameras: computes position, target, up direction and focal length at each written frame, in mm and the scene's
axes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.scene import setting as setting_data
from antdsl.scene.camera_models import PlacedCamera, UsdCamera
from antdsl.scene.staging.stage_things import interpolate_values, read_usd
from antdsl.scene.thing_models import UP_VECTORS, convert_point

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import SceneStaging


def stage_cameras(staging: SceneStaging) -> dict[str, setting_data.CameraData]:
    """Return the cameras that do not depend on agents, by name. A camera with an error is reported and omitted."""
    cameras: dict[str, setting_data.CameraData] = {}
    for name, value in staging.scene.model.named_cameras.items():
        if isinstance(value, PlacedCamera):
            cameras[name] = _stage_placed_camera(staging, value)
        elif isinstance(value, UsdCamera) and (camera := _stage_usd_camera(staging, name, value)) is not None:
            cameras[name] = camera
    return cameras


def _stage_placed_camera(staging: SceneStaging, value: PlacedCamera) -> setting_data.CameraData:
    model = staging.scene.model
    frames = range(model.frames.first, model.frames.last + 1 if value.keys else model.frames.first + 1)

    def interpolate_keys(name: str, convert: Callable[[Any], tuple[float, ...]]) -> NDArray[np.float64]:
        keys = {f: convert(part) for f, key in value.keys.items() if (part := getattr(key, name)) is not None}
        return interpolate_values(keys or {0: convert(getattr(value, name))}, frames)

    at, look_at = (interpolate_keys(name, lambda point: convert_point(point, model.unit_mm)) for name in ("at", "look_at"))
    focal = interpolate_keys("focal", lambda length: (0.0 if length is None else length.number,))[:, 0]
    up = np.tile(np.array(UP_VECTORS[model.up]), (len(frames), 1))
    return setting_data.CameraData(at, look_at, up, focal, model.frames.first)


def _stage_usd_camera(staging: SceneStaging, name: str, value: UsdCamera) -> setting_data.CameraData | None:
    from antdsl.scene.geometry.usd import read_usd_camera

    model = staging.scene.model
    camera = read_usd(staging, value.usd, value.prim, "render", model.find_camera_path(name), read_usd_camera)
    if camera is None:
        return None
    written = slice(model.preroll if len(camera.at) > 1 else 0, None)
    return setting_data.CameraData(
        camera.at[written], camera.look_at[written], camera.up[written], camera.focal[written], model.frames.first
    )
