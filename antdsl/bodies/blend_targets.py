"""The blend shapes of a mesh as targets with a weight each for every agent: what graphics hardware adds to vertices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats
from antdsl.bodies.agents.blend_shapes import blend_shapes, difference, knots_of, matched, shares_of
from antdsl.bodies.agents.definition import Binding, Clip, Definition, Rig, Shape
from antdsl.bodies.agents.deformers import SKINNING, steps
from antdsl.bodies.agents.transforms import world_matrices


@dataclass(frozen=True, slots=True)
class Target:
    """A piece of the way of one input: the channel that weighs it, the weights at which the input has shapes of its own, and
    which of these shapes it is."""

    channel: str
    knots: tuple[float, ...]
    place: int


def blend_targets(
    definition: Definition, bindings: Sequence[Binding], taken: NDArray[np.integer]
) -> dict[Target, NDArray[np.float32]]:
    """What each target adds at its whole weight to the rest pose of a skinned mesh, float32[v, 6]: to points and to normals.
    Those of shapes that are blended before anything else deforms them; `taken` int[v]: which vertices, counted
    through all bindings."""
    sizes = [len(definition.shapes[each.shape].points) for each in bindings]
    starts = np.cumsum([0, *sizes])
    found: dict[Target, NDArray[np.float32]] = {}
    rest = world_matrices(definition.rig.parents, definition.rig.rest)
    for start, binding in zip(starts, bindings, strict=False):
        shape, chain = definition.shapes[binding.shape], steps(binding.deformer) if binding.deformer else ()
        if shape.blend is None or chain[:1] != (blend_shapes,):
            continue
        carried = binding.transform and not any(step in SKINNING for step in chain)
        turn = rest[definition.rig.joint(binding.transform)][:3, :3] if carried else np.eye(3)
        for target, rows, offsets in _offsets(definition, shape, turn):
            whole = found.setdefault(target, np.zeros((int(starts[-1]), 6), np.float32))
            whole[start + rows] += offsets
    return {target: offsets[taken] for target, offsets in found.items()}


def _offsets(
    definition: Definition, shape: Shape, turn: NDArray[np.float64]
) -> list[tuple[Target, NDArray[np.intp], NDArray[np.float64]]]:
    blend = shape.blend
    assert blend is not None
    found = []
    for name, channel in zip(blend.shapes, blend.channels, strict=True):
        targets, knots = knots_of(definition, name)
        for place, target in enumerate(targets):
            here, there = matched(shape, target, blend.point_id)
            offsets = np.zeros((len(here), 6))
            for first, attribute, values in ((0, "P", target.points), (3, "N", target.normals)):
                if attribute in blend.attributes and values is not None:
                    offsets[:, first : first + 3] = difference(shape, target, attribute, here, there).T @ turn.T
            found.append((Target(channel, tuple(knots), place), here, offsets))
    return found


def weights_of(targets: Sequence[Target], rig: Rig, channels: Floats) -> Floats:
    """How much of each of K targets n agents have whose channels are float32[n, C]: float32[n, K]."""
    found = np.zeros((len(channels), len(targets)), np.float32)
    for k, target in enumerate(targets):
        found[:, k] = shares_of(channels[:, rig.channel(target.channel)], np.array(target.knots))[target.place]
    return found


def of_channels(definition: Definition) -> Definition:
    """The definition with its channels alone: one joint that does not move, and clips that have values of channels. Its poses
    have the channels that those of the definition have."""

    def valued(clip: Clip) -> Clip:
        empty = np.zeros((clip.samples, 0, 3), np.float32)
        return replace(
            clip, joints=(), translation=empty, rotation=np.zeros((clip.samples, 0, 4), np.float32), scale=empty, shear=None
        )

    channels = tuple(replace(each, transform="") for each in definition.rig.channels)
    rig = Rig(("still",), np.array([-1], np.int32), np.eye(4)[None], channels)
    groups = {name: replace(group, members=()) for name, group in definition.groups.items()}
    return replace(definition, rig=rig, clips={name: valued(clip) for name, clip in definition.clips.items()}, groups=groups)
