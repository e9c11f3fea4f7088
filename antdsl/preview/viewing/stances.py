"""Where feet stand in a frame, and how trunks stand over them, as few bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.leg_ik import Legs
from antdsl.numerics.vector_rows import unit_or
from antdsl.preview.timeline import Light
from antdsl.runtime.feet.state import Feet
from antdsl.runtime.feet.trunk import quaternions

_LENGTH = 4096  # steps in a body's length
_WHOLE = 32767
_DOWN = 15  # feet of which it is told whether they stand
Floats = NDArray[np.float32]


def stances(legs: Legs, feet: Feet, light: Light, stands: Floats) -> dict[str, NDArray[np.int16]]:
    """`feet` int16[n, L, 3]: where each foot joint is to be beside a body whose trunk is not moved, 4096 to a body's length,
    ahead, above and aside; `stance` int16[n, 6]: how much the trunk is raised, the x, y and z of its turn, how much feet stand
    (32767 is 1), and a bit for each foot that does. `light`: where these agents are shown, `stands` [n]: how much clips leave
    feet where they stand.

    Bodies stand as pages turn them, by directions of three bytes, so that a foot that stands does not shake with these."""
    size = np.where(light.size > 0, light.size, 1).astype(np.float32)
    rise = feet.rise / size * stands
    tilt = quaternions(feet.slope) * stands[:, None]
    tilt[:, 3] += 1 - stands
    tilt /= np.maximum(np.linalg.norm(tilt, axis=1, keepdims=True), 1e-20)
    made = np.empty((len(stands), 6), np.int16)
    made[:, 0] = _steps(rise, _LENGTH)
    made[:, 1:4] = _steps(tilt[:, :3], _WHOLE)  # by less than half a turn, so that w is above 0
    made[:, 4] = _steps(stands, _WHOLE)
    told = feet.down[:, :_DOWN]
    made[:, 5] = (told << np.arange(told.shape[1])).sum(axis=1)
    away = (feet.shown - light.position.T[:, :, None]).astype(np.float32) / size[None, :, None]
    place = _turned_back(_frames(light), away)
    place[1] += legs.soles[None] - rise[:, None]
    goals = _turned_back(_rotations(tilt), place)
    return {"feet": _steps(goals.transpose(1, 2, 0), _LENGTH), "stance": made}


def _frames(light: Light) -> Floats:
    """Columns ahead, above and aside of agents, float32[3, 3, n], as pages make them."""
    up = unit_or(light.up.astype(np.float64), np.array([0.0, 1.0, 0.0])).astype(np.float32)
    ahead = light.heading.astype(np.float32)
    ahead -= up * (ahead * up).sum(axis=1, keepdims=True)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-20)
    return np.stack([ahead.T, up.T, np.cross(ahead, up).T], axis=1)


def _rotations(turn: Floats) -> Floats:
    """Matrices float32[3, 3, n] of unit quaternions [n, 4]."""
    x, y, z, w = turn.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row) for row in rows]).astype(np.float32)


def _turned_back(matrices: Floats, places: Floats) -> Floats:
    """Places float32[3, n, L] by the transposes of matrices [3, 3, n]."""
    x, y, z = places
    return np.stack([(m[0][:, None] * x + m[1][:, None] * y) + m[2][:, None] * z for m in matrices.transpose(1, 0, 2)])


def _steps(values: NDArray[Any], whole: int) -> NDArray[np.int16]:
    found: NDArray[np.int16] = np.clip(np.rint(np.nan_to_num(values) * np.float32(whole)), -32767, 32767).astype(np.int16)
    return found
