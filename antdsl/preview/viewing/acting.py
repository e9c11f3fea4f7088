"""What agents do with their bodies in a frame: the clips that they play, and how they stand on their feet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.machine_clips import MachineClips, Played
from antdsl.outputs.cache.clip_arrays import clips_playing, machine_clips, playing
from antdsl.outputs.cache.shown_arrays import layers_worn, shown
from antdsl.pipeline import Shot
from antdsl.preview.timeline import Light
from antdsl.preview.viewing.plays import packed
from antdsl.preview.viewing.rigs import Outfit, outfit, posed_body
from antdsl.preview.viewing.stances import stances
from antdsl.runtime import Population, World

Arrays = dict[str, NDArray[Any]]


def acts(world: World, shot: Shot, population: Population, light: Light) -> Arrays:
    """`SPECIES/plays/MACHINE` of machines that play; of who has such `SPECIES/wears` uint32[n] (a bit for each layer),
    `SPECIES/look/GROUP` int8[n, 3] (127 is 1) and `SPECIES/lean` the same (turn, slope, 0); `SPECIES/feet` and `SPECIES/stance`
    where feet are worked out. `light`: what else a frame tells of these agents, by id."""
    name, rows = population.name, population.in_id_order()
    worn = outfit(world, shot, population)
    told = clips_playing(population, rows)
    found = {each: machine_clips(name, each, told, len(rows)) for each in playing(population)}
    machines = {each: clip for each, clip in found.items() if clip is not None}
    clips = [worn.definition.clips.get(clip) for clip, *_ in worn.plays]
    loops = np.array([*(clip is not None and clip.loop for clip in clips), False])
    arrays: Arrays = {f"plays/{each}": packed(clip, loops) for each, clip in machines.items()}
    arrays |= _shown(world, population, rows, worn)
    if name in world.feet and len(light.ids):
        arrays |= _standing(world, name, worn, light, tuple(machines.values()))
    return {f"{name}/{what}": array for what, array in arrays.items()}


def _shown(world: World, population: Population, rows: NDArray[np.intp], worn: Outfit) -> Arrays:
    arrays: Arrays = {}
    if not worn.layers and not worn.looks and not worn.leans:
        return arrays
    told = shown(population, rows, world.setting)
    if worn.layers:
        known = layers_worn(population, world.setting)
        mask, found = told[f"wears.{population.name}"], np.zeros(len(rows), np.uint32)
        for k, layer in enumerate(worn.layers):
            found |= ((mask >> np.uint64(known.index(layer))) & np.uint64(1)).astype(np.uint32) << np.uint32(k)
        arrays["wears"] = found
    for group in worn.looks:
        arrays[f"look/{group}"] = np.rint(127 * np.nan_to_num(told[f"looks.{population.name}.{group}"])).astype(np.int8)
    if worn.leans:
        leans = np.nan_to_num(told[f"leans.{population.name}"])
        arrays["lean"] = np.rint(127 * np.clip(np.column_stack([leans, np.zeros(len(rows))]), -1, 1)).astype(np.int8)
    return arrays


def _standing(world: World, name: str, worn: Outfit, light: Light, machines: tuple[MachineClips, ...]) -> Arrays:
    body = posed_body(worn)
    if body.legs is None:
        return {}
    played = (*body.idling(light.ids, world.frame * world.dt), *machines)
    stands = body.legs.kept((*worn.plays, Played(worn.definition.idle)), played, len(light.ids))
    return dict(stances(body.legs, world.feet[name], light, stands))
