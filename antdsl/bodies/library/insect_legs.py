"""Legs of insects and spiders: coxa, femur, tibia and tarsus with claws, as joints and as geometry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from antdsl.bodies.agents.legs import Leg
from antdsl.bodies.library.hair import hairs
from antdsl.bodies.library.modelling import Model
from antdsl.bodies.library.motions import Chain
from antdsl.bodies.library.surfaces import Array, Point, ellipsoid, limb, loft

BONES = ("coxa", "femur", "tibia", "tarsus", "claw")
Joints = tuple[Point, Point, Point, Point, Point]  # of a right leg, in the order of BONES; tibia is the knee, tarsus the ankle
SIDES = (("l", -1.0), ("r", 1.0))


def leg_joints(legs: Sequence[Joints], parent: str) -> dict[str, tuple[str, Point]]:
    """The joints of both sides, of legs given from front to hind."""
    made: dict[str, tuple[str, Point]] = {}
    for number, points in enumerate(legs, 1):
        for side, sign in SIDES:
            above = parent
            for bone, at in zip(BONES, points, strict=True):
                made[f"{bone}_{side}{number}"] = (above, (at[0], at[1], sign * at[2]))
                above = f"{bone}_{side}{number}"
    return made


def legs_of(pairs: int) -> tuple[Leg, ...]:
    """The legs of a definition, left before right, from front to hind."""
    names = [f"{side}{number}" for number in range(1, pairs + 1) for side, _ in SIDES]
    return tuple(Leg(name, f"femur_{name}", f"tibia_{name}", f"claw_{name}") for name in names)


def chains_of(pairs: int) -> tuple[Chain, ...]:
    """The same legs as clips move them."""
    return tuple(Chain(leg.upper, leg.lower, f"tarsus_{leg.name}", leg.foot) for leg in legs_of(pairs))


def crowd_leg(model: Model, number: int, points: Joints, girth: float = 1.0, sides: int = 3) -> None:
    """A leg of both sides in few triangles: one tube, of which each joint bends its own ring."""
    names = [f"{bone}_r{number}" for bone in BONES]
    radii = np.array([0.020, 0.020, 0.015, 0.010, 0.004]) * girth
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(np.array(points), axis=0), axis=1))])
    at = length / length[-1]
    follows = [
        (0.0, names[0]), (at[1] + 0.01, names[1]), (at[2] - 0.06, names[1]), (at[2] + 0.06, names[2]), (at[3] - 0.05, names[2]),
        (at[3] + 0.05, names[3]),
    ]  # fmt: skip
    model.both(loft(points, radii, radii, sides), follows, "leg", "leg")


def fine_leg(model: Model, number: int, points: Joints, girth: float = 1.0, spines: int = 0) -> None:
    """A leg of both sides with all its pieces. `girth` scales how thick it is; `spines`: how many stand on femur and tibia."""
    names, g = [f"{bone}_r{number}" for bone in BONES], girth
    coxa, femur, knee, ankle, claw = (np.array(at) for at in points)
    inner = coxa + g * np.array([0.0, 0.012, -0.012])
    hip = limb([_p(inner), _p(coxa), _p(coxa + 0.55 * (femur - coxa)), _p(femur)], _by(g, 0.016, 0.024, 0.022, 0.013), 10, 6)
    model.both(hip, names[0], "thorax", "coxa")
    way = (knee - femur) / np.linalg.norm(knee - femur)
    # The trochanter is the first piece of the femur; the femur is thickest before its middle.
    first = [_p(femur - g * 0.004 * way), _p(femur + g * 0.016 * way), _p(femur + g * 0.030 * way)]
    model.both(limb(first, _by(g, 0.0130, 0.0145, 0.0110), 10, 4), names[1], "leg", "trochanter")
    bow = g * np.array([0.0, 0.008, 0.0])
    along = [femur + g * 0.022 * way, femur + 0.30 * (knee - femur) + bow, femur + 0.65 * (knee - femur) + bow, knee]
    thigh = limb([_p(p) for p in along], _by(g, 0.0105, 0.0175, 0.0145, 0.0100), 10, 8)
    model.both(thigh, names[1], "leg", "femur")
    model.both(ellipsoid(_p(knee), (0.0112 * g,) * 3, 1), names[2], "joint", "knee")
    along = [knee, knee + 0.18 * (ankle - knee), knee + 0.60 * (ankle - knee), ankle]
    shank = limb([_p(p) for p in along], _by(g, 0.0085, 0.0100, 0.0115, 0.0085), 8, 7)
    model.both(shank, names[2], "leg", "tibia")
    down, out = (ankle - knee) / np.linalg.norm(ankle - knee), (claw - ankle) / np.linalg.norm(claw - ankle)
    spur = np.array(
        [ankle - g * 0.012 * down, ankle + g * (0.006 * down + 0.012 * out), ankle + g * (0.010 * down + 0.026 * out)]
    )
    model.both(loft(spur, _by(g, 0.0040, 0.0028, 0.0004), _by(g, 0.0040, 0.0028, 0.0004), 4), names[2], "leg", "spur")
    _tarsus(model, names[3], ankle, claw, g)
    hairs(
        model,
        shank,
        names[2],
        10 + 2 * spines,
        0.020 * (1 + 0.9 * (spines > 0)) * g,
        seed=10 + number,
        lean=_p(down * 1.4),
        both=True,
    )
    if spines:
        hairs(model, thigh, names[1], spines, 0.034 * g, seed=20 + number, lean=_p(way * 1.0), both=True)


def _tarsus(model: Model, joint: str, ankle: Array, claw: Array, g: float) -> None:
    """Five pieces, the first the longest, then two claws with a pad between them."""
    edges = np.array([0.0, 0.40, 0.58, 0.72, 0.84, 1.0])
    at, radius = [], [0.0072]
    for k in range(5):
        a, b = edges[k], edges[k + 1]
        at += [a + 0.04 * (b - a), a + 0.5 * (b - a), a + 0.90 * (b - a)]
        radius += [0.0050 - 0.0003 * k, 0.0058 - 0.0003 * k, 0.0078 - 0.0005 * k]
    where = np.array(at)[:, None]
    raised, bend = g * np.array([0.0, 0.006, 0.0]), g * np.array([0.0, -0.004, 0.0])
    path = ankle + (claw + raised - ankle) * where + bend * np.sin(np.pi * where)
    path = np.concatenate([[ankle - 0.002 * (claw - ankle)], path])
    model.both(loft(path, _by(g, *radius), _by(g, *radius), 7), joint, "leg", "tarsus")
    out = (claw - ankle) * np.array([1.0, 0.0, 1.0])
    out /= np.linalg.norm(out)
    side, foot = np.array([-out[2], 0.0, out[0]]), path[-1]
    for sign in (-1.0, 1.0):
        tip = foot + g * (0.026 * out + sign * 0.016 * side)
        tip[1] = 0.0015 * g
        curve = np.array([foot, foot + g * (0.014 * out + sign * 0.010 * side + np.array([0.0, 0.005, 0.0])), tip])
        size = _by(g, 0.0042, 0.0032, 0.0004)
        model.both(loft(curve, size, size, 5), joint, "jaw", "claw")
    model.both(ellipsoid(_p(foot + 0.010 * g * out), (0.006 * g, 0.004 * g, 0.006 * g), 0), joint, "joint", "pad")


def _by(girth: float, *radii: float) -> Array:
    return np.array(radii) * girth


def _p(at: Array) -> Point:
    return (float(at[0]), float(at[1]), float(at[2]))
