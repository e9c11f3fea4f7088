"""Bodies of a crowd, from files and from the library: what a run gets of them, and where they do not fit what states play."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from commands import run

from antdsl.bodies.agents.definition import Binding, Layer, map_language_names
from antdsl.bodies.crowd_bodies import build_clip_data, compute_collision_size
from antdsl.bodies.files import reading
from antdsl.bodies.files.reading import read_definition
from antdsl.bodies.files.writing import write_gltf
from antdsl.bodies.library import load_library_body
from antdsl.diagnostics import Report
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.gallery import Gallery
from antdsl.pipeline import Shot, check_path, check_scene_text, open_scene
from antdsl.runtime import bind, step

EXAMPLE = Path(__file__).parents[2] / "examples" / "walker"
PROGRAM = """ant 1
use steering
world { surface hill }
species walker {
  size 1.75 m
  max_speed 2 m/s
  start stroll
  state stroll { steer wander(); play walk; when clip at left -> stroll; when chance 5 %/s -> wave }
  state wave { steer halt(); play wave(on: arms); when clip done -> stroll }
  layers { state }
}
"""
CROWD = "  - {species: walker, from: walker.ant, count: 3, body: walker.json, place: {on: hill, radius: 5 m}}\n"


@pytest.fixture()
def folder(tmp_path: Path) -> Path:
    for name in ("hill.ply", "parts.glb", "walker.json"):
        shutil.copy(EXAMPLE / name, tmp_path / name)
    (tmp_path / "walker.fbx").write_bytes(b"Kaydara FBX Binary")
    return tmp_path


def written(folder: Path, program: str = PROGRAM, crowd: str = CROWD) -> Path:
    (folder / "walker.ant").write_text(program, encoding="utf-8")
    scene = folder / "scene.yaml"
    scene.write_text(f"antdsl: 1\nunits: m\nworld: {{hill: {{mesh: hill.ply}}}}\ncrowd:\n{crowd}", encoding="utf-8")
    return scene


def opened(scene: Path) -> Shot:
    shot, report = open_scene(scene)
    assert shot is not None, str(report)
    assert not [each for each in report.sort_by_place() if each.code != "odd-size"], str(report)
    return shot


def test_a_run_goes_by_the_clips_of_the_body(folder: Path) -> None:
    shot = opened(written(folder))
    clips = shot.setting.clips["walker"]
    assert sorted(clips) == ["idle", "run", "walk", "wave"]
    assert clips["walk"].seconds == pytest.approx(1.0) and clips["walk"].stride == pytest.approx(1.2 / 1.75)
    assert clips["wave"].loop is False and clips["wave"].marks["top"] == pytest.approx(1.0 / 2.2)
    assert shot.bodies["walker"].clips["walk"].loop and len(shot.inputs["walker.json"]) == 32
    world = bind(shot.plan, shot.setting)
    now = world.populations["walker"].now
    for _ in range(12):
        previous_turns = now["main.clip_turns"].copy()
        step(world)
        now = world.populations["walker"].now
    speed = sum(now[f"velocity.{axis}"].astype(float) ** 2 for axis in "xyz") ** 0.5  # mm/s
    walking = now["main.clip"] == 0
    assert walking.any()
    turn_differences = (now["main.clip_turns"] - previous_turns)[walking]
    assert turn_differences * 1200 * 24 == pytest.approx(
        speed[walking], rel=1e-2
    )  # 1.2 m of ground a turn; the speed is that of the step before


def test_a_gltf_file_in_the_folder_is_a_body(folder: Path) -> None:
    body, _ = read_definition(folder / "walker.json")
    assert body is not None
    (folder / "animals").mkdir()
    (folder / "animals" / "dancer.glb").write_bytes(write_gltf(body, body.layers["body"], text=False)[0])
    program = PROGRAM.replace("wave(on: arms)", "wave").replace("size 1.75 m", "size 0.3 m")
    scene = written(folder, program, CROWD.replace("walker.json", "animals/dancer.glb"))
    dancer = opened(scene).bodies["walker"]
    assert (dancer.name, sorted(dancer.clips), dancer.front) == ("dancer", sorted(body.clips), (0.0, 0.0, 1.0))
    result = run("run", "scene.yaml", "--frames", "1..2", "--out", "cache", cwd=folder)
    assert result.returncode == 0, result.stderr
    drawn = Gallery(open_cache(folder / "cache")).make_picture(2).crowds[0]
    assert drawn.body is not None and drawn.body.name == "dancer" and len(drawn.position) == 3


def test_a_body_takes_the_room_of_its_box(folder: Path) -> None:
    body, _ = read_definition(folder / "walker.json")
    assert body is not None
    extent = compute_collision_size(body)
    # some 0.5 m wide at the shoulders, and less deep; the middle below half its height
    assert extent.width == pytest.approx(0.5 / 1.75, abs=0.03) and extent.length == extent.width
    assert 0.4 < extent.height < 0.55 and abs(extent.forward_offset) < 0.05
    hat = replace(body.shapes["head"], points=body.shapes["head"].points * 20)
    hatted = replace(
        body, shapes={**body.shapes, "hat": hat}, layers={**body.layers, "hat": Layer("hat", (Binding("head", "hat"),))}
    )
    assert compute_collision_size(hatted) == extent, "what is worn takes no room"
    boxed = replace(hatted, layers={**hatted.layers, "collision": Layer("collision", (Binding("head", "hat"),))})
    assert compute_collision_size(boxed).width > 3 * extent.width, "a layer `collision` goes first"
    assert opened(written(folder)).setting.body_capsules == {"walker": extent}
    assert build_clip_data(body.clips["idle"], body).stride == 0


def test_another_file_is_another_input(folder: Path) -> None:
    scene = written(folder)
    first = opened(scene).inputs
    text = (folder / "walker.json").read_text(encoding="utf-8")
    (folder / "walker.json").write_text(text.replace('"stride":1.2', '"stride":1.3'), encoding="utf-8")
    changed = opened(scene)
    assert {name for name in first if first[name] != changed.inputs[name]} == {"walker.json"}
    assert changed.setting.clips["walker"]["walk"].stride == pytest.approx(1.3 / 1.75)


def test_a_library_name_is_a_body_with_clips_that_are_played(folder: Path) -> None:
    scene = written(folder, crowd=2 * CROWD.replace("walker.json", "ant"))
    (error,) = open_scene(scene)[1].errors
    assert (error.code, error.span.text if error.span else "") == ("unknown-name", "ant")
    assert error.message == "`ant` has no clip `wave`, no transform group `arms`" and "`antennate`, `carry`" in str(error.help)
    program = PROGRAM.replace("play wave(on: arms)", "play look(on: feelers)")
    shot = opened(written(folder, program, crowd=2 * CROWD.replace("walker.json", "ant")))
    assert not shot.bodies and not shot.setting.body_capsules and "ant" not in shot.inputs
    assert shot.setting.clips["walker"]["walk"].stride == load_library_body("ant").clips["walk"].stride


def test_without_a_body_it_is_the_one_that_suits_the_name(folder: Path) -> None:
    (error,) = open_scene(written(folder, crowd=2 * CROWD.replace(", body: walker.json", "")))[1].errors
    assert (error.span.text if error.span else "") == "walker" and "`ant` has no clip `wave`" in error.message
    assert error.help is not None and error.help.endswith(
        "`walker` has this body because of its name: write `body: …` in the crowd line to choose another one"
    )


def test_a_mark_is_one_of_the_clip_that_the_state_plays(folder: Path) -> None:
    crowd = 2 * CROWD.replace("walker.json", "ant")
    program = PROGRAM.replace("play wave(on: arms); when clip done", "play take; when clip at bite")
    opened(written(folder, program, crowd))
    (error,) = open_scene(written(folder, program.replace("play take", "play groom"), crowd))[1].errors
    assert error.message == "`ant` has no mark `bite` in clip `groom`" and error.labels[0].span.text == "clip at bite"
    assert error.help == "`groom` has no marks; `bite` is a mark of `dig`, `take`"


@pytest.mark.parametrize(
    ("wear", "help"),
    [
        ("load", "write `wear: [LAYER]`"),
        ("[{any: load}]", "write `{any: [LAYER, LAYER, none]}`"),
        ("[{any: []}]", "write `{any: [LAYER, LAYER, none]}`"),
    ],
)
def test_lists_of_what_is_worn_say_what_to_write(folder: Path, wear: str, help: str) -> None:
    crowd = CROWD.replace("body: walker.json", f"body: walker.json, wear: {wear}")
    (error,) = open_scene(written(folder, crowd=crowd))[1].errors
    assert (error.code, error.help) == ("wrong-value", help) and "tuple" not in error.message


def test_a_body_is_read_once_and_again_when_a_file_of_it_changes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.scene.paths import record_requested_paths

    times = []
    monkeypatch.setattr(reading, "read_definition", lambda *arguments: times.append(arguments) or read_definition(*arguments))
    scene = written(folder)
    first = opened(scene)
    with record_requested_paths() as files:
        assert opened(scene).bodies["walker"] is first.bodies["walker"] and len(times) == 1
    assert {folder / "walker.json", folder / "parts.glb"} <= set(files)  # a preview still looks at them
    (folder / "parts.glb").write_bytes((EXAMPLE / "parts.glb").read_bytes())
    assert opened(scene).bodies["walker"] is not first.bodies["walker"] and len(times) == 2
    (folder / "parts.glb").unlink()
    assert not open_scene(scene)[1].ok


def test_names_in_files_are_converted_to_names_of_the_language(folder: Path) -> None:
    text = (folder / "walker.json").read_text(encoding="utf-8")
    for old, new in (("walk", "Armature|Walk"), ("wave", "Wave 01"), ("arms", "Right.Arm"), ("left", "Left-foot")):
        text = text.replace(f'"{old}"', f'"{new}"')
    (folder / "walker.json").write_text(text, encoding="utf-8")
    program = PROGRAM.replace("play walk", "play armature_walk").replace("play wave(on: arms)", "play wave_01(on: right_arm)")
    shot = opened(written(folder, program.replace("clip at left", "clip at left_foot")))
    assert sorted(shot.bodies["walker"].clips) == ["armature_walk", "idle", "run", "wave_01"]
    assert shot.setting.clips["walker"]["armature_walk"].marks["left_foot"] == 0
    (error,) = open_scene(written(folder))[1].errors
    assert error.message == "`walker.json` has no clip `walk`, no clip `wave`, no transform group `arms`, no mark `left`"
    assert "clip `wave`: did you mean `wave_01`? its clips are `armature_walk`, `idle`, `run`, `wave_01`; " in str(error.help)
    assert "transform group `arms`: its transform groups are `right_arm`" in str(error.help)
    assert [label.text for label in error.labels] == ["played here", "played here", "named here", "requested here"]


def test_names_that_sound_alike_stay_apart() -> None:
    expected_names = {"Walk": "walk_2", "walk": "walk", "WALK": "walk_3", "01 run": "n01_run", "|": "n"}
    assert map_language_names(expected_names) == expected_names


def summarise_report(report: Report) -> list[tuple[str, str, str | None]]:
    return [(each.code, each.span.text if each.span else "", each.help) for each in report.sort_by_place()]


@pytest.mark.parametrize(
    "old, new, code, place, help",
    [
        ("play walk", "play wlak", "unknown-name", "walker.json", "did you mean `walk`?"),
        ("play walk", "play swim", "unknown-name", "walker.json", "its clips are `idle`, `run`, `walk`, `wave`"),
        ("on: arms", "on: wings", "unknown-name", "walker.json", "its transform groups are `arms`"),
        ("clip at left", "clip at lift", "unknown-name", "walker.json", "did you mean `left`?"),
        ("body: walker.json", "body: runner.json", "no-such-file", "runner.json", None),
        ("body: walker.json", "body: parson", "wrong-value", "parson", "did you mean `person`?"),
        ("body: walker.json", "body: walker.fbx", "wrong-kind", "walker.fbx", "for example with Blender, which reads this"),
        ("body: walker.json", "body: ../walker.json", "bad-path", "../walker.json", None),
        (CROWD, CROWD + CROWD.replace("walker.json", "person"), "wrong-value", "person", None),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_reported_at_its_place(
    folder: Path, old: str, new: str, code: str, place: str, help: str | None
) -> None:
    assert old in PROGRAM + CROWD
    scene = written(folder, PROGRAM.replace(old, new), CROWD.replace(old, new))
    for report in (open_scene(scene)[1], check_path(scene)[1]):
        (error,) = report.errors
        assert (error.code, error.span.text if error.span else "") == (code, place), str(report)
        assert error.fix is None or new.endswith("parson")  # the path of the body is not what to change
        if help is not None:
            assert error.help is not None and help in error.help
    if code == "unknown-name":
        assert new.partition(" ")[2].lstrip("at ") in error.labels[0].span.text and error.labels[0].span.source.path.endswith(
            ".ant"
        )


def test_mistakes_within_the_file_are_reported_at_their_place_in_it(folder: Path) -> None:
    text = (folder / "walker.json").read_text(encoding="utf-8")
    (folder / "walker.json").write_text(text.replace('"transform":"head"', '"transform":"haed"'), encoding="utf-8")
    _, report = open_scene(written(folder))
    (error,) = report.errors
    assert error.span is not None and error.span.source.path.endswith("walker.json") and error.help == 'write `"head"`'


def test_a_preview_takes_the_changed_body_over(folder: Path) -> None:
    from antdsl.preview.compiling import SceneCompiler

    scene = written(folder)
    compiling = SceneCompiler(scene)
    shot, report = compiling.open()
    assert shot is not None, str(report)
    assert {folder / "walker.json", folder / "parts.glb"} <= {Path(path) for path in compiling.get_watched_files()}
    world = bind(shot.plan, shot.setting)
    for _ in range(5):
        step(world)
    text = (folder / "walker.json").read_text(encoding="utf-8")
    (folder / "walker.json").write_text(text.replace('"stride":1.2', '"stride":2.4'), encoding="utf-8")
    again, _ = compiling.open()
    assert again is not None
    new_world, _, report = compiling.migrate_world(world, again)
    assert new_world is not None and report.ok
    assert new_world.setting.clips["walker"]["walk"].stride == pytest.approx(2.4 / 1.75)
    assert (new_world.populations["walker"].now["main.clip_turns"] == world.populations["walker"].now["main.clip_turns"]).all()


def test_an_editor_reports_what_the_body_does_not_have(folder: Path) -> None:
    scene = written(folder, PROGRAM.replace("play walk", "play wlak"))
    _, _, report = check_scene_text(scene, {scene: scene.read_bytes()})
    assert [each.message for each in report.errors] == ["`walker.json` has no clip `wlak`"]
    assert "did you mean `walk`?" in (report.errors[0].help or "") and report.errors[0].span is not None
    assert str(scene) == report.errors[0].span.source.path
    scene = written(folder)
    assert not check_scene_text(scene, {scene: scene.read_bytes()})[2].sort_by_place()


@pytest.mark.parametrize(
    "line",
    [
        "enter { woken = if clip at nowhere then 1 else 0 }",
        "steer if clip at nowhere then halt() else coast()",
        "let there = clip at nowhere; when there -> wave",
    ],
)
def test_marks_are_looked_up_in_the_body_wherever_a_program_uses_them(line: str, folder: Path) -> None:
    program = PROGRAM.replace("play walk;", f"play walk; {line};").replace("size 1.75 m", "size 1.75 m\n  woken = 0")
    program = program.replace("steer wander();", "") if line.startswith("steer") else program
    _, report = open_scene(written(folder, program))
    assert "`walker.json` has no mark `nowhere`" in [each.message for each in report.errors], str(report)
