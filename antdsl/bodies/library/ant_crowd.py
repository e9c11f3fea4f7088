"""The ant for crowds: fewer than 500 triangles, all parts closed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from antdsl.bodies.library import ant_rig as rig
from antdsl.bodies.library.insect_legs import crowd_leg
from antdsl.bodies.library.modelling import Model
from antdsl.bodies.library.surfaces import Point, Surface, loft


def lathe(rows: Sequence[tuple[float, float, float, float]], sides: int, shift: Point = (0.0, 0.0, 0.0)) -> Surface:
    """A body along x of rows (x, y, half its height, half its width)."""
    table = np.array(rows)
    path = np.stack([table[:, 0], table[:, 1], np.zeros(len(table))], 1) + np.array(shift)
    return loft(path, table[:, 2], table[:, 3], sides)


def crowd(model: Model, build: rig.Build) -> None:
    """Adds the parts of the ant for crowds to a model."""
    b, end = build, rig.PETIOLE_END
    long, girth = b.gaster, b.girth
    rows = [
        (0.006, 0.0, 0.012, 0.012),
        (-0.05, 0.012, 0.072, 0.078),
        (-0.16, 0.028, 0.106, 0.114),
        (-0.27, 0.020, 0.078, 0.084),
        (-0.348, -0.002, 0.014, 0.014),
    ]
    gaster = [(end[0] + x * long, end[1] + y + float(rig.gaster_raised(-x, build)), h * girth, w * girth) for x, y, h, w in rows]
    model.add(lathe(gaster, 7), [(0.45, "gaster"), (0.85, "gaster_tip")], "state", "gaster")
    t = b.thorax
    thorax = [
        (0.236, 0.172, 0.020, 0.020),
        (0.185, 0.178, 0.055 * t, 0.052 * t),
        (0.085, 0.176, 0.054 * t, 0.050 * t),
        (-0.03, 0.158, 0.046, 0.040),
        (-0.092, 0.142, 0.016, 0.016),
    ]
    model.add(lathe(thorax, 6), "thorax", "thorax", "thorax")
    petiole = [(-0.085, 0.140, 0.012, 0.012), (-0.115, 0.158, 0.040, 0.026), (-0.155, 0.142, 0.012, 0.012)]
    model.add(lathe(petiole, 5), [(0.3, "petiole"), (1.0, "gaster")], "thorax", "petiole")
    k = b.head
    head = [
        (-0.012, 0.004, 0.022, 0.026),
        (0.022, 0.008, 0.060, 0.082),
        (0.082, 0.006, 0.066, 0.094),
        (0.138, -0.010, 0.048, 0.072),
        (0.166, -0.024, 0.020, 0.044),
    ]
    model.add(lathe([(rig.NECK[0] + x * k, rig.NECK[1] + y * k, h * k, w * k) for x, y, h, w in head], 7), "head", "head", "head")
    _limbs(model, build)


def _limbs(model: Model, build: rig.Build) -> None:
    table = rig.joints(build)
    for number, points in enumerate(rig.LEGS, 1):
        crowd_leg(model, number, points)
    scape, funiculus, club = (table[f"{name}_r"][1] for name in ("scape", "funiculus", "club"))
    radii = np.array([0.009, 0.011, 0.010, 0.006])
    path = [scape, funiculus, club, rig.funiculus_end(build)]
    model.both(
        loft(path, radii, radii, 3),
        [(0.38, "scape_r"), (0.48, "funiculus_r"), (0.62, "funiculus_r"), (0.85, "club_r")],
        "leg",
        "antenna",
    )
    root = table["mandible_r"][1]
    k = build.head * build.jaws
    path = [
        root,
        (root[0] + 0.055 * k, root[1] - 0.008 * k, root[2] + 0.004 * k),
        (root[0] + 0.092 * k, root[1] - 0.016 * k, 0.008),
    ]
    model.both(loft(path, [0.016 * k, 0.014 * k, 0.004], [0.020 * k, 0.018 * k, 0.004], 3), "mandible_r", "jaw", "jaw")
