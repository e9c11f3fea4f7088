"""Answers to requests about a prim of a USD stage, as arrays and texts. They run in the reader process. Cameras are also read
here."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from antdsl.numerics import vector_rows
from antdsl.reader.protocol import pack_texts
from antdsl.scene.geometry.matrices import find_uniform_scale
from antdsl.scene.geometry.usd.child import stage as stages
from antdsl.scene.geometry.usd.child.curves import read_curve_positions
from antdsl.scene.geometry.usd.child.guard import ReaderAnswer, wrap_refusals
from antdsl.scene.geometry.usd.child.meshes import join_meshes
from antdsl.scene.geometry.usd.child.points import read_point_arrays
from antdsl.scene.geometry.usd.child.stage import Floats, OpenStage
from antdsl.scene.geometry.usd.errors import UsdError, import_pxr_module

if TYPE_CHECKING:
    from antdsl.reader.protocol import ReaderMessage

_SENSOR_WIDTH_MM = 36.0  # mm; the sensor width to which focal lengths refer
_DEFAULT_FOCUS_MM = 1000.0  # mm; distance of `look_at` for a camera without a focus


@wrap_refusals
def open_stage(request: ReaderMessage) -> ReaderAnswer:
    """Open the stage to check that it can be opened, and answer without data."""
    stages.open_stage(request)
    return {}, {}


@wrap_refusals
def read_mesh(request: ReaderMessage) -> ReaderAnswer:
    """Return an answer with the joined meshes.

    `vertices`, `faces`, `unread_shape_types`: as in `JoinedMesh`.
    `moves:NAME`: the arrays of the motion, if the mesh moves.
    `value:N`: the values of primvar number N in the list `primvars` of the request."""
    names = [str(name) for name in request.document["primvars"]]
    mesh = join_meshes(stages.open_stage(request), names)
    moves = {f"moves:{name}": array for name, array in (mesh.motion_arrays or {}).items()}
    values = {f"value:{number}": mesh.values[name] for number, name in enumerate(names)}
    return {"passed_over": mesh.unread_shape_types}, {"vertices": mesh.vertices, "faces": mesh.faces} | moves | values


@wrap_refusals
def read_points(request: ReaderMessage) -> ReaderAnswer:
    """Return an answer with points or empties.

    `names`, `radius`, `ahead`, `unit`: as in `UsdPoints`. `places`: the positions of `UsdPoints`.
    `values`, `texts`: the names of the numbers and words.
    `value:N`, `text:N`: the values of entry number N in these lists."""
    points = read_point_arrays(stages.open_stage(request), request.document["of_kind"])
    arrays = {"places": points.positions, "radius": points.radius, "ahead": points.ahead}
    arrays |= {f"value:{number}": array for number, array in enumerate(points.values.values())}
    for number, texts in enumerate(points.texts.values()):
        arrays |= pack_texts(f"text:{number}", texts)
    arrays |= pack_texts("names", points.names)
    return {"unit": points.unit, "values": list(points.values), "texts": list(points.texts)}, arrays


@wrap_refusals
def read_curve(request: ReaderMessage) -> ReaderAnswer:
    """Return an answer with the points of a curve, `places` (frames, k, 3)."""
    return {}, {"places": read_curve_positions(stages.open_stage(request))}


@wrap_refusals
def read_camera(request: ReaderMessage) -> ReaderAnswer:
    """Return an answer with a camera: `at`, `look_at`, `up` and `focal`."""
    return {}, read_camera_arrays(stages.open_stage(request))


def read_camera_arrays(stage: OpenStage) -> dict[str, Floats]:
    """Return the camera at the stage's prim, or the only camera below it: `at`, `look_at` and `up` (frames, 3), and `focal`
    (frames,)."""
    geom = import_pxr_module("UsdGeom")
    cameras = [prim for prim in stage.find_visible_prims(stage.prim) if prim.IsA(geom.Camera)]
    if len(cameras) != 1:
        path = stage.prim.GetPath()
        words = f"there is no camera at or below `{path}`" if not cameras else f"below `{path}` are {len(cameras)} cameras"
        help = ", ".join(f"`{prim.GetPath()}`" for prim in cameras[:4])
        raise UsdError("no-such-prim", words, f"name one of them: {help}" if cameras else "name a prim of the type Camera")
    prim, camera = cameras[0], geom.Camera(cameras[0])
    attributes = (camera.GetFocalLengthAttr(), camera.GetHorizontalApertureAttr(), camera.GetFocusDistanceAttr())
    changes = len(stage.times) > 1 and any(a.ValueMightBeTimeVarying() for a in attributes)
    transforms = stage.compute_scene_transforms(prim, stage.is_moving(prim))
    times = stage.times if changes or len(transforms) > 1 else stage.times[:1]
    transforms = np.broadcast_to(transforms, (len(times), 3, 4))
    lens = np.array([[float(a.Get(import_pxr_module("Usd").TimeCode(time))) for a in attributes] for time in times])
    unit = find_uniform_scale(stage.to_scene)
    at, ahead, up = transforms[:, :, 3], -vector_rows.normalise(transforms[:, :, 2]), vector_rows.normalise(transforms[:, :, 1])
    far = np.where(lens[:, 2] > 0, lens[:, 2] * unit, _DEFAULT_FOCUS_MM)[:, None]
    # both values are in tenths of the stage's unit, so their ratio does not depend on it
    focal = lens[:, 0] / np.where(lens[:, 1] > 0, lens[:, 1], 20.955) * _SENSOR_WIDTH_MM
    return {"at": at, "look_at": at + ahead * far, "up": up, "focal": focal}
