"""The walk of `Plane` as a loop: the same operations in the same order, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import F64, Array1, Array2, Strided2, inlined, kernel
from antdsl.numerics.vectors_compiled import dot, minus, plus, times


@inlined
def straight(up, point, way, ahead):  # type: ignore[no-untyped-def]
    """As `Plane.move`, for one: place, heading, direction and the way gone."""
    step, look = minus(way, times(up, dot(way, up))), minus(ahead, times(up, dot(ahead, up)))
    far = np.sqrt(dot(step, step))
    direction = look
    if far > 0:
        direction = (step[0] / far, step[1] / far, step[2] / far)
    return plus(point, step), look, direction, far


@kernel
def straight_on(
    up: Array1[F64],
    point: Strided2[F64],
    way: Strided2[F64],
    ahead: Strided2[F64],
    to: Array2[F64],
    heading: Array2[F64],
    direction: Array2[F64],
    travelled: Array1[F64],
) -> None:
    """From points by ways across `up`, with headings: all (n, 3), as are the results, the last four."""
    normal = (up[0], up[1], up[2])
    for i in range(travelled.size):
        step, look = (way[i, 0], way[i, 1], way[i, 2]), (ahead[i, 0], ahead[i, 1], ahead[i, 2])
        there, look, go, far = straight(normal, (point[i, 0], point[i, 1], point[i, 2]), step, look)
        for k in range(3):
            to[i, k], heading[i, k], direction[i, k] = there[k], look[k], go[k]
        travelled[i] = far
