"""The rig of the ant: trunk, head, feelers, jaws and six legs; its gaits; how a worker, a soldier and a queen are proportioned.

Lengths are body lengths: the worker is 1 long from the tips of its jaws to the end of its gaster."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.legs import Gait
from antdsl.bodies.library.insect_legs import Joints, leg_joints
from antdsl.bodies.library.surfaces import Point

Floats = NDArray[np.float64]
HEIGHT = 0.17  # of the thorax over the ground


@dataclass(frozen=True, slots=True)
class Build:
    """What differs between castes: `head` and `jaws` scale head and mandibles, `gaster` its length, `girth` its width and height,
    `thorax` how thick the thorax is; `wings`: whether it bears the scars of wings."""

    name: str
    head: float = 1.0
    jaws: float = 1.0
    gaster: float = 1.0
    girth: float = 1.0
    thorax: float = 1.0
    scars: bool = False


WORKER = Build("ant")
SOLDIER = Build("ant_soldier", head=1.34, jaws=1.35, gaster=0.84, girth=0.92, thorax=1.06)
QUEEN = Build("ant_queen", head=0.92, jaws=0.8, gaster=1.38, girth=1.5, thorax=1.28, scars=True)

NECK: Point = (0.222, 0.172, 0.0)
WAIST: Point = (-0.095, 0.142, 0.0)
PETIOLE_END: Point = (-0.152, 0.142, 0.0)

# The right legs from front to hind: coxa, femur, tibia (the knee), tarsus (the ankle), claw.
LEGS: tuple[Joints, ...] = (
    ((0.165, 0.142, 0.034), (0.190, 0.100, 0.062), (0.266, 0.236, 0.170), (0.326, 0.030, 0.252), (0.376, 0.0, 0.296)),
    ((0.082, 0.136, 0.040), (0.088, 0.097, 0.076), (0.072, 0.248, 0.208), (0.038, 0.030, 0.336), (0.036, 0.0, 0.402)),
    ((0.006, 0.134, 0.040), (-0.008, 0.097, 0.074), (-0.118, 0.278, 0.180), (-0.266, 0.030, 0.306), (-0.334, 0.0, 0.346)),
)


def joints(build: Build) -> dict[str, tuple[str, Point]]:
    """The joints by name: the parent and where each is in the rest pose."""
    made: dict[str, tuple[str, Point]] = {
        "root": ("", (0.0, 0.0, 0.0)),
        "thorax": ("root", (0.075, HEIGHT, 0.0)),
        "head": ("thorax", NECK),
        "petiole": ("thorax", WAIST),
        "gaster": ("petiole", PETIOLE_END),
        "gaster_tip": ("gaster", (PETIOLE_END[0] - 0.20 * build.gaster, 0.165, 0.0)),
    }
    for side, sign in (("l", -1.0), ("r", 1.0)):
        for name, parent, at in (
            ("mandible", "head", head_place((0.148, -0.030, 0.050), build)),
            ("scape", "head", head_place((0.128, 0.030, 0.030), build)),
            ("funiculus", "scape", scape_end(build)),
            ("club", "funiculus", funiculus_middle(build)),
        ):
            made[f"{name}_{side}"] = (parent if parent == "head" else f"{parent}_{side}", (at[0], at[1], sign * at[2]))
    made["load"] = ("head", load_place(build))
    made |= leg_joints(LEGS, "thorax")
    return made


def head_place(at: Point, build: Build) -> Point:
    """A place given from the neck for the worker's head."""
    return (NECK[0] + at[0] * build.head, NECK[1] + at[1] * build.head, at[2] * build.head)


def scape_end(build: Build) -> Point:
    root = head_place((0.128, 0.030, 0.030), build)
    return (root[0] + 0.068, root[1] + 0.112, root[2] + 0.108)


def funiculus_middle(build: Build) -> Point:
    root = scape_end(build)
    return (root[0] + 0.105, root[1] - 0.052, root[2] + 0.034)


def funiculus_end(build: Build) -> Point:
    root = scape_end(build)
    return (root[0] + 0.195, root[1] - 0.112, root[2] + 0.052)


def load_place(build: Build) -> Point:
    """Between the tips of the jaws."""
    at = head_place((0.148, -0.030, 0.0), build)
    return (at[0] + 0.085 * build.head * build.jaws, at[1] - 0.014 * build.head * build.jaws, 0.0)


def gaster_raised(behind: Floats | float, build: Build) -> Floats:
    """How much higher the middle of a gaster that is thicker than a worker's is carried, at so much `behind` its beginning: so
    that its underside is as far over the ground as a worker's."""
    share = np.clip(np.asarray(behind, np.float64) / 0.16, 0.0, 1.0)
    return np.asarray(0.106 * max(build.girth - 1.0, 0.0) * share * share * (3 - 2 * share))


# By leg: l1, r1, l2, r2, l3, r3. Slow ants lift one leg after the other from hind to front, fast ones front and hind of one side
# with the middle of the other (D. Wilson, Insect walking, 1966; C. Zollikofer, Stepping patterns in ants, 1994).
_WAVE = (0.667, 0.167, 0.333, 0.833, 0.0, 0.5)
_TRIPOD = (0.0, 0.5, 0.5, 0.0, 0.0, 0.5)
GAITS = (
    Gait("wave", 0.3, 0.34, 0.74, 0.045, _WAVE),
    Gait("tripod", 1.5, 0.56, 0.58, 0.060, _TRIPOD),
    Gait("fast tripod", 4.0, 0.80, 0.50, 0.070, _TRIPOD),
    Gait("sprint", 9.0, 1.15, 0.42, 0.075, _TRIPOD),
)
