"""What agents do with their bodies in a frame: the clips that they play, and how they stand on their feet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.blending import posed
from antdsl.bodies.agents.clip_table import ClipTable, clip_table
from antdsl.bodies.agents.definition import Definition, TransformGroup
from antdsl.bodies.agents.driving import with_channels
from antdsl.bodies.agents.machine_clips import MachineClips, Played, machines_playing
from antdsl.bodies.agents.varied_bodies import Draws, place_of, size_of
from antdsl.bodies.blend_targets import of_channels, weights_of
from antdsl.outputs.cache.clip_arrays import clips_playing, machine_clips, playing
from antdsl.outputs.cache.shown_arrays import layers_worn, shown
from antdsl.pipeline import Shot
from antdsl.preview.session import Session
from antdsl.preview.timeline import Light, Posed
from antdsl.preview.viewing.plays import packed
from antdsl.preview.viewing.rigs import Outfit, Traits, outfit, posed_body, traits
from antdsl.preview.viewing.stances import stances
from antdsl.runtime import Population, World

Arrays = dict[str, NDArray[Any]]


def remember(session: Session) -> None:
    """Keep what bodies do at the session's frame beside the places that are remembered of it, once."""
    world, lights = session.world, session.shown(session.frame)
    if lights is not None and session.frame not in session.timeline.poses:
        found = {name: _posed(session, each, lights[name]) for name, each in world.populations.items() if name in lights}
        session.timeline.poses.put(session.frame, found)


def remembered(session: Session, frame: int) -> dict[str, Arrays]:
    """What is kept of what bodies did at a frame, by species, of those that have the bodies and clips now that they had then."""
    found = {}
    for name, then in session.timeline.poses.get(frame, {}).items():
        population = session.world.populations.get(name)
        if population is not None and outfit(session.world, session.shot, population) == then.worn:
            found[name] = then.arrays
    return found


def _posed(session: Session, population: Population, light: Light) -> Posed:
    worn = outfit(session.world, session.shot, population)
    return Posed(worn, acts(session.world, session.shot, population, light))


def acts(world: World, shot: Shot, population: Population, light: Light) -> Arrays:
    """`SPECIES/plays/MACHINE` of machines that play; of who has such `SPECIES/wears` uint32[n] (a bit for each layer),
    `SPECIES/look/GROUP` int8[n, 3] (127 is 1) and `SPECIES/lean` the same (turn, slope, 0), `SPECIES/trait/K` float32[n, 3]
    (three of what bodies differ by, in order); `SPECIES/feet` and `SPECIES/stance`
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
    arrays |= _differing(
        world, population, rows, worn, (*posed_body(worn).idling(light.ids, world.frame * world.dt), *machines.values())
    )
    if name in world.feet and len(light.ids):
        arrays |= _standing(world, name, worn, light, tuple(machines.values()))
    return {f"{name}/{what}": array for what, array in arrays.items()}


def _shown(world: World, population: Population, rows: NDArray[np.intp], worn: Outfit) -> Arrays:
    arrays: Arrays = {}
    if not worn.layers and not worn.looks and not worn.leans:
        return arrays
    told = shown(population, world.setting, rows)
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


def _differing(
    world: World, population: Population, rows: NDArray[np.intp], worn: Outfit, machines: tuple[MachineClips, ...]
) -> Arrays:
    differ, varied = traits(worn), worn.definition.variation
    if not differ.count or not len(rows):
        return {}
    draws = Draws(population.ids[rows], world.setting.seed, population.name)
    found = np.zeros((len(rows), -(-differ.count // 3) * 3), np.float32)
    parts = [size_of(varied, name, draws) for name in differ.scales]
    parts += [place_of(varied, name, draws) for name in differ.materials]
    first = len(differ.targets)
    if first:
        told = shown(population, world.setting, rows)
        said = {each: told[f"channels.{population.name}.{each}"] for each in population.plan.channels}
        found[:, :first] = blended_by(worn, differ, machines, len(rows), said, told.get(f"leans.{population.name}"))
    for k, part in enumerate(parts, first):
        found[:, k] = part
    return {f"trait/{k}": found[:, 3 * k : 3 * k + 3] for k in range(found.shape[1] // 3)}


def blended_by(
    worn: Outfit,
    differ: Traits,
    machines: Sequence[MachineClips],
    count: int,
    said: Mapping[str, NDArray[Any]],
    lean: NDArray[Any] | None = None,
) -> NDArray[np.float32]:
    """How much of each target of blend shapes agents have, float32[n, T], by the clips that they play and by what is said of
    channels."""
    table, groups = channel_table(worn.definition)
    plays = (*worn.plays, Played(worn.definition.idle))
    poses = posed(table, groups, machines_playing(table, plays, machines, count, lean))
    return weights_of(differ.targets, table.rig, with_channels(table, poses, said).channels)


@lru_cache(maxsize=8)
def channel_table(definition: Definition) -> tuple[ClipTable, Mapping[str, TransformGroup]]:
    alone = of_channels(definition)
    return clip_table(alone), alone.groups


def _standing(world: World, name: str, worn: Outfit, light: Light, machines: tuple[MachineClips, ...]) -> Arrays:
    body = posed_body(worn)
    if body.legs is None:
        return {}
    played = (*body.idling(light.ids, world.frame * world.dt), *machines)
    stands = body.legs.kept((*worn.plays, Played(worn.definition.idle)), played, len(light.ids))
    return dict(stances(body.legs, world.feet[name], light, stands))
