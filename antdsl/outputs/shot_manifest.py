"""Makes the manifest of a shot: a description of its frames, without the files from which it was made."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.body_arrays import StoredBodies
from antdsl.outputs.cache.frame_maker import make_manifest
from antdsl.outputs.cache.manifest import AnyCameraEntry, Look, Manifest, join_line, shorten_line
from antdsl.outputs.cache.manifest_parts import CameraEntry, FollowEntry
from antdsl.outputs.feelers import list_feelers
from antdsl.outputs.pictures.camera import to_tuple
from antdsl.pipeline import Shot
from antdsl.runtime import World
from antdsl.scene.camera_models import FollowCamera, LensCamera, PlacedCamera
from antdsl.scene.looks import LAMP_LOOK_WORD
from antdsl.scene.notes.selectors import AgentName
from antdsl.scene.scene_model import SceneModel
from antdsl.scene.setting import CameraData
from antdsl.scene.thing_models import LampThing, PlacedThing, convert_point


def make_shot_manifest(shot: Shot, world: World, attributes: tuple[str, ...], stored_bodies: StoredBodies) -> Manifest:
    """Return the manifest of a shot in a world, without the path of its scene. `attributes`: the names of the agents' arrays in
    frames."""
    model = shot.scene.model
    manifest = make_manifest(
        world,
        shot.setting,
        version=shot.inputs["antdsl"],
        scene=Path(shot.scene.source.path).name,
        scene_path=None,
        inputs=shot.inputs,
        units=model.units,
        up=model.up,
        first=shot.frames.first,
        last=shot.frames.last,
        preroll=model.preroll,
        checkpoint=model.output.checkpoint,
        attributes=attributes,
        definitions=stored_bodies.entries,
        definition_by_species=stored_bodies.index_by_species,
        feelers={
            name: list_feelers(shot.program, name, world.params, shot.setting.unit_mm, world.dt) for name in world.populations
        },
        cameras=_make_camera_entries(shot, world.origin),
        looks=collect_looks(model),
    )
    return manifest.model_copy(update={"light": model.light.make_settings(), "notes": _list_notes(shot)})


def _list_notes(shot: Shot) -> tuple[str, ...]:
    """Return the notes that are not off, each on one line, without its braces."""
    scene = shot.scene
    lines = (scene.find_span("notes", k) for k, note in enumerate(scene.model.notes) if note.off == "no")
    return tuple(shorten_line(join_line(span.text)) for span in lines)


def _make_camera_entries(shot: Shot, origin: NDArray[np.float64]) -> dict[str, AnyCameraEntry]:
    """Return the manifest's entries for the cameras of a scene, by name."""
    model, entries = shot.scene.model, dict[str, AnyCameraEntry]()
    for name, value in model.named_cameras.items():
        if name in shot.setting.cameras:
            placed = _make_placed_entry(shot.setting.cameras[name], origin, 1.0 / model.unit_mm)
            entries[name] = (
                placed.model_copy(update=_read_lens(value, model.unit_mm)) if isinstance(value, PlacedCamera) else placed
            )
        elif isinstance(value, FollowCamera):
            by = None if value.by is None else to_tuple(np.array(convert_point(value.by, model.unit_mm)) / model.unit_mm)
            smooth = None if value.smooth is None else value.smooth.to_base_units(model.unit_mm, float(1 / model.fps))
            focal = None if value.focal is None else value.focal.number
            lens = _read_lens(value, model.unit_mm)
            entries[name] = FollowEntry(follow=str(value.follow), by=by, smooth=smooth, focal=focal, **lens)
        else:
            entries[name] = "fit"
    return entries


def _read_lens(camera: LensCamera, unit_mm: float) -> dict[str, Any]:
    """Return the manifest's values for a lens: the f-stop, and what is in focus (an agent, or a distance in scene units)."""
    focus = camera.focus
    sharp = None if focus is None else str(focus) if isinstance(focus, AgentName) else focus.to_millimetres(unit_mm) / unit_mm
    return {"f_stop": camera.f_stop, "focus": sharp}


def _make_placed_entry(camera: CameraData, origin: NDArray[np.float64], scale: float) -> CameraEntry:
    """Return the manifest's entry for a camera that does not depend on agents, with its values in the first frame."""
    at, look_at, up = ((camera.at[0] - origin) * scale, (camera.look_at[0] - origin) * scale, camera.up[0])
    focal = float(camera.focal[0]) or None
    return CameraEntry(at=to_tuple(at), look_at=to_tuple(look_at), focal=focal, up=to_tuple(up), moves=camera.is_moving)


def collect_looks(model: SceneModel) -> Mapping[str, Look | Mapping[str, Look]]:
    """Return the looks for pictures that the scene sets, by the name of a mesh or of items.

    Items from a USD file have one look. For items with separate entries, the value is a mapping of looks by item name."""
    looks: dict[str, Look | Mapping[str, Look]] = {}
    for name, thing in model.world.items():
        if isinstance(thing, dict):
            own = {item: placed.look for item, placed in thing.items() if placed.look is not None}
            looks |= {name: own} if own else {}
        elif isinstance(thing, LampThing):
            looks[name] = LAMP_LOOK_WORD
        elif isinstance(thing, PlacedThing) and thing.look is not None:
            looks[name] = thing.look
    return looks
