"""Flows and maps of a scene: names are checked against the program, files are read, everything is converted to millimetres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.program.model import Program
from antdsl.scene import model
from antdsl.scene import setting as stage_of
from antdsl.scene.geometry.meshes import RawMesh, rotate_points, rotate_up
from antdsl.scene.geometry.painted import PaintError, read_painted_values
from antdsl.scene.load import Scene
from antdsl.scene.quantities import Quantity
from antdsl.scene.setting import Target
from antdsl.scene.staging.stage_things import first_rotation, limit_length, stage_usd_paint

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import Staging

_GOALS = ("tangent", "toward", "away", "solved")  # keys that name where a flow leads
_DEFAULT_EVERY = 1.0  # s

FlowThing = model.FlowThing | model.PaintedThing


def is_file(text: str) -> bool:
    """Return whether a target is the path of a file and not a name of the world."""
    return any(sign in text for sign in "./:")


def find_goal(thing: FlowThing) -> tuple[str, model.Point | str] | None:
    """Return the key and the value of a flow's target."""
    key = next((key for key in _GOALS if hasattr(thing, key)), None)
    return None if key is None else (key, getattr(thing, key))


# --- against the program ---------------------------------------------------------------------------------------------


def match_flow(scene: Scene, program: Program, report: Report, name: str, thing: FlowThing) -> tuple[str, str] | None:
    """Report names in a flow or map that do not exist. Returns (key, path) of a file that is still to be checked."""
    surfaces = [n for n, t in program.world.items() if t.kind == "surface"]
    if not surfaces and not isinstance(thing, model.SpreadFlow):
        report.error(
            "missing-thing",
            f"`{name}` is painted on a surface, and no program has one",
            scene.span("world", name),
            "declare one: `world { surface ground }`",
        )
        return None
    for key in ("on", "border"):
        named: str | None = getattr(thing, key, None)
        if named is not None and named not in surfaces:
            _report_unknown(report, scene, (name, key), "no surface is named", named, surfaces)
    if isinstance(thing, model.PaintedThing):
        if thing.on is None and len(surfaces) > 1 and _find_painted_surface(scene, surfaces, thing) is None:
            report.error(
                "missing-key",
                f"`{name}` does not name the surface it is painted on",
                scene.span("world", name, "painted"),
                f"add `on: {surfaces[0]}`",
            )
        return "painted", thing.painted
    if isinstance(thing, model.TangentFlow) and thing.gather and thing.radius is None:
        words = "`gather` sets the strength at the radius, but there is no `radius`"
        report.error("missing-key", words, scene.span("world", name, "gather", key=True), "add `radius: 50 mm`")
    if isinstance(thing, model.SolvedFlow):
        _match_solved(scene, program, report, name, thing)
    key, text = find_goal(thing) or ("", "")
    if not key or not isinstance(text, str):
        return None
    if is_file(text):
        return key, text
    lines_only = key == "tangent"
    known = _goal_names(scene, program, lines_only)
    if text not in known and (lines_only or not scene.model.has_usd_items):
        what = "no curve is named" if key == "tangent" else "no curve and no item is named"
        _report_unknown(report, scene, (name, key), what, text, known)
    return None


def _match_solved(scene: Scene, program: Program, report: Report, name: str, thing: model.SolvedFlow) -> None:
    maps = [n for n, t in program.world.items() if t.kind == "map"]
    for key in thing.maps:
        if key not in maps:
            _report_unknown(report, scene, (name, "maps", key), "no map is named", key, maps)
    dug = any(t.kind == "solid" for t in program.world.values())
    if thing.every is not None and not (thing.crowding or dug or _may_move(scene)):
        report.error(
            "wrong-value",
            f"no input of `{name}` changes, so it is solved once",
            scene.span("world", name, "every", key=True),
            "leave `every` out, or add `crowding: 2`",
        )


def _may_move(scene: Scene) -> bool:
    """Return whether anything of the world may move, as far as is known without opening files."""
    things = [each for value in scene.model.world.values() for each in (value.values() if isinstance(value, dict) else (value,))]
    paths = (getattr(each, key, None) for each in things for key in ("mesh", "curve"))
    return any(getattr(each, "keys", None) or hasattr(each, "usd") for each in things) or any("#" in p for p in paths if p)


def _goal_names(scene: Scene, program: Program, lines_only: bool) -> list[str]:
    curves = [n for n, t in program.world.items() if t.kind == "curve"]
    if lines_only:
        return curves
    items = {n: v for n, v in scene.model.world.items() if isinstance(v, dict)}
    return curves + list(items) + [item for group in items.values() for item in group]


def _find_painted_surface(scene: Scene, surfaces: list[str], thing: model.PaintedThing) -> str | None:
    """Return the surface with the paint in its own file."""
    meshes = {n: scene.model.world.get(n) for n in surfaces}
    own = [n for n, m in meshes.items() if thing.painted in (getattr(m, "mesh", None), getattr(m, "usd", None))]
    return own[0] if len(own) == 1 else None


def _report_unknown(report: Report, scene: Scene, path: tuple[str, ...], what: str, name: str, known: list[str]) -> None:
    from antdsl.diagnostics.suggestion import nearest_name

    near = nearest_name(name, known)
    help = f"did you mean `{near}`?" if near else ("known: " + ", ".join(f"`{n}`" for n in sorted(known)[:12]) if known else None)
    report.error("unknown-thing", f"{what} `{name}`", scene.span("world", *path, key=path[-1] == name), help)


# --- to millimetres --------------------------------------------------------------------------------------------------


def stage_flows(
    staging: Staging, items: Mapping[str, tuple[stage_of.ItemData, ...]], curves: Mapping[str, NDArray[np.float64]]
) -> tuple[dict[str, stage_of.FlowData], dict[str, stage_of.Painted]]:
    """All flows and maps of a scene, by name."""
    flows: dict[str, stage_of.FlowData] = {}
    maps: dict[str, stage_of.Painted] = {}
    for name, declared in staging.program.world.items():
        thing = staging.scene.model.world.get(name)
        if declared.kind == "map" and isinstance(thing, model.PaintedThing):
            painted = _stage_painted(staging, name, thing, 1)
            if painted is not None:
                maps[name] = painted
        elif declared.kind == "flow" and isinstance(thing, (model.FlowThing, model.PaintedThing)):
            flow = _stage_painted(staging, name, thing, 3) if isinstance(thing, model.PaintedThing) else _stage_flow(
                staging, name, thing, items, curves
            )  # fmt: skip
            if flow is not None:
                flows[name] = flow
    return flows, maps


def _stage_flow(
    staging: Staging,
    name: str,
    thing: model.FlowThing,
    items: Mapping[str, tuple[stage_of.ItemData, ...]],
    curves: Mapping[str, NDArray[np.float64]],
) -> stage_of.FlowData | None:
    def mm(value: Quantity | None) -> float | None:
        return None if value is None else value.length(staging.scene.model.unit_mm)

    on = () if thing.on is None else (thing.on,)
    if isinstance(thing, model.BorderFlow):
        within = mm(thing.within)
        assert within is not None
        return stage_of.BorderFlow(on or (thing.border,), within, thing.falloff, thing.strength, mm(thing.cell))
    goal = find_goal(thing)
    assert goal is not None
    target = _stage_target(staging, name, goal[0], goal[1], items, curves)
    if target is None:
        return None
    if isinstance(thing, model.SolvedFlow):
        model_ = staging.scene.model
        every = _DEFAULT_EVERY if thing.every is None else thing.every.to_base_units(model_.unit_mm, float(1 / model_.fps))
        clearance = mm(thing.room) or 0.0
        return stage_of.SolvedFlow(
            target, thing.slope, clearance, dict(thing.maps), thing.crowding, every, thing.strength, mm(thing.cell), on
        )
    assert isinstance(thing, model.SpreadFlow)
    direction, gather = goal[0], thing.gather if isinstance(thing, model.TangentFlow) else 0.0
    return stage_of.SpreadFlow(direction, target, mm(thing.radius), thing.falloff, thing.strength, mm(thing.cell), on, gather)  # type: ignore[arg-type]


def _stage_target(
    staging: Staging,
    name: str,
    key: str,
    goal: model.Point | str,
    items: Mapping[str, tuple[stage_of.ItemData, ...]],
    curves: Mapping[str, NDArray[np.float64]],
) -> Target | None:
    scene = staging.scene
    if not isinstance(goal, str):
        return Target(np.array([model.millimetres(goal, scene.model.unit_mm)]), np.zeros(1))
    if is_file(goal):
        points = staging.points(goal, 2 if key == "tangent" else 1, "world", name, key)
        if points is None:
            return None
        points = points * scene.model.unit_mm
        return Target(points, np.zeros(len(points)), line=len(points) > 1)
    if goal in curves:
        return Target(curves[goal], np.zeros(len(curves[goal])), line=True, of=goal)
    of, which, target_items = goal, None, items.get(goal) or ()
    if not target_items:
        own = [(group, k) for group, each in items.items() for k, item in enumerate(each) if item.name == goal]
        if not own:
            _report_no_target(staging, name, key, goal, items)
            return None
        of, which = own[0]
        target_items = (items[of][which],)
    positions, radii = (np.array([getattr(i, key) for i in target_items], np.float64) for key in ("position", "radius"))
    return Target(positions, radii, of=of, which=which)


def _report_no_target(
    staging: Staging, name: str, key: str, goal: str, items: Mapping[str, tuple[stage_of.ItemData, ...]]
) -> None:
    """Report a goal that is no item, unless another message already explains it."""
    if not staging.report.ok:
        return
    if goal in items:
        words, help = f"`{goal}` has no items, so `{name}` leads nowhere", f"add one: `{goal}: {{one: {{at: [0, 0, 0]}}}}`"
        staging.report.error("missing-thing", words, staging.scene.span("world", name, key), help)
        return
    known = [*items, *(item.name for each in items.values() for item in each)]
    _report_unknown(staging.report, staging.scene, (name, key), "no curve and no item is named", goal, known)


def _stage_painted(staging: Staging, name: str, thing: model.PaintedThing, width: int) -> stage_of.Painted | None:
    """Return the values of a map (width 1) or the vectors of a flow (3) on the vertices or faces of a surface as it is in the
    scene."""
    surfaces = [n for n, t in staging.program.world.items() if t.kind == "surface"]
    surface = thing.on or _find_painted_surface(staging.scene, surfaces, thing) or surfaces[0]
    raw, mesh = staging.raw.get(surface), staging.scene.model.world.get(surface)
    if isinstance(mesh, model.UsdThing) and mesh.usd == thing.painted:
        values = stage_usd_paint(staging, name, thing, mesh, width)
        return None if values is None else stage_of.Painted(surface, values, False)
    data = staging.read_file(thing.painted, limits.MESH_BYTES, "world", name, "painted")
    if data is None or raw is None or not isinstance(mesh, model.MeshThing | model.HeightThing):
        return None  # the problem was reported with the mesh
    span = staging.scene.span("world", name, "painted")
    attribute = name if thing.attribute is None else thing.attribute
    try:
        rows = read_painted_values(data, thing.painted, attribute, width)
    except PaintError as why:
        staging.report.error("bad-paint", f"`{thing.painted}` {why}", span, why.help)
        return None
    own = _select_used_rows(rows, raw)
    if own is None:
        vertices, faces = raw.counts
        staging.report.error(
            "bad-paint",
            f"`{thing.painted}` has {len(rows):,} values, and `{surface}` has {vertices:,} vertices and {faces:,} triangles",
            span,
            "paint on the mesh that the surface is made from, its points in the same order",
        )
        return None
    values, of_faces = own
    values = values * thing.strength
    if width == 3:
        up = staging.scene.model.up
        mirrored, own_up = (mesh.scale < 0, mesh.own_up or up) if isinstance(mesh, model.MeshThing) else (False, "y")
        values = values * (-1.0 if mirrored else 1.0)
        values = limit_length(rotate_points(rotate_up(values, own_up, up), first_rotation(staging, mesh)))
    return stage_of.Painted(surface, values if width == 3 else values[:, 0], of_faces)


def _select_used_rows(rows: NDArray[np.float64], raw: RawMesh) -> tuple[NDArray[np.float64], bool] | None:
    """Return the rows of the file's vertices or faces that are in the scene."""
    vertices, faces = raw.counts
    if len(rows) == vertices:
        return rows[raw.own_vertices], False
    return (rows[raw.own_faces], True) if len(rows) == faces else None


def check_densities(staging: Staging, maps: Mapping[str, stage_of.Painted]) -> None:
    """Report a crowd that is placed by a map which is nowhere above 0, or painted on another surface."""
    for number, line in enumerate(staging.scene.model.crowd):
        name = line.place.density
        if name is None or name not in maps:
            continue
        span = staging.scene.span("crowd", number, "place", "density")
        painted = maps[name]
        if line.place.on not in (None, painted.surface):
            words = f"`{name}` is painted on `{painted.surface}`, and the crowd is placed on `{line.place.on}`"
            staging.report.error("bad-paint", words, span, f"write `on: {painted.surface}`")
        elif not (painted.values > 0).any():
            staging.report.error("bad-paint", f"`{name}` is nowhere above 0, so no agent can be placed by it", span)
