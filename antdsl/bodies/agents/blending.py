"""Blends the clips that agents play into poses, following a tree of layers.

An agent has a list of clips. Each clip has a time, a weight, a transform group, and the layer to which it is an input. Layers
have a mode, a weight and a parent layer. The inputs of a layer are its clips in list order, then its child layers in list order.
The root layer, with parent -1, gives the pose; its weight is unused.

- `INTERPOLATE_BLEND_MODE`: the weighted mean of the inputs at each joint. The weight of an input is multiplied by its transform
  group's weight for the joint. Where all weights are 0, the layer does not affect the joint: it does not count in its parent, and
  without other inputs the joint has its rest pose. The weight of a nested layer is multiplied by the mean of the group weights
  below it. So a layer with one input equals that input. Translations, scales, shears and channels are linear means. Rotations are
  a normalised sum of quaternions, each with its sign aligned to the sum of the previous ones.
- `ADDITIVE_BLEND_MODE`: the first input counts in full, whatever its weight. Each other input adds its difference from the rest
  pose, times its weight and its group's weight. Weights are not normalised. Differences are translation minus rest translation,
  rotation relative to the rest rotation, and channels minus their defaults. Scales and shears are those of the first input.
- `OVERRIDE_BLEND_MODE`: each input replaces the previous ones at each joint, by its weight times its group's weight, at most 1.
  The first input replaces the rest pose. This mode is antdsl's own; Houdini's documentation does not have it. It combines the
  state machines of an agent, such as waving arms over a walk. A layer that fades out reveals the layers below.

A joint that an additive clip lacks adds nothing. Any clip can be additive; no separate difference clip is needed. The added
rotation is applied in the parent's space, after the rotation of the first input. A part of a rotation is an nlerp from the
identity; weights above 1 extrapolate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats, multiply_quaternions, normalise_quaternions
from antdsl.bodies.agents.definition import TransformGroup
from antdsl.bodies.agents.poses import (
    REST_CLIP,
    ClipTable,
    LocalPose,
    WorldPoses,
    build_rest_pose,
    compute_transforms,
    sample_poses,
)
from antdsl.numerics import parallel
from antdsl.numerics.processor.float_environment import use_standard_floats

INTERPOLATE_BLEND_MODE, ADDITIVE_BLEND_MODE, OVERRIDE_BLEND_MODE = 0, 1, 2
NO_PARENT_LAYER = -1
_JOINTS_PER_CHUNK = 1 << 15  # the components of a chunk fit into the cache of a core
_FLOAT32_ONE = np.float32(1)
# limits of weights: float32 cannot resolve shares of larger weights, or of a smaller sum
_MAX_WEIGHT, _MIN_TOTAL_WEIGHT = np.float32(1e18), np.float32(1e-30)


@dataclass(frozen=True, slots=True)
class ClipBlendTree:
    """A tree of L layers with S clips, which several agents may share. Raises ValueError if the layers do not form one tree.

    `layers`: the layer of each clip (agentcliplayerids).
    `groups`: the transform group of each clip (agentcliptransformgroups); "" is the complete rig.
    `modes`: the mode of each layer (agentcliplayermodes).
    `parents`: the parent of each layer (agentcliplayerparents).
    """

    layers: tuple[int, ...]
    groups: tuple[str, ...]
    modes: tuple[int, ...] = (INTERPOLATE_BLEND_MODE,)
    parents: tuple[int, ...] = (NO_PARENT_LAYER,)

    def __post_init__(self) -> None:
        count = len(self.modes)
        if len(self.groups) != len(self.layers) or len(self.parents) != count:
            raise ValueError("each clip needs a layer and a transform group, and each layer needs a mode and a parent")
        if any(mode not in (INTERPOLATE_BLEND_MODE, ADDITIVE_BLEND_MODE, OVERRIDE_BLEND_MODE) for mode in self.modes):
            raise ValueError(
                f"the mode of a layer must be {INTERPOLATE_BLEND_MODE} (interpolate), {ADDITIVE_BLEND_MODE} (additive) or "
                f"{OVERRIDE_BLEND_MODE} (over)"
            )
        if any(not 0 <= layer < count for layer in self.layers):
            raise ValueError(f"a clip is an input of a layer that does not exist: layers are numbered from 0 to {count - 1}")
        if any(not NO_PARENT_LAYER <= parent < count for parent in self.parents):
            raise ValueError(
                f"the parent of a layer must be a number from 0 to {count - 1}, or {NO_PARENT_LAYER} for the topmost layer"
            )
        if self.parents.count(NO_PARENT_LAYER) != 1:
            raise ValueError(
                f"{self.parents.count(NO_PARENT_LAYER)} layers have the parent {NO_PARENT_LAYER}, but exactly one layer must "
                "have it: the topmost one"
            )
        for layer in range(count):
            above, depth = layer, 0
            while above != NO_PARENT_LAYER:
                above, depth = self.parents[above], depth + 1
                if depth > count:
                    raise ValueError(f"layer {layer} is above itself: the parents {self.parents} form a circle")

    @property
    def root(self) -> int:
        """Return the layer that outputs the pose."""
        return self.parents.index(NO_PARENT_LAYER)

    @staticmethod
    def build_flat(count: int, *groups: str) -> ClipBlendTree:
        """Return a tree in which one layer blends `count` clips by their weights. `groups`: the transform groups of the first
        clips; the other clips move the complete rig."""
        return ClipBlendTree((0,) * count, (*groups, *("",) * (count - len(groups))))


@dataclass(frozen=True, slots=True, eq=False)
class ClipPlayback:
    """The clips that each of n agents plays. S and L are the largest numbers of clips and layers in a tree. Entries beyond an
    agent's tree are ignored.

    `tree_indices`: int32[n], indices into `trees`.
    `clips`: int32[n, S], numbers of a `ClipTable`, -1 for none (agentclipnames).
    `times`: [n, S], seconds (agentcliptimes).
    `weights`: float32[n, S], the weights of the clips (agentclipweights).
    `layer_weights`: float32[n, L] (agentcliplayerweights).

    Weights below 0, and NaN, count as 0.
    """

    trees: tuple[ClipBlendTree, ...]
    tree_indices: NDArray[np.int32]
    clips: NDArray[np.int32]
    times: NDArray[np.float32] | NDArray[np.float64]
    weights: Floats
    layer_weights: Floats

    @staticmethod
    def make_with_shared_tree(tree: ClipBlendTree, clips: NDArray[np.int32], times: NDArray[np.float32] | NDArray[np.float64],
              weights: Floats, layer_weights: Floats | None = None) -> ClipPlayback:  # fmt: skip
        """Return the `ClipPlayback` of agents that all share one tree. Layer weights are 1 by default."""
        n = len(clips)
        layers = np.ones((n, len(tree.modes)), np.float32) if layer_weights is None else layer_weights
        return ClipPlayback((tree,), np.zeros(n, np.int32), clips, times, weights, layers)


def blend_poses(
    table: ClipTable, groups: Mapping[str, TransformGroup], playback: ClipPlayback, *, needs_local: bool = False, threads: int = 1
) -> WorldPoses:
    """Return the poses (transforms and channel values) of all agents, blended from the clips that they play.

    `needs_local`: also return local transforms. Results have the same bits for any number of `threads` and order of agents.
    Raises KeyError for a transform group that does not exist, or that names a joint or channel that the rig lacks. Raises
    IndexError for a clip or tree number out of range. Raises ValueError for arrays that do not match each other or the trees."""
    _check_shapes(playback)
    n, joints = len(playback.tree_indices), len(table.joint_order)
    if n and not 0 <= int(playback.tree_indices.min()) <= int(playback.tree_indices.max()) < len(playback.trees):
        raise IndexError(f"blend trees are numbered from 0 to {len(playback.trees) - 1}")
    named = {name for tree in playback.trees for name in tree.groups if name}
    members = {name: table.compute_group_weights(groups[name]) for name in sorted(named)}
    world = np.empty((3, 4, joints, n), np.float32)
    own = np.empty((3, 4, joints, n), np.float32) if needs_local else None
    channels = np.empty((len(table.rig.channels), n), np.float32)
    part = max(64, _JOINTS_PER_CHUNK // max(1, joints))

    for number, tree in enumerate(playback.trees):
        rows = None if len(playback.trees) == 1 else np.flatnonzero(playback.tree_indices == number)
        count = n if rows is None else len(rows)

        def blend_range(begin: int, end: int, tree: ClipBlendTree = tree, rows: NDArray[np.intp] | None = rows) -> None:
            for a in range(begin, end, part):
                b = min(a + part, end)
                agents = slice(a, b) if rows is None else rows[a:b]
                pose = blend_agents(table, members, tree, playback, agents)
                local_matrices, placed = compute_transforms(table, pose)
                _store_matrices(world, table, agents, placed)
                if own is not None:
                    _store_matrices(own, table, agents, local_matrices)
                channels[:, agents] = pose.channels

        if count:
            with use_standard_floats():
                parallel.run_in_parts(blend_range, count, threads)
    return WorldPoses(world.transpose(3, 2, 0, 1), None if own is None else own.transpose(3, 2, 0, 1), channels.T)


def _check_shapes(playback: ClipPlayback) -> None:
    """Check that the shapes of all arrays match the trees. Raises ValueError if they do not."""
    n = len(playback.tree_indices)
    slots = max((len(tree.layers) for tree in playback.trees), default=0)
    layers = max((len(tree.modes) for tree in playback.trees), default=0)
    for name, least in (("clips", slots), ("times", slots), ("weights", slots), ("layer_weights", layers)):
        shape = getattr(playback, name).shape
        if len(shape) != 2 or shape[0] != n or shape[1] < least:
            raise ValueError(f"`{name}` of {n} agents has the shape {shape}; it must be [{n}, {least} or more]")


def _store_matrices(target: Floats, table: ClipTable, agents: slice | NDArray[np.intp], matrices: Floats) -> None:
    """Write the matrices of `agents` into their rows of `target`, with joints in the order of the rig."""
    for r in range(3):
        for c in range(4):
            if isinstance(agents, slice):
                target[r, c, table.joint_order, agents] = matrices[r, c]
            else:
                target[r, c, table.joint_order[:, None], agents] = matrices[r, c]


@dataclass(slots=True, eq=False)
class _BlendInput:
    """An input of a layer: a clip, or the result of another layer.

    `pose`: the local poses of n agents.
    `weight`: [n], the weight of the input in the layer.
    `joint_coverage`, `channel_coverage`: how strongly the input sets each joint ([J, n]) or channel ([C, n]), from 0 to 1. [n] if
        it is equal for all joints or channels."""

    pose: LocalPose
    weight: Floats
    joint_coverage: Floats
    channel_coverage: Floats


def blend_agents(
    table: ClipTable, group_weights: Mapping[str, tuple[Floats, Floats]], tree: ClipBlendTree, playback: ClipPlayback,
    agents: slice | NDArray[np.intp],
) -> LocalPose:  # fmt: skip
    """Return the local poses of `agents`, which all share `tree`. `group_weights`: by group name, the weights of joints and of
    channels."""
    clips = _select_agent_columns(playback.clips, agents)
    times, weights = (
        _select_agent_columns(playback.times, agents),
        _limit_weights(_select_agent_columns(playback.weights, agents)),
    )
    layer_weights = _limit_weights(_select_agent_columns(playback.layer_weights, agents))
    n = clips.shape[1]
    rest = build_rest_pose(table, n)

    def of_clip(slot: int) -> _BlendInput:
        presence = (clips[slot] != REST_CLIP).astype(np.float32)
        joints, channels = presence, presence
        if tree.groups[slot]:
            joints, channels = (each[:, None] * presence for each in group_weights[tree.groups[slot]])
        return _BlendInput(sample_poses(table, clips[slot], times[slot]), weights[slot], joints, channels)

    def of_layer(layer: int) -> _BlendInput:
        inputs = [of_clip(slot) for slot, each in enumerate(tree.layers) if each == layer]
        inputs += [of_layer(below) for below, parent in enumerate(tree.parents) if parent == layer]
        if not inputs:
            nothing = np.zeros(n, np.float32)
            return _BlendInput(rest, layer_weights[layer], nothing, nothing)
        layer_input = _BLEND_BY_MODE[tree.modes[layer]](inputs, rest)
        layer_input.weight = layer_weights[layer]
        return layer_input

    return of_layer(tree.root).pose


def _select_agent_columns(values: NDArray, agents: slice | NDArray[np.intp]) -> NDArray:  # type: ignore[type-arg]  # of any numbers
    """Return the rows of the given agents, transposed so that each column is contiguous."""
    return np.ascontiguousarray(values[agents].T)


def _limit_weights(weights: Floats) -> Floats:
    """Return weights limited to the range from 0 to the largest value that can be summed; NaN becomes 0."""
    return np.minimum(np.where(weights > 0, weights, np.float32(0)).astype(np.float32, copy=False), _MAX_WEIGHT)


def _blend_mean(inputs: list[_BlendInput], rest: LocalPose) -> _BlendInput:
    """Return the weighted mean of the inputs; joints and channels that no input covers have the rest pose."""
    if len(inputs) == 1:
        return _use_single_input(inputs[0], rest)
    joint_shares, joints, no_joint = _compute_shares([(each.weight, each.joint_coverage) for each in inputs])
    channel_shares, channels, no_channel = _compute_shares([(each.weight, each.channel_coverage) for each in inputs])
    first = inputs[0].pose
    pose = LocalPose(
        first.translation * joint_shares[0], first.rotation * joint_shares[0],
        None if first.scale is None else first.scale * joint_shares[0],
        None if first.shear is None else first.shear * joint_shares[0],
        first.channels * channel_shares[0],
    )  # fmt: skip
    part = np.empty_like(pose.rotation)
    for each, share, channel_share in zip(inputs[1:], joint_shares[1:], channel_shares[1:], strict=True):
        for into, addend in (
            (pose.translation, each.pose.translation),
            (pose.scale, each.pose.scale),
            (pose.shear, each.pose.shear),
        ):
            if into is not None and addend is not None:
                np.multiply(addend, share, out=part[:3])
                into += part[:3]
        pose.channels += each.pose.channels * channel_share
        _add_rotations(pose.rotation, each.pose.rotation, share, part)
    normalise_quaternions(pose.rotation)
    _set_unweighted_to_rest(pose, rest, no_joint, no_channel)
    return _BlendInput(pose, inputs[0].weight, joints, channels)


def _use_single_input(input_layer: _BlendInput, rest: LocalPose) -> _BlendInput:
    """Return the weighted mean of a single input: the input itself where its weight is above 0, the rest pose elsewhere."""
    joints = input_layer.joint_coverage * (input_layer.weight > 0)
    channels = input_layer.channel_coverage * (input_layer.weight > 0)
    _set_unweighted_to_rest(input_layer.pose, rest, joints == 0, channels == 0)
    return _BlendInput(input_layer.pose, input_layer.weight, joints, channels)


def _compute_shares(weights: list[tuple[Floats, Floats]]) -> tuple[list[Floats], Floats, NDArray[np.bool_]]:
    """Return the share of each input, the mean coverage, and a mask of entries that no input covers. An entry is a joint or a
    channel.

    `weights`: the weight and the coverage of each input. For each entry, the shares are proportional to weight times coverage
    and add up to 1."""
    products = [weight * presence for weight, presence in weights]
    total, weight_sum = products[0], weights[0][0]
    for each, (weight, _) in zip(products[1:], weights[1:], strict=True):
        total, weight_sum = total + each, weight_sum + weight
    none = total < _MIN_TOTAL_WEIGHT
    by: Floats = np.where(none, _FLOAT32_ONE, total)
    np.divide(_FLOAT32_ONE, by, out=by)
    divisor: Floats = np.where(weight_sum == 0, _FLOAT32_ONE, weight_sum)
    presence: Floats = np.divide(total, divisor)
    return [each * by for each in products], presence, none


def _add_rotations(target: Floats, addend: Floats, share: Floats, scratch: Floats) -> None:
    """Add the quaternions `addend`, multiplied by `share`, to the sum `target` in place. First choose the sign of each
    quaternion that is closer to the sum.

    `scratch`: an array for intermediate results."""
    np.multiply(target, addend, out=scratch)
    dots = scratch[0]
    for k in (1, 2, 3):
        dots += scratch[k]
    side = np.where(dots < 0, -share, share)
    np.multiply(addend, side, out=scratch)
    target += scratch


def _set_unweighted_to_rest(pose: LocalPose, rest: LocalPose, no_joint: NDArray[np.bool_], no_channel: NDArray[np.bool_]) -> None:
    """Set joints to the rest pose and channels to their defaults, in place. `no_joint`, `no_channel`: masks of these joints and
    channels."""
    if no_joint.any():
        parts = (pose.translation, pose.rotation, pose.scale, pose.shear)
        for into, still in zip(parts, (rest.translation, rest.rotation, rest.scale, rest.shear), strict=True):
            if into is not None and still is not None:
                np.copyto(into, still, where=no_joint)
    if no_channel.any():
        np.copyto(pose.channels, rest.channels, where=no_channel)


def _blend_additive(inputs: list[_BlendInput], rest: LocalPose) -> _BlendInput:
    """Return the first input, plus the weighted differences of the other inputs from the rest pose."""
    first = inputs[0]
    pose, joints, channels = first.pose, first.joint_coverage, first.channel_coverage
    _set_unweighted_to_rest(pose, rest, joints == 0, channels == 0)
    back = rest.rotation * np.array([-1, -1, -1, 1], np.float32)[:, None, None]
    for each in inputs[1:]:
        share, channel_share = each.weight * each.joint_coverage, each.weight * each.channel_coverage
        pose.translation += (each.pose.translation - rest.translation) * share
        pose.channels += (each.pose.channels - rest.channels) * channel_share
        turn = multiply_quaternions(each.pose.rotation, back)
        turn *= np.where(turn[3] < 0, -share, share)
        turn[3] += _FLOAT32_ONE - share
        pose.rotation = normalise_quaternions(multiply_quaternions(normalise_quaternions(turn), pose.rotation))
        joints = np.maximum(joints, np.minimum(share, _FLOAT32_ONE))
        channels = np.maximum(channels, np.minimum(channel_share, _FLOAT32_ONE))
    return _BlendInput(pose, first.weight, joints, channels)


def _blend_override(inputs: list[_BlendInput], rest: LocalPose) -> _BlendInput:
    """Return the result of laying the inputs over the rest pose in turn. Each replaces the result so far in proportion to its
    weight."""
    parts = (rest.translation, rest.rotation, rest.scale, rest.shear, rest.channels)
    pose = LocalPose(*(None if each is None else each.copy() for each in parts))  # type: ignore[arg-type]
    joints, channels = np.float32(0), np.float32(0)
    for each in inputs:
        share = np.minimum(each.weight * each.joint_coverage, _FLOAT32_ONE)
        channel_share = np.minimum(each.weight * each.channel_coverage, _FLOAT32_ONE)
        for into, overlay in (
            (pose.translation, each.pose.translation),
            (pose.scale, each.pose.scale),
            (pose.shear, each.pose.shear),
        ):
            if into is not None and overlay is not None:
                into += (overlay - into) * share
        pose.channels += (each.pose.channels - pose.channels) * channel_share
        part = np.empty_like(pose.rotation)
        pose.rotation *= _FLOAT32_ONE - share
        _add_rotations(pose.rotation, each.pose.rotation, share, part)
        normalise_quaternions(pose.rotation)
        joints, channels = joints + share - joints * share, channels + channel_share - channels * channel_share
    return _BlendInput(pose, inputs[0].weight, joints, channels)  # type: ignore[arg-type]


_BLEND_BY_MODE = {INTERPOLATE_BLEND_MODE: _blend_mean, ADDITIVE_BLEND_MODE: _blend_additive, OVERRIDE_BLEND_MODE: _blend_override}
