"""`--show paths`: where agents were and will be, read from the cache, drawn along the ground as they walked."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from antdsl.bodies.shapes import build_flat_grid, build_sphere
from antdsl.cli import app
from antdsl.outputs.agent_paths import PathWindow
from antdsl.outputs.cache.cache_reader import make_frame_path, open_cache
from antdsl.outputs.cut_plane import CutPlane
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures import Camera, Crowd, Picture, Solid, render_frame
from antdsl.outputs.pictures.camera import make_view
from antdsl.outputs.pictures.model import AgentPathLines

RUN = CliRunner()
PROGRAM = """ant 1
use steering
world { surface ground }
species bug {
  response 1 step
  start go
  state go { steer wander(swing: 200 deg); when chance 60 %/s -> split; when age > 0.6 s and id > 9 -> gone }
  state split { enter { spawn bug }; steer coast(); when after 0.2 s -> go }
  state gone { enter { die } }
  layers { state }
}
"""
SCENE = """antdsl: 1
frames: 1..30
fps: 24
world: {ground: {mesh: ground.obj}}
crowd: [{species: bug, from: bug.ant, count: 20, place: {on: ground, radius: 30 mm}}]
output: {attributes: [P, v, orient, id, pscale], checkpoint: 10}
"""


def ripple(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    return 6.0 * np.sin(x / 6.0) * np.cos(z / 7.0)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bugs that are born, walk over ripples and die."""
    folder = tmp_path_factory.mktemp("paths")
    line = np.linspace(-60.0, 60.0, 81)
    vertices, faces = build_flat_grid(line, line)
    vertices[:, 1] = ripple(vertices[:, 0], vertices[:, 2])
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / "ground.obj").write_text("\n".join(lines))
    (folder / "bug.ant").write_text(PROGRAM)
    (folder / "scene.yaml").write_text(SCENE)
    result = RUN.invoke(app, ["run", str(folder / "scene.yaml"), "--out", str(folder / "cache"), "--backend", "numpy", "-q"])
    assert result.exit_code == 0, result.output
    return folder / "cache"


def test_paths_are_the_places_of_the_frames_around(cache: Path) -> None:
    stored_cache = open_cache(cache)
    gallery = Gallery(stored_cache, window=PathWindow(0.25, 0.5))
    born, dead = 0, 0
    for frame in (1, 2, 15, 29, 30):
        crowd = gallery.make_picture(frame).crowds[0]
        assert crowd.paths is not None and crowd.ids is not None
        paths = crowd.paths.positions
        assert paths.shape == (len(crowd.ids), 6 + 1 + 12, 3) and crowd.paths.current_index == 6
        for k in range(paths.shape[1]):
            at = frame - 6 + k
            where = {}
            if 1 <= at <= 30:
                arrays = stored_cache.frame(at)
                where = dict(zip(arrays["id"].tolist(), zip(arrays["P"], arrays["pscale"], strict=True), strict=True))
            for row, name in enumerate(crowd.ids.tolist()):
                if name not in where:
                    assert np.isnan(paths[row, k]).all(), "nothing is made up where an agent is not there"
                    born, dead = born + (1 <= at < frame), dead + (frame < at <= 30)
                    continue
                place, size = where[name]
                assert np.linalg.norm(paths[row, k] - place) == pytest.approx(0.06 * size, rel=1e-2)
        middle = (paths[:, 1:] + paths[:, :-1])[np.isfinite(paths[:, 1:] + paths[:, :-1]).all(axis=2)] / 2
        off = np.abs(middle[:, 1] - ripple(middle[:, 0], middle[:, 2]))
        assert off.max() < 0.8, "between two frames it lies on the ground, ripples of 6 mm and all"
    assert born and dead


def test_named_agents_alone_have_paths_and_a_cut_keeps_rows_together(cache: Path) -> None:
    window = PathWindow(0.1, 0.1)
    named, others = Gallery(open_cache(cache), window=window).make_picture(20, agents=frozenset([3 * SPECIES_PER_KEY])).crowds
    assert named.paths is not None and len(named.paths.positions) == 1 and others.paths is None
    part = Gallery(open_cache(cache), CutPlane.parse("x > 0"), window).make_picture(20).crowds[0]
    assert part.paths is not None and 0 < len(part.position) == len(part.paths.positions)
    assert np.abs(part.paths.positions[:, part.paths.current_index] - part.position).max() < 0.5
    assert Gallery(open_cache(cache)).make_picture(20).crowds[0].paths is None


def test_a_frame_that_is_missing_or_damaged_leaves_a_gap(cache: Path, tmp_path: Path) -> None:
    copied = tmp_path / "cache"
    shutil.copytree(cache, copied)
    make_frame_path(copied, 12).unlink()
    make_frame_path(copied, 9).write_bytes(b"no frame")
    paths = Gallery(open_cache(copied), window=PathWindow(0.25, 0.25)).make_picture(10).crowds[0].paths
    assert paths is not None
    is_present = np.isfinite(paths.positions).all(axis=2).any(axis=0)
    assert not is_present[5] and not is_present[8] and is_present[[4, 6, 7]].all()


ABOVE = Camera((0.0, 60.0, 0.01), (0.0, 0.0, 0.0), focal=30.0)


def picture(*solids: Solid) -> Picture:
    line = np.linspace(-40, 40, 9)
    corner = np.array([[[-12.0, 0.3, 0], [-6, 0.3, 0], [0, 0.3, 0], [6, 0.3, 0], [6, 0.3, 6], [6, 0.3, 12], [np.nan] * 3]])
    still = np.array([[0.0, 0, 0, 1]])
    ant = Crowd(
        "ant",
        np.zeros((1, 3)),
        still,
        np.full(1, 2.0),
        np.full((1, 3), 0.5),
        ids=np.zeros(1, np.int64),
        paths=AgentPathLines(corner, 2),
    )
    return Picture((Solid("floor", *build_flat_grid(line, line)), *solids), (ant,))


def changes(drawn: Picture, *points: tuple[float, float, float]) -> list[float]:
    """How much brighter the pixels about each place become by the paths."""
    with_paths, plain = (render_frame(drawn, ABOVE, 160, 90, show=show, samples=1).astype(int) for show in (("paths",), ()))
    differences = []
    for column, row in make_view(ABOVE, 160, 90, (0.0, 1.0, 0.0)).project(np.array(points, float))[0].round().astype(int):
        part = (with_paths - plain)[row - 2 : row + 3, column - 2 : column + 3].sum(axis=2)
        differences.append(float(part.ravel()[np.abs(part).argmax()]))
    return differences


def test_ways_gone_are_dark_and_ways_to_go_are_bright_round_the_corner() -> None:
    past, to_go, corner, straight_on = changes(picture(), (-6, 0.3, 0), (5, 0.3, 0), (6, 0.3, 6), (14, 0.3, 0))
    assert past < -60 and to_go > 60 and corner > 30 and straight_on == 0


def test_what_is_behind_a_wall_is_not_drawn() -> None:
    vertices, faces = build_sphere(2)
    wall = Solid("wall", vertices * [4, 2, 4] + [6, 20, 4], faces, "stone")
    hidden, visible = changes(picture(wall), (6, 0.3, 4), (-6, 0.3, 0))
    assert hidden == 0 and visible < -60


@pytest.mark.parametrize(("text", "window"), [("1..2", (1, 2)), (" 0 .. 2.5 ", (0, 2.5)), ("60..60", (60, 60))])
def test_windows_are_read(text: str, window: tuple[float, float]) -> None:
    result = PathWindow.parse(text)
    assert result is not None and (result.seconds_before, result.seconds_after) == window


@pytest.mark.parametrize("text", ["", "2", "-1..2", "1..61", "nan..2", "1..", "1..2..3", "1e9..2"])
def test_windows_that_are_none_are_refused(text: str, cache: Path) -> None:
    assert PathWindow.parse(text) is None
    result = RUN.invoke(app, ["render", str(cache), "--show", "paths", "--window", text])
    assert result.exit_code == 2 and "1..2" in result.output


def test_the_command_draws_them(cache: Path, tmp_path: Path) -> None:
    from PIL import Image

    size = ["--width", "160", "--height", "90", "--frames", "15..15", "--threads", "1"]
    images = []
    for words in (["--show", "none"], ["--show", "paths"], ["--show", "paths", "--window", "0..0.1"]):
        out = tmp_path / str(len(images))
        result = RUN.invoke(app, ["render", str(cache), *words, *size, "--out", str(out)])
        assert result.exit_code == 0, result.output
        images.append(np.asarray(Image.open(out / "picture.0015.png")).astype(int))
    none, all_of_them, short = ((np.abs(i - images[0]) > 20).any(axis=2).sum() for i in images)
    assert none == 0 < short < all_of_them and math.isfinite(all_of_them)
