"""Flat soles: they lie on the ground below each foot, on slopes and on what moves, with knees that bend to the front."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import stick_bodies
from foot_frames import BodyFrames

from antdsl.bodies.agents.leg_ik import BodySpaceFeet
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.cache.pose_arrays import make_feet_arrays, read_feet
from antdsl.pipeline import Shot
from antdsl.runtime import Options, World, bind, feet_hash, restore_checkpoint, step, take_checkpoint
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER
from antdsl.runtime.feet.soles import compute_local_soles

NUMPY = Options(backend="numpy", feet=True)
PROGRAM = """ant 2
use steering
world { surface ground }
species walker {
  height 1.7 m; max_speed 1.3 m/s; response 0.2 s
  start walk
  state walk { steer wander(); when after 1 s -> rest }
  state rest { steer halt() }
}
"""


def people(folder: Path, slope: float, keys: str = "", kind: str = "surface", count: int = 6) -> Shot:
    """People on a plane of 20 m that rises towards +x by `slope` degrees."""
    rise = 10 * np.tan(np.radians(slope))
    corners = [(x, y, z) for x, y in ((-10, -rise), (10, rise)) for z in (-10, 10)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    (folder / "ground.obj").write_text("\n".join([*lines, "f 1 2 3", "f 2 4 3", ""]))
    (folder / "walker.ant").write_text(PROGRAM.replace("surface ground", f"{kind} ground"))
    path = folder / "scene.yaml"
    path.write_text(
        "antdsl: 1\nunits: m\nup: y\nfps: 24\nframes: 1..40\nseed: 4\n"
        f"world: {{ground: {{mesh: ground.obj{keys}}}}}\n"
        f"crowd: [{{species: walker, from: walker.ant, count: {count}, body: person,"
        " place: {on: ground, around: [0, 0, 0], radius: 2 m, apart: 0.6 m}}]\n"
    )
    return stick_bodies.opened(path)


def world_of(shot: Shot, steps: int, options: Options = NUMPY) -> World:
    world = bind(shot.plan, shot.setting, options)
    for _ in range(steps):
        step(world)
    return world


def find_footholds(world: World) -> np.ndarray:
    """Whether each foot [n, 2] has a foothold, in the order of rows."""
    return np.asarray(world.feet["walker"].on != NO_GROUND_NUMBER)


def posed_angles(world: World) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Angles (degrees) [n, 2] of the foot and of the toes from the ground, and of the knee; whether each foot stands."""
    body, feet = PosedBody(load_library_body("person"), ()), world.feet["walker"].sort_by_id()
    count = len(feet)
    placed = read_feet("walker", make_feet_arrays(world, "walker", 1.0), count, 2)
    assert placed is not None
    population = world.populations["walker"]
    frames = BodyFrames.of(population)
    local = np.moveaxis(frames.to_bodies(feet.shown), 0, -1).astype(np.float32)
    rise = (placed.rise / frames.size).astype(np.float32)
    poses = body.compute_poses((), count, BodySpaceFeet(local, placed.is_on_ground != 0, rise, placed.tilt, placed.normals))
    matrices, names = np.asarray(poses.world_transforms, np.float64), body.definition.rig
    feet_angles, toes, knees = [], [], []
    for k, leg in enumerate(body.definition.legs):
        hip, knee, ankle, foot = (names.find_joint(name) for name in (leg.upper, leg.lower, leg.ankle, leg.foot))
        normal = np.einsum("nak,kn->na", frames.axes, feet.tread[:, :, k].astype(np.float64))
        for joint, angles in ((ankle, feet_angles), (foot, toes)):
            up = matrices[:, joint, :, 1]  # the person rests with level feet, in axes of agents
            cosine = (up * normal).sum(axis=1) / np.linalg.norm(up, axis=1)
            angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        thigh, shank = (matrices[:, each, :, 3] - matrices[:, knee, :, 3] for each in (hip, ankle))
        bend = np.arccos((thigh * shank).sum(axis=1) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shank, axis=1))
        knees.append(np.sign(np.cross(thigh, shank)[:, 2]) * (180 - np.degrees(bend)))
    return *(np.stack(each, axis=1) for each in (feet_angles, toes, knees)), feet.is_standing  # type: ignore[return-value]


@pytest.mark.parametrize("slope", [5, 20, 35])
def test_soles_of_people_lie_flat_on_slopes_and_knees_bend_forward(tmp_path: Path, slope: float) -> None:
    world = world_of(people(tmp_path, slope), 0)
    normal = (-np.sin(np.radians(slope)), np.cos(np.radians(slope)), 0)
    heels = []
    for _ in range(20):
        for _ in range(6):
            step(world)
        feet, toes, knees, stands = posed_angles(world)
        tread = world.feet["walker"].tread[:, find_footholds(world)]
        assert np.abs(tread - np.reshape(normal, (3, 1))).max() < 1e-6
        assert toes[stands].max() < 0.1 and knees.min() > 0
        heels += feet[stands].tolist()
    assert np.mean(np.array(heels) < 1) > 0.6  # heels rise at the end of a step only
    assert stands.all() and feet.max() < 0.5, "those that stand do so on flat feet"


def test_soles_are_the_same_for_rows_threads_and_continued_runs(tmp_path: Path) -> None:
    shot = people(tmp_path, 20, count=9)
    worlds = [
        world_of(shot, 12, each) for each in (NUMPY, Options(backend="numpy", feet=True, shuffle_rows=3, chunk=4, threads=2))
    ]
    continued = bind(shot.plan, shot.setting, NUMPY)
    restore_checkpoint(continued, take_checkpoint(world_of(shot, 5)))
    for _ in range(7):
        step(continued)
    assert len({feet_hash(each.feet) for each in (*worlds, continued)}) == 1


def test_a_sole_in_swing_turns_to_the_ground_ahead_without_a_jump(tmp_path: Path) -> None:
    world = world_of(people(tmp_path, 0), 12)
    feet = world.feet["walker"]
    feet.tread[:] = np.reshape((0.6, 0.8, 0), (3, 1, 1))
    swinging = ~feet.is_standing
    assert swinging.any()
    turns = []
    for _ in range(3):
        last = deepcopy(world.feet["walker"])
        step(world)
        feet = world.feet["walker"]
        both = ~feet.is_standing & ~last.is_standing
        turns += np.degrees(np.arccos(np.clip((feet.sole * last.sole).sum(axis=0), -1, 1)))[both].tolist()
        assert np.array_equal(feet.sole[:, feet.is_standing], feet.tread[:, feet.is_standing])
    assert 1 < max(turns) < 25


def test_soles_follow_ground_that_turns(tmp_path: Path) -> None:
    keys = ", keys: {1: {at: [0, 0, 0], rotate: [0, 0, 0]}, 40: {at: [0, 0, 0], rotate: [0, 0, 12]}}"
    world = world_of(people(tmp_path, 0, keys), 20)
    feet = world.feet["walker"]
    angles = np.degrees(np.arccos(np.clip(feet.sole[1][feet.is_standing], -1, 1)))
    assert angles == pytest.approx(np.full(len(angles), angles[0]), abs=0.01) and 4 < angles[0] < 8


def test_a_sole_bends_by_at_most_45_degrees(tmp_path: Path) -> None:
    feet = world_of(people(tmp_path, 0), 1).feet["walker"]
    feet.sole[:] = np.reshape((0.8, -0.6, 0), (3, 1, 1))
    soles = compute_local_soles(feet)
    assert soles[..., 1] == pytest.approx(np.full((6, 2), np.sqrt(0.5)), abs=1e-6)
    assert np.linalg.norm(soles, axis=2) == pytest.approx(np.ones((6, 2)), abs=1e-6)
