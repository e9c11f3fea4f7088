"""What agents play in a frame, as few bytes: two clips a machine with how far each is and how much it weighs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.machine_clips import MachineClips

NONE = 65535  # the number of no clip
_WHOLE = 65535  # one turn of a clip, or a weight of 1


def packed(told: MachineClips, loops: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """What one machine of n agents plays, uint16[n, 6]: clip, the one before, how far through each is, the weight of each.
    `loops`: of each clip that the species plays, and False for none; one that does not ends with its last sample."""
    fade = np.clip(np.nan_to_num(told.fade), 0, 1)
    made = np.empty((len(fade), 6), np.uint16)
    slots = ((told.clip, told.turns, told.weight, 1 - fade), (told.before, told.before_turns, told.before_weight, fade))
    for place, (clip, turns, weight, share) in enumerate(slots):
        known = (clip >= 0) & (clip < len(loops) - 1)
        exact = np.nan_to_num(turns.astype(np.float64))
        again = loops[np.where(known, clip, -1)]
        made[:, place] = np.where(known, clip, NONE)
        made[:, 2 + place] = np.round(np.where(again, exact - np.floor(exact), np.clip(exact, 0, 1)) * _WHOLE)
        made[:, 4 + place] = np.round(np.clip(np.nan_to_num(weight) * share, 0, 1) * _WHOLE)
    return made
