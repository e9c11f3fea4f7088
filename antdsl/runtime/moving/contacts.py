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
from antdsl.numerics.vectors import Vector, dot
from antdsl.runtime.moving.capsules import Crowd, Near, find, part_of
from antdsl.runtime.moving.falling import floating, pushed_in_the_air
from antdsl.runtime.moving.obstacles import slide_some
from antdsl.runtime.world import AXES, PUSHED, Population, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_F = np.float32
_DEAD = 5e-4  # of the room of two: an overlap that nobody is moved for, so that who lies still stays so
_FINE = 40  # digits of a term in a sum, below the widest overlap
_MAGIC = 1.5 * 2.0 ** (52 - _FINE)
_SHARES = 1 << 20  # a share is a multiple of one in so many
_SPREADS = 3  # contacts along which it is told how locked in agents are
_OUTWARD = 10.0  # times the difference of two, by which the outer one makes room in a heap
_PRESSED = 1.0  # the same among those who are hardly in each other: there a crowd that presses must not be thrown about
_LEAST = 1 / 64  # of the whole: what the inner one makes room for at least
_EAGER = 1.5  # times the mean of its contacts, by which one in a heap is moved
_LONGER = 1.005  # times the way allowed, above which a correction is not made: less is the rounding of a seam
_STEEPEST = 0.1  # square of the part of a way that lies along the ground, below which one goes no farther for it
_MISSED = 0.05  # of a radius: who ends so far from where it was to is looked at again
_HELD = 0.5  # of the way it was to go: who comes on by less is held by an obstacle, a border or a fall, and others make the room
_GOES = 0.5  # of its way: who goes less is stopped
_BENDS = 3  # times that a step is bent along those in its way, before it is cut
_HEAP = 0.4  # radii: who was half as deep in another begins to be in a heap, who was one and a half times as deep is
_RESTS = 0.01  # of the way that it may walk: who goes less rests, and presses nobody
_YIELD = 0.3  # of the way that it may walk: how far one that was free is pushed by others in a substep
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


@dataclass(frozen=True, slots=True, eq=False)
class Stood:
    """How agents stood when a substep began, by species: places (n, 3) mm and headings."""

    places: Mapping[str, Floats]
    headings: Mapping[str, Vector]


def stood(world: World) -> Stood | None:
    """How agents stand now, for `resolve`; None where bodies take no room."""
    if world.setting.contacts == "off":
        return None
    species = world.populations.items()
    headings = {name: vec.copy(vec.named(population.now, "heading")) for name, population in species}
    return Stood({name: population.position for name, population in species}, headings)


def resolve(world: World, began: Stood, dt: float) -> None:
    """Move apart who stands in another, after a substep that `began` so and took `dt` s."""
    if len(world) < 2:
        return
    effort, before, crowd = EFFORTS[world.setting.contacts], began.places, Crowd(world)
    near = find(crowd)
    if not len(near.i):
        return
    share = 1.0 if world.setting.contacts == "hard" else 1.0 - float(elementary.exp(_F(-dt / _SOFT)))
    which, held = np.arange(len(near.i)), crowd.of(lambda p: p.quarantined).take(near.rows)
    cut = np.zeros_like(near.middle)
    if world.setting.contacts == "hard":
        cut, stopped = _cut(crowd, near, before, dt)
        _face_as_before(crowd, near, stopped, began.headings)
    for _ in range(effort.rounds):
        asked = _apart(crowd, near, which, held, before, dt, effort, share, cut)
        pushed, cut = asked - cut, np.zeros_like(cut)
        some = np.flatnonzero((asked[0] != 0) | (asked[1] != 0) | (asked[2] != 0))
        got = _walked(crowd, near.rows.take(some), asked.take(some, axis=1), before, dt)
        near.middle[:, some] += got
        _note_pushes(crowd, near.rows.take(some), pushed.take(some, axis=1), asked.take(some, axis=1), got)
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


def _note_pushes(crowd: Crowd, rows: Rows, pushed: Floats, asked: Floats, got: Floats) -> None:
    """Add to how far rows of a crowd, ascending, were pushed in this step, where their program asks. Of what they were `asked` to
    go, (3, k) mm, only what others `pushed` counts, not what their own step was cut by; and of that what they `got`."""
    short = np.where((pushed == 0).all(axis=0), 0.0, got - (asked - pushed))
    far = np.sqrt(dot(short, short)).astype(_F)
    for number, population in enumerate(crowd.species):
        if PUSHED in population.now:
            first, last = np.searchsorted(rows, crowd.first[number : number + 2])
            population.now[PUSHED][rows[first:last] - crowd.first[number]] += far[first:last]


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
    crowd: Crowd,
    near: Near,
    which: Rows,
    held: Flags,
    before: Mapping[str, Floats],
    dt: float,
    effort: Effort,
    share: float,
    cut: Floats,
) -> Floats:
    """By what (3, k) mm the rows of `near` are to be moved for some of the pairs, with what their steps were `cut` by (3, k) mm;
    who is `held` is not moved farther."""
    rows, i, j = near.rows, near.i, near.j
    start, place = crowd.of(lambda p: before[p.name]), crowd.of(lambda p: p.position)
    speed, mass = crowd.of(lambda p: p.now["max_speed"]), crowd.of(lambda p: p.now["mass"])
    feet = crowd.of(lambda p: p.normal)
    magic = np.ldexp(1.5, int(np.frexp(near.radius.max())[1]) + 1 - _FINE + 52)
    gone = cut.copy()
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
        most = np.maximum(np.maximum(speed.take(who), _F(0)).astype(np.float64) * dt, np.sqrt(dot(walked, walked)))
        deep = _before(near, some, first, second, walked)
        room = np.minimum(most * _YIELD + deep, most)
        heap = np.minimum(np.maximum(deep / (near.radius.take(some) * _HEAP) - 0.5, 0.0), 1.0)
        heap[dot(walked, walked) <= (_RESTS * most) ** 2] = 1.0
        normal = np.ascontiguousarray(feet.take(who, axis=0).T).astype(np.float64)
        pairs = _Pairs(first, second, gap.take(part), way.take(part, axis=1), least.take(part), light, heap, normal, magic)
        seen = gone.take(some, axis=1)
        led = seen
        for _ in range(effort.sweeps):
            asked = pairs.swept(led - seen, share)
            if asked is None:
                break
            led = _within(led + asked, -cut.take(some, axis=1), room)
            led = _within(led, walked, most)
        gone[:, some] = led
        moved = (gone[0] != 0) | (gone[1] != 0) | (gone[2] != 0)
        which = np.flatnonzero(moved.take(i) | moved.take(j))
    return gone


class _Pairs:
    """Pairs of agents, `i` and `j` of them, as one look found them: gaps and ways to part stay these for its sweeps. All
    that these need is laid out in one row: of the first of each pair, then of the second, axis after axis."""

    def __init__(
        self, i: Rows, j: Rows, gap: Floats, way: Floats, dead: Floats, light: Floats, heap: Floats, normal: Floats, magic: float
    ) -> None:
        self._count, self._gap, self._way, self._least, self._magic = len(light), gap, way, -dead, magic
        self._both = np.concatenate([i, j])
        self._along = np.concatenate([self._both, self._both + len(light), self._both + 2 * len(light)])
        ways, normal = np.concatenate([way, -way], axis=1), normal.take(self._both, axis=1)
        ways -= normal * dot(ways, normal)  # along the ground under the feet of each: who is pushed into it makes no room
        self._shares = _shares(i, j, np.where(gap < -dead, -gap, 0.0), light, heap, dot(ways, ways))
        self._eager = 1 + (_EAGER - 1) * heap
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
        part = np.where(crowded, self._eager, 1.0) / np.maximum(weight, 1.0)
        asked: Floats = np.bincount(self._along, terms.ravel(), 3 * count).astype(np.float64).reshape(3, count) * part
        return asked


def _shares(i: Rows, j: Rows, deep: Floats, light: Floats, heap: Floats, level: Floats) -> Floats:
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
    outward = _PRESSED + (_OUTWARD - _PRESSED) * np.maximum(heap.take(i), heap.take(j))
    outer = 0.5 + outward * (second - first) / np.maximum(first + second, 1e-300)
    outer = np.minimum(np.maximum(outer, _LEAST), 1 - _LEAST)
    one, other = light.take(i) * outer * level[: len(i)], light.take(j) * (1 - outer) * level[len(i) :]
    total = one + other
    share = np.round(one / np.maximum(total, 1e-300) * _SHARES) / _SHARES
    return np.concatenate([share, np.where(total > 0, 1 - share, 0.0)])


def _rounded(terms: Floats) -> Floats:
    """Numbers up to 1 as multiples of a quantum, of which sums are exact."""
    return (terms + _MAGIC) - _MAGIC


def _face_as_before(crowd: Crowd, near: Near, stopped: Rows, facing: Mapping[str, Vector]) -> None:
    """Let some of the rows of `near` face as before the substep: who cannot go cannot turn either, between others."""
    rows = near.rows.take(stopped)
    for number, population in enumerate(crowd.species):
        first, last = np.searchsorted(rows, crowd.first[number : number + 2])
        own = rows[first:last] - crowd.first[number]
        up, now = vec.take(vec.named(population.now, "up"), own), vec.take(vec.named(population.now, "heading"), own)
        heading = vec.unit(vec.flat(vec.take(facing[population.name], own), up), now)
        for axis, component in zip(AXES, heading, strict=True):
            population.now[f"heading.{axis}"][own] = component
        near.ahead[:, stopped[first:last]] = heading


def _cut(crowd: Crowd, near: Near, before: Mapping[str, Floats], dt: float) -> tuple[Floats, Rows]:
    """By what (3, k) mm steps of the rows of `near` are cut and bent so that nobody enters another, and who goes less than half
    of its way.

    As in J. van den Berg et al., Reciprocal n-Body Collision Avoidance, 2011, each agent by itself keeps to half-planes: towards
    each other one it goes no farther than half of the gap, and than what that one withdraws if it goes on as it came. What all
    share in is so found without anybody waiting for others, and a crowd that presses stands still. Of two masses the heavier is
    cut less."""
    rows = near.rows
    gap, _ = near.gaps()
    which = np.flatnonzero(gap < near.radius.take(near.i) + near.radius.take(near.j))
    gone = np.zeros_like(near.middle)
    if not len(which):
        return gone, which
    some, i, j = part_of(len(rows), near.i.take(which), near.j.take(which))
    who = rows.take(some)
    start, place = crowd.of(lambda p: before[p.name]).take(who, axis=0), crowd.of(lambda p: p.position).take(who, axis=0)
    walked = np.ascontiguousarray((place - start).T)
    came = [crowd.of(lambda p, axis=axis: p.start[f"velocity.{axis}"]).take(who) * dt for axis in AXES]  # type: ignore[misc]
    gone[:, some] = -walked
    gap, way = near.between(near.middle + gone, near.i.take(which), near.j.take(which))
    both, other = np.concatenate([i, j]), np.concatenate([j, i])
    ways = np.concatenate([way, -way], axis=1)
    free = np.maximum(gap, 0.0) * 0.5
    free = np.concatenate([free, free]) + np.maximum(-dot(ways, np.stack(came).astype(np.float64).take(other, axis=1)), 0.0)
    mass = np.maximum(crowd.of(lambda p: p.now["mass"]).take(who).astype(np.float64), 1e-30)
    heavier = 1 - np.minimum(2 * mass.take(other) / (mass.take(both) + mass.take(other)), 1.0)
    free += heavier * np.maximum(-dot(ways, walked.take(both, axis=1)) - free, 0.0)
    along = np.concatenate([both, both + len(some), both + 2 * len(some)])
    magic = np.ldexp(1.5, int(np.frexp(max(np.abs(walked).max(), 1e-30))[1]) + 2 - _FINE + 52)
    step = walked
    for _ in range(_BENDS):
        over = -dot(ways, step.take(both, axis=1)) - free
        into = over > 0
        if not into.any():
            break
        terms = ways * np.where(into, over, 0.0)
        terms = (terms + magic) - magic
        count = np.maximum(np.bincount(both, into, len(some)), 1)
        step = step + np.bincount(along, terms.ravel(), 3 * len(some)).reshape(3, -1) / count
    towards = -dot(ways, step.take(both, axis=1))
    part = np.ones(len(some))
    np.minimum.at(part, both, np.where(towards > free, free / np.maximum(towards, 1e-300), 1.0))
    step = step * part
    gone[:, some] = step - walked
    return gone, some[dot(step, step) < _GOES**2 * dot(walked, walked)]


def _before(near: Near, some: Rows, i: Rows, j: Rows, walked: Floats) -> Floats:
    """How deep (k) mm agents were in others, as these face now, before they `walked` (3, k)."""
    gone = np.zeros_like(near.middle)
    gone[:, some] = -walked
    gap = near.between(near.middle + gone, some.take(i), some.take(j))[0]
    deep = np.zeros(len(some))
    inside = np.flatnonzero(gap < 0)
    for k in (i.take(inside), j.take(inside)):
        np.maximum.at(deep, k, -gap.take(inside))
    return deep


def _within(gone: Floats, from_middle: Floats, room: Floats) -> Floats:
    """Corrections (3, k) cut so that nobody ends farther than its `room` from a place that lies `from_middle` before that where
    it walked to."""
    way = from_middle + gone
    size = np.sqrt(dot(way, way))
    far = np.flatnonzero(size > room)
    if len(far):
        gone[:, far] = way[:, far] * (room[far] / size[far]) - from_middle[:, far]
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
