"""A cache as Houdini's ASCII geometry (.geo), one file per frame with one point per agent.

The format has no published description. This writer is based on open-source readers (`hgeo.py` of cgdougm/HoudiniObj among
others). A file is a list of keys and values. Attributes are `tuples`, `arrays`, and tables of `strings` with `indices`.

Points are in axes with y up, as in Houdini. `orient` rotates +z, Houdini's forward axis for agents, to the heading. In a world
far from the scene's zero, points are relative to the global attribute `origin`, which is in double precision."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.atomic_write import write_atomically
from antdsl.bodies.agents.machine_clips import MachineClips
from antdsl.bodies.agents.transforms import multiply_quaternions, normalise_quaternion
from antdsl.outputs.cache.cache_reader import Arrays, CacheError
from antdsl.outputs.cache.frame_agents import (
    IDENTITY_ARRAYS,
    find_species_rows,
    get_agent_ids,
    get_species_numbers,
    iterate_other_numbers,
    make_agent_keys,
)
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.outputs.cache.pose_arrays import read_all_machine_clips
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.numbered_files import make_numbered_path
from antdsl.scene.scene_model import UNIT_MM

Floats = NDArray[np.float64]
Slot = tuple[NDArray[np.int64], Floats, Floats]
_SQRT_HALF = float(np.sqrt(0.5))
_Z_TO_X_ROTATION = np.array([0.0, _SQRT_HALF, 0.0, _SQRT_HALF])  # rotates +z to +x, about +y
_Z_TO_Y_ROTATION = np.array([-_SQRT_HALF, 0.0, 0.0, _SQRT_HALF])  # rotates +z to +y, about +x
_COVERING_CLIP_WEIGHT = 1e6  # factor for the weight of a clip that replaces others completely


def export_geo(gallery: Gallery, frames: Iterable[int], path: Path) -> None:
    """Write a file of points for each frame. The frame number is inserted into the name of `path`.

    Raises CacheError for a damaged frame, OSError if writing fails. The files are not synced to the disk."""
    for frame in frames:
        arrays = gallery.cache.frame(frame)
        text = json.dumps(_make_geometry(gallery, frame, arrays), separators=(",", ":"), allow_nan=False)
        write_atomically(make_numbered_path(path, frame), (text + "\n").encode("ascii"), sync=False)


def _make_geometry(gallery: Gallery, frame: int, arrays: Arrays) -> list[Any]:
    """Return the points of a frame in the form of the file: a list of keys and values."""
    manifest, count = gallery.manifest, len(arrays["P"])
    points = [
        _format_numbers(name, values, kind) for name, (values, kind) in _make_point_attributes(gallery, frame, arrays).items()
    ]
    points += [_format_strings(name, table, indices) for name, (table, indices) in _make_text_attributes(gallery, arrays).items()]
    global_attributes = [
        _format_numbers("fps", np.array([1 / gallery.dt])),
        _format_numbers("meters_per_unit", np.array([UNIT_MM[manifest.units] / 1000])),
    ]  # fmt: skip
    if gallery.origin.any():
        global_attributes.append(
            _format_numbers("origin", _rotate_to_y_up(gallery.origin[None], manifest.up == "z"), storage="fpreal64")
        )
    return [
        "fileversion", "18.5.0", "hasindex", False, "pointcount", count, "vertexcount", 0, "primitivecount", 0,
        "info", {"software": f"antdsl {manifest.antdsl}", "scene": manifest.scene, "frame": frame},
        "topology", ["pointref", ["indices", []]],
        "attributes", ["pointattributes", points, "globalattributes", global_attributes],
    ]  # fmt: skip


def _make_point_attributes(gallery: Gallery, frame: int, arrays: Arrays) -> dict[str, tuple[NDArray[Any], str]]:
    """Return the numeric attributes of agents by name: the values, and Houdini's type of vector ("" for plain numbers)."""
    z_up = gallery.manifest.up == "z"
    turn = normalise_quaternion(np.asarray(arrays["orient"], np.float64))
    attributes = {"P": (_rotate_to_y_up(arrays["P"], z_up), "point")}
    if "v" in arrays:
        attributes["v"] = (_rotate_to_y_up(arrays["v"] + arrays.get("v_ground", np.float32(0)), z_up), "vector")
    attributes["w"] = (_rotate_to_y_up(_compute_angular_velocity(gallery, frame, arrays, turn), z_up), "vector")
    facing = multiply_quaternions(turn, np.broadcast_to(_Z_TO_X_ROTATION, turn.shape))
    attributes["orient"] = (
        multiply_quaternions(np.broadcast_to(_Z_TO_Y_ROTATION, turn.shape), facing) if z_up else facing,
        "quaternion",
    )
    attributes["pscale"] = (np.asarray(arrays["pscale"], np.float64), "")
    if "Cd" in arrays:
        attributes["Cd"] = (np.asarray(arrays["Cd"], np.float64), "color")
    if "id" in arrays:
        attributes["id"] = (np.asarray(arrays["id"], np.int64), "")
    for name, values in iterate_other_numbers(arrays, "geo"):
        if "." not in name:
            attributes[name] = (np.asarray(values, np.int64 if values.dtype.kind in "iu" else np.float64), "")
    return {name: (np.nan_to_num(values), kind) for name, (values, kind) in attributes.items()} | _make_clip_numbers(
        gallery, arrays
    )


def _make_text_attributes(gallery: Gallery, arrays: Arrays) -> dict[str, tuple[list[str], NDArray[np.int64]]]:
    """Return the text attributes of agents by name: a table of texts, and for each agent an index in it (-1 for none)."""
    manifest, count = gallery.manifest, len(arrays["P"])
    which = get_species_numbers(arrays)
    species = [entry.name for entry in manifest.species]
    ids = get_agent_ids(arrays)
    tables = {
        "species": (species, which),
        "agentname": ([f"{species[s]}_{n}" for s, n in zip(which.tolist(), ids.tolist(), strict=True)], np.arange(count)),
    }
    if "state" in arrays:
        states = [[state.name for state in entry.machines[0].states] if entry.machines else [] for entry in manifest.species]
        starts = np.cumsum([0, *map(len, states)])[:-1]
        known = np.asarray(arrays["state"], np.int64) + starts[which]
        tables["state"] = ([name for each in states for name in each], np.where([bool(states[s]) for s in which], known, -1))
    return tables | _make_clip_names(gallery, arrays)


def _make_clip_numbers(gallery: Gallery, arrays: Arrays) -> dict[str, tuple[NDArray[Any], str]]:
    """Return numeric attributes for the clips that each agent plays: `clipN_time` (seconds) and `clipN_weight`."""
    attributes: dict[str, tuple[NDArray[Any], str]] = {}
    for number, entry, rows, slot, (clip, turns, weight) in _iterate_played_clips(gallery, arrays):
        body = gallery.bodies.numbers(number, get_agent_ids(arrays)[rows])
        for name, values in (("time", turns * _find_clip_durations(gallery, number, entry)[body, clip]), ("weight", weight)):
            column, _ = attributes.setdefault(f"clip{slot}_{name}", (np.zeros(len(arrays["P"])), ""))
            column[rows] = values
    return attributes


def _make_clip_names(gallery: Gallery, arrays: Arrays) -> dict[str, tuple[list[str], NDArray[np.int64]]]:
    """Return text attributes for the clips that each agent plays: `clipN` (the clip's name) and `clipN_group` (its transform
    group)."""
    attributes: dict[str, tuple[list[str], NDArray[np.int64]]] = {}
    for _, entry, rows, slot, (clip, _, _) in _iterate_played_clips(gallery, arrays):
        for name, texts in (("", [each.name for each in entry.clips]), ("_group", [each.on for each in entry.clips])):
            table, indices = attributes.setdefault(f"clip{slot}{name}", ([], np.full(len(arrays["P"]), -1, np.int64)))
            indices[rows] = np.where(clip >= 0, clip + len(table), -1)
            table.extend(texts)
    return attributes


def _iterate_played_clips(gallery: Gallery, arrays: Arrays) -> Iterator[tuple[int, SpeciesEntry, NDArray[np.intp], int, Slot]]:
    """Yield the clips that agents play, species by species and slot by slot.

    The values are: the number of the species, its entry, the rows of its agents, the number of the slot, and the clips in the
    slot."""
    for number, entry in enumerate(gallery.manifest.species):
        rows = find_species_rows(arrays, number)
        machines = read_all_machine_clips(entry, arrays, len(rows))
        if machines and entry.clips:
            for slot, played in enumerate(_make_clip_slots(machines, len(rows))):
                yield number, entry, rows, slot, played


def _make_clip_slots(machines: Iterable[MachineClips], count: int) -> list[Slot]:
    """Return two slots per machine: first the clip that fades out, then the current clip.

    A slot consists of clip numbers, played cycles and weights of all agents. In antdsl, the clips of a machine replace those of
    earlier machines in proportion to their total weight. Houdini normalises the weights at each joint instead. With the returned
    weights, the result is the same for up to two machines."""
    slots, below = [], np.zeros(count)
    for machine in machines:
        fade = np.clip(machine.fade, 0, 1).astype(np.float64)
        layers = (
            (machine.before, machine.before_turns, machine.before_weight * fade),
            (machine.clip, machine.turns, machine.weight * (1 - fade)),
        )  # fmt: skip
        together = np.minimum(sum(np.where(clip >= 0, weight, 0.0) for clip, _, weight in layers), 1.0)
        over = np.where(
            below > 0, np.minimum(below / np.maximum(1 - together, 1 / _COVERING_CLIP_WEIGHT), _COVERING_CLIP_WEIGHT), 1.0
        )
        for clip, turns, weight in layers:
            slots.append((clip.astype(np.int64), turns.astype(np.float64), np.where(clip >= 0, weight * over, 0.0)))
        below = below + together * over
    return slots


def _find_clip_durations(gallery: Gallery, number: int, entry: SpeciesEntry) -> Floats:
    """Return the duration (s) of each clip of a species, with one row per body.

    A clip that a body does not have gets the duration 1. The last column, all zeros, stands for no clip."""
    bodies = [gallery.load_body(number, 0, which).definition.clips for which in range(len(gallery.bodies.keys(number)))]
    return np.array(
        [[*(clips[each.name].duration if each.name in clips else 1.0 for each in entry.clips), 0.0] for clips in bodies]
    )


def _compute_angular_velocity(gallery: Gallery, frame: int, arrays: Arrays, orientations: Floats) -> Floats:
    """Return the angular velocity (n, 3) of each agent in radians per second, from its rotation until the next frame.

    In the last frame, the rotation since the previous frame is used."""
    for other, sign in ((frame + 1, 1.0), (frame - 1, -1.0)):
        try:
            other_arrays = gallery.cache.frame(other, IDENTITY_ARRAYS | {"orient"})
        except CacheError:
            continue
        mine, theirs = make_agent_keys(arrays), make_agent_keys(other_arrays)
        _, rows, then = np.intersect1d(mine, theirs, assume_unique=True, return_indices=True)
        was, goes = orientations[rows], normalise_quaternion(np.asarray(other_arrays["orient"], np.float64))[then]
        step = multiply_quaternions(goes, was * (-1, -1, -1, 1))
        step = np.where(step[:, 3:] < 0, -step, step)
        sine = np.linalg.norm(step[:, :3], axis=1)
        angle = 2 * np.arctan2(sine, step[:, 3])
        velocity = np.zeros((len(orientations), 3))
        velocity[rows] = step[:, :3] * (sign * angle / np.maximum(sine, 1e-12) / gallery.dt)[:, None]
        return velocity
    return np.zeros((len(orientations), 3))


def _rotate_to_y_up(vectors: NDArray[Any], z_up: bool) -> Floats:
    """Return vectors (n, 3) of the scene in axes with y up. `z_up`: whether the scene has z up."""
    xyz = np.asarray(vectors, np.float64)
    return np.stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]], axis=1) if z_up else xyz


def _format_numbers(name: str, values: NDArray[Any], kind: str = "", storage: str = "fpreal32") -> list[Any]:
    """Return a numeric attribute with values (n,) or (n, k) in the form of the file: a list of keys and values."""
    is_integer = values.dtype.kind == "i"
    storage = "int64" if is_integer else storage
    size = 1 if values.ndim == 1 else values.shape[1]
    options: Mapping[str, Any] = {"type": {"type": "string", "value": kind}} if kind else {}
    if storage == "fpreal32":
        values = values.astype(np.float32)
    value_list = ["tuples", values.tolist()] if size > 1 else ["arrays", [values.tolist()]]
    default = ["size", 1, "storage", "int64" if is_integer else "fpreal64", "values", [0]]
    return [
        ["scope", "public", "type", "numeric", "name", name, "options", options],
        ["size", size, "storage", storage, "defaults", default, "values", ["size", size, "storage", storage, *value_list]],
    ]


def _format_strings(name: str, table: list[str], indices: NDArray[np.int64]) -> list[Any]:
    """Return a text attribute in the form of the file: a list of keys and values. `indices`: for each agent, the index in
    `table`."""
    return [
        ["scope", "public", "type", "string", "name", name, "options", {}],
        ["size", 1, "storage", "int32", "strings", table,
         "indices", ["size", 1, "storage", "int32", "arrays", [indices.tolist()]]],
    ]  # fmt: skip
