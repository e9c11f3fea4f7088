"""Reads a curve prim as a polyline at each frame, in mm and the scene's axes."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.geometry.matrices import apply_transforms
from antdsl.scene.geometry.usd.child.shapes import BAKE_HELP, check_motion_bytes
from antdsl.scene.geometry.usd.child.stage import Floats, OpenStage
from antdsl.scene.geometry.usd.errors import UsdError, import_pxr_module

_SEGMENTS_PER_CUBIC = 16  # number of straight pieces per cubic piece
# Weights of four points for 1, t, t², t³ (Foley, van Dam, Computer Graphics: Principles and Practice, 1990, 11.2).
_CUBIC_BASES = {
    "bezier": (((1, 0, 0, 0), (-3, 3, 0, 0), (3, -6, 3, 0), (-1, 3, -3, 1)), 1, 3),
    "bspline": (((1, 4, 1, 0), (-3, 0, 3, 0), (3, -6, 3, 0), (-1, 3, -3, 1)), 6, 1),
    "catmullRom": (((0, 2, 0, 0), (-1, 0, 1, 0), (2, -5, 4, -1), (-1, 3, -3, 1)), 2, 1),
}


def read_curve_positions(stage: OpenStage) -> Floats:
    """Return the points (frames, k, 3) of the only BasisCurves prim at or below the stage's prim. A static curve has a single
    frame.

    Raises UsdError if there is no such prim, or more than one."""
    geom = import_pxr_module("UsdGeom")
    curves = [prim for prim in stage.find_visible_prims(stage.prim) if prim.IsA(geom.BasisCurves)]
    path = stage.prim.GetPath()
    if not curves:
        other = sorted({str(p.GetTypeName()) for p in stage.find_visible_prims(stage.prim) if p.IsA(geom.Curves)})
        words = f"there is no curve at or below `{path}`" + (f", only {', '.join(other)}" if other else "")
        raise UsdError("no-such-prim", words, "name a prim of the type BasisCurves")
    if len(curves) > 1:
        names = ", ".join(f"`{prim.GetPath()}`" for prim in curves[:4])
        raise UsdError("bad-usd", f"below `{path}` are {len(curves)} curves", f"name one of them: {names}")
    prim, curve = curves[0], geom.BasisCurves(curves[0])
    counts = list(curve.GetCurveVertexCountsAttr().Get(stage.first_time) or [])
    if len(counts) != 1:
        raise UsdError("bad-usd", f"`{prim.GetPath()}` holds {len(counts)} curves, not one", "split it into one prim per curve")
    bends = len(stage.times) > 1 and (
        curve.GetPointsAttr().ValueMightBeTimeVarying() or curve.GetCurveVertexCountsAttr().ValueMightBeTimeVarying()
    )
    travels = stage.is_moving(prim)
    transforms = stage.compute_scene_transforms(prim, travels)
    first = _read_polyline(curve, stage.first_time, prim)
    if len(first) > limits.MAX_AGENTS:
        raise UsdError("too-large", f"`{prim.GetPath()}` has more than {limits.MAX_AGENTS:,} points")
    times = stage.times if bends or travels else stage.times[:1]
    check_motion_bytes(len(first) * len(times) * 24, f"`{prim.GetPath()}`")
    positions = np.empty((len(times), len(first), 3))
    for k, time in enumerate(times):
        line = _read_polyline(curve, import_pxr_module("Usd").TimeCode(time), prim) if k and bends else first
        if len(line) != len(first):
            raise UsdError("moving-topology", f"the number of points of the curve `{prim.GetPath()}` changes", BAKE_HELP)
        positions[k] = apply_transforms(transforms[min(k, len(transforms) - 1)], line)
    if not np.isfinite(positions).all():
        raise UsdError("bad-usd", f"`{prim.GetPath()}` has a point that is not finite")
    return positions


def _read_polyline(curve: Any, time: Any, prim: Any) -> Floats:
    point_values = curve.GetPointsAttr().Get(time)
    points = np.array([] if point_values is None else point_values, np.float64).reshape(-1, 3)
    counts = list(curve.GetCurveVertexCountsAttr().Get(time) or [])
    if counts != [len(points)] or len(points) < 2:
        raise UsdError("bad-usd", f"`{prim.GetPath()}` has {len(points):,} points, but its curve needs {counts}")
    wrap = curve.GetWrapAttr().Get(time)
    if curve.GetTypeAttr().Get(time) == "linear":
        return np.concatenate([points, points[:1]]) if wrap == "periodic" else points
    basis = curve.GetBasisAttr().Get(time)
    if basis not in _CUBIC_BASES:
        words = f"the curve `{prim.GetPath()}` has the unsupported basis `{basis}`"
        raise UsdError("bad-usd", words, "use bezier, bspline or catmullRom")
    return _cut_cubic(points, basis, wrap, prim)


def _cut_cubic(points: Floats, basis: str, wrap: str, prim: Any) -> Floats:
    """Return points along a cubic curve. Each segment is divided evenly in its parameter."""
    weights, divisor, step = _CUBIC_BASES[basis]
    if wrap == "periodic":
        points = np.concatenate([points, points[: 4 - step]])
    elif wrap == "pinned" and basis != "bezier":
        points = np.concatenate([[2 * points[0] - points[1]], points, [2 * points[-1] - points[-2]]])
    pieces = (len(points) - 4) // step + 1
    if len(points) < 4 or (len(points) - 4) % step:
        raise UsdError("bad-usd", f"`{prim.GetPath()}` has a number of points that no {basis} curve can have")
    t = np.arange(_SEGMENTS_PER_CUBIC) / _SEGMENTS_PER_CUBIC
    powers = np.stack([np.ones_like(t), t, t * t, t * t * t], axis=1)
    factors = np.array(weights, np.float64) / divisor
    share = _sum_arrays(powers[:, k, None] * factors[k] for k in range(4))
    control = points[(np.arange(pieces) * step)[:, None] + np.arange(4)]
    along = _sum_arrays(share[:, k, None] * control[:, k, None, :] for k in range(4)).reshape(-1, 3)
    last = _sum_arrays(factors)
    end = _sum_arrays(last[k] * control[-1, k] for k in range(4))
    return np.concatenate([along, end[None]])


def _sum_arrays(terms: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the sum of arrays. They are added in order, starting with 0."""
    return reduce(np.add, terms, np.zeros(()))
