"""A small hill on a floor, with some who dig through it and others who do not, as scenes for tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from meshes import Mesh

from antdsl.bodies.shapes import build_flat_grid, build_stone
from antdsl.pipeline import Shot, open_scene

PROGRAM = """ant 1
use steering
world { surface ground; solid hill; items goal; items heap { soil = 0 mm^3 } }
field trail on ground, hill { cell 3 mm; half_life 20 s; diffuse 3 mm^2/s }
species digger {
  size 4 mm
  max_speed 30 mm/s
  soil = 0 mm^3
  smelt = 0
  start go
  state go "Goes" amber {
    steer seek(nearest(goal)) + wander() * 0.3
    smelt = max(trail, nearest: 16)
    when touching(hill) -> dig
    when touching(nearest(heap)) -> go { give all soil to heap }
  }
  state dig "Digs" brown {
    steer seek(nearest(goal))
    deposit trail 2 /s
    carve hill(radius: 0.75 * size, toward: direction(nearest(goal)), into: soil)
    when not touching(hill) held 0.5 s -> go
  }
  layers { separate(radius: size); state }
}
species walker {
  size 4 mm
  max_speed 30 mm/s
  felt = 0
  start go
  state go "Goes" blue {
    steer seek(nearest(goal))
    felt = count(h in feelers(hill, reach: 8 mm): h.distance >= 0 mm) + (if distance(hill) > 20 mm then 10 else 0)
  }
  layers { avoid(hill) * 0.2; state }
}
"""
SCENE = """antdsl: 1
units: mm
fps: 24
frames: 1..40
seed: 3
world:
  ground: {mesh: ground.ply}
  hill: {mesh: hill.ply, voxel: 1 mm}
  goal: {there: {at: [60, 0, 0], on: ground}}
  heap: {there: {at: [45, 0, 0], on: ground, radius: 14 mm}}
crowd:
  - {species: digger, from: dig.ant, count: 5, place: {on: ground, around: [-31, 0, 0], radius: 8 mm}}
  - {species: walker, from: dig.ant, count: 12, place: {around: [-20, 0, 0], radius: 25 mm}}
output: {checkpoint: 8}
"""


def ground() -> Mesh:
    line = np.linspace(-70.0, 70.0, 36)
    vertices, faces = build_flat_grid(line, line)
    x, z = vertices[:, 0], vertices[:, 2]
    return np.stack([x, 1.2 * np.sin(x / 20) + np.cos(z / 17), z], axis=1), faces


def hill() -> Mesh:
    return build_stone(5, (20.0, 17.0, 26.0), detail=4, roughness=0.05)


def save(mesh: Mesh, path: Path) -> None:
    trimesh.Trimesh(*mesh, process=False).export(path)


def folder(path: Path, program: str = PROGRAM, scene: str = SCENE) -> Path:
    """Write the scene with its meshes; gives the path of the scene."""
    save(ground(), path / "ground.ply")
    save(hill(), path / "hill.ply")
    (path / "dig.ant").write_text(program)
    (path / "scene.yaml").write_text(scene)
    return path / "scene.yaml"


def opened(scene: Path) -> Shot:
    shot, report = open_scene(scene)
    assert shot is not None and report.ok, [(d.message, d.help) for d in report.sort_by_place()]
    return shot
