"""Small scenes with notes, for tests: a crowd of ants on hills, and what their agents do frame by frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import meshes
import numpy as np

from antdsl.pipeline import Shot, open_scene
from antdsl.runtime import BindingCache, Options, World, bind, state_hash, step

PROGRAM = """ant 1
use steering
world { surface ground; obstacle foot; items leaves; curve way; map mud; items stones }
species ant {
  size 5 mm
  max_speed 30 mm/s
  max_turn 400 deg/s
  mood = 0
  brave = false
  start walk
  state walk { steer wander(); play walk; when mood > 1e6 -> rest }
  state rest { enter { mood = 5 }; play walk; when mood > 1e6 -> walk }
  layers { avoid(foot, reach: 4 * size); separate(radius: 1.3 * size); state }
}
"""
SCENE = """antdsl: 1
frames: 1..{last}
seed: 4
contacts: hard
world:
  ground: {{mesh: ground.obj}}
  foot: {{mesh: foot.obj, at: [-150, 5, 40], keys: {{20: {{at: [-150, 5, 40]}}, 80: {{at: [50, 5, 40]}}}}}}
  way: {{curve: way.json}}
  mud: {{painted: mud.npz, attribute: mud}}
  leaves: {{leaf: {{at: [90, 0, -60], on: ground, radius: 6 mm}}}}
  stones: {{stone: {{at: [-60, 0, -60], on: ground, radius: 10 mm}}}}
cameras: {{front: {{at: [20, 90, -150], look_at: [20, 0, -60], focal: 50 mm}}}}
crowd:
  - {{name: guards, species: ant, from: a.ant, count: {count}, place: {{on: ground, radius: 130 mm}}, body: ant}}
{notes}"""
BUILT = BindingCache()


def open_directed(folder: Path, *notes: str, count: int = 60, last: int = 80, program: str = PROGRAM) -> Shot:
    """Write a scene with notes and open it. The ground is hilly; a ball as wide as a foot moves over it."""
    folder.mkdir(parents=True, exist_ok=True)
    ground = meshes.terrain(300.0, 24)
    write_mesh(folder / "ground.obj", *ground)
    write_mesh(folder / "foot.obj", *meshes.ball(25.0, rings=8))
    (folder / "way.json").write_text("[[-100, 0, 0], [0, 0, 30], [100, 0, 0]]")
    np.savez(folder / "mud.npz", mud=np.where(ground[0][:, 0] < 0, 1.0, 0.0))
    (folder / "a.ant").write_text(program)
    listed = "notes:\n" + "".join(f"  - {note}\n" for note in notes) if notes else ""
    (folder / "scene.yaml").write_text(SCENE.format(count=count, last=last, notes=listed))
    shot, report = open_scene(folder / "scene.yaml")
    assert shot is not None, [(d.code, d.message, d.help, str(d.span)) for d in report.diagnostics]
    return shot


def write_mesh(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    rows = [f"v {x} {y} {z}" for x, y, z in np.asarray(vertices)] + ["f {} {} {}".format(*(f + 1)) for f in np.asarray(faces)]
    path.write_text("\n".join(rows))


def start(shot: Shot, **options: object) -> World:
    return bind(shot.plan, shot.setting, Options(**options), binding_cache=BUILT)  # type: ignore[arg-type]


def row_of(world: World, agent: int) -> int:
    return int(world.populations["ant"].find_rows(np.array([agent]))[0])


class Track:
    """What each agent did: `position`, `velocity`, `heading` float64 (frames, agents, 3), and other registers, by id."""

    def __init__(self, world: World, last: int, each: Callable[[World], None] | None = None, names: tuple[str, ...] = ()) -> None:
        self.frames: list[int] = []
        self.world, self.hashes = world, [state_hash(world)]
        rows: dict[str, list[np.ndarray]] = {name: [] for name in ("position", "velocity", "heading", *names)}
        while True:
            population = world.populations["ant"]
            order = population.get_rows_by_id()
            self.frames.append(world.frame)
            rows["position"].append(population.position[order].copy())
            for name in ("velocity", "heading"):
                rows[name].append(population.read_vector(name)[order])
            for name in names:
                rows[name].append(population.now[name][order].copy())
            if world.frame >= last:
                break
            step(world)
            self.hashes.append(state_hash(world))
            if each is not None:
                each(world)
        self.values = {name: np.array(values) for name, values in rows.items()}
        self.ids = np.sort(population.ids)

    def at(self, name: str, frame: int, agent: int) -> np.ndarray:
        """A register of an agent in a frame."""
        return self.values[name][self.frames.index(frame)][list(self.ids).index(agent)]

    def of(self, name: str, agent: int) -> np.ndarray:
        """A register of an agent in all frames."""
        return self.values[name][:, list(self.ids).index(agent)]

    def speeds(self) -> np.ndarray:
        """Distances over time (frames - 1, agents) in mm/s, in space."""
        return np.linalg.norm(np.diff(self.values["position"], axis=0), axis=2) / self.world.dt


def follow(shot: Shot, last: int, each: Callable[[World], None] | None = None, names: tuple[str, ...] = ()) -> Track:
    return Track(start(shot, threads=2), last, each, names)
