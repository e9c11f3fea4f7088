"""Reads the animations of a glTF file as clips. LINEAR, STEP and CUBICSPLINE keys are sampled at equal time steps. Khronos Group,
glTF 2.0 Specification, 2021, section 3.11 and appendix C."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import BodyError, Clip, Rig
from antdsl.bodies.agents.transforms import align_signs, decompose_matrix, normalise_quaternion, slerp_quaternions
from antdsl.bodies.files.gltf.gltf_shapes import make_unused_name
from antdsl.scene.geometry.gltf_file import GltfDocument

if TYPE_CHECKING:
    from antdsl.bodies.files.document_model import AnimationSettings

Floats = NDArray[np.float64]
_EXPORT_HELP = "export the body again, as glTF 2.0"
EXTRAS_KEY = "antdsl"  # the key in `extras` of settings that glTF cannot express
_RATE_TOLERANCE = 1e-6  # relative tolerance of a rate, because key times are rounded to float32
_WIDTH_BY_PATH = {"translation": 3, "rotation": 4, "scale": 3}


def read_clips(
    file: GltfDocument, joint_names: Mapping[int, str], weights: Mapping[int, tuple[str, ...]], rig: Rig, rate: float
) -> list[Clip]:
    """Return the clips of a file. If a part of a joint's transform has no keys, it is that of the rest pose of `rig`.

    `joint_names`: joint names by node number.
    `weights`: by node number, the channels that weight the morph targets of the node's mesh.
    `rate`: approximate samples per second, from 0 s to the last key. A rate in the extras of an animation overrides it.
    """
    animations = file.get_top_list("animations")
    if len(animations) > limits.MAX_BODY_PARTS:
        raise BodyError(f"has {len(animations):,} animations, more than the limit of {limits.MAX_BODY_PARTS:,}", code="too-large")
    clips: dict[str, Clip] = {}
    left = limits.MAX_CLIP_BYTES
    for number, animation in enumerate(animations):
        name = make_unused_name(file.get_name(animation, f"clip{number}"), clips)
        clip, size = _read_clip(file, animation, name, joint_names, weights, rig, rate, left)
        left -= size
        if clip is not None:
            clips[name] = clip
    return list(clips.values())


def compute_even_times(seconds: float, rate: float) -> tuple[NDArray[Any], float]:
    """Return evenly spaced times from 0 to `seconds`, both included, and their number per second, which is close to `rate`."""
    steps = max(1, round(seconds * rate))
    if seconds <= 0:
        return np.zeros(1), rate
    return np.arange(steps + 1, dtype=np.float64) * (seconds / steps), steps / seconds


def _read_clip(
    file: GltfDocument, animation: dict[str, Any], name: str, joint_names: Mapping[int, str],
    weights: Mapping[int, tuple[str, ...]], rig: Rig, rate: float, remaining_bytes: int,
) -> tuple[Clip | None, int]:  # fmt: skip
    """Return an animation as a clip, and the number of bytes of its samples. The clip is None if the animation moves nothing.

    Raises BodyError if the samples need more than `remaining_bytes` bytes."""
    moved: dict[str, dict[str, _SamplerKeys]] = {}
    shares: dict[str, tuple[_SamplerKeys, int]] = {}
    samplers = file.get_objects(animation, "samplers")
    seconds = 0.0
    for channel in file.get_objects(animation, "channels"):
        target = file.get_object(channel, "target")
        node, path = target.get("node"), target.get("path")
        if node is None:
            continue
        node = file.check_index(node, "node", len(file.get_top_list("nodes")))
        sampler = samplers[file.check_index(channel.get("sampler"), "sampler", len(samplers))]
        if isinstance(path, str) and path in _WIDTH_BY_PATH and node in joint_names:
            moved.setdefault(joint_names[node], {})[path] = keys = _SamplerKeys(file, sampler, _WIDTH_BY_PATH[path])
        elif path == "weights" and node in weights:
            keys = _SamplerKeys(file, sampler, len(weights[node]))
            shares |= {each: (keys, column) for column, each in enumerate(weights[node])}
        else:
            continue
        seconds = max(seconds, float(keys.times[-1]))
    if not moved and not shares:
        return None, 0
    if seconds * rate > limits.MAX_CLIP_SAMPLES:
        raise BodyError(f"has a clip `{name}` of {seconds:,.0f} seconds, longer than the limit", code="too-large")
    extras = animation.get("extras")
    own = extras.get(EXTRAS_KEY) if isinstance(extras, dict) else None
    settings = None if own is None else read_settings(own, "extras", name)
    exact_rate = settings.rate if settings is not None and settings.rate is not None else 0.0
    times, rate = compute_even_times(seconds, exact_rate or rate)
    if exact_rate and abs(rate - exact_rate) <= _RATE_TOLERANCE * rate:  # key times in float32 are not exact to the last bit
        rate = exact_rate
        times = np.arange(len(times)) / rate
    size = len(times) * (len(moved) * 13 + len(shares)) * 8
    if size > remaining_bytes:
        raise BodyError(f"has clips of more than {limits.MAX_CLIP_BYTES:,} bytes after sampling", code="too-large")
    joints = tuple(each for each in rig.names if each in moved)
    rest = decompose_matrix(rig.rest_matrices[[rig.names.index(each) for each in joints]].reshape(-1, 4, 4))
    translation, rotation, scale, shear = (np.broadcast_to(part, (len(times), *part.shape)).copy() for part in rest)
    for number, each in enumerate(joints):
        for path, array in (("translation", translation), ("rotation", rotation), ("scale", scale)):
            if path in moved[each]:
                array[:, number] = moved[each][path].sample(times, path == "rotation")
    values = np.array([keys.sample(times)[:, column] for keys, column in shares.values()]).reshape(len(shares), len(times)).T
    if not all((np.abs(part) <= limits.MAX_NUMBER).all() for part in (translation, rotation, scale, shear, values)):
        raise BodyError(f"has a clip `{name}` with a value that is not finite", _EXPORT_HELP)
    clip = Clip(
        name, rate, joints,
        translation.astype(np.float32), align_signs(normalise_quaternion(rotation)).astype(np.float32), scale.astype(np.float32),
        shear.astype(np.float32) if (np.abs(shear) > 1e-6).any() else None,
        tuple(shares), np.ascontiguousarray(values, np.float32),
    )  # fmt: skip
    return (clip if settings is None else apply_settings(clip, settings)), size


def build_settings_extras(clip: Clip) -> dict[str, Any]:
    """Return the extras of an animation, which store the settings of a clip that glTF cannot express."""
    settings: dict[str, Any] = {"rate": clip.rate, "loop": clip.loop, "feet": clip.feet}
    if clip.stride:
        settings["stride"] = clip.stride
    if clip.marks:
        settings["marks"] = dict(clip.marks)
    return {EXTRAS_KEY: settings}


def apply_settings(clip: Clip, settings: AnimationSettings) -> Clip:
    """Return the clip with the given settings applied."""
    return replace(clip, loop=settings.loop, stride=settings.stride, marks=settings.marks, feet=settings.feet)


def read_settings(settings: Any, holder: str, name: str) -> AnimationSettings:
    """Return the settings of the clip `name`. Raises BodyError for wrong values.

    `settings`: the values in the file. `holder`: the key that contains them, `extras` in glTF or `customData` in USD."""
    from pydantic import ValidationError  # imported late, because most files have no such settings

    from antdsl.bodies.files.document_model import AnimationSettings

    try:
        return AnimationSettings.model_validate(settings)
    except ValidationError as problem:
        error = problem.errors(include_url=False, include_input=False)[0]
        path = "".join(f" at `{str(key)[:60]}`" for key in error["loc"])
        hint = f"the {holder} may have the keys rate, stride, loop, feet and marks; delete or correct the others"
        raise BodyError(f"has unknown {holder} `{EXTRAS_KEY}` in the clip `{name}`{path}", hint) from None


class _SamplerKeys:
    """The keys of an animation sampler.

    `times`: float64[n], seconds, ascending.
    `values`: float64[n, 1, width], the value at each key. For a spline float64[n, 3, width]: arriving tangent, value, leaving
    tangent.
    """

    def __init__(self, file: GltfDocument, sampler: dict[str, Any], width: int) -> None:
        self.kind = sampler.get("interpolation", "LINEAR")
        if self.kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
            raise BodyError(f"has an animation with the unknown interpolation `{str(self.kind)[:20]}`", _EXPORT_HELP)
        self.times = file.read_accessor(sampler.get("input"), 1)[:, 0].astype(np.float64)
        values = file.read_accessor(sampler.get("output")).astype(np.float64)
        count, each = len(self.times), 3 if self.kind == "CUBICSPLINE" else 1
        if not count or not np.isfinite(self.times).all() or (np.diff(self.times) < 0).any() or self.times[0] < 0:
            raise BodyError("has an animation with key times that do not increase from 0", _EXPORT_HELP)
        if values.size != count * each * width or not np.isfinite(values).all():
            raise BodyError(
                f"has an animation with {values.size:,} values for {count:,} keys of {width} numbers each, or with a value that "
                "is not finite",
                _EXPORT_HELP,
            )
        self.values = values.reshape(count, each, width)

    def sample(self, times: Floats, rotation: bool = False) -> Floats:
        """Return the values at `times` float64[F]. Before the first key or after the last key, the value is constant."""
        keys, own = self.times, self.values[:, len(self.values[0]) // 2]
        if len(keys) == 1:
            return np.broadcast_to(own[0], (len(times), own.shape[1]))
        if len(keys) == len(times) and (keys.astype(np.float32) == times.astype(np.float32)).all():
            return own
        previous_key = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, len(keys) - 2)
        step = keys[previous_key + 1] - keys[previous_key]
        share = np.clip((times - keys[previous_key]) / np.where(step > 0, step, 1.0), 0.0, 1.0)
        share = np.where(step > 0, share, 1.0)
        if self.kind == "STEP":
            return np.where(share[:, None] >= 1.0, own[previous_key + 1], own[previous_key])
        if self.kind == "CUBICSPLINE":
            return self._sample_spline(previous_key, share, step)
        if rotation:
            return slerp_quaternions(normalise_quaternion(own[previous_key]), normalise_quaternion(own[previous_key + 1]), share)
        return own[previous_key] + share[:, None] * (own[previous_key + 1] - own[previous_key])

    def _sample_spline(self, previous_key: NDArray[np.int64], share: Floats, step: Floats) -> Floats:
        """Return the values float64[F, width] of a Hermite spline. `previous_key`: the key before each time. `share`: the
        position between this key and the next one, 0 to 1. `step`: the time between the two keys."""
        t, d = share[:, None], step[:, None]
        t2, t3 = t * t, t * t * t
        start, leaving = self.values[previous_key, 1], self.values[previous_key, 2]
        arriving, end = self.values[previous_key + 1, 0], self.values[previous_key + 1, 1]
        first = (2 * t3 - 3 * t2 + 1) * start + d * (t3 - 2 * t2 + t) * leaving
        return np.asarray(first + (3 * t2 - 2 * t3) * end + d * (t3 - t2) * arriving)
