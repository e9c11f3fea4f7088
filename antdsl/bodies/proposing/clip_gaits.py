"""Measures how clips walk. Feet on the ground move backward below a body that stays in place, at the speed of the walk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.proposing.joint_motion import ClipMotion
from antdsl.bodies.proposing.leg_search import FoundLeg

Floats = NDArray[np.float64]
_LOW_SHARE = 0.2  # share of a foot's lift; a foot below this height may stand
_STANCE_SHARE = 0.3  # share of the speed; a low foot that moves backward at least this fast stands
_MIN_SPEED = 0.25  # leg lengths per second; a slower clip stays in place
_MIN_LIFT = 0.02  # share of the leg length
_MIN_AGREEMENT = 0.6  # share of low feet that move in the same direction
_SHORT_RUN = 0.06  # share of a cycle; shorter stances or swings are noise
_MAX_CYCLES = 16  # maximum number of cycles in a clip
_MIN_GATHERING = 0.45  # mean length of the unit vectors of a foot's phases while it stands; 0.64 for half a cycle on the ground
_PLANTED_SPEED = 0.35  # leg lengths per second; a slower low foot stands still


@dataclass(frozen=True, slots=True)
class ClipGait:
    """A walking clip, with L feet.

    `speed`: definition units per second. `backward_direction` float64[3]: the direction in which feet on the ground move.
    `cycles`: steps of each foot in the clip. `duty`, `lift`, `phases`: as in a gait."""

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
        """Return the distance of one cycle of the feet."""
        return self.speed * self.seconds / self.cycles


@dataclass(frozen=True, slots=True, eq=False)
class FootPaths:
    """The lowest point of each foot over a cycle: heights float64[F, L] above each foot's lowest position, horizontal velocities
    float64[F, L, 3] per second, and the lift [L] of each foot."""

    height: Floats
    velocity: Floats
    lift: Floats


def foot_paths(motion: ClipMotion, legs: Sequence[FoundLeg], up: Floats) -> FootPaths:
    """Return the paths of the soles of legs in a clip."""
    heights, velocities = [], []
    for leg in legs:
        joints = [joint for joint, _ in leg.soles]
        inner = np.array([point for _, point in leg.soles])
        worlds = motion.worlds[:, joints].astype(np.float64)
        place = (worlds[..., :3] @ inner[None, :, :, None])[..., 0] + worlds[..., 3]
        if motion.repeats_first_pose:
            velocity = (np.roll(place, -1, axis=0) - np.roll(place, 1, axis=0)) / (2 * motion.step)
        else:
            velocity = np.gradient(place, motion.step, axis=0) if len(place) > 1 else np.zeros_like(place)
        velocity -= (velocity @ up)[..., None] * up
        height = place @ up
        lowest = height.argmin(axis=1)
        rows = np.arange(len(height))
        heights.append(height[rows, lowest])
        velocities.append(velocity[rows, lowest])
    height = np.stack(heights, axis=1)
    height -= height.min(axis=0)
    return FootPaths(height, np.stack(velocities, axis=1), height.max(axis=0))


def planted_share(motion: ClipMotion, legs: Sequence[FoundLeg], up: Floats, length: float) -> float:
    """Return the share of a clip in which feet stand still on the ground. `length`: the length of a leg."""
    paths = foot_paths(motion, legs, up)
    still = (paths.height < 0.05 * length) & (np.linalg.norm(paths.velocity, axis=2) < _PLANTED_SPEED * length)
    return float(still.mean())


def find_gait(motion: ClipMotion, legs: Sequence[FoundLeg], up: Floats, length: float) -> ClipGait | None:
    """Return the gait of a clip, or None if the clip does not walk. `length`: the length of a leg."""
    if len(motion.worlds) < 4 or not legs or motion.step <= 0 or not motion.is_cyclic:
        return None
    paths = foot_paths(motion, legs, up)
    low = paths.height < _LOW_SHARE * paths.lift
    directions = paths.velocity[low]
    if not len(directions) or np.median(paths.lift) < _MIN_LIFT * length:
        return None
    direction = np.median(directions, axis=0)
    speed = float(np.linalg.norm(direction))
    if speed < _MIN_SPEED * length:
        return None
    back = direction / speed
    along = paths.velocity @ back
    if float((along[low] > _STANCE_SHARE * speed).mean()) < _MIN_AGREEMENT:
        return None
    speed = float(np.median(along[low & (along > _STANCE_SHARE * speed)]))
    stands = (paths.height < 1.5 * _LOW_SHARE * paths.lift) & (along > _STANCE_SHARE * speed)
    stands = np.stack([_without_short_runs(each) for each in stands.T], axis=1)
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
    """Return the number of cycles of the feet, bool[F, L], in a clip: the least number in which stances occur at one phase."""
    samples = np.arange(len(is_stance)) / len(is_stance)
    for cycles in range(1, _MAX_CYCLES + 1):
        turns = np.exp(2j * np.pi * cycles * samples)
        if np.mean([abs(turns[each].mean()) for each in is_stance.T]) > _MIN_GATHERING:
            return cycles
    return 1


def _without_short_runs(is_stance: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the stances of a foot over a cycle, without swings and stances of only a few samples."""
    shortest = max(1, round(_SHORT_RUN * len(is_stance)))
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
