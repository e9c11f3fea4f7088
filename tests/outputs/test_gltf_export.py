"""A crowd as glTF, evaluated by the rules of the specification: its points are those that pictures draw."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from antdsl.bodies.body import rotate_vectors
from antdsl.bodies.files.reading import read_definition
from antdsl.cli import app
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.gallery import Gallery
from tests.commands import run
from tests.gltf_bodies import arm, binary
from tests.gltf_scene import Scene

RUN = CliRunner()
BUG = """ant 1
use steering
world { surface ground; items food { amount = 5 } }
species bug {
  size 4 mm
  response 1 step
  start go
  state go "Goes" red {
    steer wander(swing: 200 deg)
    play bend
    when chance 90 %/s -> grin over 0.2 s
    when age > 0.4 s and id > 9 -> gone
  }
  state grin "Grins" blue {
    enter { spawn bug }
    steer coast()
    play smile(speed: 0.7)
    when after 0.3 s -> hop over 0.2 s
  }
  state hop { play hop; when after 0.2 s -> go over 0.1 s }
  state gone { enter { die } }
  layers { state }
}
"""
SCENE = """antdsl: 1
units: cm
up: UP
frames: 3..26
world: {ground: {mesh: ground.obj}, food: {crumb: {at: [1, 0, 2], radius: 4 mm, amount: 5}}}
crowd: [{species: bug, from: bug.ant, count: 14, body: arm.glb, place: {on: ground}}]
camera: {at: [0, 12, 30], look_at: [0, 0, 0], focal: 50 mm}
"""


def create_cache(folder: Path, up: str) -> Path:
    (folder / "bug.ant").write_text(BUG)
    (folder / "scene.yaml").write_text(SCENE.replace("UP", up))
    (folder / "arm.glb").write_bytes(binary(*arm()))
    ground = "v -9 0 -9\nv 9 3 -9\nv 9 0 9\nv -9 -5 9\nf 1 4 3\nf 1 3 2\n"
    if up == "z":
        ground = "v -9 9 0\nv 9 9 3\nv 9 -9 0\nv -9 -9 -5\nf 1 4 3\nf 1 3 2\n"
    (folder / "ground.obj").write_text(ground)
    result = RUN.invoke(app, ["run", str(folder / "scene.yaml"), "--out", str(folder / "cache"), "--backend", "numpy", "-q"])
    assert result.exit_code == 0, result.output
    return folder / "cache"


@pytest.fixture(scope="module", params=["y", "z"])
def cache(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return create_cache(tmp_path_factory.mktemp("gltf"), request.param)


def exported(cache: Path, path: Path, *words: str) -> str:
    result = RUN.invoke(app, ["export", str(cache), "--to", str(path), *words])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("ending", [".glb", ".gltf"])
def test_points_are_where_pictures_draw_them(cache: Path, tmp_path: Path, ending: str) -> None:
    output = exported(cache, tmp_path / f"bugs{ending}", "--tolerance", "0%", "--show", "states")
    assert "frames 3..26" in output and "keep the colour of their first state" in output
    scene = Scene((tmp_path / f"bugs{ending}").read_bytes())
    scene.check()
    gallery = Gallery(open_cache(cache))
    nodes = {node["name"]: number for number, node in enumerate(scene.tree["nodes"])}
    up_is_z, hidden_count, changed = gallery.manifest.up == "z", 0, set()
    for frame in range(3, 27, 4 if ending == ".glb" else 11):
        _, points = scene.at((frame - 3) / 24)
        (crowd,) = gallery.make_picture(frame).crowds
        assert crowd.body is not None and crowd.ids is not None
        body = crowd.body.pose_vertices(crowd.machine_clips, len(crowd.position))[0].astype(float)
        expected = rotate_vectors(crowd.orient, body) * crowd.scale[:, None, None] + crowd.position[:, None]
        if up_is_z:
            expected = np.stack([expected[..., 0], expected[..., 2], -expected[..., 1]], axis=-1)
        for row, one in enumerate(crowd.ids.tolist()):
            assert np.abs(points[nodes[f"bug_{one}_arm"]] - expected[row] / 100).max() < 2e-7, "metres; a body is 4e-3 long"
            changed.add(tuple(np.round(body[row].ravel(), 3)))
        away = [name for name in nodes if name.startswith("bug_") and name.endswith("_arm")]
        for name in away:
            if int(name.split("_")[1]) not in crowd.ids:
                hidden_count += 1
                assert np.ptp(points[nodes[name]], axis=0).max() == 0
    assert hidden_count > 5, "some are born and some die"
    assert len(changed) > 20, "they play"


def test_what_stands_about_is_there_and_meshes_are_shared(cache: Path, tmp_path: Path) -> None:
    exported(cache, tmp_path / "bugs.glb", "--ids", "0..3", "-q")
    scene = Scene((tmp_path / "bugs.glb").read_bytes())
    tree = scene.tree
    names = [node["name"] for node in tree["nodes"]]
    assert {"ground", "crumb", "camera", "bug_0", "bug_3"} <= set(names) and "bug_4" not in names
    _, points = scene.at(0.0)
    ground = points[names.index("ground")]
    assert np.allclose(np.ptp(ground, axis=0), (0.18, 0.08, 0.18))
    assert np.allclose(points[names.index("crumb")].mean(axis=0)[0], 0.01, atol=2e-3)
    lens = tree["cameras"][0]["perspective"]
    assert lens["znear"] < 0.01 < 0.3 < lens["zfar"], "metres; the camera is 0.32 away"
    shared = {tuple(sorted(p["attributes"].items())) for m in tree["meshes"] if m["name"] == "arm" for p in m["primitives"]}
    assert len(shared) == 1 and tree["cameras"][0]["perspective"]["yfov"] == pytest.approx(2 * np.arctan(36 * 9 / 16 / 100))


def test_frames_that_are_missing_leave_their_time(cache: Path, tmp_path: Path) -> None:
    gaps = tmp_path / "gaps"
    shutil.copytree(cache, gaps)
    for frame in (6, 7, 8):
        (gaps / "frames" / f"frame.{frame:04d}.npz").unlink()
    for folder, name in ((cache, "all.glb"), (gaps, "gaps.glb")):
        exported(folder, tmp_path / name, "--ids", "0..3", "-q")
    full_scene, partial_scene = (Scene((tmp_path / name).read_bytes()) for name in ("all.glb", "gaps.glb"))
    number = [node["name"] for node in partial_scene.tree["nodes"]].index("bug_1_arm")
    for frame in (3, 9, 26):
        seconds = (frame - 3) / 24
        assert np.abs(partial_scene.at(seconds)[1][number] - full_scene.at(seconds)[1][number]).max() < 1e-6, frame


def test_others_read_it(cache: Path, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    exported(cache, tmp_path / "bugs.glb", "--ids", "0..3", "-q")
    body, report = read_definition(tmp_path / "bugs.glb")
    assert body is not None and not report.errors, str(report)
    assert "bug_0" in body.rig.names and body.clips["shot"].duration == pytest.approx(23 / 24)
    loaded = trimesh.load(tmp_path / "bugs.glb")
    assert len(loaded.geometry) >= 3 and np.isfinite(loaded.bounds).all()


def test_large_crowds_are_refused_with_what_to_do(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("antdsl.outputs.exports.gltf_export._MAX_FILE_AGENTS", 9)
    process = run("export", str(cache), "--to", str(tmp_path / "bugs.glb"), cwd=tmp_path)
    assert (
        process.returncode == 1
        and "small crowds" in process.stderr
        and "--ids" in process.stderr
        and not list(tmp_path.iterdir())
    )
