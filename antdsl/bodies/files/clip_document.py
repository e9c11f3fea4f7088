"""Builds a clip from a document in antdsl's own JSON form, and writes a clip in this form.

The channels of joints have the names of Houdini's documentation, `joint:tx … joint:shear3`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import Clip, Rig
from antdsl.bodies.agents.transforms import align_signs, angles_to_quaternion, decompose_matrix, quaternion_to_angles
from antdsl.bodies.files.document_model import ClipForm
from antdsl.bodies.files.documents import format_json
from antdsl.bodies.files.json_text import JsonNode, find_span, report_unknown_name
from antdsl.diagnostics import Report

Floats = NDArray[np.float64]
TRANSFORM_PARTS = ("tx", "ty", "tz", "rx", "ry", "rz", "sx", "sy", "sz", "shear1", "shear2", "shear3")
_IDENTITY_PARTS = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0)


def build_clip(form: ClipForm, root: JsonNode, report: Report, rig: Rig | None = None) -> Clip | None:
    """Return the clip of a document. If the document has mistakes, report them and return None.

    Parts of a joint's transform that the text omits are taken from the rig's rest pose, or without a rig from the identity.
    Joints that the rig lacks are reported and omitted."""
    findings = Report()
    samples = max(len(each) for each in form.channels.values())
    joints, numbers = _split_channels(form, root, findings, rig)
    columns = len(joints) + len(numbers)
    if samples > limits.MAX_CLIP_SAMPLES or samples * columns * 13 * 8 > limits.MAX_CLIP_BYTES:
        words = f"a clip of {samples:,} samples of {columns:,} joints and channels is too large"
        findings.error("too-large", words, find_span(root, ("channels",)), "use fewer samples per second")
    check_marks(form.marks, (samples - 1) / form.rate, root, findings)
    report.extend(findings)
    if not findings.ok:
        return None
    channels, unit = form.channels, 1.0 if form.angles == "radians" else np.pi / 180
    parts = np.empty((samples, len(joints), 12))
    parts[:] = _compute_rest_parts(joints, rig)
    rotation = np.empty((samples, len(joints), 4))
    for number, joint in enumerate(joints):
        for count, part in enumerate(TRANSFORM_PARTS):
            if f"{joint}:{part}" in channels:
                parts[:, number, count] = channels[f"{joint}:{part}"]
        if any(f"{joint}:{part}" in channels for part in TRANSFORM_PARTS[3:6]):
            rotation[:, number] = angles_to_quaternion(parts[:, number, 3:6] * unit, form.rotation_order or "xyz")
        else:
            rotation[:, number] = angles_to_quaternion(_compute_rest_parts((joint,), rig)[:, 3:6], "xyz")
    sheared = bool((parts[..., 9:] != 0).any())
    weights = np.array([np.broadcast_to(channels[channel], samples) for channel in numbers]).reshape(len(numbers), samples).T
    return Clip(
        form.name, form.rate, joints,
        parts[..., 0:3].astype(np.float32), align_signs(rotation).astype(np.float32), parts[..., 6:9].astype(np.float32),
        parts[..., 9:12].astype(np.float32) if sheared else None,
        numbers, np.ascontiguousarray(weights, np.float32), form.loop, form.stride, form.marks, form.feet,
    )  # fmt: skip


def _split_channels(form: ClipForm, root: JsonNode, report: Report, rig: Rig | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints that the clip moves, and the rig channels that it animates, in the order of the text. Report unknown
    names."""
    joints: dict[str, None] = {}
    numbers: list[str] = []
    rig_channels = None if rig is None else {each.name for each in rig.channels}
    names = None if rig is None else set(rig.names)
    for channel in form.channels:
        joint, colon, part = channel.rpartition(":")
        place = find_span(root, ("channels", channel), key=True)
        if not colon or (rig_channels is not None and channel in rig_channels):
            if rig_channels is None or channel in rig_channels:
                numbers.append(channel)
            else:
                report_unknown_name(report, place, "channel", channel, rig_channels, is_warning=True)
        elif part not in TRANSFORM_PARTS:
            report_unknown_name(report, place, "transform part", part, TRANSFORM_PARTS)
        elif names is not None and joint not in names:
            report_unknown_name(report, place, "joint", joint, names, is_warning=True)
        else:
            joints[joint] = None
    return tuple(joints), tuple(numbers)


def check_marks(marks: Mapping[str, float], seconds: float, root: JsonNode, report: Report) -> None:
    """Report marks that are after the end of a clip, which is `seconds` long."""
    for name, mark_time in marks.items():
        if mark_time > seconds:
            words, place = f"the mark `{name[:40]}` is after the end of the clip", find_span(root, ("marks", name))
            report.error("out-of-range", words, place, f"write `{seconds:g}`")


def _compute_rest_parts(joints: tuple[str, ...], rig: Rig | None) -> Floats:
    """Return the parts [J, 12] of each joint's transform in the rest pose, in the order of TRANSFORM_PARTS. Angles are in
    radians. Without a rig, the transforms are identities."""
    if rig is None:
        return np.tile(np.array(_IDENTITY_PARTS), (len(joints), 1))
    chosen = rig.rest_matrices[[rig.names.index(joint) for joint in joints]].reshape(-1, 4, 4)
    translation, rotation, scale, shear = decompose_matrix(chosen)
    return np.concatenate([translation, quaternion_to_angles(rotation), scale, shear], axis=-1)


def write_clip(clip: Clip) -> str:
    """Return a clip as JSON text, with the channels of `collect_clip_channels`."""
    channels = {name: _to_json_samples(column) for name, column in collect_clip_channels(clip).items()}
    return format_json(
        {
            "antdsl_clip": 1, "name": clip.name, "rate": clip.rate, "rotation_order": "xyz", "angles": "degrees",
            "loop": clip.loop, "stride": clip.stride, "marks": dict(clip.marks), "feet": clip.feet,
            "channels": channels,
        }
    )  # fmt: skip


def collect_clip_channels(clip: Clip) -> dict[str, NDArray[np.float64]]:
    """Return the samples (n,) of a clip's channels by name: `joint:tx` to `joint:shear3` of each joint, and rig channels.

    Rotations are in degrees about x, then y, then z, without jumps of 360 degrees."""
    channels: dict[str, NDArray[np.float64]] = {}
    angles = np.unwrap(quaternion_to_angles(clip.rotation.astype(np.float64)), axis=0) * (180 / np.pi)
    columns = [clip.translation, angles, clip.scale, *(() if clip.shear is None else (clip.shear,))]
    for number, joint in enumerate(clip.joints):
        joint_samples = np.concatenate([np.asarray(each[:, number], np.float64) for each in columns], axis=-1)
        channels |= {
            f"{joint}:{part}": joint_samples[:, count] for count, part in enumerate(TRANSFORM_PARTS[: joint_samples.shape[1]])
        }
    return channels | {channel: np.asarray(clip.values[:, number]) for number, channel in enumerate(clip.channels)}


def _to_json_samples(column: NDArray[np.float64]) -> Any:
    """Return the samples of a channel as a list of numbers, or as a single number if they are all equal."""
    short = shorten_samples(column)
    return short[0] if len(set(short)) == 1 and len(short) > 1 else short


def shorten_samples(column: NDArray[np.float64]) -> list[float]:
    """Return samples rounded to nine digits, which represent any float32 value exactly."""
    return [float(f"{value:.9g}") for value in column.tolist()]
