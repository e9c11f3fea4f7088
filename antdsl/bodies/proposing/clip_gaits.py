"""Measures the gaits of clips. In a clip that walks in place, feet on the ground move backward at the speed of the walk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.proposing.joint_motion import ClipMotion
from antdsl.bodies.proposing.leg_search import LegCandidate

Floats = NDArray[np.float64]
_MAX_STANCE_HEIGHT_SHARE = 0.2  # share of a foot's lift; a foot below this height may stand
_MIN_STANCE_SPEED_SHARE = 0.3  # share of the speed; a low foot that moves backward at least this fast stands
_MIN_SPEED = 0.25  # leg lengths per second; a slower clip stays in place
_MIN_LIFT = 0.02  # share of the leg length
_MIN_DIRECTION_AGREEMENT = 0.6  # share of low feet that move in the same direction
_MIN_RUN_SHARE = 0.06  # share of a cycle; shorter stances or swings are noise
_MAX_CYCLES = 16  # maximum number of cycles in a clip
_MIN_PHASE_AGREEMENT = (
    0.45  # mean length of the unit vectors of a foot's phases while it stands; 0.64 for half a cycle on the ground
)
_MAX_PLANTED_SPEED = 0.35  # leg lengths per second; a slower low foot stands still


@dataclass(frozen=True, slots=True)
class ClipGait:
    """The gait of a walking clip, with L feet.

    `speed`: definition units per second.
    `backward_direction`: float64[3], the direction in which feet on the ground move.
    `cycles`: the number of gait cycles in the clip, in each of which a foot takes one step.
    `duty`, `lift`, `phases`: as in a `Gait`.
    `seconds`: the duration of the clip."""

    clip: str
    speed: float
    backward_direction: Floats
    cycles: int
    duty: float
    lift: float
    phases: tuple[float, ...]
    seconds: float

    @property
    def stride(self) -> float:
        """Return the distance covered in one gait cycle."""
        return self.speed * self.seconds / self.cycles


@dataclass(frozen=True, slots=True, eq=False)
class FootPaths:
    """The motion of each foot's lowest point over the cycle of a clip, for L feet and F samples."""

    height: Floats
    velocity: Floats
    lift: Floats


def measure_foot_paths(motion: ClipMotion, legs: Sequence[LegCandidate], up: Floats) -> FootPaths:
    """Return the paths of the soles of legs in a clip."""
    heights, velocities = [], []
    for leg in legs:
        joints = [joint for joint, _ in leg.soles]
        inner = np.array([point for _, point in leg.soles])
        worlds = motion.worlds[:, joints].astype(np.float64)
        place = (worlds[..., :3] @ inner[None, :, :, None])[..., 0] + worlds[..., 3]
        if motion.repeats_first_pose:
            velocity = (np.roll(place, -1, axis=0) - np.roll(place, 1, axis=0)) / (2 * motion.sample_interval)
        else:
            velocity = np.gradient(place, motion.sample_interval, axis=0) if len(place) > 1 else np.zeros_like(place)
        velocity -= (velocity @ up)[..., None] * up
        height = place @ up
        lowest = height.argmin(axis=1)
        rows = np.arange(len(height))
        heights.append(height[rows, lowest])
        velocities.append(velocity[rows, lowest])
    height = np.stack(heights, axis=1)
    height -= height.min(axis=0)
    return FootPaths(height, np.stack(velocities, axis=1), height.max(axis=0))


def measure_planted_share(motion: ClipMotion, legs: Sequence[LegCandidate], up: Floats, length: float) -> float:
    """Return the fraction of a clip's time, from 0 to 1, in which feet are on the ground and do not move. `length`: the length
    of a leg."""
    paths = measure_foot_paths(motion, legs, up)
    still = (paths.height < 0.05 * length) & (np.linalg.norm(paths.velocity, axis=2) < _MAX_PLANTED_SPEED * length)
    return float(still.mean())


def find_gait_of_clip(motion: ClipMotion, legs: Sequence[LegCandidate], up: Floats, length: float) -> ClipGait | None:
    """Return the gait of a clip, or None if it is not a walking clip. `length`: the length of a leg."""
    if len(motion.worlds) < 4 or not legs or motion.sample_interval <= 0 or not motion.is_cyclic:
        return None
    paths = measure_foot_paths(motion, legs, up)
    low = paths.height < _MAX_STANCE_HEIGHT_SHARE * paths.lift
    directions = paths.velocity[low]
    if not len(directions) or np.median(paths.lift) < _MIN_LIFT * length:
        return None
    direction = np.median(directions, axis=0)
    speed = float(np.linalg.norm(direction))
    if speed < _MIN_SPEED * length:
        return None
    back = direction / speed
    along = paths.velocity @ back
    if float((along[low] > _MIN_STANCE_SPEED_SHARE * speed).mean()) < _MIN_DIRECTION_AGREEMENT:
        return None
    speed = float(np.median(along[low & (along > _MIN_STANCE_SPEED_SHARE * speed)]))
    stands = (paths.height < 1.5 * _MAX_STANCE_HEIGHT_SHARE * paths.lift) & (along > _MIN_STANCE_SPEED_SHARE * speed)
    stands = np.stack([_remove_short_runs(each) for each in stands.T], axis=1)
    duties = stands.mean(axis=0)
    if not duties.all() or duties.min() >= 1:
        return None
    cycles = _count_cycles(stands)
    turns = np.exp(2j * np.pi * cycles * np.arange(len(stands)) / len(stands))
    centres = np.array([np.angle(turns[each].sum()) for each in stands.T]) / (2 * np.pi)
    phases = tuple(round(float(each), 2) % 1.0 for each in (centres[0] - centres) % 1.0)
    lift = float(np.median(paths.lift))
    return ClipGait(motion.name, speed, back, cycles, float(np.clip(duties.mean(), 0.05, 0.95)), lift, phases, motion.seconds)


def _count_cycles(is_stance: NDArray[np.bool_]) -> int:
    """Return the number of gait cycles in a clip. It is the smallest number for which every foot is on the ground in a single
    period of the cycle.

    `is_stance`: bool[F, L], whether each foot is on the ground."""
    samples = np.arange(len(is_stance)) / len(is_stance)
    for cycles in range(1, _MAX_CYCLES + 1):
        turns = np.exp(2j * np.pi * cycles * samples)
        if np.mean([abs(turns[each].mean()) for each in is_stance.T]) > _MIN_PHASE_AGREEMENT:
            return cycles
    return 1


def _remove_short_runs(is_stance: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return, for one foot, whether it is on the ground in each sample, bool[F]. Swings and stances of only a few samples have
    been removed."""
    shortest = max(1, round(_MIN_RUN_SHARE * len(is_stance)))
    for value in (False, True):
        starts = np.flatnonzero((is_stance == value) & (np.roll(is_stance, 1) != value))
        for start in starts.tolist():
            run = 1
            while run < len(is_stance) and is_stance[(start + run) % len(is_stance)] == value:
                run += 1
            if run < shortest:
                is_stance = is_stance.copy()
                is_stance[(start + np.arange(run)) % len(is_stance)] = not value
    return is_stance
