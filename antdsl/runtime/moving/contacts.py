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
from antdsl.numerics import compiled, elementary
from antdsl.numerics import vectors as vec
from antdsl.numerics.vector_rows import length
from antdsl.numerics.vectors import Vector, dot
from antdsl.runtime.moving.capsules import Crowd, Near, deepest, find, part_of
from antdsl.runtime.moving.falling import floating, pushed_in_the_air
from antdsl.runtime.moving.obstacles import slide_some
from antdsl.runtime.world import AXES, Population, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_F = np.float32
_DEAD = 5e-4  # of the room of two: an overlap that nobody is moved for, so that who lies still stays so
_SEEN = 0.05  # of the room of two: an overlap for which more is walked
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


EFFORTS: Mapping[str, Effort] = {"soft": Effort(1, 1, 1), "hard": Effort(12, 4, 3)}


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
    effort, crowd = EFFORTS[world.setting.contacts], Crowd(world)
    near = find(crowd)
    if not len(near.i):
        return
    share = 1.0 if world.setting.contacts == "hard" else 1.0 - float(elementary.exp(_F(-dt / _SOFT)))
    agents = _Agents.of(crowd, near, began, dt)
    cut, walked = np.zeros_like(near.middle), agents.walked(crowd, near.rows)
    gap, way = near.before(walked)
    deep = deepest(len(near.rows), near.i, near.j, gap)
    if world.setting.contacts == "hard":
        cut, stopped = _cut(near, agents, walked, gap, way)
        _face_as_before(crowd, near, stopped, began.headings)
        changed = _moved(cut)
        changed[stopped] = True
        near.measure(cut, changed)
    visible = (near.radius.take(near.i) + near.radius.take(near.j)) * _SEEN
    which, held, walking = np.ones(len(near.i), np.bool_), agents.frozen, _Walking(crowd, began, dt)
    for _ in range(effort.rounds):
        asked = _apart(near, agents, which, held, walked, deep, effort, share, cut)
        cut = np.zeros_like(cut)
        some = np.flatnonzero(_moved(asked))
        wanted = asked.take(some, axis=1)
        got = walking.walk(near.rows.take(some), wanted)
        near.middle[:, some] += got
        short = wanted - got
        missed = dot(short, short) > (_MISSED * near.radius.take(some)) ** 2
        if not missed.any():
            break
        held = held.copy()
        held[some[missed & (dot(got, wanted) < _HELD * dot(wanted, wanted))]] = True
        touched = np.zeros(len(held), np.bool_)
        touched[some[missed]] = True
        which = touched.take(near.i) | touched.take(near.j)
        near.measure(cut, touched)
        if not (which & (near.gap < -visible)).any():
            break
        walked = agents.walked(crowd, near.rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Agents:
    """What counts of the rows of pairs in a substep: where they `start` and how they `came`, their way in a substep before this
    one, (3, k) mm; how far they may walk, `reach` (k) mm; `mass`; the share of that to which the others about them can push them,
    `yields`; the normals (3, k) of the ground under their feet; and who is `frozen` by a fault."""

    start: Floats
    came: Floats
    reach: Floats
    mass: Floats
    yields: Floats | float
    normal: Floats
    frozen: Flags

    @staticmethod
    def of(crowd: Crowd, near: Near, began: Stood, dt: float) -> _Agents:
        rows = near.rows
        start, normal = crowd.of(lambda p: began.places[p.name]), crowd.of(lambda p: p.normal)
        came = np.stack([crowd.of(lambda p, axis=axis: p.start[f"velocity.{axis}"]).take(rows) * dt for axis in AXES])  # type: ignore[misc]
        speed = np.maximum(crowd.of(lambda p: p.now["max_speed"]).take(rows), _F(0))
        mass = np.maximum(crowd.of(lambda p: p.now["mass"]).take(rows).astype(np.float64), 1e-30)
        yields: Floats | float = 1.0
        if mass.min() < mass.max():  # or the sweeps would push at a heavy one as often as a light one cannot get away
            yields = np.zeros(len(rows))
            for k, other in ((near.i, near.j), (near.j, near.i)):
                np.maximum.at(yields, k, _lightness(mass.take(k), mass.take(other)))
        return _Agents(
            np.ascontiguousarray(start.take(rows, axis=0).T),
            came.astype(np.float64),
            speed.astype(np.float64) * dt,
            mass,
            yields,
            np.ascontiguousarray(normal.take(rows, axis=0).T).astype(np.float64),
            crowd.of(lambda p: p.quarantined).take(rows),
        )

    def walked(self, crowd: Crowd, rows: Rows) -> Floats:
        """By how much (3, k) mm agents are now from where they started."""
        return np.ascontiguousarray(crowd.of(lambda p: p.position).take(rows, axis=0).T) - self.start


def _lightness(mass: Floats, other: Floats) -> Floats:
    """Up to which share of an even one those of a mass make room for others, 1 for the lighter."""
    share: Floats = np.minimum(2 * other / (mass + other), 1.0)
    return share


def _moved(gone: Floats) -> Flags:
    """Who goes (3, k) anywhere."""
    moved: Flags = (gone[0] != 0) | (gone[1] != 0) | (gone[2] != 0)
    return moved


def _apart(
    near: Near,
    agents: _Agents,
    which: Flags,
    held: Flags,
    walked: Floats,
    deep: Floats,
    effort: Effort,
    share: float,
    cut: Floats,
) -> Floats:
    """By what (3, k) mm rows are to be moved for some of the pairs (m), as measured after steps were `cut` by (3, k) mm; who is
    `held` is not moved farther. Rows have `walked` (3, k) mm and were so `deep` (k) mm in others before."""
    size = np.sqrt(dot(walked, walked))
    most = np.maximum(agents.reach, size)
    room = np.minimum(most * _YIELD + deep, most) * agents.yields
    heap = np.minimum(np.maximum(deep / (near.radius * _HEAP) - 0.5, 0.0), 1.0)
    heap[size <= _RESTS * most] = 1.0
    light = np.where(held, 0.0, 1 / agents.mass)
    least = (near.radius.take(near.i) + near.radius.take(near.j)) * _DEAD
    magic = np.ldexp(1.5, int(np.frexp(near.radius.max())[1]) + 1 - _FINE + 52)
    which, gone, looks = which.copy(), cut.copy(), effort.looks
    if compiled.wanted(len(near.i)):
        from antdsl.runtime.moving.contacts_compiled import parted

        lost = np.empty(len(near.i), np.intp)
        capsules = (near.middle, near.ahead, near.up, near.half, near.radius, near.i, near.j, near.gap, near.way)
        limits = (light, heap, agents.normal, walked, most, room, cut, gone)
        while looks:
            looks, count = parted(*capsules, which, *limits, magic, looks, effort.sweeps, share, lost)
            some = lost[:count]
            near.gap[some], near.way[:, some] = near.measured(gone, some)
        return gone
    for _ in range(looks):
        before = gone.copy()
        _look(near, which, least, light, heap, agents.normal, walked, most, room, cut, gone, magic, effort.sweeps, share)
        changed = _moved(gone - before)
        if not changed.any():
            break
        near.measure(gone, changed)
        which |= changed.take(near.i) | changed.take(near.j)
    return gone


def _look(
    near: Near,
    which: Flags,
    least: Floats,
    light: Floats,
    heap: Floats,
    normal: Floats,
    walked: Floats,
    most: Floats,
    room: Floats,
    cut: Floats,
    gone: Floats,
    magic: float,
    sweeps: int,
    share: float,
) -> None:
    """Change by what (3, k) rows are `gone`, for some pairs (m) as they were last measured; overlaps of less than the `least` (m)
    do not count."""
    count = len(near.rows)
    touching = np.flatnonzero(which & (near.gap < -least))
    if not len(touching):
        return
    met = np.zeros(count, np.bool_)
    met[near.i.take(touching)] = True
    met[near.j.take(touching)] = True
    part = np.flatnonzero(
        which & (met.take(near.i) | met.take(near.j))
    )  # others are not reached by what these are moved in a sweep
    some, i, j = part_of(count, near.i.take(part), near.j.take(part))
    light, heap, normal, walked = light.take(some), heap.take(some), normal.take(some, axis=1), walked.take(some, axis=1)
    pairs = _Pairs(i, j, near.gap.take(part), near.way.take(part, axis=1), least.take(part), light, heap, normal, magic)
    seen, most, room, back = gone.take(some, axis=1), most.take(some), room.take(some), -cut.take(some, axis=1)
    led = seen
    for _ in range(sweeps):
        asked = pairs.swept(led - seen, share)
        if asked is None:
            break
        led = _within(led + asked, back, room)
        led = _within(led, walked, most)
    gone[:, some] = led


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
        turned = near.ahead[:, stopped[first:last]]
        near.ahead[:, stopped[first:last]] = heading
        near.middle[:, stopped[first:last]] += (heading - turned) * crowd.ahead.take(rows[first:last])


def _cut(near: Near, agents: _Agents, walked: Floats, gap: Floats, way: Floats) -> tuple[Floats, Rows]:
    """By what (3, k) mm steps of rows that `walked` (3, k) mm are cut and bent so that nobody enters another, and who goes less
    than half of its way. `gap` (m) and `way` (3, m) of pairs are those from before the steps.

    As in J. van den Berg et al., Reciprocal n-Body Collision Avoidance, 2011, each agent by itself keeps to half-planes: towards
    each other one it goes no farther than half of the gap, and than what that one withdraws if it goes on as it came. What all
    share in is so found without anybody waiting for others, and a crowd that presses stands still. Of two masses the heavier is
    cut less."""
    magic = np.ldexp(1.5, int(np.frexp(max(np.abs(walked).max(), 1e-30))[1]) + 2 - _FINE + 52)
    step = _bent(near, _free(near, agents, walked, gap, way), walked, way, magic)
    return step - walked, np.flatnonzero(dot(step, step) < _GOES**2 * dot(walked, walked))


def _free(near: Near, agents: _Agents, walked: Floats, gap: Floats, way: Floats) -> Floats:
    """How far (2 m) mm the first and then the second of each pair may go towards the other."""
    both, other = np.concatenate([near.i, near.j]), np.concatenate([near.j, near.i])
    ways = np.concatenate([way, -way], axis=1)
    free = np.maximum(gap, 0.0) * 0.5
    free = np.concatenate([free, free]) + np.maximum(-dot(ways, agents.came.take(other, axis=1)), 0.0)
    heavier = 1 - _lightness(agents.mass.take(both), agents.mass.take(other))
    if heavier.any():
        free += heavier * np.maximum(-dot(ways, walked.take(both, axis=1)) - free, 0.0)
    found: Floats = free
    return found


def _bent(near: Near, free: Floats, walked: Floats, way: Floats, magic: float) -> Floats:
    """Steps (3, k) mm of rows that `walked` so, of which what leads farther towards another than is `free` (2 m) is left out, one
    half-plane after the other, and at last what yet does is cut."""
    i, j, count = near.i, near.j, len(near.rows)
    if compiled.wanted(len(i)):
        from antdsl.runtime.moving.contacts_compiled import bent

        step = np.empty_like(walked)
        bent(i, j, way, free, walked, magic, step)
        return step
    both, ways = np.concatenate([i, j]), np.concatenate([way, -way], axis=1)
    along = np.concatenate([both, both + count, both + 2 * count])
    step = walked
    for _ in range(_BENDS):
        over = -dot(ways, step.take(both, axis=1)) - free
        into = over > 0
        if not into.any():
            break
        terms = ways * np.where(into, over, 0.0)
        terms = (terms + magic) - magic
        met = np.maximum(np.bincount(both, into, count), 1)
        step = step + np.bincount(along, terms.ravel(), 3 * count).reshape(3, -1) / met
    towards = -dot(ways, step.take(both, axis=1))
    part = np.ones(count)
    np.minimum.at(part, both, np.where(towards > free, free / np.maximum(towards, 1e-300), 1.0))
    step = step * part
    return step


def _within(gone: Floats, from_middle: Floats, room: Floats) -> Floats:
    """Corrections (3, k) cut so that nobody ends farther than its `room` from a place that lies `from_middle` before that where
    it walked to."""
    way = from_middle + gone
    size = np.sqrt(dot(way, way))
    far = np.flatnonzero(size > room)
    if len(far):
        gone[:, far] = way[:, far] * (room[far] / size[far]) - from_middle[:, far]
    return gone


class _Walking:
    """Walks that corrections ask of a crowd in one substep, which `began` so."""

    def __init__(self, crowd: Crowd, began: Stood, dt: float) -> None:
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
        start = self._began.places[population.name][rows]
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
