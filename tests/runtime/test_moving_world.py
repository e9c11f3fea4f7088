"""Things of the world that move: files per frame, keys, agents carried along and pushed aside, fields and senses that follow."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import meshes
import numpy as np
import pytest

from antdsl.diagnostics import Report
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.moving import MovingGround
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.outputs.scene_cameras import SceneCameras
from antdsl.pipeline import RunChoices, Shot, open_scene, simulate
from antdsl.runtime import Options, World, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.scene import PathRefused, Roots
from antdsl.scene.geometry.matrices import apply_transforms, make_identity_transforms
from antdsl.scene.staging.motion import MeshMotion

STAND = """ant 1
use steering
world { surface ground; obstacle wall; curve way; items food { load = 1 } }
species stander {
  size 4 mm
  max_speed 20 mm/s
  response 0.1 s
  seen = 0
  near = 0 mm
  start rest
  state rest amber { seen = nearest(food).load; near = distance(way); WISH }
  layers { state }
}
"""
SCENE = """antdsl: 1
fps: 24
frames: 1..13
world:
  ground: {mesh: ground.obj GROUND}
  wall: {mesh: wall.obj, at: [500, 0, 0] WALL}
  way: {curve: way.json WAY}
  food: {apple: {at: [30, 0, 0], on: ground FOOD}}
crowd:
  - {species: stander, from: stand.ant, count: 40, place: {on: ground}}
"""


def write(folder: Path, name: str, mesh: meshes.Mesh) -> None:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh[0].tolist()] + [
        f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh[1].tolist()
    ]
    (folder / name).write_text("\n".join(lines) + "\n")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write(tmp_path, "ground.obj", meshes.grid(100, 10))
    write(tmp_path, "wall.obj", meshes.box((-10, -10, -10), (10, 10, 10)))
    (tmp_path / "way.json").write_text("[[0, 0, 0], [50, 0, 0]]")
    return tmp_path


def open_with(folder: Path, wish: str = "steer stand()", scene: str = SCENE, **additions: str) -> tuple[Shot | None, Report]:
    text = STAND.replace("WISH", wish)
    if wish == "steer stand()":
        text = text.replace("; steer stand()", "")
        text = text.replace("max_speed 20 mm/s", "max_speed 0.00001 mm/s")
    (folder / "stand.ant").write_text(text)
    for key in ("GROUND", "WALL", "WAY", "FOOD"):
        scene = scene.replace(f" {key}", ", " + additions[key.lower()] if key.lower() in additions else "")
    (folder / "scene.yaml").write_text(scene)
    return open_scene(folder / "scene.yaml")


def shot(folder: Path, wish: str = "steer stand()", scene: str = SCENE, **additions: str) -> Shot:
    opened_shot, report = open_with(folder, wish, scene, **additions)
    assert opened_shot is not None and not report.errors, report.errors
    return opened_shot


def positions_by_id(world: World) -> np.ndarray:
    population = world.populations["stander"]
    return population.position[population.get_rows_by_id()].copy()


TURN = "keys: {1: {at: [0, 0, 0], rotate: [0, 0, 0]}, 13: {at: [24, 12, 0], rotate: [0, 0, 90]}}"


# --- where things are ----------------------------------------------------------------------------------------------------


def test_keys_go_evenly_and_hold_at_their_ends(folder: Path) -> None:
    scene = SCENE.replace("1..13", "1..20").replace("frames:", "preroll: 2\nframes:")
    moves = shot(folder, scene=scene, ground=TURN).setting.motion
    assert moves.first == -1 and moves.meshes["ground"].frame_count == 22
    rest = np.array([[10.0, 0, 0]] * 121)
    at = [moves.meshes["ground"].compute_vertices(rest, frame - moves.first)[0] for frame in (-1, 1, 7, 13, 20)]
    half = np.sqrt(0.5) * 10
    assert np.allclose(at, [(10, 0, 0), (10, 0, 0), (12 + half, 6 + half, 0), (24, 22, 0), (24, 22, 0)])


def test_a_key_of_one_kind_leaves_the_other_as_it_is(folder: Path) -> None:
    setting = shot(folder, wall="keys: {1: {rotate: [0, 0, 0]}, 13: {rotate: [0, 90, 0]}}").setting
    rest = setting.obstacles["wall"].vertices
    assert np.allclose(rest.mean(axis=0), [500, 0, 0])
    turned = setting.motion.meshes["wall"].compute_vertices(rest, 12)
    assert np.allclose(turned.mean(axis=0), [500, 0, 0]) and not np.allclose(turned, rest)


def test_moves_of_a_file_are_placed_by_its_entry() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    vertex_frames = np.stack([points, points * 2])
    poses = make_identity_transforms(2)
    poses[:, :, :3] *= 10
    poses[1, :, 3] = (0, 0, 5)
    moves = MeshMotion.from_positions(vertex_frames).transform_motion(poses)
    rest = apply_transforms(poses[0], points)
    assert np.array_equal(moves.compute_vertices(rest, 0), rest)
    assert np.allclose(moves.compute_vertices(rest, 1), apply_transforms(poses[1], points * 2))
    assert np.array_equal(
        moves.select_vertices(np.array([1])).compute_vertices(rest[[1]], 1), moves.compute_vertices(rest, 1)[[1]]
    )


def test_files_per_frame_are_found_by_number(tmp_path: Path) -> None:
    for name in ("a.0001.ply", "a.0002.ply", "a.10000.ply", "a.3.ply", "a.0x01.ply", "a.-0005.ply", "b.0001.ply"):
        (tmp_path / name).write_text("x")
    roots = Roots(tmp_path / "scene", {"set": tmp_path})
    assert roots.find_sequence("set:a.####.ply") == {
        -5: "set:a.-0005.ply",
        1: "set:a.0001.ply",
        2: "set:a.0002.ply",
        10000: "set:a.10000.ply",
    }
    for bad in ("set:a.##.##.ply", "set:##/a.ply", "set:c.####.ply", "../a.####.ply"):
        with pytest.raises(PathRefused):
            roots.find_sequence(bad)


def sequence(folder: Path, name: str, frames: range, place: Callable[[int], meshes.Mesh]) -> None:
    for frame in frames:
        write(folder, f"{name}.{frame:03d}.obj", place(frame))


def test_files_per_frame_move_a_mesh_and_are_inputs(folder: Path) -> None:
    sequence(folder, "wall", range(3, 14), lambda f: meshes.box((-10, -10 + f, -10), (10, 10 + f, 10)))
    opened_shot = shot(folder, scene=SCENE.replace("wall.obj", "wall.###.obj"))
    rest, moves = opened_shot.setting.obstacles["wall"].vertices, opened_shot.setting.motion
    heights = [moves.meshes["wall"].compute_vertices(rest, k)[:, 1].mean() for k in (0, 1, 2, 3, 12)]
    assert np.allclose(heights, [3, 3, 3, 4, 13])
    assert {"wall.003.obj", "wall.013.obj"} <= set(opened_shot.inputs)
    (folder / "wall.013.obj").write_text((folder / "wall.013.obj").read_text() + "\n")
    again = shot(folder, scene=SCENE.replace("wall.obj", "wall.###.obj"))
    assert opened_shot.inputs["wall.013.obj"] != again.inputs["wall.013.obj"]


def test_mistakes_of_moving_things_are_reported_at_their_place(folder: Path) -> None:
    def only(scene: str = SCENE, **additions: str) -> tuple[str, str]:
        opened_shot, report = open_with(folder, scene=scene, **additions)
        assert opened_shot is None and len(report.errors) == 1, report.errors
        assert report.errors[0].span is not None
        return report.errors[0].code, report.errors[0].span.text

    files = SCENE.replace("wall.obj", "wall.###.obj")
    assert only(files) == ("no-such-file", "wall.###.obj")
    sequence(folder, "wall", range(1, 14), lambda f: meshes.box((-10, -10, -10), (10, 10, 10)))
    (folder / "wall.007.obj").unlink()
    assert only(files) == ("no-such-file", "wall.###.obj")
    write(folder, "wall.007.obj", meshes.ball(10, rings=4))
    assert only(files) == ("moving-topology", "wall.###.obj")
    (folder / "wall.007.obj").write_text("v 0 0 x\n")
    assert only(files) == ("bad-mesh", "wall.###.obj")
    assert only(wall="keys: {one: {at: [0, 0, 0]}}")[0] == "wrong-value"
    assert only(wall="keys: {1: {up: y}}") == ("unknown-key", "up")
    assert only(food="keys: {1: {rotate: [0, 0, 0]}}") == ("wrong-value", "[0, 0, 0]")
    assert only(food="keys: {1: {at: [0, 0, 0]}, 13: {at: [400, 0, 0]}}")[0] == "off-surface"
    for frame in range(1, 14):
        (folder / f"way.{frame:02d}.json").write_text(
            "[[0, 0, 0], [50, 0, 0]]" if frame < 9 else "[[0, 0, 0], [50, 0, 0], [51, 0, 0]]"
        )
    assert only(SCENE.replace("way.json", "way.##.json")) == ("moving-topology", "way.##.json")


def test_more_frames_than_memory_are_refused_before_they_are_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl import limits

    sequence(folder, "wall", range(1, 14), lambda f: meshes.box((-10, -10 + f, -10), (10, 10 + f, 10)))
    monkeypatch.setattr(limits, "MAX_MOTION_BYTES", 3000)
    _, report = open_with(folder, scene=SCENE.replace("wall.obj", "wall.###.obj"))
    assert [d.code for d in report.errors] == ["too-large"]


# --- agents on what moves ------------------------------------------------------------------------------------------------


def test_agents_ride_on_ground_that_moves(folder: Path) -> None:
    opened_shot = shot(folder, ground=TURN)
    first, moves = None, opened_shot.setting.motion
    for world in simulate(opened_shot):
        population = world.populations["stander"]
        now = positions_by_id(world)
        first = now if first is None else first
        # the ground is flat at first, so one turn and shift tell where its points are
        track = moves.meshes["ground"].tracks[0, world.frame - 1]
        assert np.abs(now - apply_transforms(track, first)).max() < 1e-5
        up = population.read_vector("up")
        assert np.allclose(up, track[:, :3] @ (0, 1, 0), atol=1e-6)
        heading = population.read_vector("heading")
        assert np.abs((heading * up).sum(axis=1)).max() < 1e-6
        assert np.abs(np.linalg.norm(heading, axis=1) - 1).max() < 1e-6
    assert np.abs(now - first).max() > 20


def test_walkers_on_moving_ground_never_leave_it_and_walk_as_on_still_ground(folder: Path) -> None:
    """Seen from the ground, a walk on a plate that goes along is the walk on one that rests."""
    resting, going = (
        shot(folder, "steer wander()"),
        shot(folder, "steer wander()", ground="keys: {1: {at: [0, 0, 0]}, 13: {at: [0, 0, 60]}}"),
    )
    for one, two in zip(simulate(resting), simulate(going), strict=True):
        shift = np.array([0, 0, 5.0 * (two.frame - 1)])
        assert np.abs(positions_by_id(one) + shift - positions_by_id(two)).max() < 1e-4
        population = two.populations["stander"]
        assert np.abs(two.ground.position(population.footing) - population.position).max() < 1e-9


def test_ground_that_bends_carries_and_a_face_without_area_harms_no_agent(folder: Path) -> None:
    def bend_mesh(frame: int) -> meshes.Mesh:
        flat = max(1 - frame / 8, 0)  # from frame 8 on it is a line
        return meshes.grid(100, 10, lambda x, z: 10 * np.sin(x / 20) * frame / 13)[0] * (1, 1, flat), meshes.grid(100, 10)[1]

    sequence(folder, "ground", range(1, 14), bend_mesh)
    opened_shot = shot(
        folder, "steer wander()", scene=SCENE.replace("ground.obj", "ground.###.obj").replace(", on: ground FOOD", "")
    )
    for world in simulate(opened_shot):
        population = world.populations["stander"]
        for name in ("position", "velocity", "heading", "up"):
            assert np.isfinite(population.read_vector(name)).all(), (world.frame, name)
        assert np.abs(world.ground.position(population.footing) - population.position).max() < 1e-9
        assert (population.footing.face >= 0).all()
        vertices = opened_shot.setting.motion.meshes["ground"].compute_vertices(
            opened_shot.setting.surfaces["ground"].vertices, world.frame - 1
        )
        assert positions_by_id(world)[:, 2].max() <= vertices[:, 2].max() + 1e-9


def test_a_platform_picks_up_who_walks_onto_it(folder: Path) -> None:
    """A box drives over the plain: who climbs it rides along, and rays find it where it is now."""
    plain, lorry = meshes.grid(200, 8), meshes.box((-30, -5, -30), (30, 6, 30))
    ground = MovingGround({"plain": plain, "lorry": lorry}, ["lorry"])
    ground.set_mesh_vertices({"lorry": lorry[0] + (50, 0, 0)})
    up = np.array([[0.0, 1, 0]])
    foot, hit = ground.place_points(np.array([[15.0, 50, 1]]), up)
    assert hit.all() and foot.mesh[0] == 0, "there it was at rest"
    walked = ground.move(foot, np.array([[20.0, 0, 0]]), np.array([[1.0, 0, 0]]), up, 4.0)
    assert walked.footing.mesh[0] == 1 and walked.position[0, 1] > 5, "up its side at 20 mm"
    foot = walked.footing
    previous_position = ground.position(foot)
    ground.set_mesh_vertices({"lorry": lorry[0] + (70, 0, 3)})
    assert np.allclose(ground.position(foot) - previous_position, [[20, 0, 3]])
    assert np.allclose(ground.compute_rest_positions(foot), previous_position - (50, 0, 0))


def test_posed_ground_is_rebuilt_ground() -> None:
    """All that is computed again for a mesh that moved, rays included, is what it would be at once; both walks agree."""
    draw = np.random.default_rng(5)
    hill, ball = meshes.terrain(160, 12), meshes.ball(18, (0, 6, 0), rings=8)
    bend = ball[0] * (1.2, 0.8, 1) + (11, 2, -7)
    posed = MovingGround({"hill": hill, "ball": ball}, ["ball"])
    posed.move(*_crowd(posed, draw, 5))  # what it keeps was made before it was posed
    posed.set_mesh_vertices({"ball": bend})
    rebuilt = MeshGround({"hill": hill, "ball": (bend, ball[1])})
    for name in (
        "corner",
        "edge1",
        "edge2",
        "normal",
        "axis1",
        "axis2",
        "rate1",
        "rate2",
        "shear",
        "edge_c",
        "edge_s",
        "smooth",
        "link",
    ):
        assert np.allclose(getattr(posed._topology, name), getattr(rebuilt._topology, name), atol=1e-12), name
    for count in (300, 4000):  # by NumPy, and compiled where that can be had
        arguments = _crowd(rebuilt, np.random.default_rng(8), count)
        one, two = posed.move(*arguments), rebuilt.move(*arguments)
        assert np.array_equal(one.footing.face, two.footing.face) and np.allclose(one.position, two.position, atol=1e-3)
        assert np.allclose(one.up, two.up, atol=1e-3)


def _crowd(ground: MeshGround, draw: np.random.Generator, count: int) -> tuple:
    points = np.column_stack([draw.uniform(-70, 70, count), np.zeros(count), draw.uniform(-70, 70, count)])
    foot, _ = ground.place_points(points, np.array([0.0, 1, 0]))
    up = ground.compute_upright_normals(foot, np.array([0.0, 1, 0]))
    heading = np.cross(up, draw.normal(size=(count, 3)))
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    return foot, heading * draw.uniform(0, 3, (count, 1)), heading, up, 4.0


def test_an_obstacle_pushes_who_is_in_its_way(folder: Path) -> None:
    opened_shot = shot(folder, wall="keys: {1: {at: [-70, 0, 0]}, 13: {at: [10, 0, 0]}}")
    rest, moves = opened_shot.setting.obstacles["wall"].vertices, opened_shot.setting.motion.meshes["wall"]
    start = None
    for world in simulate(opened_shot):
        positions = positions_by_id(world)
        start = positions if start is None else start
        box = moves.compute_vertices(rest, world.frame - 1)
        inside = ((positions > box.min(axis=0) + 1e-3) & (positions < box.max(axis=0) - 1e-3)).all(axis=1)
        assert not inside.any(), world.frame
        assert np.abs(positions[:, 1]).max() < 1e-9
    in_way = (np.abs(start[:, 2]) < 9) & (start[:, 0] > -55) & (start[:, 0] < 15)
    moved = np.linalg.norm(positions - start, axis=1) > 0.5
    assert in_way.sum() >= 3 and moved[in_way].all()
    assert not moved[(np.abs(start[:, 2]) > 13)].any()


def test_items_and_curves_are_read_where_they_are(folder: Path) -> None:
    apple = "keys: {1: {at: [30, 0, 0]}, 13: {at: [-30, 0, 24]}}"
    curve_keys = "keys: {1: {at: [0, 0, 0]}, 13: {at: [0, 0, 48]}}"
    opened_shot = shot(folder, food=apple, way=curve_keys)
    for world in simulate(opened_shot):
        part = (world.frame - 1) / 12
        assert np.allclose(world.items["food"].position, [[30 - 60 * part, 0, 24 * part]])
        assert np.allclose([world.items["food"].visible_values[axis][0] for axis in "xz"], [30 - 60 * part, 24 * part], atol=1e-5)
        if world.frame > 1:  # what they felt in the last step is the distance as that began
            curve_z = (world.frame - 2) / 12 * 48
            population = world.populations["stander"]
            x, _, z = population.position.T
            away = np.hypot(np.clip(x, 0, 50) - x, curve_z - z)
            assert np.allclose(population.now["near"], away, atol=1e-3)


def test_an_item_rides_on_its_surface_and_keys_lead_it_over_one(folder: Path) -> None:
    ridden = shot(folder, ground=TURN).setting
    track = ridden.motion.meshes["ground"].tracks[0]
    assert np.allclose(ridden.motion.items["food"][:, 0], [apply_transforms(pose, np.array([[30.0, 0, 0]]))[0] for pose in track])
    raised = shot(
        folder, ground="keys: {1: {at: [0, 0, 0]}, 13: {at: [0, 12, 0]}}", food="keys: {1: {at: [30, 0, 0]}, 13: {at: [0, 0, 0]}}"
    )
    assert np.allclose(raised.setting.motion.items["food"][:, 0], [(30 - 2.5 * k, k, 0) for k in range(13)])


TRAIL = """ant 1
use steering
world { surface ground }
field trail on ground { cell 4 mm; half_life 100 s }
species layer {
  size 4 mm
  max_speed 15 mm/s
  response 0.1 s
  smelled = 0
  start go
  state go amber { steer wander(); smelled = trail; deposit trail 5 /s }
  layers { climb(trail, nearest: 16); state }
}
"""


def test_scent_stays_on_the_ground_that_moves(folder: Path) -> None:
    """The same crowd on ground that rests and on ground that is carried off and turned over smells and lays the same."""
    (folder / "trail.ant").write_text(TRAIL)
    runs = []
    for keys in ("", ", keys: {1: {at: [0, 0, 0], rotate: [0, 0, 0]}, 13: {at: [40, 12, 30], rotate: [0, 90, 0]}}"):
        (folder / "scene.yaml").write_text(
            f"antdsl: 1\nframes: 1..13\nworld:\n  ground: {{mesh: ground.obj{keys}}}\n"
            "crowd:\n  - {species: layer, from: trail.ant, count: 20, place: {radius: 15 mm}}\n"
        )
        opened_shot, report = open_scene(folder / "scene.yaml")
        assert opened_shot is not None and not report.errors, report.errors
        runs.append(list(simulate(opened_shot))[-1])
    fields = [world.fields["trail"].amounts for world in runs]
    assert fields[0].sum() > 1 and np.allclose(fields[0], fields[1], atol=0.02)
    smelled = [w.populations["layer"].now["smelled"][w.populations["layer"].get_rows_by_id()] for w in runs]
    assert np.allclose(*smelled, atol=0.02) and smelled[0].max() > 0.1


# --- the same bits, resumed and written ----------------------------------------------------------------------------------

ALL = {
    "ground": TURN,
    "wall": "keys: {1: {at: [-70, 0, 0]}, 13: {at: [10, 0, 0]}}",
    "way": "keys: {1: {at: [0, 0, 0]}, 13: {at: [0, 0, 48]}}",
}


def test_hashes_are_the_same_for_all_ways_to_run(folder: Path) -> None:
    opened_shot = shot(folder, "steer wander()", **ALL)
    option_sets = (Options(), Options(backend="reference"), Options(chunk=7, threads=2), Options(shuffle_rows=4))
    hashes = [[state_hash(world) for world in simulate(opened_shot, options)] for options in option_sets]
    assert all(other == hashes[0] for other in hashes[1:]) and len(set(hashes[0])) == 13


def test_a_checkpoint_goes_on_where_things_were(folder: Path) -> None:
    opened_shot = shot(folder, "steer wander()", scene=SCENE.replace("frames:", "preroll: 3\nframes:"), **ALL)
    run = simulate(opened_shot)
    worlds = [next(run) for _ in range(5)]
    saved = take_checkpoint(worlds[-1])
    later_hashes = [state_hash(world) for world in run]
    fresh = next(simulate(opened_shot))
    restore_checkpoint(fresh, saved)
    again = []
    for _ in range(8):
        step(fresh)
        again.append(state_hash(fresh))
    assert again == later_hashes


def test_frames_hold_what_moved_and_a_run_resumes(folder: Path) -> None:
    apple = "keys: {1: {at: [30, 0, 0]}, 13: {at: [-30, 0, 24]}}"
    opened_shot = shot(folder, "steer wander()", scene=SCENE.replace(", on: ground", ""), food=apple, **ALL)
    hashes = [state_hash(world) for world in simulate(opened_shot)]
    complete = folder / "whole"
    *_, state = record_frames(begin_recording(opened_shot, complete, Options(), resume=False, force=False))
    assert state.surface_error < 1e-4
    cache = open_cache(complete)
    assert [cache.read_state_hashes()[frame] for frame in range(1, 14)] == hashes
    rest = opened_shot.setting.obstacles["wall"].vertices
    for frame in (1, 5, 13):
        arrays = cache.frame(frame)
        assert np.allclose(
            arrays["mesh.wall.vertices"], opened_shot.setting.motion.meshes["wall"].compute_vertices(rest, frame - 1), atol=1e-3
        )
        assert np.allclose(arrays["items.food.P"][0, [0, 2]], [30 - 5 * (frame - 1), 2 * (frame - 1)])
    # places of the same agent differ by what it walked and what the ground went
    one, two = (cache.frame(frame) for frame in (7, 8))
    pushed = np.linalg.norm((two["P"] - one["P"]) * 24 - two["v"] - two["v_ground"], axis=1)
    assert np.median(pushed) < 3 and np.linalg.norm(two["v_ground"], axis=1).min() > 20
    gallery = Gallery(cache)
    solids = {solid.name: solid.vertices for solid in gallery.make_picture(9).solids}
    assert np.allclose(solids["wall"].mean(axis=0), [-70 + 80 * 8 / 12, 0, 0], atol=1e-3)
    half = begin_recording(opened_shot, folder / "half", Options(), resume=False, force=False)
    for state in record_frames(half):
        if state.frame == 6:
            state.stop_requested = True
    resumed = begin_recording(opened_shot, folder / "half", Options(threads=2), resume=True, force=False)
    assert resumed.resumed_from == 6
    *_, state = record_frames(resumed)
    assert state.last_state_hash == hashes[-1]


def test_a_camera_of_a_usd_file_moves_in_pictures(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    import usd_sets

    path = usd_sets.write_usd(tmp_path / "assets", tmp_path / "usd")
    opened_shot, report = open_scene(path, RunChoices({"assets": tmp_path / "assets"}))
    assert opened_shot is not None, report.errors
    run = begin_recording(opened_shot, tmp_path / "cache", Options(), resume=False, force=False)
    for state in record_frames(run):
        state.stop_requested = state.frame == 2
    scene_cameras = SceneCameras(Gallery(open_cache(tmp_path / "cache")))
    assert scene_cameras.is_moving()
    cameras = [scene_cameras.make_camera(frame) for frame in (1, 40, 90)]
    assert all(camera is not None and camera.focal == 35 for camera in cameras)
    assert np.allclose([camera.at[0] for camera in cameras if camera], [-50, 50, 50])
    assert opened_shot.setting.fps == Fraction(24)


DIGGERS = """ant 1
use steering
world { surface plate; solid hill }
species digger {
  size 4 mm
  max_speed 20 mm/s
  response 0.1 s
  start dig
  state dig amber { steer wander(); carve hill(radius: size / 2) }
  layers { state }
}
"""


def test_a_plate_moves_beside_a_hill_that_is_dug(folder: Path) -> None:
    write(folder, "hill.obj", meshes.box((60, -10, -20), (100, 10, 20)))
    (folder / "dig.ant").write_text(DIGGERS)
    (folder / "scene.yaml").write_text(
        "antdsl: 1\nframes: 1..9\nworld:\n  plate: {mesh: ground.obj, keys: {1: {at: [0, 0, 0]}, 9: {at: [0, 0, 40]}}}\n"
        "  hill: {mesh: hill.obj, voxel: 2 mm}\n"
        "crowd:\n  - {species: digger, from: dig.ant, count: 20, place: {on: plate}}\n"
        "  - {species: digger, from: dig.ant, count: 20, place: {on: hill}}\n"
    )
    opened_shot, report = open_scene(folder / "scene.yaml")
    assert opened_shot is not None and not report.errors, report.errors
    start = None
    for world in simulate(opened_shot):
        diggers = world.populations["digger"]
        place = diggers.position[diggers.get_rows_by_id()]
        start = place.copy() if start is None else start
        assert np.abs(world.ground.position(diggers.footing) - diggers.position).max() < 1e-9
    distances = place[:, 2] - start[:, 2]
    assert distances[:20].min() > 30 and abs(distances[20:]).max() < 10, (
        "those on the plate went along, those on the hill did not"
    )
    *_, state = record_frames(begin_recording(opened_shot, folder / "dug", Options(), resume=False, force=False))
    assert state.surface_error < 1e-4 and state.last_state_hash == state_hash(world)
