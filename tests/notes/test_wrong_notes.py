"""What is said of wrong notes: the place in the text, what is wrong, and what to write instead."""

from __future__ import annotations

import cProfile
import pstats
from pathlib import Path

import pytest
from directed import PROGRAM, open_directed, start

from antdsl.pipeline import RunChoices, check_path, open_scene
from antdsl.runtime import step

WRONG = [
    ("{hald: ant}", "wrong-value", "`hald` is not a verb of notes", "did you mean `hold`?", "{hald: ant}"),
    ("{frames: 1..2, hold: ant}",
     "wrong-value", "`frames` comes before the verb of this note", "write `{hold: ant, frames: …}`", None),
    ("{hold: gards.17}", "unknown-thing", "no crowd line or species is named `gards`", "did you mean `guards`?", "gards.17"),
    ("{hold: guards.99}",
     "unknown-thing", "`guards.99` does not exist: `guards` has 60 agents", "write a number from 0 to 59", "guards.99"),
    ("{hold: guards, frame: 3}", "unknown-key", "`frame` is not a key of `hold`", "did you mean `frames`?", "frame"),
    ("{hold: guards, look_at: {head: leef}}", "unknown-thing", "named `leef`", "did you mean `leaf`?", "leef"),
    ("{reach: guards.1, target: leaf}", "missing-key", "has no `frame`", "add `frame: …`", None),
    ("{reach: guards.1, target: [0, 0], frame: 9}",
     "wrong-value", "this list has too few values", "a point is `[x, y, z]`", None),
    ("{path: guards.1, along: wey, frames: 1..9}", "unknown-thing", "no program has a curve `wey`", "did you mean `way`?", "wey"),
    ("{set: guards, to: {moood: 1}}", "unknown-thing", "`ant` has no attribute `moood`", "did you mean `mood`?", "moood"),
    ("{set: guards, to: {max_speed: 5}}", "missing-unit", "`max_speed` is a speed, and `5` has no unit", "write `5 mm/s`", "5"),
    ("{set: guards, to: {brave: 3}}",
     "wrong-value", "`brave` is true or false, so it cannot be `3`", "write `true` or `false`", "3"),
    ("{change: guards, to: wolk, frame: 3}", "unknown-thing", "no species has a state `wolk`", "did you mean `walk`?", "wolk"),
    ("{retime: ant, speed: 150 %}",
     "wrong-value", "faster than these agents can move", "{set: …, to: {max_speed: 60 mm/s}}", "150 %"),
    ("{set: guards, to: {size: 0 mm}}", "out-of-range", "`size` cannot be `0 mm`", "write more than 0", "0 mm"),
    ("{set: guards, to: {max_speed: -3 mm/s}}", "out-of-range", "cannot be `-3 mm/s`", "write more than 0", "-3 mm/s"),
    ("{hold: guards, near: frint, within: 3 mm}",
     "unknown-thing", "no crowd line, species, item or camera is named `frint`", "did you mean `front`?", "frint"),
    ("{part: ant, for: food, distance: 4 mm}",
     "unknown-thing", "no mesh, item, camera, crowd line or species is named `food`", "did you mean `foot`?", "food"),
    ("{slow: ant, in: {around: stome, radius: 4 mm}}",
     "unknown-thing", "no mesh, item, camera, crowd line or species is named `stome`", "did you mean `stone`?", "stome"),
    ("{forbid: ant, in: {around: {of: gards}, radius: 4 mm}}",
     "unknown-thing", "no crowd line or species is named `gards`", "did you mean `guards`?", "gards"),
    ("{look: ant, at: {head: frint}}",
     "unknown-thing", "no crowd line, species, item, camera or mesh is named `frint`", "did you mean `front`?", "frint"),
    ("{reach: guards.1, target: foot, frame: 9}",
     "unknown-thing", "no crowd line, species, item or camera is named `foot`", None, "foot"),
    ("{kill: ant, frame: 60}", "wrong-value", "`kill` is not a verb of notes", "are those of `antdsl edit`", None),
    ("{hold: ant, near: leaf}", "wrong-value", "`near` has no effect without `within` or `most`", "or `most: 3`", None),
    ("{hold: ant, most: 3}", "wrong-value", "`most` has no effect without `near`", "add `near:", None),
    ("{forbid: ant, in: foot}", "wrong-value", "`foot` is not a region", "write `{around: foot, radius: 50 mm}`", "foot"),
    ("{hold: ant, in: leaf}", "wrong-value", "`leaf` is not a region", "write `{around: leaf, radius: 50 mm}`", "leaf"),
    ("{slow: ant, painted: mad}", "unknown-thing", "no program has a map `mad`", "did you mean `mud`?", "mad"),
    ("{slow: ant, falloff: 4 mm}", "wrong-value", "`falloff` has no effect without `in`", "add `in:", None),
    ("{without: ant, across: [0 %, 33 %]}", "wrong-value", "`across` has no effect without `in_view`", "in_view: shot", None),
    ("{without: ant, in: {in_view: frint}}", "unknown-thing", "no camera is named `frint`", "did you mean `front`?", "frint"),
    ("{reach: guards.1, frame: 9}", "wrong-value", "`reach` needs either `target` or `along`", "add `target:", None),
    ("{reach: guards.1, along: wey, frame: 9}", "unknown-thing", "no program has a curve `wey`", "did you mean `way`?", "wey"),
    ("{forbid: ant}", "missing-key", "has no `in`", "add `in: …`", None),
    ("{look: ant, at: {}}", "wrong-value", "this list has too few values", None, None),
    ("{play: ant, clip: fly}", "unknown-name", "`ant` has no clip `fly`", None, None),
    ("{hold: ant, frames: 9..20, stagger: 40 mm/s}",
     "wrong-value", "`40 mm/s` does not define a delay for each agent", "`{from: [0, 0, 0], speed: 40 mm/s}`", "40 mm/s"),
    ("{hold: ant, frames: 9..20, stagger: {from: leaf}}",
     "wrong-value", "this does not define a delay", "`{each: 2}`", "{from: leaf}"),
    ("{hold: ant, frames: 9..20, stagger: {speed: 40 mm/s}}",
     "wrong-value", "`speed` has no effect without `from`", "write `{from: [0, 0, 0], speed: 40 mm/s}`", None),
    ("{hold: ant, frames: 9..20, stagger: {each: 2, random: 4}}",
     "wrong-value", "`each` and `random` exclude each other", None, None),
    ("{hold: ant, frames: 9..20, stagger: {from: leef, speed: 40 mm/s}}",
     "unknown-thing", "no crowd line, species, item, camera or mesh is named `leef`", "did you mean `leaf`?", "leef"),
    ("{hold: ant, stagger: {each: 2}}",
     "wrong-value", "`stagger` has no effect without `frames`", "add `frames: 100..150`", None),
    ("{confine: ant, in: {in_view: front, across: 33 %}}",
     "wrong-value", "`33 %` is not a part of a picture", "write `[0 %, 33 %]`", "33 %"),
    ("{confine: ant, in: {in_view: front, across: [50 %, 33 %]}}",
     "wrong-value", "this part of the picture is empty", "`[33 %, 50 %]`", "[50 %, 33 %]"),
    ("{forbid: ant, in: {along: [front, guards.99], width: 3 mm}}",
     "unknown-thing", "`guards.99` does not exist", "write a number from 0 to 59", "guards.99"),
    ("{hold: ant, near: leaf, most: 3, farthest: 2}", "wrong-value", "`most` and `farthest` exclude each other", None, None),
    ("{lane: ant, along: [[0, 0, 0]], width: 4 mm}", "wrong-value", "this list has too few values", None, None),
]  # fmt: skip


@pytest.mark.parametrize(("note", "code", "message", "help", "place"), WRONG)
def test_wrong_notes(tmp_path: Path, note: str, code: str, message: str, help: str | None, place: str | None) -> None:
    open_directed(tmp_path)
    scene = tmp_path / "scene.yaml"
    scene.write_text(scene.read_text() + f"notes:\n  - {note}\n")
    shot, report = open_scene(scene)
    assert shot is None
    first = report.errors[0]
    assert first.code == code and message in first.message, first.message
    assert help is None or help in (first.help or ""), first.help
    assert first.span is not None and (place is None or first.span.text.strip() == place), first.span.text


def test_machines_of_notes_have_reserved_names(tmp_path: Path) -> None:
    program = PROGRAM.replace("  start walk", "  machine notes_play { start on; state on { play walk } }\n  start walk")
    open_directed(tmp_path, program=program)
    scene = tmp_path / "scene.yaml"
    scene.write_text(scene.read_text() + "notes:\n  - {play: ant, clip: run}\n")
    _, report = open_scene(scene)
    assert [each.code for each in report.errors] == ["reserved-name"] and "notes_play" in report.errors[0].message


def test_check_warns_of_targets_that_are_too_far(tmp_path: Path) -> None:
    open_directed(tmp_path, "{path: guards.0, along: [[0, 0, 0], [100, 0, 0]], frames: 200..210}", last=210)
    _, report = check_path(tmp_path / "scene.yaml", RunChoices())
    (warning,) = [each for each in report.diagnostics if each.code == "far-target"]
    assert "cannot walk along the path in time: it walks at most 12 mm in 0.417 s" in warning.message
    assert warning.span is not None and warning.span.text.startswith("{path: guards.0")


def test_a_scene_without_notes_pays_nothing(tmp_path: Path) -> None:
    shot = open_directed(tmp_path)
    assert shot.setting.notes == () and shot.program.species["ant"].machines[0].states[0].transitions[0].key.endswith("rest#1")
    world = start(shot)
    assert world.notes is None
    profile = cProfile.Profile()
    profile.enable()
    for _ in range(5):
        step(world)
    profile.disable()
    files = [file for file, _, _ in pstats.Stats(profile).stats]  # type: ignore[attr-defined]
    assert len(files) > 200 and not [file for file in files if "notes" in Path(file).parts]


FOLLOWING = "cameras: {chase: {follow: guards.7, by: [0, 20 mm, 40 mm]}, wide: fit, front: "


@pytest.mark.parametrize(
    ("note", "place", "help"),
    [
        ("{look: guards, at: {head: chase}, frames: 10..20}", "follows `guards.7`", "or the agent, `guards.7`"),
        ("{hold: ant, near: chase, within: 30 mm}", "follows `guards.7`", "or the agent, `guards.7`"),
        ("{forbid: ant, in: {in_view: chase}}", "follows `guards.7`", "with `at` and `look_at`"),
        ("{thin: ant, in_view: wide, to: 50 %}", "holds the agents of the drawn frames", "with `at` and `look_at`"),
        ("{forbid: ant, in: {around: chase, radius: 20 mm}}", "follows `guards.7`", "or the agent, `guards.7`"),
    ],
)
def test_cameras_that_are_placed_after_the_run_are_reported_with_what_to_write(
    tmp_path: Path, note: str, place: str, help: str
) -> None:
    open_directed(tmp_path)
    scene = tmp_path / "scene.yaml"
    scene.write_text(scene.read_text().replace("cameras: {front: ", FOLLOWING) + f"notes: [{note}]\n")
    shot, report = open_scene(scene)
    [error] = report.errors
    assert shot is None and error.code == "unknown-thing" and error.span is not None
    assert place in error.message and "known only when pictures are drawn" in error.message
    assert help in (error.help or "") and error.span.text in ("chase", "wide")
