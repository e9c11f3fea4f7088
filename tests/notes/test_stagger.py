"""Notes that are later for some agents than for others: waves from a target, one after the other."""

from __future__ import annotations

from pathlib import Path

import commands
import numpy as np
import pytest
from directed import Track, follow, open_directed, row_of, start

from antdsl.pipeline import open_scene
from antdsl.runtime import World, step


def find_stops(track: Track) -> np.ndarray:
    """The frames (2, agents) from the first to the last in which each agent stands still."""
    is_still = track.speeds() < 0.1
    frames = np.array(track.frames[1:])
    return np.array([frames[is_still.argmax(axis=0)], frames[len(frames) - 1 - is_still[::-1].argmax(axis=0)]])


@pytest.mark.parametrize("ends", ["later", "together"])
def test_a_freeze_spreads_from_a_point(tmp_path: Path, ends: str) -> None:
    wave = f"{{from: [20, 0, 0], speed: 120 mm/s, ends: {ends}}}"
    track = follow(open_directed(tmp_path, f"{{hold: guards, frames: 20..60, ease: 0, stagger: {wave}}}"), 110)
    start = track.values["position"][track.frames.index(19)]
    expected = 20 + np.linalg.norm(start - [20, 0, 0], axis=1) / 120 * 24  # the point is dropped onto the ground, some mm off
    first, last = find_stops(track)
    is_free = (np.abs(start[:, 2] - 40) > 45) | (start[:, 0] > 110)  # of the foot, which pushes agents that stand still
    assert is_free.sum() > 30 and len(set(first[is_free].tolist())) > 10
    assert np.abs(first - expected)[is_free].max() < 1.5
    assert (last == 60)[is_free].all() if ends == "together" else (last - first == 40)[is_free].all()


def test_agents_do_something_one_after_the_other(tmp_path: Path) -> None:
    notes = "{hold: guards, frames: 20..30, ease: 0, stagger: {each: 1}}"
    first, last = find_stops(follow(open_directed(tmp_path / "ids", notes), 100))
    assert (first == 20 + np.arange(60)).mean() > 0.95 and (last == 30 + np.arange(60)).mean() > 0.9  # the foot pushes some
    track = follow(open_directed(tmp_path / "near", notes.replace("each: 1", "each: 1, from: leaf")), 100)
    distance = np.linalg.norm(track.values["position"][track.frames.index(19)] - track.world.items["leaves"].position[0], axis=1)
    assert (find_stops(track)[0] == 20 + np.argsort(np.argsort(distance))).mean() > 0.9


def test_agents_reach_a_target_and_change_and_look_one_after_the_other(tmp_path: Path) -> None:
    stagger = "stagger: {each: 10}"
    shot = open_directed(
        tmp_path,
        f"{{path: guards.0..2, along: [[-40, 0, 0], [40, 0, 0]], frames: 130..220, {stagger}}}",
        f"{{change: guards.10..12, to: rest, frame: 20, {stagger}}}",
        f"{{look: guards.20..22, at: {{head: leaf}}, frames: 20..25, ease: 0, {stagger}}}",
        last=250,
    )
    looks: dict[int, list[int]] = {20: [], 21: [], 22: []}

    def record_looks(world: World) -> None:
        states = world.populations["ant"].now["notes_look_head.state"]
        for agent, frames in looks.items():
            frames += [world.frame] if states[row_of(world, agent)] else []

    track = follow(shot, 250, record_looks, names=("mood",))
    for k in range(3):
        for frame, x in ((130, -40), (220, 40)):
            position = track.at("position", frame + 10 * k, k)
            assert np.linalg.norm(position[[0, 2]] - [x, 0]) < 8, (k, frame, position)
        mood = track.of("mood", 10 + k)
        assert track.frames[int((mood == 5).argmax())] == 20 + 10 * k
        assert looks[20 + k] == list(range(20 + 10 * k, 26 + 10 * k))


def test_a_note_waits_for_a_target_that_appears_later(tmp_path: Path) -> None:
    """The target appears in frame 30: the nearest agents stop first, though the note begins, with its ease, before that."""
    open_directed(tmp_path)
    scene = tmp_path / "scene.yaml"
    place = "{on: ground, around: [20, 0, 20], radius: 1 mm}"
    scene.write_text(f"""{scene.read_text()}
  - {{name: queen, species: ant, from: a.ant, frames: 30..30, rate: 24 /s, place: {place}}}
notes:
  - {{hold: guards, frames: 24..90, ease: 4, stagger: {{each: 1, from: queen, ends: together}}}}
""")
    shot, report = open_scene(scene)
    assert shot is not None, report.diagnostics
    world = start(shot)
    positions = [world.populations["ant"].position.copy()]
    while world.frame < 88:
        step(world)
        population = world.populations["ant"]
        positions.append(population.position[population.find_rows(np.arange(60))].copy())
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=2) / world.dt
    stops = (speed < 0.1).argmax(axis=0)
    assert world.populations["ant"].ids.max() == 60 and stops.min() >= 28
    distance = np.linalg.norm(positions[29] - np.array([20, 0, 20]), axis=1)
    assert np.corrcoef(np.argsort(np.argsort(distance)), stops)[0, 1] > 0.9


def test_a_cache_with_looks_has_readable_checkpoints(tmp_path: Path) -> None:
    """Members of archives have names without blanks."""
    open_directed(
        tmp_path, "{look: guards.1, at: {head: leaf}, frames: 3..5}", "{play: guards.2, clip: walk, frames: 3..5}", last=6
    )
    scene = tmp_path / "scene.yaml"
    scene.write_text(scene.read_text() + "output: {checkpoint: 2}\n")
    assert commands.run("run", "scene.yaml", "--out", "cache", cwd=tmp_path).returncode == 0
    result = commands.run("info", "cache", "--verify", cwd=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    result = commands.run("explain", "cache", "--species", "ant", "--agent", "1", "--frame", "5", cwd=tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
