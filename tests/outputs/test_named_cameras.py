"""Cameras of a scene by name: in the manifest, in pictures, as a sense, in selectors, and those that follow an agent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gltf_scene import Scene
from test_scene_files import PROGRAM, SCENE, folder, opened  # noqa: F401
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.cache.frame_agents import make_agent_keys
from antdsl.outputs.cache.manifest import Manifest
from antdsl.outputs.cache.manifest_parts import FollowEntry
from antdsl.outputs.drawing import DrawRequest, FrameDrawer
from antdsl.outputs.edits.cache_selection import Selection, list_selector_names
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.outputs.edits.verbs.terrain import Ground
from antdsl.outputs.gallery import Gallery, PictureUnavailable
from antdsl.outputs.pictures.camera import make_view
from antdsl.outputs.pictures.following import AgentTrack, BodySize, FollowingCamera, StableTrack
from antdsl.outputs.pictures.model import Camera
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.outputs.scene_cameras import SceneCameras, find_agent
from antdsl.runtime import Options, bind, step
from antdsl.runtime.sensing.selectable_agents import collect_selectable_frame
from antdsl.scene.notes.selection import select_ids, select_rows
from antdsl.scene.notes.selectors import AgentConditions

SHOT = "camera: {at: [80, 60, 80], look_at: [10, 0, 10], focal: 30 mm}"
CAMERAS = (
    f"{SHOT}\n"
    + """cameras:
  wide: {at: [0, 300, 1], look_at: [0, 0, 0]}
  dolly: {at: [9, 9, 9], look_at: [10, 0, 10], keys: {1: {at: [80, 60, 80]}, 3: {at: [40, 20, 80], focal: 70 mm}}}
  all: fit
  hero: {follow: guards.2}
  side: {follow: ant.2, by: [30, 20, 10], smooth: 1 s, focal: 50 mm}
"""
)
NAMED = SCENE.replace("{species: ant,", "{name: guards, species: ant,").replace("1..3", "1..8") + CAMERAS


@pytest.fixture
def cache(folder: Path) -> Cache:  # noqa: F811
    return record(folder, NAMED)


def record(folder: Path, scene: str) -> Cache:  # noqa: F811
    shot, report = opened(folder, scene)
    assert shot is not None, [each.message for each in report]
    for _ in record_frames(begin_recording(shot, folder / "out", Options(backend="numpy"), resume=False, force=True)):
        pass
    return open_cache(folder / "out")


def test_a_cache_has_the_cameras_of_its_scene(cache: Cache) -> None:
    cameras = SceneCameras(Gallery(cache))
    assert cameras.names == ["shot", "wide", "dolly", "all", "hero", "side"]
    assert [name for name in cameras.names if cameras.is_moving(name)] == ["dolly", "hero", "side"]
    assert cameras.is_fitted("all") and cameras.make_camera(1, "all") is None and cameras.make_camera(1, "other") is None
    shot, wide = cameras.make_camera(1), cameras.make_camera(5, "wide")
    assert shot is not None and (shot.at, shot.look_at, shot.focal) == ((80, 60, 80), (10, 0, 10), 30)
    assert wide is not None and (wide.at, wide.focal) == ((0, 300, 1), 35)
    dolly = [cameras.make_camera(frame, "dolly") for frame in (1, 2, 3, 8)]
    assert [each.at for each in dolly if each] == [(80, 60, 80), (60, 40, 80), (40, 20, 80), (40, 20, 80)]
    assert [(each.focal, each.look_at) for each in dolly if each] == [(70, (10, 0, 10))] * 4
    assert cache.manifest.cameras["side"] == FollowEntry(follow="ant.2", by=(30, 20, 10), smooth=1, focal=50)
    assert find_agent(cache.manifest, "guards.2") == (0, 2)
    for wrong in ("guards.9", "bee.1"):
        with pytest.raises(PictureUnavailable, match=f"no agent `{wrong}`"):
            find_agent(cache.manifest, wrong)


@pytest.mark.parametrize("camera", ["shot", "wide", "dolly"])
def test_edits_and_notes_select_by_the_same_view(folder: Path, camera: str) -> None:  # noqa: F811
    cache = record(folder, NAMED.replace("count: 5", "count: 60").replace("radius: 20", "radius: 60"))
    shot, _ = opened(folder, NAMED.replace("count: 5", "count: 60").replace("radius: 20", "radius: 60"))
    assert shot is not None and list_selector_names(cache.manifest).cameras == {"shot", "wide", "dolly"}
    world = bind(shot.plan, shot.setting, Options(backend="numpy"))
    for frame in (1, 2, 3):
        selector = AgentConditions(in_view=camera)
        keys = make_agent_keys(cache.frame(frame))
        ids = keys[Selection(selector, cache, frame).find(keys)] // SPECIES_PER_KEY
        assert ids.tolist() == select_ids(selector, collect_selectable_frame(world))["ant"].tolist() and 0 < len(ids) <= 60
        parts = [AgentConditions(in_view=camera, across=part) for part in (["0 %", "50 %"], ["50 %", "100 %"])]
        halves = [keys[Selection(part, cache, frame).find(keys)] // SPECIES_PER_KEY for part in parts]
        assert sorted(np.concatenate(halves)) == ids.tolist() and len(halves[0]) < len(ids)
        step(world)


def test_a_manifest_without_names_has_its_default_camera(cache: Cache) -> None:
    document = cache.manifest.model_dump(mode="json")
    del document["cameras"]
    older = Manifest.model_validate(document)
    assert dict(older.named_cameras) == {"shot": cache.manifest.cameras["shot"]} and older.camera is not None


@pytest.mark.parametrize("name", ["hero", "side", "close", "eye"])
def test_the_agent_that_a_camera_follows_stays_in_the_picture(cache: Cache, name: str) -> None:
    frames = cache.frames()
    request = DrawRequest(320, 180, name, (), agents=(2 * SPECIES_PER_KEY,))
    drawer = FrameDrawer(request.gallery(cache), request, frames, 1)
    eyes = []
    for frame in frames:
        camera = drawer._find_camera(frame)
        arrays = cache.frame(frame)
        view = make_view(camera, 320, 180, (0.0, 1.0, 0.0))
        pixels, depth = view.project(np.asarray(arrays["P"], np.float64)[np.asarray(arrays["id"]) == 2])
        assert depth[0] > 0 and (np.abs(pixels[0] - [160, 90]) < [80, 75]).all(), (frame, pixels)
        eyes.append(camera.at)
    steps = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    assert steps.max() > 0 and steps.max() < 2 * max(steps.min(), 0.5), "it moves, evenly"
    if name == "side":
        offsets = [np.subtract(drawer._find_camera(frame).look_at, drawer._find_camera(frame).at) for frame in frames]
        assert np.ptp(offsets, axis=0).max() < 1e-6, "its direction never changes"
    again = FrameDrawer(request.gallery(cache), request, frames, 1)
    assert [again._find_camera(frame) for frame in reversed(frames)] == [drawer._find_camera(frame) for frame in reversed(frames)]


def wander(count: int, shake: float) -> AgentTrack:
    """An agent that walks along a circle over a hill, turns, and trembles."""
    random, turns = np.random.default_rng(3), np.linspace(0, 3, count)
    path = np.stack([60 * np.sin(turns), 10 * np.cos(2 * turns), 60 * np.cos(turns)], axis=1)
    yaw = turns + np.pi / 2 + 0.8 * np.sin(9 * turns)
    orient = np.stack([np.zeros(count), np.sin(yaw / 2), np.zeros(count), np.cos(yaw / 2)], axis=1)
    return AgentTrack(np.arange(count), path + random.normal(0, shake, (count, 3)), orient)


@pytest.mark.parametrize("is_close", [True, False])
def test_a_camera_does_not_tremble_or_turn_with_its_agent(is_close: bool) -> None:
    track, body = wander(120, 0.15), BodySize(2.0, 1.5, 4.0)
    stable = StableTrack.of(track, 12.0, np.array([0.0, 1.0, 0.0]))
    following = FollowingCamera.of(stable, body, 35.0, 0.6, is_close)
    cameras = [following.make_camera(frame) for frame in range(120)]
    eyes, aims = np.array([each.at for each in cameras]), np.array([each.look_at for each in cameras])
    jolts = np.linalg.norm(np.diff(eyes, 2, axis=0), axis=1)
    assert jolts.max() < 0.2 * np.linalg.norm(np.diff(track.position, 2, axis=0), axis=1).max()
    views = (aims - eyes) / np.linalg.norm(aims - eyes, axis=1)[:, None]
    assert (views @ views[0]).min() > np.cos(0.02), "the agent's up never changes, so neither does the direction"
    far = np.linalg.norm(aims[0] - eyes[0])
    assert np.linalg.norm(following.centre - track.position, axis=1).max() < 0.2 * far
    ends = following.make_camera(-50), following.make_camera(500)
    assert ends == (cameras[0], cameras[-1])


def test_a_camera_goes_over_an_edge_with_its_agent() -> None:
    """From the floor to a wall: the camera turns with the ground by a right angle, and is never below it, if it is beside."""
    frames = np.arange(80)
    path = np.stack([np.minimum(frames, 40) - 40.0, np.maximum(frames - 40.0, 0), np.zeros(80)], axis=1)
    tilt = np.where(frames < 40, 0.0, np.pi / 2)
    orient = np.stack([np.zeros(80), np.zeros(80), np.sin(tilt / 2), np.cos(tilt / 2)], axis=1)
    stable = StableTrack.of(AgentTrack(frames, path, orient), 12.0, np.array([0.0, 1.0, 0.0]))
    following = FollowingCamera.of(stable, BodySize(2.0, 1.5, 4.0), 35.0, np.pi / 2)
    eyes = np.array([following.make_camera(frame).at for frame in range(80)])
    assert (eyes[:, 1] > 0.5).all() and (eyes[:, 0] < -0.5).all()
    tops = np.array([following.make_camera(frame).up for frame in range(80)])
    assert np.abs(np.diff(tops, axis=0)).max() < 0.15 and np.allclose(tops[0], [0, 1, 0]) and np.allclose(tops[-1], [-1, 0, 0])


@pytest.mark.parametrize(("radius", "height", "focal"), [(2.0, 1.5, 35.0), (300.0, 1750.0, 35.0), (60.0, 20.0, 85.0)])
def test_a_close_body_fills_the_picture(radius: float, height: float, focal: float) -> None:
    track = AgentTrack(np.arange(1), np.array([[5.0, 2.0, -3.0]]), np.array([[0.0, 0.0, 0.0, 1.0]]))
    stable = StableTrack.of(track, 0.0, np.array([0.0, 1.0, 0.0]))
    camera = FollowingCamera.of(stable, BodySize(radius, height, max(2 * radius, height)), focal, 0.6).make_camera(0)
    turns = np.linspace(0, 2 * np.pi, 60)
    rim = [[radius * np.cos(t), y, radius * np.sin(t)] for t in turns for y in (0.0, height)]
    pixels, depth = make_view(camera, 1600, 900, (0.0, 1.0, 0.0)).project(track.position[0] + np.array(rim))
    extent = np.abs(pixels / [1600, 900] - 0.5).max(axis=0) * 2
    assert (depth > 0).all() and extent.max() < 1.3 and extent.max() > 0.8


def test_the_lens_of_a_camera_has_the_real_size_and_focuses_on_an_agent(folder: Path) -> None:  # noqa: F811
    lens = "f_stop: 10, focus: 25 mm}"
    scene = NAMED.replace(SHOT, SHOT[:-1] + ", " + lens).replace("{follow: guards.2}", "{follow: guards.2, f_stop: 70}")
    cache = record(folder, scene.replace("look_at: [0, 0, 0]}", "look_at: [0, 0, 0], f_stop: 2, focus: guards.2}"))
    cameras = SceneCameras(Gallery(cache))
    shot, wide, hero = (cameras.make_camera(3, name) for name in ("shot", "wide", "hero"))
    assert shot is not None and wide is not None and hero is not None
    assert (shot.aperture, shot.focus) == (3.0, 25.0) and wide.aperture == 17.5 and hero.aperture == 0.5
    arrays = cache.frame(3)
    place = arrays["P"][arrays["id"] == 2][0]
    assert wide.focus == pytest.approx(300 - float(place[1]), rel=0.01)
    assert hero.focus is not None and 0 < hero.focus < np.linalg.norm(np.subtract(hero.at, place)) * 1.2
    request = DrawRequest(64, 36, "scene", (), f_stop=5.0, focus=40.0)
    camera = FrameDrawer(request.gallery(cache), request, [3], 1).make_camera(3)
    assert (camera.aperture, camera.focus) == (6.0, 40.0)


def test_options_place_a_camera(cache: Cache) -> None:
    request = DrawRequest(320, 180, "scene", (), at=(1.0, 2.0, 3.0), look_at=(4.0, 5.0, 6.0), focal=80.0)
    drawer = FrameDrawer(request.gallery(cache), request, [1], 1)
    assert drawer.draw(1).shape == (180, 320, 3) and drawer._find_camera(1) == Camera((1, 2, 3), (4, 5, 6))
    words = ["render", str(cache.folder), "--width", "64", "--height", "36", "--out", str(cache.folder / "stills")]
    for options in ("--at 9,8,7 --look-at 1,0,-2.5 --focal 20", "--camera wide", "--camera hero --sheet"):
        result = CliRunner().invoke(app, [*words, *options.split()])
        assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--camera heor", "has no camera `heor`: did you mean `hero`?"),
        ("--camera unlike", "it has `scene`, `fit`"),
        ("--at 1,2", "`1,2` is not a point such as `120,80,-40`"),
        ("--at 1,2,x --look-at 0,0,0", "`1,2,x` is not a point"),
        ("--at 1,2,3", "add `--look-at X,Y,Z`"),
        ("--look-at 1,2,3", "add `--at X,Y,Z`"),
        ("--at 1,2,3 --look-at 0,0,0 --camera wide", "leave `--camera` out"),
        ("--camera top --focal 50", "parallel rays"),
    ],
)
def test_options_that_do_not_fit(cache: Cache, options: str, words: str) -> None:
    result = CliRunner().invoke(app, ["render", str(cache.folder), *options.split()])
    assert result.exit_code == 2 and words in " ".join(result.output.replace("│", " ").split())


SENSING = PROGRAM.replace("world {", "world {\n  camera shot").replace("species ant {", "species ant {\n  seen = 0")


def test_a_scene_places_the_cameras_that_programs_sense(folder: Path) -> None:  # noqa: F811
    (folder / "ant.ant").write_text(
        SENSING.replace("state go amber {", "state go amber { seen = if in_view(shot) then 1 else 0;")
    )
    shot, report = opened(folder, NAMED)
    assert shot is not None, [each.message for each in report]
    world = bind(shot.plan, shot.setting, Options(backend="numpy"))
    frame = collect_selectable_frame(world)
    selected = select_rows(AgentConditions(in_view="shot"), frame)["ant"]
    step(world)
    assert world.populations["ant"].now["seen"].astype(bool).tolist() == selected.tolist() and selected.any()
    other, _ = opened(folder, NAMED.replace("focal: 30", "focal: 31"))
    assert other is not None and other.inputs["camera shot"] != shot.inputs["camera shot"]
    assert {name for name in shot.inputs if other.inputs[name] != shot.inputs[name]} == {"camera shot"}
    named = "cameras:\n  shot: {at: [80, 60, 80], look_at: [10, 0, 10], focal: 30 mm}\n"
    same, report = opened(folder, SCENE.replace("1..3", "1..8") + named)
    assert same is not None and (same.setting.cameras["shot"].at == shot.setting.cameras["shot"].at).all()


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("focal: 30 mm", "f_stop: 0", "wrong-value", "0"),
        ("focal: 30 mm", "focus: guards.99", "unknown-thing", "guards"),
        (CAMERAS, "", "missing-thing", "the program's camera `shot` has no place in the scene"),
        (SHOT, "camera: fit", "wrong-kind", "when pictures are made"),
        (SHOT, "camera: {follow: guards.1}", "wrong-kind", "follows one"),
        ("wide:", "shot:", "duplicate-name", "the camera under `camera` already has the name `shot`"),
        ("wide:", "top:", "duplicate-name", "`top` is a view that every cache has"),
        ("guards.2", "gards.2", "unknown-thing", "no crowd line or species is named `gards`"),
        ("guards.2", "guards.5", "unknown-thing", "`guards` has 5 agents"),
        ("guards.2", "guards", "wrong-value", "`guards` is not a single agent"),
        ("guards.2", "guards.2..4", "wrong-value", "is not a single agent"),
        ("follow: guards.2", "folow: guards.2", "unknown-key", "`folow` is not a key of `hero`"),
        ("3: {at: [40, 20, 80]", "3: {to: [40, 20, 80]", "unknown-key", "`to` is not a key of `3`"),
        ("wide: {at: [0, 300, 1], look_at: [0, 0, 0]}", "wide: {usd: none.usda, prim: /cam}", "no-such-file", "none.usda"),
    ],
)
def test_cameras_with_mistakes(folder: Path, old: str, new: str, code: str, words: str) -> None:  # noqa: F811
    (folder / "ant.ant").write_text(SENSING)
    assert old in NAMED
    shot, report = opened(folder, NAMED.replace(old, new))
    assert shot is None
    error = next(each for each in report.errors if each.code == code)
    assert words in error.message and error.span is not None, [each.message for each in report.errors]
    assert error.help or code == "no-such-file"


def test_all_named_cameras_are_exported_with_their_motion(cache: Cache, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Gf, Usd, UsdGeom

    cameras, frames = SceneCameras(Gallery(cache)), cache.frames()
    files = [tmp_path / "shot.usda", tmp_path / "shot.glb"]
    for path, flags in zip(files, ([], ["--tolerance", "0%"]), strict=True):
        result = CliRunner().invoke(app, ["export", str(cache.folder), "--to", str(path), "-q", *flags])
        assert result.exit_code == 0, result.output
    stage = Usd.Stage.Open(str(files[0]))
    paths = {str(prim.GetPath()) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)}
    assert paths == {"/World/camera", "/World/wide", "/World/dolly", "/World/hero", "/World/side"}
    tree = Scene(files[1].read_bytes())
    names = [node["name"] for node in tree.tree["nodes"] if "camera" in node]
    assert sorted(names) == ["camera", "dolly", "hero", "side", "wide"] and len(tree.tree["cameras"]) == 5
    for name in ("shot", "wide", "dolly", "hero", "side"):
        written = "camera" if name == "shot" else name
        prim = UsdGeom.Camera(stage.GetPrimAtPath(f"/World/{written}"))
        node = next(k for k, each in enumerate(tree.tree["nodes"]) if each["name"] == written)
        for frame in frames:
            own = cameras.make_camera(frame, name)
            assert own is not None
            camera = prim.GetCamera(frame)
            eye = camera.transform.Transform(Gf.Vec3d(0, 0, 0))
            ahead = camera.transform.TransformDir(Gf.Vec3d(0, 0, -1))
            direction = np.subtract(own.look_at, own.at) / np.linalg.norm(np.subtract(own.look_at, own.at))
            assert np.allclose(eye, own.at, atol=1e-4) and np.allclose(ahead, direction, atol=1e-5), (name, frame)
            assert camera.focalLength == pytest.approx(own.focal * 10, rel=1e-5)  # tenths of the unit, mm
            world = tree.at((frame - frames[0]) / 24)[0][node]
            assert np.allclose(world[:3, 3] * 1000, own.at, atol=1e-3), (name, frame)
            assert np.allclose(-world[:3, 2] / np.linalg.norm(world[:3, 2]), direction, atol=1e-4), (name, frame)


def test_a_camera_that_follows_stays_above_the_ground(folder: Path) -> None:  # noqa: F811
    """The scene places the camera below the hill on which the agent walks."""
    low = NAMED.replace("by: [30, 20, 10]", "by: [30, -25, 10]")
    cache = record(folder, low)
    gallery = Gallery(cache)
    cameras, ground = SceneCameras(gallery), Ground(cache)
    eyes = []
    for frame in cache.frames():
        camera, terrain = cameras.make_camera(frame, "side"), ground.at(frame)
        assert camera is not None and terrain is not None
        eye, aim = (np.array([each], np.float64) for each in (camera.at, camera.look_at))
        assert terrain.measure_free_shares(aim, eye)[0] == 1, frame
        eyes.append(eye[0])
    assert np.linalg.norm(np.diff(eyes, axis=0), axis=1).max() < 4, "it does not jump"
