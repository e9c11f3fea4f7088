"""Crowds that walk at random on any surface, and what is measured of them: distance to it, tilt, jumps, walls gone through."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from meshes import Mesh
from numpy.typing import NDArray

from antdsl.casting.faces import find_nearest_on_triangle
from antdsl.casting.rays import RayScene
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.protocol import Footing, GroundMove

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "torture"
BODY = 4.0
STEP = 1.25
HAIR = 1e-4  # mm: how far above its surface an agent is for the test of what it is in
JUMP = 0.6 * BODY  # beyond the step: of those who step over to another surface or round a border


def shapes() -> ModuleType:
    """The script of the example that makes the shapes."""
    spec = importlib.util.spec_from_file_location("make_shapes", EXAMPLE / "make_shapes.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def crowd(ground: MeshGround, meshes: list[Mesh], n: int, rng: np.random.Generator) -> GroundMove:
    """Agents evenly over all faces, on both sides of them, heading anywhere."""
    corners = np.concatenate([v[f] for v, f in meshes])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    area[~ground.triangles[3].is_live] = 0
    face = rng.choice(len(area), n, p=area / area.sum())
    owner = np.repeat(np.arange(len(meshes)), [len(f) for _, f in meshes])
    first = np.cumsum([0, *(len(f) for _, f in meshes)])
    u, v = np.sort(rng.uniform(0, 1, (2, n)), axis=0)
    footing = Footing.from_faces(owner[face].astype(np.int32), (face - first[owner[face]]).astype(np.int32), u, 1 - v)
    up = ground.normal(footing) * rng.choice([-1.0, 1.0], (n, 1))
    return ground.move(footing, np.zeros((n, 3)), rng.normal(size=(n, 3)), up, BODY)


def wander(
    ground: MeshGround, at: GroundMove, steps: int, rng: np.random.Generator, threads: int = 1
) -> Iterator[tuple[GroundMove, GroundMove]]:
    """Go on and on, turning at random: all positions before and after."""
    for _ in range(steps):
        heading = at.heading + np.cross(at.up, at.heading) * rng.normal(0, 0.3, (len(at.up), 1))
        heading /= np.linalg.norm(heading, axis=1, keepdims=True)
        # Who has come to a border turns round, or it would stand there for ever.
        heading = np.where(at.is_blocked[:, None], -heading, heading)
        previous, at = at, ground.move(at.footing, heading * STEP, heading, at.up, BODY, threads)
        yield previous, at


def above(ground: MeshGround, at: GroundMove, high: float = HAIR) -> NDArray[np.float64]:
    """Places a hair off the surface, or `high` mm, on the side that all agents are on."""
    normal = ground.normal(at.footing)
    return at.position + normal * np.where((normal * at.up).sum(axis=1) < 0, -high, high)[:, None]


def winding(mesh: Mesh, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """How often a closed mesh goes round each point (van Oosterom, Strackee, The Solid Angle of a Plane
    Triangle, 1983, p. 125)."""
    total = np.empty(len(points))
    corners = mesh[0][mesh[1]]
    for start in range(0, len(points), 500):
        a, b, c = (corners[None, :, k] - points[start : start + 500, None] for k in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
        top = (a * np.cross(b, c)).sum(axis=2)
        low = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
        total[start : start + 500] = 2 * np.arctan2(top, low).sum(axis=1) / (4 * np.pi)
    return total


def parts(mesh: Mesh, size: int) -> list[Mesh]:
    """The stones of a stack, which follow each other."""
    points, faces = len(mesh[0]) // size, len(mesh[1]) // size
    return [(mesh[0][k * points : (k + 1) * points], mesh[1][k * faces : (k + 1) * faces] - k * points) for k in range(size)]


def inside(mesh: Mesh, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.abs(winding(mesh, points)) > 0.5


def depth(mesh: Mesh, points: NDArray[np.float64]) -> float:
    """How far any point is inside a closed mesh, mm; 0 where none is."""
    within = points[inside(mesh, points)]
    return float(RayScene(*mesh).find_closest(within)[3].max()) if len(within) else 0.0


@dataclass(slots=True)
class WalkMeasures:
    """The worst of a run: distance to the surface in body lengths, heading against normal, jumps in mm, how many were lost."""

    away: float = 0.0
    tilt: float = 0.0
    jump: float = 0.0
    lost: int = 0
    moved: float = 0.0

    def look(self, ground: MeshGround, meshes: list[Mesh], previous: GroundMove, at: GroundMove) -> None:
        corners = ground.triangles[0][ground.triangles[1][ground.get_face_numbers(at.footing)[0]]]
        written = at.position.astype(np.float32).astype(np.float64)
        away = np.linalg.norm(find_nearest_on_triangle(written, corners) - written, axis=1)
        distances = np.linalg.norm(at.position - previous.position, axis=1)
        self.away = max(self.away, float(away.max()) / BODY)
        self.tilt = max(self.tilt, float(np.abs((at.heading * at.up).sum(axis=1)).max()))
        self.jump = max(self.jump, float(distances.max()))
        self.lost += int(np.count_nonzero(at.is_lost | ~np.isfinite(at.position).all(axis=1)))
        self.moved += float(distances.mean())

    def good(self) -> None:
        assert self.away < 1e-4 and self.tilt < 1e-4 and self.lost == 0, self
        assert self.jump < STEP + JUMP, self
