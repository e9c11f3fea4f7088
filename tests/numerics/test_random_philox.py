"""The generator against the known answers of its authors, and draws as pure functions of their place."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.numerics import randomness

KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@pytest.mark.parametrize("counter, key, answer", KNOWN)
def test_known_answers(counter, key, answer):
    words = randomness.run_philox(tuple(np.full(3, c, np.uint64) for c in counter), key)
    assert [[int(w) for w in word] for word in words] == [[a] * 3 for a in answer]


def test_draws_are_functions_of_their_arguments():
    ids = np.arange(1000, dtype=np.int64)
    draws = randomness.draw_uniform(7, 12, "ant", "main.search#1", 0, ids)
    assert draws.dtype == np.float32 and draws.min() >= 0 and draws.max() < 1
    rows = np.random.default_rng(0).permutation(1000)
    assert np.array_equal(randomness.draw_uniform(7, 12, "ant", "main.search#1", 0, ids[rows]), draws[rows])
    assert np.array_equal(randomness.draw_uniform(7, 12, "ant", "main.search#1", 0, ids[:10]), draws[:10])


@pytest.mark.parametrize(
    "other",
    [
        (8, 12, "ant", "s", 0),
        (7, 13, "ant", "s", 0),
        (7, 12, "bee", "s", 0),
        (7, 12, "ant", "t", 0),
        (7, 12, "ant", "s", 1),
        (7, 12, "ant", "s", 4),
        (7 + 2**32, 12, "ant", "s", 0),
    ],
)
def test_every_argument_changes_the_draw(other):
    ids = np.arange(4000, dtype=np.int64)
    a = randomness.draw_uniform(7, 12, "ant", "s", 0, ids)
    b = randomness.draw_uniform(*other, ids)
    assert abs(float(np.corrcoef(a, b)[0, 1])) < 0.06
    assert (a == b).mean() < 0.01


def test_draws_are_uniform():
    ids = np.arange(200_000, dtype=np.int64)
    counts = np.bincount((randomness.draw_uniform(1, 0, "a", "s", 2, ids) * 100).astype(int), minlength=100)
    assert ((counts - 2000.0) ** 2 / 2000.0).sum() < 150  # chi square of 99 degrees; 150 is beyond one in a thousand


def test_ids_above_32_bits_have_different_draws():
    ids = np.array([5, 5 + 2**32, 5 + 2**33], np.int64)
    assert len(set(randomness.draw_uniform(1, 0, "a", "s", 0, ids).tolist())) == 3
