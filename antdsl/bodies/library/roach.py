"""A cockroach: flat, under a shield and two wing covers in the colour of the state, with feelers as long as itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from antdsl.bodies.agents.clip import Clip
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.layer import TransformGroup
from antdsl.bodies.agents.legs import Gait
from antdsl.bodies.agents.rig import Rig
from antdsl.bodies.library.insect_legs import SIDES, Joints, chains_of, crowd_leg, fine_leg, leg_joints, legs_of
from antdsl.bodies.library.lazy_shapes import layered
from antdsl.bodies.library.modelling import Model, profile, rig_of
from antdsl.bodies.library.motions import FAST, Motion, X, Y, Z, steps
from antdsl.bodies.library.surfaces import Array, Point, Surface, ellipsoid, loft, smooth_through

LEGS: tuple[Joints, ...] = (
    ((0.230, 0.072, 0.045), (0.262, 0.052, 0.090), (0.335, 0.120, 0.185), (0.420, 0.022, 0.262), (0.482, 0.0, 0.300)),
    ((0.105, 0.070, 0.060), (0.100, 0.048, 0.118), (0.075, 0.132, 0.250), (-0.005, 0.022, 0.372), (-0.040, 0.0, 0.440)),
    ((-0.030, 0.070, 0.062), (-0.075, 0.048, 0.120), (-0.190, 0.142, 0.245), (-0.405, 0.022, 0.345), (-0.490, 0.0, 0.378)),
)
FEELER: tuple[Point, ...] = ((0.425, 0.085, 0.035), (0.60, 0.135, 0.115), (0.82, 0.155, 0.235), (1.08, 0.140, 0.390))
JOINTS: dict[str, tuple[str, Point]] = {
    "root": ("", (0.0, 0.0, 0.0)),
    "thorax": ("root", (0.10, 0.085, 0.0)),
    "head": ("thorax", (0.36, 0.075, 0.0)),
    "abdomen": ("thorax", (0.0, 0.082, 0.0)),
    **{
        f"feeler{k}_{side}": ("head" if k == 1 else f"feeler{k - 1}_{side}", (at[0], at[1], sign * at[2]))
        for side, sign in SIDES
        for k, at in enumerate(FEELER[:3], 1)
    },
    **leg_joints(LEGS, "thorax"),
}
_TRIPOD = (0.0, 0.5, 0.5, 0.0, 0.0, 0.5)
GAITS = (
    Gait("slow", 0.4, 0.38, 0.72, 0.035, (0.667, 0.167, 0.333, 0.833, 0.0, 0.5)),
    Gait("tripod", 2.0, 0.56, 0.56, 0.045, _TRIPOD),
    Gait("fast tripod", 6.0, 0.80, 0.46, 0.055, _TRIPOD),
    Gait("sprint", 8.5, 1.08, 0.40, 0.060, _TRIPOD),
)
MATERIALS = {
    "thorax": (0.12, 0.050, 0.018),
    "leg": (0.115, 0.045, 0.016),
    "jaw": (0.03, 0.012, 0.006),
    "joint": (0.16, 0.075, 0.030),
    "shield": (0.30, 0.150, 0.052),
    "mark": (0.060, 0.022, 0.010),
    "belly": (0.15, 0.065, 0.025),
    "eye": (0.006, 0.006, 0.008),
    "hair": (0.10, 0.045, 0.018),
}


def roach() -> Definition:
    rig = rig_of(JOINTS)

    shapes, layers = layered("roach", JOINTS, _body)
    feelers = tuple((f"feeler{k}_{side}", 1.0) for k in (1, 2, 3) for side in "lr")
    return Definition(
        "roach",
        rig,
        shapes,
        layers,
        {clip.name: clip for clip in (make(rig) for make in CLIPS)},
        {"feelers": TransformGroup("feelers", feelers)},
        materials=MATERIALS,
        length=1.0,
        unit=35.0,
        legs=legs_of(3),
        gaits=GAITS,
        idle="idle",
    )


def _dome(rows: Array, sides: int, over: float, under: float) -> Surface:
    """A plate along x of rows (x, y, half its height, half its width): `over` of its height above, `under` of it below."""
    made = loft(np.stack([rows[:, 0], rows[:, 1], np.zeros(len(rows))], 1), rows[:, 2], rows[:, 3], sides)
    middle = np.interp(-made.points[:, 0], -rows[:, 0], rows[:, 1])
    points = made.points.copy()
    up = points[:, 1] - middle
    points[:, 1] = middle + np.where(up > 0, up * over, up * under)
    return made.moved(points)


def _body(model: Model, fine: bool) -> None:
    rings, sides = (30, 26) if fine else (6, 7)

    def rows(*keys: tuple[float, float, float, float]) -> Array:
        found = profile(keys, rings)
        found[:, 0] *= -1
        return found

    belly = rows(
        (-0.36, 0.070, 0.010, 0.030),
        (-0.28, 0.068, 0.030, 0.085),
        (0.05, 0.064, 0.040, 0.132),
        (0.30, 0.062, 0.032, 0.118),
        (0.50, 0.062, 0.006, 0.020),
    )
    if fine:  # plates of the belly
        ripple = 1 - 0.05 * np.clip(np.sin(belly[:, 0] * 75), 0, 1) * (belly[:, 0] < 0.05)
        belly[:, 2:] *= ripple[:, None]
    model.add(_dome(belly, sides, 0.8, 1.0), [(0.45, "thorax"), (0.60, "abdomen")], "belly", "belly")
    wings = rows(
        (-0.20, 0.096, 0.006, 0.060),
        (-0.14, 0.096, 0.022, 0.118),
        (0.05, 0.094, 0.038, 0.150),
        (0.28, 0.086, 0.030, 0.134),
        (0.46, 0.076, 0.014, 0.072),
        (0.515, 0.072, 0.003, 0.016),
    )
    cover = _dome(wings, sides, 1.0, 0.25)
    if fine:  # a seam where one lies over the other, and veins
        points = cover.points.copy()
        x, z = points[:, 0], points[:, 2]
        points[:, 1] -= 0.006 * np.exp(-(((z - 0.16 * (x + 0.15)) / 0.006) ** 2)) * (points[:, 1] > 0.09)
        points[:, 1] += 0.0012 * np.sin(150 * np.abs(z) + 18 * x) * (points[:, 1] > 0.085)
        cover = cover.moved(points)
    model.add(cover, [(0.2, "thorax"), (0.5, "abdomen")], "state", "wings")
    shield = rows(
        (-0.400, 0.090, 0.004, 0.050),
        (-0.375, 0.094, 0.016, 0.098),
        (-0.27, 0.100, 0.034, 0.142),
        (-0.19, 0.102, 0.030, 0.138),
        (-0.160, 0.100, 0.006, 0.090),
    )
    model.add(
        _dome(shield, sides, 1.0, 0.35), "thorax", lambda along: np.where(np.abs(along - 0.5) < 0.22, "mark", "shield"), "shield"
    )
    model.add(ellipsoid((0.375, 0.066, 0.0), (0.050, 0.046, 0.060), 3 if fine else 0), "head", "thorax", "head")
    if fine:
        model.both(ellipsoid((0.395, 0.080, 0.046), (0.022, 0.026, 0.014), 2), "head", "eye", "eye")
        model.both(
            loft(
                [(0.415, 0.035, 0.026), (0.432, 0.020, 0.026), (0.425, 0.008, 0.018)],
                [0.006, 0.005, 0.002],
                [0.006, 0.005, 0.002],
                6,
            ),
            "head",
            "jaw",
            "palp",
        )
    count = 34 if fine else 5
    path = smooth_through(FEELER, np.linspace(0, 1, count))
    radius = np.linspace(0.0075, 0.0016, count) * ((1 - 0.18 * (np.arange(count) % 2)) if fine else 1.4)
    feeler = loft(path, radius, radius, 6 if fine else 3)
    model.both(feeler, [(0.18, "feeler1_r"), (0.34, "feeler2_r"), (0.58, "feeler2_r"), (0.80, "feeler3_r")], "leg", "feeler")
    tail = [(-0.40, 0.075, 0.060), (-0.50, 0.080, 0.100), (-0.575, 0.092, 0.125)]
    model.both(loft(tail, [0.011, 0.010, 0.002], [0.011, 0.010, 0.002], 7 if fine else 3), "abdomen", "leg", "cercus")
    for number, leg in enumerate(LEGS, 1):
        if fine:
            fine_leg(model, number, leg, 0.95, spines=14)
        else:
            crowd_leg(model, number, leg, 0.9)


CHAINS = chains_of(3)


def _feelers(m: Motion, reach: float, cycles: int) -> None:
    for side, sign in SIDES:
        late = 0.0 if sign < 0 else 0.41
        m.turn(f"feeler1_{side}", Y, -sign * reach * (m.wave(cycles, late) + 0.5 * m.wave(cycles + 1, 2 * late)))
        m.turn(f"feeler1_{side}", Z, reach * 0.5 * m.wave(cycles, late + 0.3))
        m.turn(f"feeler2_{side}", Z, reach * 0.6 * m.wave(cycles, late + 0.15))
        m.turn(f"feeler2_{side}", Y, -sign * reach * 0.5 * m.wave(cycles, late - 0.12))
        m.turn(f"feeler3_{side}", Z, reach * 0.7 * m.wave(cycles, late + 0.02) - 3.0)
        m.turn(f"feeler3_{side}", Y, -sign * reach * 0.5 * m.wave(cycles, late - 0.24))


def _stand(m: Motion) -> None:
    for chain in CHAINS:
        m.reach(chain, np.broadcast_to(m.rest(chain.tip), (m.samples, 3)))


def idle(rig: Rig) -> Clip:
    """Stands with its feelers sweeping, and crouches a little as it breathes."""
    m = Motion(rig, 5.0)
    m.move("thorax", Y, 0.003 * m.wave(4))
    m.turn("head", Z, 4.0 * m.wave(2))
    _feelers(m, 15.0, 2)
    _stand(m)
    return m.clip("idle")


def _going(name: str, number: int) -> Callable[[Rig], Clip]:
    def going(rig: Rig) -> Clip:
        gait = GAITS[number]
        m = Motion(rig, gait.stride / gait.speed, FAST)
        m.move("thorax", Y, 0.003 * m.wave(2, 0.1) + 0.006 * (number - 1))
        m.turn("thorax", Y, 2.0 * m.wave(1, 0.1))
        m.turn("thorax", X, 1.2 * m.wave(1, 0.35))
        _feelers(m, 6.0, 1)
        steps(m, gait, CHAINS)
        return m.clip(name, stride=gait.stride, marks={"left": 0.0, "right": 0.5})

    return going


def flinch(rig: Rig) -> Clip:
    """Ducks to the ground, feelers laid back, and gets up again."""
    m = Motion(rig, 1.2)
    down = m.keys((0, 0), (0.10, 1), (0.55, 1), (1, 0))
    m.move("thorax", Y, -0.030 * down)
    m.turn("head", Z, -14.0 * down)
    for side, sign in SIDES:
        m.turn(f"feeler1_{side}", Y, -sign * 62.0 * down)
        m.turn(f"feeler2_{side}", Y, -sign * 30.0 * down)
    _stand(m)
    return m.clip("flinch", loop=False, marks={"down": 0.12})


def die(rig: Rig) -> Clip:
    """Rolls on its back and draws in its legs."""
    m = Motion(rig, 2.4)
    over = m.keys((0, 0), (0.15, 0.1), (0.45, 1), (1, 1))
    curl = m.keys((0, 0), (0.4, 0.1), (0.9, 1), (1, 1))
    below = m.keys((0, 0), (0.06, 0.1), (0.24, 1), (1, 1))  # the legs that it rolls over give way first
    m.turn("thorax", X, 180.0 * over)
    m.move("thorax", Y, 0.03 * m.keys((0, 0), (0.25, 1), (0.45, 1), (1, 1)))
    for side, sign in SIDES:
        for number in (1, 2, 3):
            kick = 8.0 * m.wave(8, 0.2 * number + 0.3 * sign) * (1 - curl) * over
            drawn = curl if sign < 0 else below
            m.turn(f"femur_{side}{number}", X, sign * (kick - 22.0 * drawn))
            m.turn(f"tibia_{side}{number}", X, sign * 48.0 * drawn)
            m.turn(f"tarsus_{side}{number}", X, sign * 30.0 * drawn)
        m.turn(f"feeler1_{side}", Y, -sign * 20.0 * over)
    m.above_ground("thorax")
    return m.clip("die", loop=False, marks={"down": 0.45}, feet=False)


CLIPS: tuple[Callable[[Rig], Clip], ...] = (idle, _going("walk", 1), _going("run", 2), flinch, die)
