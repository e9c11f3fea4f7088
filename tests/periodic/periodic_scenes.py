"""Scenes of periodic worlds on a plane or on heights, and what tests measure in them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from antdsl.pipeline import Shot, open_scene
from antdsl.runtime import Options, World, bind, step

HALF = 8.0  # mm: half of the width of most worlds here
FLOCK = """ant 2
world { surface ground }
field trail on ground { cell 1 mm; half_life 5 s; diffuse 0.2 mm^2/s }
species bird {
  size 0.1 mm; max_speed 1 mm/step; response 1 step; max_turn none
  let scent = gradient(trail) * 0.1 mm + direction(strongest(trail, nearest: 9)) * 0.1 * smell(trail, ahead: 1 mm)
  let course = heading + sum(n in neighbours(radius: 1 mm): n.heading) + scent
  start fly
  state fly {
    steer match(rotate(unit(course), about: up, by: uniform(-0.5, 0.5) * 1 rad) * 1 mm/step)
    deposit trail (1 + id * 0.01) / 1 step
  }
  layers { state }
}
"""


PLAIN_FLOCK = "\n".join(
    line for line in FLOCK.replace(" + scent", "").splitlines() if not {"trail", "surface"} & set(line.split())
)
PLAIN_FLOCK = "\n".join(line for line in PLAIN_FLOCK.splitlines() if "let scent" not in line)


def write_ply(path: Path, vertices: NDArray[np.float64], faces: Sequence[Sequence[int]]) -> None:
    """Write a mesh as text."""
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}", *(f"property float {axis}" for axis in "xyz")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(repr(float(part)) for part in row) for row in vertices]
    path.write_text("\n".join([*head, *rows, *("3 " + " ".join(map(str, face)) for face in faces), ""]))


def write_plane(path: Path, half: float, height: float = 0.0) -> None:
    """Write a level square of two triangles, `half` mm from its middle to its sides."""
    corners = np.array([[-half, height, -half], [half, height, -half], [half, height, half], [-half, height, half]])
    write_ply(path, corners, [(0, 2, 1), (0, 3, 2)])


def open_world(
    folder: Path,
    program: str,
    crowd: str,
    *,
    wrap: str = f"{{x: -{HALF:g} mm .. {HALF:g} mm, z: -{HALF:g} mm .. {HALF:g} mm}}",
    world: str = "{ground: {mesh: ground.ply}}",
    keys: str = "",
    body: str = "arrow",
    half: float = 20.0,
) -> Shot:
    """Return a shot of a periodic world. `crowd`: the values of its only line after the species' file."""
    write_plane(folder / "ground.ply", half)
    (folder / "p.ant").write_text(program)
    species = program.split("species ")[1].split()[0]
    lines = f"antdsl: 1\nunits: mm\nfps: 1\nframes: 0..50\nseed: 1\nwrap: {wrap}\nworld: {world}\n{keys}"
    (folder / "scene.yaml").write_text(f"{lines}crowd: [{{species: {species}, from: p.ant, body: {body}, {crowd}}}]\n")
    shot, report = open_scene(folder / "scene.yaml")
    assert shot is not None, report
    return shot


def write_points(folder: Path, points: NDArray[np.float64]) -> str:
    """Write start points, and return the keys of a crowd line that has an agent at each."""
    (folder / "points.json").write_text(json.dumps(np.asarray(points).tolist()))
    return f"count: {len(points)}, place: {{on: ground, points: points.json}}"


def run(shot: Shot, frames: int, options: Options | None = None) -> World:
    """Return the world after some frames."""
    world = bind(shot.plan, shot.setting, options)
    for _ in range(frames):
        step(world)
    return world


def wrapped(values: NDArray[np.float64], width: float = 2 * HALF) -> NDArray[np.float64]:
    """Differences of positions, each as its nearest image."""
    return values - width * np.rint(values / width)


def read_vector(world: World, name: str) -> NDArray[np.float64]:
    """A vector attribute of the only species, by id."""
    population = next(iter(world.populations.values()))
    return population.read_vector(name)[population.get_rows_by_id()]
