"""Lamps, the sun and the sky of a scene: in pictures and in USD."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from meshes import box, grid
from numpy.typing import NDArray

from antdsl.bodies.body import build_orientations
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.exports.gltf_export import export_gltf
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures import Camera, Crowd, Item, Picture, Solid, render_frame
from antdsl.outputs.pictures.camera import make_view
from antdsl.outputs.pictures.lamps import LAMP_COLOUR, Lamp, find_lamps
from antdsl.outputs.pictures.light import SUN_LIGHT, decode_srgb, make_sun
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import open_scene
from antdsl.runtime import Options
from antdsl.scene.light_model import LightSettings
from antdsl.scene.thing_models import UP_VECTORS

NIGHT, UP = LightSettings(sun=0.0, sky=0.0, haze=0.0), (0.0, 1.0, 0.0)
ABOVE = Camera((0.0, 120.0, 0.01), (0.0, 0.0, 0.0), focal=30.0)
W, H = 160, 90
# The centre of the bulb is 0.85 radii above the position of an item.
BULB = Item("bulb", (0.0, 30.0, 0.0), 2.0, 1.0, "sphere", "light")


def floor(colour: float = 0.5) -> Solid:
    return Solid("floor", *grid(200.0, 20), "table", np.array([colour] * 3))


def brightness(image: NDArray[np.uint8], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear light of the pixels that show points."""
    positions, _ = make_view(ABOVE, W, H, UP).project(np.asarray(points, np.float64))
    column, row = positions.astype(int).T
    return np.asarray(decode_srgb(image[row, column] / np.float32(255)).mean(axis=1), np.float64)


def test_light_decreases_with_the_square_of_the_distance_and_the_angle() -> None:
    lamp = Lamp(np.array([0.0, 20.0, 0.0]), 2.0, 3.0)
    points = np.array([[0, 0, 0], [0, 10, 0], [20, 0, 0], [0, 40, 0]], np.float32)
    up = np.tile(np.array(UP, np.float32), (4, 1))
    light = lamp.compute_light(points, up)
    assert np.allclose(light[0], 3.0 * LAMP_COLOUR) and np.allclose(light[1], 4 * light[0])
    assert np.allclose(light[2], light[0] / 2 * np.sqrt(0.5), rtol=1e-5) and not light[3].any()


def test_a_lamp_lights_the_ground_and_things_hide_it() -> None:
    picture = Picture((floor(),), items=(BULB,), light=NIGHT)
    image = render_frame(picture, ABOVE, W, H)
    away = np.array([10.0, 20.0, 30.0, 40.0])
    measured = brightness(image, np.stack([away, 0 * away, 0 * away], axis=1))
    high = 30.0 + 2 * 0.85
    expected = high / (away**2 + high**2) ** 1.5
    assert np.allclose(measured / measured[0], expected / expected[0], rtol=0.06)
    wall = Solid("wall", *box((15, 0, -30), (16, 20, 30)), "stone")
    behind = brightness(
        render_frame(replace(picture, solids=(floor(), wall)), ABOVE, W, H), np.array([[22.0, 0, 0], [-22.0, 0, 0]])
    )
    assert behind[0] < 0.03 * behind[1]


def test_bodies_are_lit_and_throw_shadows() -> None:
    orient = build_orientations(np.array([[1.0, 0, 0]]), np.array([UP]))
    ant = Crowd("ant", np.array([[20.0, 0, 0]]), orient, np.array([12.0]), np.array([[0.9, 0.9, 0.9]]))
    lamp = replace(BULB, position=(0.0, 12.0, 0.0))
    lit = Picture((floor(),), (ant,), (lamp,), light=NIGHT, grain=4.0)
    with_ant, bare = (render_frame(replace(lit, crowds=crowds), ABOVE, W, H) for crowds in ((ant,), ()))
    change = with_ant.astype(int).sum(axis=2) - bare.astype(int).sum(axis=2)
    column = np.nonzero(change < -60)[1]
    assert (change > 30).any() and len(column) > 20 and column.mean() > W / 2 + 20 * 0.8, "the shadow is behind the ant"


def test_used_up_and_other_items_give_no_light() -> None:
    others = (
        replace(BULB, remaining_share=0.0),
        replace(BULB, look="metal"),
        replace(BULB, look=None),
        replace(BULB, shape="none"),
    )
    assert find_lamps(others, UP, 1.0) == () and find_lamps((BULB,), UP, 0.0) == () and find_lamps((), UP, 1.0) == ()
    many = tuple(replace(BULB, radius=float(n)) for n in range(1, 40))
    assert [lamp.radius for lamp in find_lamps(many, UP, 1.0)] == [float(n) for n in range(39, 23, -1)]


def test_sun_and_sky_change_pictures() -> None:
    def draw(**settings: float) -> float:
        image = render_frame(Picture((floor(),), light=LightSettings(haze=0.0, **settings)), ABOVE, W, H)
        return float(brightness(image, np.array([[10.0, 0, 10]]))[0])

    usual, dark = draw(), draw(sun=0.0, sky=0.0)
    assert dark < 0.01 and draw(sun=0.0) + draw(sky=0.0) == pytest.approx(usual, rel=0.02)
    assert draw(sky=0.0, elevation=90.0) > 1.4 * draw(sky=0.0, elevation=30.0)


PROGRAM = """ant 1
use steering
world { surface ground
  items lamps { load = 1 } }
species walker { max_speed 30 mm/s
  start stroll
  state stroll { steer wander() }
  layers { state } }
"""
SCENE = """antdsl: 1
units: mm
frames: 1..2
light: {sun: 50 %, sky: 0 %, lamps: 200 %, elevation: 30 deg, azimuth: 90 deg}
world:
  ground: {mesh: ground.ply}
  lamps: {bulb: {at: [0, 20, 0], radius: 2 mm, look: light, keys: {1: {at: [0, 20, 0]}, 2: {at: [8, 20, 0]}}}}
crowd: [{species: walker, from: walker.ant, count: 2, place: {on: ground}}]
"""


def write_scene(folder: Path, text: str = SCENE) -> Path:
    (folder / "walker.ant").write_text(PROGRAM)
    trimesh.Trimesh(*grid(100.0, 4), process=False).export(folder / "ground.ply")
    (folder / "scene.yaml").write_text(text)
    return folder / "scene.yaml"


def test_the_light_of_a_scene_is_in_its_cache_and_in_usd(tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdGeom, UsdLux

    from antdsl.outputs.exports import find_export

    shot, report = open_scene(write_scene(tmp_path))
    assert shot is not None, str(report)
    for _ in record_frames(begin_recording(shot, tmp_path / "out", Options(), resume=False, force=False)):
        pass
    gallery = Gallery(open_cache(tmp_path / "out"))
    assert gallery.light == LightSettings(0.5, 0.0, 1.0, 2.0, pytest.approx(30.0), pytest.approx(90.0))  # type: ignore[arg-type]
    export = find_export(tmp_path / "a.usda")
    assert export is not None
    export.forms["instances"](gallery, [1, 2], tmp_path / "a.usda")
    stage = usd.Stage.Open(str(tmp_path / "a.usda"))
    sun, lamp = (UsdLux.LightAPI(stage.GetPrimAtPath(f"/World/lights/{name}")) for name in ("sun", "lamp_0"))
    assert not stage.GetPrimAtPath("/World/lights/sky")
    assert sun.GetIntensityAttr().Get() == pytest.approx(2.65 / 2) and lamp.GetIntensityAttr().Get() == pytest.approx(
        2.65 * 200 / np.pi
    )
    shines = UsdGeom.Xformable(sun).ComputeLocalToWorldTransform(1).TransformDir((0, 0, -1))
    assert shines[1] == pytest.approx(-0.5, abs=1e-6), "the sun is 30 degrees above the ground"
    centres = [UsdGeom.Xformable(lamp).ComputeLocalToWorldTransform(frame).ExtractTranslation() for frame in (1, 2)]
    assert np.allclose(centres, [[0, 23.5, 0], [8, 23.5, 0]], atol=1e-5)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{sun: -1}", "`-1` is not a strength"),
        ("{sky: 9 mm}", "`9 mm` is not a strength"),
        ("{haze: thick}", "thick"),
        ("{lamps: 200000 %}", "not a strength"),
        ("{moon: 3 %}", "moon"),
        ("{elevation: 3 mm}", "`3 mm` is not"),
    ],
)
def test_wrong_values_are_located(tmp_path: Path, line: str, message: str) -> None:
    text = SCENE.replace("{sun: 50 %, sky: 0 %, lamps: 200 %, elevation: 30 deg, azimuth: 90 deg}", line)
    shot, report = open_scene(write_scene(tmp_path, text))
    assert shot is None and report.errors[0].span is not None and message in report.errors[0].message, report.errors


@pytest.mark.parametrize("up", ["y", "z"])
def test_gltf_has_the_sun_and_a_light_in_each_lamp(tmp_path: Path, up: str) -> None:
    text = SCENE.replace("units: mm", f"units: mm\nup: {up}").replace("ground.ply}", "ground.ply, up: y}")
    shot, report = open_scene(write_scene(tmp_path, text))
    assert shot is not None, str(report)
    for _ in record_frames(begin_recording(shot, tmp_path / "out", Options(), resume=False, force=False)):
        pass
    gallery = Gallery(open_cache(tmp_path / "out"))
    export_gltf(gallery, [1, 2], tmp_path / "a.gltf")
    file = json.loads((tmp_path / "a.gltf").read_text(encoding="utf-8"))
    assert file["extensionsUsed"] == ["KHR_lights_punctual"]
    sun, lamp = file["extensions"]["KHR_lights_punctual"]["lights"]
    nodes = {node["extensions"]["KHR_lights_punctual"]["light"]: node for node in file["nodes"] if "extensions" in node}
    assert (sun["type"], lamp["type"], max(sun["color"]), max(lamp["color"])) == ("directional", "point", 1.0, 1.0)
    # The light 1 of pictures is at ten radii, 20 mm, from a lamp of 100 %; the sun has half of its usual light.
    light = lamp["intensity"] / 0.02**2 * np.array(lamp["color"]) / (np.pi * 683)
    assert np.allclose(light, 2 * LAMP_COLOUR, rtol=1e-4)
    assert np.allclose(sun["intensity"] * np.array(sun["color"]) / (np.pi * 683), 0.5 * SUN_LIGHT, rtol=1e-4)
    x, y, z, w = nodes[0]["rotation"]
    toward_sun = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])  # +z, rotated
    assert np.allclose(toward_sun, make_sun(np.array(UP_VECTORS[up]), gallery.light).direction, atol=1e-5)
    parent = next(node for node in file["nodes"] if file["nodes"].index(nodes[1]) in node.get("children", ()))
    assert parent["name"] == "bulb" and nodes[1]["translation"] == (np.array(UP_VECTORS[up]) * 1.75).tolist()
