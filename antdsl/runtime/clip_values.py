"""Reads properties of animation clips. The bodies of a species define its clips, and the states of the species name them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.body_rows import find_body_numbers
from antdsl.runtime.world import Population, World
from antdsl.scene.setting import ClipData

_UNKNOWN_CLIP = ClipData()


def make_clip_table(world: World, population: Population, property_name: str) -> NDArray[np.float32]:
    """Return the values of one clip property: one for each clip of the species' plan, then one for an unknown clip.

    For a species with several bodies, the table has such a group of values for each body. `property_name`: `seconds`,
    `stride`, `loop` or `mark NAME`."""
    every = []
    for key in world.setting.list_body_keys(population.name):
        known = world.setting.clips.get(key, {})
        every += [*(known.get(each.name, _UNKNOWN_CLIP) for each in population.plan.clips), _UNKNOWN_CLIP]
    return np.array([_read_clip_property(each, property_name) for each in every], np.float32)


def find_clip_table_starts(world: World, population: Population) -> NDArray[np.int32]:
    """Return, for each agent, the index at which the values of its body begin in the result of `make_clip_table`, int32[n]."""
    return find_body_numbers(population, world.setting).astype(np.int32) * np.int32(len(population.plan.clips) + 1)


def read_clip_value(
    world: World, population: Population, property_name: str, clip: Any, rows: Any = slice(None)
) -> NDArray[np.float32]:
    """Return a property of the clips numbered `clip`. An agent without a clip gets the value of an unknown clip.

    `clip`: numbers of clips in the species' plan. `rows`: the rows of the agents with these clips."""
    values = make_clip_table(world, population, property_name)
    number, last = np.asarray(clip), len(population.plan.clips)
    place = np.where((number >= 0) & (number < last), number, last)
    if len(values) > last + 1:
        place = place + find_clip_table_starts(world, population)[rows]
    chosen_values: NDArray[np.float32] = values[place]
    return chosen_values


def _read_clip_property(clip: ClipData, property_name: str) -> float:
    if property_name.startswith("mark "):
        return clip.marks.get(property_name.removeprefix("mark "), -1.0)
    return float(getattr(clip, property_name))
