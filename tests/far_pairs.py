"""The same world twice: about the zero point and 530 km away, where a float32 in metres has steps of 3 to 6 cm."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.commands import run

ORIGIN = np.array([530000.0, 25.0, -180000.0])  # metres
BUG = """ant 1
use steering
world { surface ground; obstacle wall; solid heap; items crumb { amount = 5 }; items goal; curve way; flow drift }
field trail on ground { cell 100 mm; half_life 20 s }
species bug {
  size 400 mm
  max_speed 2 m/s
  soil = 0 mm^3
  start go
  state go "Goes" amber {
    steer wander(swing: 90 deg) + along(drift) * 0.3
    deposit trail 2 /s
    when touching(heap) -> dig
    when chance 60 %/s -> cry
    when age > 0.5 s and id > 12 -> gone
  }
  state dig "Digs" brown { carve heap(radius: 0.4 * size, toward: direction(nearest(goal)), into: soil); when after 0.3 s -> go }
  state cry { enter { emit bang; spawn bug }; steer coast(); when after 0.2 s -> go }
  state gone { enter { die } }
  layers { avoid(wall) * 0.2; state }
}
"""
SCENE = """antdsl: 1
units: m
up: UP
frames: 1..LAST
world:
  ground: {mesh: ground.obj}
  wall: {mesh: wall.obj, keys: {1: {at: [0.25, 0, 0]}, 12: {at: [0.25, 0.5, 0]}}}
  heap: {mesh: heap.obj, voxel: 250 mm}
  crumb: {first: {at: [2, 0, 1], radius: 200 mm, amount: 5}, second: {at: [-1, 0, 3], radius: 200 mm, amount: 5}}
  goal: {there: {at: [3, 0, 3], radius: 100 mm}}
  way: {curve: way.json}
  drift: {tangent: way, radius: 3 m}
crowd: [{species: bug, from: bug.ant, count: 16, place: {on: ground}}]
camera: {at: [1, 6, 9], look_at: [0, 0, 0], focal: 35 mm}
contacts: soft
output: {attributes: [P, v, orient, id, pscale, Cd, state, soil], events: [contact, emit], checkpoint: 4}
"""
_BOX = [
    (0, 3, 1), (0, 2, 3), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4),
    (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5),
]  # fmt: skip


def far_pair(folder: Path, last: int = 12, up: str = "y") -> tuple[Path, Path]:
    """The caches of the two worlds, in folders `near` and `far` of a folder."""
    caches = []
    for name, origin in (("near", np.zeros(3)), ("far", ORIGIN)):
        place = folder / name
        place.mkdir()
        write_scene(place, origin, last, up)
        result = run("run", "scene.yaml", "--out", "cache", "-q", cwd=place)
        assert result.returncode == 0, result.stdout + result.stderr
        caches.append(place / "cache")
    return caches[0], caches[1]


def write_scene(folder: Path, origin: np.ndarray, last: int = 12, up: str = "y") -> None:
    """The files of the scene, everything in it moved by an origin. Coordinates are exact in float64 however far they lie."""
    line = np.linspace(-5.0, 5.0, 11)
    x, z = (each.ravel() for each in np.meshgrid(line, line, indexing="ij"))
    ground = np.stack([x, np.round(np.sin(x) * np.cos(z) * 4) / 16, z], axis=1)
    corner = np.arange(121).reshape(11, 11)[:-1, :-1].ravel()
    faces = np.concatenate([np.stack([corner, corner + 1, corner + 12], 1), np.stack([corner, corner + 12, corner + 11], 1)])
    _write_obj(folder / "ground.obj", ground, faces, origin, up)
    for name, low, high in (("wall", (-4, -0.5, -4), (-3, 1, -3)), ("heap", (0.5, -0.5, -3), (3, 1, -1))):
        corners = np.array([[(low, high)[k >> (2 - axis) & 1][axis] for axis in range(3)] for k in range(8)], float)
        _write_obj(folder / f"{name}.obj", corners, np.array(_BOX)[:, ::-1], origin, up)
    route = _moved(np.array([[-4.0, 0, -4], [4, 0, -2], [4, 0, 4]]), origin, up)
    (folder / "way.json").write_text(str(route.tolist()))
    scene = SCENE.replace("UP", up).replace("LAST", str(last))
    for point in ([2, 0, 1], [-1, 0, 3], [3, 0, 3], [1, 6, 9], [0, 0, 0]):
        scene = scene.replace(f": {point}", f": {_moved(np.array([point], float), origin, up)[0].tolist()}")
    (folder / "scene.yaml").write_text(scene)
    (folder / "bug.ant").write_text(BUG)


def _moved(points: np.ndarray, origin: np.ndarray, up: str) -> np.ndarray:
    """Points of a world with y up, moved, in the axes of the scene."""
    return (np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1) if up == "z" else points) + origin


def _write_obj(path: Path, points: np.ndarray, faces: np.ndarray, origin: np.ndarray, up: str) -> None:
    lines = ["v " + " ".join(map(repr, row)) for row in _moved(points, origin, up).tolist()]
    lines += ["f " + " ".join(map(str, row)) for row in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")
