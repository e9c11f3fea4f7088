"""Pictures by Cycles: the request has the camera and the light of antdsl's own pictures, the pixels come back in order.

The slow test renders with Blender, as `test_usd_blender.py` finds it."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import trimesh
from meshes import box, grid

pytest.importorskip("pxr")

from test_usd_crowds import recorded

from antdsl.casting.lamps import UNIT_DISTANCE_IN_RADII
from antdsl.outputs.blender import rendering
from antdsl.outputs.blender.rendering import BlenderError, build_request, render_with_blender
from antdsl.outputs.blender.requests import describe_camera, to_blender_axes
from antdsl.outputs.cache.cache_reader import Cache
from antdsl.outputs.drawing import DrawRequest, FrameDrawer
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.camera import make_view
from antdsl.outputs.pictures.lamps import find_lamps
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Camera
from antdsl.scene.light_model import LightSettings
from antdsl.scene.setting import SENSOR_WIDTH_MM

W, H = 96, 54
REQUEST = DrawRequest(W, H, "scene", (), samples=16, legend=False)
SCENE = """antdsl: 1
units: mm
frames: 1..3
world:
  floor: {mesh: floor.ply}
  box: {mesh: box.ply}
  lamps: {bulb: {at: [60, 120, 0], radius: 12 mm, look: light}}
light: {sun: 60 %, elevation: 50 deg, azimuth: 30 deg, haze: 0 %}
crowd:
  - {species: walker, from: walker.ant, count: 4, place: {on: floor, around: [-60, 0, 60], radius: 20 mm}}
camera: {at: [40, 260, 330], look_at: [0, 0, 0], focal: 40 mm, f_stop: 8}
"""
WALKER = """ant 1
use steering
world { surface floor; obstacle box; items lamps }
species walker {
  max_speed 20 mm/s
  size 6 mm
  start go
  state go amber { steer wander() }
  layers { state }
}
"""
# Stands in for the script: gives each frame its number as its light.
STAND_IN = """
import json, sys
from array import array
request = json.load(sys.stdin)
for each in request["frames"]:
    with open(each["path"], "wb") as file:
        array("f", [each["frame"] / 10] * (request["size"][0] * request["size"][1] * 3)).tofile(file)
    print("rendered", each["frame"], flush=True)
"""


@pytest.fixture(scope="module")
def lit(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    """A few ants on a floor with a box, a lamp and the sun."""
    folder = tmp_path_factory.mktemp("lit")
    for name, mesh in (("floor", grid(600.0, 12)), ("box", box((-20.0, 0.0, -20.0), (20.0, 40.0, 20.0)))):
        trimesh.Trimesh(*mesh, process=False).export(folder / f"{name}.ply")
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "walker.ant").write_text(WALKER)
    return recorded(folder, 3)


@pytest.mark.parametrize("up", ["y", "z"])
def test_points_are_in_the_pixels_of_antdsls_own_picture(lit: Cache, up: str) -> None:
    gallery = Gallery(lit)
    gallery.manifest = gallery.manifest.model_copy(update={"up": up})
    camera = Camera((40.0, 260.0, 330.0), (5.0, 10.0, 20.0), focal=40.0, aperture=5.0)
    points = np.random.default_rng(3).uniform(-60, 60, (20, 3))
    expected, ahead = make_view(camera, W, H, (0.0, 1.0, 0.0) if up == "y" else (0.0, 0.0, 1.0)).project(points)
    described = describe_camera(gallery, camera)
    offset = to_blender_axes(points, up) / 1000 - np.array(described["matrix"])[:3, 3]
    local = offset @ np.array(described["matrix"])[:3, :3]  # Blender's camera looks along its own -z
    assert np.allclose(-local[:, 2] * 1000, ahead)
    share = local[:, :2] / -local[:, 2:] * described["focal"] / SENSOR_WIDTH_MM
    assert np.allclose(np.stack([(share[:, 0] + 0.5) * W, H / 2 - share[:, 1] * W], axis=1), expected)
    assert described["f_stop"] == pytest.approx(40.0 / 5.0)
    assert described["focus"] == pytest.approx(np.linalg.norm([35.0, 250.0, 310.0]) / 1000)


def test_the_lamp_has_the_irradiance_of_pictures(lit: Cache, tmp_path: Path) -> None:
    gallery = Gallery(lit)
    request = build_request(gallery, REQUEST, [2], [2], {2: tmp_path / "2"}, tmp_path / "scene.usdc", 1)
    assert [each["frame"] for each in request["frames"]] == [2] and request["size"] == (W, H)
    (bulb,) = request["frames"][0]["lamps"]
    (lamp,) = find_lamps(gallery.make_picture(2).items, (0.0, 1.0, 0.0), 1.0)
    distance = UNIT_DISTANCE_IN_RADII * lamp.radius / 1000
    irradiance = np.array(bulb["power"]) / (4 * np.pi * distance**2)
    assert np.allclose(irradiance / np.pi, lamp.light * lamp.strength)
    assert np.allclose(bulb["centre"], to_blender_axes(lamp.centre[None], "y")[0] / 1000)
    light = request["light"]
    assert np.linalg.norm(light["sun_direction"]) == pytest.approx(1)
    assert light["sun_direction"][2] == pytest.approx(np.sin(np.radians(50)))


def test_blur_asks_for_the_camera_of_the_next_frame(lit: Cache, tmp_path: Path) -> None:
    paths = {1: tmp_path / "1"}
    for blur, count in ((0.0, 1), (0.5, 2)):
        blurred = DrawRequest(W, H, "scene", (), samples=4, blur=blur, legend=False)
        request = build_request(Gallery(lit), blurred, [1], [1], paths, tmp_path / "scene.usdc", 1)
        assert len(request["frames"][0]["cameras"]) == count and request["blur"] == blur


def test_pictures_come_back_in_order(lit: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendering, "build_command", lambda: [sys.executable, "-c", STAND_IN])
    images = list(render_with_blender(Gallery(lit), REQUEST, [1, 3], [1, 3], 1))
    assert [image.shape for image in images] == [(H, W, 3)] * 2
    assert [len(np.unique(image)) for image in images] == [1, 1] and images[0][0, 0, 0] < images[1][0, 0, 0]


def test_an_early_end_of_blender_is_an_error_with_its_words(lit: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendering, "build_command", lambda: [sys.executable, "-c", "raise SystemExit('no module bpy')"])
    with pytest.raises(BlenderError, match="no module bpy"):
        list(render_with_blender(Gallery(lit), REQUEST, [1], [1], 1))


@pytest.mark.slow
def test_cycles_shows_what_antdsl_draws(lit: Cache) -> None:
    """At night, the light of the lamp and the shadow of the box are in the same blocks of pixels, equally bright."""
    if rendering.PYTHON_VARIABLE not in os.environ and find_spec("bpy") is None:
        pytest.skip("there is no Blender (bpy)")
    gallery = Gallery(lit)
    gallery.light = LightSettings(sun=0.0, sky=0.0, haze=0.0)
    (cycles,) = render_with_blender(gallery, REQUEST, [2], [2], 0)
    own = FrameDrawer(gallery, REQUEST, [2], 0).draw(2)
    first, second = (
        decode_srgb(image / np.float32(255)).mean(axis=2).reshape(H // 6, 6, W // 6, 6).mean(axis=(1, 3))
        for image in (own, cycles)
    )
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.9
    assert 0.8 < second.mean() / first.mean() < 1.25
