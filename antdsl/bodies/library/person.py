"""A person who walks, runs, stands and waves, in a shirt of the state's colour.

Lengths are metres; `size` is half a metre, about as wide as the shoulders."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from antdsl.bodies.agents.clip import Clip
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.layer import TransformGroup
from antdsl.bodies.agents.legs import Gait, Leg
from antdsl.bodies.agents.rig import Rig
from antdsl.bodies.library.lazy_shapes import layered
from antdsl.bodies.library.modelling import Model, bands, rig_of
from antdsl.bodies.library.motions import FAST, Chain, Motion, X, Y, Z, steps
from antdsl.bodies.library.surfaces import Point, ellipsoid
from antdsl.bodies.library.vertebrates import Row, mirrored, places, swept

LENGTH = 0.5
JOINTS: dict[str, tuple[str, Point]] = mirrored({
    "root": ("", (0.0, 0.0, 0.0)),
    "hips": ("root", (0.0, 0.930, 0.0)),
    "spine": ("hips", (0.0, 1.080, 0.0)),
    "chest": ("spine", (-0.010, 1.230, 0.0)),
    "neck": ("chest", (-0.010, 1.470, 0.0)),
    "head": ("neck", (0.005, 1.560, 0.0)),
    "arm_r": ("chest", (-0.010, 1.420, 0.185)),
    "forearm_r": ("arm_r", (-0.015, 1.140, 0.225)),
    "hand_r": ("forearm_r", (0.010, 0.890, 0.235)),
    "thigh_r": ("hips", (0.0, 0.900, 0.095)),
    "shin_r": ("thigh_r", (0.018, 0.490, 0.098)),
    "foot_r": ("shin_r", (-0.010, 0.085, 0.098)),
    "ball_r": ("foot_r", (0.120, 0.0, 0.105)),
})  # fmt: skip
LEGS = tuple(Leg(side, f"thigh_{side}", f"shin_{side}", f"ball_{side}") for side in "lr")
CHAINS = tuple(Chain(leg.upper, leg.lower, f"foot_{leg.name}", leg.foot) for leg in LEGS)
GAITS = (
    Gait("stroll", 0.6, 0.90, 0.66, 0.06, (0.0, 0.5)),
    Gait("walk", 1.35, 1.38, 0.60, 0.08, (0.0, 0.5)),
    Gait("run", 3.6, 2.35, 0.34, 0.16, (0.0, 0.5)),
)
MATERIALS = {
    "skin": (0.47, 0.27, 0.18), "trousers": (0.045, 0.055, 0.085), "shoe": (0.022, 0.018, 0.016), "hair": (0.030, 0.018, 0.011),
    "eye": (0.010, 0.008, 0.008), "sole": (0.28, 0.26, 0.24),
}  # fmt: skip

# Up from the crotch to the neck; half the depth, half the width.
TORSO: tuple[Row, ...] = (
    (0.0, 0.840, 0.0, 0.020, 0.030), (0.0, 0.860, 0.0, 0.085, 0.120), (-0.005, 0.930, 0.0, 0.112, 0.168),
    (0.0, 1.040, 0.0, 0.098, 0.148), (0.0, 1.130, 0.0, 0.098, 0.145), (-0.005, 1.260, 0.0, 0.118, 0.168),
    (-0.010, 1.360, 0.0, 0.108, 0.176), (-0.012, 1.420, 0.0, 0.078, 0.150), (-0.012, 1.455, 0.0, 0.062, 0.085),
    (-0.010, 1.475, 0.0, 0.050, 0.054), (-0.008, 1.480, 0.0, 0.020, 0.020),
)  # fmt: skip
NECK: tuple[Row, ...] = (
    (-0.012, 1.430, 0.0, 0.040, 0.040), (-0.008, 1.480, 0.0, 0.052, 0.052), (0.000, 1.530, 0.0, 0.050, 0.049),
    (0.005, 1.580, 0.0, 0.046, 0.045), (0.006, 1.595, 0.0, 0.010, 0.010),
)  # fmt: skip
HEAD: tuple[Row, ...] = (
    (0.048, 1.530, 0.0, 0.012, 0.014), (0.040, 1.540, 0.0, 0.046, 0.040), (0.020, 1.585, 0.0, 0.082, 0.062),
    (0.008, 1.645, 0.0, 0.096, 0.073), (0.000, 1.700, 0.0, 0.097, 0.075), (-0.004, 1.745, 0.0, 0.074, 0.058),
    (-0.006, 1.765, 0.0, 0.020, 0.016),
)  # fmt: skip
HAIR: tuple[Row, ...] = (
    (-0.052, 1.580, 0.0, 0.020, 0.030), (-0.040, 1.620, 0.0, 0.066, 0.072), (-0.022, 1.690, 0.0, 0.090, 0.082),
    (-0.008, 1.740, 0.0, 0.086, 0.070), (-0.006, 1.775, 0.0, 0.050, 0.040), (-0.006, 1.784, 0.0, 0.010, 0.010),
)  # fmt: skip
ARM: tuple[Row, ...] = (
    (-0.010, 1.440, 0.145, 0.034, 0.020), (-0.010, 1.425, 0.180, 0.062, 0.050), (-0.012, 1.330, 0.200, 0.054, 0.048),
    (-0.014, 1.200, 0.218, 0.046, 0.042), (-0.015, 1.140, 0.225, 0.042, 0.040), (-0.004, 1.060, 0.230, 0.043, 0.039),
    (0.010, 0.905, 0.235, 0.028, 0.024), (0.012, 0.880, 0.235, 0.016, 0.014),
)  # fmt: skip
LEG: tuple[Row, ...] = (
    (-0.002, 0.965, 0.082, 0.040, 0.030), (-0.004, 0.900, 0.096, 0.100, 0.082), (0.004, 0.740, 0.100, 0.086, 0.078),
    (0.016, 0.540, 0.099, 0.062, 0.058), (0.018, 0.490, 0.098, 0.058, 0.054), (0.006, 0.400, 0.098, 0.058, 0.053),
    (-0.004, 0.230, 0.098, 0.048, 0.046), (-0.010, 0.105, 0.098, 0.046, 0.046), (-0.010, 0.080, 0.098, 0.030, 0.030),
)  # fmt: skip
SHOE: tuple[Row, ...] = (
    (-0.082, 0.050, 0.098, 0.012, 0.012), (-0.070, 0.055, 0.098, 0.042, 0.034), (-0.015, 0.060, 0.098, 0.056, 0.040),
    (0.060, 0.045, 0.101, 0.042, 0.042), (0.130, 0.034, 0.106, 0.031, 0.046), (0.180, 0.030, 0.107, 0.025, 0.038),
    (0.200, 0.026, 0.107, 0.008, 0.014),
)  # fmt: skip


def person() -> Definition:
    rig = rig_of(JOINTS)
    shapes, layers = layered("person", JOINTS, _body)
    groups = {
        "arms": tuple(f"{name}_{side}" for side in "lr" for name in ("arm", "forearm", "hand")),
        "arm": ("arm_r", "forearm_r", "hand_r"),
        "head": ("neck", "head"),
    }
    return Definition(
        "person", rig, shapes, layers, {clip.name: clip for clip in (make(rig) for make in CLIPS)},
        {name: TransformGroup(name, tuple((joint, 1.0) for joint in members)) for name, members in groups.items()},
        materials=MATERIALS, length=LENGTH, unit=1000.0, legs=LEGS, gaits=GAITS, idle="idle",
    )  # fmt: skip


def _body(model: Model, fine: bool) -> None:

    def n(many: int, few: int) -> int:
        return many if fine else few

    front = (1.0, 0.0, 0.0)
    follows = places(TORSO, (1, "hips"), (2, "hips"), (4, "spine"), (5, "chest"), (8, "chest"), (10, "neck"))
    model.add(swept(TORSO, n(52, 7), n(30, 8), front, 0.9), follows, bands(["trousers", "state"], [0.24]), "torso")
    model.add(swept(NECK, n(14, 4), n(18, 5), front), places(NECK, (1, "neck"), (3, "head")), "skin", "neck")
    model.add(swept(HEAD, n(36, 5), n(26, 6), front), "head", "skin", "face")
    model.add(swept(HAIR, n(26, 5), n(24, 6), front), "head", "hair", "hair")
    model.both(
        swept(ARM, n(36, 6), n(18, 5), front),
        places(ARM, (0, "chest"), (1, "arm_r"), (3, "arm_r"), (5, "forearm_r"), (6, "forearm_r"), (7, "hand_r")),
        bands(["state", "skin"], [0.40]),
        "arm",
    )
    hand: tuple[Row, ...] = (
        (0.010, 0.910, 0.235, 0.018, 0.014),
        (0.014, 0.870, 0.236, 0.034, 0.017),
        (0.020, 0.820, 0.236, 0.040, 0.018),
        (0.026, 0.760, 0.233, 0.030, 0.014),
        (0.030, 0.725, 0.230, 0.008, 0.006),
    )
    model.both(swept(hand, n(14, 4), n(14, 4), front), "hand_r", "skin", "hand")
    model.both(
        swept(LEG, n(44, 6), n(20, 5), front),
        places(LEG, (0, "hips"), (1, "thigh_r"), (3, "thigh_r"), (5, "shin_r"), (7, "shin_r"), (8, "foot_r")),
        "trousers",
        "leg",
    )
    shoe = swept(SHOE, n(24, 5), n(18, 5))
    points = shoe.points.copy()
    points[:, 1] = np.maximum(points[:, 1], 0.002 + 0.15 * np.maximum(points[:, 0] - 0.14, 0.0))
    model.both(shoe.moved(points), places(SHOE, (3, "foot_r"), (5, "ball_r")), "shoe", "shoe")
    if fine:
        nose: tuple[Row, ...] = (
            (0.088, 1.680, 0.0, 0.004, 0.006),
            (0.104, 1.650, 0.0, 0.012, 0.012),
            (0.118, 1.625, 0.0, 0.013, 0.017),
            (0.104, 1.610, 0.0, 0.006, 0.010),
        )
        model.add(swept(nose, 12, 12, front), "head", "skin", "nose")
        model.both(ellipsoid((0.088, 1.668, 0.030), (0.012, 0.011, 0.015), 2), "head", "eye", "eye")
        ear: tuple[Row, ...] = (
            (0.0, 1.620, 0.074, 0.006, 0.006),
            (0.002, 1.640, 0.080, 0.018, 0.008),
            (-0.004, 1.670, 0.082, 0.022, 0.008),
            (-0.006, 1.690, 0.078, 0.006, 0.004),
        )
        model.both(swept(ear, 10, 10, front), "head", "skin", "ear")
        thumb: tuple[Row, ...] = (
            (0.030, 0.875, 0.230, 0.010, 0.010),
            (0.052, 0.845, 0.222, 0.012, 0.012),
            (0.064, 0.805, 0.216, 0.010, 0.010),
            (0.066, 0.790, 0.214, 0.003, 0.003),
        )
        model.both(swept(thumb, 10, 8, front), "hand_r", "skin", "thumb")


def _going(
    name: str, number: int, lean: float, arms: float, elbows: float, off: float, on: float, drop: float, bounce: float
) -> Callable[[Rig], Clip]:
    def going(rig: Rig) -> Clip:
        gait = GAITS[number]
        m = Motion(rig, gait.stride / gait.speed, FAST if number == 2 else 45.0)
        middle = -gait.duty / 2
        step = m.wave(1, 0.25 + middle)  # 1 where the left foot is under the body
        swing = m.wave(1, 0.5 + middle)
        m.move("hips", Y, -drop + bounce * np.cos(4 * np.pi * (m.phase + middle)) * (1 if gait.duty > 0.5 else -1))
        m.move("hips", Z, -0.018 * step * (gait.duty > 0.5))
        m.turn("hips", Y, -5.0 * swing)
        m.turn("hips", X, -2.5 * step)
        m.turn("spine", Y, 6.0 * swing)
        m.turn("chest", Y, 6.0 * swing)
        m.turn("spine", Z, -lean)
        m.turn("neck", Z, 0.7 * lean)
        m.turn("head", Y, -5.0 * swing)
        for side, sign in (("l", -1.0), ("r", 1.0)):
            m.turn(f"arm_{side}", Z, -sign * arms * swing)
            m.turn(f"arm_{side}", X, -sign * 3.0)
            m.turn(f"forearm_{side}", Z, elbows * (1 - 0.3 * sign * swing))
            m.turn(f"hand_{side}", Z, 6.0)
        steps(m, gait, CHAINS, off, on, 0.20, toes=True)
        return m.clip(name, stride=gait.stride, marks={"left": 0.0, "right": 0.5})

    return going


def _stand(m: Motion) -> None:
    for chain in CHAINS:
        m.reach(chain, np.broadcast_to(m.rest(chain.tip), (m.samples, 3)))


def _relaxed(m: Motion, sides: str = "lr") -> None:
    for side in sides:
        sign = 1.0 if side == "r" else -1.0
        m.turn(f"arm_{side}", Z, 2.0 * m.wave(2, 0.2 * sign))
        m.turn(f"forearm_{side}", Z, 12.0 + 2.0 * m.wave(1, 0.3 * sign))


def idle(rig: Rig) -> Clip:
    """Stands, breathes, shifts its weight from one leg to the other, looks about."""
    m = Motion(rig, 6.0)
    m.swell("chest", 1 + 0.010 * m.wave(3))
    shift = m.keys((0, -1), (0.40, -1), (0.52, 1), (0.88, 1), (1, -1))
    m.move("hips", Z, 0.030 * shift)
    m.move("hips", Y, -0.012)
    m.turn("hips", X, 2.2 * shift)
    m.turn("spine", X, -3.0 * shift)
    m.turn("neck", Y, m.keys((0, 0), (0.18, 20), (0.38, 18), (0.55, -16), (0.85, -12), (1, 0)))
    m.turn("head", Z, m.keys((0, 0), (0.3, -5), (0.6, 3), (1, 0)))
    _relaxed(m)
    _stand(m)
    return m.clip("idle")


def wave(rig: Rig) -> Clip:
    """The right arm goes up, and the forearm to and fro."""
    m = Motion(rig, 2.4)
    up = m.keys((0, 0), (0.20, 1), (0.80, 1), (1, 0))
    m.turn("arm_r", Z, 30.0 * up)
    m.turn("arm_r", X, -118.0 * up)
    m.turn("forearm_r", X, -(40.0 + 24.0 * m.wave(4)) * up)
    m.turn("forearm_r", Z, 12.0 * (1 - up))
    m.turn("spine", X, 4.0 * up)
    m.turn("head", Z, 5.0 * up)
    m.move("hips", Y, -0.012)
    _relaxed(m, "l")
    _stand(m)
    return m.clip("wave", loop=False, marks={"top": 0.5})


def die(rig: Rig) -> Clip:
    """The knees give way, it falls on its back."""
    m = Motion(rig, 2.0)
    sink = m.keys((0, 0), (0.35, 1), (0.6, 0.4), (1, 0.1))
    fall = m.keys((0, 0), (0.25, 0.12), (0.62, 1), (0.70, 0.96), (0.78, 1), (1, 1))
    m.turn("hips", Z, 88.0 * fall)
    m.move("hips", Y, -0.30 * sink * (1 - fall) - 0.800 * fall)
    m.move("hips", X, -0.10 * sink - 0.30 * fall)
    m.turn("neck", Z, -16.0 * sink)
    for side, sign in (("l", -1.0), ("r", 1.0)):
        m.turn(f"thigh_{side}", Z, 62.0 * sink + (9.0 if sign > 0 else 20.0) * fall)
        m.turn(f"shin_{side}", Z, -84.0 * sink - (10.0 if sign > 0 else 34.0) * fall)
        m.turn(f"foot_{side}", Z, 22.0 * sink - 30.0 * fall)
        m.turn(f"arm_{side}", X, -sign * 44.0 * fall)
        m.turn(f"forearm_{side}", Z, 26.0 * sink + 10.0 * fall)
    m.above_ground("hips")
    return m.clip("die", loop=False, marks={"down": 0.62}, feet=False)


CLIPS: tuple[Callable[[Rig], Clip], ...] = (
    idle,
    _going("walk", 1, 3.0, 24.0, 16.0, 46.0, 14.0, 0.022, 0.016),
    _going("run", 2, 9.0, 42.0, 82.0, 62.0, 4.0, 0.050, 0.030),
    wave,
    die,
)
