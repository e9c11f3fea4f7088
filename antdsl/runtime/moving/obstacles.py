"""Obstacles are hard: a step that would bring an agent's centre into one is shortened, and what is left of it slides along."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.numerics import compiled
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import Columns, Vector
from antdsl.runtime.moving.obstacle_clearance import clearance, may_touch
from antdsl.runtime.world import Population, World

_F = np.float32
_BIT = _F(1e-6)  # more than rounding makes a way shorter
_MARGIN = _F(0.5)  # of the radius: how near the centre comes to a face that it walks into


@cache
def _kernels() -> Any:
    from antdsl.runtime.moving import obstacles_compiled

    return obstacles_compiled


def slide(world: World, population: Population, step: Vector, up: Columns, radius: NDArray[np.float32]) -> Vector:
    """The step (mm) of every agent, bent along the obstacles in its way; up is the ground's."""
    names = _names(world)
    if names:
        place, began = vec.named(population.now, "position"), _where_they_were(population, world.options.threads)
    for name in names:
        scene = mesh_of(world, name)
        clear = clearance(world, population, name) if began else scene.clearance(*place)
        step = _along(scene, place, step, up, radius, clear, world.options.threads)
    return step


def slide_some(world: World, population: Population, rows: NDArray[np.intp], step: Vector, up: Columns) -> Vector:
    """As `slide`, of some agents alone, from where they are now in a step that began elsewhere."""
    names = _names(world)
    if names:
        place, radius, gone = _strayed(population, rows)
    for name in names:
        clear = clearance(world, population, name).take(rows) - gone
        step = _along(mesh_of(world, name), place, step, up, radius, clear, world.options.threads)
    return step


def _strayed(population: Population, rows: NDArray[np.intp]) -> tuple[Vector, NDArray[np.float32], NDArray[np.float32]]:
    """Where some agents are now, their radii, and how far (mm) they are at most from where the step began."""
    places, start = (vec.named(registers, "position") for registers in (population.now, population.start))
    if compiled.wanted(len(rows)):
        place, radius, gone = np.empty((3, len(rows)), np.float32), *np.empty((2, len(rows)), np.float32)
        _kernels().strayed(rows, places, start, population.now["radius"], place, radius, gone)
        return (place[0], place[1], place[2]), radius, gone
    at = vec.take(places, rows)
    gone = vec.length(vec.sub(at, vec.take(start, rows))) * (1 + _BIT)
    return at, population.now["radius"][rows], gone


def _names(world: World) -> list[str]:
    """Obstacles that there are."""
    return [name for name in world.plan.of_kind("obstacle") if name in world.obstacles]


def mesh_of(world: World, name: str) -> RayScene:
    """An obstacle that nobody walks through; solids are none."""
    scene = world.obstacles[name]
    assert isinstance(scene, RayScene)
    return scene


def _where_they_were(population: Population, threads: int) -> bool:
    """Whether everybody is still where the step began; not so after a first substep."""
    now, start = vec.named(population.now, "position"), vec.named(population.start, "position")
    if compiled.wanted(len(population)):
        return all(compiled.in_parts(partial(_kernels().same, now, start), len(population), threads, compiled.LIGHT))
    return all((one == other).all() for one, other in zip(now, start, strict=True))


def _along(
    scene: RayScene,
    place: Vector,
    step: Vector,
    up: Columns,
    radius: NDArray[np.float32],
    clear: NDArray[np.float32],
    threads: int,
) -> Vector:
    if compiled.wanted(len(radius)):
        return _along_fast(scene, place, step, up, radius, clear, threads)
    size, margin = vec.length(step), np.maximum(radius, _F(0)) * _MARGIN
    near = np.flatnonzero((size > _F(1e-9)) & may_touch(clear, size + margin))
    if not len(near):
        return step
    place, up, clear = vec.take(place, near), vec.take(up, near), clear[near]
    return _put(step, near, _bent(scene, place, vec.take(step, near), up, size[near], margin[near], clear, threads))


def _put(step: Vector, rows: NDArray[np.intp], own: Vector) -> Vector:
    """Steps, of some rows others."""
    result = vec.copy(step)
    for component, value in zip(result, own, strict=True):
        component[rows] = value
    return result


def _along_fast(
    scene: RayScene,
    place: Vector,
    step: Vector,
    up: Columns,
    radius: NDArray[np.float32],
    clear: NDArray[np.float32],
    threads: int,
) -> Vector:
    """As `_along`, to the same bits, by kernels."""
    kernels, n = _kernels(), len(radius)
    tables = scene.tables()
    if tables is not None:
        (rows, met), found, faces = np.empty((2, n), np.int64), np.empty((10, n), np.float32), np.empty((4, n), np.float32)
        normals = np.stack(up) if isinstance(up, tuple) else up
        work = partial(kernels.along, tables, place, step, normals, radius, clear, rows, found, met, faces)
        parts = compiled.in_parts(work, n, threads, compiled.LIGHT)
        if not any([left for _, _, _, left in parts]):
            return _turned(scene, step, rows, found, met, faces, parts, threads)
    rows, found = np.empty(n, np.int64), np.empty((9, n), np.float32)
    parts = compiled.in_parts(partial(kernels.touching, place, step, radius, clear, rows, found), n, threads)
    rows, found = compiled.joined(parts, rows, found)
    count, found = len(rows), np.ascontiguousarray(found)
    if not count:
        return step
    above = vec.take(up, rows)
    size, margin, _, x, y, z, _, _, _ = found
    gap, out = scene.apart(x, y, z, size + margin, threads)
    bent, going, rays = np.empty((3, count), np.float32), np.empty(count, np.int64), np.empty((9, count), np.float32)
    asking = kernels.kept_off(found, above, gap, out, bent, going, rays)
    a, b, c = bent
    if asking:
        px, py, pz, dx, dy, dz, reach, size, margin = rays[:, :asking]
        hits = scene.feelers(px, py, pz, dx, dy, dz, reach, threads=threads)
        met = np.flatnonzero(hits.hit)
        if len(met):
            free, normal = np.clip(hits.t[met] - margin[met], _F(0), size[met]), (hits.nx[met], hits.ny[met], hits.nz[met])
            _turn_aside(scene, (x, y, z), (a, b, c), above, found[1], going[met], free, normal, threads)
    return _put(step, rows, (a, b, c))


def _turned(
    scene: RayScene,
    step: Vector,
    rows: NDArray[np.int64],
    found: NDArray[np.float32],
    met: NDArray[np.int64],
    hits: NDArray[np.float32],
    parts: list[tuple[int, int, int, int]],
    threads: int,
) -> Vector:
    """Steps, of those whom the kernel `along` has found bent ones, of those who have met a face turned aside from that."""
    rows, found = compiled.joined(parts, rows, found)
    if not len(rows):
        return step
    met, hits = compiled.joined([(begin, hit) for begin, _, hit, _ in parts], met, hits)
    if len(met):
        if len(parts) > 1:  # each part counts its own
            counts = [count for _, count, _, _ in parts]
            met = met + np.repeat(np.cumsum(counts) - counts, [hit for _, _, hit, _ in parts])
        free, *normal = hits
        place, bent, above = (found[k : k + 3] for k in (0, 3, 6))
        _turn_aside(scene, place, bent, above, found[9], met, free, (normal[0], normal[1], normal[2]), threads)
    to = np.empty((3, len(step[0])), np.float32)
    _kernels().put(step, rows, found[3:6], to)
    return to[0], to[1], to[2]


def _bent(
    scene: RayScene,
    place: Vector,
    step: Vector,
    up: Columns,
    size: NDArray[np.float32],
    margin: NDArray[np.float32],
    clear: NDArray[np.float32],
    threads: int,
) -> Vector:
    """The steps of those who may touch the obstacle; `size` is their length."""
    step, gap = _keep_off(scene, place, step, up, size, margin, threads)
    clear = np.where(gap < 0, _F(np.inf), np.maximum(clear, gap))  # nothing holds who is inside
    met, free, normal = _ahead(scene, place, step, margin, threads, clear)
    if len(met):
        _turn_aside(scene, place, step, up, margin, met, free, normal, threads)
    return step


def _turn_aside(
    scene: RayScene,
    place: Columns,
    step: Columns,
    up: Columns,
    margin: NDArray[np.float32],
    met: NDArray[np.intp],
    free: NDArray[np.float32],
    normal: Vector,
    threads: int,
) -> None:
    """Bend the steps of those who have `met` a face of a normal after what is `free` (mm) of them; changes them in place."""
    u, wanted = vec.take(up, met), vec.take(step, met)
    size = vec.length(wanted)
    wall = vec.unit(vec.flat(normal, u), normal)
    part = free / size
    rest = vec.scale(wanted, _F(1) - part)
    into = np.minimum(vec.dot(rest, wall), _F(0))
    bent = vec.add(vec.scale(wanted, part), vec.sub(rest, vec.scale(wall, into)))
    # In a corner the way along one wall leads into the next: then it goes only as far as is free.
    again, free, _ = _ahead(scene, vec.take(place, met), bent, margin[met], threads)
    if len(again):
        short = vec.take(bent, again)
        short = vec.scale(short, free / vec.length(short))
        for component, value in zip(bent, short, strict=True):
            component[again] = value
    for component, value in zip(step, bent, strict=True):
        component[met] = value


def _keep_off(
    scene: RayScene,
    place: Vector,
    step: Vector,
    up: Columns,
    size: NDArray[np.float32],
    margin: NDArray[np.float32],
    threads: int,
) -> tuple[Vector, NDArray[np.float32]]:
    """Steps that keep the margin from the nearest face, or win it back by at most half a step; and how far (mm) that is, below 0
    of who is inside. A ray along a round wall sees nothing of it, and the ground may carry one sideways."""
    gap, out = scene.apart(*place, size + margin, threads)
    wall = vec.unit(vec.flat((out[0], out[1], out[2]), up), (_F(0) * size,) * 3)
    least = np.minimum(margin - gap, size * _F(0.5)) - vec.dot(step, wall)
    bent = vec.choose(least <= 0, step, vec.add(step, vec.scale(wall, least)))
    long = vec.length(bent)
    return vec.scale(bent, np.where(long > size, size / np.where(long > 0, long, _F(1)), _F(1))), gap


def _ahead(
    scene: RayScene,
    place: Vector,
    step: Vector,
    margin: NDArray[np.float32],
    threads: int,
    clear: NDArray[np.float32] | None = None,
) -> tuple[NDArray[np.intp], NDArray[np.float32], Vector]:
    """Who meets a face on its step, how much of the step (mm) is free, and the face's normal. `clear`: as far there is none."""
    size = vec.length(step)
    asking = size > _F(1e-9)
    if clear is not None:
        asking &= may_touch(clear, size + margin)
    going = np.flatnonzero(asking)
    size, margin = size[going], margin[going]
    direction = vec.scale(vec.take(step, going), _F(1) / size)
    hits = scene.feelers(*vec.take(place, going), *direction, size + margin, threads=threads)
    met = np.flatnonzero(hits.hit)
    free = np.clip(hits.t[met] - margin[met], _F(0), size[met])
    return going[met], free, (hits.nx[met], hits.ny[met], hits.nz[met])
