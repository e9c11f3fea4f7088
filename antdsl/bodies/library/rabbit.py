"""A rabbit: it hops, bounds, sits up to look, nibbles, and lies down dead."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from antdsl.bodies.agents.clip import Clip
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.layer import TransformGroup
from antdsl.bodies.agents.legs import Gait, Leg
from antdsl.bodies.agents.rig import Rig
from antdsl.bodies.library.lazy_shapes import layered
from antdsl.bodies.library.modelling import Model, rig_of
from antdsl.bodies.library.motions import FAST, Chain, Motion, X, Y, Z, steps
from antdsl.bodies.library.surfaces import Point, ellipsoid
from antdsl.bodies.library.vertebrates import Row, mirrored, places, swept

JOINTS: dict[str, tuple[str, Point]] = mirrored({
    "root": ("", (0.0, 0.0, 0.0)),
    "hips": ("root", (-0.240, 0.265, 0.0)),
    "spine": ("hips", (-0.080, 0.300, 0.0)),
    "chest": ("spine", (0.090, 0.265, 0.0)),
    "head": ("chest", (0.250, 0.375, 0.0)),
    "jaw": ("head", (0.330, 0.345, 0.0)),
    "ear1_r": ("head", (0.262, 0.465, 0.038)),
    "ear2_r": ("ear1_r", (0.225, 0.585, 0.055)),
    "tail": ("hips", (-0.430, 0.240, 0.0)),
    "upper_r1": ("chest", (0.165, 0.215, 0.068)),
    "lower_r1": ("upper_r1", (0.072, 0.138, 0.076)),
    "wrist_r1": ("lower_r1", (0.165, 0.046, 0.068)),
    "paw_r1": ("wrist_r1", (0.200, 0.0, 0.068)),
    "upper_r2": ("hips", (-0.255, 0.225, 0.085)),
    "lower_r2": ("upper_r2", (-0.090, 0.150, 0.125)),
    "wrist_r2": ("lower_r2", (-0.280, 0.050, 0.110)),
    "paw_r2": ("wrist_r2", (-0.140, 0.0, 0.112)),
})  # fmt: skip
NAMES = ("l1", "r1", "l2", "r2")
LEGS = tuple(Leg(name, f"upper_{name}", f"lower_{name}", f"paw_{name}") for name in NAMES)
CHAINS = tuple(Chain(leg.upper, leg.lower, f"wrist_{leg.name}", leg.foot) for leg in LEGS)
# Both hind legs push together; the forelegs come down one after the other before them.
GAITS = (
    Gait("hop", 1.0, 0.62, 0.55, 0.05, (0.42, 0.36, 0.0, 0.0)),
    Gait("bound", 5.5, 1.80, 0.20, 0.07, (0.48, 0.38, 0.0, 0.03)),
)
MATERIALS = {
    "belly": (0.60, 0.53, 0.44), "dark": (0.018, 0.012, 0.010), "inner": (0.48, 0.25, 0.20), "tail": (0.75, 0.72, 0.68),
    "paw": (0.42, 0.34, 0.26),
}  # fmt: skip

TORSO: tuple[Row, ...] = (
    (-0.440, 0.215, 0.0, 0.010, 0.010), (-0.425, 0.215, 0.0, 0.075, 0.070), (-0.360, 0.225, 0.0, 0.145, 0.125),
    (-0.250, 0.240, 0.0, 0.175, 0.148), (-0.100, 0.255, 0.0, 0.172, 0.140), (0.020, 0.250, 0.0, 0.152, 0.120),
    (0.105, 0.258, 0.0, 0.136, 0.108), (0.172, 0.285, 0.0, 0.112, 0.094), (0.224, 0.328, 0.0, 0.086, 0.080),
    (0.264, 0.372, 0.0, 0.064, 0.066), (0.286, 0.402, 0.0, 0.030, 0.030),
)  # fmt: skip
HEAD: tuple[Row, ...] = (
    (0.200, 0.385, 0.0, 0.014, 0.014), (0.215, 0.388, 0.0, 0.062, 0.058), (0.270, 0.398, 0.0, 0.090, 0.078),
    (0.335, 0.388, 0.0, 0.082, 0.072), (0.395, 0.366, 0.0, 0.058, 0.052), (0.440, 0.350, 0.0, 0.036, 0.034),
    (0.455, 0.346, 0.0, 0.010, 0.010),
)  # fmt: skip
EAR: tuple[Row, ...] = (
    (0.272, 0.440, 0.034, 0.014, 0.018), (0.262, 0.480, 0.040, 0.013, 0.034), (0.240, 0.550, 0.050, 0.013, 0.044),
    (0.215, 0.620, 0.060, 0.011, 0.040), (0.192, 0.680, 0.066, 0.007, 0.024), (0.182, 0.704, 0.068, 0.002, 0.004),
)  # fmt: skip
FORELEG: tuple[Row, ...] = (
    (0.160, 0.265, 0.050, 0.016, 0.014), (0.160, 0.222, 0.066, 0.050, 0.034), (0.078, 0.140, 0.076, 0.038, 0.028),
    (0.122, 0.088, 0.072, 0.026, 0.022), (0.165, 0.044, 0.068, 0.023, 0.021), (0.170, 0.016, 0.068, 0.016, 0.018),
)  # fmt: skip
HIND: tuple[Row, ...] = (
    (-0.310, 0.290, 0.060, 0.030, 0.016), (-0.255, 0.240, 0.090, 0.120, 0.046), (-0.150, 0.180, 0.120, 0.100, 0.046),
    (-0.085, 0.145, 0.126, 0.052, 0.034), (-0.170, 0.095, 0.118, 0.040, 0.028), (-0.275, 0.052, 0.110, 0.030, 0.026),
    (-0.300, 0.030, 0.110, 0.016, 0.018),
)  # fmt: skip


def rabbit() -> Definition:
    rig = rig_of(JOINTS)
    shapes, layers = layered("rabbit", JOINTS, _body)
    groups = {"head": ("head", "jaw", "ear1_l", "ear2_l", "ear1_r", "ear2_r"), "ears": ("ear1_l", "ear2_l", "ear1_r", "ear2_r")}
    return Definition(
        "rabbit", rig, shapes, layers, {clip.name: clip for clip in (make(rig) for make in CLIPS)},
        {name: TransformGroup(name, tuple((joint, 1.0) for joint in members)) for name, members in groups.items()},
        materials=MATERIALS, length=1.0, unit=400.0, legs=LEGS, gaits=GAITS, idle="idle",
    )  # fmt: skip


def _body(model: Model, fine: bool) -> None:

    def n(many: int, few: int) -> int:
        return many if fine else few

    follows = places(TORSO, (1, "hips"), (3, "hips"), (4, "spine"), (6, "chest"), (7, "chest"), (9, "head"))
    model.add(swept(TORSO, n(54, 7), n(28, 7)), follows, "state", "torso")
    model.add(swept(HEAD, n(36, 5), n(24, 6)), "head", "state", "head")
    muzzle: tuple[Row, ...] = (
        (0.375, 0.330, 0.0, 0.010, 0.020),
        (0.400, 0.332, 0.0, 0.030, 0.040),
        (0.440, 0.334, 0.0, 0.026, 0.030),
        (0.462, 0.338, 0.0, 0.006, 0.008),
    )
    model.add(swept(muzzle, n(14, 4), n(16, 4)), "jaw", "belly", "muzzle")
    model.add(ellipsoid((0.457, 0.356, 0.0), (0.010, 0.009, 0.013), n(2, 0)), "head", "inner", "nose")
    model.both(
        swept(EAR, n(22, 5), n(14, 4), up=(1.0, 0.0, 0.0)),
        places(EAR, (1, "ear1_r"), (2, "ear1_r"), (4, "ear2_r")),
        "state",
        "ear",
    )
    tail: tuple[Row, ...] = (
        (-0.415, 0.235, 0.0, 0.020, 0.020),
        (-0.440, 0.250, 0.0, 0.055, 0.050),
        (-0.490, 0.275, 0.0, 0.052, 0.048),
        (-0.530, 0.295, 0.0, 0.012, 0.012),
    )
    model.add(swept(tail, n(16, 4), n(16, 5)), "tail", "tail", "tail")
    for number, rows in ((1, FORELEG), (2, HIND)):
        above, upper, lower, wrist = (
            "chest" if number == 1 else "hips",
            f"upper_r{number}",
            f"lower_r{number}",
            f"wrist_r{number}",
        )
        bent = (0, above), (1, upper), (1 if number == 1 else 2, upper), (3, lower), (4, lower), (5, wrist)
        model.both(swept(rows, n(28, 5), n(16, 5), up=(1.0, 0.0, 0.0)), places(rows, *bent), "state", f"leg {number}")
        (x, _, z), long = JOINTS[f"paw_r{number}"][1], 0.060 if number == 1 else 0.170
        paw: tuple[Row, ...] = (
            (x - long, 0.030, z, 0.012, 0.012),
            (x - 0.85 * long, 0.030, z, 0.026, 0.024),
            (x - 0.1 * long, 0.021, z, 0.021, 0.027),
            (x + 0.030, 0.013, z, 0.011, 0.020),
            (x + 0.042, 0.010, z, 0.004, 0.006),
        )
        model.both(swept(paw, n(16, 4), n(14, 4)), wrist, "paw", f"paw {number}")
    if fine:
        model.both(ellipsoid((0.335, 0.418, 0.062), (0.021, 0.021, 0.015), 2), "head", "dark", "eye")
        inner: tuple[Row, ...] = (
            (0.276, 0.470, 0.042, 0.004, 0.010),
            (0.262, 0.520, 0.049, 0.006, 0.026),
            (0.232, 0.610, 0.061, 0.006, 0.026),
            (0.206, 0.675, 0.068, 0.003, 0.008),
        )
        model.both(
            swept(inner, 16, 10, up=(1.0, 0.0, 0.0)),
            places(inner, (0, "ear1_r"), (1, "ear1_r"), (2, "ear2_r")),
            "inner",
            "inner ear",
        )


def _ears(m: Motion, back: float = 0.0, twitch: float = 10.0) -> None:
    for side, sign in (("l", -1.0), ("r", 1.0)):
        late = 0.3 * sign
        m.turn(f"ear1_{side}", Z, back + 3.0 * m.wave(2, late))
        m.turn(f"ear1_{side}", Y, sign * twitch * np.maximum(m.wave(3, late), 0) ** 4)
        m.turn(f"ear2_{side}", Z, 4.0 * m.wave(2, late - 0.1))


def _nose(m: Motion, cycles: int) -> None:
    m.turn("jaw", Z, 2.5 * m.wave(cycles))


def _stand(m: Motion, without: int = 0) -> None:
    for chain in CHAINS[without:]:
        m.reach(chain, np.broadcast_to(m.rest(chain.tip), (m.samples, 3)))


def idle(rig: Rig) -> Clip:
    """Sits: the nose twitches, the ears turn, the flanks breathe."""
    m = Motion(rig, 5.0)
    m.swell("spine", 1 + 0.014 * m.wave(7))
    _nose(m, 20)
    _ears(m, 0.0)
    m.turn("head", Y, m.keys((0, 0), (0.2, 9), (0.5, 8), (0.6, -10), (0.9, -6), (1, 0)))
    m.turn("head", Z, 2.0 * m.wave(2))
    _stand(m)
    return m.clip("idle")


def _hopping(name: str, number: int, bend: float, rise: float) -> Callable[[Rig], Clip]:
    def hopping(rig: Rig) -> Clip:
        gait = GAITS[number]
        m = Motion(rig, gait.stride / gait.speed, FAST)
        # The hind feet push at the start; the back is stretched as they leave the ground and round when they come ahead.
        arch = m.wave(1, 0.30 - gait.duty)
        m.move("hips", Y, rise * (m.wave(1, 0.5 - gait.duty) - 0.3))
        m.turn("hips", Z, -bend * 0.8 * arch)
        m.turn("spine", Z, bend * 1.2 * arch)
        m.turn("chest", Z, bend * 0.3 * arch)
        m.turn("head", Z, -bend * 0.5 * arch)
        _ears(m, 14.0 if number == 0 else 46.0, 0.0)
        steps(m, gait, CHAINS, 20.0)
        return m.clip(name, stride=gait.stride, marks={"push": 0.0, "land": 0.6})

    return hopping


def look(rig: Rig) -> Clip:
    """Sits up on its hind legs and looks about."""
    m = Motion(rig, 3.0)
    up = m.keys((0, 0), (0.16, 1.04), (0.24, 1), (0.78, 1), (1, 0))
    m.turn("hips", Z, 38.0 * up)
    m.turn("spine", Z, 14.0 * up)
    m.turn("head", Z, -44.0 * up)
    m.move("hips", Y, -0.02 * up)
    m.turn("head", Y, m.keys((0, 0), (0.25, 0), (0.38, 32), (0.5, 30), (0.64, -30), (0.76, -26), (1, 0)))
    _nose(m, 10)
    _ears(m, -6.0)
    for name in NAMES[:2]:
        m.turn(f"upper_{name}", Z, -30.0 * up)
        m.turn(f"lower_{name}", Z, 30.0 * up)
        m.turn(f"wrist_{name}", Z, -60.0 * up)
    _stand(m, 2)
    return m.clip("look", loop=False, marks={"up": 0.2}, feet=False)


def nibble(rig: Rig) -> Clip:
    """Head to the ground, chews."""
    m = Motion(rig, 2.4)
    m.turn("chest", Z, -12.0)
    m.turn("head", Z, -26.0 + 4.0 * m.wave(2))
    m.turn("head", Y, 5.0 * m.wave(1))
    m.turn("jaw", Z, -5.0 + 5.0 * m.wave(12))
    m.turn("jaw", Y, 4.0 * m.wave(12, 0.25))
    _ears(m, 6.0)
    _stand(m)
    return m.clip("nibble", marks={"bite": 0.1})


def die(rig: Rig) -> Clip:
    """Falls on its side and goes limp."""
    m = Motion(rig, 1.8)
    fall = m.keys((0, 0), (0.12, -0.05), (0.45, 1), (0.54, 0.94), (0.62, 1), (1, 1))
    limp = m.keys((0, 0), (0.5, 1), (1, 1))
    m.turn("hips", X, -86.0 * fall)
    m.move("hips", Y, -0.110 * fall)
    m.move("hips", Z, -0.10 * fall)
    m.turn("head", Z, -18.0 * limp)
    _ears(m, 24.0, 0.0)
    for name, by in zip(NAMES, (30.0, 42.0, -20.0, -8.0), strict=True):
        m.turn(f"upper_{name}", Z, by * limp)
        m.turn(f"lower_{name}", Z, (-50.0 if name.endswith("1") else 40.0) * limp)
        m.turn(f"wrist_{name}", Z, (-20.0 if name.endswith("1") else -36.0) * limp)
    m.above_ground("hips")
    return m.clip("die", loop=False, marks={"down": 0.45}, feet=False)


CLIPS: tuple[Callable[[Rig], Clip], ...] = (
    idle, _hopping("hop", 0, 9.0, 0.035), _hopping("run", 1, 20.0, 0.060), look, nibble, die,
)  # fmt: skip
