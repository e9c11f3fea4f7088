"""Models on a torus against plain NumPy versions: the flock of Vicsek and NetLogo's slime."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import slime
import vicsek
from numpy.typing import ArrayLike
from sampling import sampled

FRAMES, FIRST = 100, 51  # of a flock; its order is that of the second half
SLIME_FRAMES = (100, 200, 300, 500)


def measure_deviation(values: ArrayLike, expected: ArrayLike) -> float:
    """How many standard errors the mean of some runs is from that of runs in plain NumPy."""
    own, plain = np.asarray(values, float), np.asarray(expected, float)
    return float((own.mean() - plain.mean()) / (plain.std(ddof=1) * np.sqrt(1 / len(own) + 1 / len(plain))))


@pytest.mark.parametrize("eta", sampled([0.5, 2.5, 4.5], [2.5]))
def test_some_flocks_have_the_order_of_the_model(tmp_path: Path, eta: float) -> None:
    scene = vicsek.write_scene(tmp_path)
    own = [vicsek.measure_order(scene, eta, seed, FRAMES, FIRST) for seed in range(3)]
    assert abs(measure_deviation(own, [vicsek.measure_plain_order(eta, seed, FRAMES, FIRST) for seed in range(20)])) < 2.6


@pytest.mark.slow
def test_flocks_have_the_order_of_the_model(tmp_path: Path) -> None:
    """11 levels of noise, 20 seeds. One level in 20 is outside its 95 % interval by chance, so two of 11 may be; all together are
    inside theirs (chi-squared with 11 degrees of freedom)."""
    scene, deviations = vicsek.write_scene(tmp_path), []
    for eta in np.linspace(0, 5, 11):
        own = [vicsek.measure_order(scene, eta, seed, FRAMES, FIRST) for seed in range(20)]
        plain = [vicsek.measure_plain_order(eta, seed, FRAMES, FIRST) for seed in range(100)]
        deviations.append(measure_deviation(own, plain))
    assert sum(abs(each) > 1.96 for each in deviations) <= 2, deviations
    assert sum(each**2 for each in deviations) < 19.68, deviations


def test_a_small_slime_gathers_like_the_model(tmp_path: Path) -> None:
    scene = slime.write_scene(tmp_path, 61, 60)
    own = [slime.measure_slime(scene, 61, seed, (60,))[0] for seed in range(3)]
    plain = [slime.measure_plain_slime(61, 60, seed, (60,))[0] for seed in range(30)]
    assert abs(measure_deviation(own, plain)) < 2.6


@pytest.mark.slow
def test_slime_gathers_like_the_model(tmp_path: Path) -> None:
    """The mean number of neighbours within 3 mm of 400 amoebae on 201 x 201 cells, as in NetLogo by default.
    One of four times may be outside its 95 % interval by chance; all together are inside theirs (chi-squared)."""
    scene = slime.write_scene(tmp_path, 201, 400)
    own = np.array([slime.measure_slime(scene, 201, seed, SLIME_FRAMES) for seed in range(10)])
    plain = np.array([slime.measure_plain_slime(201, 400, seed, SLIME_FRAMES) for seed in range(20)])
    deviations = [measure_deviation(own[:, k], plain[:, k]) for k in range(len(SLIME_FRAMES))]
    assert sum(abs(each) > 1.96 for each in deviations) <= 1, (deviations, own.mean(axis=0), plain.mean(axis=0))
    assert sum(each**2 for each in deviations) < 9.49, deviations
