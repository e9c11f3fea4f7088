"""A crowd that walks on hills, and its cache, for tests of settling."""

from __future__ import annotations

from pathlib import Path

import edit_scenes
import meshes
import numpy as np
from directed import write_mesh

from antdsl.outputs.cache.cache_reader import Cache, open_cache

PROGRAM = """ant 1
use steering
world { surface ground }
species ant {
  size 5 mm
  max_speed 24 mm/s
  start walk
  state walk { steer wander(swing: 30 deg); play walk }
  layers { separate(radius: 1.2 * size); state }
}
"""
SCENE = """antdsl: 1
frames: 1..{last}
seed: 3
contacts: {contacts}
world: {{ground: {{mesh: ground.obj}}}}
crowd:
  - {{name: guards, species: ant, from: a.ant, count: {count}, place: {{on: ground, radius: {radius} mm}}, body: ant}}
output: {{checkpoint: 12}}
"""


def simulate(folder: Path, *, count: int = 24, last: int = 48, contacts: str = "hard", radius: int = 40) -> Cache:
    """Write the scene and return its cache."""
    folder.mkdir(parents=True, exist_ok=True)
    write_mesh(folder / "ground.obj", *meshes.terrain(200.0, 16))
    (folder / "a.ant").write_text(PROGRAM)
    (folder / "scene.yaml").write_text(SCENE.format(count=count, last=last, contacts=contacts, radius=radius))
    edit_scenes.run("run", folder / "scene.yaml", "--out", folder / "cache", "-q")
    return open_cache(folder / "cache")


def find_track(cache: Cache, agent: int) -> np.ndarray:
    """The positions of an agent in all frames; NaN where it is not there."""
    track = np.full((len(cache.frames()), 3), np.nan)
    for k, number in enumerate(cache.frames()):
        arrays = cache.frame(number)
        rows = np.flatnonzero(arrays["id"] == agent)
        track[k] = arrays["P"][rows[0]] if len(rows) else np.nan
    return track
