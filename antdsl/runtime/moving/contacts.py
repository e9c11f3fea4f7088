"""Bodies take room: what stands in another after everybody has walked is moved apart, along the surface, all species at once.

Position-based contacts (M. Müller et al., Position Based Dynamics, VRIPHYS 2006, 3.3) in Jacobi sweeps, of which each agent
takes the mean of its contacts (M. Macklin et al., Unified Particle Physics for Real-Time Applications, SIGGRAPH 2014, 4.2). A
sweep adds over pairs exactly, so that no order counts. Two part in shares by their masses.

Nobody is farther from where it stood than it may walk in that time: a step into another is cut and slides along it, and what
stood in each other already parts as fast as it can walk. What is left is measured (`motion_measures`). The surface and
obstacles have the last word. What of its velocity leads into another is taken from an agent, but being pushed gives it none: who
rests would glide on for ever.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Move
from antdsl.numerics import elementary
from antdsl.numerics import vectors as vec
from antdsl.numerics.vector_rows import length
from antdsl.numerics.vectors import dot
from antdsl.runtime.moving.capsules import Crowd, Near, find, part_of
from antdsl.runtime.moving.falling import floating, pushed_in_the_air
from antdsl.runtime.moving.obstacles import slide_some
from antdsl.runtime.world import AXES, Population, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_F = np.float32
_DEAD = 5e-4  # of the room of two: an overlap that nobody is moved for, so that who lies still stays so
_FINE = 40  # digits of a term in a sum, below the widest overlap
_MAGIC = 1.5 * 2.0 ** (52 - _FINE)
_SHARES = 1 << 20  # a share is a multiple of one in so many
_SPREADS = 3  # contacts along which it is told how locked in agents are
_OUTWARD = 10.0  # times the difference of two, by which the outer one makes room
_LEAST = 1 / 64  # of the whole: what the inner one makes room for at least
_EAGER = 1.5  # times the mean of its contacts, by which one in a crowd is moved
_LONGER = 1.005  # times the way allowed, above which a correction is not made: less is the rounding of a seam
_STEEPEST = 0.1  # square of the part of a way that lies along the ground, below which one goes no farther for it
_MISSED = 0.05  # of a radius: who ends so far from where it was to is looked at again
_HELD = 0.5  # of the way it was to go: who comes on by less is held by an obstacle, a border or a fall, and others make the room
_BACK = 3  # times that one is led back which got farther than it may
_SOFT = 0.1  # s, in which two part by the most of their overlap


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is done about overlaps in a substep: `looks` measure pairs anew, each with so many `sweeps`; further `rounds`
    are for those whom the ground led elsewhere, or something held."""

    looks: int
    sweeps: int
    rounds: int


EFFORTS: Mapping[str, Effort] = {"soft": Effort(1, 1, 1), "hard": Effort(4, 3, 3)}


def resolve(world: World, before: Mapping[str, Floats], dt: float) -> None:
    """Move apart who stands in another. `before`: where each species was (n, 3) when the substep began, which took `dt` s."""
    effort = EFFORTS.get(world.setting.contacts)
    crowd = Crowd(world) if effort is not None and len(world) > 1 else None
    if effort is None or crowd is None:
        return
    near = find(crowd)
    if not len(near.i):
        return
    share = 1.0 if world.setting.contacts == "hard" else 1.0 - float(elementary.exp(_F(-dt / _SOFT)))
    which, held = np.arange(len(near.i)), crowd.of(lambda p: p.quarantined).take(near.rows)
    for _ in range(effort.rounds):
        asked = _apart(crowd, near, which, held, before, dt, effort, share)
        some = np.flatnonzero((asked[0] != 0) | (asked[1] != 0) | (asked[2] != 0))
        got = _walked(crowd, near.rows.take(some), asked.take(some, axis=1), before, dt)
        near.middle[:, some] += got
        wanted = asked.take(some, axis=1)
        short = wanted - got
        missed = dot(short, short) > (_MISSED * near.radius.take(some)) ** 2
        if not missed.any():
            break
        held = held.copy()
        held[some[missed & (dot(got, wanted) < _HELD * dot(wanted, wanted))]] = True
        touched = np.zeros(len(held), np.bool_)
        touched[some[missed]] = True
        which = np.flatnonzero(touched.take(near.i) | touched.take(near.j))


def _walked(crowd: Crowd, rows: Rows, gone: Floats, before: Mapping[str, Floats], dt: float) -> Floats:
    """Walk rows of a crowd, ascending, by (3, k) mm each; gives by what they have come on."""
    got = np.zeros_like(gone)
    for number, population in enumerate(crowd.species):
        first, last = np.searchsorted(rows, crowd.first[number : number + 2])
        if last > first:
            own = rows[first:last] - crowd.first[number]
            place = population.position[own]
            _walk(crowd.world, population, own, gone[:, first:last], before[population.name], dt)
            got[:, first:last] = (population.position[own] - place).T
    return got


def _apart(
    crowd: Crowd, near: Near, which: Rows, held: Flags, before: Mapping[str, Floats], dt: float, effort: Effort, share: float
) -> Floats:
    """By what (3, k) mm the rows of `near` are to be moved for some of the pairs; who is `held` is not."""
    rows, i, j = near.rows, near.i, near.j
    start, place = crowd.of(lambda p: before[p.name]), crowd.of(lambda p: p.position)
    speed, mass = crowd.of(lambda p: p.now["max_speed"]), crowd.of(lambda p: p.now["mass"])
    feet = crowd.of(lambda p: p.normal)
    magic = np.ldexp(1.5, int(np.frexp(near.radius.max())[1]) + 1 - _FINE + 52)
    gone = np.zeros((3, len(rows)))
    for _ in range(effort.looks):
        gap, way = near.gaps(gone, which)
        first, second = i.take(which), j.take(which)
        least = (near.radius.take(first) + near.radius.take(second)) * _DEAD
        touching = np.flatnonzero(gap < -least)
        if not len(touching):
            break
        met = np.zeros(len(rows), np.bool_)
        met[first.take(touching)] = True
        met[second.take(touching)] = True
        part = np.flatnonzero(met.take(first) | met.take(second))  # others are not reached by what these are moved in a sweep
        some, first, second = part_of(len(rows), first.take(part), second.take(part))
        who = rows.take(some)
        light = np.where(held.take(some), 0.0, 1 / np.maximum(mass.take(who).astype(np.float64), 1e-30))
        walked = np.ascontiguousarray((place.take(who, axis=0) - start.take(who, axis=0)).T)
        room = np.maximum(np.maximum(speed.take(who), _F(0)).astype(np.float64) * dt, np.sqrt(dot(walked, walked)))
        normal = np.ascontiguousarray(feet.take(who, axis=0).T).astype(np.float64)
        pairs = _Pairs(first, second, gap.take(part), way.take(part, axis=1), least.take(part), light, normal, magic)
        seen = gone.take(some, axis=1)
        led = seen
        for _ in range(effort.sweeps):
            asked = pairs.swept(led - seen, share)
            if asked is None:
                break
            led = _within(led + asked, walked, room)
        gone[:, some] = led
        moved = (gone[0] != 0) | (gone[1] != 0) | (gone[2] != 0)
        which = np.flatnonzero(moved.take(i) | moved.take(j))
    return gone


class _Pairs:
    """Pairs of agents, `i` and `j` of them, as one look found them: gaps and ways to part stay these for its sweeps. All
    that these need is laid out in one row: of the first of each pair, then of the second, axis after axis."""

    def __init__(
        self, i: Rows, j: Rows, gap: Floats, way: Floats, dead: Floats, light: Floats, normal: Floats, magic: float
    ) -> None:
        self._count, self._gap, self._way, self._least, self._magic = len(light), gap, way, -dead, magic
        self._both = np.concatenate([i, j])
        self._along = np.concatenate([self._both, self._both + len(light), self._both + 2 * len(light)])
        ways, normal = np.concatenate([way, -way], axis=1), normal.take(self._both, axis=1)
        ways -= normal * dot(ways, normal)  # along the ground under the feet of each: who is pushed into it makes no room
        self._shares = _shares(i, j, np.where(gap < -dead, -gap, 0.0), light, dot(ways, ways))
        self._ways = ways * (self._shares / np.maximum(dot(ways, ways), _STEEPEST))

    def swept(self, since: Floats, share: float) -> Floats | None:
        """One sweep, when agents have gone by (3, k) mm since the look: what each one's contacts ask of it together (3, k) mm, by
        a share of what is left of their overlaps; None where nobody is in anybody."""
        count, m = self._count, len(self._gap)
        gone = since.take(self._both, axis=1)
        gap = self._gap + dot(self._way, gone[:, :m] - gone[:, m:])
        touching = gap < self._least
        if not touching.any():
            return None
        deep = np.where(touching, gap, 0.0) * -share
        terms = self._ways * np.concatenate([deep, deep])
        terms = (terms + self._magic) - self._magic
        flags = np.concatenate([touching, touching])
        weight = np.bincount(self._both, self._shares * flags, count)
        crowded = np.bincount(self._both, flags, count) > 1
        part = np.where(crowded, _EAGER, 1.0) / np.maximum(weight, 1.0)
        asked: Floats = np.bincount(self._along, terms.ravel(), 3 * count).astype(np.float64).reshape(3, count) * part
        return asked


def _shares(i: Rows, j: Rows, deep: Floats, light: Floats, level: Floats) -> Floats:
    """What of their overlap the first of each pair and then (2 m) the second of each make room for, together 1: the lighter more,
    and the one that is less locked in. `deep`: overlaps, mm; `light`: 1 / mass of each agent, 0 of who is not to be moved;
    `level`: how much of the way to part lies along the ground of each (2 m), squared.

    Locked in is who is deep in others that are deep in others: the overlaps of each, added up along contacts again and again
    (power iteration to the first eigenvector of the contact graph, whose values fall from the middle of a heap to its rim)."""
    count, touch = len(light), deep > 0
    both, far = np.concatenate([i[touch], j[touch]]), np.concatenate([j[touch], i[touch]])
    deep = _rounded(deep[touch] / deep.max())
    locked: Floats = np.bincount(both, np.concatenate([deep, deep]), count).astype(np.float64)
    for _ in range(_SPREADS):
        locked = locked + np.bincount(both, locked.take(far), count)
        locked = _rounded(locked / locked.max())
    first, second = locked.take(i), locked.take(j)
    outer = 0.5 + _OUTWARD * (second - first) / np.maximum(first + second, 1e-300)
    outer = np.minimum(np.maximum(outer, _LEAST), 1 - _LEAST)
    one, other = light.take(i) * outer * level[: len(i)], light.take(j) * (1 - outer) * level[len(i) :]
    total = one + other
    share = np.round(one / np.maximum(total, 1e-300) * _SHARES) / _SHARES
    return np.concatenate([share, np.where(total > 0, 1 - share, 0.0)])


def _rounded(terms: Floats) -> Floats:
    """Numbers up to 1 as multiples of a quantum, of which sums are exact."""
    return (terms + _MAGIC) - _MAGIC


def _within(gone: Floats, walked: Floats, room: Floats) -> Floats:
    """Corrections (3, k) cut so that, with what was `walked` before them, nobody is farther than its `room` from its start."""
    way = walked + gone
    size = np.sqrt(dot(way, way))
    far = np.flatnonzero(size > room)
    if len(far):
        gone[:, far] = way[:, far] * (room[far] / size[far]) - walked[:, far]
    return gone


def _walk(world: World, population: Population, rows: Rows, gone: Floats, before: Floats, dt: float) -> None:
    """Walk some agents by (3, k) mm over their ground, along obstacles; their velocity loses what led against that."""
    now = population.now
    normal = vec.columns(population.normal[rows], np.float32)
    way = (gone[0].astype(_F), gone[1].astype(_F), gone[2].astype(_F))
    way = slide_some(world, population, rows, way, normal)
    start = before[rows]
    most = np.maximum(now["max_speed"][rows].astype(np.float64) * dt, length(population.position[rows] - start))
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
        _put(world, population, rows, moved)


def _put(world: World, population: Population, rows: Rows, moved: Move) -> None:
    """Where corrections have led the feet of some agents. Bodies stay as they stand, or they would be in others again: they
    lean, and the next step turns them after their feet."""
    now = population.now
    pushed, up = vec.columns(moved.position - population.position[rows], np.float32), vec.columns(moved.up, np.float32)
    velocity = vec.take(vec.named(now, "velocity"), rows)
    size, dt = vec.length(pushed), _F(world.dt / world.setting.substeps)
    against = vec.unit(pushed, (size * 0,) * 3)
    back = np.minimum(np.maximum(-vec.dot(velocity, against), _F(0)), size / dt)
    velocity = vec.flat(vec.add(velocity, vec.scale(against, back)), up)
    for name, value in (("position", vec.columns(moved.position, np.float32)), ("velocity", velocity)):
        for axis, component in zip(AXES, value, strict=True):
            now[f"{name}.{axis}"][rows] = component
    footing, position, normals = population.footing.copy(), population.position.copy(), population.normal.copy()
    footing.put(rows, moved.footing)  # a snapshot may have those from before
    position[rows], normals[rows] = moved.position, moved.up
    population.footing, population.position, population.normal = footing, position, normals
