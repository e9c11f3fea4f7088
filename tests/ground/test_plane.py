"""Steps on the plane of a scene without surfaces, against projection matrices and lengths in decimal arithmetic."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest

from antdsl.ground.plane import PlaneGround
from antdsl.ground.protocol import Footing

COUNT = 60
UPS = ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.48, -0.6, 0.64])


def decimals(values: np.ndarray) -> list[Decimal]:
    return [Decimal(float(each)) for each in values]


def flattened(vector: np.ndarray, up: np.ndarray) -> list[Decimal]:
    """The part of a vector that is perpendicular to `up`, to 40 digits."""
    v, normal = decimals(vector), decimals(up)
    along = sum((a * b for a, b in zip(v, normal, strict=True)), Decimal(0))
    return [a - along * b for a, b in zip(v, normal, strict=True)]


@pytest.mark.parametrize("up", UPS)
def test_steps_are_flattened_and_lengths_measured(up: list[float]) -> None:
    rng, normal = np.random.default_rng(8), np.array(up)
    scale = 10.0 ** rng.uniform(-4, 3, (COUNT, 1))  # steps shorter and longer than 1 mm
    points, steps, headings = rng.normal(0, 50, (COUNT, 3)), rng.normal(size=(COUNT, 3)) * scale, rng.normal(size=(COUNT, 3))
    steps[::7] = 0.0
    ups = np.broadcast_to(normal, (COUNT, 3))
    moved = PlaneGround(normal).move(Footing.from_plane(points), steps, headings, ups, 1.0)
    with localcontext() as context:
        context.prec = 40
        for k in range(COUNT):
            step, heading = flattened(steps[k], normal), flattened(headings[k], normal)
            far = sum((a * a for a in step), Decimal(0)).sqrt()
            direction = [a / far for a in step] if far else heading
            position = [a + b for a, b in zip(decimals(points[k]), step, strict=True)]
            assert moved.travelled[k] == pytest.approx(float(far), rel=1e-12)
            assert moved.direction[k] == pytest.approx([float(a) for a in direction], rel=1e-12, abs=1e-13)
            assert moved.heading[k] == pytest.approx([float(a) for a in heading], rel=1e-12, abs=1e-13)
            assert moved.position[k] == pytest.approx([float(a) for a in position], rel=1e-12, abs=1e-12)
    assert np.array_equal(moved.footing.point, moved.position) and np.array_equal(moved.up, ups)
    assert not moved.is_lost.any() and not moved.is_blocked.any() and (moved.travelled[::7] == 0).all()


def test_an_empty_crowd_walks_on_the_plane() -> None:
    none = np.empty((0, 3))
    moved = PlaneGround(np.array(UPS[2])).move(Footing.from_plane(none), none, none, none, 1.0)
    assert moved.position.shape == (0, 3) and moved.travelled.shape == (0,)
