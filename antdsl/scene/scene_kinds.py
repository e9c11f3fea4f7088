"""The kinds of things of the world in scenes, with one class for each row of `antdsl.program.tables.things`.

A class lists the forms in which a scene may define such a thing. It checks an entry against the program, and names the mapping
that stores the entry's data. No file is read here; `staging` reads files, with NumPy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from antdsl.program.model import Dimension
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.tables.units import describe_dimension
from antdsl.scene import thing_models as forms
from antdsl.scene.camera_models import FollowCamera, PlacedCamera, UsdCamera
from antdsl.scene.checks.entry_checks import WorldEntryCheck, check_attributes, report_unknown_name
from antdsl.scene.document import PathKey

if TYPE_CHECKING:
    from antdsl.scene.load import Scene
    from antdsl.scene.staging.stage_scene import SceneStaging


_FLOW_TARGET_KEYS = ("tangent", "toward", "away", "solved")  # keys that name the target of a flow


@dataclass(frozen=True, slots=True)
class SceneThingKind:
    """A kind of thing in scenes.

    `models`: the forms in which a scene may define such a thing.
    `group`: the mapping in the staging and in the setting that stores its data.
    `missing_data`: a noun for what a thing without an entry in the scene lacks, for messages.
    `forbidden_picture_keys`: keys about pictures that this kind must not have."""

    models: tuple[type, ...]
    group: str
    missing_data: str = "geometry"
    forbidden_picture_keys: tuple[str, ...] = ()

    def check(self, entry: WorldEntryCheck, value: Any) -> None:
        """Report everything in an entry that does not match the program. Files must exist, but are not read."""
        if isinstance(value, forms.ThingModel) and value.names_file:
            entry.check_file(getattr(value, value.find_form_key()), value.find_form_key())
        if isinstance(value, forms.UsdThing):
            self.check_item_keys(entry, value)
        if isinstance(value, forms.ScaledThing):
            self.check_voxel(entry, value)
            _check_scale(entry, value)

    def check_item_keys(self, entry: WorldEntryCheck, value: forms.UsdThing) -> None:
        """Report keys that only items may have, on a thing from a USD file that is not items."""
        for key in ("each", "kind", "turn", *self.forbidden_picture_keys):
            if key in value.model_fields_set:
                users = "what is seen" if key in self.forbidden_picture_keys else "items"
                words = f"`{key}` is for {users}, but `{entry.name}` is a {entry.thing.kind}"
                entry.report.error("wrong-kind", words, entry.find_span(key, key=True), "delete it")

    def check_voxel(self, entry: WorldEntryCheck, value: forms.ScaledThing) -> None:
        """Report the key `voxel` of a thing that is not a solid."""
        if value.voxel is not None:
            words = f"`{entry.name}` is {entry.thing.kind} in the program, but only solids have voxels"
            entry.report.error("wrong-value", words, entry.find_span("voxel"), f"leave it out, or declare `solid {entry.name}`")

    def stage_thing(self, staging: SceneStaging, name: str, value: Any) -> Any:
        """Return the data of a thing, in mm and the scene's axes. On failure, report an error and return None."""
        return staging.read_group_entry(self.group, name, value)


def _check_scale(entry: WorldEntryCheck, value: forms.ScaledThing) -> None:
    """Report a scale of 0, which would flatten the mesh to a point."""
    if abs(value.scale) < 1e-6:
        entry.report.error("wrong-value", "a scale of 0 removes the mesh", entry.find_span("scale"), "write `scale: 1`")
    elif value.scale < 0:
        help = "its faces are flipped so that the outside stays outside"
        entry.report.warning("mirrored", f"the mesh of `{entry.name}` is mirrored", entry.find_span("scale"), help)


class SolidKind(SceneThingKind):
    """The kind of closed meshes that become voxels. They are static."""

    def check(self, entry: WorldEntryCheck, value: Any) -> None:
        if value.keys or (isinstance(value, forms.MeshThing) and entry.scene.roots.is_sequence(value.mesh)):
            words, place = f"the solid `{entry.name}` cannot move", entry.find_span("keys" if value.keys else "mesh")
            entry.report.error("wrong-value", words, place, "give it one position for all frames")
        super().check(entry, value)

    def check_voxel(self, entry: WorldEntryCheck, value: forms.ScaledThing) -> None:
        if value.voxel is None:
            words, help = f"`{entry.name}` is solid, but no `voxel` is given", "a fourth of a body or less: `voxel: 1 mm`"
            entry.report.error("missing-key", words, entry.find_span(), f"add the edge of its voxels, {help}")


class ItemsKind(SceneThingKind):
    """The kind of items, which have separate entries or come from points and empties in a USD file."""

    def check(self, entry: WorldEntryCheck, value: Any) -> None:
        if not isinstance(value, dict):
            super().check(entry, value)
            return
        known = [*(a.name for a in entry.thing.attributes), "at", "on", "radius", "keys", "look"]
        surfaces = entry.program.list_things_of_kind("surface")
        for item, placed in value.items():
            if placed.on is not None and placed.on not in surfaces:
                entry.report_unknown_name("no surface is named", surfaces, item, "on")
            check_attributes(entry, placed.model_extra or {}, known, item)

    def check_item_keys(self, entry: WorldEntryCheck, value: forms.UsdThing) -> None:
        declared = {a.name: a.type for a in entry.thing.attributes}
        check_attributes(entry, value.each.model_extra or {}, [*declared, "radius"], "each")
        axes = value.turn if isinstance(value.turn, tuple) else ()
        expected, words = (
            (Dimension(), "is a component of a direction, without a unit") if axes else (Dimension(angle=1), "is an angle")
        )
        for number, attribute in enumerate(axes or ([] if value.turn is None else [str(value.turn)])):
            path: tuple[PathKey, ...] = ("turn", number) if axes else ("turn",)
            if attribute not in declared:
                entry.report_unknown_name(f"`{entry.name}` has no attribute", declared, *path)
            elif declared[attribute].dimension != expected:
                has = describe_dimension(declared[attribute].dimension)
                message = f"the value of `turn` for `{attribute}` {words}, but `{attribute}` of `{entry.name}` is {has}"
                help = f"declare `{attribute} = 0`" if axes else f"declare `{attribute} = 0 deg`"
                entry.report.error("wrong-unit", message, entry.find_span(*path), help)


class CameraKind(SceneThingKind):
    """The kind of cameras, which are under `cameras` instead of `world`. Agents sense the cameras that do not depend on
    agents."""

    def check(self, entry: WorldEntryCheck, value: Any) -> None:
        if isinstance(value, FollowCamera | str):
            words = "it follows one of them" if isinstance(value, FollowCamera) else "it is placed when pictures are made"
            place = entry.scene.find_span(*entry.scene.model.find_camera_path(entry.name))
            message = f"agents cannot sense the camera `{entry.name}`: {words}"
            advice = f"write `{entry.name}: {KIND_BY_WORD[entry.thing.kind].scene}`, or name another one in the program"
            entry.report.error("wrong-kind", message, place, advice)


def is_file_path(text: str) -> bool:
    """Return whether a target is the path of a file rather than the name of a thing."""
    return any(sign in text for sign in "./:")


def find_flow_target(thing: forms.FlowThing | forms.PaintedThing) -> tuple[str, forms.FlowTargetValue] | None:
    """Return the key and the value of a flow's target, or None if the flow has none."""
    key = next((key for key in _FLOW_TARGET_KEYS if hasattr(thing, key)), None)
    return None if key is None else (key, getattr(thing, key))


class FlowKind(SceneThingKind):
    """The kind of flows and maps."""

    def check(self, entry: WorldEntryCheck, value: Any) -> None:
        surfaces = entry.program.list_things_of_kind("surface")
        if not surfaces and not isinstance(value, forms.SpreadFlow):
            words = f"`{entry.name}` is painted on a surface, but no program has one"
            entry.report.error("missing-thing", words, entry.find_span(), "declare one: `world { surface ground }`")
            return
        for key in ("on", "border"):
            if getattr(value, key, None) not in (None, *surfaces):
                entry.report_unknown_name("no surface is named", surfaces, key)
        if isinstance(value, forms.PaintedThing):
            if value.on is None and len(surfaces) > 1 and find_painted_surface(entry.scene, surfaces, value) is None:
                words = f"`{entry.name}` does not name the surface it is painted on"
                entry.report.error("missing-key", words, entry.find_span("painted"), f"add `on: {surfaces[0]}`")
            super().check(entry, value)
        if isinstance(value, forms.TangentFlow) and value.gather and value.radius is None:
            words = "`gather` sets the strength at the radius, but there is no `radius`"
            entry.report.error("missing-key", words, entry.find_span("gather", key=True), "add `radius: 50 mm`")
        if isinstance(value, forms.SolvedFlow):
            _check_solved_flow(entry, value)
        key, text = find_flow_target(value) or ("", "")
        if not isinstance(text, str) or not text:
            return
        lines_only = key == "tangent"
        if is_file_path(text):
            entry.check_file(text, key)
        elif text not in (known := _list_target_names(entry, lines_only)) and (lines_only or not entry.scene.model.has_usd_items):
            entry.report_unknown_name("no curve is named" if lines_only else "no curve and no item is named", known, key)


def _check_solved_flow(entry: WorldEntryCheck, thing: forms.SolvedFlow) -> None:
    maps = entry.program.list_things_of_kind("map")
    for key in thing.maps:
        if key not in maps:
            report_unknown_name(entry.report, entry.scene, ("world", entry.name, "maps", key), "no map is named", maps)
    dug = any(KIND_BY_WORD[t.kind].is_dug for t in entry.program.world.values())
    if thing.every is not None and not (thing.crowding or dug or _may_geometry_move(entry.scene)):
        words, help = f"no input of `{entry.name}` changes, so it is solved once", "leave `every` out, or add `crowding: 2`"
        entry.report.error("wrong-value", words, entry.find_span("every", key=True), help)


def _may_geometry_move(scene: Scene) -> bool:
    """Return whether any thing of the world may move. Files are not opened, so the result may be True if everything is static."""
    things = [each for value in scene.model.world.values() for each in (value.values() if isinstance(value, dict) else (value,))]
    paths = (getattr(each, key, None) for each in things for key in ("mesh", "curve"))
    return any(getattr(each, "keys", None) or hasattr(each, "usd") for each in things) or any("#" in p for p in paths if p)


def _list_target_names(entry: WorldEntryCheck, lines_only: bool) -> list[str]:
    curves = entry.program.list_things_of_kind("curve")
    if lines_only:
        return curves
    items = {n: v for n, v in entry.scene.model.world.items() if isinstance(v, dict)}
    return curves + list(items) + [item for group in items.values() for item in group]


def find_painted_surface(scene: Scene, surfaces: list[str], thing: forms.PaintedThing) -> str | None:
    """Return the surface for which a thing is painted, because the file of the thing is also the file of the surface. Return
    None unless there is exactly one."""
    meshes = {n: scene.model.world.get(n) for n in surfaces}
    own = [n for n, m in meshes.items() if thing.painted in (getattr(m, "mesh", None), getattr(m, "usd", None))]
    return own[0] if len(own) == 1 else None


_MESH_FORMS = (forms.MeshThing, forms.UsdThing)
_FLOW_FORMS = (forms.TangentFlow, forms.TowardFlow, forms.AwayFlow, forms.BorderFlow, forms.SolvedFlow, forms.PaintedThing)
SCENE_KINDS: Mapping[str, SceneThingKind] = {
    "surface": SceneThingKind((forms.MeshThing, forms.HeightThing, forms.UsdThing), "surfaces"),
    "obstacle": SceneThingKind(_MESH_FORMS, "obstacles"),
    "solid": SolidKind(_MESH_FORMS, "solids"),
    "curve": SceneThingKind((forms.CurveThing, forms.UsdThing), "curves", forbidden_picture_keys=("look",)),
    "items": ItemsKind((dict, forms.UsdThing), "items", missing_data="place"),
    "flow": FlowKind(_FLOW_FORMS, "flows"),
    "map": FlowKind((forms.PaintedThing,), "maps"),
    "lamp": SceneThingKind((forms.LampThing,), "items", missing_data="place"),
    "camera": CameraKind((PlacedCamera, UsdCamera, FollowCamera, str), "cameras", missing_data="place"),
}
