"""Reads Points prims and empties as items: positions at each frame, directions, radii, numbers and words."""

from __future__ import annotations

from typing import Any

import numpy as np

from antdsl import limits
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.scene.geometry.matrices import apply_transforms, find_uniform_scale
from antdsl.scene.geometry.usd.child.shapes import BAKE_HELP, check_motion_bytes
from antdsl.scene.geometry.usd.child.stage import Floats, OpenStage
from antdsl.scene.geometry.usd.errors import UsdError, import_pxr_module
from antdsl.scene.geometry.usd.points import UsdPoints

_USER_NAMESPACE = "userProperties"  # the namespace into which Blender, Maya and others export custom properties of objects
_MAX_LISTED_KINDS = 12


def read_point_arrays(stage: OpenStage, kind: str | None = None) -> UsdPoints:
    """Return the points of all Points prims at or below the stage's prim. If there are no Points prims, return one point for
    each child prim with a position.

    `kind`: if set, return instead all prims at any depth below the stage's prim that have this `userProperties:kind`."""
    geom = import_pxr_module("UsdGeom")
    clouds = [prim for prim in stage.find_visible_prims(stage.prim) if prim.IsA(geom.Points)] if kind is None else []
    empties = [] if clouds else _find_placed_children(stage) if kind is None else _find_prims_of_kind(stage, kind)
    if len(empties) > limits.MAX_AGENTS:
        raise UsdError("too-large", f"there are more than {limits.MAX_AGENTS:,} places below `{stage.prim.GetPath()}`")
    check_motion_bytes(len(empties) * len(stage.times) * 24, f"the places below `{stage.prim.GetPath()}`")
    parts = [_read_points_prim(stage, prim) for prim in clouds] or [_read_empty(stage, prim) for prim in empties]
    if not parts:
        message = f"there are neither points nor empties below `{stage.prim.GetPath()}`"
        raise UsdError("no-such-prim", message, "name a Points prim")
    counts = [part.positions.shape[1] for part in parts]
    if sum(counts) > limits.MAX_AGENTS:
        raise UsdError("too-large", f"there are more than {limits.MAX_AGENTS:,} points below `{stage.prim.GetPath()}`")
    frames = max(len(part.positions) for part in parts)
    check_motion_bytes(sum(counts) * frames * 24, f"the points below `{stage.prim.GetPath()}`")
    positions = np.concatenate([np.broadcast_to(p.positions, (frames, n, 3)) for p, n in zip(parts, counts, strict=True)], axis=1)
    if not np.isfinite(positions).all():
        raise UsdError("bad-usd", f"a point below `{stage.prim.GetPath()}` is not finite")
    names = [name for part in parts for name in part.names]
    again = {name for name in names if names.count(name) > 1} if len(names) <= 1000 else set()
    keys = sorted({key for part in parts for key in part.values})
    words = sorted({key for part in parts for key in part.texts})
    return UsdPoints(
        names=tuple(f"{name}_{number}" if name in again else name for number, name in enumerate(names)),
        positions=positions,
        radius=np.concatenate([part.radius for part in parts]),
        values={
            key: np.concatenate([part.values.get(key, np.full(n, np.nan)) for part, n in zip(parts, counts, strict=True)])
            for key in keys
        },
        texts={
            key: tuple(text for part, n in zip(parts, counts, strict=True) for text in part.texts.get(key, ("",) * n))
            for key in words
        },
        ahead=np.concatenate([part.ahead for part in parts]),
        unit=find_uniform_scale(stage.to_scene),
    )


def _read_points_prim(stage: OpenStage, prim: Any) -> UsdPoints:
    """Return the points of a Points prim."""
    points = import_pxr_module("UsdGeom").Points(prim)
    attribute, path = points.GetPointsAttr(), prim.GetPath()
    moving = len(stage.times) > 1 and attribute.ValueMightBeTimeVarying()
    transforms = stage.compute_scene_transforms(prim, stage.is_moving(prim))
    count = len(attribute.Get(stage.first_time) or [])
    times = stage.times if moving or len(transforms) > 1 else stage.times[:1]
    check_motion_bytes(count * len(times) * 24, f"`{path}`")
    positions = np.empty((len(times), count, 3))
    for k, time in enumerate(times):
        frame_points = np.array(attribute.Get(import_pxr_module("Usd").TimeCode(time)) or [], np.float64).reshape(-1, 3)
        if len(frame_points) != count:
            raise UsdError("moving-topology", f"the number of points of `{path}` changes between frames", BAKE_HELP)
        positions[k] = apply_transforms(transforms[min(k, len(transforms) - 1)], frame_points)
    widths = np.array(points.GetWidthsAttr().Get(stage.first_time) or [], np.float64)
    one = find_uniform_scale(transforms[0])
    width = np.broadcast_to(widths, count) if len(widths) in (1, count) and count else np.full(count, np.nan)
    names = tuple(_read_point_names(prim, count))
    values = _read_numeric_primvars(stage, prim, count)
    return UsdPoints(
        names, positions, width / 2 * one, values, {}, np.full((count, 3), np.nan), find_uniform_scale(stage.to_scene)
    )


def _read_point_names(prim: Any, count: int) -> list[str]:
    """Return the primvar `name` if it has one word per point, else the name of the prim with a number for each point."""
    primvar = import_pxr_module("UsdGeom").PrimvarsAPI(prim).GetPrimvar("name")
    words = list(primvar.ComputeFlattened() or []) if primvar and primvar.HasValue() else []
    if len(words) == count and len(set(words)) == count:
        return [str(word)[: limits.MAX_NAME_CHARACTERS] for word in words]
    return [prim.GetName()] if count == 1 else [f"{prim.GetName()}_{number}" for number in range(count)]


def _read_numeric_primvars(stage: OpenStage, prim: Any, count: int) -> dict[str, Floats]:
    """Return, by name, the primvars of a prim that have one number, or one number per point, as arrays (count,)."""
    values_by_name = {}
    for primvar in import_pxr_module("UsdGeom").PrimvarsAPI(prim).GetPrimvarsWithValues():
        value = primvar.ComputeFlattened(stage.first_time)
        numbers = np.atleast_1d(np.array(value)) if value is not None else np.empty(0)
        if numbers.dtype.kind in "fiu" and numbers.ndim == 1 and len(numbers) in (1, count):
            values_by_name[str(primvar.GetPrimvarName())] = np.broadcast_to(numbers.astype(np.float64), count).copy()
    return values_by_name


def _find_placed_children(stage: OpenStage) -> list[Any]:
    """Return the visible children of the stage's prim that can have a position."""
    return [
        p
        for p in stage.prim.GetFilteredChildren(import_pxr_module("Usd").TraverseInstanceProxies())
        if stage.is_visible(p) and p.IsA(import_pxr_module("UsdGeom").Xformable)
    ]


def _find_prims_of_kind(stage: OpenStage, kind: str) -> list[Any]:
    """Return the prims below the stage's prim that declare the kind `kind`. If there are none, raise a UsdError that lists the
    existing kinds."""
    prims: list[Any] = []
    others: set[str] = set()
    for prim in stage.find_visible_prims(stage.prim):
        attribute = prim.GetAttribute(f"{_USER_NAMESPACE}:kind")
        word = attribute.Get(stage.first_time) if attribute and attribute.HasValue() else None
        if word is not None and str(word) == kind and prim.IsA(import_pxr_module("UsdGeom").Xformable):
            prims.append(prim)
        elif word is not None and len(others) < _MAX_LISTED_KINDS:
            others.add(str(word)[: limits.MAX_NAME_CHARACTERS])
    if prims:
        return prims
    where, near = stage.prim.GetPath(), find_nearest_name(kind, others)
    if near:
        help = f"did you mean `kind: {near}`?"
    elif others:
        help = "there are the kinds " + ", ".join(f"`{word}`" for word in sorted(others))
    else:
        help = f'give empties the property `kind` with the text "{kind}", or name the prim above them: `prim: /set/{kind}`'
    raise UsdError("no-such-prim", f'nothing below `{where}` has `{_USER_NAMESPACE}:kind = "{kind}"`', help, "kind")


def _read_empty(stage: OpenStage, prim: Any) -> UsdPoints:
    """Return a prim that has only a position (an Xform, a locator, or an empty of Blender) as one point."""
    transforms = stage.compute_scene_transforms(prim, stage.is_moving(prim))
    values = _read_numeric_primvars(stage, prim, 1)
    texts: dict[str, tuple[str, ...]] = {}
    for attribute in prim.GetAuthoredPropertiesInNamespace(_USER_NAMESPACE):
        name = str(attribute.GetName()).removeprefix(f"{_USER_NAMESPACE}:")
        value = attribute.Get(stage.first_time) if ":" not in name and hasattr(attribute, "HasValue") else None
        if isinstance(value, float) and not np.isfinite(value):
            words = f"`{name}` of `{prim.GetPath()}` is {value:g}, which is not finite"
            raise UsdError("bad-usd", words, "give it a finite one", "usd")
        if isinstance(value, bool | int | float):
            values[name] = np.full(1, float(value))
        elif isinstance(value, str) and len(value) <= limits.MAX_NAME_CHARACTERS:
            texts[name] = (value,)
    return UsdPoints(
        (prim.GetName(),),
        transforms[:, None, :, 3],
        np.full(1, np.nan),
        values,
        texts,
        transforms[:1, :, 0],
        find_uniform_scale(stage.to_scene),
    )
