"""What the state machines of agents play, as a tree of clip layers: one layer a machine, each over those before it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats
from antdsl.bodies.agents.blending import INTERPOLATE, NO_PARENT, OVER, ClipTree, Playing
from antdsl.bodies.agents.clip_table import REST, ClipTable


@dataclass(frozen=True, slots=True, eq=False)
class MachineClips:
    """What one machine of each of n agents plays. `clip` and `before` int[n] count what the species plays, -1 for none: the clip
    of the state, and the one that gives way to it. `turns` and `before_turns` float32[n]: how often each has been played through;
    `weight` and `before_weight` their shares from 0 to 1; `fade`: as much of the pose is still the one before's. Of that,
    `earlier_fade` is still the clip's that gave way to the one before as it began to give way itself; None where none did."""

    clip: NDArray[np.int16]
    turns: Floats
    weight: Floats
    before: NDArray[np.int16]
    before_turns: Floats
    before_weight: Floats
    fade: Floats
    earlier: NDArray[np.int16] | None = None
    earlier_turns: Floats | None = None
    earlier_weight: Floats | None = None
    earlier_fade: Floats | None = None

    def rows(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> MachineClips:
        """The same of some agents."""
        parts: list[Any] = [getattr(self, name) for name in FIELDS]
        kept: list[Any] = [None if part is None else part[chosen] for part in parts]
        return MachineClips(*kept)

    def slots(self) -> Iterator[tuple[NDArray[np.int16], Floats, Floats]]:
        """Clips, turns and shares of the pose float32[n], the one that gave way first before the others."""
        fade = np.clip(self.fade, 0, 1)
        if self.earlier is None or self.earlier_turns is None or self.earlier_weight is None or self.earlier_fade is None:
            part = np.zeros_like(fade)
            yield self.before, self.before_turns, part
        else:
            part = np.clip(self.earlier_fade, 0, 1)
            yield self.earlier, self.earlier_turns, self.earlier_weight * (part * fade)
        yield self.before, self.before_turns, self.before_weight * ((1 - part) * fade)
        yield self.clip, self.turns, self.weight * (1 - fade)


EARLIER = ("earlier", "earlier_turns", "earlier_weight", "earlier_fade")
FIELDS = ("clip", "turns", "weight", "before", "before_turns", "before_weight", "fade", *EARLIER)


def machines_playing(table: ClipTable, clips: Sequence[tuple[str, str]], machines: Sequence[MachineClips], count: int) -> Playing:
    """What `count` agents play. `clips`: the name and the transform group ("" for the whole rig) of what their states play; a
    name that the table does not have stands for no clip.

    A machine's layer is the mean of its clips by fade and weight, and lies over those of the machines before it by as much as
    they weigh together: a clip that gives way to none fades out, and what is below shows."""
    numbers = np.array([_number(table, name) for name, _ in clips] + [REST], np.int32)
    seconds = np.array([table.duration(n) if n != REST else 0.0 for n in numbers])
    loops = np.array([bool(table.loops[n + 1]) for n in numbers])
    groups = ["", *sorted({group for _, group in clips} - {""})]
    group_of = np.array([groups.index(group) for _, group in clips] + [0])
    told = [list(machine.slots()) for machine in machines]
    told = [parts if parts[0][2].any() else parts[1:] for parts in told]  # seldom do three clips play at once
    layer_of = tuple(1 + k for k, parts in enumerate(told) for _ in parts)
    slots = len(layer_of)
    chosen, times = np.full((count, slots), REST, np.int32), np.zeros((count, slots))
    weights, layers = np.zeros((count, slots), np.float32), np.ones((count, 1 + len(machines)), np.float32)
    used = np.zeros((count, slots), np.int64)
    for slot, (clip, turns, weight) in enumerate(part for parts in told for part in parts):
        row = np.where((clip >= 0) & (clip < len(clips)), clip, len(clips))
        chosen[:, slot], used[:, slot] = numbers[row], group_of[row]
        exact = turns.astype(np.float64)
        times[:, slot] = np.where(loops[row], exact - np.floor(exact), np.minimum(exact, 1.0)) * seconds[row]
        weights[:, slot] = weight
    for k in range(len(machines)):
        own = [slot for slot, layer in enumerate(layer_of) if layer == 1 + k]
        layers[:, 1 + k] = weights[:, own].sum(axis=1)
    # Who has the same groups in the same places shares a tree; what has no weight may be of any group.
    used[weights == 0] = 0
    kinds, tree = np.unique(used, axis=0, return_inverse=True)
    modes, parents = (OVER, *(INTERPOLATE,) * len(machines)), (NO_PARENT, *(0,) * len(machines))
    trees = tuple(ClipTree(layer_of, tuple(groups[g] for g in kind), modes, parents) for kind in kinds)
    return Playing(trees, tree.reshape(-1).astype(np.int32), chosen, times, weights, layers)


def _number(table: ClipTable, name: str) -> int:
    return table.names.index(name) if name in table.names else REST
