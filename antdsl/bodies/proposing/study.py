"""Takes the measurements of a body that a proposal needs: its standing pose, its legs, and the gaits of its clips."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.proposing.clip_gaits import ClipGait, find_gait_of_clip, measure_planted_share
from antdsl.bodies.proposing.joint_motion import (
    BodyPoints,
    ClipMotion,
    find_posed_points,
    measure_clip_motion,
    sample_world_transforms,
)
from antdsl.bodies.proposing.leg_search import LegSearchResult, find_legs

Floats = NDArray[np.float64]
IDLE_WORDS = ("idle", "stand", "breath", "survey", "rest", "wait")
MIN_STILL_SHARE = 0.9  # share of a clip in which feet stand; with less, the clip moves the feet


@dataclass(frozen=True, slots=True, eq=False)
class BodyMeasurements:
    """The measurements of a body for a proposal, in the definition's units.

    `up`: the upward axis.
    `idle_clip`: the clip of the standing pose, or "".
    `worlds`, `points`: the world matrices of the joints, and the drawn points, in the standing pose.
    `motions`: the motions of all clips; `gaits`: the gaits of walking clips.
    `planted_shares`: for each clip, the fraction of its time in which feet are on the ground and do not move.
    `length`: the mean length of the legs."""

    body: Definition
    up: Floats
    idle_clip: str
    worlds: NDArray[np.float32]
    points: BodyPoints
    leg_search: LegSearchResult
    motions: Mapping[str, ClipMotion]
    gaits: Mapping[str, ClipGait]
    planted_shares: Mapping[str, float]
    length: float


def measure_body(body: Definition) -> BodyMeasurements:
    """Return the measurements of a body: its standing pose, its legs, and the gaits of its clips."""
    idle = _find_idle_clip(body)
    up, worlds, points, search = _find_standing_pose(body, idle, np.array(body.up, np.float64))
    length = _measure_leg_length(search, worlds)
    motions = {name: measure_clip_motion(body, name, search.body_height) for name in body.clips}
    feet = search.feet
    gaits = {n: gait for n, each in motions.items() if (gait := find_gait_of_clip(each, feet, up, length)) is not None}
    planted = {n: measure_planted_share(each, feet, up, length) if feet else 0.0 for n, each in motions.items()}
    if not idle and feet:
        calm = [name for name, share in planted.items() if share > MIN_STILL_SHARE and motions[name].seconds > 0.2]
        if calm:
            idle = min(calm, key=lambda name: _measure_joint_speed(motions[name]))
            up, worlds, points, search = _find_standing_pose(body, idle, up)
            length = _measure_leg_length(search, worlds)
    return BodyMeasurements(body, up, idle, worlds, points, search, motions, gaits, planted, length)


def _find_standing_pose(
    body: Definition, idle: str, up: Floats
) -> tuple[Floats, NDArray[np.float32], BodyPoints, LegSearchResult]:
    """Return the up axis, the world matrices of joints, the points and the legs in the standing pose.

    The up axis is `up`, unless fewer than two legs are found with `up` and two or more with another axis."""
    worlds = sample_world_transforms(body, idle, np.zeros(1))[0]
    points = find_posed_points(body, worlds)
    others = [sign * axis for axis in np.eye(3)[[1, 2, 0]] for sign in (1.0, -1.0)]
    best = find_legs(body.rig, points, worlds, up)
    for other in others if len(best.legs) < 2 else ():
        search = find_legs(body.rig, points, worlds, other)
        if len(search.legs) >= 2 and len(search.legs) > len(best.legs):
            up, best = other, search
    return up, worlds, points, best


def _find_idle_clip(body: Definition) -> str:
    """Return the first clip with a name that suggests standing, or ""."""
    for word in IDLE_WORDS:
        for name, clip in body.clips.items():
            if word in name.lower() and clip.duration > 0:
                return name
    return ""


def _measure_joint_speed(motion: ClipMotion) -> float:
    """Return the mean speed of joints in a clip, in the definition's units per second."""
    place = motion.worlds[:, :, :, 3].astype(np.float64)
    return (
        float(np.linalg.norm(np.diff(place, axis=0), axis=2).mean()) / max(motion.sample_interval, 1e-9)
        if len(place) > 1
        else 0.0
    )


def _measure_leg_length(search: LegSearchResult, worlds: NDArray[np.float32]) -> float:
    """Return the mean length of the legs, or half of the body's height if there are no legs."""
    place = worlds[:, :, 3].astype(np.float64)
    lengths = [
        _measure_distance(place, leg.upper, leg.lower) + _measure_distance(place, leg.lower, leg.foot) for leg in search.legs
    ]
    return float(np.mean(lengths)) if lengths else max(0.5 * search.body_height, 1e-9)


def _measure_distance(place: Floats, a: int, b: int) -> float:
    return float(np.linalg.norm(place[b] - place[a]))
