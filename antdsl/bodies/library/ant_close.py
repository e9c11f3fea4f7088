"""The ant for close-ups: about 20,000 triangles. Every part is closed and rigid, as cuticle is; where two are jointed one ends
in a ball inside the other, so that nothing gapes when they turn."""

from __future__ import annotations

import numpy as np

from antdsl.bodies.library import ant_rig as rig
from antdsl.bodies.library.hair import hairs
from antdsl.bodies.library.insect_legs import fine_leg
from antdsl.bodies.library.modelling import Model, bands, profile
from antdsl.bodies.library.surfaces import Array, Surface, ellipsoid, limb, loft, smooth_through

_TERGITES = 5


def close(model: Model, build: rig.Build) -> None:
    """Adds the parts of the ant for close-ups to a model."""
    _thorax(model, build)
    _petiole(model)
    _gaster(model, build)
    _head(model, build)
    _mandibles(model, build)
    _antennae(model, build)
    for number, points in enumerate(rig.LEGS, 1):
        fine_leg(model, number, points)


def _lathe(rows: Array, sides: int, square: float = 1.0, flat_below: float = 0.0) -> Surface:
    """A body along x of rows (x, y, half its height, half its width), its underside `flat_below` flatter than its back."""
    path = np.stack([rows[:, 0], rows[:, 1], np.zeros(len(rows))], 1)
    made = loft(path, rows[:, 2], rows[:, 3], sides, square=square)
    if not flat_below:
        return made
    middle = np.interp(-made.points[:, 0], -rows[:, 0], rows[:, 1])
    below = np.minimum(made.points[:, 1] - middle, 0.0)
    points = made.points.copy()
    points[:, 1] -= flat_below * below
    return made.moved(points)


def _dents(rows: Array, places: tuple[tuple[float, float, float], ...]) -> Array:
    """Rows made narrower about places (x, how wide, by which share): the grooves between plates."""
    by = np.ones(len(rows))
    for x, wide, share in places:
        by *= 1 - share * np.exp(-(((rows[:, 0] - x) / wide) ** 2))
    rows[:, 2:] *= by[:, None]
    return rows


def _thorax(model: Model, build: rig.Build) -> None:
    t = build.thorax
    keys = [
        (-0.243, 0.172, 0.012, 0.012),
        (-0.232, 0.172, 0.024, 0.024),
        (-0.205, 0.176, 0.045, 0.044),
        (-0.165, 0.180, 0.058 * t, 0.054 * t),
        (-0.115, 0.181, 0.058 * t, 0.053 * t),
        (-0.060, 0.176, 0.050 * t, 0.045 * t),
        (-0.010, 0.168, 0.045, 0.041),
        (0.035, 0.163, 0.048, 0.042),
        (0.075, 0.152, 0.036, 0.031),
        (0.096, 0.143, 0.017, 0.017),
        (0.103, 0.142, 0.010, 0.010),
    ]
    rows = profile(keys, 36)
    rows[:, 0] *= -1
    rows = _dents(rows, ((0.205, 0.006, 0.10), (0.128, 0.006, 0.10), (0.040, 0.008, 0.14), (0.022, 0.005, 0.06)))
    made = _lathe(rows, 24, square=0.92, flat_below=0.15)
    model.add(made, "thorax", "thorax", "thorax")
    for x, y, z in ((0.155, 0.205, 0.046), (-0.035, 0.186, 0.037)):  # spiracles
        model.both(ellipsoid((x, y, z), (0.008, 0.006, 0.004), 0), "thorax", "seam", "spiracle")
    if build.scars:
        for x in (0.105, 0.045):
            model.both(ellipsoid((x, 0.212, 0.040), (0.018, 0.008, 0.008), 1), "thorax", "seam", "scar")
    hairs(model, made, "thorax", 60, 0.034, seed=1, where=lambda p, n: n[:, 1] > 0.35)


def _petiole(model: Model) -> None:
    stem = limb([(-0.088, 0.142, 0.0), (-0.12, 0.134, 0.0), (-0.160, 0.142, 0.0)], [0.017, 0.013, 0.017], 12, 7)
    model.add(stem, "petiole", "thorax", "stem")
    rows = np.array(
        [
            (0.128, 0.020, 0.018),
            (0.142, 0.019, 0.022),
            (0.162, 0.016, 0.028),
            (0.182, 0.012, 0.031),
            (0.196, 0.008, 0.028),
            (0.205, 0.004, 0.018),
        ]
    )
    rows = np.concatenate([[(0.120, 0.006, 0.006)], rows, [(0.208, 0.001, 0.006)]])
    path = np.stack([np.interp(rows[:, 0], [0.12, 0.21], [-0.118, -0.128]), rows[:, 0], np.zeros(len(rows))], 1)
    scale = loft(path, rows[:, 1], rows[:, 2], 18, up=(1.0, 0.0, 0.0))
    model.add(scale, "petiole", "thorax", "scale")
    hairs(model, scale, "petiole", 10, 0.028, seed=2, where=lambda p, n: n[:, 1] > 0.4)


def _gaster(model: Model, build: rig.Build) -> None:
    end, long, girth = rig.PETIOLE_END, build.gaster, build.girth
    keys = [
        (-0.010, 0.000, 0.010, 0.010),
        (0.000, 0.001, 0.022, 0.022),
        (0.030, 0.008, 0.066, 0.070),
        (0.080, 0.020, 0.096, 0.103),
        (0.140, 0.027, 0.106, 0.115),
        (0.200, 0.026, 0.098, 0.106),
        (0.260, 0.020, 0.076, 0.082),
        (0.310, 0.009, 0.046, 0.050),
        (0.340, 0.001, 0.021, 0.022),
        (0.348, -0.001, 0.008, 0.008),
    ]
    smooth = np.asarray(keys)
    edges = np.array([0.095, 0.170, 0.236, 0.290, 0.325])  # where one plate ends over the next
    at = np.unique(
        np.concatenate(
            [
                np.linspace(-0.010, 0.03, 6),
                np.linspace(0.03, 0.32, 26),
                np.linspace(0.32, 0.348, 6),
                *((edge - 0.0006, edge, edge + 0.0030, edge + 0.007) for edge in edges),
            ]
        )
    )
    rows = np.concatenate([at[:, None], smooth_through(smooth[:, 1:], at, smooth[:, 0])], 1)
    # Each plate widens towards its hind edge and steps down onto the next.
    start = np.concatenate([[-0.010], edges])
    plate = np.clip(np.searchsorted(edges, at, side="left"), 0, _TERGITES)
    share = np.clip((at - start[plate]) / (np.append(edges, 0.348)[plate] - start[plate]), 0, 1)
    rows[:, 2:] *= (1 + 0.030 * (share - 0.5) - 0.035 * np.exp(-(((at - start[plate]) / 0.004) ** 2)) * (plate > 0))[:, None]
    rows[:, 2:] *= girth
    rows[:, 1] += end[1] + rig.gaster_raised(rows[:, 0], build)
    rows[:, 0] = end[0] - rows[:, 0] * long
    made = _lathe(rows, 30)
    length = 0.358
    dark = [e / length + 0.010 / length for e in edges]
    lines: list[float] = []
    names: list[str] = ["seam"]
    lines.append(0.030)
    for edge in dark:
        lines += [edge - 0.018 / length, edge + 0.001 / length]
        names += ["state", "seam"]
    names.append("state")
    tip = [(0.45, "gaster"), (0.80, "gaster_tip")]
    model.add(made, tip, bands(names, lines), "gaster")
    hairs(model, made, tip, 150, 0.042, seed=3, where=lambda p, n: n[:, 0] < 0.6, lean=(-0.9, 0.2, 0.0))


def _head(model: Model, build: rig.Build) -> None:
    k, neck = build.head, np.array(rig.NECK)
    keys = [
        (-0.020, 0.002, 0.014, 0.016),
        (-0.012, 0.003, 0.030, 0.040),
        (0.004, 0.006, 0.049, 0.068),
        (0.030, 0.009, 0.062, 0.088),
        (0.070, 0.008, 0.067, 0.096),
        (0.105, 0.001, 0.062, 0.090),
        (0.135, -0.010, 0.050, 0.076),
        (0.158, -0.020, 0.034, 0.058),
        (0.172, -0.026, 0.018, 0.040),
        (0.177, -0.028, 0.008, 0.020),
    ]
    rows = profile(keys, 34)
    made = _lathe(rows * np.array([1.0, 1.0, 1.0, 1.0]), 30, square=0.94)
    points = made.points.copy()
    # The hind edge is hollow in the middle, as a heart's; a keel runs down the face to the plate above the jaws.
    hollow = np.exp(-((points[:, 2] / 0.034) ** 2)) * np.clip((0.02 - points[:, 0]) / 0.04, 0, 1)
    points[:, 0] += 0.016 * hollow
    keel = np.exp(-((points[:, 2] / 0.007) ** 2)) * np.clip((points[:, 0] - 0.085) / 0.03, 0, 1) * (points[:, 1] > -0.01)
    points[:, 1] += 0.005 * keel
    clypeus = np.exp(-(((points[:, 0] - 0.128) / 0.004) ** 2)) * (points[:, 1] > -0.012) * (np.abs(points[:, 2]) < 0.055)
    points[:, 1] -= 0.004 * clypeus
    # Pits in which the antennae turn.
    for side in (-1, 1):
        far = np.linalg.norm(points - np.array([0.128, 0.026, side * 0.030]), axis=1)
        points[:, 1] -= 0.006 * np.exp(-((far / 0.014) ** 2))
    made = made.moved(points * k + neck)
    model.add(made, "head", "head", "head")
    _eyes(model, k, neck)
    lip = ellipsoid(tuple(neck + k * np.array([0.163, -0.040, 0.0])), (0.016 * k, 0.010 * k, 0.030 * k), 1)
    model.add(lip, "head", "head", "lip")
    for z, out in ((0.016, 0.030), (0.026, 0.044)):  # palps
        path = [(0.150, -0.048, z), (0.172, -0.066, z + 0.006), (0.166, -0.082, out), (0.150, -0.090, out)]
        model.both(
            limb([tuple(neck + k * np.array(p)) for p in path], [0.0042 * k, 0.004 * k, 0.0035 * k, 0.002 * k], 5),
            "head",
            "leg",
            "palp",
        )
    model.add(
        limb([(0.205, 0.172, 0.0), (0.222, 0.172, 0.0), (0.240, 0.173, 0.0)], [0.018, 0.020, 0.020], 12, 5),
        "thorax",
        "joint",
        "neck",
    )
    hairs(model, made, "head", 50, 0.030, seed=4, where=lambda p, n: (n[:, 1] > 0.1) | (n[:, 0] > 0.5))


def _eyes(model: Model, k: float, neck: Array) -> None:
    eye = ellipsoid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 3)
    # The points of a coarser sphere are the middles of facets; those between lie lower.
    coarse = len(np.unique(ellipsoid((0, 0, 0), (1, 1, 1), 2).points.round(9), axis=0))
    known = {tuple(p) for p in eye.points[:coarse].round(6)}
    raised = np.array([tuple(p) in known for p in eye.points.round(6)])
    ball = eye.points * np.where(raised, 1.035, 0.985)[:, None]
    half = np.array([0.027, 0.023, 0.014])
    tilt = np.radians(24.0)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]])
    placed = eye.moved(((ball * half) @ turn + np.array([0.062, 0.030, 0.083])) * k + neck)
    model.both(placed, "head", "eye", "eye")
    for x, z in ((0.020, 0.0), (0.006, 0.014), (0.006, -0.014)):  # ocelli
        model.add(
            ellipsoid(tuple(neck + k * np.array([x, 0.067 - 0.1 * (0.02 - x), z])), (0.006 * k,) * 3, 1), "head", "eye", "ocellus"
        )


def _mandibles(model: Model, build: rig.Build) -> None:
    """Curved blades, broad at the biting edge, with teeth that grow towards the tip."""
    k = build.head * build.jaws
    root = np.array(rig.head_place((0.148, -0.030, 0.050), build))
    rings, sides = 36, 10
    at = np.linspace(0.0, 1.0, rings)
    path = smooth_through(
        [(-0.012, 0.004, -0.006), (0.012, 0.0, 0.004), (0.042, -0.006, 0.006), (0.068, -0.012, -0.008), (0.090, -0.018, -0.034)],
        at,
    )
    thick = smooth_through(np.array([0.010, 0.014, 0.013, 0.010, 0.003]), at)
    broad = smooth_through(np.array([0.012, 0.018, 0.021, 0.019, 0.003]), at)
    made = loft(path, thick, broad, sides)
    # Teeth stand on the inner edge: where a ring's point lies inwards, it goes out and back along the blade.
    ring = np.repeat(at, sides + 1)
    inward = np.repeat(path, sides + 1, axis=0)[:, 2] - made.points[: rings * (sides + 1), 2]
    inward = np.clip(inward / np.maximum(np.repeat(broad, sides + 1), 1e-6), 0, 1) ** 3
    saw = np.where(ring > 0.36, 0.5 + 0.5 * np.cos(2 * np.pi * (ring - 0.36) / 0.105), 0.0)
    points = made.points.copy()
    points[: len(ring), 2] -= 0.011 * inward * saw**0.7 * (0.6 + 0.6 * ring)
    model.both(made.moved(points * k + root), "mandible_r", bands(["head", "jaw"], [0.22]), "mandible")


def _antennae(model: Model, build: rig.Build) -> None:
    root = rig.head_place((0.128, 0.030, 0.030), build)
    elbow, middle, end = rig.scape_end(build), rig.funiculus_middle(build), rig.funiculus_end(build)
    bow = tuple(np.add(root, elbow) / 2 + np.array([-0.006, 0.006, -0.004]))
    model.both(ellipsoid(root, (0.012, 0.012, 0.012), 1), "scape_r", "joint", "socket")
    model.both(limb([root, bow, elbow], [0.0075, 0.0085, 0.0115], 10, 8), "scape_r", "leg", "scape")
    model.both(ellipsoid(elbow, (0.0110, 0.0110, 0.0110), 1), "funiculus_r", "joint", "elbow")
    pieces, each = 10, 4
    at = np.linspace(0, 1, pieces * each + 1)
    path = smooth_through([elbow, middle, end], at, np.array([0.0, 0.52, 1.0]))
    inside = (at * pieces) % 1.0
    radius = (0.0070 + 0.0035 * at) * (0.72 + 0.28 * np.sin(np.pi * np.clip(inside * 0.9 + 0.08, 0, 1)) ** 0.6)
    radius[-3:] *= (0.92, 0.70, 0.30)
    model.both(loft(path, radius, radius, 8), [(0.40, "funiculus_r"), (0.62, "club_r")], "leg", "funiculus")
