"""What is said of calls and missing spaces in notes: `{hold: all(ant, within: 50 mm)}`, `{hold:ant}`."""

from __future__ import annotations

from pathlib import Path

import pytest
from directed import open_directed

from antdsl.pipeline import open_scene
from antdsl.scene.notes.notes_model import NOTE_MODELS

MISTAKES = {  # mistakes in a line, and what to write instead
    "{VERB: all(ant, within: 9 mm), frames: 1..2}": "`{of: ant, near: [0, 0, 0], within: 9 mm}`",
    "{VERB: {of: all(ant, most: 2)}}": "write a mapping: `{of: ant, near: [0, 0, 0], most: 2}`",
    "VERB: all(ant, within: 9 mm)": "`{of: ant, near: [0, 0, 0], within: 9 mm}`",
    "{VERB: 'nearest(ant, within: 9 mm)'}": "`{of: ant, near: [0, 0, 0], within: 9 mm, most: 1}`",
    "{VERB: \"'ant'\"}": "`guards.17`",
    "{VERB:ant, frames: 1..2}": "write `VERB: ant`",
    "{VERB: ant, frames:1..2}": "write `frames: 1..2`",
    "{VERB ant}": "write `VERB: ant`",
    "VERB:ant": "write `VERB: ant`",
    "{VERB: ant.1, ant.2}": "`VERB: [ant.1, ant.2]`",
    "{VERB: ant[2]}": "write `ant.2`",
}


@pytest.mark.parametrize("form", sorted(MISTAKES))
def test_calls_and_missing_spaces_are_reported_for_each_verb(tmp_path: Path, form: str) -> None:
    open_directed(tmp_path)
    scene = tmp_path / "scene.yaml"
    text = scene.read_text()
    for verb in NOTE_MODELS:
        scene.write_text(f"{text}notes:\n  - {form.replace('VERB', verb)}\n")
        shot, report = open_scene(scene)
        first = report.errors[0]
        assert shot is None and first.span is not None and first.span.start > len(text)
        assert MISTAKES[form].replace("VERB", verb) in " ".join(each.help or "" for each in report.errors), (verb, report.errors)


@pytest.mark.parametrize(
    ("note", "help"),
    [
        ("{slow: ant, in: {around:leaf, radius: 5 mm}}", "write `around: leaf`"),
        ("{slow: ant, in: {radius: 5 mm}}", "add `around: …`"),
        ("{slow: ant, in: {from: [0, 0, 0]}}", "add `to: "),
        ("{slow: ant, in: {around: leaf, radiu: 5 mm}}", "did you mean `radius`"),
        ("{hold: ant, frames: 1..2, stagger: {eac: 2}}", "did you mean `each`"),
        ("{hold: ant, frames: 1..2, stagger: {later: 2}}", "known here: `each`, `ends`, `from`"),
        ("{attract: ant, to: nearest(leaf)}", "a name, such as `leaf`"),
        ("{attract: ant, to: {of: ant}}", "a name, such as `leaf`"),
        ("{path: ant, along: [0, 0, 0], frames: 1..9}", "points: `[[0, 0, 0], [50, 0, 0]]`"),
        ("{look: ant, at: {head:leaf}}", "write `head: leaf`"),
        ("{look: ant, at: leaf}", "write `{head: leaf}`"),
        ("{thin: ant, to: 200 %}", "a larger `count` in the crowd"),
        ("{hold: {of: guards, in: {around: guards.7, radius: 50 mm}}}", "write `near: guards.7, within: 50 mm` instead of `in`"),
        ("{hold: guards, in: {around: front, radius: 50 mm}}", "write `near: front, within: 50 mm` instead of `in`"),
        ("{reach: guards.1..2, target: [guards.2, guards.1], frame: 9}", "write a line for each"),
        ("[hold, ant]", "write `{hold: guards, frames: 10..20}`"),
    ],
)
def test_mistakes_within_values_are_reported_with_the_form(tmp_path: Path, note: str, help: str) -> None:
    open_directed(tmp_path)
    scene = tmp_path / "scene.yaml"
    scene.write_text(f"{scene.read_text()}notes:\n  - {note}\n")
    shot, report = open_scene(scene)
    assert shot is None and help in (report.errors[0].help or ""), (report.errors[0].message, report.errors[0].help)
