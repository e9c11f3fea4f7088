"""A substep of a crowd by kernels: what `advance.move` does, to the same bits, in as few loops over all agents as there can be.

Up to what stands in anybody's way one loop does; those who may touch an obstacle, look out for walls, lean or have a wall before
them are few, and have loops of their own. Another walks all who stay on their own surface and lets them arrive."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.mesh.walk_events import CrowdWalk, Waiting
from antdsl.ground.plane import Plane
from antdsl.ground.protocol import Footing, Ground, Move
from antdsl.numerics import compiled
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import Vector
from antdsl.runtime.moving.falling import in_the_air
from antdsl.runtime.moving.headings import AT_ONCE, FACE, share
from antdsl.runtime.moving.heads import RAISED
from antdsl.runtime.moving.least_speed import LEAST, no_slower
from antdsl.runtime.moving.obstacles import slide
from antdsl.runtime.moving.orienting import orient
from antdsl.runtime.moving.rises import WIDEST, rises_by_kernels
from antdsl.runtime.moving.tilting import WAITING
from antdsl.runtime.moving.walks import led, walks_of
from antdsl.runtime.world import Population, World

_F = np.float32


@dataclass(slots=True)
class _Bodies:
    """What is worked out of a crowd on its way, arrays of the kernels: see `strides_compiled.set_out`."""

    velocity: Vector
    step: Vector
    looking: Vector
    long: NDArray[np.float32]
    most: NDArray[np.float32]
    reach: NDArray[np.float64]
    state: NDArray[np.int32]


def move(world: World, population: Population, dt: np.float32, substep: int) -> None:
    """As `advance.move`, of a crowd of one at least, in `dt` seconds."""
    from antdsl.runtime.moving.tilting_compiled import follow, pace

    now = population.now
    others = world.setting.orient != "normal"
    before = (vec.copy(vec.named(now, "velocity")), vec.copy(vec.named(now, "up")), population.normal) if others else None
    bodies = _set_out(world, population, dt, substep)
    _past_obstacles(world, population, bodies, dt)
    up, heading = vec.named(now, "up"), vec.named(now, "heading")
    found = rises_by_kernels(world, population, bodies.looking, bodies.step, bodies.reach, bodies.state)
    walls = (found.wall, found.ahead, found.angle, found.far, found.over)
    pace(bodies.state, bodies.step, bodies.velocity, up, population.normal, bodies.most, walls, WAITING)
    came_from = population.position
    kept = population.room("kept", 6, (len(population),), np.float32)
    _Arrival(world, population, bodies, (kept[:3], kept[3:]), dt, others).walk(world.ground)
    if before is not None:
        orient(world, population, *before)
    ways = (kept[:3], kept[3:], came_from, population.position)
    follow(bodies.state, *ways, bodies.most, now["max_turn"], dt, walls, found.half, RAISED, up, heading)


def _set_out(world: World, population: Population, dt: np.float32, substep: int) -> _Bodies:
    """What all are about to do, whatever is in their way."""
    from antdsl.runtime.moving.strides_compiled import set_out

    now, n, whole = population.now, len(population), _F(world.dt)
    x, y, z, a, b, c, *looking, long, most = population.room("set out", 11, (n,), np.float32)
    (reach,), (state,) = population.room("reach", 1, (n,), np.float64), population.room("state", 1, (n,), np.int32)
    found = _Bodies((x, y, z), (a, b, c), (looking[0], looking[1], looking[2]), long, most, reach, state)
    given = (vec.named(now, name) for name in ("push", "velocity", "heading", "up"))
    limits = (now["max_speed"], now["max_force"], now["mass"], now["response"], now["max_turn"])
    keeps = LEAST in now
    least = now[LEAST] if keeps else now["max_speed"]
    times = (whole * AT_ONCE, whole if substep == 0 else _F(0), dt)
    work = partial(
        set_out,
        *given, population.normal, limits, keeps, least, now["size"], population.quarantined, times, WIDEST, found.velocity,
        found.step, found.looking, (long, most, reach), state,
    )  # fmt: skip
    compiled.in_parts(work, n, world.options.threads, compiled.LIGHT)
    if walks_of(world, population):
        velocity = led(world, population, found.velocity, vec.columns(population.normal, np.float32))
        zero = np.zeros(n, np.float32)
        found.velocity = vec.choose(population.quarantined, (zero, zero, zero), velocity)
        found.step = vec.scale(found.velocity, dt)
        found.long = vec.length(found.step)
    return found


def _past_obstacles(world: World, population: Population, bodies: _Bodies, dt: np.float32) -> None:
    """Steps along the obstacles in their way, and velocities of those who would have gone otherwise."""
    if not world.plan.of_kind("obstacle"):
        return
    from antdsl.runtime.moving.obstacles_compiled import slowed

    wanted, normal = bodies.step, population.normal
    up = normal[:, 0], normal[:, 1], normal[:, 2]
    step = no_slower(world, population, slide(world, population, wanted, up, population.now["radius"]), up, dt)
    if step is not wanted:
        work = partial(slowed, wanted, step, bodies.velocity, _F(1) / dt)
        compiled.in_parts(work, len(population), world.options.threads, compiled.LIGHT)
        bodies.step = step


@dataclass(slots=True)
class _Arrival:
    """A crowd whose `bodies` are about to walk, with room for the up and heading that those had who have to `follow` afterwards,
    as `everyone` may have."""

    world: World
    population: Population
    bodies: _Bodies
    kept: tuple[tuple[NDArray[Any], ...], ...]
    dt: np.float32
    everyone: bool

    def walk(self, ground: Ground) -> None:
        """Walk over a ground to new places, and arrive there."""
        if isinstance(ground, Plane):
            self._over_plane(ground)
        elif not isinstance(ground, MeshGround) or not self._over_meshes(ground):
            self._over_any(ground)

    def _given(self) -> tuple[Any, ...]:
        """What kernels need to know where somebody arrives: see `strides_compiled`."""
        now, bodies = self.population.now, self.bodies
        limits = (now["max_speed"], now["max_turn"], now["response"])
        times = (_F(self.world.dt) * AT_ONCE, self.dt, share(self.dt))
        facing = (FACE in now, vec.named(now, "~face" if FACE in now else "velocity"), self.everyone)
        registers = tuple(vec.named(now, name) for name in ("position", "velocity", "heading", "up"))
        return limits, (bodies.most, bodies.state, *self.kept), times, facing, registers

    def _over_plane(self, plane: Plane) -> None:
        from antdsl.runtime.moving.strides_compiled import glide

        p, n = self.population, len(self.population)
        place, normals = np.empty((n, 3)), np.empty((n, 3), np.float32)
        going = (self.bodies.velocity, self.bodies.step, self.bodies.looking)
        work = partial(glide, plane.up, p.footing.point, *going, *self._given(), place, normals)
        compiled.in_parts(work, n, self.world.options.threads)
        p.footing, p.position, p.normal = Footing.on_plane(place), place, normals

    def _over_meshes(self, ground: MeshGround) -> bool:
        """False where triangles are not what is walked over."""
        from antdsl.ground.mesh import walk_compiled as loop
        from antdsl.runtime.moving.strides_compiled import stride

        p, n, bodies = self.population, len(self.population), self.bodies
        walk = ground.crowd_walk(bodies.long, p.now["size"])
        if walk is None:
            return False
        tables = walk.tables()
        to = Footing.on_faces(np.empty(n, np.int32), np.empty(n, np.int32), *np.empty((3, n)))
        at, placed = ((f.mesh, f.face, f.b1, f.b2, f.over) for f in (p.footing, to))
        place, normals = np.empty((3, n)), np.empty((n, 3), np.float32)
        (how,) = p.room("how", 1, (n,), np.uint8)
        (reals,), (wholes,) = p.room("reals", 1, (loop.REALS * n,), np.float64), p.room("wholes", 1, (loop.WHOLES * n,), np.int64)
        given = (at, p.now["size"], p.normal, bodies.velocity, bodies.step, bodies.looking, *self._given())

        def part(begin: int, end: int) -> Waiting:
            floats = reals[begin * loop.REALS : end * loop.REALS].reshape(loop.REALS, -1)
            numbers = wholes[begin * loop.WHOLES : end * loop.WHOLES].reshape(loop.WHOLES, -1)
            waiting, left = stride(*tables, *given, floats, numbers, how, placed, place, p.position, normals, begin, end)
            return floats[:, :waiting], numbers[:, :waiting], left

        parted = compiled.in_parts(part, n, self.world.options.threads)
        self._later(ground, walk, parted, to, place, normals, how)
        p.footing, p.position, p.normal = to, place.T, normals
        return True

    def _later(
        self,
        ground: MeshGround,
        walk: CrowdWalk,
        parted: list[Waiting],
        to: Footing,
        place: NDArray[np.float64],
        normals: NDArray[np.float32],
        how: NDArray[np.uint8],
    ) -> None:
        """Move and let arrive those who have come to something else than the next face of their surface, and those who are nowhere
        or whose numbers are none."""
        from antdsl.ground.mesh.walk_compiled import DONE

        p, n = self.population, len(self.population)
        above, ahead, direction = p.room("walked", 3, (3, n), np.float64)
        (gone,), (blocked,) = p.room("gone", 1, (n,), np.float64), p.room("blocked", 1, (n,), np.bool_)
        placed, moved = (to.mesh, to.face, to.b1, to.b2, to.over), (place, above, ahead, direction, gone)
        rows, left = walk.on(parted, how, placed, moved, blocked, self.world.options.threads)
        if left:
            others = np.flatnonzero(how != DONE)
            result = Move(to, place.T, above.T, ahead.T, direction.T, gone, blocked, np.zeros(n, np.bool_))
            result.put(others, self._moved(ground, others))
            rows = np.union1d(rows, others)
        if len(rows):
            self._arrive(rows, (*moved[:4], blocked), normals)

    def _over_any(self, ground: Ground) -> None:
        p, rows = self.population, np.arange(len(self.population))
        moved = self._moved(ground, slice(None))
        if self.world.solids:
            moved = in_the_air(self.world, p, moved, self.dt)
        normals = np.empty((len(rows), 3), np.float32)
        walked = (moved.position.T, moved.up.T, moved.heading.T, moved.direction.T, moved.blocked)
        self._arrive(rows, walked, normals)
        p.footing, p.position, p.normal = moved.footing, moved.position, normals

    def _moved(self, ground: Ground, rows: NDArray[np.intp] | slice) -> Move:
        """Where a ground moves some agents."""
        from antdsl.runtime.moving.tilting_compiled import STANDS

        p, bodies = self.population, self.bodies
        stands = bodies.state[rows] == STANDS
        heading = vec.choose(stands, vec.take(vec.named(p.now, "heading"), rows), vec.take(bodies.looking, rows))
        vectors = vec.rows(vec.take(bodies.step, rows)), vec.rows(heading), p.normal[rows].astype(np.float64)
        size = p.now["size"][rows].astype(np.float64)
        return ground.move(p.footing.take(rows), *vectors, size, self.world.options.threads)

    def _arrive(self, rows: NDArray[np.intp], walked: tuple[Any, ...], normals: NDArray[np.float32]) -> None:
        from antdsl.runtime.moving.advance_compiled import arrive

        given = (self.bodies.velocity, self.bodies.step, self.population.position, walked, *self._given(), normals)
        work = partial(arrive, rows, *given)
        compiled.in_parts(work, len(rows), self.world.options.threads, compiled.LIGHT)
