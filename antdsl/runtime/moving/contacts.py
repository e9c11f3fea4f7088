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
from antdsl.runtime.moving.capsules import SLACK, Crowd, Near, find
from antdsl.runtime.moving.obstacles import slide_some
from antdsl.runtime.moving.tilting import limits
from antdsl.runtime.world import AXES, Population, World

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

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
_SOFT = 0.1  # s, in which two part by the most of their overlap


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is done about overlaps in a substep: `looks` measure all pairs anew, each with so many `sweeps`."""

    looks: int
    sweeps: int


EFFORTS: Mapping[str, Effort] = {"soft": Effort(1, 1), "hard": Effort(3, 4)}


def resolve(world: World, before: Mapping[str, Floats], dt: float) -> None:
    """Move apart who stands in another. `before`: where each species was (n, 3) when the substep began, which took `dt` s."""
    world.touching = None
    effort = EFFORTS.get(world.setting.contacts)
    crowd = Crowd(world) if effort is not None and len(world) > 1 else None
    if effort is None or crowd is None:
        return
    near = find(crowd)
    share = 1.0 if world.setting.contacts == "hard" else 1.0 - float(elementary.exp(_F(-dt / _SOFT)))
    gone = _apart(crowd, near, before, dt, effort, share) if len(near.i) else np.zeros((3, 0))
    moved = np.flatnonzero((gone[0] != 0) | (gone[1] != 0) | (gone[2] != 0))
    for number, population in enumerate(crowd.species):
        first, last = np.searchsorted(near.rows.take(moved), crowd.first[number : number + 2])
        some = moved[first:last]
        if len(some):
            rows = near.rows.take(some) - crowd.first[number]
            _walk(world, population, rows, gone.take(some, axis=1), before[population.name], dt)
    if bool((dot(gone, gone) <= (2 * SLACK * near.radius) ** 2).all()):
        world.touching = near  # nobody came near whom it had not been near


def _apart(crowd: Crowd, near: Near, before: Mapping[str, Floats], dt: float, effort: Effort, share: float) -> Floats:
    """By what (3, k) mm the rows of `near` are to be moved."""
    rows, i, j = near.rows, near.i, near.j
    start = crowd.of(lambda p: before[p.name]).take(rows, axis=0)
    walked = np.ascontiguousarray((crowd.of(lambda p: p.position).take(rows, axis=0) - start).T)
    room = np.maximum(crowd.of(lambda p: p.now["max_speed"]).take(rows), _F(0)).astype(np.float64) * dt
    room = np.maximum(room, np.sqrt(dot(walked, walked)))
    mass = crowd.of(lambda p: p.now["mass"]).take(rows).astype(np.float64)
    light = np.where(crowd.of(lambda p: p.quarantined).take(rows), 0.0, 1 / np.maximum(mass, 1e-30))
    dead = (near.radius.take(i) + near.radius.take(j)) * _DEAD
    magic = np.ldexp(1.5, int(np.frexp(near.radius.max())[1]) - _FINE + 52)
    gone = np.zeros((3, len(rows)))
    for _ in range(effort.looks):
        gap, way = near.gaps(gone)
        touching = np.flatnonzero(gap < -dead)
        if not len(touching):
            break
        seen, one, other = gone, *_shares(near, touching, -gap.take(touching), light)
        for _ in range(effort.sweeps):
            since = gone - seen
            now = gap + dot(way, since.take(i, axis=1) - since.take(j, axis=1))
            some = np.flatnonzero(now < -dead)
            if not len(some):
                break
            deep = now.take(some) * -share
            gone = gone + _swept(near, some, deep, way.take(some, axis=1), one.take(some), other.take(some), magic)
            gone = _within(gone, walked, room)
    return gone


def _shares(near: Near, touching: Rows, deep: Floats, light: Floats) -> tuple[Floats, Floats]:
    """What of their overlap the first and the second of each pair make room for, together 1: the lighter more, and the one that
    is less locked in. `deep`: overlaps of the pairs that touch, mm; `light`: 1 / mass, 0 of who is not to be moved.

    Locked in is who is deep in others that are deep in others: the overlaps of each, added up along contacts again and again
    (power iteration to the first eigenvector of the contact graph, whose values fall from the middle of a heap to its rim)."""
    i, j, count = near.i.take(touching), near.j.take(touching), len(near.rows)
    part = _rounded(deep / deep.max())
    locked = np.bincount(i, part, count) + np.bincount(j, part, count)
    for _ in range(_SPREADS):
        locked = locked + (np.bincount(i, locked.take(j), count) + np.bincount(j, locked.take(i), count))
        locked = _rounded(locked / locked.max())
    first, second = locked.take(near.i), locked.take(near.j)
    outer = 0.5 + _OUTWARD * (second - first) / np.maximum(first + second, 1e-300)
    outer = np.minimum(np.maximum(outer, _LEAST), 1 - _LEAST)
    one, other = light.take(near.i) * outer, light.take(near.j) * (1 - outer)
    both = one + other
    share = np.round(one / np.maximum(both, 1e-300) * _SHARES) / _SHARES
    return share, np.where(both > 0, 1 - share, 0.0)


def _rounded(terms: Floats) -> Floats:
    """Numbers up to 1 as multiples of a quantum, of which sums are exact."""
    return (terms + _MAGIC) - _MAGIC


def _swept(near: Near, some: Rows, deep: Floats, way: Floats, one: Floats, other: Floats, magic: float) -> Floats:
    """One sweep over pairs that are so deep in each other: what (3, k) mm each agent's contacts ask of it together."""
    count = len(near.rows)
    i, j = near.i.take(some), near.j.take(some)
    weight = np.bincount(i, one, count) + np.bincount(j, other, count)
    contacts = np.bincount(i, minlength=count) + np.bincount(j, minlength=count)
    part = np.where(contacts > 1, _EAGER, 1.0) / np.maximum(weight, 1.0)
    asked = np.empty((3, count))
    for axis in range(3):
        first, second = way[axis] * (deep * one), way[axis] * (deep * other)
        first, second = (first + magic) - magic, (second + magic) - magic
        asked[axis] = (np.bincount(i, first, count) - np.bincount(j, second, count)) * part
    asked -= near.up * dot(asked, near.up)
    return asked


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
    moved = world.ground.move(
        population.footing.take(rows),
        vec.rows(way),
        vec.rows(vec.take(vec.named(now, "heading"), rows)),
        vec.rows(normal),
        now["size"][rows].astype(np.float64),
        world.options.threads,
    )
    start = before[rows]
    most = np.maximum(now["max_speed"][rows].astype(np.float64) * dt, length(population.position[rows] - start))
    fair = np.flatnonzero(length(moved.position - start) <= most * _LONGER)
    if len(fair) < len(rows):
        rows, moved = rows[fair], moved.take(fair)
    if len(rows):
        _put(world, population, rows, moved)


def _put(world: World, population: Population, rows: Rows, moved: Move) -> None:
    """Where corrections have led some agents. Bodies turn with the ground as far as they may in a step; else they lean, and the
    steps that come turn them."""
    now, start = population.now, population.start
    pushed = vec.columns(moved.position - population.position[rows], np.float32)
    up, heading = vec.columns(moved.up, np.float32), vec.columns(moved.heading, np.float32)
    velocity = vec.take(vec.named(now, "velocity"), rows)
    dt = _F(world.dt / world.setting.substeps)
    size = vec.length(pushed)
    against = vec.unit(pushed, (size * 0,) * 3)
    back = np.minimum(np.maximum(-vec.dot(velocity, against), _F(0)), size / dt)
    velocity = vec.flat(vec.add(velocity, vec.scale(against, back)), up)
    upright = vec.take(vec.named(now, "up"), rows)
    lean = vec.sub(upright, vec.columns(population.normal[rows], np.float32))
    tilt = vec.sub(up, vec.take(vec.named(start, "up"), rows))
    most = limits({name: now[name][rows] for name in ("max_speed", "size", "max_turn")}, _F(world.dt))
    stands = (vec.dot(lean, lean) == 0) & (vec.dot(tilt, tilt) <= most * most)
    turned = {"up": vec.choose(stands, up, upright)}
    turned["heading"] = vec.choose(stands, heading, vec.take(vec.named(now, "heading"), rows))
    for name, value in (("position", vec.columns(moved.position, np.float32)), ("velocity", velocity), *turned.items()):
        for axis, component in zip(AXES, value, strict=True):
            now[f"{name}.{axis}"][rows] = component
    footing, position, normals = population.footing.copy(), population.position.copy(), population.normal.copy()
    footing.put(rows, moved.footing)  # a snapshot may have those from before
    position[rows], normals[rows] = moved.position, moved.up
    population.footing, population.position, population.normal = footing, position, normals
