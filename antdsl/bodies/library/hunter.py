"""A hunter on four legs, as a fox is built: it walks, trots and gallops, stalks, pounces, looks about and lies down dead."""

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

JOINTS: dict[str, tuple[str, Point]] = mirrored({
    "root": ("", (0.0, 0.0, 0.0)),
    "hips": ("root", (-0.27, 0.430, 0.0)),
    "spine": ("hips", (-0.10, 0.435, 0.0)),
    "chest": ("spine", (0.08, 0.430, 0.0)),
    "neck": ("chest", (0.235, 0.455, 0.0)),
    "head": ("neck", (0.345, 0.560, 0.0)),
    "jaw": ("head", (0.385, 0.530, 0.0)),
    "ear_r": ("head", (0.340, 0.615, 0.042)),
    "tail1": ("hips", (-0.385, 0.430, 0.0)),
    "tail2": ("tail1", (-0.520, 0.375, 0.0)),
    "tail3": ("tail2", (-0.665, 0.320, 0.0)),
    "upper_r1": ("chest", (0.205, 0.360, 0.062)),
    "lower_r1": ("upper_r1", (0.110, 0.232, 0.066)),
    "wrist_r1": ("lower_r1", (0.165, 0.075, 0.064)),
    "paw_r1": ("wrist_r1", (0.185, 0.0, 0.064)),
    "upper_r2": ("hips", (-0.275, 0.400, 0.062)),
    "lower_r2": ("upper_r2", (-0.205, 0.245, 0.072)),
    "wrist_r2": ("lower_r2", (-0.330, 0.115, 0.066)),
    "paw_r2": ("wrist_r2", (-0.290, 0.0, 0.066)),
})  # fmt: skip
NAMES = ("l1", "r1", "l2", "r2")
LEGS = tuple(Leg(name, f"upper_{name}", f"lower_{name}", f"paw_{name}") for name in NAMES)
CHAINS = tuple(Chain(leg.upper, leg.lower, f"wrist_{leg.name}", leg.foot) for leg in LEGS)
# By leg: fore left, fore right, hind left, hind right (M. Hildebrand, The quadrupedal gaits of vertebrates, 1989).
GAITS = (
    Gait("walk", 0.9, 0.54, 0.64, 0.06, (0.75, 0.25, 0.0, 0.5)),
    Gait("trot", 2.6, 0.90, 0.42, 0.09, (0.5, 0.0, 0.0, 0.5)),
    Gait("gallop", 7.0, 1.90, 0.20, 0.13, (0.42, 0.52, 0.0, 0.10)),
)
MATERIALS = {
    "sock": (0.030, 0.020, 0.016), "cream": (0.62, 0.52, 0.40), "dark": (0.020, 0.015, 0.013), "eye": (0.20, 0.10, 0.02),
    "tip": (0.66, 0.60, 0.52), "ear": (0.035, 0.022, 0.018),
}  # fmt: skip

TORSO: tuple[Row, ...] = (
    (-0.415, 0.415, 0.0, 0.010, 0.010), (-0.400, 0.420, 0.0, 0.052, 0.042), (-0.345, 0.425, 0.0, 0.092, 0.070),
    (-0.240, 0.420, 0.0, 0.100, 0.080), (-0.090, 0.425, 0.0, 0.083, 0.074), (0.060, 0.408, 0.0, 0.112, 0.086),
    (0.145, 0.415, 0.0, 0.116, 0.088), (0.215, 0.445, 0.0, 0.104, 0.078), (0.270, 0.495, 0.0, 0.082, 0.065),
    (0.320, 0.550, 0.0, 0.064, 0.057), (0.350, 0.583, 0.0, 0.030, 0.030),
)  # fmt: skip
HEAD: tuple[Row, ...] = (
    (0.298, 0.560, 0.0, 0.014, 0.016), (0.312, 0.565, 0.0, 0.050, 0.054), (0.350, 0.568, 0.0, 0.064, 0.072),
    (0.395, 0.560, 0.0, 0.058, 0.066), (0.430, 0.543, 0.0, 0.037, 0.040), (0.480, 0.528, 0.0, 0.026, 0.027),
    (0.520, 0.521, 0.0, 0.017, 0.018), (0.530, 0.520, 0.0, 0.006, 0.006),
)  # fmt: skip
TAIL: tuple[Row, ...] = (
    (-0.370, 0.435, 0.0, 0.024, 0.024), (-0.430, 0.420, 0.0, 0.034, 0.032), (-0.520, 0.375, 0.0, 0.058, 0.054),
    (-0.640, 0.325, 0.0, 0.070, 0.064), (-0.740, 0.300, 0.0, 0.052, 0.047), (-0.805, 0.296, 0.0, 0.010, 0.010),
)  # fmt: skip
FORELEG: tuple[Row, ...] = (
    (0.195, 0.430, 0.052, 0.018, 0.016), (0.190, 0.395, 0.060, 0.056, 0.030), (0.165, 0.315, 0.066, 0.052, 0.032),
    (0.114, 0.235, 0.067, 0.036, 0.027), (0.138, 0.152, 0.065, 0.025, 0.021), (0.165, 0.075, 0.064, 0.022, 0.019),
    (0.168, 0.034, 0.064, 0.021, 0.022), (0.171, 0.012, 0.064, 0.018, 0.020),
)  # fmt: skip
HIND: tuple[Row, ...] = (
    (-0.290, 0.450, 0.045, 0.020, 0.016), (-0.280, 0.405, 0.058, 0.080, 0.034), (-0.250, 0.325, 0.068, 0.078, 0.040),
    (-0.212, 0.245, 0.072, 0.048, 0.031), (-0.270, 0.180, 0.069, 0.030, 0.023), (-0.330, 0.115, 0.066, 0.021, 0.018),
    (-0.312, 0.060, 0.066, 0.020, 0.018), (-0.304, 0.014, 0.066, 0.018, 0.020),
)  # fmt: skip


def hunter() -> Definition:
    rig = rig_of(JOINTS)
    shapes, layers = layered("hunter", JOINTS, _body)
    groups = {
        "head": ("neck", "head", "jaw", "ear_l", "ear_r"),
        "tail": ("tail1", "tail2", "tail3"),
    }
    return Definition(
        "hunter", rig, shapes, layers, {clip.name: clip for clip in (make(rig) for make in CLIPS)},
        {name: TransformGroup(name, tuple((joint, 1.0) for joint in members)) for name, members in groups.items()},
        materials=MATERIALS, length=1.0, unit=700.0, legs=LEGS, gaits=GAITS, idle="idle",
    )  # fmt: skip


def _body(model: Model, fine: bool) -> None:

    def n(many: int, few: int) -> int:
        return many if fine else few

    torso = swept(TORSO, n(54, 7), n(28, 7))
    model.add(
        torso,
        places(TORSO, (2, "hips"), (3, "hips"), (4, "spine"), (5, "chest"), (6, "chest"), (8, "neck"), (9, "head")),
        "state",
        "torso",
    )
    head = swept(HEAD, n(34, 5), n(22, 6))
    model.add(head, "head", bands(["state", "cream"], [0.66]), "head")
    model.add(ellipsoid((0.527, 0.527, 0.0), (0.013, 0.011, 0.012), n(2, 0)), "head", "dark", "nose")
    jaw: tuple[Row, ...] = (
        (0.375, 0.520, 0.0, 0.008, 0.020),
        (0.400, 0.514, 0.0, 0.018, 0.030),
        (0.460, 0.508, 0.0, 0.011, 0.018),
        (0.502, 0.508, 0.0, 0.004, 0.008),
    )
    model.add(swept(jaw, n(12, 4), n(12, 3)), "jaw", "cream", "jaw")
    ear: tuple[Row, ...] = (
        (0.335, 0.595, 0.034, 0.014, 0.024),
        (0.332, 0.625, 0.046, 0.014, 0.032),
        (0.328, 0.665, 0.056, 0.008, 0.020),
        (0.326, 0.695, 0.062, 0.002, 0.003),
    )
    model.both(swept(ear, n(12, 4), n(12, 3), up=(1.0, 0.0, 0.0)), "ear_r", bands(["state", "ear"], [0.45]), "ear")
    tail = places(TAIL, (0, "tail1"), (1, "tail1"), (2, "tail2"), (3, "tail3"))
    model.add(swept(TAIL, n(30, 5), n(18, 5)), tail, bands(["state", "tip"], [0.80]), "tail")
    for number, rows in ((1, FORELEG), (2, HIND)):
        above = "chest" if number == 1 else "hips"
        follows = places(
            rows, (0, above), (1, f"upper_r{number}"), (2, f"upper_r{number}"), (4, f"lower_r{number}"), (5, f"wrist_r{number}")
        )
        model.both(
            swept(rows, n(30, 5), n(16, 4), up=(1.0, 0.0, 0.0)), follows, bands(["state", "sock"], [0.52]), f"leg {number}"
        )
        x, _, z = JOINTS[f"paw_r{number}"][1]
        paw: tuple[Row, ...] = (
            (x - 0.035, 0.016, z, 0.010, 0.014),
            (x - 0.018, 0.020, z, 0.020, 0.024),
            (x + 0.020, 0.016, z, 0.016, 0.026),
            (x + 0.044, 0.009, z, 0.006, 0.014),
        )
        model.both(swept(paw, n(12, 4), n(14, 4)), f"wrist_r{number}", "sock", "paw")
    if fine:
        model.both(ellipsoid((0.405, 0.578, 0.051), (0.016, 0.015, 0.011), 2), "head", "eye", "eye")
        model.both(ellipsoid((0.410, 0.579, 0.058), (0.007, 0.008, 0.006), 1), "head", "dark", "pupil")


def _breath(m: Motion, cycles: int) -> None:
    m.swell("chest", 1 + 0.014 * m.wave(cycles))


def _tail(m: Motion, by: float, cycles: int, lift: float = 0.0) -> None:
    for k, joint in enumerate(("tail1", "tail2", "tail3")):
        m.turn(joint, Y, by * (0.6 + 0.4 * k) * m.wave(cycles, -0.14 * k))
        m.turn(joint, Z, -lift / (1 + k) + 0.3 * by * m.wave(cycles + 1, -0.2 * k))


def _stand(m: Motion) -> None:
    for chain in CHAINS:
        m.reach(chain, np.broadcast_to(m.rest(chain.tip), (m.samples, 3)))


def idle(rig: Rig) -> Clip:
    """Stands, breathes, looks about with its ears, sways its tail."""
    m = Motion(rig, 6.0)
    _breath(m, 4)
    _tail(m, 9.0, 2)
    m.turn("neck", Y, m.keys((0, 0), (0.2, 16), (0.42, 14), (0.6, -12), (0.85, -8), (1, 0)))
    m.turn("head", Y, m.keys((0, 0), (0.16, 14), (0.42, 10), (0.55, -14), (0.85, -10), (1, 0)))
    m.turn("head", Z, m.keys((0, 0), (0.3, -6), (0.5, 5), (1, 0)))
    for side, sign in (("l", -1.0), ("r", 1.0)):
        m.turn(
            f"ear_{side}", Y, sign * m.keys((0, 0), (0.30, 0), (0.34, 22), (0.40, 0), (0.7, 0), (0.74, -18), (0.82, 0), (1, 0))
        )
    m.move("hips", Y, 0.002 * m.wave(4))
    _stand(m)
    return m.clip("idle")


def walk(rig: Rig) -> Clip:
    gait = GAITS[0]
    m = Motion(rig, gait.stride / gait.speed, FAST)
    m.move("hips", Y, 0.006 * m.wave(2, 0.1) - 0.020)
    m.turn("hips", Y, 2.5 * m.wave(1, 0.1))
    m.turn("chest", Y, -4.0 * m.wave(1, 0.05))
    m.turn("neck", Z, 2.5 * m.wave(2, 0.35))
    _tail(m, 6.0, 1, 6.0)
    steps(m, gait, CHAINS, 46.0)
    return m.clip("walk", stride=gait.stride, marks={"left": 0.25, "right": 0.75})


def trot(rig: Rig) -> Clip:
    gait = GAITS[1]
    m = Motion(rig, gait.stride / gait.speed, FAST)
    m.move("hips", Y, 0.014 * m.wave(2, 0.45) - 0.030)
    m.turn("neck", Z, -4.0)
    _tail(m, 5.0, 1, -14.0)
    steps(m, gait, CHAINS, 46.0)
    return m.clip("trot", stride=gait.stride, marks={"left": 0.5, "right": 0.0})


def run(rig: Rig) -> Clip:
    """Gallops: the back bends as the hind legs come ahead and stretches as they push."""
    gait = GAITS[2]
    m = Motion(rig, gait.stride / gait.speed, FAST)
    bend = m.wave(1, 0.30)
    m.move("hips", Y, 0.024 * m.wave(1, 0.55) - 0.050)
    m.turn("hips", Z, 7.0 * bend)
    m.turn("spine", Z, -13.0 * bend)
    m.turn("chest", Z, -4.0 * bend)
    m.turn("neck", Z, -14.0 + 8.0 * bend)
    m.turn("head", Z, 8.0)
    _tail(m, 4.0, 1, -24.0)
    for side in "lr":
        m.turn(f"ear_{side}", Z, 22.0)
    steps(m, gait, CHAINS, 46.0)
    return m.clip("run", stride=gait.stride, marks={"left": 0.58, "right": 0.48})


def stalk(rig: Rig) -> Clip:
    """Creeps: low, the head stretched ahead, one paw after the other."""
    gait = Gait("stalk", 0.32, 0.45, 0.72, 0.08, GAITS[0].phases)
    m = Motion(rig, gait.stride / gait.speed)
    m.move("hips", Y, -0.110 + 0.004 * m.wave(2))
    m.turn("hips", Y, 2.0 * m.wave(1, 0.1))
    m.turn("chest", Z, -5.0)
    m.turn("neck", Z, -38.0)
    m.turn("head", Z, 36.0)
    _tail(m, 5.0, 2, 10.0)
    for side in "lr":
        m.turn(f"ear_{side}", Z, 8.0 + 4.0 * m.wave(2))
    steps(m, gait, CHAINS, 46.0)
    return m.clip("stalk", stride=gait.stride, marks={"left": 0.25, "right": 0.75})


def bite(rig: Rig) -> Clip:
    """Lunges with its head, snaps and shakes what it has caught."""
    m = Motion(rig, 1.4)
    down = m.keys((0, 0), (0.15, -0.4), (0.32, 1), (0.75, 0.8), (1, 0))
    shake = m.wave(6) * m.keys((0, 0), (0.36, 0), (0.45, 1), (0.75, 0.8), (0.85, 0), (1, 0))
    m.turn("neck", Z, -52.0 * down)
    m.turn("head", Z, 6.0 * down)
    m.turn("head", Y, 18.0 * shake)
    m.turn("neck", Y, 10.0 * shake)
    m.turn("jaw", Z, -m.keys((0, 0), (0.18, 34), (0.30, 36), (0.35, 4), (0.8, 4), (1, 0)))
    m.move("hips", X, 0.05 * down)
    m.move("hips", Y, -0.04 * np.abs(down))
    _tail(m, 8.0, 2)
    _stand(m)
    return m.clip("bite", loop=False, marks={"bite": 0.35})


def die(rig: Rig) -> Clip:
    """Sinks on its side and stretches its legs."""
    m = Motion(rig, 2.2)
    fall = m.keys((0, 0), (0.15, 0.06), (0.5, 1), (0.58, 0.96), (0.66, 1), (1, 1))
    m.turn("hips", X, -84.0 * fall)
    m.move("hips", Y, -0.345 * fall)
    m.move("hips", Z, -0.22 * fall)
    m.turn("neck", Z, -40.0 * m.keys((0, 0), (0.4, 0.2), (0.8, 1), (1, 1)))
    _tail(m, 0.0, 1, -30.0)
    limp = m.keys((0, 0), (0.45, 1), (1, 1))
    for name, by in zip(NAMES, (14.0, 24.0, -8.0, 10.0), strict=True):
        m.turn(f"upper_{name}", Z, by * limp)
        m.turn(f"lower_{name}", Z, (-34.0 if name.endswith("1") else 26.0) * limp)
        m.turn(f"wrist_{name}", Z, (20.0 if name.endswith("1") else -16.0) * limp)
    m.above_ground("hips")
    return m.clip("die", loop=False, marks={"down": 0.5}, feet=False)


CLIPS: tuple[Callable[[Rig], Clip], ...] = (idle, walk, trot, run, stalk, bite, die)
