"""Bodies as capsules: where the trunks of all agents are, and how near any two are to each other.

A capsule is a segment along the heading with a radius about it, at the height of the trunk over the feet. Two are measured in the
plane between the ways that both stand, and across it, so that neither a slope nor bodies above each other count as an overlap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.catalogue import CAPSULES, Capsule, body_of
from antdsl.numerics import compiled, elementary, randomness
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import dot
from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.touching import Bounds, Pairs, within_reach

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_SEEN = 1.6  # radii: how far beyond its axis an agent is looked about, more than one since it will yet be moved
_ABOUT = 1.5  # widths that two are apart, up to which they may yet meet
_OPPOSITE = -0.5  # cosine between two ways of standing, below which agents are on two sides of something
_NOWHERE = 1e-6  # of a width: so near each other, two axes give no direction
_SPREAD = 0x9E3779B1  # an odd number, that numbers pairs of ids
_SPECIES = 1 << 40  # more than there are ids of a species


def capsule_of(world: World, species: str) -> Capsule:
    """The room that a body of a species takes: of its own file, else of the first line of the crowd that names one, else of what
    suits its name."""
    own = world.setting.rooms.get(species)
    if own is not None:
        return Capsule(own.length, own.width, own.height, own.ahead)
    for crowd in world.setting.crowds:
        if crowd.species == species and crowd.body:
            return CAPSULES[crowd.body]
    return CAPSULES[body_of(species)]


class Crowd:
    """All agents of a world, species by species, whose properties are read as one array each when they are asked for: as they are
    now, or as they were at the `start` of the step."""

    def __init__(self, world: World, start: bool = False) -> None:
        self.world, self._start = world, start
        self.species = [population for population in world.populations.values() if len(population)]
        self.species = self.species or list(world.populations.values())[:1]  # no agents: arrays of no rows
        self.first = np.array([*accumulate(map(len, self.species), initial=0)], np.intp)
        self._capsules = [capsule_of(world, population.name) for population in self.species]
        self.key = self.of(lambda p: p.ids + k * _SPECIES if (k := self.species.index(p)) else p.ids)
        self.bounds: Bounds | None = None  # of x, y and z of middles and of reaches, where these are known
        if compiled.wanted(len(self)):
            self.bounds = self._measured_fast()
            return
        size = self.of(lambda p: np.maximum(self._registers(p)["size"], np.float32(0))).astype(np.float64)
        self.radius = size * self._shares("width") * 0.5
        self.half = np.maximum(size * self._shares("length") * 0.5 - self.radius, 0.0)
        self.reach = self.half + self.radius * _SEEN
        high, self.ahead = size * self._shares("height"), size * self._shares("ahead")  # of the trunk's middle from the feet, mm
        heading, up = self.vector("heading"), self.vector("up")
        place = self.of(lambda p: p.position)
        self.middle = np.empty((3, len(self)))  # mm
        for k in range(3):
            self.middle[k] = (place[:, k] + up[k] * high) + heading[k] * self.ahead

    def _measured_fast(self) -> Bounds:
        """The same by a loop over each species, with the bounds of all."""
        from antdsl.runtime.moving.capsules_compiled import nothing_seen, trunks

        self.half, self.radius, self.ahead, self.reach = np.empty((4, len(self)))
        self.middle = np.empty((3, len(self)))
        seen, bounds = nothing_seen(), ()
        for population, room, first in zip(self.species, self._capsules, self.first.tolist(), strict=False):
            own = self._registers(population)
            place = np.ascontiguousarray(population.position.T)
            stands = (place, vec.named(own, "heading"), vec.named(own, "up"), own["size"])
            shares = (float(share) for share in (room.length, room.width, room.height, room.ahead))
            capsules = (self.half, self.radius, self.ahead, self.reach, self.middle)
            bounds = trunks(*stands, *shares, first, *capsules, seen)
        return list(zip(bounds[:4], bounds[4:], strict=True))

    def __len__(self) -> int:
        return int(self.first[-1])

    def of(self, read: Callable[[Population], NDArray[Any]], axis: int = 0) -> NDArray[Any]:
        """What is read of each species, one after another along an axis."""
        arrays = [read(population) for population in self.species]
        return arrays[0] if len(arrays) == 1 else np.concatenate(arrays, axis=axis)

    def parts(self, rows: Rows) -> Iterator[tuple[Population, Rows]]:
        """Each species with its own of some rows of the crowd, ascending, counted from its first agent."""
        if len(self.species) == 1:
            yield self.species[0], rows
            return
        bounds, firsts = np.searchsorted(rows, self.first).tolist(), self.first.tolist()
        for population, begin, end, first in zip(self.species, bounds, bounds[1:], firsts, strict=False):
            yield population, rows[begin:end] - first if first else rows[begin:end]

    def vector(self, name: str) -> tuple[NDArray[np.float32], ...]:
        """The three registers of a vector."""
        return tuple(self.of(lambda p, axis=axis: self._registers(p)[f"{name}.{axis}"]) for axis in AXES)  # type: ignore[misc]

    def _registers(self, population: Population) -> dict[str, NDArray[Any]]:
        return population.start if self._start else population.now

    def _shares(self, name: str) -> Floats | float:
        """A number of each capsule, in body lengths: one for all where they have one body."""
        shares = [float(getattr(capsule, name)) for capsule in self._capsules]
        if len(set(shares)) == 1:
            return shares[0]
        return np.repeat(shares, np.diff(self.first))


@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """Pairs of capsules that are near each other. `rows` of the crowd that are in any, ascending; `i` and `j` count these, and
    the first of a pair comes first by species and id. Of each row, as it stood when they were found: `middle`, `ahead` and `up`
    (3, k), `half` and `radius` (k), mm; `widest` is the largest radius of all that are near another. Of each pair, as it was last
    measured: `gap` (m) mm, how far it is from touching, below 0 inside each other, and `way` (3, m), unit vectors from the second
    to the first, the shortest way to part."""

    crowd: Crowd
    rows: Rows
    i: Rows
    j: Rows
    middle: Floats
    ahead: Floats
    up: Floats
    half: Floats
    radius: Floats
    widest: float
    gap: Floats
    way: Floats

    def before(self, walked: Floats) -> tuple[Floats, Floats, Floats]:
        """Gaps and ways of all pairs before rows `walked` (3, k) mm, as these face now, and how deep (k) mm each was in the worst
        of the others."""
        pairs, rows = len(self.i), len(self.rows)
        if compiled.wanted(pairs):
            from antdsl.runtime.moving.capsules_compiled import before

            gap, way, deep, lost = np.empty(pairs), np.empty((3, pairs)), np.empty(rows), np.empty(pairs, np.intp)
            capsules = (self.ahead, self.up, self.half, self.radius)
            count = before(self.middle, walked, *capsules, self.i, self.j, gap, way, deep, lost)
            if count:
                way[:, lost[:count]] = self.measured(-walked, lost[:count])[1]
            return gap, way, deep
        gap, way = self.measured(-walked, np.arange(pairs))
        return gap, way, deepest(rows, self.i, self.j, gap)

    def measure(self, gone: Floats, changed: Flags) -> None:
        """Measure anew the pairs of which a row has `changed` (k), once rows have gone by (3, k) mm."""
        gap, way = self.gap, self.way
        if compiled.wanted(len(self.i)):
            from antdsl.runtime.moving.capsules_compiled import measured

            some, lost = np.empty((2, len(self.i)), np.intp)
            capsules = (self.ahead, self.up, self.half, self.radius)
            count = measured(self.middle, gone, *capsules, self.i, self.j, changed, gap, way, some, lost)
            which = lost[:count]
        else:
            which = np.flatnonzero(changed.take(self.i) | changed.take(self.j))
        if len(which):
            gap[which], way[:, which] = self.measured(gone, which)

    def measured(self, gone: Floats, which: Rows) -> tuple[Floats, Floats]:
        """Gaps and ways of some pairs, once rows have gone by (3, k) mm."""
        return _gaps(self, self.middle + gone, self.i.take(which), self.j.take(which))


def find(crowd: Crowd, dead: float | None = None) -> Near:
    """The pairs of a crowd that may meet; with `dead` only those of which one is deeper in any other than that share of the room
    of two."""
    x, y, z = crowd.middle
    pairs = within_reach((x, y, z), crowd.reach, crowd.key, crowd.bounds)
    if compiled.wanted(len(pairs.i)):
        return _found_fast(crowd, pairs, dead)
    late = crowd.key.take(pairs.i) > crowd.key.take(pairs.j)
    i, j = np.where(late, pairs.j, pairs.i), np.where(late, pairs.i, pairs.j)
    ahead, up = (np.stack(crowd.vector(name)).astype(np.float64) for name in ("heading", "up"))
    number, gap, way = np.arange(len(crowd)), np.empty(len(i)), np.empty((3, len(i)))
    near = Near(crowd, number, i, j, crowd.middle, ahead, up, crowd.half, crowd.radius, 0.0, gap, way)
    gap, way = near.measured(np.zeros_like(crowd.middle), np.arange(len(i)))
    room = crowd.radius.take(i) + crowd.radius.take(j)
    kept = np.flatnonzero(gap < room * _ABOUT)
    widest = max(float(crowd.radius.take(k.take(kept)).max(initial=0.0)) for k in (i, j))
    if dead is not None:
        deep, inside = kept[gap.take(kept) < room.take(kept) * -dead], np.zeros(len(crowd), np.bool_)
        inside[i.take(deep)] = inside[j.take(deep)] = True
        kept = kept[inside.take(i.take(kept)) | inside.take(j.take(kept))]
    rows, i, j = part_of(len(crowd), i.take(kept), j.take(kept))
    middle, ahead, up = (v.take(rows, axis=1) for v in (crowd.middle, ahead, up))
    gap, way = gap.take(kept), way.take(kept, axis=1)
    return Near(crowd, rows, i, j, middle, ahead, up, crowd.half.take(rows), crowd.radius.take(rows), widest, gap, way)


def _found_fast(crowd: Crowd, pairs: Pairs, dead: float | None) -> Near:
    """As `find`, by one loop over all pairs and one over those rows that are in any."""
    from antdsl.runtime.moving.capsules_compiled import gathered, met

    i, j, m = *compiled.plain(pairs.i, pairs.j), len(pairs.i)
    gap, way, known = np.empty(m), np.empty((3, m)), np.empty(m, np.intp)
    rows, number = np.empty((2, len(crowd)), np.intp)
    stand = (crowd.middle, crowd.vector("heading"), crowd.vector("up"), crowd.half, crowd.radius)
    every = (True, 0.0) if dead is None else (False, dead)
    m, count, lost, widest = met(*stand, crowd.key, i, j, gap, way, known, rows, number, *every)
    rows, (middle, ahead, up), (half, radius) = rows[:count], np.empty((3, 3, count)), np.empty((2, count))
    own = (middle, ahead, up, half, radius)
    gathered(rows, *stand, own)
    near = Near(crowd, rows, i[:m], j[:m], *own, widest, gap[:m], np.ascontiguousarray(way[:, :m]))
    if lost:
        near.gap[known[:lost]], near.way[:, known[:lost]] = near.measured(np.zeros_like(middle), known[:lost])
    return near


def depths(world: World) -> Floats:
    """How deep each agent of a crowd (float64[n], species by species) is in the worst of the others, in widths of its own trunk;
    0 apart."""
    crowd = Crowd(world)
    near = find(crowd)
    deep = np.zeros(len(crowd))
    deep[near.rows] = deepest(len(near.rows), near.i, near.j, near.gap) / (2 * near.radius)
    return deep


def deepest(count: int, i: Rows, j: Rows, gap: Floats) -> Floats:
    """How deep (mm) each of so many rows is in the worst of the others, by the gaps of pairs; 0 apart."""
    deep, inside = np.zeros(count), np.flatnonzero(gap < 0)
    for k in (i.take(inside), j.take(inside)):
        np.maximum.at(deep, k, -gap.take(inside))
    return deep


def part_of(count: int, i: Rows, j: Rows) -> tuple[Rows, Rows, Rows]:
    """Which of so many rows are in some pairs, ascending, and the pairs by where these stand among them."""
    there = np.zeros(count, np.bool_)
    there[i] = True
    there[j] = True
    number = np.cumsum(there) - 1
    return np.flatnonzero(there), number.take(i), number.take(j)


def _gaps(near: Near, at: Floats, i: Rows, j: Rows) -> tuple[Floats, Floats]:
    """Gaps and ways of some pairs whose middles are at places (3, k) mm. The nearest points of two segments by C. Ericson,
    Real-Time Collision Detection, 2005, 5.1.9."""
    ahead, up, half, radius = near.ahead, near.up, near.half, near.radius
    one, other = up.take(i, axis=1), up.take(j, axis=1)
    away = at.take(i, axis=1) - at.take(j, axis=1)
    between = one + other
    size = dot(between, between)
    between = between * np.where(dot(one, other) < _OPPOSITE, 0.0, 1 / np.sqrt(np.maximum(size, 1e-12)))
    a, b = ahead.take(i, axis=1), ahead.take(j, axis=1)
    flat = away - between * dot(away, between)
    one, other = a - between * dot(a, between), b - between * dot(b, between)
    reach, length = half.take(i), half.take(j)
    aa, bb, ab = np.maximum(dot(one, one), 1e-9), np.maximum(dot(other, other), 1e-9), dot(one, other)
    c, f = dot(one, flat), dot(other, flat)
    skew = aa * bb - ab * ab
    s = np.where(skew > 1e-9, (ab * f - c * bb) / np.maximum(skew, 1e-9), 0.0)
    s = np.minimum(np.maximum(s, -reach), reach)
    t = (ab * s + f) / bb
    t = np.minimum(np.maximum(t, -length), length)
    s = (ab * t - c) / aa
    s = np.minimum(np.maximum(s, -reach), reach)
    apart = (away + a * s) - b * t
    over = dot(apart, between)
    apart = apart - between * over
    distance = np.sqrt(dot(apart, apart))
    wide = radius.take(i) + radius.take(j)
    room = wide * wide - over * over
    gap = np.where(room > 0, distance - np.sqrt(np.maximum(room, 0.0)), np.inf)
    way = apart / np.maximum(distance, 1e-300)
    lost = np.flatnonzero(distance <= wide * _NOWHERE)
    if len(lost):
        way[:, lost] = _parting(near, flat.take(lost, axis=1), wide.take(lost), i.take(lost), j.take(lost))
    return gap, way


def _parting(near: Near, flat: Floats, wide: Floats, i: Rows, j: Rows) -> Floats:
    """Ways to part of pairs whose axes cross: from middle to middle, and where these are in one place, as drawn."""
    size = np.sqrt(dot(flat, flat))
    way = flat / np.maximum(size, 1e-300)
    same = np.flatnonzero(size <= wide * _NOWHERE)
    if len(same):
        way[:, same] = _drawn(near, i.take(same), j.take(same))
    return way


def _drawn(near: Near, i: Rows, j: Rows) -> Floats:
    """Unit vectors (3, m) along the ground of the first of each pair, by the seed and both ids."""
    crowd = near.crowd
    first, second = (crowd.key.take(near.rows.take(k)) for k in (i, j))
    kinds = (first // _SPECIES) * len(crowd.species) + second // _SPECIES
    turn = np.empty(len(i), np.float32)
    for kind in np.unique(kinds):
        some = np.flatnonzero(kinds == kind)
        one, other = (crowd.species[number].name for number in divmod(int(kind), len(crowd.species)))
        ids = (first[some] % _SPECIES) * _SPREAD + second[some] % _SPECIES
        turn[some] = randomness.uniform(crowd.world.setting.seed, 0, one, f"parts from {other}", 0, ids)
    angle = turn * np.float32(2 * np.pi)
    normal = near.up.take(i, axis=1)
    side = np.stack(vec.across((normal[0], normal[1], normal[2])))
    found: Floats = side * elementary.cos(angle) + vec.stacked_cross(normal, side) * elementary.sin(angle)
    return found
