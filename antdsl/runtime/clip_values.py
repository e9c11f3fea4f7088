"""Properties of the clips that a species plays, from the definition of its body and the clip names of its states."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.world import Population, World
from antdsl.scene.setting import ClipData

_UNKNOWN_CLIP = ClipData()


def clip_table(world: World, population: Population, what: str) -> NDArray[np.float32]:
    """Return a property of each clip of the species' plan; the last entry is for an unknown clip.

    `what`: the property `seconds`, `stride`, `loop` or `mark NAME`."""
    known = world.setting.clips.get(population.name, {})
    every = [known.get(each.name, _UNKNOWN_CLIP) for each in population.plan.clips]
    return np.array([_clip_number(each, what) for each in (*every, _UNKNOWN_CLIP)], np.float32)


def clip_value(world: World, population: Population, what: str, clip: Any) -> NDArray[np.float32]:
    """Return a property of clips, given by their numbers in the species' plan. No clip has the value of an unknown clip."""
    values = clip_table(world, population, what)
    number, last = np.asarray(clip), len(values) - 1
    chosen_values: NDArray[np.float32] = values[np.where((number >= 0) & (number < last), number, last)]
    return chosen_values


def _clip_number(clip: ClipData, what: str) -> float:
    if what.startswith("mark "):
        return clip.marks.get(what.removeprefix("mark "), -1.0)
    return float(getattr(clip, what))
