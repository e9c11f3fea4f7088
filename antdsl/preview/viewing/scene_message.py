"""The scene message: everything that a page can display, set, switch, or use to colour agents."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from antdsl.fields.vector_field import list_program_fields
from antdsl.outputs.feelers import list_feelers
from antdsl.preview.outcomes import make_silencing_settings
from antdsl.preview.session import PreviewSession
from antdsl.preview.viewing.body_packets import collect_outfits
from antdsl.preview.viewing.edited_packets import find_edited_outfits, list_added_species
from antdsl.preview.viewing.field_packets import choose_full_value
from antdsl.preview.viewing.file_names import FileNames, read_file_text
from antdsl.preview.viewing.page_units import choose_unit, convert_constant, find_unit_size, list_colour_attributes
from antdsl.program.model import ItemAttribute, Param
from antdsl.runtime import Population
from antdsl.scene.camera_models import DEFAULT_CAMERA_NAME
from antdsl.scene.quantities import parse_quantity
from antdsl.scene.setting import DEFAULT_FOCAL_MM

if TYPE_CHECKING:
    from antdsl.preview.live import LiveSimulation

_SPECIES_COLOURS = ((0.98, 0.75, 0.24), (0.35, 0.75, 0.95), (0.62, 0.86, 0.42), (0.93, 0.47, 0.65), (0.70, 0.60, 0.96))


def make_scene_message(
    live: LiveSimulation, box: BoundingBox, charts: list[dict[str, Any]], missing_package: str
) -> dict[str, Any]:
    """Return the scene message for the session's current program."""
    session, names = live.session, live.screen.names
    world, program = session.world, session.shot.program
    low, high = box.find_corners(session)
    return {
        "op": "scene", "name": names.get_short_name(live.compiler.scene), "fps": float(world.setting.fps),
        "last": session.shot.frames.last,
        "unit_mm": world.setting.unit_mm,
        "up": [float(x) for x in world.up], "low": low, "high": high,
        "camera": _make_camera_entry(session),
        "species": [
            *(_make_species_entry(live, names, population) for population in world.populations.values()),
            *_make_added_species_entries(live),
        ],
        "params": [_make_param_entry(session, names, name, param) for name, param in program.params.items()],
        "fields": _list_fields(session), "flows": list(world.flows), "curves": list(world.setting.curves),
        "solids": list(world.solids), "items": _list_items(session), "specs": [spec.name for spec in program.specs],
        "charts": charts, "charts_need": missing_package,
    }  # fmt: skip


class BoundingBox:
    """The box around all ground, solids and agents, relative to the world's origin. It changes only when ground or solids
    change, because pages reset their view then."""

    def __init__(self) -> None:
        self._input_key: tuple[list[list[float]], bool] = [], False
        self._box: tuple[list[float], list[float]] | None = None

    def find_corners(self, session: PreviewSession) -> tuple[list[float], list[float]]:
        """Return the lowest and the highest corner of the box, in mm."""
        world = session.world
        meshes = [mesh.vertices for mesh in (*world.setting.surfaces.values(), *world.setting.obstacles.values())]
        meshes += [solid.mesh.vertices for solid in world.setting.solids.values()]
        ends = [end - world.origin for mesh in meshes if len(mesh) for end in (mesh.min(axis=0), mesh.max(axis=0))]
        people = [population.position for population in world.populations.values() if len(population)]
        signature = [[float(x) for x in end] for end in ends], bool(people)
        if self._box is None or signature != self._input_key:
            ends += [end for positions in people for end in (positions.min(axis=0), positions.max(axis=0))]
            ends = ends or [np.full(3, -100.0), np.full(3, 100.0)]
            low, high = np.min(ends, axis=0), np.max(ends, axis=0)
            self._input_key, self._box = signature, ([float(x) for x in low], [float(x) for x in high])
        return self._box


def _make_camera_entry(session: PreviewSession) -> dict[str, Any] | None:
    """Return the entry of the scene's default camera at the first frame, relative to the world's origin; None without a
    camera."""
    camera, origin = session.world.setting.cameras.get(DEFAULT_CAMERA_NAME), session.world.origin
    if camera is None:
        return None
    at, look_at = ([float(x) for x in points[0] - origin] for points in (camera.at, camera.look_at))
    return {"at": at, "look_at": look_at, "focal": float(camera.focal[0]) or DEFAULT_FOCAL_MM}


def _make_species_entry(live: LiveSimulation, names: FileNames, population: Population) -> dict[str, Any]:
    session, view = live.session, live.screen.edited.find_view()
    world, shot, name = session.world, session.shot, population.name
    worn = collect_outfits(world, shot, population) if view is None else find_edited_outfits(view, world, shot)[name]
    declared = list_colour_attributes(world, name, shot.program.species[name].attributes)
    feelers = list_feelers(shot.program, name, world.params, world.setting.unit_mm, world.dt)
    return {
        "name": name,
        "bodies": list(worn),
        "attributes": [{"name": each.name, "unit": choose_unit(each)} for each in declared],
        "machines": [
            {"name": machine.name, "states": list(machine.states), "colours": [list(colour) for colour in machine.colours]}
            for machine in population.plan.machines
        ],
        "layers": _list_layers(session, names, population),
        "feelers": [
            {"count": f.count, "spread": f.spread, "reach": f.reach * world.setting.unit_mm, "per_length": f.per_length}
            for f in feelers
        ],
    }


def _make_added_species_entries(live: LiveSimulation) -> Iterator[dict[str, Any]]:
    """Yield the entries of species that edits add to the run. These species have no program."""
    view, session = live.screen.edited.find_view(), live.session
    for entry in list_added_species(view):
        assert view is not None
        machines = [
            {"name": m.name, "states": [s.name for s in m.states], "colours": [list(s.colour) for s in m.states]}
            for m in entry.machines
        ]
        bodies = list(find_edited_outfits(view, session.world, session.shot)[entry.name])
        yield {"name": entry.name, "bodies": bodies, "attributes": [], "machines": machines, "layers": [], "feelers": []}


def _list_layers(session: PreviewSession, names: FileNames, population: Population) -> list[dict[str, Any]]:
    """Return the entries of active and disabled layers, in the order of the source text."""
    entries = []
    for layer in population.plan.layers:
        span = layer.span
        line = span.source.find_line_column(span.start)[0]
        entries.append({"text": span.text, "file": names.get_short_name(span.source.path), "line": line, "on": True})
    for (species, text), path in session.disabled_layers.items():
        if species == population.name:
            file_text = read_file_text(path, session.compiler.open_file) or ""
            own = re.search(rf"^\s*species\s+{re.escape(species)}\b", file_text, re.MULTILINE)
            line = file_text.count("\n", 0, max(file_text.find(text, own.start() if own else 0), 0)) + 1
            entries.append({"text": text, "file": names.get_short_name(path), "line": line, "on": False})
    return sorted(entries, key=lambda entry: (entry["file"], entry["line"]))


def _make_param_entry(session: PreviewSession, names: FileNames, name: str, param: Param) -> dict[str, Any]:
    world, scene = session.world, session.shot.scene
    unit_mm, dt = world.setting.unit_mm, world.dt
    scene_value = scene.model.set.get(name)
    written = scene_value.text if scene_value is not None else param.default.span.text if param.default.span is not None else ""
    chosen = session.choices.params.get(name)
    value = written if chosen is None else chosen
    quantity = scene_value if chosen is None else parse_quantity(chosen)
    number = convert_constant(param.default, unit_mm, dt) if quantity is None else quantity.to_base_units(unit_mm, dt)
    one = find_unit_size(param.unit, unit_mm, dt)
    low, high = (None if each is None else convert_constant(each, unit_mm, dt) / one for each in (param.low, param.high))
    return {
        "name": name, "value": value, "number": number / one, "unit": param.unit,
        "low": low, "high": high, "help": param.help,
        "file": names.get_short_name(param.span.source.path), "line": param.span.source.find_line_column(param.span.start)[0],
        "written": written,
    }  # fmt: skip


def _list_fields(session: PreviewSession) -> list[dict[str, Any]]:
    chosen = session.choices.params
    return [
        {
            "name": name, "unit": "", "colour": list(_SPECIES_COLOURS[number % len(_SPECIES_COLOURS)]),
            "on": not chosen.items() >= make_silencing_settings(name).items(),
            "full": choose_full_value(field.limit),
        }
        for number, (name, field) in enumerate(list_program_fields(session.world).items())
    ]  # fmt: skip


def _list_items(session: PreviewSession) -> list[dict[str, Any]]:
    things = session.shot.program.world
    return [
        {
            "name": name, "kind": things[name].kind, "names": list(items.names),
            "amounts": [
                {"name": a.name, "unit": choose_unit(a), "first": _find_initial_amounts(session, name, a)}
                for a in things[name].attributes if a.name in items.amounts
            ],
        }
        for name, items in session.world.items.items()
    ]  # fmt: skip


def _find_initial_amounts(session: PreviewSession, name: str, amount: ItemAttribute) -> list[float]:
    """Return the initial amount of each item, in the unit that authors use for this amount."""
    unit_mm, dt = session.world.setting.unit_mm, session.world.dt
    usual, one = convert_constant(amount.default, unit_mm, dt), find_unit_size(choose_unit(amount), unit_mm, dt)
    return [each.attributes.get(amount.name, usual) / one for each in session.world.setting.items[name]]
