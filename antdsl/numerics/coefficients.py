"""Constants of the elementary functions: of Cody and Waite's reductions, and of the series on what is left."""

from __future__ import annotations

from math import factorial

PI = 3.141592653589793
TWO_OVER_PI = 0.6366197723675814
HALF_PI_HIGH = 1.5707963267341256  # the first 33 bits of pi/2: its product with a whole number below 2**20 is exact
HALF_PI_LOW = 6.077100506506192e-11
FAR = 1e6  # beyond it the angle is first reduced by the exact remainder to 2 pi
LOG2_E = 1.4426950408889634
LN2_HIGH = 0.693147180369123816490
LN2_LOW = 1.90821492927058770002e-10
ROOT_HALF = 0.7071067811865476
TAN_EIGHTH = 0.41421356237309503

SIN = tuple((-1.0) ** k / factorial(2 * k + 1) for k in range(7))
COS = tuple((-1.0) ** k / factorial(2 * k) for k in range(8))
EXP = tuple(1.0 / factorial(k) for k in range(12))
LOG = tuple(2.0 / (2 * k + 1) for k in range(10))
ATAN = tuple((-1.0) ** k / (2 * k + 1) for k in range(15))
