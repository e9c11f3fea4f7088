"""Accuracy of the kernels against float64, the same bits for scalars and arrays, and sums that do not know their order."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.numerics import elementary, exact_sums

RNG = np.random.default_rng(3)
N = 40_000
WIDE = RNG.uniform(-1e5, 1e5, N).astype(np.float32)
POSITIVE = np.exp(RNG.uniform(-80, 80, N)).astype(np.float32)
SIGNED = RNG.normal(0, 1, N).astype(np.float32)
BASE = RNG.uniform(0.05, 50, N).astype(np.float32)
ONE = [
    (elementary.sin, np.sin, WIDE),
    (elementary.cos, np.cos, WIDE),
    (elementary.exp, np.exp, RNG.uniform(-100, 88, N).astype(np.float32)),
    (elementary.log, np.log, POSITIVE),
    (elementary.log, np.log, (1 + SIGNED * 1e-3).astype(np.float32)),
]
TWO = [
    (elementary.power, np.power, BASE, RNG.uniform(-20, 20, N).astype(np.float32)),
    (elementary.atan2, np.arctan2, SIGNED, SIGNED[::-1].copy()),
]


def _units_in_the_last_place(value, truth):
    return float(
        np.max(np.abs(value.astype(np.float64) - truth) / np.spacing(np.abs(truth.astype(np.float32))).astype(np.float64))
    )


@pytest.mark.parametrize("ours, theirs, x", ONE)
def test_one_argument(ours, theirs, x):
    value = ours(x)
    assert value.dtype == np.float32
    assert _units_in_the_last_place(value, theirs(x.astype(np.float64))) < 0.51
    assert value[:300].tobytes() == np.array([ours(v) for v in x[:300]]).tobytes()


@pytest.mark.parametrize("ours, theirs, x, y", TWO)
@np.errstate(over="ignore")
def test_two_arguments(ours, theirs, x, y):
    value = ours(x, y)
    assert value.dtype == np.float32
    assert _units_in_the_last_place(value, theirs(x.astype(np.float64), y.astype(np.float64))) < 0.51
    assert value[:300].tobytes() == np.array([ours(a, b) for a, b in zip(x[:300], y[:300], strict=True)]).tobytes()


EDGES = [0.0, -0.0, 1.0, -1.0, 0.5, -2.0, 3.0, np.inf, -np.inf, np.nan, 1e-45, 3e38, -3e38]


@pytest.mark.parametrize("name", ["exp", "log", "sin", "cos", "power", "atan2"])
def test_special_values_of_scalars_and_arrays_agree(name):
    ours = getattr(elementary, name)
    with np.errstate(all="ignore"):
        if name in ("power", "atan2"):
            a, b = (np.array(v, np.float32).ravel() for v in np.meshgrid(EDGES, EDGES))
            assert np.array_equal(ours(a, b), np.array([ours(x, y) for x, y in zip(a, b, strict=True)]), equal_nan=True)
        else:
            a = np.array(EDGES, np.float32)
            assert np.array_equal(ours(a), np.array([ours(x) for x in a]), equal_nan=True)


@pytest.mark.parametrize(
    "a, b, value",
    [
        (-2, 3, -8),
        (-2, 2, 4),
        (0, 2, 0),
        (0, -1, np.inf),
        (5, 0, 1),
        (np.nan, 0, 1),
        (1, np.nan, 1),
        (np.inf, 0.5, np.inf),
        (2, -np.inf, 0),
    ],
)
def test_powers(a, b, value):
    with np.errstate(all="ignore"):
        assert elementary.power(np.float32(a), np.float32(b)) == np.float32(value)
        assert np.isnan(elementary.power(np.float32(-2), np.float32(0.5)))


def test_sums_do_not_depend_on_term_order():
    terms = (RNG.normal(0, 1, N) * 10.0 ** RNG.uniform(-6, 3, N)).astype(np.float32)
    index = RNG.integers(0, 50, N)
    value = exact_sums.sum_by_index(index, terms, -24, 50)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(N)
        assert exact_sums.sum_by_index(index[order], terms[order], -24, 50).tobytes() == value.tobytes()
    naive = np.zeros(50)
    np.add.at(naive, index, terms.astype(np.float64))
    assert np.allclose(value, naive, rtol=1e-6, atol=1e-4)
