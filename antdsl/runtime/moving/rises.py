"""What rises before agents: a wall of the ground that the next steps lead onto, and how far a body is tilted for it by then."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Meshes
from antdsl.numerics import elementary
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import Vector, dot, stacked_cross
from antdsl.runtime.moving.headings import FACE
from antdsl.runtime.moving.heads import RAISED
from antdsl.runtime.world import Population, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

_STEEP = 0.7071067811865476  # cosine of the least turn of the ground that is a wall; less is smooth, or a slope
_EYE = 0.03  # of a body: how high above the feet a ray looks for walls
_ASIDE = 0.97  # cosine of the angle between look and way above which one ray tells of both
_FEW = 512  # agents for whom there is always room
WIDEST = 3.0  # half bodies before a wall within which a body tilts, at most


@dataclass(frozen=True, slots=True, eq=False)
class Rises:
    """Walls before some agents (`rows`): normals `wall` (3, k) on their side, the `angle` (radians) by which the ground turns
    into it, how `far` along their way (`ahead`) feet are from it, the way `over` which the body tilts, `half` its length, mm."""

    rows: Rows
    wall: Floats
    ahead: Floats
    angle: Floats
    far: Floats
    over: Floats
    half: Floats

    @staticmethod
    @cache
    def none() -> Rises:
        return Rises(np.empty(0, np.intp), np.empty((3, 0)), np.empty((3, 0)), *np.empty((4, 0)))

    def take(self, which: Rows) -> Rises:
        """Some of the walls."""
        wall, ahead = self.wall[:, which], self.ahead[:, which]
        return Rises(self.rows[which], wall, ahead, self.angle[which], self.far[which], self.over[which], self.half[which])

    def tilted(self, rows: Rows, normal: Floats, gone: Floats) -> Floats:
        """How bodies of `rows` (ascending, all of the own among them) should stand on ground of a normal (3, m), when they have
        `gone` (3, m) mm: as it does, or before a wall tilted towards that of the wall."""
        found = normal.copy()
        if not len(self.rows):
            return found
        at = np.searchsorted(rows, self.rows)
        n = normal[:, at]
        part = np.clip(1.0 - (self.far - self._nearer(gone[:, at])) / self.over, 0.0, 1.0) * self.angle
        axis, cosine = stacked_cross(n, self.wall), dot(n, self.wall)
        sine = np.sqrt(dot(axis, axis))
        left = elementary.atan2(sine.astype(np.float32), cosine.astype(np.float32)).astype(np.float64)
        part = np.minimum(part, left).astype(np.float32)
        side = stacked_cross(axis / np.maximum(sine, 1e-300), n)
        turned = n * elementary.cos(part) + side * elementary.sin(part)
        turned /= np.sqrt(dot(turned, turned))
        tilts = (part > 0) & (sine > 1e-6)
        found[:, at] = np.where(tilts, turned, n)
        return found

    def _nearer(self, gone: Floats) -> Floats:
        """By how much less ways lead along `ahead` to the wall from a place as far from the first as vectors (3, k) say."""
        less: Floats = dot(gone, self.wall) / np.minimum(dot(self.ahead, self.wall), -1e-3)
        return less

    def clear(self, rows: Rows, up: Floats, heading: Floats, gone: Floats) -> Floats:
        """How far (mm) heads of `rows` are before the wall, less than 0 behind it, of bodies that stand and face so (3, m)
        and have `gone` (3, m) mm; inf without one."""
        found = np.full(len(rows), np.inf)
        if len(self.rows):
            at = np.searchsorted(rows, self.rows)
            middle = up[:, at] * (2 * RAISED * self.half) + self.ahead * (self._nearer(gone[:, at]) - self.far)
            found[at] = dot(middle + heading[:, at] * self.half, self.wall)
        return found

    def room(self, rows: Rows, up: Floats, way: Floats, most: Floats) -> Floats:
        """How far (mm) feet of `rows` may go in directions (3, m) while the body, which stands as `up`, tilts by `most`."""
        found = np.full(len(rows), np.inf)
        if not len(self.rows):
            return found
        at = np.searchsorted(rows, self.rows)
        u, towards = up[:, at], self._nearer(way[:, at])
        across = stacked_cross(u, self.wall)
        left = elementary.atan2(np.sqrt(dot(across, across)).astype(np.float32), dot(u, self.wall).astype(np.float32))
        tilt = self.angle - left.astype(np.float64) + most[at]
        free = np.maximum(self.over * (tilt / self.angle - 1.0) + self.far, 0.0)
        found[at] = np.where(towards > 0.05, free / np.maximum(towards, 0.05), np.inf)
        return found


@cache
def _kernels() -> Any:
    from antdsl.runtime.moving import rises_compiled

    return rises_compiled


def reaches(size: NDArray[np.float32]) -> tuple[Floats, Floats]:
    """Half of bodies' sizes (mm), 0 of what is none, and how far before it they look out for walls."""
    long = np.maximum(size, np.float32(0)).astype(np.float64)
    half = np.where(np.isfinite(long), long / 2, 0.0)
    return half, WIDEST * half


def rises(
    world: World,
    population: Population,
    looking: NDArray[np.float32],
    step: Vector,
    lengths: tuple[Floats, Floats],
) -> Rises:
    """What rises before whom who looks along `looking` (3, n) over its ground and is about to make a step (mm): of what lies in
    the two directions that for which it has to tilt further. Of those who face a way of their own, who walks backward has no head
    where it goes. `lengths` are `reaches`.

    The body of length L tilts over a way of L before a wall, linearly: so its head, L/2 before its feet, keeps out of a wall that
    rises by up to a right angle, and of one that hangs over if the way is longer by angle / sine."""
    meshes = world.ground.meshes
    if meshes is None:
        return Rises.none()
    half, reach = lengths
    rows = meshes.rising(population.footing, population.position, reach, world.options.threads)
    if not len(rows):
        return Rises.none()
    faced = _faced(population.now)
    half, normal, look = half[rows], population.normal[rows].T.astype(np.float64), looking[:, rows].astype(np.float64)
    way = np.stack([component[rows] for component in step]).astype(np.float64)
    way -= normal * dot(way, normal)
    size = np.sqrt(dot(way, way))
    way = np.where(size > 1e-9, way / np.maximum(size, 1e-300), look)
    same = dot(way, look)
    aside = np.flatnonzero((same < _ASIDE) if faced is None else (same < _ASIDE) & ((same >= 0) | ~faced[rows]))
    which = np.concatenate([np.arange(len(rows)), aside])
    ahead = np.concatenate([look, way.take(aside, axis=1)], axis=1)
    place = population.position[rows[which]].T
    found = _seen(meshes, world.options.threads, rows[which], place, ahead, normal[:, which], half[which], size[which])
    if not len(found.rows):
        return found
    tilt = (1.0 - found.far / found.over) * found.angle
    order = np.lexsort((-tilt, found.rows))
    first = order[np.unique(found.rows[order], return_index=True)[1]]
    return found.take(first)


def _faced(now: dict[str, NDArray[Any]]) -> NDArray[np.bool_] | None:
    """Who faces a way of its own, and may walk backward; None where nobody can."""
    if FACE not in now:
        return None
    found: NDArray[np.bool_] = (now["~face.x"] != 0) | (now["~face.y"] != 0) | (now["~face.z"] != 0)
    return found


def rises_by_kernels(
    world: World, population: Population, looking: Vector, step: Vector, reach: Floats, state: NDArray[np.int32]
) -> Rises:
    """As `rises`, to the same bits, of those who look out as far as `reach` (mm): in their `state` they get the number of their
    wall. `looking` has the headings of those alone who lean, and gets those of all who look out."""
    meshes = world.ground.meshes
    if meshes is None:
        return Rises.none()
    rows = meshes.rising(population.footing, population.position, reach, world.options.threads)
    if not len(rows):
        return Rises.none()
    kernels, now, most = (
        _kernels(),
        population.now,
        max(_FEW, 1 << len(rows).bit_length()),
    )  # the same room while about as many look out
    (which,) = population.room("looks", 1, (2 * most,), np.int64)
    halves, sizes = population.room("sizes", 2, (2 * most,), np.float64)
    ahead, normal, origin, ray = population.room("ways", 4, (3, 2 * most), np.float64)
    looks = (which, halves, sizes, ahead, normal)
    face, heading = vec.named(now, "~face") if FACE in now else step, vec.named(now, "heading")
    ways = (heading, looking, state, step, FACE in now, face)
    count = kernels.look(rows, now["size"], population.position, population.normal, *ways, looks, origin, ray)
    hit, part, wall = meshes.faced(origin[:, :count].T, ray[:, :count].T, world.options.threads)
    if not len(hit):
        return Rises.none()
    own, lengths, found, along = np.empty(len(hit), np.int64), np.empty((4, len(hit))), *np.empty((2, 3, len(hit)))
    count = kernels.walls(len(rows), looks, hit, part, wall, own, found, along, *lengths, state)
    return Rises(own[:count], found[:, :count], along[:, :count], *lengths[:, :count])


def _seen(
    meshes: Meshes, threads: int, rows: Rows, place: Floats, ahead: Floats, normal: Floats, half: Floats, step: Floats
) -> Rises:
    """Walls that rays along `ahead` (3, k) meet from just above the ground, so near that the body tilts within a `step` (mm)."""
    high, reach = 2 * _EYE * half, WIDEST * half
    hit, part, wall = meshes.faced((place + normal * high).T, (ahead * reach).T, threads)
    rows, half, step, high, reach = rows.take(hit), half.take(hit), step.take(hit), high.take(hit), reach.take(hit)
    ahead, normal = ahead.take(hit, axis=1), normal.take(hit, axis=1)
    wall = np.where(dot(wall, ahead) > 0, -wall, wall)
    cosine, across = dot(normal, wall), stacked_cross(normal, wall)
    sine = np.maximum(np.sqrt(dot(across, across)), 1e-6)
    angle = elementary.atan2(sine.astype(np.float32), cosine.astype(np.float32)).astype(np.float64)
    over = half * np.clip(angle / sine, 2.0, WIDEST)
    far = np.maximum(part * reach - high * cosine / sine, 0.0)
    who = np.flatnonzero((cosine < _STEEP) & (far < over + 2 * step))
    return Rises(rows[who], wall[:, who], ahead[:, who], angle[who], far[who], over[who], half[who])
