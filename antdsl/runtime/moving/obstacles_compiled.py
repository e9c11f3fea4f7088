"""The passes of obstacles over all agents as loops: the same operations in the same order, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import F32, I64, Array1, kernel
from antdsl.numerics.vectors_compiled import dot

Three = tuple[Array1[F32], Array1[F32], Array1[F32]]
_F = np.float32
_ZERO, _LEAST, _MARGIN = _F(0), _F(1e-9), _F(0.5)  # as `obstacles`
_SLACK = _F(1e-4)  # as `obstacle_clearance`
_WIDER = _F(1) + _SLACK


@kernel
def touching(
    step: Three,
    radius: Array1[F32],
    clear: Array1[F32],
    rows: Array1[I64],
    sizes: Array1[F32],
    margins: Array1[F32],
) -> I64:
    """How many may touch an obstacle on their step, which is `clear` of them: their rows, lengths of steps and margins (mm)."""
    count = 0
    for i in range(radius.size):
        way = (step[0][i], step[1][i], step[2][i])
        size = np.sqrt(dot(way, way))
        margin = (_ZERO if radius[i] <= 0 else radius[i]) * _MARGIN
        if size > _LEAST and clear[i] <= (size + margin) * _WIDER + _SLACK:
            rows[count], sizes[count], margins[count] = i, size, margin
            count += 1
    return count


@kernel
def slowed(wanted: Three, step: Three, velocity: Three, rate: F32, to: Three) -> None:
    """Velocities into `to`: of those whose steps are not as `wanted`, `rate` times their steps."""
    for i in range(wanted[0].size):
        stopped = step[0][i] != wanted[0][i] or step[1][i] != wanted[1][i] or step[2][i] != wanted[2][i]
        for k in range(3):
            to[k][i] = step[k][i] * rate if stopped else velocity[k][i]
