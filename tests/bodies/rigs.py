"""Rigs, clips and definitions that tests of poses are made with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Channel, Clip, Definition, Rig

Floats = NDArray[np.float64]


def turn(axis: str, degrees: float) -> list[float]:
    """The quaternion of a turn about an axis."""
    half = np.radians(degrees) / 2
    return [np.sin(half) * (axis == each) for each in "xyz"] + [np.cos(half)]


def matrix(translation: Sequence[float] = (0, 0, 0), rotation: Sequence[float] = (0, 0, 0, 1), scale: Sequence[float] = (1, 1, 1),
           shear: Sequence[float] = (0, 0, 0)) -> Floats:  # fmt: skip
    """Translation · rotation · shear · scale, multiplied out by matrices."""
    x, y, z, w = np.asarray(rotation, np.float64) / np.linalg.norm(rotation)
    r = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    h = np.array([[1, shear[0], shear[1]], [0, 1, shear[2]], [0, 0, 1]])
    result = np.eye(4)
    result[:3, :3] = r @ h @ np.diag(scale)
    result[:3, 3] = translation
    return result


def still(name: str, joints: dict[str, dict[str, Sequence[float]]], channels: dict[str, float] | None = None) -> Clip:
    """A clip of one sample: what its joints say (`t`, `r`, `s`, `h`), and its channels."""

    def part(key: str, default: Sequence[float]) -> NDArray[np.float32]:
        return np.array([[each.get(key, default) for each in joints.values()]], np.float32).reshape(1, len(joints), len(default))

    values = channels or {}
    shear = part("h", (0, 0, 0)) if any("h" in each for each in joints.values()) else None
    numbers = np.array([list(values.values())], np.float32)
    parts = (part("t", (0, 0, 0)), part("r", (0, 0, 0, 1)), part("s", (1, 1, 1)), shear)
    return Clip(name, 24.0, tuple(joints), *parts, tuple(values), numbers)


def definition(
    parents: dict[str, str], *clips: Clip, rest: dict[str, Floats] | None = None, channels: Sequence[Channel] = ()
) -> Definition:
    """A definition of joints with their parents ("" for a root) and clips."""
    names = tuple(parents)
    up = np.array([names.index(each) if each else -1 for each in parents.values()], np.int32)
    matrices = np.stack([(rest or {}).get(name, np.eye(4)) for name in names])
    return Definition("test", Rig(names, up, matrices, tuple(channels)), clips={clip.name: clip for clip in clips})


def wild(joints: int, seed: int, samples: Sequence[int] = (5, 9), scales: bool = True, sheared: bool = False) -> Definition:
    """A random rig with joints in no order of depth beyond parents first, with several roots and random clips."""
    random = np.random.default_rng(seed)
    names = tuple(f"j{k}" for k in range(joints))
    parents = np.array([-1 if k < 2 else random.integers(0, k) for k in range(joints)], np.int32)
    rest = np.stack([matrix(random.normal(size=3), random.normal(size=4), random.uniform(0.5, 2, 3)) for _ in names])
    clips = {}
    for number, count in enumerate(samples):
        rotation = random.normal((0, 0, 0, 2), size=(count, joints, 4))
        rotation /= np.linalg.norm(rotation, axis=2, keepdims=True)
        scale = random.uniform(0.5, 2, (count, joints, 3)) if scales else np.ones((count, joints, 3))
        shear = random.normal(size=(count, joints, 3)) * 0.3 if sheared else None
        scale[:, ::4, 0] *= -1 if sheared else 1  # these mirror
        clips[f"c{number}"] = Clip(
            f"c{number}", 24.0, names, random.normal(size=(count, joints, 3)).astype(np.float32), rotation.astype(np.float32),
            scale.astype(np.float32), None if shear is None else shear.astype(np.float32), ("jaw",),
            random.uniform(size=(count, 1)).astype(np.float32), loop=number % 2 == 0,
        )  # fmt: skip
    if not scales:
        rest[:, :3, :3] = np.stack([np.linalg.qr(each)[0] for each in rest[:, :3, :3]])
        rest[:, :3, 0] *= np.linalg.det(rest[:, :3, :3])[:, None]
    return Definition("wild", Rig(names, parents, rest, (Channel("jaw", 0.25),)), clips=clips)
