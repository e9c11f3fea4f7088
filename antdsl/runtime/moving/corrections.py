"""Walks that contacts ask for: agents are led over their ground, along obstacles, no farther than they may walk in that time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Move
from antdsl.numerics import compiled
from antdsl.numerics import vectors as vec
from antdsl.numerics.vector_rows import length
from antdsl.numerics.vectors import Columns, Vector
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
        self._crowd, self._began, self._dt = crowd, began, dt

    def walk(self, rows: Rows, gone: Floats) -> Floats:
        """Walk rows of the crowd, ascending, by (3, k) mm each; gives by what they have come on."""
        got: list[Floats] = []
        for population, own in self._crowd.parts(rows):
            first = sum(each.shape[1] for each in got)
            got.append(self._walk(population, own, gone[:, first : first + len(own)]))
        return got[0] if len(got) == 1 else np.concatenate(got, axis=1)

    def _walk(self, population: Population, rows: Rows, gone: Floats) -> Floats:
        """Walk some agents by (3, k) mm over their ground, along obstacles; their velocity loses what led against that. Gives by
        what they have come on."""
        if not len(rows):
            return np.empty_like(gone)
        world, threads = self._crowd.world, self._crowd.world.options.threads
        way, normal, up, heading, size = self._asked(population, rows, gone)
        way = slide_some(world, population, rows, way, normal)
        moved = world.ground.move(population.footing.take(rows), vec.rows(way), heading, up, size, threads)
        if world.solids and len(some := floating(world, population, rows)):
            moved.put(some, pushed_in_the_air(world, population, rows[some], gone.T[some]))
        fair = self._allowed(population, rows, moved, size)
        if fair is None:
            return self._put(population, rows, moved)
        got = np.zeros_like(gone)
        if len(fair):
            got[:, fair] = self._put(population, rows.take(fair), moved.take(fair))
        return got

    def _asked(self, population: Population, rows: Rows, gone: Floats) -> tuple[Vector, Columns, Floats, Floats, Floats]:
        """What a walk by (3, k) mm is told of some agents: the way and the normal of the ground, float32, the same normal and
        headings, float64 (k, 3), and sizes (mm)."""
        now = population.now
        if compiled.wanted(len(rows)):
            from antdsl.runtime.moving.corrections_compiled import asked

            step, feet = np.empty((2, 3, len(rows)), np.float32)
            up, heading, size = *np.empty((2, 3, len(rows))), np.empty(len(rows))
            asked(rows, gone, population.normal, vec.named(now, "heading"), now["size"], step, feet, up, heading, size)
            return (step[0], step[1], step[2]), feet, up.T, heading.T, size
        normal = vec.columns(population.normal[rows], np.float32)
        way = (gone[0].astype(_F), gone[1].astype(_F), gone[2].astype(_F))
        heading = vec.rows(vec.take(vec.named(now, "heading"), rows))
        return way, normal, vec.rows(normal), heading, now["size"][rows].astype(np.float64)

    def _allowed(self, population: Population, rows: Rows, moved: Move, size: Floats) -> Rows | None:
        """Let those of some agents whom ground that bends led farther than they may walk go back towards the start by as much.
        Says which of them (their numbers among these, ascending) are then not too far; None for all."""
        for _ in range(_BACK):
            far, most = self._reached(population, rows, moved)
            if far is None:
                return None
            over = np.flatnonzero(far > most * _LONGER)
            if not len(over):
                break
            start = self._began[population.name][rows[over]]
            back = (moved.position[over] - start) * (most[over] / far[over] - 1.0)[:, None]
            again, ground = moved.take(over), self._crowd.world.ground
            threads = self._crowd.world.options.threads
            moved.put(over, ground.move(again.footing, back, again.heading, again.up, size[over], threads))
        far, most = self._reached(population, rows, moved)
        return None if far is None else np.flatnonzero(far <= most * _LONGER)

    def _reached(self, population: Population, rows: Rows, moved: Move) -> tuple[Floats | None, Floats]:
        """How far (mm) from where some agents began they would get, None where nobody gets farther than it may, and how far they
        may."""
        began, max_speed = self._began[population.name], population.now["max_speed"]
        if compiled.wanted(len(rows)):
            from antdsl.runtime.moving.corrections_compiled import too_far

            far, most = np.empty((2, len(rows)))
            found = too_far(rows, moved.position, began, population.position, max_speed, self._dt, far, most)
            return (far if found else None), most
        start = began[rows]
        most = np.maximum(max_speed[rows].astype(np.float64) * self._dt, length(population.position[rows] - start))
        far = length(moved.position - start)
        return (None if (far <= most * _LONGER).all() else far), most

    def _put(self, population: Population, rows: Rows, moved: Move) -> Floats:
        """Where corrections have led the feet of some agents; gives by what (3, k) mm. Bodies stay as they stand, or they would
        be in others again: they lean, and the next step turns them after their feet. The footings, places and normals written to
        are those that the substep's own walk has made, which nobody else has."""
        if compiled.wanted(len(rows)):
            from antdsl.runtime.moving.corrections_compiled import arrived

            at, velocity = (vec.named(population.now, name) for name in ("position", "velocity"))
            got = np.empty((3, len(rows)))
            arrived(rows, moved.position, moved.up, self._dt, at, velocity, population.position, population.normal, got)
        else:
            got = self._arrive(population, rows, moved)
        population.footing.put(rows, moved.footing)  # at last, since a plane's footings are the places themselves
        return got

    def _arrive(self, population: Population, rows: Rows, moved: Move) -> Floats:
        """As `_put`, of all but footings."""
        now = population.now
        got = moved.position - population.position[rows]
        pushed, up = vec.columns(got, np.float32), vec.columns(moved.up, np.float32)
        velocity = vec.take(vec.named(now, "velocity"), rows)
        size, dt = vec.length(pushed), _F(self._dt)
        against = vec.unit(pushed, (size * 0,) * 3)
        back = np.minimum(np.maximum(-vec.dot(velocity, against), _F(0)), size / dt)
        velocity = vec.flat(vec.add(velocity, vec.scale(against, back)), up)
        for name, value in (("position", vec.columns(moved.position, np.float32)), ("velocity", velocity)):
            for axis, component in zip(AXES, value, strict=True):
                now[f"{name}.{axis}"][rows] = component
        population.position[rows], population.normal[rows] = moved.position, moved.up
        return got.T
