"""How bodies stand on five shapes, by each way of orienting them: how far from the shape's own normal, and how restless.

`python tests/benchmarks/orienting.py` prints the table of docs/scene.md; `--agents` and `--steps` change how long it takes."""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import meshes  # lie beside the tests
from plan_text import plan_of

from antdsl.passes import optimise_plan
from antdsl.plan import ir
from antdsl.runtime import CrowdData, MeshData, Options, PlacementData, WorldSetting, bind, step

Floats = np.ndarray
WANDERING = """use steering
species a { max_turn 360 deg/s
state walk { steer wander(swing: 90 deg) } }"""


def torus(wide: float = 60.0, thin: float = 20.0, n: int = 64, m: int = 32) -> meshes.Mesh:
    """A torus about the y axis."""
    a, b = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    u, v = a * (2 * np.pi / n), b * (2 * np.pi / m)
    r = wide + thin * np.cos(v)
    corner = np.stack([r * np.cos(u), thin * np.sin(v), r * np.sin(u)], axis=1)

    def at(i: Floats, j: Floats) -> Floats:
        return (i % n) * m + j % m

    quad = np.stack([at(a, b), at(a, b + 1), at(a + 1, b + 1), at(a + 1, b)], axis=1)
    return corner, np.concatenate([quad[:, (0, 1, 2)], quad[:, (0, 2, 3)]]).astype(np.int32)


def _around_ring(p: Floats) -> Floats:
    ring = p * (1, 0, 1)
    return p - 60.0 * ring / np.linalg.norm(ring, axis=1)[:, None]


def _on_hills(p: Floats) -> Floats:
    e = 1e-3
    slope = [
        (meshes.hills(p[:, 0] + a, p[:, 2] + b) - meshes.hills(p[:, 0] - a, p[:, 2] - b)) / (2 * e) for a, b in ((e, 0), (0, e))
    ]
    return np.stack([-slope[0], np.ones(len(p)), -slope[1]], axis=1)


def _on_box(p: Floats) -> Floats:
    side = np.argmax(np.abs(p), axis=1)
    normals = np.zeros_like(p)
    normals[np.arange(len(p)), side] = np.sign(p[np.arange(len(p)), side])
    return normals


@dataclass(frozen=True)
class Shape:
    """A mesh and the normals of the shape that it stands for, at places [n,3], of any length."""

    mesh: meshes.Mesh
    normal: Callable[[Floats], Floats]


SHAPES: dict[str, Shape] = {
    "plane": Shape(meshes.grid(400.0, 8), lambda p: np.tile((0.0, 1.0, 0.0), (len(p), 1))),
    "ball": Shape(meshes.ball(40.0, rings=32), lambda p: p),
    "torus": Shape(torus(), _around_ring),
    "hills": Shape(meshes.terrain(400.0, 120), _on_hills),
    "box": Shape(meshes.box((-40.0, -40.0, -40.0), (40.0, 40.0, 40.0)), _on_box),
}


@dataclass(frozen=True)
class Tilts:
    """Degrees between bodies and the shape's normal: their median and 99th percentile; degrees by which bodies tilt in a frame,
    their 99th percentile; seconds of processor a step."""

    median: float
    most: float
    restless: float
    seconds: float


def walking(plan: ir.Plan, shape: Shape, how: str, agents: int, steps: int, warm: int = 24) -> Tilts:
    """A crowd that wanders over a shape."""
    crowd = CrowdData("a", agents, PlacementData(surfaces=("s",)))
    setting = WorldSetting(surfaces={"s": MeshData(*shape.mesh)}, crowds=(crowd,), orient=how, seed=5)
    world = bind(plan, setting, Options(backend="native", wait_for_code=True))
    population, off, turned, seconds = world.populations["a"], [], [], []
    for number in range(warm + steps):
        ids, previous_up = population.ids.copy(), population.read_vector("up")
        start_time = time.process_time()
        step(world)
        took = time.process_time() - start_time
        if number < warm:
            continue
        seconds.append(took)
        up = population.read_vector("up")
        normal = shape.normal(population.position + world.origin)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        off.append(_degrees(up, normal * np.sign((normal * population.normal).sum(axis=1))[:, None]))
        if np.array_equal(ids, population.ids):
            turned.append(_degrees(up, previous_up))
    every, each = np.concatenate(off), np.concatenate(turned)
    return Tilts(
        float(np.median(every)), float(np.percentile(every, 99)), float(np.percentile(each, 99)), statistics.median(seconds)
    )


def _degrees(a: Floats, b: Floats) -> Floats:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", type=int, default=2000)
    parser.add_argument("--steps", type=int, default=120)
    options = parser.parse_args()
    plan = optimise_plan(plan_of(WANDERING, "ant 1\nworld { surface s }\n"))
    print("| shape | `orient` | off the shape, deg: median | 99 % | tilt a frame, deg: 99 % | CPU ms a step |")
    print("|---|---|---|---|---|---|")
    for name, shape in SHAPES.items():
        for how in ("normal", "turns", "probes"):
            tilts = walking(plan, shape, how, options.agents, options.steps)
            print(
                f"| {name} | {how} | {tilts.median:.2f} | {tilts.most:.1f} | {tilts.restless:.2f} | {1000 * tilts.seconds:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
