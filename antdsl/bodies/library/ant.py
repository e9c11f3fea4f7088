"""The ant: a worker, a soldier and a queen, each for crowds (layer `body`) and for close-ups (layer `close`)."""

from __future__ import annotations

import numpy as np

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.layer import Binding, Layer, TransformGroup
from antdsl.bodies.agents.shape import Shape
from antdsl.bodies.library import ant_rig
from antdsl.bodies.library.ant_clips import CLIPS
from antdsl.bodies.library.ant_close import close
from antdsl.bodies.library.ant_crowd import crowd
from antdsl.bodies.library.insect_legs import BONES, legs_of
from antdsl.bodies.library.lazy_shapes import LazyShapes
from antdsl.bodies.library.modelling import Model, rig_of
from antdsl.bodies.library.surfaces import ellipsoid

MILLIMETRES = 6.0  # a body length
MATERIALS = {
    "thorax": (0.105, 0.032, 0.014), "head": (0.085, 0.026, 0.012), "leg": (0.060, 0.020, 0.010), "jaw": (0.030, 0.010, 0.006),
    "joint": (0.150, 0.055, 0.024), "eye": (0.006, 0.006, 0.008), "hair": (0.42, 0.30, 0.17), "seam": (0.045, 0.018, 0.010),
    "crumb": (0.62, 0.40, 0.16),
}  # fmt: skip


def ant(build: ant_rig.Build = ant_rig.WORKER) -> Definition:
    """An ant of a caste."""
    joints = ant_rig.joints(build)
    rig = rig_of(joints)

    def modelled(name: str) -> Shape:
        model = Model(joints)
        (close if name == "ant_close" else crowd)(model, build)
        return model.shape(name)

    def crumb(name: str) -> Shape:
        model = Model(joints)
        at = joints["load"][1]
        ball = ellipsoid((at[0] + 0.04, at[1] + 0.006, 0.0), (0.074, 0.064, 0.070), 1)
        dents = (
            1
            + 0.20 * np.sin(37 * ball.points[:, :1] + 5) * np.cos(53 * ball.points[:, 2:])
            + 0.10 * np.sin(91 * ball.points[:, 1:2])
        )
        middle = np.array([at[0] + 0.04, at[1] + 0.006, 0.0])
        model.add(ball.moved(middle + (ball.points - middle) * dents), "load", "crumb", "crumb")
        return model.shape(name)

    def worn(name: str, shape: str) -> Layer:
        return Layer(name, deforming=(Binding("", shape, deformer="linearskinning"),))

    groups = {
        "feelers": [f"{name}_{side}" for name in ("scape", "funiculus", "club") for side in "lr"],
        "jaws": ["mandible_l", "mandible_r"],
        "head": [
            "head",
            "mandible_l",
            "mandible_r",
            *(f"{name}_{side}" for name in ("scape", "funiculus", "club") for side in "lr"),
        ],
        "forelegs": [f"{bone}_{side}1" for bone in BONES for side in "lr"],
        "gaster": ["petiole", "gaster", "gaster_tip"],
    }
    return Definition(
        build.name, rig,
        LazyShapes({"ant": modelled, "ant_close": modelled, "crumb": crumb}),
        {"body": worn("body", "ant"), "close": worn("close", "ant_close"), "load": worn("load", "crumb")},
        {clip.name: clip for clip in (make(rig) for make in CLIPS)},
        {name: TransformGroup(name, tuple((joint, 1.0) for joint in members)) for name, members in groups.items()},
        materials=MATERIALS, length=1.0, unit=MILLIMETRES, legs=legs_of(3), gaits=ant_rig.GAITS, idle="idle",
    )  # fmt: skip


def soldier() -> Definition:
    """A soldier: a large head with long mandibles."""
    return ant(ant_rig.SOLDIER)


def queen() -> Definition:
    """A queen: a large gaster, a thorax that once bore wings."""
    return ant(ant_rig.QUEEN)
