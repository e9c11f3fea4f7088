"""Sets of other departments: meshes, curves, points and cameras by prim path out of USD files, in mm and the scene's axes.

USD files are read in the reader's process (`antdsl.reader`): `closure` collects the files, `stage` requests, `answers` checks
what comes back. The folder `child` runs there, with usd-core of the extra `[usd]`. No other code reads a USD file."""

from antdsl.scene.geometry.usd.answers import (
    UsdCamera,
    UsdMesh,
    UsdPoints,
    read_usd_camera,
    read_usd_curve,
    read_usd_mesh,
    read_usd_points,
)
from antdsl.scene.geometry.usd.closure import Closure
from antdsl.scene.geometry.usd.errors import UsdError, pxr
from antdsl.scene.geometry.usd.stage import UsdStage, open_stage

__all__ = [
    "Closure", "UsdCamera", "UsdError", "UsdMesh", "UsdPoints", "UsdStage",
    "open_stage", "pxr", "read_usd_camera", "read_usd_curve", "read_usd_mesh", "read_usd_points",
]  # fmt: skip
