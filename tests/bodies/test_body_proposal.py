"""Proposals for bodies: what they guess is what the library's bodies are known to be, after glTF has lost it."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from commands import run
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.other_axes import convert_definition_axes
from antdsl.bodies.files.reading import read_definition
from antdsl.bodies.files.writing import write_gltf
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import find_base_layer
from antdsl.bodies.proposing.proposal import propose_definition

HILL = Path(__file__).parents[2] / "examples" / "walker" / "hill.ply"


def write_bare(word: str, folder: Path) -> Path:
    """A body of the library as a glTF file without the extras of antdsl, as other programs write it."""
    body = load_library_body(word)
    tree = json.loads(write_gltf(body, find_base_layer(body), text=True)[0])
    del tree["extras"]
    for animation in tree.get("animations", ()):
        del animation["extras"]
    path = folder / f"{word}.gltf"
    path.write_text(json.dumps(tree), encoding="utf-8")
    return path


def read_bare(word: str, folder: Path) -> Definition:
    definition, report = read_definition(write_bare(word, folder), rate=120.0)
    assert definition is not None and not report.sort_by_place() and not definition.legs
    return definition


@pytest.mark.parametrize("word", ["person", "hunter", "ant", "spider"])
def test_legs_and_walks_are_those_that_the_body_has(word: str, tmp_path: Path) -> None:
    body, lines = load_library_body(word), propose_definition(read_bare(word, tmp_path), "x.gltf").entries
    assert (lines["front"], lines["up"], lines["units"], lines["idle"]) == ("+z", "+y", "m", "idle")
    assert [(leg["upper"], leg["lower"]) for leg in lines["legs"]] == [(leg.upper, leg.lower) for leg in body.legs]
    strides = {clip["clip"]: clip.get("stride", 0.0) for clip in lines["clips"]}
    metres = body.unit / 1000
    assert strides["walk"] == pytest.approx(body.clips["walk"].stride * metres, rel=0.03)
    assert strides["run"] == pytest.approx(body.clips["run"].stride * metres, rel=0.15)
    assert strides["idle"] == strides["die"] == 0
    walk = next(gait for gait in lines["gaits"] if gait["name"] == "walk")
    speed = body.clips["walk"].stride * metres / body.clips["walk"].duration
    known = min(body.gaits, key=lambda gait: abs(gait.speed * metres - speed))
    assert walk["speed"] == pytest.approx(speed, rel=0.03) and walk["duty"] == pytest.approx(known.duty, abs=0.1)
    assert walk["lift"] == pytest.approx(known.lift * metres, rel=0.25)
    for mine, other in zip(walk["phases"], known.phases, strict=True):
        off = (mine - (other - known.phases[0])) % 1.0
        assert min(off, 1.0 - off) < 0.1


@pytest.mark.parametrize(
    ("word", "ankles"),
    [
        ("person", [("foot_l", "ball_l"), ("foot_r", "ball_r")]),
        ("hunter", [(f"wrist_{side}{pair}",) * 2 for pair in (1, 2) for side in "lr"]),
        ("ant", [(None, f"tarsus_{side}{pair}") for pair in (1, 2, 3) for side in "lr"]),
    ],
)
def test_feet_with_soles_get_ankles(word: str, ankles: list[tuple[str | None, str]], tmp_path: Path) -> None:
    """Claws of an ant hold at any angle, so its legs have none."""
    legs = propose_definition(read_bare(word, tmp_path), "x.gltf").entries["legs"]
    assert [(leg.get("ankle"), leg["foot"]) for leg in legs] == ankles


def test_feet_that_end_in_points_get_no_ankles(tmp_path: Path) -> None:
    """A foot of one joint is its own ankle, as that of the hunter above, but not where it touches the ground at one point."""
    body = read_bare("hunter", tmp_path)
    shapes = {name: replace(shape, points=_point_feet(shape.points)) for name, shape in body.shapes.items()}
    legs = propose_definition(replace(body, shapes=shapes), "x.gltf").entries["legs"]
    assert [(leg.get("ankle"), leg["foot"][:-2]) for leg in legs] == [(None, "wrist_")] * 4


def _point_feet(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Contract the points near the ground level, in each quarter around the body."""
    points, low = points.copy(), points[:, 1] < points[:, 1].min() + 0.06
    for x, z in product((False, True), repeat=2):
        own = low & ((points[:, 0] > 0) == x) & ((points[:, 2] > 0) == z)
        points[own, ::2] = points[own, ::2].mean(axis=0) + 0.02 * (points[own, ::2] - points[own, ::2].mean(axis=0))
    return points


def test_names_of_clips_are_those_that_say_something(tmp_path: Path) -> None:
    body = read_bare("person", tmp_path)
    renamed = {"walk": "Armature|Walk_01", "run": "clip0", "idle": "Breathing", "wave": "Armature|Wave", "die": "die"}
    clips = {renamed[name]: replace(clip, name=renamed[name]) for name, clip in body.clips.items() if name in renamed}
    lines = propose_definition(replace(body, clips=clips), "x.gltf").entries
    names = {clip["clip"]: clip["name"] for clip in lines["clips"]}
    assert names == {"Armature|Walk_01": "walk", "clip0": "walk_2", "Breathing": "idle", "Armature|Wave": "wave", "die": "die"}


def test_another_up_axis_and_unit_are_found(tmp_path: Path) -> None:
    body = convert_definition_axes(read_bare("person", tmp_path), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), 10.0)
    proposal = propose_definition(replace(body, up=(0.0, 1.0, 0.0), unit=1000.0), "x.gltf")
    assert (proposal.entries["front"], proposal.entries["up"], proposal.entries["units"]) == ("+x", "+z", "cm")
    assert any("no legs reach the ground" in reason for reason in proposal.reasons["up"])
    assert any("would be" in reason for reason in proposal.reasons["units"])


def test_a_body_without_walking_clips_gets_a_usual_walk(tmp_path: Path) -> None:
    body = read_bare("hunter", tmp_path)
    lines = propose_definition(replace(body, clips={"idle": body.clips["idle"]}), "x.gltf").entries
    (gait,) = lines["gaits"]
    assert sorted(gait["phases"]) == [0.0, 0.25, 0.5, 0.75] and gait["speed"] > 0
    without = propose_definition(replace(body, clips={}), "x.gltf")
    assert "idle" not in without.entries and "clips" not in without.entries and len(without.entries["legs"]) == 4


def test_a_body_without_legs_says_why(tmp_path: Path) -> None:
    proposal = propose_definition(read_bare("ball", tmp_path), "x.gltf")
    assert "legs" not in proposal.entries and "gaits" not in proposal.entries
    assert "no legs" in proposal.format_text()


def test_a_proposal_is_written_read_and_walks(tmp_path: Path) -> None:
    write_bare("hunter", tmp_path)
    shutil.copy(HILL, tmp_path / "hill.ply")
    assert run("body", "hunter.gltf", "--propose", "--to", "fox.json", cwd=tmp_path).returncode == 0
    definition, report = read_definition(tmp_path / "fox.json")
    assert definition is not None and not report.sort_by_place(), str(report)
    assert len(definition.legs) == 4 and definition.capsule is not None and definition.idle == "idle"
    (tmp_path / "fox.ant").write_text(
        "ant 1\nuse steering\nworld { surface hill }\nspecies fox {\n  size 0.9 m\n  max_speed 0.6 m/s\n  start go\n"
        "  state go { steer wander(); play walk }\n  layers { state }\n}\n"
    )
    (tmp_path / "scene.yaml").write_text(
        "antdsl: 1\nunits: m\nframes: 1..4\nworld: {hill: {mesh: hill.ply}}\n"
        "crowd: [{species: fox, from: fox.ant, count: 3, body: fox.json, place: {on: hill, radius: 4 m}}]\n"
    )
    result = run("run", "scene.yaml", "--out", "cache", "--quiet", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    printed = run("body", "hunter.gltf", "--propose", cwd=tmp_path)
    assert printed.stdout == (tmp_path / "fox.json").read_text("utf-8")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("own.json", "--propose"), "not a glTF or USD file"),
        (("hunter.gltf", "--propose", "--to", "other/fox.json"), "not in the folder"),
        (("hunter.gltf", "--propose", "--to", "fox.glb"), "must end in .json"),
    ],
)
def test_a_proposal_that_cannot_be_written_says_why(words: tuple[str, ...], says: str, tmp_path: Path) -> None:
    write_bare("hunter", tmp_path)
    (tmp_path / "own.json").write_text('{"antdsl_body": 1, "from": "hunter.gltf"}')
    result = run("body", *words, cwd=tmp_path)
    assert result.returncode == 2 and says in " ".join(result.stderr.split()).replace("│ ", "")
