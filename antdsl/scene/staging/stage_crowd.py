"""Lines of a scene's crowd: where their agents begin, and a way that they are led."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from antdsl.diagnostics.suggestion import nearest_name
from antdsl.scene import setting as stage_of
from antdsl.scene.crowd_model import Placement, UsdPlaces, Walk
from antdsl.scene.document import Key
from antdsl.scene.load import Scene
from antdsl.scene.model import Point, millimetres
from antdsl.scene.quantities import Quantity
from antdsl.scene.staging.stage_things import usd_places

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import Staging


def length(scene: Scene, value: Quantity | None) -> float | None:
    return None if value is None else value.length(scene.model.unit_mm)


Places = Mapping[str, stage_of.Point]


def point(
    staging: Staging, places: Places, around: Point | str | None, radius: Quantity | None, *path: Key, key: str = "around"
) -> stage_of.Point | None:
    """Where something lies about: a point, an item's place, the origin where only a radius is given."""
    if around is None:
        return None if radius is None else (0.0, 0.0, 0.0)
    if not isinstance(around, str):
        return millimetres(around, staging.scene.model.unit_mm)
    if around not in places and staging.report.ok:
        near = nearest_name(around, places)
        help = f"did you mean `{near}`?" if near else None
        staging.report.error("unknown-thing", f"no item is named `{around}`", staging.scene.span(*path, key), help)
    return places.get(around)


def place(staging: Staging, places: Places, place: Placement, *path: Key) -> stage_of.PlaceData:
    scene = staging.scene
    points = None
    if isinstance(place.points, UsdPlaces):
        points = usd_places(staging, place.points, *path)
    elif place.points is not None:
        points = staging.points(place.points, 1, *path, "points")
        if points is not None:
            points = points * scene.model.unit_mm
    return stage_of.PlaceData(
        on=(place.on,) if place.on is not None else (),
        around=point(staging, places, place.around, place.radius, *path),
        inside=point(staging, places, place.inside, None, *path, key="inside"),
        radius=length(scene, place.radius),
        points=points,
        density=place.density,
        by_area=place.by == "area",
        apart=_apart(scene, place.apart),
        seed=place.seed,
    )


def walk(scene: Scene, walk: Walk | None) -> stage_of.WalkData | None:
    if walk is None:
        return None
    model = scene.model
    x, y, z = walk.direction
    size = math.sqrt((x * x + y * y) + z * z)
    speed = walk.speed.length(model.unit_mm) if walk.speed.bare else walk.speed.base(model.unit_mm, float(1 / model.fps))
    return stage_of.WalkData((x / size, y / size, z / size), speed, walk.length.length(model.unit_mm))


def _apart(scene: Scene, apart: Quantity | str | None) -> float:
    """How far apart (mm) agents of a line begin; inf: evenly."""
    if isinstance(apart, str):
        return math.inf
    return length(scene, apart) or 0.0
