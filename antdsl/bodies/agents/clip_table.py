"""All clips of a definition as rows of one table, one row a sample, so that one gather takes the samples of all agents."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats, decomposed, normalised
from antdsl.bodies.agents.definition import Clip, Definition, Rig, TransformGroup

REST = -1  # the number of no clip: the rest pose, and the defaults of channels


@dataclass(frozen=True, slots=True, eq=False)
class ClipTable:
    """Samples of all clips, for J joints and C channels of one rig.

    `names`: of clips, whose numbers are their places. `samples` float32[R, W]: row 0 is the rest pose with the defaults of
    channels, and a clip has the rows from `first[clip + 1]` on; a row is translations (3 J, component by component), rotations
    (4 J), scales (3 J, if `scaled`), shears (3 J, if `sheared`) and channels (C), where a clip does not say otherwise those of
    the rest. Joints stand by their depth in the rig's tree: `order` int32[J] gives the rig's number of each, `levels` the joints
    of each depth as (begin, end, places of their parents). Rotations follow each other by the shorter way within a clip."""

    rig: Rig
    names: tuple[str, ...]
    samples: Floats
    first: NDArray[np.int64]
    counts: NDArray[np.int64]
    rates: NDArray[np.float64]
    loops: NDArray[np.bool_]
    order: NDArray[np.intp]
    levels: tuple[tuple[int, int, NDArray[np.intp]], ...]
    scaled: bool
    sheared: bool

    def number(self, name: str) -> int:
        """The number of a clip. Raises KeyError."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(name) from None

    def duration(self, number: int) -> float:
        """Seconds from the first sample of a clip to its last."""
        return float(self.counts[number + 1] - 1) / float(self.rates[number + 1])

    def weights(self, group: TransformGroup) -> tuple[Floats, Floats]:
        """The weights of a transform group: float32[J] of joints, in the order of the table, and float32[C] of channels, 1 for
        those it names. Raises KeyError for a name that the rig does not have."""
        joints, channels = np.zeros(len(self.order), np.float32), np.zeros(len(self.rig.channels), np.float32)
        for name, weight in group.members:
            joints[self.rig.joint(name)] = weight
        for name in group.channels:
            channels[self.rig.channel(name)] = 1
        return joints[self.order], channels


def clip_table(definition: Definition) -> ClipTable:
    """Lay out the clips of a definition. Joints and channels of clips that the rig does not have are left out: clips are shared
    between rigs. Raises ValueError where arrays of a clip do not fit each other, or where the rig's tree has a circle."""
    rig = definition.rig
    order, levels = _by_depth(rig)
    clips = tuple(definition.clips.values())
    rest = decomposed(rig.rest)
    rest[3][np.abs(rest[3]) < 1e-7] = 0  # what is left of rounding is no shear
    scaled = bool((np.abs(rest[2] - 1) > 1e-6).any()) or any((clip.scale != 1).any() for clip in clips)
    sheared = bool(rest[3].any()) or any(clip.shear is not None and clip.shear.any() for clip in clips)
    kept = [*rest[:2], *([rest[2]] if scaled else []), *([rest[3]] if sheared else [])]
    blocks = [_row(rig, kept, order)]
    for clip in clips:
        blocks.append(_rows(clip, rig, kept, order, scaled, sheared))
    counts = np.array([len(block) for block in blocks], np.int64)
    return ClipTable(
        rig, tuple(definition.clips), np.concatenate(blocks), np.concatenate([[0], np.cumsum(counts)[:-1]]), counts,
        np.array([1.0, *(clip.rate for clip in clips)]), np.array([False, *(clip.loop for clip in clips)]),
        order, levels, scaled, sheared,
    )  # fmt: skip


def _by_depth(rig: Rig) -> tuple[NDArray[np.intp], tuple[tuple[int, int, NDArray[np.intp]], ...]]:
    """The joints of a rig by their depth, and where each depth begins and ends."""
    parents = np.asarray(rig.parents, np.intp)
    depth, above = np.zeros(len(parents), np.intp), parents.copy()
    while (above >= 0).any():
        depth += above >= 0
        above = np.where(above >= 0, parents[above], -1)
        if depth.max(initial=0) > len(parents):
            raise ValueError("joints of the rig are their own ancestors")
    order = np.argsort(depth, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    bounds = np.searchsorted(depth[order], np.arange(depth.max(initial=-1) + 2))
    levels = tuple(
        (int(a), int(b), place[parents[order[a:b]]] if parents[order[a]] >= 0 else np.zeros(0, np.intp))
        for a, b in pairwise(bounds)
    )
    return order, levels


def _row(rig: Rig, rest: list[NDArray[np.float64]], order: NDArray[np.intp]) -> Floats:
    return np.concatenate([*(part[:, order].reshape(-1) for part in rest), rig.defaults]).astype(np.float32)[None]


def _rows(clip: Clip, rig: Rig, rest: list[NDArray[np.float64]], order: NDArray[np.intp], scaled: bool, sheared: bool) -> Floats:
    """The rows of a clip: its samples where it has some, the rest where not."""
    count = clip.samples
    if count < 1 or not clip.rate > 0:
        raise ValueError(f"clip `{clip.name}` has no samples, or a rate that is not above 0")
    given = [clip.translation, clip.rotation, *([clip.scale] if scaled else []), *([clip.shear] if sheared else [])]
    wanted = [(count, len(clip.joints), width) for width in (3, 4, 3, 3)]
    found = [np.repeat(part[None], count, 0) for part in rest]
    numbers = {name: number for number, name in enumerate(rig.names)}
    known = [(place, numbers[name]) for place, name in enumerate(clip.joints) if name in numbers]
    there, here = (np.array(side, np.intp) for side in zip(*known, strict=True)) if known else (np.zeros(0, np.intp),) * 2
    for place, part in enumerate(given):
        if part is None:
            found[place][:, :, here] = 0  # a clip without shears says that there are none
            continue
        if clip.joints and part.shape != wanted[place]:
            raise ValueError(f"clip `{clip.name}` has an array {part.shape} where {wanted[place]} is needed")
        if known:
            found[place][:, :, here] = np.moveaxis(part.astype(np.float64)[:, there], 2, 1)
    found[1] = _shorter(normalised(np.moveaxis(found[1], 1, 0)), rest[1])
    values = np.repeat(rig.defaults[None], count, 0)
    names = {each.name: number for number, each in enumerate(rig.channels)}
    for place, name in enumerate(clip.channels):
        if name in names:
            values[:, names[name]] = clip.values[:, place]
    rows = [part[:, :, order].reshape(count, -1) for part in found]
    return np.concatenate([*rows, values], axis=1).astype(np.float32)


def _shorter(rotation: NDArray[np.float64], rest: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions [4, F, J] as [F, 4, J] with the sign of each sample by which it is near the one before it, the first near the
    rest [4, J]: then interpolation goes the shorter way without asking, and clips seldom have to be turned to each other."""
    before = np.concatenate([rest[:, None], rotation[:, :-1]], 1)
    near = before * rotation
    dots = ((near[0] + near[1]) + near[2]) + near[3]
    sign = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.moveaxis(rotation * sign, 0, 1)
