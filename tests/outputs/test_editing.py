"""Orientations smoothed after the run: what a mean over frames is, and the cache that `antdsl edit` makes of another."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.outputs.cache.cache_reader import make_frame_path, open_cache
from antdsl.outputs.edits.verbs.smoothing import FrameValues, average_rotations

RUN = CliRunner()
PROGRAM = """ant 1
use steering
world { surface ground }
species bug {
  response 1 step
  start go
  state go { steer wander(swing: 200 deg); when chance 40 %/s -> split; when age > 0.6 s and id > 9 -> gone }
  state split { enter { spawn bug }; steer coast(); when after 0.2 s -> go }
  state gone { enter { die } }
  layers { state }
}
"""
SCENE = """antdsl: 1
frames: 1..30
world: {ground: {mesh: ground.obj}}
crowd: [{species: bug, from: bug.ant, count: 20, place: {on: ground}}]
output: {attributes: [P, v, orient, id, pscale], checkpoint: 10}
"""


def about_y(angle: np.ndarray) -> np.ndarray:
    """Quaternions of turns about +y."""
    half, nothing = np.asarray(angle, float) / 2, np.zeros(np.shape(angle))
    return np.stack([nothing, np.sin(half), nothing, np.cos(half)], axis=-1)


def frames_of(angles: np.ndarray, keys: np.ndarray | None = None) -> dict[int, FrameValues]:
    """Frames (rows) of agents (columns) that face so."""
    every = np.arange(angles.shape[1]) if keys is None else keys
    return {k: FrameValues(every.astype(np.int64), about_y(row)) for k, row in enumerate(angles)}


def angle_of(orient: np.ndarray) -> np.ndarray:
    return 2 * np.arctan2(orient[:, 1], orient[:, 3])


def test_an_even_turn_stays_and_a_jerk_is_spread() -> None:
    steps = np.arange(21.0)
    frames = frames_of(np.stack([0.1 * steps, (steps >= 10) * 1.0, 0.3 * (-1.0) ** steps], axis=1))
    angles = np.array([angle_of(average_rotations(frames, k, 9)) for k in range(21)])
    assert angles[:, 0] == pytest.approx(0.1 * steps, abs=1e-6)  # no agent lags, also not at the ends
    assert (
        np.diff(angles[:, 1]).max() < 0.25 and (np.diff(angles[:, 1]) > -1e-6).all() and angles[9:11, 1].sum() == pytest.approx(1)
    )
    assert np.abs(angles[4:-4, 2]).max() < 0.02 and angles[(0, -1), 2] == pytest.approx((0.3, 0.3))


def test_the_weights_are_those_of_a_raised_cosine() -> None:
    frames = frames_of(np.array([[0.0], [0.0], [0.02], [0.0], [0.0]]))
    each = [1, 0.5 + 0.5 * np.cos(np.pi / 3), 0.5 + 0.5 * np.cos(2 * np.pi / 3)]
    assert angle_of(average_rotations(frames, 2, 5)) == pytest.approx(0.02 / (each[0] + 2 * each[1] + 2 * each[2]), rel=1e-4)


def test_signs_of_quaternions_and_rows_count_for_nothing() -> None:
    rng = np.random.default_rng(2)
    frames = frames_of(np.cumsum(rng.normal(0, 0.4, (9, 6)), axis=0))
    other = {}
    for number, frame in frames.items():
        order, sign = rng.permutation(6), rng.choice((-1.0, 1.0), 6)
        other[number] = FrameValues(frame.key[order], frame.values[order] * sign[:, None])
    one, two = average_rotations(frames, 4, 7), average_rotations(other, 4, 7)
    two = two[np.argsort(other[4].key)]
    assert np.minimum(np.abs(one - two), np.abs(one + two)).max() < 1e-6
    assert np.linalg.norm(one, axis=1) == pytest.approx(np.ones(6), abs=1e-6)


def test_who_comes_and_goes_has_fewer_frames_and_a_gap_ends_them() -> None:
    angles = np.arange(9.0)[:, None] ** 2 * 0.02
    frames = frames_of(np.repeat(angles, 2, axis=1))
    for number in (0, 1, 2):  # the second one is born in frame 3
        frames[number] = FrameValues(frames[number].key[:1], frames[number].values[:1])
    one, two = angle_of(average_rotations(frames, 3, 9)), angle_of(average_rotations(frames, 4, 9))
    assert one[1] == pytest.approx(angles[3, 0], abs=1e-6) and one[0] > angles[3, 0] + 0.01
    assert two[1] == pytest.approx((angles[3, 0] / 2 + angles[4, 0] + angles[5, 0] / 2) / 2, abs=1e-4)
    del frames[5]
    assert angle_of(average_rotations(frames, 4, 9)) == pytest.approx([angles[4, 0]] * 2, abs=1e-6)


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("edited")
    (folder / "bug.ant").write_text(PROGRAM)
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "ground.obj").write_text("v -90 0 -90\nv 90 0 -90\nv 90 0 90\nv -90 0 90\nf 1 4 3\nf 1 3 2\n")
    result = RUN.invoke(app, ["run", str(folder / "scene.yaml"), "--out", str(folder / "walk"), "--backend", "numpy", "-q"])
    assert result.exit_code == 0, result.output
    return folder


def test_a_cache_is_made_of_which_only_the_orientations_differ(ran: Path) -> None:
    result = RUN.invoke(app, ["edit", str(ran / "walk"), "--smooth", "orient:9"])
    assert result.exit_code == 0 and "30 frames" in result.output, result.output
    old, new = open_cache(ran / "walk"), open_cache(ran / "walk_edited")
    turned = {"old": 0.0, "new": 0.0}
    last: dict[str, dict[int, np.ndarray]] = {"old": {}, "new": {}}
    for number in range(1, 31):
        one, two = old.frame(number), new.frame(number)
        assert list(one) == list(two) and all(np.array_equal(one[name], two[name]) for name in one if name != "orient")
        for name, frame in (("old", one), ("new", two)):
            for agent, orient in zip(frame["id"].tolist(), frame["orient"], strict=True):
                previous_orient = last[name].get(agent, orient)
                turned[name] += 2 * float(np.arccos(min(1.0, abs(float(previous_orient @ orient)))))
                last[name][agent] = orient
    assert len({len(old.frame(number)["id"]) for number in (1, 15, 30)}) == 3  # some were born, some have died
    assert turned["new"] < 0.95 * turned["old"]
    assert new.manifest.inputs["edit 1"] == "smooth: {}, orient: 9" and new.read_state_hashes() == old.read_state_hashes()
    checked = RUN.invoke(app, ["info", str(ran / "walk_edited"), "--verify"])
    assert checked.exit_code == 0 and "30 frames" in checked.output, checked.output
    went_on = RUN.invoke(app, ["run", str(ran / "scene.yaml"), "--out", str(ran / "walk_edited"), "--resume", "-q"])
    assert went_on.exit_code == 1  # it is no run that could go on


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--smooth", "orient:8"), 2, "odd number"),
        (("--smooth", "orient:101"), 2, "3 to 99"),
        (("--smooth", "orient"), 2, "odd number"),
        (("--smooth", "P:9"), 2, "orientations"),
        (("--smooth", "orient:9", "--out", "walk"), 2, "would be lost"),
        (("--smooth", "orient:9", "--out", "."), 3, "do not belong to a cache"),
        ((), 2, "--smooth"),
    ],
)
def test_impossible_edits_are_reported_and_nothing_is_lost(
    ran: Path, arguments: tuple[str, ...], code: int, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ran)
    initial_bytes = make_frame_path(ran / "walk", 7).read_bytes()
    result = RUN.invoke(app, ["edit", "walk", *arguments])
    said = result.output + str(getattr(result.exception, "message", ""))
    assert (getattr(result.exception, "code", None) or result.exit_code) == code and words in said, said
    assert make_frame_path(ran / "walk", 7).read_bytes() == initial_bytes


def test_damaged_frames_and_missing_orientations_are_reported(ran: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ran / "walk", "broken")
    data = bytearray(make_frame_path(Path("broken"), 12).read_bytes())
    data[len(data) // 2] ^= 1
    make_frame_path(Path("broken"), 12).write_bytes(bytes(data))
    result = RUN.invoke(app, ["edit", "broken", "--smooth", "orient:3"])
    assert result.exit_code != 0 and "frame.0012" in str(getattr(result.exception, "message", result.output))
    assert not (tmp_path / "broken_edited" / "manifest.json").exists()  # what is not finished is no cache
    text = (ran / "walk" / "manifest.json").read_text()
    (tmp_path / "broken" / "manifest.json").write_text(text.replace('"orient",', ""))
    result = RUN.invoke(app, ["edit", "broken", "--smooth", "orient:3"])
    assert "`orient`" in str(getattr(result.exception, "message", result.output))
