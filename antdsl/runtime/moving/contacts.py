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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled, elementary
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import Vector, dot
from antdsl.runtime.moving import cutting, rounds
from antdsl.runtime.moving.capsules import Crowd, Near, find, part_of
from antdsl.runtime.moving.corrections import Corrections
from antdsl.runtime.world import AXES, PUSHED, World

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
_STEEPEST = 0.1  # square of the part of a way that lies along the ground, below which one goes no farther for it
_HEAP = 0.4  # radii: who was half as deep in another begins to be in a heap, who was one and a half times as deep is
_RESTS = 0.01  # of the way that it may walk: who goes less rests, and presses nobody
_YIELD = 0.3  # of the way that it may walk: how far one that was free is pushed by others in a substep
_SOFT = 0.1  # s, in which two part by the most of their overlap


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is done about overlaps in a substep: `looks` measure pairs anew, each with so many `sweeps`; further `rounds`
    are for those whom the ground led elsewhere, or something held."""

    looks: int
    sweeps: int
    rounds: int

    @property
    def once(self) -> bool:
        """Whether nobody is moved but who is in another as pairs are found."""
        return self.looks == self.sweeps == self.rounds == 1


EFFORTS: Mapping[str, Effort] = {"soft": Effort(1, 1, 1), "hard": Effort(12, 4, 3)}


@dataclass(frozen=True, slots=True, eq=False)
class Stood:
    """How agents stood when a substep began, by species: places (n, 3) mm and, where contacts are hard, headings."""

    places: Mapping[str, Floats]
    headings: Mapping[str, Vector]


def stood(world: World) -> Stood | None:
    """How agents stand now, for `resolve`; None where bodies take no room."""
    if world.setting.contacts == "off":
        return None
    species, headings = world.populations.items(), {}
    if world.setting.contacts == "hard":
        headings = {name: vec.copy(vec.named(population.now, "heading")) for name, population in species}
    return Stood({name: population.position for name, population in species}, headings)


def resolve(world: World, began: Stood, dt: float) -> None:
    """Move apart who stands in another, after a substep that `began` so and took `dt` s."""
    if len(world) < 2:
        return
    effort, crowd = EFFORTS[world.setting.contacts], Crowd(world)
    near = find(crowd, _DEAD if effort.once else None)
    if not len(near.i):
        return
    share = 1.0 if world.setting.contacts == "hard" else 1.0 - float(elementary.exp(_F(-dt / _SOFT)))
    agents, walked = _Agents.of(crowd, near, began, dt)
    gap, way, deep = near.before(walked)
    if world.setting.contacts == "hard":
        cut, stopped, changed = cutting.cut(near, _came(crowd, near.rows, dt), agents.mass, walked, gap, way)
        _face_as_before(crowd, near, stopped, began.headings)
        near.measure(cut, changed)
    else:
        cut = np.zeros_like(near.middle)
    which, held, walking = np.ones(len(near.i), np.bool_), agents.frozen, Corrections(crowd, began.places, dt)
    work = _work(near)
    for left in range(effort.rounds - 1, -1, -1):
        asked = _apart(near, agents, which, held, walked, deep, effort, share, cut, work)
        some, wanted = rounds.led(asked)
        rows = near.rows.take(some)
        got = walking.walk(rows, wanted)
        _note_pushes(crowd, rows, cut, some, wanted, got)
        if not left:
            break
        cut, held = np.zeros_like(cut), held.copy()
        touched = rounds.missed(near, some, wanted, got, held)
        if not touched.any():
            break
        near.measure(cut, touched)
        seen = rounds.visible(near, touched)
        if seen is None:
            break
        which = seen
        at = [population.position[own].T for population, own in crowd.parts(rows)]
        walked[:, some] = (at[0] if len(at) == 1 else np.concatenate(at, axis=1)) - agents.start.take(some, axis=1)


def _came(crowd: Crowd, rows: Rows, dt: float) -> Floats:
    """The way (3, k) mm that rows of a crowd came in a time as long as this substep before it."""
    if compiled.wanted(len(rows)):
        from antdsl.runtime.moving.corrections_compiled import came

        first, way = 0, np.empty((3, len(rows)))
        for population, own in crowd.parts(rows):
            came(own, first, vec.named(population.start, "velocity"), dt, way)
            first += len(own)
        return way
    velocity = (crowd.of(lambda p, axis=axis: p.start[f"velocity.{axis}"]) for axis in AXES)  # type: ignore[misc]
    return np.stack([component.take(rows) * dt for component in velocity]).astype(np.float64)


def _note_pushes(crowd: Crowd, rows: Rows, cut: Floats, some: Rows, asked: Floats, got: Floats) -> None:
    """Add to how far rows of a crowd, ascending, which are `some` of those in pairs, were pushed in this step, where their
    program asks. Of what they were `asked` to go, (3, k) mm, only what others pushed counts, not what their own step was `cut`
    by; and of that what they `got`."""
    if not any(PUSHED in population.now for population in crowd.species):
        return
    pushed = asked - cut.take(some, axis=1)
    short = np.where((pushed == 0).all(axis=0), 0.0, got - (asked - pushed))
    far = np.sqrt(dot(short, short)).astype(_F)
    first = 0
    for population, own in crowd.parts(rows):
        if PUSHED in population.now:
            population.now[PUSHED][own] += far[first : first + len(own)]
        first += len(own)


@dataclass(frozen=True, slots=True, eq=False)
class _Agents:
    """What counts of the rows of pairs in a substep: where they `start`, (3, k) mm; how far they may walk, `reach` (k) mm; their
    `mass`; the share of that to which the others about them can push them, `yields`; the normals (3, k) of the ground under their
    feet; and who is `frozen` by a fault."""

    start: Floats
    reach: Floats
    mass: Floats
    yields: Floats
    normal: Floats
    frozen: Flags

    @staticmethod
    def of(crowd: Crowd, near: Near, began: Stood, dt: float) -> tuple[_Agents, Floats]:
        """These, and by how much (3, k) mm agents are now from where they started."""
        rows = near.rows
        if compiled.wanted(len(rows)):
            start, walked, normal, reach, mass = _stands(crowd, rows, began, dt)
        else:
            start = crowd.of(lambda p: began.places[p.name].T, 1).take(rows, axis=1)
            walked = crowd.of(lambda p: p.position.T, 1).take(rows, axis=1) - start
            normal = crowd.of(lambda p: p.normal.T, 1).take(rows, axis=1).astype(np.float64)
            speed = np.maximum(crowd.of(lambda p: p.now["max_speed"]).take(rows), _F(0))
            reach = speed.astype(np.float64) * dt
            mass = np.maximum(crowd.of(lambda p: p.now["mass"]).take(rows).astype(np.float64), 1e-30)
        yields = np.ones(len(rows))
        if mass.min() < mass.max():  # or the sweeps would push at a heavy one as often as a light one cannot get away
            yields[:] = 0.0
            for k, other in ((near.i, near.j), (near.j, near.i)):
                np.maximum.at(yields, k, cutting.lightness(mass.take(k), mass.take(other)))
        return _Agents(start, reach, mass, yields, normal, crowd.of(lambda p: p.quarantined).take(rows)), walked


def _stands(crowd: Crowd, rows: Rows, began: Stood, dt: float) -> tuple[Floats, ...]:
    """Of rows of a crowd, ascending, where they start, how they have walked and the normals of their ground (3, k), how far they
    may walk, and their masses, by a loop over each species."""
    from antdsl.runtime.moving.corrections_compiled import stands

    vectors, numbers = np.empty((3, 3, len(rows))), np.empty((2, len(rows)))
    first = 0
    for p, own in crowd.parts(rows):
        feet = (began.places[p.name], p.position, p.normal, p.now["max_speed"], p.now["mass"])
        stands(own, first, *feet, dt, *vectors, *numbers)
        first += len(own)
    return *vectors, *numbers


def _work(near: Near) -> tuple[Any, ...] | None:
    """Room for the kernels that part agents; None without kernels."""
    if not compiled.wanted(len(near.i)):
        return None
    from antdsl.runtime.moving.contacts_compiled import arrays

    return arrays(len(near.rows), len(near.i))


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
    work: tuple[Any, ...] | None,
) -> Floats:
    """By what (3, k) mm rows are to be moved for some of the pairs (m), as measured after steps were `cut` by (3, k) mm; who is
    `held` is not moved farther. Rows have `walked` (3, k) mm and were so `deep` (k) mm in others before. `work`: room for
    kernels."""
    magic = np.ldexp(1.5, int(np.frexp(near.widest)[1]) + 1 - _FINE + 52)
    which, gone = which.copy(), cut.copy()
    if work is not None:
        from antdsl.runtime.moving.contacts_compiled import parted

        looks, lost = effort.looks, np.empty(len(near.i), np.intp)
        bodies = (near.middle, near.ahead, near.up, near.half, near.radius)
        pairs = (near.i, near.j, near.gap, near.way, which)
        stand = (agents.mass, agents.yields, agents.reach, deep, held, agents.normal, walked, cut)
        while looks:
            looks, count = parted(bodies, pairs, stand, gone, magic, looks, effort.sweeps, share, lost, work)
            some = lost[:count]
            if count:
                near.gap[some], near.way[:, some] = near.measured(gone, some)
        return gone
    size = np.sqrt(dot(walked, walked))
    most = np.maximum(agents.reach, size)
    room = np.minimum(most * _YIELD + deep, most) * agents.yields
    heap = np.minimum(np.maximum(deep / (near.radius * _HEAP) - 0.5, 0.0), 1.0)
    heap[size <= _RESTS * most] = 1.0
    light = np.where(held, 0.0, 1 / agents.mass)
    least = (near.radius.take(near.i) + near.radius.take(near.j)) * _DEAD
    for left in range(effort.looks - 1, -1, -1):
        before = gone.copy()
        _look(near, which, least, light, heap, agents.normal, walked, most, room, cut, gone, magic, effort.sweeps, share)
        changed = rounds.moved(gone - before)
        if not left or not changed.any():
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
        deep, flags = np.where(touching, gap, 0.0) * -share, np.concatenate([touching, touching])
        terms = np.where(flags, self._ways * np.concatenate([deep, deep]), 0.0)  # who has no mass harms those alone who touch it
        terms = (terms + self._magic) - self._magic
        weight = np.bincount(self._both, np.where(flags, self._shares, 0.0), count)
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
    rows, last = near.rows.take(stopped), 0
    for population, own in crowd.parts(rows):
        first, last = last, last + len(own)
        if compiled.wanted(len(own)):
            from antdsl.runtime.moving.contacts_compiled import faced

            vectors = (facing[population.name], *(vec.named(population.now, name) for name in ("up", "heading")))
            faced(own, stopped[first:last], rows[first:last], *vectors, crowd.ahead, near.ahead, near.middle)
            continue
        up, now = vec.take(vec.named(population.now, "up"), own), vec.take(vec.named(population.now, "heading"), own)
        heading = vec.unit(vec.flat(vec.take(facing[population.name], own), up), now)
        for axis, component in zip(AXES, heading, strict=True):
            population.now[f"heading.{axis}"][own] = component
        turned = near.ahead[:, stopped[first:last]]
        near.ahead[:, stopped[first:last]] = heading
        near.middle[:, stopped[first:last]] += (heading - turned) * crowd.ahead.take(rows[first:last])


def _within(gone: Floats, from_middle: Floats, room: Floats) -> Floats:
    """Corrections (3, k) cut so that nobody ends farther than its `room` from a place that lies `from_middle` before that where
    it walked to."""
    way = from_middle + gone
    size = np.sqrt(dot(way, way))
    far = np.flatnonzero(size > room)
    if len(far):
        gone[:, far] = way[:, far] * (room[far] / size[far]) - from_middle[:, far]
    return gone
