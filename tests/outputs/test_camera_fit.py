"""`camera: fit` holds the whole crowd in every frame that is drawn, and is written and reported like other cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.drawing import DrawRequest, FrameDrawer
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.camera import make_view
from antdsl.outputs.scene_cameras import SceneCameras
from antdsl.pipeline import open_scene

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture(scope="module")
def flock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flock") / "cache"
    words = ["run", str(EXAMPLES / "flocking" / "scene.yaml"), "--out", str(folder), "--frames", "1..240", "--quiet"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    return folder


@pytest.mark.parametrize("frames", [[1], [240], [1, 60, 120, 180, 240], list(range(1, 241))])
def test_the_flock_is_in_its_own_picture(flock: Path, frames: list[int]) -> None:
    gallery = Gallery(open_cache(flock))
    cameras = SceneCameras(gallery)
    assert cameras.is_fitted() and cameras.make_camera(1) is None and not cameras.is_moving()
    width, height = 960, 540
    options = DrawRequest(width, height, "scene", (), legend=False)
    camera = FrameDrawer(gallery, options, frames, threads=1)._find_camera(frames[0])
    camera_view = make_view(camera, width, height, (0.0, 1.0, 0.0))
    widest = 0.0
    for frame in frames:
        positions, ahead = camera_view.project(np.asarray(gallery.cache.frame(frame)["P"], np.float64))
        assert (ahead > 0).all() and (positions > 0).all() and (positions < [width, height]).all()
        widest = max(widest, float((np.ptp(positions, axis=0) / [width, height]).max()))
    assert widest > 0.5 or len(frames) > 1  # as large as it can be


def test_any_cache_can_be_drawn_so(flock: Path, tmp_path: Path) -> None:
    words = ["render", str(flock), "--camera", "fit", "--frames", "240..240", "--width", "64", "--height", "36"]
    result = CliRunner().invoke(app, [*words, "--out", str(tmp_path)])
    assert result.exit_code == 0 and (tmp_path / "picture.0240.png").is_file()


@pytest.mark.parametrize(("camera", "code"), [("fits", "wrong-value"), ("fit\nlod: {near: 100 mm}", "missing-key")])
def test_wrong_cameras_and_levels_of_detail_are_reported(tmp_path: Path, camera: str, code: str) -> None:
    for file in (EXAMPLES / "flocking").iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    text = (tmp_path / "scene.yaml").read_text(encoding="utf-8")
    (tmp_path / "scene.yaml").write_text(text.replace("camera: fit", f"camera: {camera}"), encoding="utf-8")
    shot, report = open_scene(str(tmp_path / "scene.yaml"))
    assert shot is None and [d.code for d in report.errors] == [code]


def test_open_scene_takes_words_and_paths() -> None:
    by_word, by_path = (open_scene(kind(EXAMPLES / "minimal" / "scene.yaml"))[0] for kind in (str, Path))
    assert by_word is not None and by_path is not None and by_word.inputs == by_path.inputs
