"""Long walks on one shape at a time, held to all that is true of any surface: `python tests/torture_long.py` prints a table.

`--agents 5000 --steps 5000` by default. Names of shapes pick some of them; the path of a closed mesh is walked on as well."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import open3d
import trimesh
from meshes import Mesh
from numpy.typing import NDArray
from torture_walks import BODY, HAIR, WalkMeasures, above, crowd, parts, shapes, wander, winding

from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.mesh.surroundings import EYE_HEIGHT_BODY_LENGTHS
from antdsl.ground.protocol import GroundMove

SHAPES = shapes()
SHEETS = ("pot", "moebius", "rag", "ground")
TALL = 150.0  # mm: as long as a mesh from a file is made
EVERY = 25  # steps between two looks at who is in what
FINE = 1e-9  # mm: nearer to feet than any wall that they have not gone through, and more than float64 rounds; rays need a hair
SideTest = Callable[[MeshGround, GroundMove], NDArray[np.bool_]]


class Rooms:
    """In which closed meshes places are: by the parity of what a ray crosses, which is fast, and by winding numbers."""

    def __init__(self, closed: list[Mesh]) -> None:
        self.closed, self.scenes = closed, []
        for vertices, faces in closed:
            scene = open3d.t.geometry.RaycastingScene(nthreads=1)
            scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
            self.scenes.append(scene)

    def parity(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Bool (meshes, n)."""
        points32 = points.astype(np.float32)
        return np.stack([s.compute_occupancy(points32, nthreads=1, nsamples=3).numpy() > 0 for s in self.scenes])

    def winding(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Whole numbers (meshes, n)."""
        return np.stack([np.round(winding(mesh, points)).astype(np.int64) for mesh in self.closed])


@dataclass(slots=True)
class Walls:
    """Who has gone through a wall: who is in another room than at first. The parity of rays, from a hair above the feet, says
    who may be; winding numbers, computed so near above the feet that no wall comes between, say who is. In a wedge that is
    narrower than a hair the hair is in the next room."""

    rooms: Rooms
    began: NDArray[np.int64]
    near: float  # mm above the feet
    through: set[int] = field(default_factory=set)

    @staticmethod
    def of(closed: list[Mesh], ground: MeshGround, at: GroundMove, near: float) -> Walls:
        rooms = Rooms(closed)
        return Walls(rooms, rooms.winding(above(ground, at, near)), near)

    def look(self, ground: MeshGround, at: GroundMove) -> None:
        parity = self.rooms.parity(above(ground, at))
        self._ask(ground, at, np.flatnonzero((parity != (self.began % 2 == 1)).any(axis=0)))

    def end(self, ground: MeshGround, at: GroundMove) -> None:
        self._ask(ground, at, np.arange(len(at.up)))

    def _ask(self, ground: MeshGround, at: GroundMove, rows: NDArray[np.int64]) -> None:
        if rows.size:
            now = self.rooms.winding(above(ground, at.select_rows(rows), self.near))
            self.through |= set(rows[(now != self.began[:, rows]).any(axis=0)].tolist())


def start_crowd(ground: MeshGround, mesh: Mesh, closed: list[Mesh], n: int, rng: np.random.Generator) -> GroundMove:
    """A crowd. Where stones are sunk in each other no agent begins in the sunken part of one; nor where feet are in another room
    than the eye above them, which sees the other stones."""
    begin = crowd(ground, [mesh], n if len(closed) < 2 else 3 * n, rng)
    if len(closed) > 1:
        free = ~np.any([np.abs(winding(each, above(ground, begin))) > 0.5 for each in closed], axis=0)
        begin = begin.select_rows(np.flatnonzero(free)[:n])
    for each in closed if len(closed) > 1 else []:
        feet, eye = (np.round(winding(each, above(ground, begin, high))) for high in (HAIR, EYE_HEIGHT_BODY_LENGTHS * BODY))
        begin = begin.select_rows(np.flatnonzero(feet == eye))
    return begin


def solid(name: str, mesh: Mesh) -> list[Mesh]:
    """The closed meshes that a shape is made of."""
    if name in SHEETS:
        return []
    if name == "stones":
        return parts(mesh, len(SHAPES.STACK))
    if name == "broken":
        plain = SHAPES.build_stone(65, (22.0, 20.0, 22.0), detail=2)
        return [(plain[0] + np.array([0.0, 19.0, 0.0]), plain[1])]
    return [mesh]


@dataclass(slots=True)
class Walked:
    """What is seen of a crowd on a shape: of how many, how many of them went through a wall, how many met no surface at some
    step (no agent that walks over triangles should: borders are not counted), and seconds that each move took."""

    measures: WalkMeasures
    agents: int
    through: int
    missed: int
    seconds: list[float]


def long_walk(name: str, mesh: Mesh, n: int, steps: int, by_rays: bool = False) -> Walked:
    """A crowd that begins evenly over a shape and walks at random."""
    ground, rng, measures = MeshGround({name: mesh}, by_rays), np.random.default_rng(4), WalkMeasures()
    closed = solid(name, mesh)
    begin = start_crowd(MeshGround({name: mesh}), mesh, closed, n, rng)
    n = len(begin.up)
    walls = Walls.of(closed, ground, begin, HAIR if by_rays else FINE) if closed else None
    at, sides = begin, side(ground, begin)
    through, missed, seconds = np.zeros(n, bool), np.zeros(n, bool), []
    steady = wander(ground, begin, steps, rng)
    for k in range(steps):
        start = time.perf_counter()
        previous, at = next(steady)
        seconds.append(time.perf_counter() - start)
        measures.look(ground, [mesh], previous, at)
        missed |= at.is_blocked if by_rays else at.is_lost
        if walls is not None and k % EVERY == EVERY - 1:
            walls.look(ground, at)
        if name in ("pot", "rag", "ground"):  # sheets of one winding: who comes to the other side went through, or round
            through |= side(ground, at) != sides
    if walls is not None:
        walls.end(ground, at)
        through[list(walls.through)] = True
    return Walked(measures, n, int(through.sum()), int(missed.sum()), seconds)


def side(ground: MeshGround, at: GroundMove) -> NDArray[np.bool_]:
    return np.asarray((ground.normal(at.footing) * at.up).sum(axis=1) > 0)


def from_file(path: Path) -> Mesh:
    """A mesh of a file, made TALL and put at the origin."""
    loaded = trimesh.load(path, process=False, force="mesh")
    vertices = np.asarray(loaded.vertices, np.float64)
    vertices = (vertices - vertices.mean(axis=0)) * (TALL / np.ptp(vertices, axis=0).max())
    return vertices, np.asarray(loaded.faces, np.int32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(SHAPES.SHAPES))
    parser.add_argument("--agents", type=int, default=5000)
    parser.add_argument("--steps", type=int, default=5000)
    options = parser.parse_args()
    print("shape      agents  steps       s  surface/body      tilt  lost  through      mm")
    for name in options.names:
        label, mesh = (name, SHAPES.SHAPES[name]()) if name in SHAPES.SHAPES else (Path(name).stem, from_file(Path(name)))
        walked = long_walk(label, mesh, options.agents, options.steps)
        measures = walked.measures
        print(
            f"{label:10} {walked.agents:6} {options.steps:6} {sum(walked.seconds):7.0f} "
            f"{measures.away:13.1e} {measures.tilt:9.1e} "
            f"{measures.lost:5} {walked.through:8} {measures.moved:7.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
