"""Notes that are later for some agents than for others: waves from a target, one after the other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from directed import Track, follow, open_directed, row_of

from antdsl.runtime import World


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
