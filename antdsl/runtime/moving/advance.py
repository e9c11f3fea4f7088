"""From pushes to places: acceleration, limits of speed and turn, sliding along obstacles, walking, and where one faces.

a = push * max_force / mass; v += a dt; P += v dt (T20 of the sources, explicit Euler as there). An animal whose response is a
step or less takes its whole change of velocity at once, and faces where it goes. The heading of others follows within a tenth of
a second. Who has a way to face turns there instead, and walks backward and sideways where its velocity leads.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Move
from antdsl.numerics import compiled, elementary
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import Vector
from antdsl.runtime.moving.falling import in_the_air
from antdsl.runtime.moving.headings import AT_ONCE, BEYOND, BOUNCE, FACE, LEAST_TURN, LEVEL, NINETIETH, SLOW, TWELFTH, share
from antdsl.runtime.moving.least_speed import LEAST, least, no_slower, quickened
from antdsl.runtime.moving.obstacles import slide
from antdsl.runtime.moving.orienting import orient
from antdsl.runtime.moving.tilting import bodies
from antdsl.runtime.moving.walks import led
from antdsl.runtime.world import AXES, Population, World

_F = np.float32


def move(world: World, population: Population, substep: int) -> None:
    """Move all agents of a species by one substep; changes position, velocity, heading, up and footing."""
    if not len(population):
        return
    dt = _F(world.dt / world.setting.substeps)
    if compiled.wanted(len(population)):
        _strides().move(world, population, dt, substep)
        return
    up = vec.columns(population.normal, np.float32)
    others = world.setting.orient != "normal"
    before = (vec.copy(_read(population, "velocity")), vec.copy(_read(population, "up")), population.normal) if others else None
    velocity = _velocity(world, population, up, dt, substep)
    velocity = led(world, population, velocity, up)
    if population.quarantined.any():
        velocity = vec.choose(population.quarantined, (_F(0),) * 3, velocity)  # type: ignore[arg-type]
    wanted = vec.scale(velocity, dt)
    step = no_slower(world, population, slide(world, population, wanted, up, population.now["radius"]), up, dt)
    if step is not wanted:
        stopped = (step[0] != wanted[0]) | (step[1] != wanted[1]) | (step[2] != wanted[2])
        velocity = vec.choose(stopped, vec.scale(step, _F(1) / dt), velocity)
    body = bodies(world, population, step, dt)
    going = body.paced(step, velocity)
    moved = world.ground.move(population.footing, going.wish, going.looking, going.up, going.size, world.options.threads)
    if world.solids:
        moved = in_the_air(world, population, moved, dt)
    hasty = _arrive(population, going.velocity, going.step, moved, going.at_once, dt, _F(world.dt))
    came_from = population.position
    population.footing, population.position = moved.footing, moved.position
    if before is not None:
        orient(world, population, *before)
        hasty[:] = True
    body.follow(hasty, came_from, dt)


@cache
def _strides() -> Any:
    """What does this by kernels, which take a while to load."""
    from antdsl.runtime.moving import strides

    return strides


def _arrive(
    population: Population,
    velocity: Vector,
    step: Vector,
    moved: Move,
    most: NDArray[np.float32],
    dt: np.float32,
    whole: np.float32,
) -> NDArray[np.bool_]:
    """Velocity and heading where the walk of a substep has led, with place, and up as that of the ground there; says whose body
    would tilt by more than `most` (radians) by that, or turn by more than `max_turn` allows. What it tilts by, up to `most`,
    its heading turns less. `whole`: the time of all substeps."""
    now = population.now
    old_up = _read(population, "up")
    new_up = vec.columns(moved.up, np.float32)
    speed = vec.length(velocity)
    velocity = vec.scale(vec.columns(moved.direction, np.float32), speed)
    if moved.blocked.any():
        gone = vec.scale(vec.columns(moved.position - population.position, np.float32), _F(1) / dt)
        lost = vec.sub(vec.scale(step, _F(1) / dt), gone)
        velocity = vec.choose(moved.blocked, vec.sub(gone, vec.scale(lost, BOUNCE)), velocity)
    velocity = vec.flat(velocity, new_up)
    chord = vec.sub(new_up, old_up)
    tilt = _squared_angle(vec.dot(chord, chord))
    hasty = tilt > most * most
    ahead, tilt = vec.columns(moved.heading, np.float32), np.minimum(tilt, most * most)
    heading = _face(population, ahead, velocity, new_up, tilt, dt, _at_once(now, whole))
    # A way round a tip brings a heading back turned. The whole turn, by how far all axes of the body are from where they were.
    before = _read(population, "heading")
    chords = (vec.sub(heading, before), vec.sub(new_up, old_up), vec.sub(vec.cross(new_up, heading), vec.cross(old_up, before)))
    square = (vec.dot(chords[0], chords[0]) + vec.dot(chords[1], chords[1]) + vec.dot(chords[2], chords[2])) * _F(0.5)
    limit = np.maximum(now["max_turn"], _F(0)) * dt * BEYOND
    hasty |= _squared_angle(square) > limit * limit + LEAST_TURN
    for name, value in (
        ("velocity", velocity),
        ("heading", heading),
        ("up", new_up),
        ("position", vec.columns(moved.position, np.float32)),
    ):
        for axis, component in zip(AXES, value, strict=True):
            now[f"{name}.{axis}"][:] = component
    population.normal = np.stack(new_up, axis=1)
    return hasty


def _squared_angle(square: NDArray[np.float32]) -> NDArray[np.float32]:
    """The square of an angle, by the first terms of its series in the squared chord of unit vectors: less beyond 1 rad."""
    inner: NDArray[np.float32] = square * NINETIETH + TWELFTH
    angle: NDArray[np.float32] = square * (square * inner + _F(1))
    return angle


def _read(population: Population, name: str) -> Vector:
    return vec.named(population.now, name)


def _velocity(world: World, population: Population, up: Vector, dt: np.float32, substep: int) -> Vector:
    """Velocity after the push, along the ground, within the limits of speed and turn."""
    now = population.now
    before, push = _read(population, "velocity"), _read(population, "push")
    velocity = _pushed(now, push, vec.flat(before, up), up, _time(now, _F(world.dt), dt, substep))
    turning = np.flatnonzero(np.isfinite(now["max_turn"]))
    if len(turning):
        time = _time({"response": now["response"][turning]}, _F(world.dt), dt, substep)
        most = np.maximum(now["max_turn"][turning], _F(0)) * time
        u = vec.take(up, turning)
        _limit_turn(velocity, vec.flat(vec.take(before, turning), u), u, most, turning)
    return velocity


def _pushed(now: dict[str, NDArray[Any]], push: Vector, before: Vector, up: Vector, time: NDArray[np.float32]) -> Vector:
    """Velocity after the push for a time each, along the ground, within the limit of speed."""
    push = vec.flat(push, up)
    push = vec.scale(push, _F(1) / np.maximum(vec.length(push), _F(1)))
    max_speed = np.maximum(now["max_speed"], _F(0))
    velocity = vec.add(before, vec.scale(push, _gain(now, time)))
    speed = vec.length(velocity)
    velocity = vec.scale(velocity, np.where(speed > max_speed, max_speed / np.where(speed > 0, speed, _F(1)), _F(1)))
    x, y, z = (np.where(np.isfinite(v), v, _F(0)) for v in velocity)
    if LEAST not in now:
        return x, y, z
    return quickened((x, y, z), before, vec.flat(vec.named(now, "heading"), up), least(now))


def _time(now: dict[str, NDArray[Any]], step: np.float32, dt: np.float32, substep: int) -> NDArray[np.float32]:
    """Seconds that a push acts in this substep: for who answers at once the whole step, in the first."""
    return np.where(_at_once(now, step), step if substep == 0 else _F(0), dt)


def _at_once(now: dict[str, NDArray[Any]], step: np.float32) -> NDArray[np.bool_]:
    """Who is kinematic: whose response is no longer than a step."""
    at_once: NDArray[np.bool_] = now["response"] <= step * AT_ONCE
    return at_once


def _gain(now: dict[str, NDArray[Any]], time: NDArray[np.float32]) -> NDArray[np.float32]:
    """Change of velocity by a push of 1 in this substep, mm/s."""
    per_second = now["max_force"] / now["mass"]
    gain: NDArray[np.float32] = np.where(np.isfinite(per_second), per_second, _F(0)) * time
    return gain


def _limit_turn(velocity: Vector, before: Vector, up: Vector, most: NDArray[np.float32], rows: NDArray[np.intp]) -> None:
    """Turn the velocity of `rows`, whose are all others, by at most `most` (radians), at its new speed; changes it in place."""
    some = np.flatnonzero(_may_turn_more(vec.take(velocity, rows), before, most))
    if not len(some):
        return
    rows, most = rows[some], most[some]
    v, b, u = vec.take(velocity, rows), vec.take(before, some), vec.take(up, some)
    speed, ahead = vec.length(v), vec.unit(b, vec.unit(v, vec.across(u)))
    direction = vec.unit(v, ahead)
    side = vec.unit(vec.flat(direction, ahead), vec.cross(u, ahead))
    angle = elementary.atan2(vec.length(vec.cross(ahead, direction)), vec.dot(ahead, direction))
    most = np.where(vec.length(b) > 0, most, _F(4))  # who stands may set out in any direction
    turned = vec.add(vec.scale(ahead, elementary.cos(most)), vec.scale(side, elementary.sin(most)))
    limited = vec.choose(angle > most, vec.scale(turned, speed), v)
    for component, value in zip(velocity, limited, strict=True):
        component[rows] = value


def _may_turn_more(velocity: Vector, before: Vector, most: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Who may turn by more than `most` (radians): all but those whose angle is clearly less, of whom most crowds are."""
    cosine = np.cos(np.clip(most, _F(0), _F(np.pi)))
    along, both = vec.dot(velocity, before), vec.length(velocity) * vec.length(before)
    clearly: NDArray[np.bool_] = (along > (cosine + _F(1e-3)) * both) & (both > _F(1e-12))
    return np.logical_not(clearly)


def _face(
    population: Population,
    heading: Vector,
    velocity: Vector,
    up: Vector,
    tilt: NDArray[np.float32],
    dt: np.float32,
    at_once: NDArray[np.bool_],
) -> Vector:
    """Turn the heading towards the movement: exponentially within a tenth of a second or at once, and with the body's tilt, whose
    squared angle is given, no faster than max_turn."""
    now = population.now
    heading = vec.unit(vec.flat(heading, up), vec.across(up))
    speed = vec.length(velocity)
    direction = vec.unit(velocity, heading)
    faced = None
    if FACE in now:
        wish = vec.named(now, "~face")
        along = vec.flat(vec.unit(wish, up), up)  # a way straight off the ground is none
        faced = vec.length(along) > LEVEL
        direction = vec.choose(faced, vec.unit(along, direction), direction)
    turn = now["max_turn"]
    behind = (vec.dot(heading, direction) < 0) & ~(at_once & ~np.isfinite(turn))
    if behind.any():  # over a right angle it turns towards its side first, instead of through itself
        left = vec.cross(up, heading)
        side = vec.unit(vec.flat(direction, heading), left)
        direction = vec.choose(behind, vec.unit(vec.flat(side, up), left), direction)
    part = share(dt)
    eager = np.minimum(speed / np.maximum(now["max_speed"] * SLOW, _F(1e-6)), _F(1))
    if faced is not None:
        eager = np.where(faced, _F(1), eager)
    change = vec.scale(vec.sub(direction, heading), np.where(at_once, _F(1), part * eager))
    if np.isfinite(turn).any():
        size = vec.length(change)
        most = np.where(np.isfinite(turn), np.maximum(turn, _F(0)) * dt, np.inf).astype(np.float32)
        most = np.sqrt(np.maximum(most * most - tilt, _F(0)))
        change = vec.scale(change, np.where(size > most, most / np.where(size > 0, size, _F(1)), _F(1)))
    return vec.unit(vec.flat(vec.add(heading, change), up), heading)
