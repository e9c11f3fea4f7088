"""All that is reduced over a set is the same to the bit in any order: terms that cancel, from 1e-7 to 1e7, 2,000 of them."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from meaning import crowd, play

from antdsl.numerics import exact_sums
from antdsl.runtime import Options

COUNT = 2_000
QUANTA = (-30, -24, -20, -10, 0)


def adversarial(seed: int, largest: float = 7.0) -> np.ndarray:
    """Terms of both signs, nine of ten of which cancel: what is left is as small as what adding them in float64 rounds off."""
    rng = np.random.default_rng(seed)
    large = (10.0 ** rng.uniform(-7, largest, COUNT * 9 // 20)).astype(np.float32)
    small = (rng.choice([-1.0, 1.0], COUNT // 10) * 10.0 ** rng.uniform(-7, -6, COUNT // 10)).astype(np.float32)
    terms = np.concatenate([large, -large, small])
    rng.shuffle(terms)
    return terms


def by_fractions(terms: np.ndarray, quantum: int) -> np.float32:
    """The definition, with whole numbers of any length."""
    one, most = Fraction(2) ** quantum, 2**44
    integers = [round(Fraction(float(term)) / one) for term in terms]  # to even at a tie, as float64 does
    return np.float32(float(sum(max(-most, min(most, n)) for n in integers) * one))


@pytest.mark.parametrize("quantum", QUANTA)
@pytest.mark.parametrize("largest", [5.0, 7.0])
def test_sums_are_exact_in_any_order(quantum: int, largest: float):
    terms = adversarial(3, largest)
    expected = by_fractions(terms, quantum)
    rng = np.random.default_rng(1)
    for _ in range(20):
        order = rng.permutation(COUNT)
        assert exact_sums.sum_by_index(np.zeros(COUNT, np.intp), terms[order], quantum, 1)[0].tobytes() == expected.tobytes()


@pytest.mark.parametrize("quantum", QUANTA)
def test_sums_in_two_words_are_exact(quantum: int):
    """Terms at the cut and next to it: their sum has more than the 53 digits of a float64."""
    rng = np.random.default_rng(5)
    cut = np.float32(2.0 ** (quantum + 44))
    small = (rng.integers(1, 999, COUNT) * 2.0**quantum).astype(np.float32)
    for terms in (np.full(COUNT, cut), np.concatenate([np.full(COUNT, cut * 2), small, np.full(COUNT - 1, -cut)])):
        expected = by_fractions(terms, quantum)
        for _ in range(10):
            order = rng.permutation(len(terms))
            totals = exact_sums.sum_by_index(np.ones(len(terms), np.intp), terms[order], quantum, 3)
            assert totals[1].tobytes() == expected.tobytes() and totals[0] == totals[2] == 0


def test_nan_affects_only_its_sum():
    terms = np.array([1.0, np.nan, 2.0, np.inf], np.float32)
    totals = exact_sums.sum_by_index(np.array([0, 1, 0, 2]), terms, -24, 3)
    assert totals[0] == 3 and np.isnan(totals[1]) and totals[2] == 2.0**20


# The numbers are those of `adversarial`, made in the language: large ones in pairs that cancel, then small ones of both signs.
TEXT = """species a { all_of = 0
near_ones = 0
less = 0
middle = 0
least = 0
most = 0
best_one = 0
on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s) }
start s
state s {
  all_of = sum(n in b: n.w)
  near_ones = sum(n in neighbours(900 mm, of: b): n.w)
  less = sum(n in b: n.w * n.v)
  middle = mean(n in b: n.w)
  least = min(n in b: n.w)
  most = max(n in b: n.w)
  best_one = best(n in b: n.w).id
  when false -> t
}
state t { when false -> s } }
species b { k = floor(id / 2)
w = if id < %d then (if id - 2 * k < 1 then 1 else -1) * 10 ^ (7 * sin(k * 12.9898 rad)) else cos(id * 78.233 rad) / 1000000
v = if id < %d then 1 / 1024 else 1
on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s) }
start s
state s { when false -> t }
state t { when false -> s } }"""


def test_reductions_of_a_program_are_the_same_in_any_order_of_rows():
    option_sets = (
        Options(),
        *(Options(shuffle_rows=seed) for seed in range(1, 7)),
        Options(chunk=333, shuffle_rows=8, threads=2),
    )
    history = play(TEXT % ((COUNT * 9 // 10,) * 2), crowd(3), crowd(COUNT, "b", radius=300), option_sets=option_sets)
    assert 0 < abs(history["all_of"][0]) < 1e-4
    assert history["most"][0] > 1e6 and history["least"][0] < -1e6


def test_the_reference_backend_has_equal_sums(monkeypatch: pytest.MonkeyPatch):
    few = COUNT // 5
    option_sets = (Options(), Options(backend="reference"), Options(backend="reference", shuffle_rows=1))
    history = play(TEXT % ((few * 9 // 10,) * 2), crowd(1), crowd(few, "b", radius=300), option_sets=option_sets)
    assert 0 < abs(history["all_of"][0]) < 1e-4
