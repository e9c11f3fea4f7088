"""Scene files with a crowd that is empty for a part of the frames, with everything that outputs show: bodies with skeletons,
layers and legs, capsules, fields, flows, feelers, items, events, what is dug, and a camera."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import meshes
import trimesh

WALKER = Path(__file__).resolve().parents[1] / "examples" / "walker"
FIRST, LAST = 101, 110  # at 10 a second
PROGRAM = """ant 1
use steering
world {
  surface ground
  obstacle stones
  solid mound
  curve way_in
  items food { load = 3 }
  flow home
}
field trail on ground { cell 500 mm; half_life 4 s; diffuse 0.1 m^2/s; deposits first }
species person "Somebody with a skeleton" {
  param life = 1000 s
  size 1.75 m
  radius 0.3 m
  max_speed 3 m/s
  load = 0
  let friend = nearest(ant, within: 4 m)
  on ping { load += 0.1 }
  on full { load += 0.1 }
  on collision(met) { load += 0.1 }
  machine legs {
    start stroll
    state stroll "Strolls" amber {
      steer wander() + climb(trail) * load; play walk;
      deposit trail 1 /s; when after 0.2 s -> run over 0.2 s
    }
    state run "Runs" red { steer seek(friend); play run; emit ping(within: 9 m); when after 0.2 s -> stroll over 0.2 s }
    from any except gone when age > life -> gone { die }
    state gone "Dies" grey { when after 1 s -> run }
  }
  machine arms {
    start hang
    state hang { when any(feelers(stones, count: 3, spread: 40 deg, reach: 2 m)) or friend -> greet over 0.1 s }
    state greet { play wave(on: arms); when clip done -> hang }
  }
  layers { separate(radius: 1 m); state }
}
species ant "On six legs" {
  param life = 1000 s
  size 1 m
  max_speed 2 m/s
  load = 0
  soil = 0 mm^3
  start roam
  state roam "Roams" green {
    steer wander() + along(home) * 0.2
    deposit trail 2 /s
    carve mound(radius: 0.2 m, into: soil)
    when chance 100 %/s take 0.1 load from nearest(food) -> roam_on { emit full(within: load * 9 m) }
    when age > life -> over { die }
  }
  state roam_on { when after 0.1 s -> roam; when age > life -> over { die } }
  state over { when after 1 s -> roam }
  layers { avoid(stones); state }
}
species egg "Bears both" {
  param life = 1000 s
  param hatch = 1000 s
  start wait
  state wait {
    when age > hatch -> bear { spawn person; spawn ant }
    when age > life -> bear { die }
  }
  state bear { when after 100 s -> wait }
}
spec "whoever is there" on "scene.yaml" {
  for 0.8 s
  always: count(person) >= 0 and mean(person.speed) >= 0 m/s and total(ant.soil) >= 0 mm^3
  always: share(ant.state == roam) <= 1 and max(ant.speed) < 9 m/s and every(ant.speed < 9 m/s)
  finally: motion.turn_p99 >= 0 deg
}
"""
SCENE = """antdsl: 1
units: m
fps: 10
frames: {first}..{last}
contacts: hard
world:
  ground: {{mesh: ground.ply}}
  stones: {{mesh: stones.ply}}
  mound: {{mesh: mound.ply, voxel: 200 mm}}
  way_in: {{curve: way_in.json}}
  food: {{crumb: {{at: [3, 0, 3], on: ground, load: 4, radius: 0.5 m}}}}
  home: {{solved: food}}
crowd:
  - {{species: person, from: crowd.ant, count: {people}, body: walker.json, place: {{on: ground, radius: 4 m}}}}
  - {{species: ant, from: crowd.ant, count: {ants}, body: ant, place: {{on: ground, radius: 4 m}}}}
  - {{species: egg, from: crowd.ant, count: {eggs}, place: {{on: ground, radius: 1 m}}}}
set: {{person.life: {life} s, ant.life: {life} s, egg.life: {life} s, egg.hatch: {hatch} s}}
camera: {{at: [6, 5, 12], look_at: [0, 0, 0], focal: 30 mm}}
output: {{attributes: [P, v, orient, id, pscale, Cd, state, max_speed], events: [emit, contact], checkpoint: 3}}
"""


@dataclass(frozen=True)
class Case:
    """How many of each there are at first; after how many seconds these die, and others hatch."""

    people: int
    ants: int
    eggs: int
    life: float = 1000.0
    hatch: float = 1000.0


CASES = {
    "never": Case(0, 0, 0),
    "later": Case(0, 0, 1, hatch=0.3),
    "not_in_the_middle": Case(3, 3, 1, life=0.25, hatch=0.6),
    "not_at_the_end": Case(3, 3, 1, life=0.35),
    "one_kind": Case(0, 3, 0),
    "alone": Case(1, 0, 0),
}


def scene(folder: Path, name: str) -> Path:
    """The scene of a case in a new folder, with all its files."""
    folder.mkdir(parents=True)
    for each in ("walker.json", "parts.glb"):
        shutil.copy(WALKER / each, folder)
    for each, mesh in (
        ("ground", meshes.grid(24.0, 8)),
        ("stones", meshes.box((4, -1, -5), (6, 2, -3))),
        ("mound", meshes.box((-6, -2, -3), (-3, 2, 0))),
    ):
        trimesh.Trimesh(*mesh, process=False).export(folder / f"{each}.ply")
    (folder / "way_in.json").write_text(json.dumps([[-5, 0, -5], [0, 0, 1], [5, 0, 4]]))
    (folder / "crowd.ant").write_text(PROGRAM)
    case = CASES[name]
    (folder / "scene.yaml").write_text(SCENE.format(first=FIRST, last=LAST, **vars(case)))
    return folder / "scene.yaml"
