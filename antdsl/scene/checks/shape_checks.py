"""Checks placements in crowd lines: shapes that exclude each other, and the directions in which agents start."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.model import Program
from antdsl.program.tables.things import MESH_GROUND_KIND
from antdsl.scene.checks.entry_checks import report_unknown_name
from antdsl.scene.crowds.casting_model import FACING_WORDS, FacingDirection
from antdsl.scene.crowds.crowd_model import Placement
from antdsl.scene.document import PathKey
from antdsl.scene.load import Scene
from antdsl.scene.notes.selectors import Ball

_KEY_BY_FIELD = {"volume": "in"}  # keys that are no names in Python
_SHAPE_FIELDS = ("points", "inside", "along", "edge", "volume", "ranks")  # of which a place has one at most


def collect_item_declarations(scene: Scene) -> dict[str, tuple[str, str]]:
    """Return the item names that `around` accepts. Each name maps to a pair: the name of the group, and the name of an item in
    it.

    The name of a group itself is also accepted and maps to the first item of the group."""
    names: dict[str, tuple[str, str]] = {}
    for name, value in scene.model.world.items():
        if isinstance(value, dict) and value:
            names[name] = (name, next(iter(value)))
    for name, value in scene.model.world.items():
        if isinstance(value, dict):
            for item in value:
                names.setdefault(item, (name, item))
    return names


def check_placement_shapes(scene: Scene, program: Program, report: Report, place: Placement, *path: PathKey) -> None:
    """Report shapes of a placement that exclude each other, unknown names in the shapes, and a `facing` that does not fit the
    shape."""
    shapes = [name for name in _SHAPE_FIELDS if getattr(place, name) is not None]
    disc = ["around"] if place.around is not None and place.ranks is None else []
    disc += ["radius"] if place.radius is not None and place.along is None and place.edge is None else []
    density = ["density"] if place.density is not None else []
    if (shapes and shapes[0] in ("along", "edge", "volume", "ranks")) or len(shapes) > 1:
        for other in [*shapes[1:], *disc, *density]:
            one, two = (_KEY_BY_FIELD.get(name, name) for name in (shapes[0], other))
            place_of = scene.find_span(*path, two, key=True)
            report.error("wrong-value", f"agents are placed by `{one}` or by `{two}`, not both", place_of, "keep one of them")
    if place.clumps is not None and shapes and shapes[0] in ("points", "inside", "ranks"):
        words = f"agents at `{shapes[0]}` have fixed positions, so `clumps` has no effect"
        report.error("wrong-value", words, scene.find_span(*path, "clumps", key=True), "leave `clumps` out")
    curves = program.list_things_of_kind("curve")
    if place.along is not None and place.along not in curves:
        report_unknown_name(report, scene, (*path, "along"), "no curve is named", curves, key=False)
    surfaces = program.list_things_of_kind(MESH_GROUND_KIND)
    if place.edge is not None and place.edge not in surfaces:
        report_unknown_name(report, scene, (*path, "edge"), "no surface is named", surfaces, key=False)
    items = collect_item_declarations(scene)
    around = place.volume.around if isinstance(place.volume, Ball) else None
    if isinstance(around, str) and around not in items and not scene.model.has_usd_items:
        report_unknown_name(report, scene, (*path, "in", "around"), "no item is named", items, key=False)
    _check_facing(scene, report, place, items, *path)


def _check_facing(scene: Scene, report: Report, place: Placement, items: dict[str, tuple[str, str]], *path: PathKey) -> None:
    """Report a `facing` that makes no sense for its placement."""
    facing, span = place.facing, scene.find_span(*path, "facing")
    if isinstance(facing, FacingDirection):
        if not any(facing.direction):
            report.error("wrong-value", "`[0, 0, 0]` leads nowhere", span, "write a direction, such as `[1, 0, 0]`")
    elif facing == "along" and place.along is None and place.edge is None:
        report.error("wrong-value", "`facing: along` has no line to follow", span, "place agents `along` a curve or an `edge`")
    elif facing in ("out", "in") and not _has_placement_centre(place):
        help = "add `around` and `radius`, or write a point or `{direction: [1, 0, 0]}`"
        report.error("wrong-value", f"`facing: {facing}` has no centre here", span, help)
    elif isinstance(facing, str) and facing not in (*FACING_WORDS, *items) and not scene.model.has_usd_items:
        words = "no direction or item is named"
        report_unknown_name(report, scene, (*path, "facing"), words, [*FACING_WORDS, *items], key=False)


def _has_placement_centre(place: Placement) -> bool:
    """Return whether a placement has a centre or a line from which `facing: out` can lead away."""
    keys = ("around", "radius", "inside", "along", "edge", "volume")
    return any(getattr(place, key) is not None for key in keys)
