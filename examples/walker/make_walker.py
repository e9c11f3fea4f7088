"""Writes hill.ply, parts.glb and walker.json of this example: `python examples/walker/make_walker.py`.

The walker is a jointed figure 1.75 m tall that looks along +x with the origin between its feet. Its clips are worked out here: a
foot on the ground goes back by the ground that the body covers, turns about its toe as its heel lifts, and swings ahead in an
arc; the angles of hip and knee follow from where hip and ankle are."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Clip, Rig
from antdsl.bodies.files.clip_document import write_clip
from antdsl.bodies.files.documents import write_rig
from antdsl.bodies.shapes import build_flat_grid

FOLDER = Path(__file__).parent
Floats = NDArray[np.float64]
BONE = 0.42  # m, of thigh and shin
HIP, SIDE, ANKLE = 0.90, 0.095, 0.06  # height of the hip's joint, half the width between legs, height of the ankle
TOE = np.array([0.14, -0.06])  # from the ankle, where the foot turns as the heel lifts
RATE = 30

# Each joint with its parent and where it is from there.
JOINTS: dict[str, tuple[str, tuple[float, float, float]]] = {
    "hips": ("", (0.0, HIP, 0.0)),
    "chest": ("hips", (0.0, 0.20, 0.0)),
    "head": ("chest", (0.01, 0.36, 0.0)),
    "arm_l": ("chest", (0.0, 0.27, -0.195)),
    "forearm_l": ("arm_l", (0.0, -0.28, 0.0)),
    "arm_r": ("chest", (0.0, 0.27, 0.195)),
    "forearm_r": ("arm_r", (0.0, -0.28, 0.0)),
    "thigh_l": ("hips", (0.0, 0.0, -SIDE)),
    "shin_l": ("thigh_l", (0.0, -BONE, 0.0)),
    "foot_l": ("shin_l", (0.0, -BONE, 0.0)),
    "thigh_r": ("hips", (0.0, 0.0, SIDE)),
    "shin_r": ("thigh_r", (0.0, -BONE, 0.0)),
    "foot_r": ("shin_r", (0.0, -BONE, 0.0)),
}
# What is bound to a joint: the part, and its material; `state` has the colour of the agent's state.
PARTS = {
    "hips": ("pelvis", "cloth"), "chest": ("trunk", "state"), "head": ("head", "skin"), "arm": ("arm", "state"),
    "forearm": ("forearm", "skin"), "thigh": ("thigh", "cloth"), "shin": ("shin", "cloth"), "foot": ("foot", "leather"),
}  # fmt: skip
MATERIALS = {"skin": (0.52, 0.30, 0.20), "cloth": (0.06, 0.08, 0.13), "leather": (0.05, 0.03, 0.02)}


def hill(lines: int = 81) -> trimesh.Trimesh:
    line = np.linspace(-20.0, 20.0, lines)
    vertices, faces = build_flat_grid(line, line)
    x, z = vertices[:, 0], vertices[:, 2]
    vertices[:, 1] = 2.0 * np.exp(-((x / 9.5) ** 2) - (z / 8.0) ** 2) + 0.08 * np.sin(x / 2.3) * np.cos(z / 2.9)
    return trimesh.Trimesh(np.round(vertices, 4), faces, process=False)


def turned(outline: list[tuple[float, float]], wide: tuple[float, float] = (1.0, 1.0), sides: int = 14) -> trimesh.Trimesh:
    """A body of revolution about y: heights with radii, from the top down, wide along x and z."""
    around = np.arange(sides) * 2 * np.pi / sides
    rings = [np.stack([r * np.cos(around) * wide[0], np.full(sides, y), -r * np.sin(around) * wide[1]], 1) for y, r in outline]
    corner = (np.arange(len(rings) - 1)[:, None] * sides + np.arange(sides)).reshape(-1)
    beside = corner // sides * sides + (corner + 1) % sides
    faces = np.concatenate([np.stack([corner, corner + sides, beside], 1), np.stack([beside, corner + sides, beside + sides], 1)])
    return trimesh.Trimesh(np.concatenate(rings), faces, process=False)


def rounded(top: float, bottom: float, radii: tuple[float, ...], wide: tuple[float, float] = (1.0, 1.0)) -> trimesh.Trimesh:
    """A limb from `top` to `bottom` with radii between, round at both ends."""
    caps = np.array([0.02, 0.5, 0.86])
    start = [(top + radii[0] * float(np.sqrt(1 - c * c)), radii[0] * float(c)) for c in caps]
    middle = [(float(y), r) for y, r in zip(np.linspace(top, bottom, len(radii)), radii, strict=True)]
    end = [(bottom - radii[-1] * float(np.sqrt(1 - c * c)), radii[-1] * float(c)) for c in caps[::-1]]
    return turned(start + middle + end, wide)


def parts() -> dict[str, trimesh.Trimesh]:
    foot = rounded(0.11, -0.09, (0.045, 0.05, 0.043), (0.62, 0.95))
    lying = foot.vertices[:, [1, 0, 2]]  # the heel behind, the toes ahead
    lying[:, 0] += 0.035
    lying[:, 1] = np.maximum(lying[:, 1] - 0.03, -ANKLE)
    foot = trimesh.Trimesh(lying, foot.faces[:, ::-1], process=False)
    skull = trimesh.util.concatenate([
        rounded(0.20, 0.09, (0.085, 0.098, 0.072), (1.05, 0.85)), rounded(0.06, -0.04, (0.05, 0.055)),
        trimesh.creation.icosphere(subdivisions=1, radius=0.022).apply_translation((0.105, 0.115, 0.0)),
    ])  # fmt: skip
    return {
        "pelvis": rounded(0.13, 0.0, (0.115, 0.125, 0.11), (0.85, 1.2)),
        "trunk": rounded(0.26, -0.04, (0.10, 0.145, 0.14, 0.115), (0.75, 1.22)),
        "head": skull,
        "arm": rounded(0.0, -0.28, (0.056, 0.05, 0.042)),
        "forearm": trimesh.util.concatenate([
            rounded(0.0, -0.24, (0.042, 0.04, 0.03)), rounded(-0.26, -0.34, (0.03, 0.036, 0.02), (1.0, 0.55)),
        ]),
        "thigh": rounded(0.0, -BONE, (0.085, 0.082, 0.058)),
        "shin": rounded(0.0, -BONE + 0.02, (0.057, 0.06, 0.04)),
        "foot": foot,
    }  # fmt: skip


def rig() -> Rig:
    names = tuple(JOINTS)
    rest = np.tile(np.eye(4), (len(names), 1, 1))
    rest[:, :3, 3] = [at for _, at in JOINTS.values()]
    return Rig(names, np.array([names.index(parent) if parent else -1 for parent, _ in JOINTS.values()], np.int32), rest)


@dataclass(frozen=True)
class Gait:
    """`seconds` of a turn, its `stride`, the share of it in which a foot is down; how high the hips are and by how much they go
    up and down; how high the ankle swings; the angles of trunk, arms and elbows in degrees."""

    seconds: float
    stride: float
    down: float
    hips: float
    bounce: float
    lift: float
    lean: float
    arms: float
    elbows: float


def smooth(share: Floats) -> Floats:
    share = np.clip(share, 0.0, 1.0)
    return share * share * (3 - 2 * share)


def ankle(phase: Floats, gait: Gait) -> tuple[Floats, Floats, Floats]:
    """Where an ankle is, ahead of the hips and above the ground, and how far the foot's toe points up, at phases from 0 to 1:
    0 is where the foot comes down."""
    phase = phase % 1.0
    reach = gait.stride * gait.down / 2
    pitch_off, pitch_on = np.radians(-48.0), np.radians(14.0)
    # Down: the toe stays where it is on the ground, and the heel lifts towards the end.
    share = phase / gait.down
    pitch = pitch_on * (1 - smooth(share / 0.15)) + pitch_off * smooth((share - 0.55) / 0.45)
    toe = np.stack([reach - gait.stride * phase + TOE[0] - 0.03, np.zeros_like(phase)])
    heel = np.stack([reach - gait.stride * phase - 0.07 - 0.03, np.zeros_like(phase)])
    on_toe = toe - rotated(pitch, TOE)
    on_heel = heel - rotated(pitch, np.array([-0.07, -ANKLE]))
    standing = np.where(pitch > 0, on_heel, on_toe)
    if np.ndim(phase) and np.all((phase >= 0) & (share <= 1)):
        return standing[0], standing[1], pitch
    # Swinging: from where it lifts to where it comes down, in an arc.
    swing = np.clip((phase - gait.down) / (1 - gait.down), 0.0, 1.0)
    ends = [ankle(np.array([at]), gait) for at in (gait.down * (1 - 1e-9), 0.0)]
    go = smooth(swing)
    ahead = ends[0][0] + (ends[1][0] - ends[0][0]) * go
    above = ends[0][1] + (ends[1][1] - ends[0][1]) * go + gait.lift * np.sin(np.pi * swing) ** 2 * (1 - 0.5 * swing)
    toes = ends[0][2] + (ends[1][2] - ends[0][2]) * smooth(swing * 1.25)
    flying = share > 1
    return np.where(flying, ahead, standing[0]), np.where(flying, above, standing[1]), np.where(flying, toes, pitch)


def rotated(angle: Floats, vector: Floats) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def legs(found: dict[str, Floats], side: str, ahead: Floats, above: Floats, pitch: Floats, high: Floats) -> None:
    """Angles of hip, knee and foot about z for an ankle below a hip at a height."""
    down = high - above
    far = np.minimum(np.hypot(ahead, down), 2 * BONE * 0.9995)
    knee = np.arccos(np.clip(far**2 / (2 * BONE**2) - 1, -1.0, 1.0))
    way = np.arctan2(ahead, down)
    found[f"thigh_{side}"], found[f"shin_{side}"] = way + knee / 2, -knee
    found[f"foot_{side}"] = pitch - (way - knee / 2)


def walking(name: str, gait: Gait, marks: dict[str, float]) -> Clip:
    count = round(gait.seconds * RATE)
    phase = np.arange(count + 1) / count
    found: dict[str, Floats] = {}
    high = gait.hips + gait.bounce * -np.cos(4 * np.pi * (phase - gait.down / 2 + 0.25 * (gait.down < 0.5)))
    for side, later in (("l", 0.0), ("r", 0.5)):
        legs(found, side, *ankle(phase + later, gait), high)
    swing = np.radians(gait.arms) * np.cos(2 * np.pi * (phase - gait.down / 2 + 0.20))
    found["arm_l"], found["arm_r"] = -swing, swing
    bent = np.radians(gait.elbows)
    found["forearm_l"], found["forearm_r"] = bent * (1 - 0.35 * swing), bent * (1 + 0.35 * swing)
    found["chest"] = np.full(count + 1, np.radians(-gait.lean))
    found["head"] = np.full(count + 1, np.radians(gait.lean * 0.7))
    twist = {"chest": np.radians(7.0) * np.cos(2 * np.pi * (phase - gait.down / 2 + 0.20))}
    return clip(name, found, high, twist, marks, gait.stride, gait.seconds)


def clip(
    name: str, turns: dict[str, Floats], high: Floats, twists: dict[str, Floats], marks: dict[str, float], stride: float = 0.0,
    seconds: float = 0.0, loop: bool = True,
) -> Clip:  # fmt: skip
    """A clip of turns about z, and of twists about y before these; the hips at a height."""
    names, count = tuple(JOINTS), len(high)
    translation = np.tile(np.array([at for _, at in JOINTS.values()]), (count, 1, 1))
    translation[:, 0, 1] = high
    z = np.stack([np.broadcast_to(turns.get(joint, np.zeros(1)), count) for joint in names], 1) / 2
    y = np.stack([np.broadcast_to(twists.get(joint, np.zeros(1)), count) for joint in names], 1) / 2
    rotation = np.stack([np.sin(y) * np.sin(z), np.sin(y) * np.cos(z), np.cos(y) * np.sin(z), np.cos(y) * np.cos(z)], -1)
    rate = (count - 1) / seconds if seconds else float(RATE)
    return Clip(
        name, rate, names, translation.astype(np.float32), rotation.astype(np.float32),
        np.ones((count, len(names), 3), np.float32), loop=loop, stride=stride, marks=marks,
    )  # fmt: skip


def standing(seconds: float, name: str, more: Callable[[Floats, dict[str, Floats], dict[str, Floats]], None], loop: bool) -> Clip:
    """Both feet flat, the hips a little up and down with the breath."""
    count = round(seconds * RATE)
    phase = np.arange(count + 1) / count
    found: dict[str, Floats] = {}
    twists: dict[str, Floats] = {}
    high = 0.885 + 0.004 * np.sin(2 * np.pi * phase)
    for side, ahead in (("l", 0.03), ("r", -0.05)):
        legs(found, side, np.full(count + 1, ahead), np.full(count + 1, ANKLE), np.zeros(count + 1), high)
    found["forearm_l"] = found["forearm_r"] = np.full(count + 1, 0.16)
    more(phase, found, twists)
    return clip(name, found, high, twists, {}, 0.0, seconds, loop)


def breathing(phase: Floats, found: dict[str, Floats], twists: dict[str, Floats]) -> None:
    found["chest"] = 0.02 * np.sin(2 * np.pi * phase) - 0.01
    found["head"] = -0.03 * np.sin(2 * np.pi * phase)
    twists["head"] = 0.5 * np.sin(2 * np.pi * phase) * np.abs(np.sin(2 * np.pi * phase))
    found["arm_l"] = found["arm_r"] = 0.03 * np.sin(2 * np.pi * phase)


def waving(phase: Floats, found: dict[str, Floats], twists: dict[str, Floats]) -> None:
    """The right arm goes up ahead, and the forearm to and fro."""
    up = smooth(phase / 0.22) * (1 - smooth((phase - 0.80) / 0.20))
    found["arm_r"] = 2.3 * up
    found["forearm_r"] = 0.16 + up * (0.55 + 0.40 * np.sin(2 * np.pi * 3 * (phase - 0.2)))


def main() -> None:
    walk = walking("walk", Gait(1.0, 1.20, 0.60, 0.845, 0.014, 0.07, 4.0, 24.0, 18.0), {"left": 0.0, "right": 0.5})
    run = walking("run", Gait(0.66, 2.10, 0.34, 0.80, 0.035, 0.20, 12.0, 42.0, 85.0), {"left": 0.0, "right": 0.33})
    idle, wave = standing(4.0, "idle", breathing, True), standing(2.2, "wave", waving, False)
    wave = replace(wave, marks={"top": 1.0})
    scene = trimesh.Scene()
    for name, mesh in parts().items():
        scene.add_geometry(mesh, node_name=name, geom_name=name)
    (FOLDER / "parts.glb").write_bytes(scene.export(file_type="glb", include_normals=True))
    (FOLDER / "hill.ply").write_bytes(hill().export(file_type="ply", vertex_normal=False))
    bound = [
        {"transform": joint, "shape": PARTS[joint.partition("_")[0]][0], "bounds_scale": [1, 1, 1], "deformer": ""}
        for joint in JOINTS
    ]
    document = {
        "antdsl_body": 1, "name": "walker", "front": "+x", "up": "+y", "units": "m", "length": 1.75,
        "rig": json.loads(write_rig(rig())),
        "materials": {name: list(colour) for name, colour in MATERIALS.items()},
        "shapes": [{"file": "parts.glb", "shape": part, "material": material} for part, material in PARTS.values()],
        "layers": [{"version": 2, "name": "body", "static": bound, "deforming": []}],
        "groups": [{"version": 2, "name": "arms", "members": [{"name": "arm_r"}, {"name": "forearm_r"}]}],
        "clips": [json.loads(write_clip(each)) for each in (walk, run, idle, wave)],
    }  # fmt: skip
    (FOLDER / "walker.json").write_text(json.dumps(rounded_numbers(document), separators=(",", ":")) + "\n", encoding="utf-8")


def rounded_numbers(value: object) -> object:
    """Five decimals: a hundredth of a millimetre, a thousandth of a degree or less."""
    if isinstance(value, float):
        return round(value, 5)
    if isinstance(value, list):
        return [rounded_numbers(each) for each in value]
    return {key: rounded_numbers(each) for key, each in value.items()} if isinstance(value, dict) else value


if __name__ == "__main__":
    main()
