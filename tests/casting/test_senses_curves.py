"""Curves: even samples, exact nearest points, tangents as drawn, and ties that fall to the first."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.casting.curves import SampledCurve, resample_curve


def spiral(n: int = 60) -> np.ndarray:
    t = np.linspace(0, 4 * np.pi, n)
    return np.stack([10 * t * np.cos(t), 3 * t, 10 * t * np.sin(t)], axis=1)


def test_samples_are_evenly_spaced_and_include_both_ends():
    line = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 9], [4, 0, 9]], np.float64)
    even = resample_curve(line, 0.5)
    assert len(even) == 27 and np.array_equal(even[[0, -1]], line[[0, -1]])
    assert np.allclose(np.linalg.norm(np.diff(even, axis=0), axis=1), 0.5)
    assert len(resample_curve(line, 1e-9)) <= 5000
    assert len(resample_curve(np.ones((3, 3)), 1.0)) == 1


@pytest.mark.parametrize("reach", [5.0, 200.0, 5000.0])
def test_nearest_point_and_tangent_against_all_segments(reach):
    curve = SampledCurve(spiral(), 4.0)
    points = np.random.default_rng(1).uniform(-reach, reach, (400, 3))
    closest = curve.find_closest(*points.T)
    start, step = curve.samples[:-1], np.diff(curve.samples, axis=0)
    part = np.clip(np.einsum("psk,sk->ps", points[:, None] - start, step) / (step**2).sum(axis=1), 0, 1)
    point = start + part[:, :, None] * step
    gap = np.linalg.norm(point - points[:, None], axis=2)
    best = gap.argmin(axis=1)
    rows = np.arange(400)
    assert np.allclose(closest.distance, gap[rows, best], rtol=1e-6)
    assert np.allclose(np.stack([closest.px, closest.py, closest.pz], axis=1), point[rows, best], atol=1e-4)
    unit = step / np.linalg.norm(step, axis=1, keepdims=True)
    tangent = np.stack([closest.tx, closest.ty, closest.tz], axis=1)
    assert np.allclose(np.linalg.norm(tangent, axis=1), 1)
    # The tangent turns from joint to joint: within half a bend of the segment's own way.
    bend = np.arccos((unit[1:] * unit[:-1]).sum(axis=1).clip(-1, 1)).max()
    assert np.arccos((tangent * unit[best]).sum(axis=1).clip(-1, 1)).max() <= bend / 2 + 1e-3


def test_tangents_rotate_evenly():
    curve = SampledCurve(np.array([[0, 0, 0], [10, 0, 0], [10, 0, 10]], np.float64), 1.0)
    s = np.linspace(8.0, 12.0, 400)
    closest = curve.find_closest(np.minimum(s, 10), np.zeros(400), np.maximum(s - 10, 0))
    angle = np.degrees(np.arctan2(closest.tz, closest.tx))
    assert angle[0] == 0 and angle[-1] == 90 and np.diff(angle).min() >= 0 and np.diff(angle).max() < 1.5


def test_tangents_follow_the_drawing_direction_and_reverse_flips_them():
    line = np.array([[0, 0, 0], [10, 0, 0]], np.float64)
    one = np.array([5.2], np.float32), np.array([1.0], np.float32), np.array([0.0], np.float32)
    assert (
        SampledCurve(line, 1.0).find_closest(*one).tx[0] == 1
        and SampledCurve(line, 1.0, reverse=True).find_closest(*one).tx[0] == -1
    )


def test_ties_select_the_first_point_along_the_curve():
    hairpin = np.array([[0, 0, -1], [10, 0, -1], [10, 0, 1], [0, 0, 1]], np.float64)
    curve = SampledCurve(hairpin, 0.5)
    x = np.linspace(0.1, 8.9, 50)
    zero = np.zeros(50)
    closest = curve.find_closest(x, zero, zero)
    assert (closest.tx == 1).all() and (closest.pz == -1).all() and (closest.distance == 1).all()
    alone = curve.find_closest(x[7:8], zero[:1], zero[:1])
    assert alone.px[0] == closest.px[7]


def test_curves_of_one_point_and_invalid_curves():
    dot = SampledCurve(np.array([[1.0, 2, 3]]), 1.0)
    closest = dot.find_closest(np.array([1.0, np.nan]), np.array([2.0, 0]), np.array([7.0, 0]))
    assert closest.distance.tolist() == [4.0, np.inf] and closest.tx.tolist() == [0, 0]
    for bad in (np.empty((0, 3)), np.array([[0, np.nan, 0]])):
        with pytest.raises(ValueError, match="at least one point"):
            SampledCurve(bad, 1.0)
    with pytest.raises(ValueError, match="more than 0"):
        SampledCurve(spiral(), 0.0)
