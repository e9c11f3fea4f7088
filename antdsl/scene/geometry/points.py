"""Reads JSON files with a list of points `[x, y, z]`, for curves and for placing agents one by one."""

from __future__ import annotations

import json
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits

MAX_POINT_FILE_BYTES = 64 * limits.MIB


class PointsError(Exception):
    """Error for a file without usable points. The message is a reason that fits after the file's name."""


def _reject_json_constant(word: str) -> Any:
    raise PointsError(f"has `{word}`, which is not a number")


def read_points(data: bytes, min_count: int) -> NDArray[np.float64]:
    """Return the points of a file as an array (n, 3), in the file's own units. Raises PointsError with the reason if there are
    fewer than `min_count` points."""
    try:
        points = json.loads(data.decode("utf-8-sig"), parse_constant=_reject_json_constant)
    except (ValueError, RecursionError):
        raise PointsError("is not JSON") from None
    if not isinstance(points, list) or len(points) < min_count:
        raise PointsError(f"is not a list of at least {min_count} points `[x, y, z]`")
    if len(points) > limits.MAX_AGENTS:
        raise PointsError(f"has more than {limits.MAX_AGENTS:,} points")
    for number, point in enumerate(points):
        if not isinstance(point, list) or len(point) != 3 or not all(_is_number(part) for part in point):
            raise PointsError(f"has no point `[x, y, z]` at number {number}")
    return np.array(points, np.float64).reshape(-1, 3)


def _is_number(part: Any) -> bool:
    return isinstance(part, (int, float)) and not isinstance(part, bool) and abs(part) < 1e30 and isfinite(part)
