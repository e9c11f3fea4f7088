"""What agents play in a frame, as few bytes: two clips a machine with how far each is and how much it weighs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.machine_clips import FIELDS
from antdsl.outputs.cache.clip_arrays import clips_playing, playing
from antdsl.runtime import Population

NONE = 65535  # the number of no clip
_WHOLE = 65535  # one turn of a clip, or a weight of 1


def plays(population: Population, rows: NDArray[np.intp], loops: Sequence[bool]) -> dict[str, NDArray[np.uint16]]:
    """`SPECIES/plays/MACHINE` uint16[n, 6] of agents at some rows, for machines that play: clip, the one before, how far through
    each is, the weight of each. `loops`: of each clip that the species plays; one that does not ends with its last sample."""
    arrays, found = clips_playing(population, rows), {}
    again = np.array([*loops, False])
    for machine in playing(population):
        told = {name: arrays[f"clips.{population.name}.{machine}.{name}"] for name in FIELDS}
        found[f"{population.name}/plays/{machine}"] = _packed(told, again)
    return found


def _packed(told: Mapping[str, NDArray[Any]], loops: NDArray[np.bool_]) -> NDArray[np.uint16]:
    fade = np.clip(np.nan_to_num(told["fade"]), 0, 1)
    made = np.empty((len(fade), 6), np.uint16)
    for place, (clip, share) in enumerate((("clip", 1 - fade), ("before", fade))):
        number = told[clip].astype(np.int64)
        known = (number >= 0) & (number < len(loops) - 1)
        turns = np.nan_to_num(told["turns" if place == 0 else "before_turns"].astype(np.float64))
        turns = np.where(loops[np.where(known, number, -1)], turns - np.floor(turns), np.clip(turns, 0, 1))
        weight = np.clip(np.nan_to_num(told["weight" if place == 0 else "before_weight"]) * share, 0, 1)
        made[:, place] = np.where(known, number, NONE)
        made[:, 2 + place] = np.round(turns * _WHOLE)
        made[:, 4 + place] = np.round(weight * _WHOLE)
    return made
