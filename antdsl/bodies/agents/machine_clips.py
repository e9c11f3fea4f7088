"""Converts the clips that state machines of agents play to clips in a tree of layers.

Each machine has one layer, which lies above the layers of the previous machines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats
from antdsl.bodies.agents.blending import (
    ADDITIVE_BLEND_MODE,
    INTERPOLATE_BLEND_MODE,
    NO_PARENT_LAYER,
    OVERRIDE_BLEND_MODE,
    ClipBlendTree,
    ClipPlayback,
)
from antdsl.bodies.agents.poses import REST_CLIP, ClipTable


@dataclass(frozen=True, slots=True, eq=False)
class MachineClips:
    """The clips that one state machine plays, for n agents. At most three clips of an agent overlap: the clip of the current
    state (`clip`), the previous clip, which fades out (`before`), and the clip before that, if it is still fading out
    (`earlier`).

    `clip`, `before`, `earlier`: int[n], indices into the clips that the species plays, -1 for none.
    `turns`, `before_turns`, `earlier_turns`: float32[n], the number of cycles of the clip played so far, including fractions.
    `weight`, `before_weight`, `earlier_weight`: float32[n], the weights of the clips, from 0 to 1.
    `fade`: float32[n], the fraction of the pose that still comes from `before` and `earlier`.
    `earlier_fade`: float32[n], the fraction of `fade` that belongs to `earlier`.

    The fields of `earlier` are None if no agent has such a clip."""

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

    def iterate_clip_slots(self) -> Iterator[tuple[NDArray[np.int16], Floats, Floats]]:
        """Yield the overlapping clips of each agent, from the oldest to the current one.

        Each item has three arrays [n]: the clip's index, the number of cycles played, and the clip's weight in the pose."""
        fade = np.clip(self.fade, 0, 1)
        if self.earlier is None or self.earlier_turns is None or self.earlier_weight is None or self.earlier_fade is None:
            part = np.zeros_like(fade)
            yield self.before, self.before_turns, part
        else:
            part = np.clip(self.earlier_fade, 0, 1)
            yield self.earlier, self.earlier_turns, self.earlier_weight * (part * fade)
        yield self.before, self.before_turns, self.before_weight * ((1 - part) * fade)
        yield self.clip, self.turns, self.weight * (1 - fade)


EARLIER_CLIP_FIELDS = ("earlier", "earlier_turns", "earlier_weight", "earlier_fade")


class PlayedClip(NamedTuple):
    """A clip that a statement of a state plays on the joints of a transform group.

    `group`: the transform group, "" for the complete rig.
    `add`: whether the clip is additive: its differences from the rest pose are added to the result of all other clips.
    `left_turn_clip`, `right_turn_clip`, `climbing_clip`, `descending_clip`: the clips that replace `clip` while an agent turns,
        climbs or descends; "" for none."""

    clip: str
    group: str = ""
    add: bool = False
    left_turn_clip: str = ""
    right_turn_clip: str = ""
    climbing_clip: str = ""
    descending_clip: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _ClipSlot:
    """For each of n agents, one clip that a machine contributes to its pose.

    `machine`: the number of the machine.
    `is_additive`: whether the clip is additive.
    `clips`: int32[n], the clip's number in the `ClipTable`.
    `times`: float64[n], the time in the clip, in seconds.
    `weights`: float32[n], the clip's weight in the machine's layer.
    `groups`: int64[n], the index of the clip's transform group."""

    machine: int
    is_additive: bool
    clips: NDArray[np.int32]
    times: NDArray[np.float64]
    weights: Floats
    groups: NDArray[np.int64]


def build_machine_playback(
    table: ClipTable, clips: Sequence[tuple[str, str] | PlayedClip], machines: Sequence[MachineClips], count: int,
    lean: Floats | None = None,
) -> ClipPlayback:  # fmt: skip
    """Return the `ClipPlayback` of `count` agents, from the clips that their state machines play.

    `clips`: all clips of the species, which `machines` refers to by index. A name that the table lacks means no clip.
    `lean`: float32[n, 2], how much each agent turns (-1 right to 1 left) and climbs (-1 down to 1 up).

    Each machine has a layer: the mean of its clips, weighted by fade and weight. The layer replaces the result of the previous
    machines in proportion to its total weight. So the previous machines become visible where it fades out. Additive clips are
    added to the result of all layers, in the order of the machines."""
    played = [PlayedClip(*each) for each in clips]
    groups = ["", *sorted({each.group for each in played} - {""})]
    slots = [
        slot
        for k, machine in enumerate(machines)
        for slot in _iterate_slots(table, played, groups, k, machine, lean)
        if not slot.is_additive or slot.weights.any()
    ]
    chosen, times = np.full((count, len(slots)), REST_CLIP, np.int32), np.zeros((count, len(slots)))
    weights, used = np.zeros((count, len(slots)), np.float32), np.zeros((count, len(slots)), np.int64)
    for place, slot in enumerate(slots):
        chosen[:, place], times[:, place] = slot.clips, slot.times
        weights[:, place], used[:, place] = slot.weights, slot.groups
    added = sorted({slot.machine for slot in slots if slot.is_additive})
    # Layer 0 contains the layers of the machines over each other. Added clips have separate layers behind the topmost one.
    layer_of = tuple(2 + len(machines) + added.index(slot.machine) if slot.is_additive else 1 + slot.machine for slot in slots)
    modes: tuple[int, ...] = (OVERRIDE_BLEND_MODE, *(INTERPOLATE_BLEND_MODE,) * len(machines))
    parents: tuple[int, ...] = (NO_PARENT_LAYER, *(0,) * len(machines))
    if added:
        top = len(modes)
        modes = (*modes, ADDITIVE_BLEND_MODE, *(INTERPOLATE_BLEND_MODE,) * len(added))
        parents = (top, *(0,) * len(machines), NO_PARENT_LAYER, *(top,) * len(added))
    layers = np.ones((count, len(modes)), np.float32)
    for layer in {*range(1, 1 + len(machines)), *layer_of}:
        layers[:, layer] = weights[:, [place for place, each in enumerate(layer_of) if each == layer]].sum(axis=1)
    # Agents with equal groups in equal slots share a tree. A slot without weight may have any group.
    used[weights == 0] = 0
    kinds, tree = np.unique(used, axis=0, return_inverse=True)
    trees = tuple(ClipBlendTree(layer_of, tuple(groups[g] for g in kind), modes, parents) for kind in kinds)
    return ClipPlayback(trees, tree.reshape(-1).astype(np.int32), chosen, times, weights, layers)


def _iterate_slots(
    table: ClipTable,
    played_clips: Sequence[PlayedClip],
    groups: Sequence[str],
    number: int,
    machine: MachineClips,
    lean: Floats | None,
) -> Iterator[_ClipSlot]:
    """Yield the clips that a machine contributes to the pose. Each additive clip is in a separate slot."""
    names = [
        (each.clip, each.left_turn_clip, each.right_turn_clip, each.climbing_clip, each.descending_clip) for each in played_clips
    ]
    numbers = np.array([[_find_clip_number(table, name) for name in row] for row in (*names, ("",) * 5)], np.int32)
    seconds = np.array([[table.get_duration(n) if n != REST_CLIP else 0.0 for n in row] for row in numbers])
    loops = np.array([bool(table.is_looping[n + 1]) for n in numbers[:, 0]])
    group_of = np.array([groups.index(each.group) for each in played_clips] + [0])
    adds = np.array([each.add for each in played_clips] + [False])
    parts = list(machine.iterate_clip_slots())
    for clip, turns, weight in parts if parts[0][2].any() else parts[1:]:  # three simultaneous clips are rare
        row = np.where((clip >= 0) & (clip < len(played_clips)), clip, len(played_clips))
        exact = turns.astype(np.float64)
        far = np.where(loops[row], exact - np.floor(exact), np.minimum(exact, 1.0))
        for side, share in enumerate(_iterate_lean_shares(numbers[row], lean)):
            if share is None:
                continue
            for add in (False, True) if adds.any() else (False,):
                yield _ClipSlot(
                    number, add, numbers[row, side], far * seconds[row, side],
                    np.where(adds[row] == add, weight * share, np.float32(0)), group_of[row],
                )  # fmt: skip


def _iterate_lean_shares(numbers: NDArray[np.int32], lean: Floats | None) -> Iterator[Floats | None]:
    """Yield five weights [n] of each agent: for its clip, and for the variants that replace the clip (left, right, climbing,
    descending).

    The item of a variant that no agent uses is None."""
    ones = np.ones(len(numbers), np.float32)
    if lean is None or not (numbers[:, 1:] != REST_CLIP).any():
        yield ones
        return
    side_shares = np.stack([lean[:, 0], -lean[:, 0], lean[:, 1], -lean[:, 1]], axis=1)
    side_shares = np.where(numbers[:, 1:] != REST_CLIP, np.clip(np.nan_to_num(side_shares), 0, 1), 0).astype(np.float32)
    side_shares /= np.maximum(side_shares.sum(axis=1), 1)[:, None]
    yield 1 - side_shares.sum(axis=1)
    for side_share in side_shares.T:
        yield np.ascontiguousarray(side_share) if side_share.any() else None


def _find_clip_number(table: ClipTable, name: str) -> int:
    """Return the number of the clip called `name`, or REST_CLIP if the table does not have it."""
    return table.names.index(name) if name in table.names else REST_CLIP
