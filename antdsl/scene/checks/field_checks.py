"""Checks of the starting values of fields in a scene."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.model import Field
from antdsl.scene.checks.entry_checks import check_file, report_unknown_name
from antdsl.scene.crowds.crowd_checks import check_around
from antdsl.scene.document import PathKey
from antdsl.scene.load import Scene
from antdsl.scene.scene_model import FieldGrid, FieldStart

_WIDTH_TOLERANCE = 1e-9  # share of the width of a periodic world; exceeds the rounding of lengths


def check_field_start(
    scene: Scene, report: Report, start: FieldStart | FieldGrid, declared: Field | None, *path: PathKey
) -> None:
    """Report a starting value that does not suit its field. `declared`: the field; None if no program has it."""
    if declared is not None and start.on is not None and start.on not in declared.surfaces:
        report_unknown_name(report, scene, (*path, "on"), f"`{declared.name}` has no surface", declared.surfaces, key=False)
    if isinstance(start, FieldStart):
        check_around(scene, report, start.around, start.radius, *path)
        if declared is not None and declared.has_vectors != isinstance(start.start, tuple):
            kinds = ("vector", "numbers", "0") if isinstance(start.start, tuple) else ("number", "vectors", "[1, 0, 0]")
            words = f"`start` is a {kinds[0]}, but the cells of `{declared.name}` hold {kinds[1]}"
            report.error("wrong-value", words, scene.find_span(*path, "start"), f"write `start: {kinds[2]}`")
        return
    check_file(scene, report, start.values, *path, "values")
    if declared is not None and declared.has_vectors and start.offset:
        words = f"`offset` is a number, but the cells of `{declared.name}` hold vectors"
        report.error("wrong-value", words, scene.find_span(*path, "offset"), "leave `offset` out")
    _check_grid_width(scene, report, start, *path)


def _check_grid_width(scene: Scene, report: Report, grid: FieldGrid, *path: PathKey) -> None:
    """Report a grid that is wider than a periodic world, because it would overlap itself."""
    if scene.model.wrap is None or grid.extent is None:
        return
    unit_mm = scene.model.unit_mm
    for k, axis in enumerate(("x", "z" if scene.model.up == "y" else "y")):
        ends = getattr(scene.model.wrap, axis)
        if ends is None:
            continue
        width = ends[1].to_millimetres(unit_mm) - ends[0].to_millimetres(unit_mm)
        extent = grid.extent[k].to_millimetres(unit_mm)
        if extent > width * (1 + _WIDTH_TOLERANCE):
            words = f"the grid is {extent:g} mm wide along `{axis}`, but the world repeats after {width:g} mm"
            report.error("wrong-value", words, scene.find_span(*path, "extent", k), f"write {width:g} mm or less")
