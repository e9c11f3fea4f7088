"""How far a crowd goes and how large its bodies are, at most: what it has to know of its surroundings."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import F32, F64, Array1, kernel


@kernel
def longest(ways: Array1[F32], bodies: Array1[F32]) -> tuple[F64, F64]:
    """The greatest of ways that are finite, 0 without one, and of bodies that are numbers, NaN without one."""
    way, body, known = np.float32(0), np.float32(-np.inf), False
    for i in range(ways.size):
        if ways[i] < np.inf and ways[i] > way:
            way = ways[i]
    for i in range(bodies.size):
        if bodies[i] == bodies[i]:
            known = True
            if bodies[i] > body:
                body = bodies[i]
    return np.float64(way), np.float64(body if known else np.float32(np.nan))
