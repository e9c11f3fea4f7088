"""Sets of other departments: meshes, curves, points and cameras by prim path out of USD files, in mm and the scene's axes.

usd-core comes with the extra `[usd]` and is imported when the first such file is opened."""

from antdsl.scene.geometry.usd.camera import UsdCamera, read_usd_camera
from antdsl.scene.geometry.usd.curves import read_usd_curve
from antdsl.scene.geometry.usd.errors import UsdError, pxr, usd_exception, words_of
from antdsl.scene.geometry.usd.layers import Layers
from antdsl.scene.geometry.usd.meshes import UsdMesh, read_usd_mesh
from antdsl.scene.geometry.usd.points import UsdPoints, read_usd_points
from antdsl.scene.geometry.usd.stage import UsdStage, open_stage

__all__ = [
    "Layers", "UsdCamera", "UsdError", "UsdMesh", "UsdPoints", "UsdStage",
    "open_stage", "pxr", "read_usd_camera", "read_usd_curve", "read_usd_mesh", "read_usd_points", "usd_exception", "words_of",
]  # fmt: skip
