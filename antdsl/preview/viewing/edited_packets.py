"""The arrays that pages receive for a frame with edits. They have the same form as those of a frame without edits."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.machine_clips import PlayedClip
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.frame_agents import find_species_rows, get_agent_ids
from antdsl.outputs.cache.manifest import ClipEntry, Manifest, SpeciesEntry
from antdsl.outputs.cache_bodies import CacheBodies
from antdsl.outputs.edits.edited_cache import EditedCache
from antdsl.outputs.edits.frame_rows import match_rows
from antdsl.outputs.edits.verbs.agent_moves import find_axes
from antdsl.pipeline import Shot
from antdsl.preview.viewing.action_arrays import SpeciesActions, make_action_arrays
from antdsl.preview.viewing.body_packets import MAX_PAGE_LAYERS, BodyOutfit, collect_outfits
from antdsl.runtime import World
from antdsl.scene.setting import MeshData
from antdsl.scene.thing_models import UNIT_MM

PageArrays = dict[str, NDArray[Any]]
_FEET_LENGTH_COLUMNS = ("P", "rise")  # fields of feet in scene units
_DIRECTION_SCALE = np.float32(127)


def make_edited_arrays(
    view: EditedCache, frame: Arrays, world: World, shot: Shot, unedited: Mapping[str, NDArray[Any]]
) -> PageArrays:
    """Return the arrays of agents for a page, in a frame with edits.

    `unedited`: the arrays of the same frame without edits. Agents that edits do not move have the same bits as there. Attributes
    are 0 for copies, and for agents that the unedited frame lacks."""
    arrays: PageArrays = {}
    worn = find_edited_outfits(view, world, shot)
    for number, entry in enumerate(view.manifest.species):
        own = {
            name.removeprefix(f"{entry.name}/"): array for name, array in unedited.items() if name.startswith(f"{entry.name}/")
        }
        rows = find_species_rows(frame, number)
        displayed = _make_displayed_arrays(view.manifest, entry, frame, rows, world)
        own = own or {name: np.empty(0, np.int32) for name in ("id", "born")}  # of a species that edits add
        at, is_known = match_rows(displayed["id"].astype(np.int64), own["id"].astype(np.int64))
        _retain_bits(displayed, own, at, is_known)
        actions = _gather_actions(view, number, frame, rows, displayed, worn[entry.name], world)
        for name, array in own.items():
            if name == "born" or name.startswith("column/"):
                displayed[name] = np.where(is_known, array[at] if len(array) else np.zeros(len(at), array.dtype), 0).astype(
                    array.dtype
                )
        tint = _make_tint(entry, frame, rows)
        displayed |= {} if tint is None else {"tint": tint}
        arrays |= {f"{entry.name}/{name}": array for name, array in displayed.items()} | make_action_arrays(actions)
    return arrays


def _make_displayed_arrays(
    manifest: Manifest, entry: SpeciesEntry, frame: Arrays, rows: NDArray[np.intp], world: World
) -> PageArrays:
    """Return the displayed values of the agents in `rows`, in the units of pages."""
    unit_mm = UNIT_MM[manifest.units]
    heading, up = find_axes(np.asarray(frame["orient"], np.float64)[rows])
    velocity = np.asarray(frame["v"], np.float32)[rows] * np.float32(unit_mm)
    displayed = {
        "id": get_agent_ids(frame)[rows].astype(np.int32),
        "position": frame["P"][rows] * np.float32(unit_mm),
        "heading": np.rint(heading * _DIRECTION_SCALE).astype(np.int8),
        "up": np.rint(up * _DIRECTION_SCALE).astype(np.int8),
        "size": frame["pscale"][rows] * np.float32(unit_mm),
        "speed": np.sqrt((velocity * velocity).sum(axis=1)),
    }
    for number, machine in enumerate(entry.machines):
        name = "state" if number == 0 else f"{machine.name}.state"
        states = frame[name][rows] if name in frame else np.zeros(len(rows), np.uint8)  # the frames of a merged cache may lack it
        displayed[f"state/{machine.name}"] = np.nan_to_num(states).astype(np.uint8)
    return displayed


def _retain_bits(displayed: PageArrays, own: PageArrays, at: NDArray[np.intp], is_known: NDArray[np.bool_]) -> None:
    """Copy directions from the unedited arrays `own` into `displayed` where the two differ only by rounding.

    `at`: the row of each agent in `own`. `is_known`: whether the agent has a row there."""
    for name in ("heading", "up"):
        if not len(own["id"]):
            continue
        same = is_known & (np.abs(displayed[name].astype(np.int16) - own[name][at]) <= 1).all(axis=1)
        displayed[name][same] = own[name][at[same]]


def _make_tint(entry: SpeciesEntry, frame: Arrays, rows: NDArray[np.intp]) -> NDArray[np.uint8] | None:
    """Return the colours that edits set, uint8[n, 4]: red, green, blue, and 1 if the agent has such a colour, else 0. Return
    None if no agent has one."""
    stored = np.asarray(frame["Cd"], np.float32)[rows]
    palette = np.array([state.colour for state in entry.machines[0].states] if entry.machines else [(1.0, 1.0, 1.0)], np.float32)
    states = np.clip(frame["state"][rows], 0, len(palette) - 1) if entry.machines else np.zeros(len(rows), np.int64)
    is_set = (stored != palette[states]).any(axis=1)
    if not is_set.any():
        return None
    return np.column_stack([np.rint(np.clip(stored, 0, 1) * 255), is_set]).astype(np.uint8)


def _gather_actions(
    view: EditedCache,
    number: int,
    frame: Arrays,
    rows: NDArray[np.intp],
    displayed: PageArrays,
    worn: Mapping[str, BodyOutfit],
    world: World,
) -> SpeciesActions:
    """Return the actions of the bodies of species `number` in a frame with edits. `rows`: the rows of its agents in the frame."""
    manifest, entry = view.manifest, view.manifest.species[number]
    unit_mm = np.float32(UNIT_MM[manifest.units])
    stored = {
        name: array * unit_mm if name.startswith("feet.") and name.rpartition(".")[2] in _FEET_LENGTH_COLUMNS else array
        for name, array in frame.items()
        if _find_owner(name) in (entry.name, *worn)
    }
    numbers = CacheBodies(manifest, {}).numbers(number, get_agent_ids(frame)[rows])
    seconds = int(frame["frame"]) * world.dt
    return SpeciesActions(
        entry.name, entry.playing, entry.wears, entry.channels, manifest.seed, seconds, worn, numbers, stored, displayed
    )


def _find_owner(name: str) -> str:
    """Return the species or body that an array of a frame belongs to; "" for any other array. Such an array has a name like
    `feet.ant#0.P`."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[0] in ("clips", "wears", "channels", "looks", "leans", "feet", "joints") else ""


def collect_added_meshes(view: EditedCache) -> dict[str, MeshData]:
    """Return the meshes that edits add to the scene, by name, in mm relative to the scene's origin."""
    manifest, known = view.manifest, {mesh.name for mesh in view.original.manifest.meshes}
    names = [mesh.name for mesh in manifest.meshes if mesh.name not in known]
    static = view.read_static() if names else {}
    return {
        name: MeshData(
            (np.asarray(static[f"mesh.{name}.vertices"], np.float64) + manifest.origin) * UNIT_MM[manifest.units],
            np.asarray(static[f"mesh.{name}.faces"], np.int32),
        )
        for name in names
    }


def list_added_species(view: EditedCache | None) -> tuple[SpeciesEntry, ...]:
    """Return the species that edits add to the run."""
    return () if view is None else view.manifest.species[len(view.original.manifest.species) :]


def find_edited_outfits(view: EditedCache, world: World, shot: Shot) -> Mapping[str, Mapping[str, BodyOutfit]]:
    """Return the outfits of each species of an edited view, by species and body key."""
    originals = {entry.name: entry for entry in view.original.manifest.species}
    edited = {}
    for number, entry in enumerate(view.manifest.species):
        original = originals.get(entry.name)
        is_same = original is not None and (_list_body_choices(entry), view.manifest.bodies) == (
            _list_body_choices(original),
            view.original.manifest.bodies,
        )
        edited[entry.name] = (
            collect_outfits(world, shot, world.populations[entry.name]) if is_same else _make_outfits(view, number)
        )
    return edited


def _list_body_choices(entry: SpeciesEntry) -> tuple[object, ...]:
    """Return the properties of a species that determine how its bodies look."""
    return entry.body, entry.definition, entry.bodies, entry.wears


@lru_cache(maxsize=8)
def _make_outfits(view: EditedCache, number: int) -> Mapping[str, BodyOutfit]:
    """Return the outfits of species `number`, including bodies and layers that edits add."""
    entry, bodies = view.manifest.species[number], CacheBodies(view.manifest, view.read_static())
    clips = tuple(PlayedClip(*(getattr(clip, name) for name in ClipEntry.model_fields)) for clip in entry.clips)
    leans = any(any(clip[3:]) for clip in clips)  # clips for turning and climbing
    worn = {}
    for which, key in enumerate(bodies.keys(number)):
        definition = bodies.definition(number, which)
        layers = tuple(name for name in entry.wears if name in definition.layers)[:MAX_PAGE_LAYERS]
        worn[key] = BodyOutfit(definition, clips, layers, tuple(name for name in entry.looks if name in definition.groups), leans)
    return worn
