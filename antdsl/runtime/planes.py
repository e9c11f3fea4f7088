"""The plane of its own ground in which an agent sees who is about it: vectors by their parts ahead and to the left."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import Vector
from antdsl.runtime.world import Population

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]


@cache
def _kernels() -> Any:
    from antdsl.runtime import planes_compiled

    return planes_compiled


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """How some agents move: their velocities `own` in space, these and those that they wish by their parts ahead and to the left,
    and how fast (mm/s) each may be, float64."""

    own: Vector
    velocity: tuple[Floats, Floats]
    wish: tuple[Floats, Floats]
    fastest: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The ground of some agents: unit `up`, `ahead` along their heading and `left`, float64."""

    up: Vector
    ahead: Vector
    left: Vector

    @classmethod
    def of(cls, population: Population, rows: Rows, threads: int) -> Plane:
        """That of the agents of some rows, as the step began."""
        up, heading = (vec.named(population.start, name) for name in ("up", "heading"))
        if compiled.wanted(n := len(rows)):
            found = np.empty((3, 3, n))
            compiled.in_parts(partial(_kernels().stand, rows, up, heading, *found), n, threads, compiled.LIGHT)
            return cls(*(tuple(each) for each in found))
        above, along = known(vec.take(up, rows)), known(vec.take(heading, rows))
        ahead = vec.unit(vec.flat(along, above), vec.across(above))
        return cls(above, ahead, vec.cross(above, ahead))

    def moves(self, population: Population, rows: Rows, wish: Vector, threads: int) -> Moves:
        """How these agents move, with the velocities (mm/s) in space that they wish; what is no number is 0."""
        start = population.start
        velocity, speed = vec.named(start, "velocity"), start["max_speed"]
        if compiled.wanted(n := len(rows)):
            wished = tuple(np.ascontiguousarray(component, np.float64) for component in wish)
            own, laid, fastest = np.empty((3, n)), np.empty((4, n)), np.empty(n)
            work = partial(_kernels().move, rows, velocity, speed, wished, self.ahead, self.left, own, laid, fastest)
            compiled.in_parts(work, n, threads, compiled.LIGHT)
            return Moves((own[0], own[1], own[2]), (laid[0], laid[1]), (laid[2], laid[3]), fastest)
        now = known(vec.take(velocity, rows))
        fastest = np.where(speed[rows] > 0, speed[rows], 0).astype(np.float64)
        return Moves(now, self._laid(now), self._laid(known(wish)), np.minimum(fastest, 1e9))

    def _laid(self, vector: Vector) -> tuple[Floats, Floats]:
        """The parts of vectors ahead and to the left."""
        return vec.dot(vector, self.ahead), vec.dot(vector, self.left)

    def raised(self, x: Floats, y: Floats, threads: int) -> tuple[NDArray[np.float32], ...]:
        """Vectors of such parts."""
        if compiled.wanted(n := len(x)):
            made = np.empty((3, n), np.float32)
            compiled.in_parts(partial(_kernels().lift, self.ahead, self.left, x, y, made), n, threads, compiled.LIGHT)
            return tuple(made)
        found = vec.add(vec.scale(self.ahead, x), vec.scale(self.left, y))
        return tuple(component.astype(np.float32) for component in found)


def known(vector: Vector) -> Vector:
    """Vectors in float64, 0 where one is no number."""
    x, y, z = (np.asarray(component, np.float64) for component in vector)
    good = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    return vec.choose(good, (x, y, z), (np.zeros_like(x),) * 3)
