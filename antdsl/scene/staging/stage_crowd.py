"""Staging of crowd lines: when and where their agents start, with which attributes, and their scripted walks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.diagnostics import Report
from antdsl.program.model import Dimension, TypeKind
from antdsl.scene import setting as setting_data
from antdsl.scene.crowds.crowd_data import ReleaseData
from antdsl.scene.crowds.crowd_model import Placement, ScriptedWalk, UsdPositions
from antdsl.scene.crowds.initial_values import stage_initial_values
from antdsl.scene.document import PathKey
from antdsl.scene.library_bodies import BODY_WORDS
from antdsl.scene.load import Scene
from antdsl.scene.quantities import Quantity
from antdsl.scene.staging.stage_shapes import PointsByName, convert_length, stage_point, stage_shapes
from antdsl.scene.staging.stage_things import stage_usd_places
from antdsl.scene.staging.usd_values import UsdFile, read_in_base_units, warn_misspelled_names

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import SceneStaging


def stage_crowd(staging: SceneStaging, item_points: PointsByName, number: int) -> setting_data.CrowdData:
    """Return the data of a crowd line of the scene. Errors are added to the report. `number`: the index of the line."""
    scene = staging.scene
    model, line = scene.model, scene.model.crowd[number]
    begin, interval, count = line.find_release(model.frames.first, model.fps)
    return setting_data.CrowdData(
        line.species,
        count,
        stage_placement(staging, item_points, line.place, "crowd", number, "place"),
        number,
        stage_walk(scene, line.walk),
        _find_single_library_body(line.body_weights),
        line.list_worn_layers(),
        line.name or "",
        None if line.frames is None and line.seconds is None else ReleaseData(begin, interval),
        stage_initial_values(scene, staging.program, Report(), number),
    )


def _find_single_library_body(weights: Mapping[str, float]) -> str:
    """Return the name of the crowd line's body if the line has exactly one body and the body is from the library. Otherwise
    return ""."""
    return next((text for text in weights if len(weights) == 1 and text in BODY_WORDS), "")


def stage_placement(
    staging: SceneStaging, item_points: PointsByName, placement: Placement, *path: PathKey
) -> setting_data.PlacementData:
    """Return the starting positions of a crowd line, in mm and the scene's axes. Errors are added to the report."""
    scene = staging.scene
    points, ahead, values = None, None, {}
    if isinstance(placement.points, UsdPositions):
        usd_points = stage_usd_places(staging, placement.points, *path)
        if usd_points is not None:
            file = UsdFile(staging, placement.points.usd, scene.find_span(*path, "points", "usd"), usd_points)
            points, ahead, values = (
                usd_points.positions[0],
                _normalise_rows(usd_points.ahead),
                _read_usd_attributes(file, scene.model.crowd[int(path[1])].species),
            )
    elif placement.points is not None:
        points = staging.read_points(placement.points, 1, *path, "points")
        if points is not None:
            points = points * scene.model.unit_mm
    return setting_data.PlacementData(
        surfaces=(placement.on,) if placement.on is not None else (),
        disc_centre=stage_point(staging, item_points, placement.around, placement.radius, *path),
        ray_origin=stage_point(staging, item_points, placement.inside, None, *path, key="inside"),
        radius=convert_length(scene, placement.radius),
        points=points,
        density=placement.density,
        is_by_area=placement.by == "area",
        spacing=_read_spacing(scene, placement.apart),
        seed=placement.seed,
        headings=ahead,
        values=values,
        **stage_shapes(staging, item_points, placement, *path),
    )


def _normalise_rows(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors (n, 3) scaled to length 1. Zero vectors become nan."""
    size = np.sqrt((vectors[:, 0] * vectors[:, 0] + vectors[:, 1] * vectors[:, 1]) + vectors[:, 2] * vectors[:, 2])
    unit_vectors: NDArray[np.float64] = vectors / np.where(size > 0, size, np.nan)[:, None]
    return unit_vectors


def _read_usd_attributes(file: UsdFile, species: str) -> dict[str, NDArray[np.float64]]:
    """Return, by name, the attributes of a species for which the points or empties in the file have values."""
    declared = file.staging.program.species[species].attributes
    own = {a.name: a.type.dimension for a in declared if a.type.kind is TypeKind.NUMBER and not a.pair_species}
    own |= {a.name: Dimension() for a in declared if a.type.kind is TypeKind.BOOL}
    columns = {name: read_in_base_units(file, name, dim) for name, dim in own.items()}
    warn_misspelled_names(file, species, own)
    return {name: column for name, column in columns.items() if np.isfinite(column).any()}


def stage_walk(scene: Scene, walk: ScriptedWalk | None) -> setting_data.ScriptedWalkData | None:
    """Return a scripted walk with a unit direction, in mm and seconds, or None if there is no walk."""
    if walk is None:
        return None
    model = scene.model
    x, y, z = walk.direction
    size = math.sqrt((x * x + y * y) + z * z)
    speed = (
        walk.speed.to_millimetres(model.unit_mm)
        if walk.speed.has_no_unit
        else walk.speed.to_base_units(model.unit_mm, float(1 / model.fps))
    )
    return setting_data.ScriptedWalkData((x / size, y / size, z / size), speed, walk.length.to_millimetres(model.unit_mm))


def _read_spacing(scene: Scene, spacing: Quantity | str | None) -> float:
    """Return the smallest distance (mm) between agents of a crowd line at the start. The result inf means that agents are
    distributed evenly."""
    if isinstance(spacing, str):
        return math.inf
    return convert_length(scene, spacing) or 0.0
