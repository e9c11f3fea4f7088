"""Bodies follow the ground that their feet are on: smoothly, no faster than they turn, and with the head out of what rises before
them.

Feet are exact: their footing and the normal of what they are on (`Population.normal`) change at once, at an edge by any angle.
The body's up and heading are turned towards them step by step, and are what frames hold; programs read and push along the feet's.
Before a wall the body tilts ahead of the feet, a right angle
over about its own length; where it cannot tilt as fast as it walks, the feet wait for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled, elementary
from antdsl.numerics import vectors as vec
from antdsl.numerics.vector_rows import unit
from antdsl.numerics.vectors import Vector, dot, stacked_cross
from antdsl.runtime.moving.rises import Rises, reaches, rises
from antdsl.runtime.world import AXES, Population, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

_F = np.float32
_RIGHT_ANGLE = _F(np.pi / 2)
_LEAST = _F(np.pi / 4)  # rad/s that a body tilts at least: who turns slower still comes round an edge
_OPPOSITE = 0.05  # sine of an angle near half a turn, below which its axis is drowned in rounding: it goes over the head then
WAITING = _F(0.05)  # of a velocity: kept by who waits for its body


@cache
def _kernels() -> Any:
    from antdsl.runtime.moving import tilting_compiled

    return tilting_compiled


def limits(now: dict[str, NDArray[Any]], dt: np.float32) -> NDArray[np.float32]:
    """By what angle (radians) bodies tilt at most in a time: as fast as they turn, and by a right angle while they walk their own
    length at full speed."""
    walking = np.maximum(now["max_speed"], _F(0)) / np.where(now["size"] > 0, now["size"], _F(1)) * _RIGHT_ANGLE
    rate = np.maximum(np.minimum(np.maximum(now["max_turn"], _F(0)), walking), _LEAST)
    most: NDArray[np.float32] = np.where(np.isfinite(rate), rate, _F(np.pi) / dt) * dt
    return most


@dataclass(frozen=True, slots=True)
class Paced:
    """What the bodies of a species are about to do: steps (mm) and velocities, by what angle those may tilt `at_once` that stand
    as their feet do (0 of others, which `follow` turns), and what a walk is told in float64: steps, headings along the ground and
    its up (n, 3), and sizes (mm)."""

    step: Vector
    velocity: Vector
    at_once: NDArray[np.float32]
    wish: Floats
    looking: Floats
    up: Floats
    size: Floats


@dataclass(slots=True)
class Bodies:
    """The bodies of a species as a step begins: `up` and `heading` (3, n) float32 of all, the `most` (radians) that each may
    tilt, who leans (stands otherwise than its feet), and what rises before whom."""

    population: Population
    up: NDArray[np.float32]
    heading: NDArray[np.float32]
    most: NDArray[np.float32]
    leaning: Rows
    rises: Rises
    looking: NDArray[np.float32]  # (3, n): headings laid along the ground that the feet are on

    def paced(self, step: Vector, velocity: Vector) -> Paced:
        """What bodies are about to do, with steps (mm) and velocities such that they can follow."""
        chosen = np.zeros(len(self.most), np.bool_)
        chosen[self.leaning] = True
        chosen[self.rises.rows] = True
        at_once = np.where(chosen, _F(0), self.most)
        rows = np.flatnonzero(chosen)
        if len(rows):
            share = np.ones(len(self.most), np.float64)
            way = np.stack([component[rows] for component in step]).astype(np.float64)
            size = np.sqrt(dot(way, way))
            stood = self.up[:, rows].astype(np.float64)
            normal = self._feet(rows)
            wanted = self.rises.tilted(rows, normal, np.zeros((3, len(rows))))
            free = np.minimum(1.0, 2.0 * np.maximum(dot(stood, wanted), 0.0))  # as a way that leads off the ground by as much
            far = self.rises.room(rows, stood, way / np.maximum(size, 1e-300), self.most[rows].astype(np.float64))
            share[rows] = np.minimum(free, np.clip(far / np.maximum(size, 1e-300), 0.0, 1.0))
            part = share.astype(np.float32)
            step, velocity = vec.scale(step, part), vec.scale(velocity, np.maximum(part, WAITING))
        looking = self.looking.T.astype(np.float64, order="K")
        up = self.population.normal.astype(np.float64)
        return Paced(step, velocity, at_once, vec.rows(step), looking, up, self.population.now["size"].astype(np.float64))

    def follow(self, hasty: NDArray[np.bool_], before: Floats, dt: np.float32) -> None:
        """Turn the bodies of those who lean, would tilt too fast or have something rise before them; all others stand as their
        feet do already. The population's up and heading are those of its feet, which were at places `before` (n, 3)."""
        chosen = hasty.copy()
        chosen[self.leaning] = True
        chosen[self.rises.rows] = True
        rows = np.flatnonzero(chosen)
        if not len(rows):
            return
        now = self.population.now
        stood, ahead = self.up[:, rows].astype(np.float64), self.heading[:, rows].astype(np.float64)
        ahead = _across(ahead, stood)
        normal = np.stack([now[f"up.{axis}"][rows] for axis in AXES]).astype(np.float64)
        looking = np.stack([now[f"heading.{axis}"][rows] for axis in AXES]).astype(np.float64)
        gone = (self.population.position[rows] - before[rows]).T
        wanted = self.rises.tilted(rows, normal, gone)
        most = self.most[rows]
        axis, cosine, sine = _axis(stood, wanted, ahead)
        whole = elementary.atan2(sine.astype(np.float32), cosine.astype(np.float32))
        there = whole <= most
        angle = np.where(there, whole, most)
        c, s = (np.where(there, exact, part) for exact, part in ((cosine, elementary.cos(most)), (sine, elementary.sin(most))))
        up = np.where(there, wanted, unit(_rotated(stood, axis, c, s).T).T)
        one = _across(_rotated(ahead, axis, c, s), up)
        other = _laid(_laid(looking, normal, wanted), wanted, up)
        turn = now["max_turn"][rows]
        room = np.where(np.isfinite(turn), np.maximum(turn, _F(0)) * dt, _F(4)).astype(np.float64)
        room = np.where(np.isfinite(turn), np.sqrt(np.maximum(room * room - angle.astype(np.float64) ** 2, 0.0)), room)
        room = np.minimum(room, 4.0).astype(np.float32)
        left = stacked_cross(up, one)
        yaw = elementary.atan2(dot(left, other).astype(np.float32), dot(one, other).astype(np.float32))
        part = np.sign(yaw) * np.minimum(np.abs(yaw), room)
        facing = np.where(np.abs(yaw) <= room, other, unit((one * elementary.cos(part) + left * elementary.sin(part)).T).T)
        # Who would turn its head into a wall tilts first.
        into = self.rises.clear(rows, up, facing, gone) < np.minimum(self.rises.clear(rows, up, one, gone), 0)
        facing = np.where(into, one, facing)
        for name, value in (("up", up), ("heading", facing)):
            for axis_name, component in zip(AXES, value, strict=True):
                now[f"{name}.{axis_name}"][rows] = component

    def _feet(self, rows: Rows) -> Floats:
        return self.population.normal[rows].T.astype(np.float64)


def bodies(world: World, population: Population, step: Vector, dt: np.float32) -> Bodies:
    """The bodies of a species about to make steps (mm) in a time."""
    now = population.now
    up, heading = (np.stack([now[f"{name}.{axis}"] for axis in AXES]) for name in ("up", "heading"))
    leaning = _leaning(population)
    looking = heading
    if len(leaning):
        looking = heading.copy()
        looking[:, leaning] = _laid_down(leaning, heading, up, population.normal)
    found = rises(world, population, looking, step, reaches(now["size"]))
    return Bodies(population, up, heading, limits(now, dt), leaning, found, looking)


def settle(world: World, population: Population, rows: Rows) -> None:
    """Let the bodies of those who begin stand tilted as far as what rises before them asks, their heads out of it, at once."""
    now, start = population.now, population.start
    looking, rest = np.stack([now[f"heading.{axis}"] for axis in AXES]), np.zeros(len(population), np.float32)
    found = rises(world, population, looking, (rest, rest, rest), reaches(now["size"]))
    who = found.rows
    if not len(who):
        return
    normal = population.normal[who].T.astype(np.float64)
    up = found.tilted(who, normal, np.zeros((3, len(who))))
    heading = _laid(looking[:, who].astype(np.float64), normal, up)
    own = np.isin(who, rows)
    for name, value in (("up", up), ("heading", heading)):
        for axis, component in zip(AXES, value, strict=True):
            now[f"{name}.{axis}"][who[own]] = start[f"{name}.{axis}"][who[own]] = component[own]


def _leaning(population: Population) -> Rows:
    """Rows of those whose body stands otherwise than their feet."""
    normal, now = population.normal, population.now
    return np.flatnonzero((now["up.x"] != normal[:, 0]) | (now["up.y"] != normal[:, 1]) | (now["up.z"] != normal[:, 2]))


def _laid_down(
    rows: Rows, heading: NDArray[np.float32], up: NDArray[np.float32], normal: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Headings (3, k) of some rows, laid from across up (3, n) to across the normal (n, 3) of the ground."""
    return _laid(*(v[:, rows].astype(np.float64) for v in (heading, up, normal.T))).astype(np.float32)


def lay(population: Population, threads: int = 1) -> None:
    """Show programs the heading and up of the feet, along the ground, while a step is made: a push ahead leads on, over whatever
    edge the body tilts just then."""
    start, now = population.start, population.now
    population.laid = None
    if compiled.wanted(n := len(population)):
        (found,), lean = population.room("leaning", 1, (n,), np.int64), population.room("laid", 3, (3, n), np.float32)
        work = partial(_kernels().lay, population.normal, *_registers(start), *_registers(now), found, *lean)
        parts = compiled.in_parts(work, n, threads)
        if any([count for _, count in parts]):
            population.laid = tuple(compiled.joined(parts, found, *lean))
        return
    rows = _leaning(population)
    if not len(rows):
        return
    up, heading = (np.stack([start[f"{name}.{axis}"].take(rows) for axis in AXES]) for name in ("up", "heading"))
    normal = population.normal.take(rows, axis=0)
    population.laid = (rows, up, heading, _laid_down(np.arange(len(rows)), heading, up, normal))
    for name, shown in (("up", normal.T), ("heading", population.laid[3])):
        for axis, component in zip(AXES, shown, strict=True):
            start[f"{name}.{axis}"][rows] = now[f"{name}.{axis}"][rows] = component


def stand_up(population: Population) -> None:
    """Give the bodies back what `lay` took; who has been told another heading has that."""
    if population.laid is None:
        return
    rows, up, heading, along = population.laid
    population.laid = None
    if compiled.wanted(len(population)):
        _kernels().stand_up(rows, up, heading, along, *_registers(population.start), *_registers(population.now))
        return
    told = np.stack([population.now[f"heading.{axis}"][rows] for axis in AXES])
    kept = np.where((told == along).all(axis=0), heading, told)
    for k, axis in enumerate(AXES):
        population.start[f"up.{axis}"][rows] = population.now[f"up.{axis}"][rows] = up[k]
        population.start[f"heading.{axis}"][rows], population.now[f"heading.{axis}"][rows] = heading[k], kept[k]


def _registers(values: dict[str, NDArray[Any]]) -> tuple[Vector, Vector]:
    return vec.named(values, "up"), vec.named(values, "heading")


def _across(v: Floats, up: Floats) -> Floats:
    """Unit vectors (3, n) across `up`, as near to v as can be; some where v says nothing."""
    flat = v - up * dot(v, up)
    size = np.sqrt(dot(flat, flat))
    other = np.stack(vec.across((up[0], up[1], up[2])))
    return np.where(size > 1e-6, flat / np.where(size > 1e-6, size, 1.0), other)


def _axis(one: Floats, other: Floats, ahead: Floats) -> tuple[Floats, Floats, Floats]:
    """Axis of the least turn of one unit vector into another, and the cosine and sine of its angle. Near half a turn, whose axis
    is anywhere, it goes over `ahead`."""
    axis, cosine = stacked_cross(one, other), np.clip(dot(one, other), -1.0, 1.0)
    sine = np.sqrt(dot(axis, axis))
    clear = (sine > _OPPOSITE) | (cosine > 0)
    axis = np.where(clear, axis / np.maximum(sine, 1e-300), unit(stacked_cross(one, ahead).T).T)
    return axis, cosine, sine


def _rotated(v: Floats, axis: Floats, c: Floats, s: Floats) -> Floats:
    """Vectors turned about unit axes by an angle of a cosine and a sine (O. Rodrigues, 1840)."""
    turned: Floats = v * c + stacked_cross(axis, v) * s + axis * (dot(axis, v) * (1.0 - c))
    return turned


def _laid(heading: Floats, one: Floats, other: Floats) -> Floats:
    """Headings across one normal, turned as it is turned into another."""
    axis, cosine, sine = _axis(one, other, heading)
    return _across(_rotated(heading, axis, cosine, sine), other)
