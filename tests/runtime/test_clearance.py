"""Bodies that stay outside their ground: paths, lifts and shifts against closed forms and all faces, and crowds on stairs."""

from __future__ import annotations

from fractions import Fraction
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meaning import crowd
from numpy.typing import NDArray
from plan_text import plan_of

from antdsl.casting.faces import find_nearest_on_triangle
from antdsl.ground.mesh.boxes import FaceList
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.mesh.walkers import FaceWalker, SurfaceTables
from antdsl.machine_code.kernels import kernel
from antdsl.machine_code.kernels.types import F64, I64, Array1
from antdsl.outputs.cache.agent_arrays import AgentArrayBuilder
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.passes import optimise_plan
from antdsl.pipeline import open_scene
from antdsl.runtime import MeshData, Options, World, WorldSetting, bind, state_hash, step
from antdsl.runtime.body_positions import LIFT_REGISTERS, compute_body_positions
from antdsl.runtime.body_rows import group_rows_by_body
from antdsl.runtime.feet.wearers import get_body_wearers
from antdsl.runtime.moving.body_records import BodyLimits, BodyPoses, BodyStances
from antdsl.runtime.moving.clearance import clearance_kernels as clearance
from antdsl.runtime.moving.clearance.bodies_inside import find_bodies_inside
from antdsl.runtime.moving.clearance.body_paths import (
    FLOATS_PER_PATH,
    BodyShape,
    FacesNearby,
    compute_lift_over_profile,
    measure_ground_bend,
)
from antdsl.runtime.moving.clearance.body_tables import compute_unit_shapes, make_contact_faces
from antdsl.runtime.moving.contacts.capsules import measure_overlap_depths
from antdsl.scene.setting import BodyCapsuleData

Floats = NDArray[np.float64]
STEP_DEPTH, STEP_HEIGHT, STEPS, WIDTH = 7.0, 3.0, 6, 40.0
WALKER = """ant 2
use steering
world { surface ground }
species a {
  size 4 mm
  max_speed 30 mm/s
  max_turn 360 deg/s
  SWITCH
  start go
  state go { steer wander() }
  layers { state }
}"""


def extruded(profile: list[tuple[float, float]]) -> MeshData:
    """An open sheet over a profile of points (x, y), as wide as `WIDTH`; its normals point up where x increases."""
    points = np.array([(x, y, z) for z in (-WIDTH / 2, WIDTH / 2) for x, y in profile])
    n = len(profile)
    faces = [face for k in range(n - 1) for face in ((k, n + k, k + 1), (k + 1, n + k, n + k + 1))]
    return MeshData(points, np.array(faces, np.int32))


def stairs() -> MeshData:
    profile = [(-20.0, 0.0)]
    for k in range(STEPS):
        profile += [(k * STEP_DEPTH, k * STEP_HEIGHT), (k * STEP_DEPTH, (k + 1) * STEP_HEIGHT)]
    return extruded([*profile, (STEPS * STEP_DEPTH + 20.0, STEPS * STEP_HEIGHT)])


def walking(mesh: MeshData, count: int, clears: bool = True, options: Options | None = None, **fields: Any) -> World:
    """A crowd of walkers on a mesh; their bodies stay outside it or not. `fields`: further fields of the setting."""
    things = "".join(f"\n  obstacle {name}" for name in fields.get("obstacles", ()))
    text = WALKER.replace("SWITCH", "" if clears else "body_clearance false").replace("ground }", f"ground{things}\n}}")
    setting = WorldSetting(fps=Fraction(24), crowds=(crowd(count, radius=25),), surfaces={"ground": mesh}, seed=4, **fields)
    return bind(optimise_plan(plan_of(text, "")), setting, options or Options(backend="numpy"))


@kernel
def trace_paths(
    surface: SurfaceTables, face: I64, side: F64, window: F64, points: Array1[F64], bends: Array1[F64], nearby: FacesNearby
) -> None:
    start = FaceWalker(face, (0.25, 0.25), side, (bends[0], bends[1]), (1.0, 0.0))
    bend = measure_ground_bend(surface, nearby, start, window, 0.1, points)
    bends[0], bends[1], bends[2] = bend.roll, bend.pitch, float(bend.point_count)


@kernel
def lift_over(points: Array1[F64], count: I64, shape: BodyShape, lifts: Array1[F64]) -> None:
    lifts[0] = compute_lift_over_profile(points, count, shape, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), 100.0)


@pytest.mark.parametrize("turn", [-100.0, -40.0, 20.0, 70.0, 150.0])
def test_a_path_turns_as_far_as_it_reaches_over_an_edge(turn: float) -> None:
    angle = np.radians(turn)
    mesh = extruded([(-30.0, 0.0), (0.0, 0.0), (30 * np.cos(angle), -30 * np.sin(angle))])
    ground = MeshGround({"ground": (mesh.vertices, mesh.faces)})
    walk, table = ground.build_crowd_walk(1.0, 4.0), ground.triangles[3]
    assert walk is not None
    surface, points = walk.build_tables()[0], np.empty(FLOATS_PER_PATH)
    tree = walk.boxes.to_box_tree()
    nearby = FacesNearby(tree, FaceList(np.empty(9, np.int64), 0), 0, table.piece, table.cuts.cut_starts)
    start = table.corner[:, 0] + 0.25 * table.edge1[:, 0] + 0.25 * table.edge2[:, 0]
    for window in (20.0, 40.0):
        travel = np.array([1.0, 0.0, 0.0])
        bends = np.array([table.axis1[:, 0] @ travel, table.axis2[:, 0] @ travel, 0.0])
        trace_paths(surface, 0, 1.0, window, points, bends, nearby)
        beyond = max(window + start[0], 0.0)
        assert bends[0] == pytest.approx(0.0, abs=1e-6)
        assert bends[1] == pytest.approx(0.0 if turn < -114 else angle * beyond / (2 * window), abs=2e-6)


def test_a_lift_clears_any_profile_and_is_no_higher_than_it_must() -> None:
    rng, shape = np.random.default_rng(3), BodyShape(1.5, 0.5, 0.7, -0.1)
    along = np.linspace(-shape.axis_half_length, shape.axis_half_length, 400)
    for _ in range(40):
        slopes = np.radians(rng.uniform(-50, 60, 5))
        parts = np.stack([np.cos(slopes), np.sin(slopes)], axis=1) * rng.uniform(0.3, 1.5, 5)[:, None]
        corners = np.concatenate([[[0.0, 0.0]], np.cumsum(parts, axis=0)])
        points = np.zeros((len(corners), FLOATS_PER_PATH // 18))
        points[:, :2] = corners
        lifts = np.empty(1)
        lift_over(points.ravel(), len(corners), shape, lifts)
        line = np.concatenate([a + (b - a) * np.linspace(0, 1, 300)[:, None] for a, b in pairwise(corners)])
        axis = np.stack([along + shape.middle_forward_offset, np.full(len(along), shape.middle_height)], axis=1)
        gaps = [np.sqrt(((axis[:, None] + [0, lift] - line) ** 2).sum(axis=2)).min() for lift in (lifts[0], lifts[0] - 0.02)]
        assert gaps[0] > shape.radius - 0.01
        assert lifts[0] == 0.0 or gaps[1] < shape.radius


@pytest.mark.parametrize("turns", [0, 4])
def test_depths_are_those_to_all_faces(turns: int) -> None:
    world = walking(stairs(), 60)
    for _ in range(8):
        step(world)
    population, meshes = world.populations["a"], world.ground.meshes
    assert meshes is not None
    walk, n = meshes.build_crowd_walk(1.0, 4.0), len(population)
    rng, (shapes, body) = np.random.default_rng(6), compute_unit_shapes(world, population)
    shape = BodyShape(*shapes[0])
    now = {name: array.copy() for name, array in population.now.items()}
    up = population.read_vector("up") + rng.normal(0, 0.3, (n, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    heading = np.cross(up, rng.normal(size=(n, 3)))
    heading /= np.linalg.norm(heading, axis=1)[:, None]
    columns = [tuple(np.ascontiguousarray(v, np.float32) for v in vectors.T) for vectors in (up, heading, np.zeros((n, 3)))]
    zero, rows = np.zeros(n, np.float32), np.arange(n)
    limits = BodyLimits(zero, zero, np.float32(1), now["size"], zero, shapes, body, np.inf, np.inf)
    old, depths, outs = tuple(v.copy() for v in columns[2]), zero.copy(), np.zeros((3, n), np.float32)
    inputs = (
        rows,
        BodyStances(population.position, population.normal, BodyPoses(*columns[:2])),
        limits,
        columns[2],
        old,
        depths,
        outs,
    )
    clearance.shift_bodies(*make_contact_faces(world, walk, n, 1), *inputs, turns, 0, n)
    vertices, faces, _, _ = meshes.triangles
    corners, size = vertices[faces], now["size"].astype(np.float64)[:, None]
    up, heading, lift = (np.stack(v, axis=1).astype(np.float64) for v in columns)
    middle = population.position + lift + size * (up * shape.middle_height + heading * shape.middle_forward_offset)
    nearest = np.full(n, np.inf)
    for part in np.linspace(-1, 1, 9):
        center = middle + heading * size * shape.axis_half_length * part
        for i in range(n):
            at = np.broadcast_to(center[i], (len(corners), 3))
            nearest[i] = min(
                nearest[i], np.sqrt(((find_nearest_on_triangle(at, corners) - at) ** 2).sum(axis=1)).min() / size[i, 0]
            )
    expected = np.maximum(shape.radius - nearest, 0.0)
    assert (expected > 0.02).any() or turns
    assert (depths >= expected - 1e-6).all()
    # A face between two points of the axis is met by the axis alone.
    assert (depths - expected < 1e-6).mean() > 0.65
    assert (depths - expected)[depths < shape.radius].max() < 0.03
    if turns:
        assert (depths < 0.02).mean() > 0.8, "most bodies are brought outside"


def test_bodies_stay_outside_stairs_near_their_ground_and_as_fast() -> None:
    frames, speeds = 72, []
    for clears in (False, True):
        world = walking(stairs(), 60, clears)
        population, distance, leaning, turns = world.populations["a"], 0.0, 0, 0.0
        for _ in range(frames):
            previous, pose = population.position.copy(), (population.read_vector("up"), population.read_vector("heading"))
            step(world)
            distance += float(np.linalg.norm(population.position - previous, axis=1).mean())
            leaning += int(
                np.count_nonzero((population.read_vector("up") * population.normal).sum(axis=1) < 0.5)
            )  # by 60 degrees
            axes = [
                np.stack([u, h, np.cross(u, h)])
                for u, h in (pose, (population.read_vector("up"), population.read_vector("heading")))
            ]
            trace = (axes[0] * axes[1]).sum(axis=(0, 2))
            turns = max(turns, float(np.degrees(np.arccos(((trace - 1) / 2).clip(-1, 1))).max()))
        speeds.append(distance)
        summary = world.motion.summarise()
        if clears:
            assert summary["body_inside"] == 0.0 and summary["heads_inside"] == 0.0
            assert leaning < 0.005 * 60 * frames and turns < 15.1 and summary["step_max"] <= 1.005
        else:
            assert summary["body_inside"] > 0.05 and leaning > 0.02 * 60 * frames, "without it, bodies are inside or lag"
    assert speeds[1] > 0.95 * speeds[0]


def folds() -> MeshData:
    """A sheet of wide faces with folds of 20 degrees, upward and downward."""
    return extruded([(-30.0, 0.0), (-15.0, 0.0), (0.0, 5.5), (15.0, 5.5), (30.0, 0.0)])


def test_bodies_on_wide_faces_rise_and_sink_steadily() -> None:
    world, inside, lifts, frames = walking(folds(), 60), 0, [], 60
    population = world.populations["a"]
    for _ in range(frames):
        step(world)
        inside += int(find_bodies_inside(world, population, np.arange(60)).sum())
        lifts.append(np.linalg.norm(compute_body_positions(population) - population.position, axis=1)[np.argsort(population.ids)])
    change = np.diff(np.array(lifts), axis=0) / 4.0
    returns = (np.abs(change) > 0.02) & (np.abs(np.roll(change, 1, axis=0)) > 0.02) & (change * np.roll(change, 1, axis=0) < 0)
    assert inside < 0.001 * frames * 60
    assert np.max(lifts) > 0.1, "some bodies rise"
    assert returns[1:].mean() < 0.002


def test_bodies_turn_with_a_rod_that_is_thinner_than_they_are_long() -> None:
    sectors = 9  # 40 degrees each, which is smooth for wide faces
    angle = 2 * np.pi * np.arange(sectors) / sectors
    ring = np.stack([np.zeros(sectors), 2.5 * np.cos(angle) - 2.5, 2.5 * np.sin(angle)], axis=1)
    vertices = np.concatenate([ring + np.array([x, 0, 0]) for x in (-30.0, 0.0, 30.0)])
    first = np.concatenate([np.arange(sectors), sectors + np.arange(sectors)])
    aside = np.where(first % sectors == sectors - 1, first - sectors + 1, first + 1)
    faces = np.concatenate(
        [np.stack([first, first + sectors, aside]), np.stack([aside, first + sectors, aside + sectors])], axis=1
    )
    world, leaning, frames = walking(MeshData(vertices, faces.astype(np.int32)), 12), 0, 72
    population = world.populations["a"]
    for _ in range(frames):
        step(world)
        leaning += int(np.count_nonzero((population.read_vector("up") * population.normal).sum(axis=1) < 0.5))
    assert len(population) == 12 and leaning == 0, "by 60 degrees"
    assert world.motion.summarise()["body_inside"] < 0.02


def pillars() -> MeshData:
    """Posts of 6 x 6 mm between which bodies fit, on flat ground."""
    box = np.array([(x, y, z) for x in (-3.0, 3.0) for y in (-5.0, 12.0) for z in (-3.0, 3.0)])
    sides = np.array(
        [(0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5), (2, 3, 7), (2, 7, 6), (1, 5, 7), (1, 7, 3)]
    )
    middles = [(x, 0.0, z) for x in (-14.0, 0.0, 14.0) for z in (-14.0, 0.0, 14.0)]
    vertices = np.concatenate([box + np.array(middle) for middle in middles])
    return MeshData(vertices, np.concatenate([sides + 8 * k for k in range(len(middles))]).astype(np.int32))


def test_bodies_stay_outside_obstacles_and_as_fast() -> None:
    obstacle, frames, inside, speeds = pillars(), 72, [], []
    flat = extruded([(-40.0, 0.0), (-20.0, 0.0), (0.0, 0.0), (20.0, 0.0), (40.0, 0.0)])
    corners = obstacle.vertices[obstacle.faces]
    for clears in (False, True):
        world = walking(flat, 40, clears, obstacles={"post": obstacle})
        population, count, distance = world.populations["a"], 0, 0.0
        half, radius, height, ahead = compute_unit_shapes(world, population, 0.0)[0][0]
        for _ in range(frames):
            previous = population.position.copy()
            step(world)
            distance += float(np.linalg.norm(population.position - previous, axis=1).mean())
            up, heading = population.read_vector("up"), population.read_vector("heading")
            size = population.now["size"].astype(np.float64)[:, None]
            middle = compute_body_positions(population) + size * (up * height + heading * ahead)
            nearest = np.full(len(population), np.inf)
            for part in np.linspace(-1, 1, 9):
                center = np.repeat(middle + heading * size * half * part, len(corners), axis=0)
                gap = find_nearest_on_triangle(center, np.tile(corners, (len(population), 1, 1))) - center
                nearest = np.minimum(nearest, np.sqrt((gap**2).sum(axis=1)).reshape(len(population), -1).min(axis=1))
            count += int(np.count_nonzero(nearest < (radius - 0.01) * size[:, 0]))
        inside.append(count / (frames * len(population)))
        speeds.append(distance)
        assert abs(world.motion.summarise()["body_inside"] - inside[-1]) < 0.05
    assert inside[0] > 0.01 and inside[1] < 0.001, inside
    assert speeds[1] > 0.88 * speeds[0], "bodies turn and walk round posts that feet could pass closely"


def test_step_and_shift_together_move_bodies_little_farther_than_a_step() -> None:
    flat = extruded([(-40.0, 0.0), (-20.0, 0.0), (0.0, 0.0), (20.0, 0.0), (40.0, 0.0)])
    world, farthest = walking(flat, 80, obstacles={"post": pillars()}), 0.0
    population = world.populations["a"]
    longest = float((population.now["max_speed"] * np.float32(world.dt)).max())
    for _ in range(36):
        previous = compute_body_positions(population).copy()
        step(world)
        farthest = max(farthest, float(np.linalg.norm(compute_body_positions(population) - previous, axis=1).max()))
    assert longest < farthest < 1.21 * longest


def test_results_do_not_depend_on_threads_rows_or_backends() -> None:
    hashes = set()
    for options in (
        Options(backend="numpy"), Options(backend="numpy", threads=2), Options(backend="native", wait_for_code=True),
        Options(backend="numpy", shuffle_rows=7), Options(backend="reference"),
    ):  # fmt: skip
        world = walking(stairs(), 80, options=options, obstacles={"post": pillars()})
        for _ in range(10):
            step(world)
        hashes.add(state_hash(world))
    assert len(hashes) == 1


def test_bodies_that_contacts_move_do_not_turn_into_their_neighbours() -> None:
    rough = extruded([(float(x), 1.2 * float(np.sin(x / 2.5))) for x in np.arange(-30.0, 30.5, 1.5)])
    world, shares = walking(rough, 160, contacts="hard"), []
    for _ in range(40):
        step(world)
        shares.append(float((measure_overlap_depths(world) > 0.05).mean()))
    assert np.mean(shares[16:]) < 0.03, "a tenth if bodies turn towards their feet again"


def test_frames_have_the_shifted_positions() -> None:
    world = walking(stairs(), 60)
    for _ in range(20):
        step(world)
    population = world.populations["a"]
    shift = population.read_vector("~lift")
    assert (np.abs(shift).max(axis=1) > 0.1).any()
    drawn = AgentArrayBuilder(1.0, {}, {"a": ()}).build_arrays(world, ("P",))["P"]
    order = population.get_rows_by_id()
    assert np.allclose(drawn, (population.position + shift)[order], atol=1e-4)


def test_flat_ground_and_no_agents_change_nothing() -> None:
    flat = extruded([(-60.0, 0.0), (60.0, 0.0)])
    hashes = []
    for clears in (False, True):
        world = walking(flat, 30, clears)
        for _ in range(12):
            step(world)
        population = world.populations["a"]
        hashes.append((population.position.tobytes(), *(population.now[f"heading.{axis}"].tobytes() for axis in "xyz")))
    assert hashes[0] == hashes[1]
    assert not np.any(population.read_vector("~lift"))
    empty = walking(flat, 0)
    step(empty)
    assert len(empty.populations["a"]) == 0


def test_the_first_edition_has_no_registers_for_bodies() -> None:
    text = WALKER.replace("ant 2", "ant 1").replace("SWITCH", "")
    assert not any(name.startswith("~lift") for name in plan_of(text, "").species["a"].registers)
    assert any(name.startswith("~lift") for name in plan_of(WALKER.replace("SWITCH", ""), "").species["a"].registers)


def test_feet_of_several_bodies_read_the_shift_of_each_body() -> None:
    world = walking(stairs(), 60, body_weights={"a": (1.0, 1.0)})
    for _ in range(8):
        step(world)
    population = world.populations["a"]
    drawn = compute_body_positions(population)
    assert any(population.now[name].any() for name in LIFT_REGISTERS)
    for key, rows in group_rows_by_body(population, world.setting):
        assert rows is not None and len(rows) > 10
        assert np.array_equal(compute_body_positions(get_body_wearers(world, key)), drawn[rows])


def test_each_agent_is_held_outside_by_the_capsule_of_its_own_body() -> None:
    capsules = (BodyCapsuleData(0.7, 0.2, 0.15, 0.0), BodyCapsuleData(1.3, 0.4, 0.3, 0.1))
    mixed, worlds = {f"a#{k}": each for k, each in enumerate(capsules)}, []
    for weights, own in (({"a": (1.0, 1.0)}, mixed), *(({}, {"a": each}) for each in capsules)):
        worlds.append(walking(stairs(), 60, body_weights=weights, body_capsules=own))
        for _ in range(12):
            step(worlds[-1])
    several, *single = (world.populations["a"] for world in worlds)
    for (_, rows), population in zip(group_rows_by_body(several, worlds[0].setting), single, strict=True):
        assert rows is not None and len(rows) > 10
        for name in ("position", "up", "heading", "~lift"):
            assert np.array_equal(several.read_vector(name)[rows], population.read_vector(name)[rows])
    assert not np.array_equal(single[0].read_vector("~lift"), single[1].read_vector("~lift"))


def test_a_run_is_continued_with_the_same_bodies(tmp_path: Path) -> None:
    mesh = stairs()
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces]
    (tmp_path / "stairs.obj").write_text("\n".join(lines))
    (tmp_path / "a.ant").write_text(WALKER.replace("SWITCH", ""))
    (tmp_path / "scene.yaml").write_text(
        "antdsl: 1\nunits: mm\nup: y\nframes: 1..9\noutput: {checkpoint: 1}\nworld: {ground: {mesh: stairs.obj}}\n"
        "crowd: [{species: a, from: a.ant, count: 20, place: {on: ground, by: area}}]\n"
    )
    shot, _ = open_scene(tmp_path / "scene.yaml")
    assert shot is not None
    hashes = {}
    for folder, count in (("whole", 9), ("part", 4), ("part", 9)):
        recording = begin_recording(shot, tmp_path / folder, Options(), resume=count == 9, force=False)
        list(islice(record_frames(recording), count))
        hashes[folder, count] = state_hash(recording.world)
    assert recording.resumed_from == 4 and hashes["part", 9] == hashes["whole", 9]
    assert recording.world.populations["a"].read_vector("~lift").any()
