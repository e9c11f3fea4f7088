"""How fast headings follow the movement, which differences count, and the states of bodies.

The `state` of a body is the number of the wall before it; or it leans, or stands as its feet do, or hastens: it stands so, but
would turn too fast."""

from __future__ import annotations

from functools import cache

import numpy as np

from antdsl.numerics import elementary

_F = np.float32
_HEADING_TIME = 0.1  # s, of the heading on its way to the direction of movement (T22)
FACE = "~face.x"  # a register of those species alone that ask for it
SLOW = _F(0.1)  # of max_speed: below it the heading follows more and more slowly
BOUNCE = _F(0.3)  # of the speed into the border of an open surface that is turned back
BEYOND = _F(1.005)  # times the greatest turn, up to which rounding may bring one
LEVEL = _F(1e-3)  # sine of the angle to the body's up below which a way to face says nothing
AT_ONCE = _F(1.0001)  # steps: who responds within that is kinematic
LEAST_TURN = _F(1e-12)  # rad2 more than the greatest turn that are rounding
TWELFTH, NINETIETH = _F(1 / 12), _F(1 / 90)  # of the series of an angle's square

LEANS, STANDS, HASTENS = -1, -2, -3


@cache
def share(dt: np.float32) -> np.float32:
    """Of the turn towards the movement: how much is done within a substep."""
    return _F(1.0 - float(elementary.exp(_F(-float(dt) / _HEADING_TIME))))
