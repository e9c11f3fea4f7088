"""Points prims and locators as items: where each is at every frame, its radius and its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from antdsl import limits
from antdsl.scene.geometry.matrices import applied, scale
from antdsl.scene.geometry.usd.errors import UsdError, pxr
from antdsl.scene.geometry.usd.shapes import BAKE, check_bytes
from antdsl.scene.geometry.usd.stage import Floats, UsdStage


@dataclass(frozen=True, slots=True, eq=False)
class UsdPoints:
    """`places` (frames, n, 3) in mm, one frame where all stand still. `radius` (n,) in mm, nan where the file says nothing.
    `values`: primvars with one number a point, by name."""

    names: tuple[str, ...]
    places: Floats
    radius: Floats
    values: Mapping[str, Floats]


def read_usd_points(stage: UsdStage) -> UsdPoints:
    """The points of all Points prims at or below the prim; where there are none, its children that have a place, one each."""
    geom = pxr("UsdGeom")
    found = [prim for prim in stage.below(stage.prim) if prim.IsA(geom.Points)]
    parts = [_cloud(stage, prim) for prim in found] or [_locator(stage, prim) for prim in _children(stage)]
    if not parts:
        raise UsdError(
            "no-such-prim", f"there are neither points nor locators below `{stage.prim.GetPath()}`", "name a Points prim"
        )
    counts = [part.places.shape[1] for part in parts]
    if sum(counts) > limits.AGENTS:
        raise UsdError("too-large", f"below `{stage.prim.GetPath()}` are more than {limits.AGENTS:,} points")
    frames = max(len(part.places) for part in parts)
    check_bytes(sum(counts) * frames * 24, f"the points below `{stage.prim.GetPath()}`")
    places = np.concatenate([np.broadcast_to(p.places, (frames, n, 3)) for p, n in zip(parts, counts, strict=True)], axis=1)
    if not np.isfinite(places).all():
        raise UsdError("bad-usd", f"a point below `{stage.prim.GetPath()}` is not finite")
    names = [name for part in parts for name in part.names]
    again = {name for name in names if names.count(name) > 1} if len(names) <= 1000 else set()
    keys = sorted({key for part in parts for key in part.values})
    return UsdPoints(
        names=tuple(f"{name}_{number}" if name in again else name for number, name in enumerate(names)),
        places=places,
        radius=np.concatenate([part.radius for part in parts]),
        values={
            key: np.concatenate([part.values.get(key, np.full(n, np.nan)) for part, n in zip(parts, counts, strict=True)])
            for key in keys
        },
    )


def _cloud(stage: UsdStage, prim: Any) -> UsdPoints:
    points = pxr("UsdGeom").Points(prim)
    attribute, path = points.GetPointsAttr(), prim.GetPath()
    moving = len(stage.times) > 1 and attribute.ValueMightBeTimeVarying()
    ways = stage.matrices(prim, stage.travels(prim))
    count = len(attribute.Get(stage.first) or [])
    times = stage.times if moving or len(ways) > 1 else stage.times[:1]
    check_bytes(count * len(times) * 24, f"`{path}`")
    places = np.empty((len(times), count, 3))
    for k, time in enumerate(times):
        given = np.array(attribute.Get(pxr("Usd").TimeCode(time)) or [], np.float64).reshape(-1, 3)
        if len(given) != count:
            raise UsdError("moving-topology", f"`{path}` has other points at other frames", BAKE)
        places[k] = applied(ways[min(k, len(ways) - 1)], given)
    widths = np.array(points.GetWidthsAttr().Get(stage.first) or [], np.float64)
    one = scale(ways[0])
    width = np.broadcast_to(widths, count) if len(widths) in (1, count) and count else np.full(count, np.nan)
    names = tuple(_names(prim, count))
    return UsdPoints(names, places, width / 2 * one, _numbers(stage, prim, count))


def _names(prim: Any, count: int) -> list[str]:
    """The primvar `name` where it has a word a point, else the prim's name with a number."""
    primvar = pxr("UsdGeom").PrimvarsAPI(prim).GetPrimvar("name")
    words = list(primvar.ComputeFlattened() or []) if primvar and primvar.HasValue() else []
    if len(words) == count and len(set(words)) == count:
        return [str(word)[: limits.NAME_CHARACTERS] for word in words]
    return [prim.GetName()] if count == 1 else [f"{prim.GetName()}_{number}" for number in range(count)]


def _numbers(stage: UsdStage, prim: Any, count: int) -> dict[str, Floats]:
    found = {}
    for primvar in pxr("UsdGeom").PrimvarsAPI(prim).GetPrimvarsWithValues():
        given = primvar.ComputeFlattened(stage.first)
        numbers = np.atleast_1d(np.array(given)) if given is not None else np.empty(0)
        if numbers.dtype.kind in "fiu" and numbers.ndim == 1 and len(numbers) in (1, count):
            found[str(primvar.GetPrimvarName())] = np.broadcast_to(numbers.astype(np.float64), count).copy()
    return found


def _children(stage: UsdStage) -> list[Any]:
    return [
        p
        for p in stage.prim.GetFilteredChildren(pxr("Usd").TraverseInstanceProxies())
        if stage.shown(p) and p.IsA(pxr("UsdGeom").Xformable)
    ]


def _locator(stage: UsdStage, prim: Any) -> UsdPoints:
    ways = stage.matrices(prim, stage.travels(prim))
    return UsdPoints((prim.GetName(),), ways[:, None, :, 3], np.full(1, np.nan), _numbers(stage, prim, 1))
