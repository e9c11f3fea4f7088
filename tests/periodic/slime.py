"""NetLogo's model Slime (U. Wilensky, 1997) in antdsl and in plain NumPy: amoebae that aggregate by a chemical, on a torus. Both
drop before the move, and spread by the nine-point Laplacian of `stencil 8`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from periodic_scenes import write_plane
from scipy.ndimage import convolve
from scipy.spatial import cKDTree

from antdsl.pipeline import RunChoices, open_scene
from antdsl.runtime import Options, bind, step

PROGRAM = """ant 1
world { surface ground }
field chem on ground { cell 1 mm; keeps 90 %/step; diffuse 0.25 mm^2/step; stencil 8; deposits first }
behaviour walk(by: angle) -> push { match(rotate(heading, about: up, by: by) * 1 mm/step) }
species amoeba {
  size 0.2 mm; max_speed 1 mm/step; response 1 step
  let ahead = smell(chem, ahead: 1 mm)
  let right = smell(chem, ahead: 1 mm, turn: -45 deg)
  let left = smell(chem, ahead: 1 mm, turn: 45 deg)
  let turn = if right >= ahead and right >= left then -45 deg else if left >= ahead then 45 deg else 0 deg
  start live
  state live {
    steer walk((if chem > 1 then turn else 0 deg) + uniform(0 deg, 40 deg) - uniform(0 deg, 40 deg))
    deposit chem 2 /step
  }
  layers { state }
}
"""
KERNEL = np.array([[1, 4, 1], [4, 4, 4], [1, 4, 1]]) / 24


def write_scene(folder: Path, side: int, count: int) -> Path:
    """Write a scene of `count` amoebae on `side` x `side` cells, and return its path."""
    write_plane(folder / "ground.ply", side)
    (folder / "slime.ant").write_text(PROGRAM)
    ends = f"{-side / 2} mm .. {side / 2} mm"
    lines = f"antdsl: 1\nfps: 1\nframes: 0..500\nwrap: {{x: {ends}, z: {ends}}}\nworld: {{ground: {{mesh: ground.ply}}}}\n"
    crowd = f"crowd: [{{species: amoeba, from: slime.ant, body: arrow, count: {count}, place: {{on: ground}}}}]\n"
    (folder / "scene.yaml").write_text(lines + crowd)
    return folder / "scene.yaml"


def count_neighbours(place: NDArray[np.float64], side: int) -> float:
    """Return the mean number of others within 3 mm, over the seam too."""
    inside = np.mod(place, side)
    inside[inside >= side] = 0.0
    return 2 * len(cKDTree(inside, boxsize=side).query_pairs(3.0)) / len(place)


def measure_slime(scene: Path, side: int, seed: int, frames: tuple[int, ...]) -> list[float]:
    """Return the mean number of neighbours at some frames of a run."""
    shot, report = open_scene(scene, RunChoices(seed=seed))
    assert shot is not None, report
    world, counts = bind(shot.plan, shot.setting, Options(backend="numpy", threads=1)), []
    for frame in range(1, frames[-1] + 1):
        step(world)
        if frame in frames:
            counts.append(count_neighbours(world.populations["amoeba"].position[:, [0, 2]] + side / 2, side))
    return counts


def measure_plain_slime(side: int, count: int, seed: int, frames: tuple[int, ...]) -> list[float]:
    """Return the same of a run in plain NumPy."""
    rng = np.random.default_rng(seed)
    place, heading = rng.uniform(0, side, (count, 2)), rng.uniform(0, 2 * np.pi, count)
    chem, counts, wiggle = np.zeros((side, side)), [], np.deg2rad(40)

    def locate(points: NDArray[np.float64]) -> tuple[NDArray[np.int64], ...]:
        return tuple((np.floor(points).astype(np.int64) % side).T)

    def step_towards(turn: float) -> NDArray[np.float64]:
        return np.stack([np.cos(heading + turn), np.sin(heading + turn)], axis=1)

    for frame in range(1, frames[-1] + 1):
        ahead, right, left = (chem[locate(place + step_towards(turn))] for turn in (0, -np.pi / 4, np.pi / 4))
        turn = np.where((right >= ahead) & (right >= left), -np.pi / 4, np.where(left >= ahead, np.pi / 4, 0))
        turn = turn * (chem[locate(place)] > 1)
        heading = heading + turn + rng.uniform(0, wiggle, count) - rng.uniform(0, wiggle, count)
        np.add.at(chem, locate(place), 2.0)
        chem = convolve(chem, KERNEL, mode="wrap") * 0.9
        place = (place + step_towards(0)) % side
        if frame in frames:
            counts.append(count_neighbours(place, side))
    return counts
