"""What agents play in a frame, as few bytes: up to three clips a machine with how far each is and how much it weighs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.machine_clips import MachineClips

NONE = 65535  # the number of no clip
_WHOLE = 65535  # one turn of a clip, or a weight of 1


def packed(told: MachineClips, loops: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """What one machine of n agents plays, uint16[n, 3, k]: numbers, how far through, and weights of the clip and of the one
    before; k is 2, and where anybody still plays the one before that, 3. `loops`: of each clip that the species plays, and False
    for none; one that does not ends with its last sample."""
    slots = list(told.slots())[::-1]
    if not slots[-1][2].any():
        slots.pop()
    made = np.empty((len(told.clip), 3, len(slots)), np.uint16)
    for place, (clip, turns, weight) in enumerate(slots):
        known = (clip >= 0) & (clip < len(loops) - 1)
        exact = np.nan_to_num(turns.astype(np.float64))
        again = loops[np.where(known, clip, -1)]
        made[:, 0, place] = np.where(known, clip, NONE)
        made[:, 1, place] = np.round(np.where(again, exact - np.floor(exact), np.clip(exact, 0, 1)) * _WHOLE)
        made[:, 2, place] = np.round(np.clip(np.nan_to_num(weight), 0, 1) * _WHOLE)
    return made
