"""Extreme numbers in every numeric field of a scene end in a located message, or in a run with a finite state."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import antdsl.scene.scene_model  # noqa: F401 - defines the parts
from antdsl.cli.commands.new import build_ground_ply
from antdsl.pipeline import open_scene
from antdsl.runtime import BindError, FaultStop, LimitStop, Options, bind, step
from antdsl.scene.load import load_scene
from antdsl.scene.quantities import Quantity
from antdsl.scene.values import ScenePart

EXTREMES = (
    "1e300", "-1e300", "1e-300", "-0.0", "5e-324", "2.2250738585072011e-308", "0.12345678901234567890", "1e38", "-3.5e38",
    "1e19", "1e12", "1e-12", "99999999999999999999999999", "0", "-1", "0.5", "1e5", "1e9",
)  # fmt: skip
PROGRAM = """ant 1
use steering
world { surface ground; surface hills; obstacle rock; curve line; items food { load = 3 }; flow drift; flow away; flow rim
  flow guide; flow brush; flow home; map paint; lamp bulb }
field trail on ground { half_life 3 s; diffuse 4 mm^2/s; cell 4 mm }
field way: push on ground { half_life 3 s; cell 9 mm }
species walker {
  param pace = 20 mm/s in 5 mm/s .. 50 mm/s
  size 4 mm
  load = 0
  max_speed pace
  state stroll { steer wander(swing: 60 deg) + along(drift) + along(away) + along(rim) + along(guide) + along(brush) + along(home)
    deposit trail 4 /s; deposit way heading * 1 /s }
  layers { separate(radius: 8 mm); state }
}
"""
SCENE = """antdsl: 1
units: mm
fps: 24
frames: 1..2
until: total(food.load) < 0.5
preroll: 0
substeps: 1
seed: 5
contacts: hard
world:
  ground: {mesh: ground.ply, at: [1, 2, 3], rotate: [4, 5, 6], scale: 1.5, keys: {1: {at: [7, 8, 9], rotate: [10, 11, 12]}}}
  hills: {height: hills.png, extent: [50 mm, 60 mm], scale: 5 mm, offset: 1 mm, at: [0, -90, 1], rotate: [1, 2, 3]}
  rock: {mesh: ball.ply, at: [10, 3, 10], rotate: [1, 2, 3], scale: 0.5, weld: 0.01 mm}
  line: {curve: line.json, at: [1, 2, 3]}
  food: {crumb: {at: [30, 0, 20], on: ground, radius: 3 mm, load: 7, keys: {1: {at: [5, 6, 7]}}}}
  drift: {tangent: line, strength: 0.5, radius: 40 mm, cell: 9 mm, gather: 2}
  bulb: {lamp: [1, 60, 2], radius: 5 mm, power: 150 %, colour: [1, 0.5, 0.2]}
  away: {away: [30, 0, 20], strength: 0.5, radius: 40 mm, cell: 9 mm}
  rim: {border: ground, within: 30 mm, strength: 0.5, cell: 9 mm}
  home: {toward: [30, 0, 20], strength: 0.5, radius: 40 mm, cell: 9 mm}
  guide: {solved: [30, 0, 20], slope: 2, room: 3 mm, maps: {paint: 2}, crowding: 3, every: 2 s, cell: 9 mm, strength: 0.5}
  brush: {painted: brush.npz, on: ground, strength: 0.5}
  paint: {painted: paint.npz, on: ground, strength: 0.5}
crowd:
  - {species: walker, from: walker.ant, count: 20, place: {on: ground, around: [1, 2, 3], radius: 60 mm, apart: 5 mm, seed: 9}}
  - {species: walker, from: walker.ant, count: 2, place: {on: ground, inside: [1, 9, 3]}}
  - species: walker
    from: walker.ant
    count: 3
    place: {on: ground, radius: 50 mm}
    walk: {direction: [1, 0, 2], speed: 10 mm/s, length: 20 mm}
  - name: rows
    species: walker
    from: walker.ant
    count: 4
    each: {size: {uniform: [3 mm, 5 mm]}, load: {painted: paint, from: 1, to: 2}}
    place: {ranks: {columns: 2, spacing: [7 mm, 9 mm]}, around: [10, 2, 30], facing: {direction: [1, 0, 2]}}
  - species: walker
    from: walker.ant
    rate: 40 /s
    frames: 1..2
    each: {size: {normal: [4 mm, 0.1 mm]}, load: {choice: {1: 2, 3: 1}}}
    place: {on: ground, clumps: {number: 2, radius: 20 mm}}
  - {species: walker, from: walker.ant, count: 2, place: {in: {from: [-20, 0, -20], to: [20, 5, 30]}}}
cameras:
  wide: {at: [0, 130, 190], look_at: [1, 2, 3], focal: 35 mm, f_stop: 8, focus: 20 mm}
  chase: {follow: rows.1, by: [10, 20, 30], smooth: 0.5 s}
notes:
  - {hold: rows.0, frames: 1..2, ease: 3, look_at: {head: [1, 2, 3]}, share: 50 %, seed: 3, stagger: {random: 2}}
  - {set: rows, to: {load: 3}, frames: 1..2, ease: 2}
  - {reach: rows.1, target: [9, 8, 7], frame: 2, ease: 4}
  - {path: rows.2, along: [[1, 2, 3], [4, 5, 6]], frames: 1..2, apart: 3 mm, stagger: {from: [1, 2, 3], speed: 3 mm/s}}
  - {release: rows, frame: 2, stagger: {each: 3}}
  - {slow: {share: 40 %}, in: {from: [1, 2, 3], to: [4, 5, 6]}, speed: 30 %, falloff: 6 mm, strength: 70 %}
  - {forbid: rows, in: {along: line, width: 8 mm}}
  - {attract: rows, to: [3, 2, 1], radius: 40 mm}
  - {repel: rows, from: [30, 2, 1], radius: 40 mm}
  - {lane: rows, along: [[1, 2, 3], [4, 5, 6]], width: 9 mm}
  - {confine: rows, in: {in_view: wide, across: [1 %, 33 %], up: [2 %, 50 %]}, falloff: 6 mm}
  - {part: rows, for: rock, distance: 9 mm}
  - {thin: rows, to: 90 %, near: [1, 2, 3], within: 500 mm, most: 40}
  - {thin: rows, to: 90 %, near: [1, 2, 3], farthest: 40}
set: {walker.pace: 30 mm/s}
fields:
  trail:
    - {start: 2, around: [1, 2, 3], radius: 30 mm}
    - {values: start.npz, layer: 1, scale: 2, offset: 1, extent: [70 mm, 80 mm], at: [1, 2, 3]}
  way: {start: [1, 2, 3]}
camera: {at: [0, 130, 190], look_at: [1, 2, 3], focal: 35 mm}
light: {sun: 50 %, sky: 60 %, haze: 70 %, lamps: 80 %, elevation: 30 deg, azimuth: 100 deg}
lod: {near: 100 mm, far: 200 mm}
output: {checkpoint: 50}
"""
# Read by the validators of MeshThing, CurveThing and ItemThing, from files that take seconds to read. Much of this scene cannot
# be in a world with `wrap`, so its numbers are in tests/periodic.
ELSEWHERE = {("UsdThing", name) for name in ("at", "rotate", "scale", "voxel", "weld")} | {
    ("Wrap", "x"), ("Wrap", "y"), ("Wrap", "z"),
    ("UsdEach", "radius"), ("MeshThing", "voxel"), ("StartFrom", "frame"), ("HeightThing", "layer"), ("CrowdLine", "body"),
}  # fmt: skip
NUMBER = re.compile(r"(?<![\w.#])-?\d+(?:\.\d+)?(?![\w.]*\.(?:ply|png|npz|json|ant))")


def number_spans() -> list[tuple[int, int]]:
    """Where numbers stand in the text of the scene."""
    return [match.span() for match in NUMBER.finditer(SCENE) if not SCENE[: match.start()].endswith("antdsl: ")]


NUMBER_SPANS = number_spans()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("numbers")
    (folder / "walker.ant").write_text(PROGRAM)
    (folder / "ground.ply").write_bytes(build_ground_ply(side=9))
    (folder / "ball.ply").write_bytes(build_ground_ply(side=3, width=20))
    (folder / "line.json").write_text("[[-40, 0, 0], [0, 1, 5], [40, 0, 0]]")
    Image.fromarray(np.arange(64, dtype=np.uint16).reshape(8, 8) * 500).save(folder / "hills.png")
    np.savez(folder / "brush.npz", brush=np.ones((81, 3), np.float32))
    np.savez(folder / "paint.npz", paint=np.ones(81, np.float32))
    np.savez(folder / "start.npz", np.ones((2, 3, 4)))
    return folder


def demand_message_or_run(folder: Path, place: tuple[int, int], extreme: str) -> None:
    text = SCENE[: place[0]] + extreme + SCENE[place[1] :]
    scene = folder / "scene.yaml"
    scene.write_text(text)
    shot, report = open_scene(scene)
    if not report.ok:
        assert all(each.span is not None for each in report.errors), report.errors
        return
    assert shot is not None
    try:
        world = bind(shot.plan, shot.setting, Options(backend="numpy"))
        step(world)
    except BindError as why:
        assert why.report.errors and all(each.span is not None for each in why.report.errors)
    except (FaultStop, LimitStop) as why:
        raise AssertionError(f"{extreme} is accepted and stops the run: {why}") from None


def line_of(place: tuple[int, int]) -> str:
    number = SCENE[: place[0]].count("\n")
    return f"{number + 1}:{place[0] - SCENE.rfind(chr(10), 0, place[0])}"


@pytest.mark.parametrize("number", range(3))
def test_extreme_numbers_in_some_fields(folder: Path, number: int) -> None:
    for index in range(number * 7, len(NUMBER_SPANS), 21):
        demand_message_or_run(folder, NUMBER_SPANS[index], EXTREMES[(index * 5 + number) % len(EXTREMES)])


@pytest.mark.slow
@pytest.mark.parametrize("place", NUMBER_SPANS, ids=line_of)
def test_extreme_numbers_in_every_field(folder: Path, place: tuple[int, int]) -> None:
    for extreme in EXTREMES:
        demand_message_or_run(folder, place, extreme)


def test_the_scene_has_every_numeric_field(folder: Path) -> None:
    scene = folder / "all.yaml"
    scene.write_text(SCENE)
    loaded, report = load_scene(scene)
    assert loaded is not None and report.ok, report.errors
    used = {
        (type(part).__name__, name) for part in parts(loaded.model) for name in numeric(part) if getattr(part, name) is not None
    }
    known = {
        (kind.__name__, name)
        for kind in kinds(ScenePart)
        for name, field_info in kind.model_fields.items()
        if is_numeric(field_info)
    }
    inherited = {name for _, name in used}
    missing = {(kind, name) for kind, name in known - used - ELSEWHERE if name not in inherited}
    assert not missing


def kinds(kind: type[ScenePart]) -> Iterator[type[ScenePart]]:
    for each in kind.__subclasses__():
        if each.__module__.startswith("antdsl.scene"):  # the rest are edits of caches
            yield each
        yield from kinds(each)


def is_numeric(field_info: Any) -> bool:
    return bool(re.search(r"\bint\b|\bfloat\b|Quantity|Fraction", repr(field_info.annotation) + repr(field_info.metadata)))


def numeric(part: ScenePart) -> list[str]:
    return [
        name for name, field_info in type(part).model_fields.items() if is_numeric(field_info) and name in part.model_fields_set
    ]


def parts(value: Any) -> Iterator[ScenePart]:
    """All parts of a model, those in it too."""
    if isinstance(value, ScenePart):
        yield value
        for name in type(value).model_fields:
            yield from parts(getattr(value, name))
    elif isinstance(value, dict):
        for each in value.values():
            yield from parts(each)
    elif isinstance(value, tuple) and not isinstance(value, Quantity):
        for each in value:
            yield from parts(each)
