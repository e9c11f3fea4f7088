"""Staging of the placements of crowd lines: ranks, clumps, lines and volumes, and the directions that agents face at the
start."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.scene import setting as setting_data
from antdsl.scene.crowds.casting_model import FACING_WORDS, FacingDirection, FacingValue, RankFormation
from antdsl.scene.crowds.crowd_data import ClumpsData, FacingData, ItemCentre, RanksData, VolumeData
from antdsl.scene.crowds.crowd_model import Placement
from antdsl.scene.document import PathKey
from antdsl.scene.load import Scene
from antdsl.scene.notes.selectors import Box, Region
from antdsl.scene.quantities import Quantity
from antdsl.scene.thing_models import convert_point
from antdsl.scene.values import PointValue

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import SceneStaging


def convert_length(scene: Scene, value: Quantity | None) -> float | None:
    """Return a length of the scene in mm, or None if `value` is None."""
    return None if value is None else value.to_millimetres(scene.model.unit_mm)


PointsByName = Mapping[str, setting_data.PointMm]


def stage_point(
    staging: SceneStaging,
    item_points: PointsByName,
    around: PointValue | str | None,
    radius: Quantity | None,
    *path: PathKey,
    key: str = "around",
) -> setting_data.PointMm | None:
    """Return a centre in mm. It is a point, the position of an item, or the origin if there is only a radius. Return None
    without a centre or after an error."""
    if around is None:
        return None if radius is None else (0.0, 0.0, 0.0)
    if not isinstance(around, str):
        return convert_point(around, staging.scene.model.unit_mm)
    if around not in item_points and staging.report.ok:
        near = find_nearest_name(around, item_points)
        help = f"did you mean `{near}`?" if near else None
        staging.report.error("unknown-thing", f"no item is named `{around}`", staging.scene.find_span(*path, key), help)
    return item_points.get(around)


def stage_shapes(staging: SceneStaging, item_points: PointsByName, placement: Placement, *path: PathKey) -> dict[str, Any]:
    """Return those fields of `PlacementData` that define shapes and directions, by field name."""
    scene, clumps = staging.scene, placement.clumps
    return {
        "ranks": None if placement.ranks is None else _stage_ranks(scene, placement.ranks, int(path[1])),
        "curve_name": placement.along,
        "border_surface": placement.edge,
        "volume": None if placement.volume is None else _stage_volume(staging, item_points, placement.volume, *path),
        "clumps": None if clumps is None else ClumpsData(clumps.number, _convert_required_length(scene, clumps.radius)),
        "facing": None if placement.facing is None else _stage_facing(staging, item_points, placement.facing, *path),
        "centre_item": _find_centre_item(staging, placement.around),
    }


def _convert_required_length(scene: Scene, value: Quantity) -> float:
    return value.to_millimetres(scene.model.unit_mm)


def _stage_ranks(scene: Scene, ranks: RankFormation, number: int) -> RanksData:
    """Return ranks with as many rows as the agents of a crowd line need. `number`: the index of the crowd line."""
    model = scene.model
    count = model.crowd[number].count_agents(model.frames.first, model.fps)
    across, along = ranks.spacing if isinstance(ranks.spacing, tuple) else (ranks.spacing, ranks.spacing)
    columns = min(ranks.columns, max(count, 1))
    return RanksData(
        columns, -(-count // columns), _convert_required_length(scene, across), _convert_required_length(scene, along)
    )


def _stage_volume(staging: SceneStaging, item_points: PointsByName, volume: Region, *path: PathKey) -> VolumeData | None:
    """Return a box or a ball in mm, or None after an error."""
    unit_mm = staging.scene.model.unit_mm
    if isinstance(volume, Box):
        corner, opposite = convert_point(volume.corner, unit_mm), convert_point(volume.opposite, unit_mm)
        (x, to_x), (y, to_y), (z, to_z) = (sorted(pair) for pair in zip(corner, opposite, strict=True))
        return VolumeData((x, y, z), (to_x, to_y, to_z))
    centre = stage_point(staging, item_points, volume.around, volume.radius, *path, "in")
    return None if centre is None else VolumeData(centre, radius=_convert_required_length(staging.scene, volume.radius))


def _stage_facing(staging: SceneStaging, item_points: PointsByName, facing: FacingValue, *path: PathKey) -> FacingData | None:
    """Return the direction that agents face at the start, in mm and the scene's axes, or None after an error."""
    if isinstance(facing, FacingDirection):
        x, y, z = facing.direction
        size = math.sqrt((x * x + y * y) + z * z)
        return FacingData("direction", (x / size, y / size, z / size))
    if isinstance(facing, str) and facing in FACING_WORDS:
        return FacingData(facing)  # type: ignore[arg-type]
    point = stage_point(staging, item_points, facing, None, *path, key="facing")
    return None if point is None else FacingData("point", point)


def _find_centre_item(staging: SceneStaging, around: PointValue | str | None) -> ItemCentre | None:
    """Return the item that is the centre of a placement, or None if the centre is not an item."""
    if not isinstance(around, str):
        return None
    for name, items in staging.items.items():
        names = [item.name for item in items]
        if items and (around == name or around in names):
            return ItemCentre(name, 0 if around == name else names.index(around))
    return None
