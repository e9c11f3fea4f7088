"""What agents do with their bodies in a frame: the clips that they play, and how they stand on their feet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.machine_clips import MachineClips
from antdsl.outputs.cache.clip_arrays import clips_playing, machine_clips, playing
from antdsl.pipeline import Shot
from antdsl.preview.timeline import Light
from antdsl.preview.viewing.bodies import body_of_species
from antdsl.preview.viewing.plays import packed
from antdsl.preview.viewing.rigs import posed_body
from antdsl.preview.viewing.stances import stances
from antdsl.runtime import Population, World

Arrays = dict[str, NDArray[Any]]


def acts(world: World, shot: Shot, population: Population, light: Light) -> Arrays:
    """`SPECIES/plays/MACHINE` of machines that play, and `SPECIES/feet` and `SPECIES/stance` where feet are worked out; `light`:
    what else a frame tells of these agents, by id."""
    name = population.name
    definition = body_of_species(shot, name)
    told = clips_playing(population, population.in_id_order())
    found = {each: machine_clips(name, each, told, len(population.ids)) for each in playing(population)}
    machines = {each: plays for each, plays in found.items() if plays is not None}
    clips = [definition.clips.get(clip.name) for clip in population.plan.clips]
    loops = np.array([*(clip is not None and clip.loop for clip in clips), False])
    arrays: Arrays = {f"{name}/plays/{each}": packed(clip, loops) for each, clip in machines.items()}
    if name in world.feet and len(light.ids):
        arrays |= _standing(world, shot, population, light, tuple(machines.values()))
    return arrays


def _standing(world: World, shot: Shot, population: Population, light: Light, machines: tuple[MachineClips, ...]) -> Arrays:
    name = population.name
    definition = body_of_species(shot, name)
    plays = tuple((clip.name, clip.on) for clip in population.plan.clips)
    body = posed_body(definition, plays)
    if body.legs is None:
        return {}
    played = (*body.idling(light.ids, world.frame * world.dt), *machines)
    stands = body.legs.kept((*plays, (definition.idle, "")), played, len(light.ids))
    return {f"{name}/{what}": array for what, array in stances(body.legs, world.feet[name], light, stands).items()}
