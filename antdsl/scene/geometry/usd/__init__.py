"""USD sets from other departments: meshes, curves, points and cameras by prim path, in mm and the scene's axes.

Only the reader process (`antdsl.reader`) reads USD files.
`closure`: collects the files; `stage`: sends requests; `answers`: checks the results.
`child`: runs in the reader process, with usd-core from the extra `[usd]`.

Public names are loaded on first use, because the reader process needs only `child`, and a scene without USD needs none of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from antdsl.scene.geometry.usd.answers import (
        UsdCameraTracks,
        UsdMesh,
        read_usd_camera,
        read_usd_curve,
        read_usd_mesh,
        read_usd_points,
    )
    from antdsl.scene.geometry.usd.closure import UsdFileClosure
    from antdsl.scene.geometry.usd.errors import UsdError, import_pxr_module
    from antdsl.scene.geometry.usd.points import UsdPoints
    from antdsl.scene.geometry.usd.stage import UsdStage, open_stage

__all__ = [
    "UsdCameraTracks",
    "UsdError",
    "UsdFileClosure",
    "UsdMesh",
    "UsdPoints",
    "UsdStage",
    "import_pxr_module",
    "open_stage",
    "read_usd_camera",
    "read_usd_curve",
    "read_usd_mesh",
    "read_usd_points",
]  # fmt: skip
_MODULE_BY_NAME = {
    "UsdFileClosure": "closure", "UsdError": "errors", "UsdPoints": "points", "import_pxr_module": "errors", "UsdStage": "stage",
    "open_stage": "stage",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module `{__name__}` has no `{name}`")
    return getattr(import_module(f"{__name__}.{_MODULE_BY_NAME.get(name, 'answers')}"), name)
