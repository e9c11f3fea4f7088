"""Walks that contacts ask for: agents are led over their ground, along obstacles, no farther than they may walk in that time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Move
from antdsl.numerics import vectors as vec
from antdsl.numerics.vector_rows import length
from antdsl.runtime.moving.capsules import Crowd
from antdsl.runtime.moving.falling import floating, pushed_in_the_air
from antdsl.runtime.moving.obstacles import slide_some
from antdsl.runtime.world import AXES, Population

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

_F = np.float32
_LONGER = 1.005  # times the way allowed, above which a correction is not made: less is the rounding of a seam
_BACK = 3  # times that one is led back which got farther than it may


class Corrections:
    """Walks of agents of a crowd in one substep, which took `dt` s and `began` with species at places (n, 3) mm."""

    def __init__(self, crowd: Crowd, began: Mapping[str, Floats], dt: float) -> None:
        self._crowd, self._began, self._dt, self._own = crowd, began, dt, set[str]()

    def walk(self, rows: Rows, gone: Floats) -> Floats:
        """Walk rows of the crowd, ascending, by (3, k) mm each; gives by what they have come on."""
        got = np.zeros_like(gone)
        for number, population in enumerate(self._crowd.species):
            first, last = np.searchsorted(rows, self._crowd.first[number : number + 2])
            if last > first:
                own = rows[first:last] - self._crowd.first[number]
                place = population.position[own]
                self._walk(population, own, gone[:, first:last])
                got[:, first:last] = (population.position[own] - place).T
        return got

    def _walk(self, population: Population, rows: Rows, gone: Floats) -> None:
        """Walk some agents by (3, k) mm over their ground, along obstacles; their velocity loses what led against that."""
        world, now = self._crowd.world, population.now
        normal = vec.columns(population.normal[rows], np.float32)
        way = (gone[0].astype(_F), gone[1].astype(_F), gone[2].astype(_F))
        way = slide_some(world, population, rows, way, normal)
        start = self._began[population.name][rows]
        most = np.maximum(now["max_speed"][rows].astype(np.float64) * self._dt, length(population.position[rows] - start))
        size, heading = now["size"][rows].astype(np.float64), vec.rows(vec.take(vec.named(now, "heading"), rows))
        threads = world.options.threads
        moved = world.ground.move(population.footing.take(rows), vec.rows(way), heading, vec.rows(normal), size, threads)
        if world.solids and len(some := floating(world, population, rows)):
            moved.put(some, pushed_in_the_air(world, population, rows[some], gone.T[some]))
        for _ in range(_BACK):  # ground that bends may lead farther than the plane: back towards the start by as much
            way_there = moved.position - start
            far = length(way_there)
            over = np.flatnonzero(far > most * _LONGER)
            if not len(over):
                break
            back = way_there[over] * (most[over] / far[over] - 1.0)[:, None]
            again = moved.take(over)
            moved.put(over, world.ground.move(again.footing, back, again.heading, again.up, size[over], threads))
        fair = np.flatnonzero(length(moved.position - start) <= most * _LONGER)
        if len(fair) < len(rows):
            rows, moved = rows[fair], moved.take(fair)
        if len(rows):
            self._put(population, rows, moved)

    def _put(self, population: Population, rows: Rows, moved: Move) -> None:
        """Where corrections have led the feet of some agents. Bodies stay as they stand, or they would be in others again: they
        lean, and the next step turns them after their feet."""
        now = population.now
        pushed, up = vec.columns(moved.position - population.position[rows], np.float32), vec.columns(moved.up, np.float32)
        velocity = vec.take(vec.named(now, "velocity"), rows)
        size, dt = vec.length(pushed), _F(self._dt)
        against = vec.unit(pushed, (size * 0,) * 3)
        back = np.minimum(np.maximum(-vec.dot(velocity, against), _F(0)), size / dt)
        velocity = vec.flat(vec.add(velocity, vec.scale(against, back)), up)
        for name, value in (("position", vec.columns(moved.position, np.float32)), ("velocity", velocity)):
            for axis, component in zip(AXES, value, strict=True):
                now[f"{name}.{axis}"][rows] = component
        if population.name not in self._own:  # a snapshot may have those from before
            self._own.add(population.name)
            population.footing, population.position = population.footing.copy(), population.position.copy()
            population.normal = population.normal.copy()
        population.footing.put(rows, moved.footing)
        population.position[rows], population.normal[rows] = moved.position, moved.up
