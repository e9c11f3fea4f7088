"""Checks of a scene's crowd lines against a program: names, numbers, placements and values at birth."""

from __future__ import annotations

from antdsl import limits
from antdsl.diagnostics import Label, Report
from antdsl.program.model import Program
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.scene.checks.entry_checks import check_file, check_map_name, report_unknown_name
from antdsl.scene.checks.shape_checks import check_placement_shapes, collect_item_declarations
from antdsl.scene.crowds.crowd_model import Placement, UsdPositions
from antdsl.scene.crowds.initial_values import stage_initial_values
from antdsl.scene.document import PathKey
from antdsl.scene.load import Scene


def count_agents(scene: Scene) -> list[int]:
    """Return, for each crowd line, how many agents it creates in total."""
    model = scene.model
    return [line.count_agents(model.frames.first, model.fps) for line in model.crowd]


def check_crowd(scene: Scene, program: Program, report: Report) -> None:
    """Report names, numbers, placements and values of crowd lines that do not match the program. Also report too many agents."""
    total = sum(count_agents(scene))
    for number, line in enumerate(scene.model.crowd):
        _check_line_name(scene, program, report, number)
        _check_release(scene, report, number)
        if line.species not in program.species:
            report_unknown_name(
                report, scene, ("crowd", number, "species"), "no program has a species", program.species, key=False
            )
        _check_placement(scene, program, report, line.place, "crowd", number, "place")
        if line.walk is not None and not any(line.walk.direction):
            where = scene.find_span("crowd", number, "walk", "direction")
            report.error("wrong-value", "`[0, 0, 0]` leads nowhere", where, "write a direction, such as `[1, 0, 0]`")
        stage_initial_values(scene, program, report, number)
    if total > limits.MAX_AGENTS:
        report.error(
            "too-large",
            f"{total:,} agents are more than {limits.MAX_AGENTS:,}",
            scene.find_span("crowd"),
            "write a smaller `count` or `rate`",
        )


def _check_release(scene: Scene, report: Report, number: int) -> None:
    """Report a rate that creates no agents, and frames outside the range of the scene."""
    model, line = scene.model, scene.model.crowd[number]
    key = "frames" if line.frames is not None else "seconds"
    if getattr(line, key) is None:
        return
    begin, interval, count = line.find_release(model.frames.first, model.fps)
    start = model.frames.first - model.preroll
    end = begin + interval * max(count - 1, 0)
    place = scene.find_span("crowd", number, key)
    if not count and line.rate is not None:
        help = "write a larger `rate` or more frames"
        report.error(
            "wrong-value", f"`{line.rate.text}` creates no agent in this time", scene.find_span("crowd", number, "rate"), help
        )
    elif begin >= model.frames.last + 1:
        help = f"write frames between {start} and {model.frames.last}"
        report.warning("out-of-range", f"the scene ends at frame {model.frames.last}, before any of these agents", place, help)
    elif count and end < start:
        help = f"write frames between {start} and {model.frames.last}, or remove `frames`"
        report.warning(
            "out-of-range", f"the scene begins at frame {start}, so all of these agents are there at once", place, help
        )


def _check_line_name(scene: Scene, program: Program, report: Report, number: int) -> None:
    """Report the name of a crowd line if it is already the name of something else."""
    name = scene.model.crowd[number].name
    earlier = [k for k, line in enumerate(scene.model.crowd[:number]) if line.name == name]
    taken = {**dict.fromkeys(collect_item_declarations(scene), "an item"), **dict.fromkeys(program.species, "a species")}
    if name in taken:
        help = f"write another name, such as `{name}_line`"
        report.error("duplicate-name", f"`{name}` is the name of {taken[name]}", scene.find_span("crowd", number, "name"), help)
    elif name is not None and earlier:
        label = Label(scene.find_span("crowd", earlier[0], "name"), "here first")
        help = f"write another name, such as `{name}_{number + 1}`"
        place = scene.find_span("crowd", number, "name")
        report.error("duplicate-name", f"two lines of the crowd are named `{name}`", place, help, labels=(label,))


def check_around(scene: Scene, report: Report, around: object, radius: object, *path: PathKey) -> None:
    """Report an `around` that names no item, or an `around` without a `radius`."""
    if isinstance(around, str) and around not in collect_item_declarations(scene) and not scene.model.has_usd_items:
        report_unknown_name(report, scene, (*path, "around"), "no item is named", collect_item_declarations(scene), key=False)
    if around is not None and radius is None:
        at = scene.find_span(*path, "around", key=True)
        report.error("missing-key", "`around` has no effect without `radius`", at, "add `radius: 50 mm`")


def _check_placement(scene: Scene, program: Program, report: Report, place: Placement, *path: PathKey) -> None:
    grounds = [name for name, thing in program.world.items() if KIND_BY_WORD[thing.kind].is_ground]
    if place.on is not None and place.on not in grounds:
        report_unknown_name(report, scene, (*path, "on"), "no surface is named", grounds, key=False)
    if place.points is not None:
        if isinstance(place.points, UsdPositions):
            check_file(scene, report, place.points.usd, *path, "points", "usd")
        else:
            check_file(scene, report, place.points, *path, "points")
        if place.around is not None:
            words = "agents are placed at points or around a place, not both"
            report.error("wrong-value", words, scene.find_span(*path, "around", key=True), "keep one of them")
    if place.density is not None:
        check_map_name(scene, report, program, place.density, *path, "density")
    check_placement_shapes(scene, program, report, place, *path)
    used_keys = [name for name in ("points", "around", "radius", "density") if getattr(place, name) is not None]
    for method in ("density", "inside"):
        other = [name for name in used_keys if name != method]
        if getattr(place, method) is not None and other:
            words = f"agents are placed by `{method}` or by `{other[0]}`, not both"
            report.error("wrong-value", words, scene.find_span(*path, method, key=True), "keep one of them")
    if place.by == "area" and place.inside is not None:
        words = "agents that start `inside` are placed along lines from there, not by area"
        report.error("wrong-value", words, scene.find_span(*path, "by", key=True), "leave `by` out")
    for key in ("apart", "seed"):
        fixed_key = "points" if place.points is not None else "ranks" if place.ranks is not None else None
        if getattr(place, key) is not None and fixed_key is not None:
            words = f"agents at `{fixed_key}` have fixed positions, so `{key}` has no effect"
            report.error("wrong-value", words, scene.find_span(*path, key, key=True), f"leave `{key}` out")
    if place.apart == "even" and (place.inside is not None or (place.density is not None and place.by != "area")):
        what, addition = ("inside", "") if place.inside is not None else ("by `density` from above", ", or add `by: area`")
        advice = f"write a length, such as `apart: 10 mm`{addition}"
        report.error("wrong-value", f"the available space {what} is unknown", scene.find_span(*path, "apart", key=True), advice)
    check_around(scene, report, place.around, place.radius or place.ranks, *path)
