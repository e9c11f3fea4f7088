"""A clip as JSON text, in a form of our own with the documented channel names (`joint:tx … joint:shear3`), read and written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import Clip, Rig
from antdsl.bodies.agents.transforms import ORDERS, align_signs, angles_of_rotation, parts_of, rotation_of_angles
from antdsl.bodies.files.checked_values import Values
from antdsl.bodies.files.documents import json_text
from antdsl.bodies.files.json_text import Node

Floats = NDArray[np.float64]
PARTS = ("tx", "ty", "tz", "rx", "ry", "rz", "sx", "sy", "sz", "shear1", "shear2", "shear3")
_STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
_KNOWN = ("antdsl_clip", "name", "rate", "rotation_order", "angles", "loop", "stride", "marks", "feet", "channels")


def read_clip(values: Values, node: Node, rig: Rig | None = None) -> Clip | None:
    """Read a clip. Parts of a joint that the text leaves out are those of the rig's rest pose (without a rig: of the identity
    transform). Joints that the rig does not have are reported and left out."""
    needed = {"antdsl_clip": "1", "name": '"…"', "rate": "24", "channels": "{}"}
    entries = values.object(node, "a clip", _KNOWN, needed)
    if entries is None or any(key not in entries for key in needed):
        return None
    values.version(entries, "antdsl_clip", 1)
    name = values.text(entries["name"], "the name of a clip")
    rate = values.number(entries["rate"], "samples a second", 0.001, 100_000)
    channels = _channels(values, entries["channels"])
    stride = values.number(entries.get("stride"), "a stride", 0.0) or 0.0
    loop = values.boolean(entries.get("loop"), "whether the clip loops", True)
    feet = values.boolean(entries.get("feet"), "whether feet stand while it plays", True)
    if name is None or rate is None or not channels:
        return None
    samples = max(len(array) for _, array in channels.values())
    joints, numbers = _joints(values, entries["channels"], channels, rig)
    if not _is_within_limits(values, entries["channels"], samples, len(joints) + len(numbers)):
        return None
    marks = read_marks(values, entries.get("marks"), (samples - 1) / rate)
    turn = _read_rotation_order(values, entries, any(":r" in channel for channel in channels))
    if turn is None or not values.report.ok:
        return None
    parts = np.empty((samples, len(joints), 12))
    parts[:] = _rest_parts(joints, rig)
    rotation = np.empty((samples, len(joints), 4))
    for number, joint in enumerate(joints):
        for count, part in enumerate(PARTS):
            if f"{joint}:{part}" in channels:
                parts[:, number, count] = channels[f"{joint}:{part}"][1]
        if any(f"{joint}:{part}" in channels for part in PARTS[3:6]):
            rotation[:, number] = rotation_of_angles(parts[:, number, 3:6] * turn[1], turn[0])
        else:
            rotation[:, number] = rotation_of_angles(_rest_parts((joint,), rig)[:, 3:6], "xyz")
    sheared = bool((parts[..., 9:] != 0).any())
    weights = np.array([np.broadcast_to(channels[channel][1], samples) for channel in numbers]).reshape(len(numbers), samples).T
    return Clip(
        name, rate, joints,
        parts[..., 0:3].astype(np.float32), align_signs(rotation).astype(np.float32), parts[..., 6:9].astype(np.float32),
        parts[..., 9:12].astype(np.float32) if sheared else None,
        numbers, np.ascontiguousarray(weights, np.float32), loop, stride, marks, feet,
    )  # fmt: skip


def _channels(values: Values, node: Node) -> dict[str, tuple[Node, Floats]]:
    """Return the samples of each channel: the same number for all, or one for a constant channel."""
    if not isinstance(node.value, dict) or not node.value:
        values.report_wrong(node, "an object of channels, each with a list of its samples,", 'write `{"JOINT:tx": [0, 1]}`')
        return {}
    channels: dict[str, tuple[Node, Floats]] = {}
    longest, first = 1, ""
    for channel, each in node.value.items():
        if isinstance(each.value, int | float):
            number = values.number(each, "a sample")
            array = None if number is None else np.array([number])
        else:
            array = values.numbers(each, "samples")
        if array is None:
            continue
        if not len(array):
            values.report.error("wrong-value", f"`{channel[:60]}` has no samples", values.span(each), "leave the channel out")
            continue
        if len(array) > 1 and longest > 1 and len(array) != longest:
            words = f"`{channel[:60]}` has {len(array):,} samples, but `{first[:60]}` has {longest:,}"
            values.report.error("wrong-value", words, values.key_span(node, channel), "give all the same number, or a single one")
            continue
        if len(array) > longest:
            longest, first = len(array), channel
        channels[channel] = (each, array)
    return channels


def _joints(
    values: Values, node: Node, channels: Mapping[str, tuple[Node, Floats]], rig: Rig | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints that the channels move, and the channels that are numbers of the rig, in the order of the text."""
    joints: dict[str, None] = {}
    numbers: list[str] = []
    own = None if rig is None else {each.name for each in rig.channels}
    names = None if rig is None else set(rig.names)
    for channel in channels:
        joint, colon, part = channel.rpartition(":")
        if not colon or (own is not None and channel in own):
            numbers.append(channel)
            if own is not None and channel not in own:
                numbers.pop()
                values.report_unknown(values.key_span(node, channel), "channel", channel, own, warn=True)
        elif part not in PARTS:
            values.report_unknown(values.key_span(node, channel), "part of a transform", part, PARTS)
        elif names is not None and joint not in names:
            values.report_unknown(values.key_span(node, channel), "joint", joint, names, warn=True)
        else:
            joints[joint] = None
    return tuple(joints), tuple(numbers)


def _is_within_limits(values: Values, node: Node, samples: int, columns: int) -> bool:
    if samples > limits.CLIP_SAMPLES or samples * columns * 13 * 8 > limits.CLIP_BYTES:
        words = f"a clip of {samples:,} samples of {columns:,} joints and channels is larger than is read"
        values.report.error("too-large", words, values.start_span(node), "give fewer samples a second")
        return False
    return True


def read_marks(values: Values, node: Node | None, seconds: float) -> dict[str, float]:
    """Moments of a clip by name, in seconds from its first sample."""
    if node is None:
        return {}
    if not isinstance(node.value, dict):
        values.report_wrong(node, "an object of marks with their seconds", 'write `{"NAME": 0.5}`')
        return {}
    marks = {}
    for name, each in node.value.items():
        mark_time = values.number(each, f"the time of the mark `{name[:40]}`", 0.0, seconds)
        if mark_time is not None:
            marks[name] = mark_time
    return marks


def _read_rotation_order(values: Values, entries: Mapping[str, Node], has_rotations: bool) -> tuple[str, float] | None:
    """Return the rotation order of the axes, and the radians in one unit of the angles; the text must state both if there are
    angles."""
    order, angles = entries.get("rotation_order"), entries.get("angles")
    if has_rotations and (order is None or angles is None):
        missing = '"rotation_order": "xyz"' if order is None else '"angles": "degrees"'
        head = values.key_span(entries["channels"], next(c for c in entries["channels"].keys if ":r" in c))
        values.report.error("missing-key", "a clip with rotations must state their order and unit", head, f"add `{missing}`")
        return None
    for node, known in ((order, ORDERS), (angles, ("degrees", "radians"))):
        if node is not None and node.value not in known:
            text = "`, `".join(known)
            values.report.error("wrong-value", f"this must be one of `{text}`", values.span(node), f'write `"{known[0]}"`')
            return None
    radians = angles is not None and angles.value == "radians"
    return (str(order.value) if order is not None else "xyz"), (1.0 if radians else np.pi / 180)


def _rest_parts(joints: tuple[str, ...], rig: Rig | None) -> Floats:
    """The twelve parts of each joint's rest pose, angles in radians in the order x, y, z."""
    if rig is None:
        return np.tile(np.array(_STILL), (len(joints), 1))
    chosen = rig.rest[[rig.names.index(joint) for joint in joints]].reshape(-1, 4, 4)
    translation, rotation, scale, shear = parts_of(chosen)
    return np.concatenate([translation, angles_of_rotation(rotation), scale, shear], axis=-1)


def write_clip(clip: Clip) -> str:
    """Write a clip as text: rotations in degrees about x, then y, then z, unwrapped so that they have no jumps of 360 degrees."""
    channels: dict[str, Any] = {}
    angles = np.unwrap(angles_of_rotation(clip.rotation.astype(np.float64)), axis=0) * (180 / np.pi)
    columns = [clip.translation, angles, clip.scale, *(() if clip.shear is None else (clip.shear,))]
    for number, joint in enumerate(clip.joints):
        joint_samples = np.concatenate([np.asarray(each[:, number], np.float64) for each in columns], axis=-1)
        channels |= {
            f"{joint}:{part}": _samples(joint_samples[:, count]) for count, part in enumerate(PARTS[: joint_samples.shape[1]])
        }
    channels |= {channel: _samples(clip.values[:, number]) for number, channel in enumerate(clip.channels)}
    return json_text(
        {
            "antdsl_clip": 1, "name": clip.name, "rate": clip.rate, "rotation_order": "xyz", "angles": "degrees",
            "loop": clip.loop, "stride": clip.stride, "marks": dict(clip.marks), "feet": clip.feet,
            "channels": channels,
        }
    )  # fmt: skip


def _samples(column: NDArray[Any]) -> Any:
    """Return a single number for a constant channel. float32 values are written with only the digits that they have."""
    short = [float(f"{value:.9g}") for value in column.tolist()]
    return short[0] if len(set(short)) == 1 and len(short) > 1 else short
