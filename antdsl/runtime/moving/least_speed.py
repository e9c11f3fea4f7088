"""Those who have to keep moving: how fast they go at least, and that obstacles do not slow them where their way is free."""

from __future__ import annotations

import numpy as np

from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import Columns, Vector
from antdsl.runtime.moving.obstacles import slide
from antdsl.runtime.moving.walks import is_led
from antdsl.runtime.world import Population, World

_F = np.float32
LEAST = "min_speed"  # a register of those species alone that ask for it


def no_slower(world: World, population: Population, step: Vector, up: Columns, dt: np.float32) -> Vector:
    """Steps (mm) that obstacles have bent: of those who have to keep moving as long as the least speed asks for along the same
    way, if that is free."""
    now = population.now
    if LEAST not in now or not world.plan.of_kind("obstacle"):
        return step
    size, wanted = vec.length(step), np.minimum(np.maximum(now[LEAST], _F(0)), np.maximum(now["max_speed"], _F(0))) * dt
    short = (size > _F(1e-9)) & (size < wanted * _F(0.999)) & ~population.quarantined & ~is_led(world, population)
    if not short.any():
        return step
    longer = vec.scale(step, np.where(short, wanted / np.where(size > 0, size, _F(1)), _F(0)))
    return vec.choose(short, slide(world, population, longer, up, now["radius"]), step)
