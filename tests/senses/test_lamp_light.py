"""The sense `light` against the light of pictures, behind walls, with moving and used-up lamps, and where there is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from meaning import OPTION_SETS, RunHistory, crowd, item, play
from meshes import box, grid

from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures import Camera, Item, Picture, Renderer, Solid
from antdsl.outputs.pictures.camera import make_view
from antdsl.outputs.pictures.lamps import LAMP_COLOUR, find_lamps
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import check_path, open_scene
from antdsl.runtime import ItemData, MeshData, Options
from antdsl.scene.light_model import LightSettings
from antdsl.scene.setting import GeometryMotion

WORLD = "ant 1\nworld { obstacle wall; items glows { oil = 1 } }\n"
TEXT = "species a {\n  lit = 0\n  start see\n  state see { lit = light(glows) }\n}\n"
OPTIONS = (*OPTION_SETS, Options(), Options(chunk=5, threads=2, shuffle_rows=4))
WALL = box((15, 0, -30), (16, 20, 30))
POINTS = [(-20.0, 5.0), (-8.0, 12.0), (-3.0, -9.0), (0.0, 7.0), (4.0, 0.0), (9.0, -14.0), (12.0, 3.0), (27.5, 0.0), (20.0, -4.0),
          (22.0, 6.0), (25.0, 20.0), (30.0, -35.0), (-35.0, -2.0), (-28.0, 24.0), (2.0, 31.0), (6.0, -26.0), (40.0, 0.0),
          (-14.0, -31.0), (33.0, 12.0), (14.0, 38.0)]  # fmt: skip
STRENGTH = 5.0
BULB: ItemData = replace(item("one", 0, 0, 2.0), position=(0.0, 30.0, 0.0), look="light")


def run(
    *lamps: ItemData,
    at: list[tuple[float, float]] = POINTS,
    steps: int = 1,
    name: str = "glows",
    text: str = TEXT,
    **setting: Any,
) -> RunHistory:
    """Run agents at points, with lamps of a name and a wall."""
    world, text = (each.replace("glows", name) for each in (WORLD, text))
    things = {"items": {name: lamps}, "obstacles": {"wall": MeshData(*WALL)}}
    return play(text, crowd(at=at), world=world, steps=steps, option_sets=OPTIONS, **things, **setting)


def measure_pixels(points: list[tuple[float, float]], shape: str) -> np.ndarray:
    """Return the light of a picture at points of a grey floor, relative to LAMP_COLOUR."""
    light = LightSettings(sun=0.0, sky=0.0, haze=0.0, lamps=STRENGTH)
    floor = Solid("floor", *grid(200.0, 20), "table", np.array([0.5] * 3))
    bulb = Item("one", (0.0, 30.0, 0.0), 2.0, 1.0, shape, "light")
    above, (width, height) = Camera((0.0, 160.0, 0.01), (0.0, 0.0, 0.0), focal=30.0), (640, 360)
    picture = Picture((floor, Solid("wall", *WALL, "stone")), items=(bulb,), light=light)
    image = Renderer(width, height).compute_light(picture, above)
    points_on_floor = np.array([(x, 0.0, z) for x, z in points])
    column, row = make_view(above, width, height, (0.0, 1.0, 0.0)).project(points_on_floor)[0].astype(int).T
    return np.asarray(image[row, column] / LAMP_COLOUR).mean(axis=1)


@pytest.mark.parametrize("name, shape", [("glows", "sphere"), ("lamps", "lamp")])
def test_it_is_the_light_of_pixels(name: str, shape: str) -> None:
    lit, pixels = np.array(run(BULB, name=name, lamp_strength=STRENGTH)["lit"]), measure_pixels(POINTS, shape)
    dark = lit == 0
    assert 3 <= dark.sum() <= 8 and pixels[dark].max() < 1e-3
    ratio = pixels[~dark] / lit[~dark]
    assert np.allclose(ratio / np.median(ratio), 1, atol=0.01)


def test_it_follows_lamps_that_move_and_shrink() -> None:
    tracks = np.array([[[0.0, 30.0, 0.0]], [[0.0, 15.0, 0.0]], [[0.0, 15.0, 0.0]], [[0.0, 15.0, 0.0]]])
    burn = TEXT.replace("lit = 0", "lit = 0\n  oil = 0").replace(
        "}\n}", "; when age > 0.25 s take 7 oil from nearest(glows) -> see }\n}"
    )
    move = GeometryMotion(items={"glows": tracks})
    history = run(replace(BULB, attributes={"oil": 8.0}), at=[(0.0, 0.0)], steps=6, motion=move, text=burn)
    lit = [history.at("lit", frame)[0] for frame in range(1, 7)]
    assert history.amounts("glows", "oil") == [1.0]
    for frame, light in enumerate(lit):
        # The lamp sinks after the first step. An eighth of the oil gives half the radius.
        radius = 2.0 if light > 0.35 else 1.0
        up = (30.0 if frame < 1 else 15.0) + 0.85 * radius
        x, z = (history.at(f"position.{axis}", frame)[0] for axis in "xz")
        assert np.isclose(light, (10 * radius) ** 2 * up / (x * x + z * z + up * up) ** 1.5, rtol=1e-5), frame
    assert sum(light > 0.35 for light in lit) == 4


def test_without_lamps_it_is_dark() -> None:
    for lamps in ((), (replace(BULB, look=None),), (replace(BULB, look="metal"),)):
        assert run(*lamps)["lit"] == [0.0] * len(POINTS)
    assert run(BULB, lamp_strength=0.0)["lit"] == [0.0] * len(POINTS)
    assert run(BULB, at=[])["lit"] == []


@pytest.mark.parametrize("look, warns", [(", look: light", False), ("", True), (", look: metal", True)])
def test_items_without_a_lamp_are_reported(tmp_path: Path, look: str, warns: bool) -> None:
    (tmp_path / "a.ant").write_text("ant 2\nuse steering\nworld { items lamps }\nspecies a {\n  size 4 mm\n"
                                    "  state s { steer wander() * light(lamps) }\n}\n")  # fmt: skip
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        f"antdsl: 1\nframes: 1..2\nworld:\n  lamps: {{one: {{at: [0, 50, 0]{look}}}}}\n"
        "crowd: [{species: a, from: a.ant, count: 5, place: {around: [0, 0, 0], radius: 20 mm}}]\n"
    )
    warnings = [d for d in check_path(scene)[1].diagnostics if "`light(lamps)`" in d.message]
    assert len(warnings) == warns and all(d.severity == "warning" and "look: light" in d.help for d in warnings)


LAMP_PROGRAM = """ant 2
use steering
world { surface ground; lamp bulb }
species a {
  size 4 mm
  lit = 0
  far = 0 mm
  start see
  state see { lit = light(bulb); far = distance(bulb) }
}
"""
LAMP_SCENE = """antdsl: 1
frames: 1..3
light: {sun: 0 %, sky: 0 %, haze: 0 %, lamps: 200 %}
world:
  ground: {mesh: ground.ply}
  bulb: {lamp: [0, 30, 0], radius: 2 mm, power: 150 %, colour: [1, 0.2, 0.1], keys: {1: {at: [0, 30, 0]}, 3: {at: [0, 10, 0]}}}
crowd: [{species: a, from: a.ant, count: 6, place: {on: ground}}]
output: {attributes: [P, orient, pscale, id, state, lit, far]}
"""


def write_lamp_scene(folder: Path, text: str = LAMP_SCENE) -> Path:
    (folder / "a.ant").write_text(LAMP_PROGRAM)
    trimesh.Trimesh(*grid(40.0, 4), process=False).export(folder / "ground.ply")
    (folder / "scene.yaml").write_text(text)
    return folder / "scene.yaml"


def test_a_lamp_of_the_world_is_sensed_and_seen(tmp_path: Path) -> None:
    shot, report = open_scene(write_lamp_scene(tmp_path))
    assert shot is not None and not report.diagnostics, [each.message for each in report.diagnostics]
    for _ in record_frames(begin_recording(shot, tmp_path / "out", Options(), resume=False, force=False)):
        pass
    gallery = Gallery(open_cache(tmp_path / "out"))
    arrays, (lamp,) = gallery.cache.frame(2), gallery.make_picture(1).items
    assert (lamp.shape, lamp.power, lamp.colour, lamp.position) == ("globe", 1.5, (1.0, 0.2, 0.1), (0.0, 30.0, 0.0))
    # The values of a frame were sensed where the agents and the lamp are at its beginning.
    earlier = gallery.cache.frame(1)["P"].astype(float)
    away = np.subtract((0, 30, 0), earlier)
    distance = np.linalg.norm(away, axis=1)
    assert np.allclose(arrays["far"], distance, rtol=1e-5) and len(earlier) == 6
    assert np.allclose(arrays["lit"], 3.0 * 400 * away[:, 1] / distance**3, rtol=1e-4)
    drawn = find_lamps([lamp], (0, 1, 0), gallery.light.lamps)[0]
    assert drawn.centre.tolist() == [0, 30, 0] and drawn.strength == pytest.approx(3.0)
    weights = np.array([0.2126, 0.7152, 0.0722])
    assert drawn.light @ weights == pytest.approx(LAMP_COLOUR @ weights, rel=1e-5) and drawn.light[0] > 4 * drawn.light[1]
    assert gallery.make_picture(3).items[0].position == pytest.approx((0.0, 10.0, 0.0))


@pytest.mark.parametrize(
    "old, new, severity, words",
    [
        ("lamps: 200 %", "lamps: 0 %", "warning", "makes `bulb` dark"),
        ("lamp: [0, 30, 0]", "mesh: ground.ply", "error", "bulb"),
        ("power: 150 %", "power: -1", "error", "is not a strength"),
        ("[1, 0.2, 0.1]", "[1, 0.2, 2]", "error", "is not between 0 and 1"),
        ("power:", "powr:", "error", "`powr` is not a key"),
    ],
)
def test_lamps_with_mistakes(tmp_path: Path, old: str, new: str, severity: str, words: str) -> None:
    diagnostics = check_path(write_lamp_scene(tmp_path, LAMP_SCENE.replace(old, new)))[1].diagnostics
    assert any(words in each.message and each.severity == severity and each.help for each in diagnostics), diagnostics
