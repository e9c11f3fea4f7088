"""The model of T. Vicsek et al. (Novel type of phase transition in a system of self-driven particles, Phys. Rev. Lett. 75, 1995)
in antdsl and in plain NumPy: 400 birds in a square of 10 mm without borders, which turn to the mean direction within 1 mm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from periodic_scenes import write_plane
from scipy.spatial import cKDTree

from antdsl.pipeline import RunChoices, open_scene
from antdsl.runtime import Options, bind, step

BIRDS, SIDE, SPEED = 400, 10.0, 0.3
PROGRAM = """ant 2
"Vicsek 1995: all turn to the mean direction of those within 1 mm, themselves too, and err by eta."
world { surface ground }
species bird {
  param eta = 1 in 0 .. 6.3 "Noise, in radians"
  size 0.1 mm; max_speed 0.3 mm/step; response 1 step; max_turn none
  let course = heading + sum(n in neighbours(radius: 1 mm): n.heading)
  start fly
  state fly { steer match(rotate(unit(course), about: up, by: uniform(-0.5, 0.5) * eta * 1 rad) * 0.3 mm/step) }
  layers { state }
}
"""
SCENE = """antdsl: 1
fps: 1
frames: 0..400
wrap: {x: 0 mm .. 10 mm, z: 0 mm .. 10 mm}
world: {ground: {mesh: ground.ply}}
crowd: [{species: bird, from: vicsek.ant, body: arrow, count: 400, place: {on: ground}}]
"""


def write_scene(folder: Path) -> Path:
    """Write the scene, its program and its ground, and return the path of the scene."""
    write_plane(folder / "ground.ply", 20)
    (folder / "vicsek.ant").write_text(PROGRAM)
    (folder / "scene.yaml").write_text(SCENE)
    return folder / "scene.yaml"


def measure_order(scene: Path, eta: float, seed: int, frames: int, first: int) -> float:
    """Return the order parameter of a run: the length of the mean heading, on average from frame `first` on."""
    shot, report = open_scene(scene, RunChoices(seed=seed, params={"bird.eta": str(eta)}))
    assert shot is not None, report
    world, orders = bind(shot.plan, shot.setting, Options(backend="numpy", threads=1)), []
    for frame in range(1, frames + 1):
        step(world)
        if frame >= first:
            mean = world.populations["bird"].read_vector("heading").mean(axis=0)
            orders.append(np.hypot(mean[0], mean[2]))
    return float(np.mean(orders))


def measure_plain_order(eta: float, seed: int, frames: int, first: int) -> float:
    """Return the same of a run in plain NumPy, with neighbours of a k-d tree on a torus."""
    rng = np.random.default_rng(seed)
    place: NDArray[np.float64] = rng.uniform(0, SIDE, (BIRDS, 2))
    angle, orders = rng.uniform(0, 2 * np.pi, BIRDS), []
    for frame in range(1, frames + 1):
        pairs = cKDTree(place, boxsize=SIDE).query_pairs(1.0, output_type="ndarray")
        ahead = np.exp(1j * angle)
        total = ahead.copy()
        np.add.at(total, pairs[:, 0], ahead[pairs[:, 1]])
        np.add.at(total, pairs[:, 1], ahead[pairs[:, 0]])
        angle = np.angle(total) + rng.uniform(-eta / 2, eta / 2, BIRDS)
        place = (place + SPEED * np.stack([np.cos(angle), np.sin(angle)], axis=1)) % SIDE
        if frame >= first:
            orders.append(abs(np.exp(1j * angle).mean()))
    return float(np.mean(orders))
