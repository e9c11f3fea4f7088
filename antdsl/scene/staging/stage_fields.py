"""Staging of the starting values of fields: reads grids of values from files, and converts places to millimetres."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from antdsl import limits
from antdsl.scene import setting as setting_data
from antdsl.scene.document import PathKey
from antdsl.scene.geometry.heights import read_field_values
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.scene_model import FieldGrid, FieldStart
from antdsl.scene.staging.stage_shapes import PointsByName, convert_length, stage_point
from antdsl.scene.thing_models import convert_point

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import SceneStaging


def stage_field_starts(staging: SceneStaging, item_points: PointsByName) -> dict[str, setting_data.FieldStarts]:
    """Return the starting values by field, in mm and in the scene's order. Errors are reported.

    `item_points`: positions (mm) by the name of an item or of a group of items."""
    starts: dict[str, setting_data.FieldStarts] = {}
    for name, each in staging.scene.model.fields.items():
        staged = [_stage_start(staging, item_points, start, "fields", name, number) for number, start in enumerate(each)]
        starts[name] = tuple(start for start in staged if start is not None)
    return starts


def _stage_start(
    staging: SceneStaging, item_points: PointsByName, start: FieldStart | FieldGrid, *path: PathKey
) -> setting_data.FieldStartData | setting_data.FieldGridData | None:
    """Return a starting value, or None after an error."""
    if isinstance(start, FieldGrid):
        return _stage_grid(staging, start, *path)
    centre = stage_point(staging, item_points, start.around, start.radius, *path)
    return setting_data.FieldStartData(start.start, centre, convert_length(staging.scene, start.radius), start.on)


def _stage_grid(staging: SceneStaging, grid: FieldGrid, *path: PathKey) -> setting_data.FieldGridData | None:
    """Return the values in a file. On failure, report an error and return None."""
    declared = staging.program.fields.get(str(path[1]))
    data = staging.read_file(grid.values, limits.MAX_MESH_BYTES, *path, "values")
    if data is None or declared is None:
        return None
    unit_mm, span = staging.scene.model.unit_mm, staging.scene.find_span(*path, "values")
    try:
        samples = read_field_values(data, grid.values, grid.array, grid.layer, declared.has_vectors)
        values = grid.offset + grid.scale * samples
        wrong = np.argwhere((np.abs(values) > limits.MAX_FIELD_START) | (values < (-np.inf if declared.has_vectors else 0.0)))
        if len(wrong):
            row, column = (int(index) for index in wrong[0, :2])
            value = np.atleast_1d(values[row, column])[wrong[0, 2] if declared.has_vectors else 0]
            low = f"{-limits.MAX_FIELD_START:g}" if declared.has_vectors else "0"
            words = f"gives {value:g} in row {row}, column {column}"
            raise MeshError(words, f"values go from {low} to {limits.MAX_FIELD_START:g}: change `scale` or `offset`")
    except MeshError as error:
        staging.report.error("bad-paint", f"`{grid.values}` {error}", span, error.help)
        return None
    extent = None if grid.extent is None else (grid.extent[0].to_millimetres(unit_mm), grid.extent[1].to_millimetres(unit_mm))
    return setting_data.FieldGridData(values, extent, None if grid.at is None else convert_point(grid.at, unit_mm), grid.on)
