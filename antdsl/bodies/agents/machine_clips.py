"""What the state machines of agents play, as a tree of clip layers: one layer a machine, each over those before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats
from antdsl.bodies.agents.blending import INTERPOLATE, NO_PARENT, OVER, ClipTree, Playing
from antdsl.bodies.agents.clip_table import REST, ClipTable


@dataclass(frozen=True, slots=True, eq=False)
class MachineClips:
    """What one machine of each of n agents plays. `clip` and `before` int[n] count what the species plays, -1 for none: the clip
    of the state, and the one that gives way to it. `turns` and `before_turns` float32[n]: how often each has been played through;
    `weight` and `before_weight` their shares from 0 to 1; `fade`: as much of the pose is still the one before's."""

    clip: NDArray[np.int16]
    turns: Floats
    weight: Floats
    before: NDArray[np.int16]
    before_turns: Floats
    before_weight: Floats
    fade: Floats

    def rows(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> MachineClips:
        """The same of some agents."""
        return MachineClips(*(getattr(self, name)[chosen] for name in FIELDS))


FIELDS = ("clip", "turns", "weight", "before", "before_turns", "before_weight", "fade")


def machines_playing(table: ClipTable, clips: Sequence[tuple[str, str]], machines: Sequence[MachineClips], count: int) -> Playing:
    """What `count` agents play. `clips`: the name and the transform group ("" for the whole rig) of what their states play; a
    name that the table does not have stands for no clip.

    A machine's layer is the mean of its two clips by fade and weight, and lies over those of the machines before it by as much as
    the two weigh together: a clip that gives way to none fades out, and what is below shows."""
    numbers = np.array([_number(table, name) for name, _ in clips] + [REST], np.int32)
    seconds = np.array([table.duration(n) if n != REST else 0.0 for n in numbers])
    loops = np.array([bool(table.loops[n + 1]) for n in numbers])
    groups = ["", *sorted({group for _, group in clips} - {""})]
    group_of = np.array([groups.index(group) for _, group in clips] + [0])
    slots = 2 * len(machines)
    chosen, times = np.full((count, slots), REST, np.int32), np.zeros((count, slots))
    weights, layers = np.zeros((count, slots), np.float32), np.ones((count, 1 + len(machines)), np.float32)
    used = np.zeros((count, slots), np.int64)
    for k, machine in enumerate(machines):
        fade = np.clip(machine.fade, 0, 1)
        told = (
            (machine.before, machine.before_turns, machine.before_weight * fade),
            (machine.clip, machine.turns, machine.weight * (1 - fade)),
        )
        for slot, (clip, turns, weight) in enumerate(told, 2 * k):
            row = np.where((clip >= 0) & (clip < len(clips)), clip, len(clips))
            chosen[:, slot], used[:, slot] = numbers[row], group_of[row]
            exact = turns.astype(np.float64)
            times[:, slot] = np.where(loops[row], exact - np.floor(exact), np.minimum(exact, 1.0)) * seconds[row]
            weights[:, slot] = weight
        layers[:, 1 + k] = weights[:, 2 * k] + weights[:, 2 * k + 1]
    # Who has the same groups in the same places shares a tree; what has no weight may be of any group.
    used[weights == 0] = 0
    kinds, tree = np.unique(used, axis=0, return_inverse=True)
    layer_of = tuple(1 + slot // 2 for slot in range(slots))
    modes, parents = (OVER, *(INTERPOLATE,) * len(machines)), (NO_PARENT, *(0,) * len(machines))
    trees = tuple(ClipTree(layer_of, tuple(groups[g] for g in kind), modes, parents) for kind in kinds)
    return Playing(trees, tree.reshape(-1).astype(np.int32), chosen, times, weights, layers)


def _number(table: ClipTable, name: str) -> int:
    return table.names.index(name) if name in table.names else REST
