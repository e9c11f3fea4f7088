"""`compute_noise`: between -1 and 1, smooth, a function of place and time alone, on both backends and for any order of rows the
same."""

from __future__ import annotations

import numpy as np
import plans
import pytest
from plan_text import plan_of

from antdsl.numerics.noise import MAX_LATTICE_COORDINATE, compute_fade, compute_noise, hash_pcg4d
from antdsl.program.checks.analysis.ranges import compute_range
from antdsl.runtime import Options, bind, state_hash, step
from antdsl.runtime.faults import FaultStop

RNG = np.random.default_rng(3)


def at(points: np.ndarray, seed: int = 0) -> np.ndarray:
    return compute_noise(points, np.full(points.shape[1], seed, np.int64))


def test_values_are_within_one_and_centred() -> None:
    values = at(RNG.uniform(-500, 500, (4, 40_000)))
    assert -1 < values.min() < -0.5 and 0.5 < values.max() < 1
    assert abs(values.mean()) < 0.01 and 0.1 < values.std() < 0.4
    assert (at(RNG.integers(-90, 90, (4, 500)).astype(float)) == 0).all()  # at the points of the lattice


@pytest.mark.parametrize("axis", range(4))
def test_slope_and_curvature_are_continuous(axis: int) -> None:
    """Along a line that crosses many cells the second difference of a fine walk stays small everywhere, at their borders too."""
    step_ = 1e-4
    line = np.repeat(RNG.uniform(-9, 9, (4, 1)), 60_001, axis=1)
    line[axis] += np.arange(60_001) * step_
    value = at(line)
    slope = np.diff(value) / step_
    bend = np.diff(slope) / step_
    assert np.abs(slope).max() < 5
    assert np.abs(np.diff(slope)).max() < 60 * step_  # no step of the slope: it changes as slowly as the walk is fine
    assert np.abs(np.diff(bend)).max() < 0.5


def test_the_fade_has_zero_slope_at_both_ends() -> None:
    t = np.array([0.0, 0.5, 1.0])
    assert compute_fade(t).tolist() == [0.0, 0.5, 1.0]
    assert abs(compute_fade(np.array([1e-4]))[0]) < 1e-11


def test_patterns_of_different_seeds_are_uncorrelated() -> None:
    points = RNG.uniform(-500, 500, (4, 20_000))
    one, other, same = at(points, 1), at(points, 2), at(points, 1)
    assert np.array_equal(one, same)
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.03


def test_neighbouring_cells_are_uncorrelated() -> None:
    inside = RNG.uniform(0.3, 0.7, (4, 1))
    corner = RNG.integers(-500, 500, (4, 20_000))
    one = at(inside + corner)
    for away in 2 * np.eye(4):
        assert abs(np.corrcoef(one, at(inside + corner + away[:, None]))[0, 1]) < 0.03


def test_hashes_equal_those_of_the_paper() -> None:
    """pcg4d computed in whole numbers."""

    def plain(v: list[int]) -> list[int]:
        v = [(x * 1664525 + 1013904223) & 0xFFFFFFFF for x in v]
        for last in (False, True):
            v[0] = (v[0] + v[1] * v[3]) & 0xFFFFFFFF
            v[1] = (v[1] + v[2] * v[0]) & 0xFFFFFFFF
            v[2] = (v[2] + v[0] * v[1]) & 0xFFFFFFFF
            v[3] = (v[3] + v[1] * v[2]) & 0xFFFFFFFF
            if not last:
                v = [x ^ (x >> 16) for x in v]
        return v

    words = RNG.integers(0, 2**32, (4, 50)).astype(np.uint32)
    assert hash_pcg4d(words).T.tolist() == [plain([int(x) for x in column]) for column in words.T]


def test_non_finite_points_give_nan() -> None:
    odd = np.array([[np.nan, np.inf, MAX_LATTICE_COORDINATE, 0.5]] * 4)
    assert np.isnan(at(odd)).tolist() == [True, True, True, False]


PROGRAM = """species ant {
  mood = 0
  near = 0
  start go
  state go {
    mood = noise(20 mm, seed: id, period: 0.5 s) + noise(scale: 7 mm + size)
    near = sum(n in neighbours(30 mm): noise(9 mm, seed: n.id))
  }
}
"""


def run(options: Options, frames: int = 4) -> tuple[list[str], np.ndarray]:
    world = bind(plan_of(PROGRAM), plans.crowd(40), options)
    hashes = []
    for _ in range(frames):
        step(world)
        hashes.append(state_hash(world))
    ants = world.populations["ant"]
    assert world.faults.fault_count == 0
    order = np.argsort(ants.ids)
    return hashes, np.stack([ants.now["mood"], ants.now["near"]])[:, order]


def test_both_backends_and_any_rows_give_the_same_bits() -> None:
    hashes, values = run(Options(backend="reference"))
    assert len(set(hashes)) == len(hashes) and len(set(values[0].tolist())) > 30 and (values[1] != 0).any()
    for options in (Options(), Options(chunk=7), Options(shuffle_rows=5), Options(backend="reference", shuffle_rows=2)):
        again, same = run(options)
        assert again == hashes and np.array_equal(values, same)


def test_a_scale_of_nothing_is_refused_in_a_run_and_not_stored() -> None:
    text = "species ant {\n  mood = 5\n  start go\n  state go { mood = noise((mood - 5) * 1 mm) }\n}\n"
    world = bind(plan_of(text), plans.crowd(3), Options())
    with pytest.raises(FaultStop):
        step(world)
    assert world.faults.fault_count == 3 and (world.populations["ant"].now["mood"] == 5).all()


def test_checks_know_the_range_of_noise() -> None:
    from plan_text import program_of

    species = program_of("species ant {\n  mood = noise(20 mm)\n  start go\n  state go { mood = noise(20 mm) * 2 }\n}\n").species
    stored = species["ant"].machines[0].states[0].body[0]
    bounds = compute_range(stored.value, {}, {})  # type: ignore[union-attr]
    assert (bounds.low, bounds.high) == (-2, 2)
