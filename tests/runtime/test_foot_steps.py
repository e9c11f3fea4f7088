"""Kernels of a step of feet, against the same step of all agents in NumPy's float64, by matrices and least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from foot_frames import BodyFrames, Points, lean

from antdsl.runtime.feet import stepping, trunk
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER, SWING_PHASE_OF_STANDING_FOOT
from antdsl.runtime.feet.gaits import (
    FOOT_Y_ROW,
    LEG_LENGTH_ROW,
    LEG_REACH_ROW,
    MAX_SINK_SHARE,
    REST_OFFSET_ROW,
    REST_X_ROW,
    REST_Z_ROW,
    Gaits,
)
from antdsl.scene.setting import GaitData, LegsData

COUNT, LEGS, DT = 700, 6, np.float32(1 / 24)
F32 = np.float32
HIPS = [[0.12, 0.13, 0.05], [0.02, 0.14, 0.05], [-0.08, 0.12, 0.05]]
FEET = [[0.40, 0.02, 0.28], [0.04, 0.03, 0.40], [-0.38, 0.01, 0.32]]


def body_legs() -> LegsData:
    """Six legs of several lengths, with three gaits."""
    sides = np.array([1.0, 1.0, -1.0])
    hip, foot = (np.concatenate([np.array(each) * sides, np.array(each)]) for each in (HIPS, FEET))
    length = np.linalg.norm(foot - hip, axis=1) * np.array([1.12, 1.2, 1.15, 1.1, 1.25, 1.18])
    phases = (0.0, 0.5, 0.05, 0.5, 0.0, 0.55), (0.0, 0.5, 0.0, 0.5, 0.0, 0.5), (0.1, 0.5, 0.0, 0.6, 0.0, 0.4)
    rates = (1.0, 0.40, 0.65, 0.08), (3.0, 0.60, 0.58, 0.10), (5.0, 0.70, 0.52, 0.07)
    return LegsData(foot, hip, length, tuple(GaitData(*rate, each) for rate, each in zip(rates, phases, strict=True)))


class Crowd:
    """Bodies with feet in random states. Arrays of legs are [..., L, n], as kernels read them."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.legs, n = body_legs(), COUNT
        self.gaits = Gaits(self.legs)
        axes = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        self.frames = BodyFrames(rng.normal(0, 40, (n, 3)), axes, rng.uniform(2, 9, n).astype(F32).astype(float))
        rows = self.frames.place.T, axes.transpose(1, 2, 0).reshape(9, n), self.frames.size[None], np.ones((1, n))
        self.bodies = np.ascontiguousarray(np.concatenate(rows))
        pace = np.where(rng.random(n) < 0.4, rng.uniform(0, 0.012, n), rng.uniform(0, 0.3, n))
        turn = rng.uniform(0, 2 * np.pi, n) + rng.normal(0, 0.2, (LEGS, n))
        self.covered = (np.stack([np.cos(turn), np.sin(turn)]) * pace * rng.uniform(0.8, 1.2, (LEGS, n))).astype(F32)
        spread = rng.choice([0.01, 0.03, 0.2], n, p=[0.3, 0.2, 0.5])
        ground = rng.normal(0, 1, (3, LEGS, n)) * [[[1.0]], [[0.4]], [[1.0]]] * spread
        ground += np.stack([self.gaits.legs[REST_X_ROW], np.zeros(LEGS), self.gaits.legs[REST_Z_ROW]])[:, :, None]
        self.place = self.world(ground)
        self.start = self.world(ground + rng.normal(0, 0.2, ground.shape))
        self.shown = np.zeros_like(self.place)
        stands = (rng.random((LEGS, n)) < 0.75) | (rng.random(n) < 0.3)
        self.swing = np.where(stands, SWING_PHASE_OF_STANDING_FOOT, rng.uniform(0, 1, (LEGS, n))).astype(F32)
        self.on = rng.choice([NO_GROUND_NUMBER, -1, 0, 3], (LEGS, n), p=[0.2, 0.3, 0.3, 0.2]).astype(np.int16)
        self.found = np.where(rng.random((LEGS, n)) < 0.7, 0, rng.uniform(0, 0.1, (LEGS, n))).astype(F32)
        self.phase = rng.uniform(0, 1, n).astype(F32)
        self.rise = (rng.normal(0, 0.02, n) * self.frames.size).astype(F32)
        self.slope = rng.normal(0, 0.15, (2, n)).astype(F32)
        self.undermined = rng.random((LEGS, n)) < 0.02
        self.targets = (*np.zeros((5, LEGS, n), F32), np.zeros((3, LEGS, n), F32), np.zeros((LEGS, n), np.uint8))
        self.pace = (*np.zeros((2, n), F32), np.zeros(n, np.bool_))

    @property
    def columns(self) -> Any:
        return ((self.place, self.start, self.shown), (self.swing, self.on, self.found), (self.phase, self.rise, self.slope))

    def world(self, local: Points) -> Points:
        """World positions [3, L, n] (mm) of points [3, L, n] in body lengths."""
        away = np.einsum("kln,nka->aln", local, self.frames.axes) * self.frames.size
        return np.ascontiguousarray(self.frames.place.T[:, None] + away)

    def local(self, points: Points) -> Points:
        """Positions [3, L, n] in body lengths of world positions [3, L, n] (mm)."""
        return self.frames.to_bodies(points.swapaxes(1, 2)).swapaxes(1, 2)

    def hips(self, slope: Points, raised: Points) -> Points:
        """Hips [3, L, n] of trunks that lean by `slope` and are raised by body lengths [n]."""
        hips = lean(self.legs.hip, slope).swapaxes(1, 2)
        return hips + np.stack([np.zeros(COUNT), raised, np.zeros(COUNT)])[:, None]

    def rest(self) -> Points:
        """Rest positions [2, L, 1] of feet, ahead and aside."""
        return self.gaits.legs[[REST_X_ROW, REST_Z_ROW], :, None].astype(float)

    def leg(self, row: int) -> Points:
        return self.gaits.legs[row, :, None].astype(float)

    def rest_distance(self, local: Points, hips: Points) -> Points:
        """The distance [L, n] to the rest position: along the ground, or from where the line of the leg crosses height 0."""
        drop = np.maximum(hips[1] - local[1], 0.1 * self.leg(LEG_LENGTH_ROW))
        crossing = hips[[0, 2]] + (local - hips)[[0, 2]] * (hips[1] / drop)
        straight, along = (np.linalg.norm(each - self.rest(), axis=0) for each in (crossing, local[[0, 2]]))
        return np.minimum(straight, along)

    def too_far(self, local: Points, hips: Points, most: float) -> Points:
        """Which feet [L, n] are farther from their hips than a share of the leg, with the trunk lowered."""
        joint = local - hips + np.stack([np.zeros((LEGS, 1)), self.leg(FOOT_Y_ROW), np.zeros((LEGS, 1))])
        sunk = np.where(joint[1] < 0, np.minimum(joint[1] + MAX_SINK_SHARE * self.leg(LEG_LENGTH_ROW), 0), joint[1])
        return np.linalg.norm([joint[0], sunk, joint[2]], axis=0) > most * self.leg(LEG_LENGTH_ROW)

    def gait(self, speed: Points, distance: Points) -> tuple[Points, ...]:
        """Number, stride, duty factor and lift [n] of the gaits at speeds [n]."""
        speeds, values, _ = (each.astype(float) for each in self.gaits.kernel_tables)
        number = np.maximum(np.searchsorted(speeds, speed, side="right") - 1, 0)
        stride, duty, lift = (np.interp(speed, speeds, column) for column in values.T)
        stride = np.maximum(stride * np.maximum(speed / speeds[-1], 1), 3 * distance)
        return number, stride, np.minimum(duty, 2 * float(self.gaits.least_reach) / stride), lift


def close(actual: Any, expected: Any, size: float = 3e-5) -> None:
    np.testing.assert_allclose(actual, expected, rtol=size, atol=size)


def test_the_ground_that_feet_cover_is_that_of_matrices() -> None:
    rng, crowd = np.random.default_rng(2), Crowd(2)
    covered, new = np.full((2, LEGS, COUNT), 9, F32), rng.random(COUNT) < 0.1
    last_frames = BodyFrames(
        crowd.frames.place + rng.normal(0, 2, (COUNT, 3)), np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0], crowd.frames.size
    )
    last_frames.axes[:, 2] = np.cross(last_frames.axes[:, 0], last_frames.axes[:, 1])
    last_frames.place[5] = np.nan
    heading, up = last_frames.axes[:, 0] * 3, last_frames.axes[:, 1] + 0.4 * last_frames.axes[:, 0]
    last = np.ascontiguousarray(last_frames.place.T), *(np.ascontiguousarray(each.T, F32) for each in (heading, up))
    stepping.measure_ground_covered(crowd.bodies, last, crowd.gaits.legs, new, covered, 0, 300)
    assert (covered[:, :, 300:] == 9).all()
    stepping.measure_ground_covered(crowd.bodies, last, crowd.gaits.legs, new, covered, 300, COUNT)
    rest = np.stack([crowd.rest()[0, :, 0], np.zeros(LEGS), crowd.rest()[1, :, 0]], axis=1)
    moved = rest.T[:, :, None] - crowd.local(last_frames.to_world(rest).swapaxes(1, 2))
    still = new | (np.arange(COUNT) == 5)
    close(covered, np.where(still, 0, moved[[0, 2]]))


def test_feet_lift_and_land_by_their_gaits() -> None:
    crowd = Crowd(3)
    n, gaits = COUNT, crowd.gaits
    previous = {name: getattr(crowd, name).copy() for name in ("start", "phase", "swing", "found")}
    times = DT, DT / F32(gaits.rest_cycle_seconds), DT / F32(gaits.max_swing_seconds), gaits.least_reach
    requests = np.full(n * LEGS, -1, np.int64)
    listed = []
    for part in ((0, 37), (37, n)):
        first, many = stepping.plan_steps(
            crowd.bodies, crowd.covered, gaits.legs, gaits.kernel_tables, times, crowd.undermined, crowd.columns, crowd.pace,
            crowd.targets, requests, *part,
        )  # fmt: skip
        assert first == LEGS * part[0]
        listed += requests[first : first + many].tolist()

    covered = crowd.covered.astype(float)
    distance = np.linalg.norm(covered, axis=0).mean(axis=0)
    number, stride, duty, lift = crowd.gait(distance / float(DT), distance)
    still, ahead = distance / stride < 0.02, distance / stride
    local, hips = crowd.local(crowd.place), crowd.hips(crowd.slope, crowd.rise / crowd.frames.size)
    off, down, rest_offset = crowd.rest_distance(local, hips), crowd.swing < 0, crowd.found.astype(float)
    restless = (~down | (off > crowd.leg(REST_OFFSET_ROW) + rest_offset)).any(axis=0)
    stands = (down & (off <= crowd.leg(REST_OFFSET_ROW))).all(axis=0)
    ahead = np.minimum(np.where(still & restless, np.maximum(ahead, float(times[1])), ahead), 1 / 3)
    leg_phase = (previous["phase"].astype(float) + gaits.phases[number].T) % 1
    gap = (-((leg_phase - duty) % -1)).min(axis=0)
    advance = np.where(stands & ~still & (gap > ahead), gap + 1e-3, ahead)
    rate = np.clip(ahead / (1 - duty), float(times[2]), 1)
    stance = np.maximum(1 / np.maximum(ahead, 1e-6) - 1 / rate, 0)
    to_turn = (duty - leg_phase) % 1
    crosses = (to_turn > 0) & (advance >= to_turn) | (to_turn == 0) & (advance >= 1)
    behind = (local[[0, 2]] - crowd.rest()) * covered
    in_time = (leg_phase >= duty) & (leg_phase < duty + 0.6 * (1 - duty))
    late = in_time & (behind.sum(axis=0) < 0) & (off > 0.3 * crowd.leg(LEG_REACH_ROW))
    due = (crosses | late) & (~still | (off > 0.5 * crowd.leg(REST_OFFSET_ROW) + rest_offset))
    lost = (off > 1.25 * crowd.leg(LEG_REACH_ROW)) | crowd.undermined | crowd.too_far(local, hips, 0.99)
    lifts = down & (due | lost)
    flies = lifts | ~down
    first_share = np.where(lifts & crosses, (advance - to_turn) / (1 - duty), rate)
    reached = np.where(lifts, 0, previous["swing"].astype(float)) + first_share
    progress = np.where(flies, np.minimum(reached, 1), float(SWING_PHASE_OF_STANDING_FOOT))
    frames = np.where(flies, (1 - progress) / rate, 0)
    lands = flies & (reached >= 1)
    half = covered * np.minimum(stance, 1e4) / 2
    half *= np.minimum(1, crowd.leg(LEG_REACH_ROW) / np.maximum(np.linalg.norm(half, axis=0), 1e-9))
    past = np.where(lands, (reached - 1) / rate, 0)
    goal = crowd.rest() + covered * (frames - past) + half
    miss = np.linalg.norm(local[[0, 2]] - goal, axis=0)
    again = (miss > np.where(still, crowd.leg(REST_OFFSET_ROW), 0.45 * crowd.leg(LEG_LENGTH_ROW))) | (
        crowd.on == NO_GROUND_NUMBER
    )
    again |= crowd.too_far(local, hips, 0.97)
    does = np.select(
        [lands & again, lands, lifts],
        [stepping.SEARCHING_FOOT, stepping.LANDING_FOOT, stepping.LIFTING_FOOT],
        stepping.STAYING_FOOT,
    )

    assert np.array_equal(crowd.targets[6], does)
    counts = np.bincount(does.ravel(), minlength=4)
    assert (counts > 50).all() and 100 < still.sum() < 600 and late.sum() > 50 and (stands & ~still & (gap > ahead)).sum() > 20
    assert listed == [i << stepping.REQUEST_LEG_BITS | leg for i in range(n) for leg in range(LEGS) if does[leg, i] in (1, 3)]
    close(crowd.pace[0], stride), close(crowd.pace[1], lift)
    assert np.array_equal(crowd.pace[2], still)
    close(crowd.targets[5], local), close(crowd.targets[4], off, 1e-4)
    assert np.array_equal(crowd.start, np.where(lifts, crowd.place, previous["start"]))
    close(crowd.targets[3], progress, 3e-4), close(crowd.targets[2], frames, 1e-2)
    close(np.stack(crowd.targets[:2]), goal, 1e-3)
    moved_phase = (crowd.phase - (previous["phase"] + advance) + 0.5) % 1 - 0.5
    close(moved_phase, 0)
    assert np.array_equal(crowd.swing, previous["swing"]) and np.array_equal(crowd.found, previous["found"])


def plane_of(points: Points, held: Any) -> tuple[float, float, float]:
    """Height and slopes of the plane nearest to the points [3, k] that are `held`, level if they are close together."""
    x, y, z = points[:, held]
    if not held.any():
        return 0.0, 0.0, 0.0
    if held.sum() < 3:
        return float(y.mean()), 0.0, 0.0
    stiff = np.sqrt(held.sum() * 0.02)
    rows = np.concatenate([np.stack([x - x.mean(), z - z.mean()], axis=1), stiff * np.eye(2)])
    slope = np.linalg.lstsq(rows, np.concatenate([y - y.mean(), [0, 0]]), rcond=None)[0]
    slope *= min(1.0, float(trunk.MAX_TRUNK_SLOPE) / max(float(np.linalg.norm(slope)), 1e-6))
    return float(y.mean() - slope @ [x.mean(), z.mean()]), *slope.tolist()


def test_feet_swing_and_trunks_follow_the_ground_below_them() -> None:
    rng, crowd = np.random.default_rng(5), Crowd(4)
    n, gaits, size = COUNT, crowd.gaits, crowd.frames.size
    crowd.on[:, ::9] = NO_GROUND_NUMBER
    crowd.on[2:, 1::9] = NO_GROUND_NUMBER
    share, what = crowd.targets[3], crowd.targets[6]
    share[:] = crowd.swing
    what[:] = np.where(crowd.swing < 0, stepping.STAYING_FOOT, rng.choice([0, 1, 2, 3], (LEGS, n)))
    share[what >= stepping.LANDING_FOOT] = 1
    crowd.pace[0][:], crowd.pace[1][:] = rng.uniform(0.3, 0.8, n), rng.uniform(0.03, 0.1, n)
    crowd.pace[2][:] = rng.random(n) < 0.5
    previous = {name: getattr(crowd, name).copy() for name in ("rise", "slope", "found", "start", "place")}
    last = np.zeros((3, n)), np.zeros((3, n), F32), np.zeros((3, n), F32)
    slower, faster, highest = F32(0.4), F32(0.17), F32(0.045)
    for part in ((0, 21), (21, n)):
        steps = crowd.bodies, gaits.legs, (slower, faster, highest), crowd.columns, crowd.pace, crowd.targets, last
        stepping.take_steps(*steps, *part)

    local = crowd.local(crowd.place)
    lands = what >= stepping.LANDING_FOOT
    stands = np.where(lands, crowd.on != NO_GROUND_NUMBER, share < 0)
    assert np.array_equal(crowd.swing, np.where(lands & (crowd.on != NO_GROUND_NUMBER), SWING_PHASE_OF_STANDING_FOOT, share))
    slope, raised = previous["slope"].astype(float), previous["rise"] / size
    rest_offset = np.where(lands, crowd.rest_distance(local, crowd.hips(slope, raised)), previous["found"])
    close(crowd.found, np.where(crowd.pace[2], rest_offset, 0), 1e-4)
    planes = np.array([plane_of(local[:, :, i], crowd.on[:, i] != NO_GROUND_NUMBER) for i in range(n)]).T
    height = np.clip(planes[0], -highest, highest)
    tilt = slope + (planes[1:] - slope) * float(slower)
    wished = raised + (height - raised) * np.where(height > raised, float(faster), float(slower))
    hips = crowd.hips(tilt, np.zeros(n))
    square = (0.97 * crowd.leg(LEG_LENGTH_ROW)) ** 2 - ((local - hips)[[0, 2]] ** 2).sum(axis=0)
    over = local[1] + crowd.leg(FOOT_Y_ROW) + np.sqrt(np.maximum(square, 0)) - hips[1]
    limit = np.where(stands & (square > 0), over, np.inf).min(axis=0)
    high = np.maximum(np.minimum(wished, limit), np.minimum(wished, -float(highest)))
    torn = (stands & crowd.too_far(local, crowd.hips(tilt, high), 0.99)).any(axis=0)
    raised, slope = np.where(torn, raised, high), np.where(torn, slope, tilt)
    assert (limit < wished).sum() > 20 and (high < wished).sum() > 20 and 50 < torn.sum() < n - 50
    close(crowd.rise / size, raised), close(crowd.slope, slope)

    progress, start, hips = crowd.swing.astype(float), crowd.local(crowd.start), crowd.hips(slope, raised)
    arc = (
        crowd.pace[1]
        * np.minimum(1, np.linalg.norm(local - start, axis=0) / (crowd.pace[0] * 0.4))
        * 4
        * progress
        * (1 - progress)
    )
    arc_points = start + (local - start) * progress**2 * (3 - 2 * progress)
    arc_points[1] += arc
    shoulder = hips - np.stack([np.zeros((LEGS, 1)), crowd.leg(FOOT_Y_ROW), np.zeros((LEGS, 1))])
    reach = np.linalg.norm(arc_points - shoulder, axis=0)
    foot = shoulder + (arc_points - shoulder) * np.minimum(1, 0.97 * crowd.leg(LEG_LENGTH_ROW) / reach)
    flying = crowd.swing >= 0
    assert (flying & (reach > 0.97 * crowd.leg(LEG_LENGTH_ROW))).sum() > 50
    close(crowd.local(crowd.shown), np.where(flying, foot, local), 1e-4)
    assert np.array_equal(crowd.shown[:, ~flying], crowd.place[:, ~flying])
    assert np.array_equal(crowd.place, previous["place"]) and np.array_equal(crowd.start, previous["start"])
    assert np.array_equal(last[0], crowd.bodies[:3])
    assert np.array_equal(np.concatenate(last[1:]), crowd.bodies[3:9].astype(F32))


@pytest.mark.parametrize("count", [0, 1])
def test_empty_parts_change_nothing(count: int) -> None:
    crowd = Crowd(6)
    phase, requests = crowd.phase.copy(), np.zeros(LEGS * COUNT, np.int64)
    times = DT, DT, DT, crowd.gaits.least_reach
    gaits = crowd.gaits.legs, crowd.gaits.kernel_tables
    plan = crowd.bodies, crowd.covered, *gaits, times, crowd.undermined, crowd.columns, crowd.pace, crowd.targets, requests
    assert stepping.plan_steps(*plan, count, count) == (LEGS * count, 0)
    assert np.array_equal(crowd.phase, phase) and not requests.any()
