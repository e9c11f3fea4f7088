"""The clips of the ant. All castes play the same: their rigs have the same joints."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from antdsl.bodies.agents.clip import Clip
from antdsl.bodies.agents.rig import Rig
from antdsl.bodies.library import ant_rig
from antdsl.bodies.library.insect_legs import chains_of
from antdsl.bodies.library.motions import FAST, Array, Motion, X, Y, Z, steps

CHAINS = chains_of(3)
_REACH = 0.237  # from a worker's neck to the tips of its jaws
_SIDES = (("l", -1.0), ("r", 1.0))


def _feelers(m: Motion, reach: float, cycles: int, drop: Array | float = 0.0, still: float = 0.0) -> None:
    """Both antennae swing to the sides and up and down, not in step: by up to `reach` degrees, from `drop` degrees lower."""
    for side, sign in _SIDES:
        late = 0.0 if sign < 0 else 0.37
        swing = m.wave(cycles, late) + 0.45 * m.wave(2 * cycles + 1, 2 * late) + still
        lift = m.wave(cycles, late + 0.28) + 0.5 * m.wave(cycles + 1, late)
        m.turn(f"scape_{side}", Z, reach * 0.45 * lift - drop)
        m.turn(f"scape_{side}", Y, -sign * reach * 0.6 * swing)
        m.turn(f"funiculus_{side}", Z, reach * 0.5 * m.wave(cycles + 1, late + 0.6) - 0.3 * drop)
        m.turn(f"funiculus_{side}", Y, -sign * reach * 0.35 * m.wave(cycles, late + 0.4))
        m.turn(f"club_{side}", Z, -8.0 + reach * 0.5 * m.wave(cycles + 1, late + 0.45))


def _jaws(m: Motion, degrees: Array | float) -> None:
    """Opens both mandibles by degrees."""
    for side, sign in _SIDES:
        m.turn(f"mandible_{side}", Y, -sign * np.asarray(degrees))


def _bow(m: Motion, degrees: float) -> float:
    """So many degrees of a worker's head; fewer of a longer one, whose jaws reach the ground sooner."""
    return degrees * min(1.0, _REACH / float(np.linalg.norm(m.rest("load") - m.rest("head")))) ** 2


def _breath(m: Motion, cycles: int, by: float = 0.018) -> None:
    m.swell("gaster", 1.0 + by * m.wave(cycles))
    m.turn("gaster", Z, 1.2 * m.wave(cycles, 0.2))


def _stand(m: Motion, without: tuple[str, ...] = ()) -> None:
    """Puts the feet of all legs but some where they are in the rest pose."""
    for chain in CHAINS:
        if chain.upper.removeprefix("femur_") not in without:
            m.reach(chain, np.broadcast_to(m.rest(chain.tip), (m.samples, 3)))


def _going(rig: Rig, number: int, bob: float) -> Motion:
    """One cycle of a gait, feet on the ground going back as fast as the body goes ahead."""
    gait = ant_rig.GAITS[number]
    m = Motion(rig, gait.stride / gait.speed, FAST)
    m.move("thorax", Y, bob * m.wave(2, 0.1))
    m.turn("thorax", Y, 1.6 * m.wave(1, 0.1))
    m.turn("thorax", X, 1.2 * m.wave(1, 0.35))
    m.turn("head", Y, -1.6 * m.wave(1, 0.1))
    m.turn("petiole", Y, -2.0 * m.wave(1, 0.05))
    m.turn("gaster", Z, 1.5 * m.wave(2, 0.3))
    return m


def idle(rig: Rig) -> Clip:
    """Stands: feelers sway, it looks about, the gaster breathes, once it shifts its weight."""
    m = Motion(rig, 6.0)
    _breath(m, 5)
    _feelers(m, 22.0, 2)
    m.turn("head", Y, m.keys((0, 0), (0.14, 14), (0.30, 14), (0.44, -9), (0.66, -11), (0.80, 4), (1, 0)))
    m.turn("head", Z, m.keys((0, 0), (0.16, 5), (0.34, -3), (0.6, 3), (1, 0)))
    m.move("thorax", Z, m.keys((0, 0), (0.40, 0), (0.52, 0.008), (0.84, 0.008), (1, 0)))
    m.move("thorax", Y, 0.003 * m.wave(3) - m.keys((0, 0), (0.42, 0.006), (0.80, 0.004), (1, 0)))
    _jaws(m, m.keys((0, 0), (0.55, 0), (0.62, 9), (0.70, 0), (1, 0)))
    _stand(m)
    return m.clip("idle")


def walk(rig: Rig) -> Clip:
    m = _going(rig, 1, 0.004)
    _feelers(m, 12.0, 1)
    steps(m, ant_rig.GAITS[1], CHAINS)
    return m.clip("walk", stride=ant_rig.GAITS[1].stride, marks={"left": 0.0, "right": 0.5})


def run(rig: Rig) -> Clip:
    m = _going(rig, 2, 0.007)
    m.turn("gaster", Z, -9.0)
    m.turn("head", Z, 4.0)
    _feelers(m, 9.0, 1, drop=-6.0)
    steps(m, ant_rig.GAITS[2], CHAINS)
    return m.clip("run", stride=ant_rig.GAITS[2].stride, marks={"left": 0.0, "right": 0.5})


def carry(rig: Rig) -> Clip:
    """Walks with its head up and its jaws about a load."""
    m = _going(rig, 1, 0.004)
    m.turn("head", Z, 15.0 + 1.0 * m.wave(2))
    m.turn("thorax", Z, 2.0)
    m.turn("gaster", Z, 6.0)
    _jaws(m, 17.0)
    _feelers(m, 7.0, 1, drop=-16.0, still=0.9)
    steps(m, ant_rig.GAITS[1], CHAINS)
    return m.clip("carry", stride=ant_rig.GAITS[1].stride, marks={"left": 0.0, "right": 0.5})


def take(rig: Rig) -> Clip:
    """Bends down, opens its jaws and bites: the mark is where they close."""
    m = Motion(rig, 0.9)
    down = m.keys((0, 0), (0.35, 1), (0.60, 1), (1, 0))
    m.turn("thorax", Z, -9.0 * down)
    m.move("thorax", Y, -0.020 * down)
    m.turn("head", Z, -_bow(m, 15.0) * down + 15.0 * m.keys((0, 0), (0.60, 0), (1, 1)))
    _jaws(m, m.keys((0, 0), (0.35, 34), (0.48, 36), (0.56, 15), (1, 17)))
    _feelers(m, 9.0, 1, drop=-12.0 * down)
    _stand(m)
    return m.clip("take", loop=False, marks={"bite": 0.56})


def drop(rig: Rig) -> Clip:
    """Puts down what it carries: the mark is where the jaws open."""
    m = Motion(rig, 0.8)
    down = m.keys((0, 0), (0.40, 1), (0.62, 1), (1, 0))
    m.turn("thorax", Z, -8.0 * down)
    m.move("thorax", Y, -0.016 * down)
    m.turn("head", Z, -_bow(m, 15.0) * down + 15.0 * m.keys((0, 1), (0.4, 0), (1, 0)))
    _jaws(m, m.keys((0, 17), (0.48, 17), (0.60, 34), (0.8, 10), (1, 0)))
    _feelers(m, 9.0, 1, drop=-12.0 * down)
    _stand(m)
    return m.clip("drop", loop=False, marks={"drop": 0.55})


def dig(rig: Rig) -> Clip:
    """Scratches with its forelegs in turn and bites into the ground."""
    m = Motion(rig, 1.2)
    nod = m.wave(2, 0.1)
    m.turn("thorax", Z, -8.0 + 2.0 * nod)
    m.move("thorax", Y, -0.012 + 0.004 * nod)
    m.turn("head", Z, -_bow(m, 20.0) + 8.0 * nod)
    m.turn("head", Y, 6.0 * m.wave(1))
    m.turn("gaster", Z, -12.0)
    _jaws(m, 16.0 - 15.0 * m.wave(2, 0.35))
    _feelers(m, 10.0, 2, drop=-10.0)
    for chain, late in zip(CHAINS[:2], (0.0, 0.5), strict=True):
        place = m.rest(chain.tip) * np.array([1.0, 1.0, 0.55])
        turn = 2 * np.pi * (2 * m.phase + late)
        circle = np.stack([0.065 * np.cos(turn) - 0.01, 0.030 * (1 + np.sin(turn)), 0.012 * np.sin(turn)], 1)
        m.reach(chain, place + circle, level=0.6)
    _stand(m, ("l1", "r1"))
    return m.clip("dig", marks={"bite": 0.30}, feet=False)


def look(rig: Rig) -> Clip:
    """Rises in front, sweeps its feelers through the air, looks to both sides and comes down."""
    m = Motion(rig, 2.4)
    up = m.keys((0, 0), (0.22, 1), (0.74, 1), (1, 0))
    m.turn("thorax", Z, 13.0 * up)
    m.move("thorax", Y, 0.022 * up)
    m.turn("head", Z, 12.0 * up)
    m.turn("head", Y, m.keys((0, 0), (0.25, 0), (0.38, 24), (0.50, 22), (0.66, -24), (0.76, -20), (1, 0)))
    m.turn("gaster", Z, -8.0 * up)
    _feelers(m, 24.0, 3, drop=-18.0)
    _breath(m, 2)
    _stand(m)
    return m.clip("look", loop=False, marks={"up": 0.25})


def groom(rig: Rig) -> Clip:
    """Draws its feelers through its forelegs, the right and then the left."""
    m = Motion(rig, 3.2)
    busy = m.keys((0, 0), (0.10, 1), (0.90, 1), (1, 0))
    m.turn("thorax", Z, 5.0 * busy)
    m.turn("head", Z, -15.0 * busy)
    m.turn("head", X, m.keys((0, 0), (0.12, -10), (0.45, -10), (0.57, 10), (0.88, 10), (1, 0)))
    _breath(m, 3)
    for side, sign in _SIDES:
        times = (0.06, 0.16, 0.42, 0.52) if sign > 0 else (0.50, 0.60, 0.86, 0.96)
        mine = m.keys((0, 0), (times[0], 0), (times[1], 1), (times[2], 1), (times[3], 0), (1, 0))
        draw = 0.5 - 0.5 * np.cos(2 * np.pi * 7 * m.phase)  # from the root to the tip of the feeler
        m.turn(f"scape_{side}", Z, -34.0 * mine)
        m.turn(f"scape_{side}", Y, sign * 24.0 * mine)
        m.turn(f"funiculus_{side}", Z, (-38.0 + 26.0 * draw) * mine)
        m.turn(f"club_{side}", Z, -12.0 * draw * mine)
        chain = CHAINS[0 if side == "l" else 1]
        rest = m.rest(chain.tip)
        face = np.stack([0.40 + 0.07 * draw, 0.150 - 0.055 * draw, sign * (0.058 - 0.012 * draw)], 1)
        m.reach(chain, rest + (face - rest) * mine[:, None], level=0.5)
    _stand(m, ("l1", "r1"))
    return m.clip("groom", feet=False)


def antennate(rig: Rig) -> Clip:
    """Drums with its feelers on what is ahead, another ant or a find."""
    m = Motion(rig, 1.2)
    on = m.keys((0, 0), (0.15, 1), (0.85, 1), (1, 0))
    m.turn("head", Z, -4.0 * on + 2.0 * m.wave(3) * on)
    m.move("thorax", X, 0.012 * on)
    for side, sign in _SIDES:
        beat = m.wave(8, 0.0 if sign < 0 else 0.5)
        m.turn(f"scape_{side}", Z, (-20.0 + 7.0 * beat) * on)
        m.turn(f"scape_{side}", Y, sign * 26.0 * on)
        m.turn(f"funiculus_{side}", Z, (6.0 + 16.0 * beat) * on)
        m.turn(f"club_{side}", Z, 8.0 * m.wave(8, 0.2 if sign < 0 else 0.7) * on)
    _jaws(m, 6.0 * on)
    _stand(m)
    return m.clip("antennate", marks={"touch": 0.15})


def die(rig: Rig) -> Clip:
    """Staggers, falls on its side, rolls on its back and draws in its legs."""
    m = Motion(rig, 2.8)
    fall = m.keys((0, 0), (0.20, 0.08), (0.42, 0.75), (0.55, 0.66), (0.80, 1), (1, 1))
    curl = m.keys((0, 0), (0.28, 0.10), (0.75, 1), (0.86, 0.92), (1, 1))
    below = m.keys((0, 0), (0.08, 0.15), (0.28, 1), (1, 1))  # the legs that it rolls over give way first
    m.turn("thorax", X, 168.0 * fall)
    m.move("thorax", Y, -0.088 * m.keys((0, 0), (0.3, 0.8), (0.5, 0.9), (0.8, 1), (1, 1)))
    m.move("thorax", Z, 0.10 * fall)
    m.turn("head", Z, -18.0 * curl)
    m.turn("gaster", Z, 5.0 * curl)
    m.turn("gaster_tip", Z, 14.0 * curl)
    for side, sign in _SIDES:
        m.turn(f"scape_{side}", Z, -26.0 * curl)
        m.turn(f"funiculus_{side}", Z, -40.0 * curl)
        for number, spread in ((1, 10.0), (2, 0.0), (3, -12.0)):
            late = np.clip((curl if sign < 0 else below) * 1.15 - 0.05 * number, 0, 1)
            twitch = 7.0 * m.wave(9, 0.17 * number + 0.3 * sign) * (1 - curl) * m.keys((0, 0), (0.25, 0.2), (0.5, 1), (1, 0))
            m.turn(f"femur_{side}{number}", X, sign * (-24.0 * late) + sign * twitch)
            m.turn(f"femur_{side}{number}", Y, sign * spread * late)
            m.turn(f"tibia_{side}{number}", X, sign * (52.0 * late))
            m.turn(f"tarsus_{side}{number}", X, sign * (34.0 * late))
    m.above_ground("thorax")
    return m.clip("die", loop=False, marks={"down": 0.42}, feet=False)


CLIPS: tuple[Callable[[Rig], Clip], ...] = (idle, walk, run, carry, take, drop, dig, look, groom, antennate, die)
