"""What bodies with skin over bones have in common: swept skin that bends smoothly at its joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from antdsl.bodies.library.modelling import Weights, left
from antdsl.bodies.library.surfaces import Point, Surface, loft, smooth_through

Row = tuple[float, float, float, float, float]  # x, y, z, half its height, half its width


def swept(rows: Sequence[Row], rings: int, sides: int, up: Point = (0.0, 1.0, 0.0), square: float = 1.0) -> Surface:
    """Skin through rows, smooth between them and round at both ends: rings lie closer there."""
    table = np.asarray(rows, np.float64)
    key = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(table[:, :3], axis=0), axis=1))])
    key /= key[-1]
    at = np.linspace(0.0, 1.0, rings)
    at = 0.55 * at + 0.45 * (0.5 - 0.5 * np.cos(np.pi * at))
    if rings <= len(rows):
        at = key[np.round(np.linspace(0, len(rows) - 1, rings)).astype(int)]
    found = smooth_through(table, at, key)
    return loft(found[:, :3], found[:, 3], found[:, 4], sides, up, square)


def places(rows: Sequence[Row], *at: tuple[int, str]) -> Weights:
    """Where along a skin joints are followed wholly: numbers of rows, and the joints."""
    table = np.asarray(rows, np.float64)[:, :3]
    key = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(table, axis=0), axis=1))])
    return [(float(key[row] / key[-1]), joint) for row, joint in at]


def mirrored(joints: Mapping[str, tuple[str, Point]]) -> dict[str, tuple[str, Point]]:
    """Joints with those on the right, whose names have `_r`, on the left as well."""
    made: dict[str, tuple[str, Point]] = {}
    for name, (parent, at) in joints.items():
        made[name] = (parent, at)
        if left(name) != name:
            made[left(name)] = (left(parent), (at[0], at[1], -at[2]))
    return made
