"""Bodies for species that are no ants: a person, an arrow, a ball. Length 1 along +x, up +y, on y = 0."""

import numpy as np

from antdsl.bodies.body import Body, rigid
from antdsl.bodies.shapes import Mesh, joined, sphere


def _ellipsoid(centre: tuple[float, float, float], half: tuple[float, float, float], detail: int) -> Mesh:
    vertices, faces = sphere(detail)
    return vertices * np.array(half) + np.array(centre), faces


def person(fine: bool = False) -> Body:
    """Somebody who stands: head, trunk, arms, two legs; 1.9 high where shoulder to shoulder is 0.85."""
    detail = 2 if fine else 0
    parts = [
        (_ellipsoid((0.05, 1.72, 0.0), (0.15, 0.19, 0.14), detail), 0.4),
        (_ellipsoid((0.0, 1.15, 0.0), (0.20, 0.42, 0.29), detail), 1.0),
        (_ellipsoid((0.0, 1.10, 0.34), (0.09, 0.38, 0.08), detail), 0.9),
        (_ellipsoid((0.0, 1.10, -0.34), (0.09, 0.38, 0.08), detail), 0.9),
        (_ellipsoid((0.03, 0.42, 0.13), (0.12, 0.42, 0.12), detail), 0.2),
        (_ellipsoid((-0.03, 0.42, -0.13), (0.12, 0.42, 0.12), detail), 0.2),
    ]
    vertices, faces = joined([mesh for mesh, _ in parts])
    tint = np.concatenate([np.full(len(mesh[0]), share, np.float32) for mesh, share in parts])
    return rigid("person", (vertices, faces), tint)


def arrow(fine: bool = False) -> Body:
    """A dart that points where it goes: for birds, fish, anything seen as a flock."""
    del fine  # it is as good from near
    vertices = np.array([(0.5, 0.14, 0.0), (-0.5, 0.10, 0.30), (-0.5, 0.10, -0.30), (-0.30, 0.30, 0.0), (-0.32, 0.04, 0.0)])
    faces = np.array([(0, 3, 1), (0, 2, 3), (0, 1, 4), (0, 4, 2), (1, 3, 4), (2, 4, 3)], np.int32)
    flat = vertices[faces.reshape(-1)]  # corners of its own for each face, so that edges stay sharp
    return rigid("arrow", (flat, np.arange(18, dtype=np.int32).reshape(-1, 3)))


def ball(fine: bool = False) -> Body:
    """A ball of diameter 1 with a small nose that shows where it heads."""
    nose = _ellipsoid((0.47, 0.5, 0.0), (0.10, 0.10, 0.10), 1 if fine else 0)
    trunk = _ellipsoid((0.0, 0.5, 0.0), (0.5, 0.5, 0.5), 3 if fine else 1)
    vertices, faces = joined([trunk, nose])
    tint = np.concatenate([np.ones(len(trunk[0]), np.float32), np.zeros(len(nose[0]), np.float32)])
    return rigid("ball", (vertices, faces), tint)
