"""One step of all feet of a species: who lifts, who swings, who lands, and where.

The phase of a gait goes on by the ground that the feet went over, their turning included, by the stride. A foot lifts when its
share of the cycle to stand is over, or its leg would be too short; it swings in an arc to where it will stand half of the stance
ahead of its resting place, and stands from then on. Who does not move puts its feet back where they rest, in the order of the
gait. Phases by ground covered and stance and swing by duty follow M. H. Raibert and J. K. Hodgins, Animation of Dynamic Legged
Locomotion, SIGGRAPH 1991, and N. M. Thalmann et al.'s survey of walking; nothing here is a simulation of forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.runtime.feet import trunk
from antdsl.runtime.feet.gaits import MOST_CYCLES, REACHED, SINK, Gaits, Stepping, resting
from antdsl.runtime.feet.seeking import Floor, seek
from antdsl.runtime.feet.state import NOTHING, STANDS, Feet, by_leg
from antdsl.runtime.world import Population, World
from antdsl.scene.setting import LegsData

Floats = NDArray[np.float32]
Places = NDArray[np.float64]
Flags = NDArray[np.bool_]
_F = np.float32

_SLOW = _F(0.02)  # cycles in a frame, below which feet are put back where they rest
_OFF = _F(0.12)  # of a leg: how far from there a foot may stay
_LEFT = _F(1.25)  # times its reach: a foot so far from where it rests is lifted, whatever its share of the cycle
_AGAIN = _F(0.45)  # of a leg: a landing place so far from the one that is wanted by now is sought anew
_STRETCHED = _F(0.99)  # of a leg: a foot so far from its hip is lifted
_SMALL = _F(0.4)  # of a stride: shorter swings are lower
_GONE = 0.02  # of a leg: a solid that is so much farther from a foot than it was has been dug away below it


@dataclass(slots=True, eq=False)
class Frames:
    """Places and axes of n bodies, float64[3, n]: `place`, `ahead`, `up`, `aside`; `size` float64[n], mm."""

    place: NDArray[np.float64]
    ahead: NDArray[np.float64]
    up: NDArray[np.float64]
    aside: NDArray[np.float64]
    size: NDArray[np.float64]

    @staticmethod
    def of(position: Places, heading: Places, up: Places, size: NDArray[np.float64]) -> Frames:
        """With the heading as it is, and up across it."""
        forward, above = _vector(heading), _vector(up)
        ahead = vec.unit(forward, vec.across(above))
        straight = vec.unit(vec.flat(above, ahead), vec.across(ahead))
        return Frames(position, np.stack(ahead), np.stack(straight), vec.stacked_cross(ahead, straight), size)

    def at(self, x: NDArray[np.floating], y: NDArray[np.floating], z: NDArray[np.floating]) -> NDArray[np.float64]:
        """Places float64[3, n, L] of points [n, L] in body lengths: ahead, above, aside."""
        s = self.size[:, None]
        x, y, z = x * s, y * s, z * s
        found = by_leg((3, *x.shape))
        for k in range(3):
            found[k] = self.place[k][:, None] + (
                (x * self.ahead[k][:, None] + y * self.up[k][:, None]) + z * self.aside[k][:, None]
            )
        return found

    def of_places(self, places: NDArray[np.float64]) -> tuple[Floats, Floats, Floats]:
        """Where places [3, n, L] are from the bodies, float32[n, L] in body lengths: ahead, above, aside."""
        away = (places - self.place[:, :, None]).astype(np.float32)
        by = (1.0 / np.maximum(self.size, 1e-12)).astype(np.float32)[:, None]
        axes = (self.ahead, self.up, self.aside)
        x, y, z = (vec.dot(away, axis.astype(np.float32)[:, :, None]) * by for axis in axes)
        return x, y, z


def _vector(columns: Places) -> vec.Vector:
    x, y, z = columns
    return x, y, z


class Walkers:
    """The legs of one species with its gaits, by which its feet go."""

    def __init__(self, legs: LegsData) -> None:
        self.legs, self.gaits = legs, Gaits(legs)
        self.rest = resting(legs)
        self.off = (_OFF * legs.length).astype(np.float32)
        self.leg = legs.length.astype(np.float32)


def begin(world: World) -> None:
    """Let all whose bodies have legs stand on their feet, where feet are worked out."""
    world.feet, world.walkers, world.floor = {}, {}, None
    if not world.options.feet:
        return
    for name, legs in world.setting.legs.items():
        if name in world.populations:
            world.feet[name], world.walkers[name] = Feet.none(len(legs.foot)), Walkers(legs)
    if world.feet:
        world.floor = Floor(world)
        walk(world)


def measure(world: World) -> None:
    """Takes down what each foot's resting place went over the ground in this step, before the ground itself goes on."""
    for name, feet in world.feet.items():
        population, walkers = world.populations[name], world.walkers[name]
        feet, new = feet.matched(population.sorted_ids()[0])
        world.feet[name] = feet
        now = _frames(population)
        before = Frames.of(feet.position, feet.heading.astype(np.float64), feet.up.astype(np.float64), now.size)
        covered = _covered(before, now, walkers.rest)
        covered[:, new] = 0
        feet.covered, feet.stood = np.where(np.isfinite(covered), covered, _F(0)), now.place


def _covered(before: Frames, now: Frames, rest: tuple[Floats, Floats]) -> Floats:
    """How far each foot's resting place went, ahead and aside of bodies as they are now: float32[2, n, L], body lengths."""
    away = (before.place - now.place) / now.size
    found = by_leg((2, len(now.size), len(rest[0])), np.float32)
    for k, (axis, own) in enumerate(((now.ahead, rest[0]), (now.aside, rest[1]))):
        moved, along, across = (vec.dot(v, axis).astype(np.float32) for v in (away, before.ahead, before.aside))
        for leg, (x, z) in enumerate(zip(*rest, strict=True)):
            found[k, :, leg] = own[leg] - (moved + along * x + across * z)
    return found


def walk(world: World) -> None:
    """Brings all feet to where they are in the frame that is made."""
    if not world.feet:
        return
    with np.errstate(all="ignore"):
        for name in world.feet:
            _walk(world, world.populations[name], world.walkers[name])


def _walk(world: World, population: Population, walkers: Walkers) -> None:
    floor = world.floor
    assert floor is not None
    feet, new = world.feet[population.name].matched(population.sorted_ids()[0])
    world.feet[population.name] = feet
    body = _frames(population)
    covered = by_leg((2, *feet.swing.shape), np.float32) if feet.covered is None else feet.covered
    if floor.moving and len(feet):
        floor.carried(world, feet.on, feet.face, feet.weight, feet.place)
        if feet.stood is not None:  # where swings began goes along with the ground, as the bodies do
            feet.start += np.where(np.isfinite(feet.stood), body.place - feet.stood, 0.0)[:, :, None]
    step = _Step(world, floor, feet, walkers, body, covered)
    if new.size:
        step.stand(new)
    step.go()
    feet.position, feet.heading, feet.up = body.place, body.ahead.astype(np.float32), body.up.astype(np.float32)
    feet.covered = feet.stood = None


def _frames(population: Population) -> Frames:
    rows, now = population.in_id_order(), population.now
    heading, up = (
        np.stack([component[rows] for component in vec.named(now, name)]).astype(np.float64) for name in ("heading", "up")
    )
    return Frames.of(np.ascontiguousarray(population.position[rows].T), heading, up, now["size"][rows].astype(np.float64))


class _Step:
    """What one step works with: n agents, L legs; all lengths are of bodies, all but places float32."""

    def __init__(self, world: World, floor: Floor, feet: Feet, walkers: Walkers, body: Frames, covered: Floats) -> None:
        self.world, self.floor, self.feet, self.walkers, self.body, self.covered = world, floor, feet, walkers, body, covered
        self.dt = _F(world.dt)
        square = covered[0] * covered[0] + covered[1] * covered[1]
        self.went = trunk.summed(np.sqrt(square)) / _F(max(1, feet.legs))
        self.stepping: Stepping = walkers.gaits.at(self.went / self.dt, self.went)
        self.beside = body.of_places(feet.place)
        self._hip: tuple[Floats, Floats, Floats] | None = None

    # ---- who does what

    def stand(self, rows: NDArray[np.intp]) -> None:
        """Newborn: all feet where they rest, each agent at a phase of its own."""
        feet = self.feet
        turns = feet.ids[rows].astype(np.float64) * 0.6180339887498949
        feet.phase[rows] = (turns - np.floor(turns)).astype(np.float32)
        chosen = np.zeros(feet.swing.shape, np.bool_)
        chosen[rows] = True
        x, z = (np.broadcast_to(part, feet.swing.shape) for part in self.walkers.rest)
        self._seek(chosen, x, z, np.zeros_like(x))
        feet.swing[chosen] = np.where(feet.on[chosen] == NOTHING, _F(1), STANDS)
        feet.start[:, chosen] = feet.place[:, chosen]
        self.beside = self.body.of_places(feet.place)

    def go(self) -> None:
        """All feet by one frame."""
        feet, stepping = self.feet, self.stepping
        off = self._off()
        slow = self.went / stepping.stride < _SLOW
        ahead = self.went / stepping.stride
        restless = ((off > self.walkers.off + feet.found) & feet.down).any(axis=1) | (feet.swing >= 0).any(axis=1)
        ahead = np.where(slow & restless, np.maximum(ahead, self.dt / _F(self.walkers.gaits.cycle)), ahead)
        ahead = np.minimum(ahead, _F(MOST_CYCLES)).astype(np.float32)
        before = feet.phase[:, None] + stepping.phases
        before = before - np.floor(before)
        duty = stepping.duty[:, None]
        # Who sets out from a stand does so with the foot whose turn is next, at once: none waits until it is left behind.
        stood = feet.down.all(axis=1) & (off <= self.walkers.off).all(axis=1) & ~slow
        gap = duty - before
        gap = np.where(gap > 0, gap, gap + 1).min(axis=1)
        on = np.where(stood & (gap > ahead), gap + _F(1e-3), ahead).astype(np.float32)
        self._lift(before + on[:, None], before, duty, off, slow)
        self._swing(ahead, duty, slow)
        phase = feet.phase + on
        feet.phase = phase - np.floor(phase)
        self._trunk()
        self._show()

    def _off(self) -> Floats:
        """How far each foot is from where it rests: on the ground at right angles below or above that place, or on the straight
        way from the hip through it, whichever is nearer."""
        x, y, z = self.beside
        below = np.square(x - self.walkers.rest[0]) + np.square(z - self.walkers.rest[1])
        a, b, c = self._hips()
        by = b / np.maximum(b - y, _F(0.1) * self.walkers.leg)
        through = np.square(a + (x - a) * by - self.walkers.rest[0]) + np.square(c + (z - c) * by - self.walkers.rest[1])
        return np.asarray(np.sqrt(np.minimum(below, through)), np.float32)

    def _lift(self, share: Floats, before: Floats, duty: Floats, off: Floats, slow: Flags) -> None:
        """Who stands and has stood long enough, is left behind or has lost its ground swings from now on."""
        feet = self.feet
        crosses = ((before < duty) & (share >= duty)) | (share >= 1 + duty)
        # Whose turn was missed, as the gait changed or something else moved the foot: behind where it rests, in time to swing.
        x, z = self.beside[0] - self.walkers.rest[0], self.beside[2] - self.walkers.rest[1]
        behind = x * self.covered[0] + z * self.covered[1] < 0
        late = (before >= duty) & (before < duty + _F(0.6) * (1 - duty)) & behind & (off > _F(0.3) * self.walkers.gaits.reach)
        due = (crosses | late) & (~slow[:, None] | (off > _F(0.5) * self.walkers.off + feet.found))
        left = off > _LEFT * self.walkers.gaits.reach
        lifts = feet.down & (due | self._too_far(_STRETCHED) | left | self._undermined())
        over = share - duty
        over = np.where(over >= 1, over - 1, over)
        feet.swing = np.where(lifts, _F(0), feet.swing)
        self.lifts, self.begun = lifts, np.where(crosses & (over >= 0), over / (1 - duty), _F(-1))
        feet.start = np.where(lifts, feet.place, feet.start)

    def _hips(self) -> tuple[Floats, Floats, Floats]:
        """Hips [n, L] in body lengths, with the trunk's height and tilt."""
        if self._hip is not None:
            return self._hip
        self._hip = self._raised(trunk.leant(self.walkers.legs.hip, self.feet.slope))
        return self._hip

    def _raised(self, hips: tuple[Floats, Floats, Floats]) -> tuple[Floats, Floats, Floats]:
        x, y, z = hips
        return x, np.asarray(y + (self.feet.rise / self.body.size.astype(np.float32))[:, None], np.float32), z

    def _undermined(self) -> Flags:
        """Feet whose ground was dug away."""
        found = np.zeros(self.feet.swing.shape, np.bool_)
        for k, name in enumerate(self.floor.names):
            volume = self.world.solids.get(name)
            rows = self.feet.on == k if volume is not None else None
            if volume is not None and rows is not None and rows.any() and volume.removed > 0:
                leg = np.broadcast_to(self.walkers.leg * self.body.size[:, None], rows.shape)[rows]
                found[rows] = volume.sample(self.feet.place[:, rows].T) > np.maximum(_GONE * leg, 0.02 * volume.voxel)
        return found

    def _swing(self, ahead: Floats, duty: Floats, slow: Flags) -> None:
        """Feet in the air go on; those at the end of their swing stand, on ground that is sought where they lift, and again
        where the body has turned away from it since."""
        feet, gaits = self.feet, self.walkers.gaits
        rate = np.maximum(ahead[:, None] / (1 - duty), self.dt / _F(max(gaits.swing, 1e-3)))
        rate = np.minimum(rate, _F(1))
        flying = feet.swing >= 0
        more = np.where(self.lifts & (self.begun >= 0), self.begun, rate)
        done = np.where(flying, np.minimum(feet.swing + more, _F(1)), STANDS)
        left = np.where(flying, 1 - done, _F(0)) / rate  # frames until it stands
        stance = np.maximum(1 / np.maximum(ahead, _F(1e-6))[:, None] - 1 / rate, _F(0))  # frames that it will stand
        half = [np.minimum(stance, _F(1e4)) * part * _F(0.5) for part in self.covered]
        long = np.sqrt(half[0] * half[0] + half[1] * half[1])
        by = np.minimum(_F(1), gaits.reach / np.maximum(long, _F(1e-9)))
        x, z = (rest + part * left + most * by for rest, part, most in zip(self.walkers.rest, self.covered, half, strict=True))
        lands = flying & (done >= 1)
        past = np.where(lands, feet.swing + more - 1, _F(0)) / rate  # frames ago, in which the body went on
        x, z = x - self.covered[0] * past, z - self.covered[1] * past
        gap = np.square(self.beside[0] - x) + np.square(self.beside[2] - z)
        again = lands & (
            (gap > np.square(np.where(slow[:, None], self.walkers.off, _AGAIN * self.walkers.leg)))
            | (feet.on == NOTHING)
            | self._too_far(_F(REACHED))
        )
        self._seek(self.lifts & ~lands, x, z, left, thorough=False)
        self._seek(again, x, z, left)
        feet.swing = np.where(lands & (feet.on != NOTHING), STANDS, done).astype(np.float32)
        self.beside = self.body.of_places(feet.place)
        feet.found = np.where(slow[:, None], np.where(lands, self._off(), feet.found), _F(0))

    def _too_far(self, most: np.float32) -> Flags:
        """Whose place is farther from its hip than `most` of its leg, the trunk as low as it may be."""
        leg = self.walkers.leg
        x, y, z = (b - h for b, h in zip(self.beside, self._hips(), strict=True))
        y = y + self.walkers.legs.foot[:, 1].astype(np.float32)
        y = np.maximum(np.abs(y) - _F(SINK) * leg * (y < 0), _F(0))
        return np.asarray((x * x + y * y) + z * z > np.square(most * leg))

    # ---- places

    def _seek(self, chosen: Flags, x: Floats, z: Floats, left: Floats, thorough: bool = True) -> None:
        """Ground for chosen feet near places ahead and aside, seen from where hips will be in so many frames; where there is
        none the foot hangs there."""
        who, leg = np.nonzero(chosen)
        if not who.size:
            return
        feet, body, legs = self.feet, self.body, self.walkers.legs
        a, b, c = (part[who, leg] for part in self._hips())
        frames = left[who, leg]
        a, c = a + self.covered[0, who, leg] * frames, c + self.covered[1, who, leg] * frames
        size, place, ahead, up, aside = (v.take(who, axis=-1) for v in (body.size, body.place, body.ahead, body.up, body.aside))
        hip = place + ((a * ahead + b * up) + c * aside) * size
        wanted = place + (x[who, leg] * ahead + z[who, leg] * aside) * size
        sole = legs.foot[leg, 1] * size
        found = seek(self.world, self.floor, hip, wanted, up, legs.length[leg] * size * REACHED, sole, thorough)
        hangs = found.on == NOTHING
        feet.place[:, who, leg] = np.where(hangs, wanted, found.place)
        feet.on[who, leg], feet.face[who, leg], feet.weight[:, who, leg] = found.on, found.face, found.weight

    def _trunk(self) -> None:
        feet, legs = self.feet, self.walkers.legs
        size = self.body.size.astype(np.float32)
        rise, slope = trunk.fitted(legs, self.beside, feet.on != NOTHING, feet.rise / size, feet.slope, float(self.dt))
        hips = trunk.leant(legs.hip, slope)
        rise = trunk.lowered(legs, self.beside, feet.down, rise, hips)
        before = feet.rise, feet.slope
        feet.rise, feet.slope = (rise * size).astype(np.float32), slope
        self._hip = self._raised(hips)
        torn = (self._too_far(_STRETCHED) & feet.down).any(axis=1)
        if torn.any():  # then the trunk stays as it was, where all that stand are in reach
            feet.rise, feet.slope = (np.where(torn, a, b) for a, b in zip(before, (feet.rise, feet.slope), strict=True))
            self._hip = None

    def _show(self) -> None:
        """Where each foot is: where it stands, or on its arc, no farther than its leg reaches."""
        feet, body = self.feet, self.body
        flying = feet.swing >= 0
        done = np.where(flying, feet.swing, _F(1))
        start, end = body.of_places(feet.start), self.beside
        eased = done * done * (3 - 2 * done)
        way = tuple(b - a for a, b in zip(start, end, strict=True))
        far = np.sqrt((way[0] * way[0] + way[1] * way[1]) + way[2] * way[2])
        stride, lift = self.stepping.stride[:, None], self.stepping.lift[:, None]
        arc = lift * np.minimum(_F(1), far / (stride * _SMALL)) * (4 * done * (1 - done))
        x, y, z = (a + w * eased for a, w in zip(start, way, strict=True))
        y = y + arc
        # The foot joint is above the ground of its foot, so the hip is brought down by as much to measure from.
        a, b, c = self._hips()
        b = b - self.walkers.legs.foot[:, 1].astype(np.float32)
        dx, dy, dz = x - a, y - b, z - c
        long = np.sqrt((dx * dx + dy * dy) + dz * dz)
        by = np.minimum(_F(1), self.walkers.leg * _F(REACHED) / np.maximum(long, _F(1e-9)))
        feet.shown = np.where(flying, body.at(a + dx * by, b + dy * by, c + dz * by), feet.place)
