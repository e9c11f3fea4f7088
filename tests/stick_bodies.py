"""Bodies of sticks with two, four, six and eight legs, and grounds for them to walk on, as scenes for tests and pictures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from meshes import Mesh, box, grid
from numpy.typing import NDArray

from antdsl.pipeline import RunChoices, Shot, open_scene

Floats = NDArray[np.float64]
Three = tuple[float, float, float]
SIZE = 6.0  # mm

# Hip, knee and foot of the legs of one side, from the front, in body lengths: ahead, above, aside.
LEGS: dict[int, list[tuple[Three, Three, Three]]] = {
    8: [
        ((0.14, 0.14, 0.06), (0.34, 0.34, 0.18), (0.52, 0.0, 0.30)),
        ((0.08, 0.14, 0.08), (0.18, 0.36, 0.30), (0.22, 0.0, 0.48)),
        ((0.02, 0.14, 0.08), (-0.08, 0.36, 0.30), (-0.14, 0.0, 0.50)),
        ((-0.04, 0.14, 0.06), (-0.26, 0.34, 0.20), (-0.46, 0.0, 0.36)),
    ],
    6: [
        ((0.12, 0.13, 0.05), (0.24, 0.28, 0.16), (0.40, 0.0, 0.28)),
        ((0.02, 0.13, 0.05), (0.03, 0.28, 0.22), (0.04, 0.0, 0.40)),
        ((-0.08, 0.13, 0.05), (-0.20, 0.28, 0.18), (-0.38, 0.0, 0.32)),
    ],
    4: [
        ((0.30, 0.62, 0.12), (0.26, 0.34, 0.13), (0.31, 0.0, 0.12)),
        ((-0.30, 0.62, 0.12), (-0.24, 0.34, 0.13), (-0.33, 0.0, 0.12)),
    ],
    2: [((0.0, 0.52, 0.10), (0.035, 0.27, 0.10), (0.0, 0.02, 0.10))],
}
# Name, speed, stride, duty, lift in body lengths, and phases: the left legs from the front, then the right ones.
GAITS: dict[int, list[tuple[str, float, float, float, float, list[float]]]] = {
    8: [("walk", 1.0, 0.45, 0.65, 0.10, [0, 0.5, 0.05, 0.55, 0.5, 0, 0.55, 0.05]),
        ("run", 5.0, 0.75, 0.5, 0.10, [0, 0.5, 0, 0.5, 0.5, 0, 0.5, 0])],
    6: [("walk", 1.0, 0.40, 0.65, 0.08, [0, 0.5, 0.05, 0.5, 0.0, 0.55]),
        ("tripod", 5.0, 0.70, 0.52, 0.08, [0, 0.5, 0, 0.5, 0, 0.5])],
    4: [("walk", 0.8, 0.60, 0.70, 0.10, [0.75, 0, 0.25, 0.5]), ("trot", 2.5, 1.0, 0.5, 0.14, [0, 0.5, 0.5, 0])],
    2: [("walk", 0.7, 0.65, 0.62, 0.06, [0, 0.5]), ("run", 2.0, 1.2, 0.38, 0.12, [0, 0.5])],
}  # fmt: skip


def _bone(a: Floats, b: Floats, thick: float) -> trimesh.Trimesh:
    """A prism of four sides from one point to another."""
    displacement = b - a
    along = displacement / np.linalg.norm(displacement)
    side = np.cross(along, (0.3, 0.2, 0.93))
    side /= np.linalg.norm(side)
    over = np.cross(along, side)
    rings = [at + thick * wide * (side * c + over * s)
             for at, wide in ((a, 1.0), (b, 0.6)) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]  # fmt: skip
    return trimesh.convex.convex_hull(np.array(rings))


def write_body(folder: Path, legs: int, name: str = "body.json") -> Path:
    """A definition file `body.json` and its meshes: a trunk and legs, a unit being a body length."""
    parts: dict[str, trimesh.Trimesh] = {}
    tree: dict[str, list[str]] = {"root": []}
    rest: dict[str, Any] = {}
    bound = [{"transform": "root", "shape": "trunk"}]
    listed = []
    hips = np.array([hip for hip, _, _ in LEGS[legs]])
    length, high = (0.9, float(hips[0, 1]) + 0.02) if legs > 2 else (0.16, 0.72)
    trunk = trimesh.creation.icosphere(subdivisions=2)
    trunk.apply_scale((length / 2, 0.10 if legs > 2 else 0.24, 0.11))
    parts["trunk"] = trunk.apply_translation((0, high, 0))
    head = trimesh.creation.icosphere(subdivisions=1, radius=0.09)
    parts["head"] = head.apply_translation((length / 2 + 0.04, high + 0.04, 0) if legs > 2 else (0.03, 1.02, 0))
    bound.append({"transform": "root", "shape": "head"})
    for side, sign in (("left", -1.0), ("right", 1.0)):
        for number, leg in enumerate(LEGS[legs]):
            hip, knee, foot = (np.array(p) * (1, 1, sign) for p in leg)
            own = f"{side}_{number}"
            joints = [f"{part}_{own}" for part in ("thigh", "shank", "foot")]
            tree["root"].append(joints[0])
            tree |= {joints[0]: [joints[1]], joints[1]: [joints[2]], joints[2]: []}
            for joint, at in zip(joints, (hip, knee - hip, foot - knee), strict=True):
                rest[joint] = [[1, 0, 0, at[0]], [0, 1, 0, at[1]], [0, 0, 1, at[2]], [0, 0, 0, 1]]
            thick = 0.025 if legs > 4 else 0.045
            parts[joints[0]] = _bone(np.zeros(3), knee - hip, thick)
            parts[joints[1]] = _bone(np.zeros(3), foot - knee, thick * 0.7)
            toe = np.array([0.03 if legs > 4 else 0.09, -float(foot[1]), 0.0])
            parts[joints[2]] = _bone(np.array([-0.02, 0, 0]), toe, thick * 0.6)
            bound += [{"transform": joint, "shape": joint} for joint in joints]
            listed.append({"name": own, "upper": joints[0], "lower": joints[1], "foot": joints[2]})
    scene = trimesh.Scene()
    for part, mesh in parts.items():
        scene.add_geometry(mesh, node_name=part, geom_name=part)
    (folder / "parts.glb").write_bytes(scene.export(file_type="glb", include_normals=True))
    gaits = [dict(zip(("name", "speed", "stride", "duty", "lift", "phases"), gait, strict=True)) for gait in GAITS[legs]]
    document = {
        "antdsl_body": 1, "name": "stick", "length": 1, "units": "mm",
        "rig": {"rig_version": 1, "transforms": tree, "antdsl_rest": rest},
        "shapes": [{"file": "parts.glb", "shape": part, "material": "state" if part == "trunk" else "dark"} for part in parts],
        "materials": {"dark": [0.08, 0.05, 0.04]},
        "layers": [{"version": 2, "name": "body", "static": bound, "deforming": []}],
        "legs": listed, "gaits": gaits,
    }  # fmt: skip
    (folder / name).write_text(json.dumps(document))
    return folder / name


# ---- grounds, each with where they begin


def _band_mesh(points: Floats, wide: float) -> Mesh:
    """A band `wide` across z through points (k, 2) of x and y, its faces seen from the left of the way."""
    k, lines = len(points), 9
    z = np.linspace(-wide / 2, wide / 2, lines)
    vertices = np.concatenate([np.column_stack([points, np.full(k, at)]) for at in z])
    row, column = (a.ravel() for a in np.meshgrid(np.arange(lines - 1), np.arange(k - 1), indexing="ij"))
    a = row * k + column
    b, c, d = a + 1, a + k + 1, a + k
    faces = np.concatenate([np.stack([a, d, c], 1), np.stack([a, c, b], 1)])
    return vertices, faces.astype(np.int32)


def flat() -> Mesh:
    return grid(400.0, 8)


def hill() -> Mesh:
    def height(x: Floats, z: Floats) -> Floats:
        return 9 * np.exp(-(x**2 + z**2) / 500) + 0.8 * np.sin(x / 3.1) * np.cos(z / 2.7)

    return grid(120.0, 90, height)


def overhang() -> Mesh:
    """A floor that goes up, round a lip and on below the ceiling that it makes."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, 20)
    rise = np.column_stack([20 + 14 * np.cos(turn), 14 + 14 * np.sin(turn)])
    points = np.concatenate([np.array([[-50, 0], [-25, 0], [0, 0], [12, 0]]), rise, np.array([[10, 28], [-10, 28], [-50, 28]])])
    return _band_mesh(points, 90.0)


def can(inside: bool = False) -> Mesh:
    """A tin without a lid: a wall of no thickness, with a floor."""
    radius, high, around = 22.0, 36.0, 48
    turn = np.arange(around) * 2 * np.pi / around
    rings = [np.column_stack([radius * np.cos(turn), np.full(around, y), radius * np.sin(turn)]) for y in (0.0, 12.0, 24.0, high)]
    vertices = np.concatenate([*rings, [[0.0, 0.0, 0.0]]])
    faces = []
    for r in range(3):
        a = r * around + np.arange(around)
        b = r * around + (np.arange(around) + 1) % around
        faces += [np.stack([a, a + around, b], 1), np.stack([b, a + around, b + around], 1)]
    a, b = np.arange(around), (np.arange(around) + 1) % around
    faces.append(np.stack([a, b, np.full(around, len(vertices) - 1)], 1))
    return vertices, np.concatenate(faces).astype(np.int32)


def tunnel() -> Mesh:
    """A tube that bends, walked inside."""
    along = np.linspace(0, 1, 60)
    middle = np.column_stack([120 * along - 60, 3 * np.sin(9 * along), 10 * np.sin(5 * along)])
    ahead = np.gradient(middle, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    side = np.cross(ahead, (0, 1, 0))
    side /= np.linalg.norm(side, axis=1)[:, None]
    over = np.cross(side, ahead)
    around = 24
    turn = np.arange(around) * 2 * np.pi / around
    rings = middle[:, None] + 8.0 * (np.cos(turn)[None, :, None] * side[:, None] + np.sin(turn)[None, :, None] * over[:, None])
    k, j = (a.ravel() for a in np.meshgrid(np.arange(len(along) - 1), np.arange(around), indexing="ij"))
    a, b = k * around + j, k * around + (j + 1) % around
    c, d = a + around, b + around
    return rings.reshape(-1, 3), np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)]).astype(np.int32)


GROUNDS = {"flat": flat, "hill": hill, "overhang": overhang, "can": can, "tunnel": tunnel}
PROGRAM = """ant 1
use steering
world {{ surface ground{more} }}
species walker {{
  size {size} mm
  max_speed {speed} mm/s
  response 0.1 s
  max_turn 300 deg/s
  start go
  state go "Goes" amber {{
    steer wander(swing: 40 deg)
    {leave}
  }}
  state pause "Stands" blue {{
    steer halt()
    when after 1.2 s -> go
  }}
  layers {{ state }}
}}
"""
SCENE = """antdsl: 1
units: mm
fps: 24
frames: 1..240
seed: {seed}
world:
  ground: {{mesh: ground.ply}}
{things}crowd:
  - {{species: walker, from: walker.ant, count: {count}, body: body.json, place: {{on: ground}}}}
output: {{attributes: [P, v, orient, id, pscale, Cd, state]}}
"""


def save(mesh: Mesh, path: Path) -> None:
    trimesh.Trimesh(*mesh, process=False).export(path)


def write_scene(
    folder: Path, legs: int = 6, ground: str | Mesh = "flat", *, count: int = 20, speed: float = 24.0, pauses: bool = True,
    seed: int = 3, world_lines: str = "", things: Sequence[str] = (), program: str = "",
) -> Path:  # fmt: skip
    """A scene in which bodies walk about on a ground and now and then stand."""
    folder.mkdir(parents=True, exist_ok=True)
    save(GROUNDS[ground]() if isinstance(ground, str) else ground, folder / "ground.ply")
    write_body(folder, legs)
    leave = "when chance 40 %/s -> pause" if pauses else ""
    text = program or PROGRAM.format(size=SIZE, speed=speed, leave=leave, more=world_lines)
    (folder / "walker.ant").write_text(text)
    lines = "".join(f"  {line}\n" for line in things)
    (folder / "scene.yaml").write_text(SCENE.format(seed=seed, things=lines, count=count))
    return folder / "scene.yaml"


def opened(path: Path) -> Shot:
    shot, report = open_scene(path, RunChoices())
    assert shot is not None and report.ok, [d.message for d in report.sort_by_place()]
    return shot


def block(low: Three, high: Three) -> Mesh:
    return box(low, high)
