"""The motion gate: measures of motion against geometry written out here, and a sample of the table of bounds."""

from __future__ import annotations

import math
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
from motion_gate import Bound, broken_bounds, lower_bounds, measure_row, read_bounds, round_up, write_bounds
from motion_track import MEASURES, MotionRow, MotionTrack, Trunks, angle, overlapping, rotate, segment_distance
from sampling import sampled

from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.scene.library_bodies import TrunkCapsule

SAMPLE = ("minimal/scene", "torture/cube")
ROWS = {row.name: row for row in read_bounds()}
ALONG_X = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])


def trunks(gap: float) -> Trunks:
    """Two parallel trunks 4 long and 1 wide, with a gap between their sides."""
    middle = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0 + gap]])
    return Trunks(middle, ALONG_X, np.full(2, 1.5), np.full(2, 0.5), np.full(2, 4.0))


def test_trunks_overlap_from_a_twentieth_of_their_width_on() -> None:
    assert not overlapping(trunks(0.1)).any()
    assert not overlapping(trunks(-0.049)).any()
    assert overlapping(trunks(-0.051)).all()
    assert overlapping(Trunks(*(each[:0] for each in trunks(0.0)))).shape == (0,)


def test_distances_of_segments_are_those_of_all_their_points() -> None:
    draws = np.random.default_rng(5).normal(size=(40, 4, 3))
    start, along, other, other_along = draws.transpose(1, 0, 2)
    share = np.linspace(0, 1, 201)
    points = start[:, None] + along[:, None] * share[:, None]
    others = other[:, None] + other_along[:, None] * share[:, None]
    least = np.linalg.norm(points[:, :, None] - others[:, None], axis=3).min(axis=(1, 2))
    assert np.abs(segment_distance(start, along, other, other_along) - least).max() < 0.02


def test_a_quaternion_turns_x_to_the_heading() -> None:
    half = math.radians(30) / 2
    turned = rotate(np.array([0.0, math.sin(half), 0.0, math.cos(half)]), (1.0, 0.0, 0.0))
    assert np.allclose(turned, [math.cos(math.radians(30)), 0.0, -math.sin(math.radians(30))])
    assert np.allclose(angle(turned, np.array([1.0, 0.0, 0.0])), 30.0)


class FakeTrack(MotionTrack):
    """The track of agents with given headings (frames, n) in degrees about y, and positions."""

    def __init__(self, degrees: np.ndarray, position: np.ndarray) -> None:
        self.fps, self.common = 24.0, np.arange(degrees.shape[1])
        turn = np.radians(degrees)
        self.__dict__ |= {
            "heading": np.stack([np.cos(turn), 0 * turn, -np.sin(turn)], axis=2),
            "up": np.broadcast_to([0.0, 1.0, 0.0], (*degrees.shape, 3)),
            "position": position,
            "size": np.full(degrees.shape, 4.0),
        }


def test_turns_to_one_side_and_back_are_zigzags_and_a_full_turn_on_the_spot_is_a_spin() -> None:
    frames = np.arange(60)
    degrees = np.stack([8.0 * (frames % 2), 3.0 * (frames % 2), 14.0 * frames, 14.0 * frames], axis=1)
    position = np.zeros((60, 4, 3))
    position[:, 3, 0] = frames  # walks four body lengths in a circle's time
    track = FakeTrack(degrees, position)
    assert track._zigzags().all(axis=0).tolist() == [True, False, False, False]
    assert track._spins().any(axis=0).tolist() == [False, False, True, False]
    assert np.allclose(np.abs(track.turn[:, 2]), 14.0) and np.allclose(track.rotation[:, 2], 14.0)


def test_bounds_are_rounded_up_and_only_fall(tmp_path: Path) -> None:
    assert [round_up(value) for value in (0.0, 1.2341, 99.91, 0.010001, 2.0)] == [0.0, 1.24, 100.0, 0.0101, 2.0]
    row = Bound("some/scene", 24, MotionRow(*[2.0] * len(MEASURES)))
    measured = replace(row.bounds, turn=3.0, spin=1.0)
    assert [*broken_bounds(row, measured)] == ["some/scene: turn is 3, above its bound of 2"]
    assert [*broken_bounds(row, replace(measured, turn=2.6))] == []  # other paths of the same kind
    lower = lower_bounds(row, measured)
    assert (lower.bounds.turn, lower.bounds.spin) == (2.0, 1.0)
    path = tmp_path / "bounds.txt"
    path.write_text("# A comment.\n")
    write_bounds([lower], path)
    assert path.read_text().startswith("# A comment.\n") and read_bounds(path) == (lower,)
    path.write_text("row frames overlap\n")
    with pytest.raises(ValueError, match="columns"):
        read_bounds(path)


def test_a_row_of_the_table_has_a_bound_for_each_measure() -> None:
    assert all(math.isfinite(bound) for row in ROWS.values() for bound in astuple(row.bounds))


@pytest.mark.parametrize("name", sampled(ROWS, SAMPLE))
def test_motion_is_within_its_bounds(name: str) -> None:
    assert [*broken_bounds(ROWS[name], measure_row(ROWS[name]))] == []


def test_bodies_under_their_feet_are_inside_and_wide_ones_overlap(tmp_path: Path) -> None:
    measure_row(replace(ROWS["torture/cube"], frames=4), saved=tmp_path)
    capsules = (TrunkCapsule(0.09, 0.02, 0.1), TrunkCapsule(8.1, 1.8, 0.1), TrunkCapsule(0.9, 0.2, -0.5))
    small, wide, sunk = (MotionTrack(open_cache(tmp_path), {"crawler": each}).measure() for each in capsules)
    assert (small.overlap, wide.overlap > 90) == (0, True)
    assert small.inside < 1 and sunk.inside > 95
