"""A spider: two parts of the body on eight long legs, the abdomen in the colour of the state."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from antdsl.bodies.agents.clip import Clip
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.legs import Gait
from antdsl.bodies.agents.rig import Rig
from antdsl.bodies.library.hair import hairs
from antdsl.bodies.library.insect_legs import SIDES, Joints, chains_of, crowd_leg, fine_leg, leg_joints, legs_of
from antdsl.bodies.library.lazy_shapes import layered
from antdsl.bodies.library.modelling import Model, bands, profile, rig_of
from antdsl.bodies.library.motions import FAST, Motion, X, Y, Z, steps
from antdsl.bodies.library.surfaces import Point, Surface, ellipsoid, limb, loft


def _leg(turn: float, long: float) -> Joints:
    """A right leg that points `turn` degrees from ahead, `long` from hip to claw over the ground."""
    x, z = float(np.cos(np.radians(turn))), float(np.sin(np.radians(turn)))

    def at(far: float, high: float) -> Point:
        return (0.17 + far * x, high, far * z)

    return (
        at(0.13, 0.20),
        at(0.20, 0.20),
        at(0.20 + 0.33 * long, 0.20 + 0.34 * long),
        at(0.20 + 0.80 * long, 0.04),
        at(0.20 + long, 0.0),
    )


LEGS: tuple[Joints, ...] = (_leg(32, 0.98), _leg(68, 0.90), _leg(108, 0.78), _leg(146, 0.98))
JOINTS: dict[str, tuple[str, Point]] = {
    "root": ("", (0.0, 0.0, 0.0)),
    "thorax": ("root", (0.17, 0.21, 0.0)),
    "abdomen": ("thorax", (0.0, 0.215, 0.0)),
    **{f"fang_{side}": ("thorax", (0.375, 0.185, sign * 0.035)) for side, sign in SIDES},
    **{f"palp_{side}": ("thorax", (0.355, 0.19, sign * 0.085)) for side, sign in SIDES},
    **leg_joints(LEGS, "thorax"),
}
# Two sets of four: first and third of one side with second and fourth of the other, hind ones a little before.
_TETRAPOD = (0.04, 0.54, 0.50, 0.00, 0.02, 0.52, 0.48, 0.98)
GAITS = (
    Gait("slow", 0.3, 0.42, 0.72, 0.08, (0.75, 0.25, 0.50, 0.0, 0.25, 0.75, 0.0, 0.5)),
    Gait("tetrapod", 1.2, 0.80, 0.60, 0.10, _TETRAPOD),
    Gait("run", 3.6, 1.30, 0.46, 0.13, _TETRAPOD),
)
MATERIALS = {
    "thorax": (0.10, 0.062, 0.034),
    "leg": (0.085, 0.050, 0.026),
    "joint": (0.15, 0.095, 0.050),
    "jaw": (0.02, 0.010, 0.008),
    "mark": (0.045, 0.026, 0.015),
    "eye": (0.004, 0.004, 0.005),
    "hair": (0.20, 0.14, 0.085),
}


def spider() -> Definition:
    rig = rig_of(JOINTS)

    shapes, layers = layered("spider", JOINTS, _body)
    return Definition(
        "spider",
        rig,
        shapes,
        layers,
        {clip.name: clip for clip in (make(rig) for make in CLIPS)},
        materials=MATERIALS,
        length=1.0,
        unit=12.0,
        legs=legs_of(4),
        gaits=GAITS,
        idle="idle",
    )


def _along(keys: tuple[tuple[float, float, float, float], ...], rings: int, sides: int) -> Surface:
    rows = profile(keys, rings)
    return loft(np.stack([-rows[:, 0], rows[:, 1], np.zeros(rings)], 1), rows[:, 2], rows[:, 3], sides)


def _body(model: Model, fine: bool) -> None:
    rings, sides = (30, 24) if fine else (5, 7)
    front = (
        (-0.40, 0.195, 0.030, 0.050),
        (-0.37, 0.205, 0.075, 0.085),
        (-0.27, 0.218, 0.088, 0.130),
        (-0.12, 0.214, 0.072, 0.150),
        (-0.01, 0.208, 0.030, 0.055),
        (0.005, 0.208, 0.012, 0.022),
    )
    thorax = _along(front, rings, sides)
    model.add(thorax, "thorax", bands(["thorax", "mark", "thorax"], [0.62, 0.78]), "thorax")
    hind = (
        (-0.03, 0.212, 0.014, 0.018),
        (0.01, 0.222, 0.070, 0.075),
        (0.13, 0.255, 0.160, 0.165),
        (0.28, 0.255, 0.175, 0.180),
        (0.42, 0.225, 0.115, 0.115),
        (0.49, 0.200, 0.045, 0.042),
        (0.51, 0.195, 0.012, 0.012),
    )
    abdomen = _along(hind, rings, sides)
    model.add(abdomen, "abdomen", "state", "abdomen")
    fang = [(0.355, 0.190, 0.035), (0.405, 0.165, 0.038), (0.415, 0.105, 0.034), (0.400, 0.065, 0.022)]
    model.both(
        loft(fang, [0.034, 0.034, 0.020, 0.004], [0.034, 0.034, 0.020, 0.004], 10 if fine else 3),
        "fang_r",
        bands(["thorax", "jaw"], [0.66]),
        "fang",
    )
    palp = [(0.34, 0.195, 0.085), (0.42, 0.235, 0.115), (0.475, 0.150, 0.110), (0.505, 0.085, 0.095)]
    model.both(
        limb(palp, [0.018, 0.018, 0.016, 0.020], 8, 12) if fine else loft(palp, [0.018] * 4, [0.018] * 4, 3),
        "palp_r",
        "leg",
        "palp",
    )
    if fine:
        for x, y, z, size in (
            (0.388, 0.262, 0.022, 0.017),
            (0.392, 0.238, 0.052, 0.011),
            (0.355, 0.278, 0.040, 0.010),
            (0.320, 0.290, 0.058, 0.010),
        ):
            model.both(ellipsoid((x, y - 0.008, z), (size,) * 3, 1), "thorax", "eye", "eye")
        model.both(
            loft([(-0.47, 0.19, 0.022), (-0.53, 0.18, 0.026)], [0.016, 0.006], [0.016, 0.006], 6), "abdomen", "mark", "spinneret"
        )
        hairs(model, abdomen, "abdomen", 260, 0.050, seed=31, lean=(-0.9, 0.2, 0.0))
        hairs(model, thorax, "thorax", 90, 0.032, seed=32, where=lambda p, n: n[:, 1] > 0)
    for number, points in enumerate(LEGS, 1):
        if fine:
            fine_leg(model, number, points, 1.7, spines=12)
        else:
            crowd_leg(model, number, points, 1.5)


CHAINS = chains_of(4)


def _stand(m: Motion, without: int = 0) -> None:
    for chain in CHAINS[without:]:
        m.reach(chain, np.broadcast_to(m.rest(chain.tip), (m.samples, 3)))


def _palps(m: Motion, by: float, cycles: int) -> None:
    for side, sign in SIDES:
        m.turn(f"palp_{side}", Z, by * m.wave(cycles, 0.25 * sign))
        m.turn(f"palp_{side}", Y, by * 0.6 * m.wave(cycles, 0.1 + 0.25 * sign))
        m.turn(f"fang_{side}", Z, 0.3 * by * m.wave(cycles, 0.4))


def idle(rig: Rig) -> Clip:
    """Waits: the palps tap, a foreleg feels ahead, the abdomen breathes."""
    m = Motion(rig, 6.0)
    m.move("thorax", Y, 0.006 * m.wave(2))
    m.swell("abdomen", 1 + 0.012 * m.wave(4))
    m.turn("abdomen", Z, 1.5 * m.wave(2, 0.3))
    _palps(m, 9.0, 5)
    for chain, when in zip(CHAINS[:2], (0.15, 0.60), strict=True):
        up = m.keys((0, 0), (when, 0), (when + 0.06, 1), (when + 0.16, 0.5), (when + 0.22, 1), (when + 0.3, 0), (1, 0))
        m.reach(chain, m.rest(chain.tip) + up[:, None] * np.array([0.08, 0.16, 0.0]))
    _stand(m, 2)
    return m.clip("idle")


def _going(name: str, number: int) -> Callable[[Rig], Clip]:
    def going(rig: Rig) -> Clip:
        gait = GAITS[number]
        m = Motion(rig, gait.stride / gait.speed, FAST)
        m.move("thorax", Y, 0.008 * m.wave(2, 0.1))
        m.turn("thorax", Y, 1.5 * m.wave(1, 0.1))
        m.turn("abdomen", Y, -2.5 * m.wave(1, 0.05))
        _palps(m, 5.0, 1)
        steps(m, gait, CHAINS)
        return m.clip(name, stride=gait.stride, marks={"left": 0.0, "right": 0.5})

    return going


def threaten(rig: Rig) -> Clip:
    """Rears up with its forelegs raised and its fangs open."""
    m = Motion(rig, 2.6)
    up = m.keys((0, 0), (0.16, 1.06), (0.26, 1), (0.75, 1), (1, 0))
    m.turn("thorax", Z, 26.0 * up)
    m.move("thorax", Y, 0.05 * up)
    m.turn("abdomen", Z, -20.0 * up)
    for side, sign in SIDES:
        m.turn(f"fang_{side}", Z, 30.0 * up)
        m.turn(f"palp_{side}", Z, 35.0 * up)
        m.turn(f"palp_{side}", Y, -sign * 15.0 * up)
    for chain, sign in zip(CHAINS[:2], (-1.0, 1.0), strict=True):
        rest = m.rest(chain.tip)
        sway = 0.06 * m.wave(3, 0.15 * sign) * up
        high = np.stack([0.75 + 0.4 * sway, 1.05 + sway, sign * 0.62 + 0 * sway], 1)
        m.reach(chain, rest + (high - rest) * np.clip(up, 0, 1)[:, None], level=0)
    _stand(m, 2)
    return m.clip("threaten", loop=False, marks={"up": 0.18}, feet=False)


def die(rig: Rig) -> Clip:
    """Sinks and draws in all its legs below itself."""
    m = Motion(rig, 2.2)
    curl = m.keys((0, 0), (0.5, 1), (0.6, 0.93), (0.8, 1), (1, 1))
    m.turn("thorax", X, 172.0 * m.keys((0, 0), (0.3, 0.05), (0.75, 1), (1, 1)))
    m.move("thorax", Y, -0.04 * curl)
    for side, sign in SIDES:
        for number in (1, 2, 3, 4):
            m.turn(f"femur_{side}{number}", X, sign * -26.0 * curl)
            m.turn(f"tibia_{side}{number}", X, sign * 72.0 * curl)
            m.turn(f"tarsus_{side}{number}", X, sign * 24.0 * curl)
    m.above_ground("thorax")
    return m.clip("die", loop=False, marks={"down": 0.7}, feet=False)


CLIPS: tuple[Callable[[Rig], Clip], ...] = (idle, _going("walk", 1), _going("run", 2), threaten, die)
