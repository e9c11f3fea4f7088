"""A camera prim: where it stands, what it looks at, its upper side and focal length, at every frame."""

from __future__ import annotations

import numpy as np

from antdsl.numerics import vector_rows
from antdsl.scene.geometry.matrices import scale
from antdsl.scene.geometry.usd.child.stage import Floats, OpenStage
from antdsl.scene.geometry.usd.errors import UsdError, pxr

_SENSOR = 36.0  # mm, the width that focal lengths are for
_AHEAD = 1000.0  # mm: how far off it looks where it has no focus


def camera_arrays(stage: OpenStage) -> dict[str, Floats]:
    """The camera that the prim is, or the only one below it: `at`, `look_at`, `up` (frames, 3) and `focal` (frames,)."""
    geom = pxr("UsdGeom")
    found = [prim for prim in stage.below(stage.prim) if prim.IsA(geom.Camera)]
    if len(found) != 1:
        path = stage.prim.GetPath()
        words = f"there is no camera at or below `{path}`" if not found else f"below `{path}` are {len(found)} cameras"
        help = ", ".join(f"`{prim.GetPath()}`" for prim in found[:4])
        raise UsdError("no-such-prim", words, f"name one of them: {help}" if found else "name a prim of the type Camera")
    prim, camera = found[0], geom.Camera(found[0])
    attributes = (camera.GetFocalLengthAttr(), camera.GetHorizontalApertureAttr(), camera.GetFocusDistanceAttr())
    changes = len(stage.times) > 1 and any(a.ValueMightBeTimeVarying() for a in attributes)
    ways = stage.matrices(prim, stage.travels(prim))
    times = stage.times if changes or len(ways) > 1 else stage.times[:1]
    ways = np.broadcast_to(ways, (len(times), 3, 4))
    lens = np.array([[float(a.Get(pxr("Usd").TimeCode(time))) for a in attributes] for time in times])
    unit = scale(stage.to_scene)
    at, ahead, up = ways[:, :, 3], -vector_rows.unit(ways[:, :, 2]), vector_rows.unit(ways[:, :, 1])
    far = np.where(lens[:, 2] > 0, lens[:, 2] * unit, _AHEAD)[:, None]
    # both are in tenths of the stage's unit, so that their ratio is free of it
    focal = lens[:, 0] / np.where(lens[:, 1] > 0, lens[:, 1], 20.955) * _SENSOR
    return {"at": at, "look_at": at + ahead * far, "up": up, "focal": focal}
