"""Cameras as things of notes: the crowd makes way for one that moves through it, and stays out of a ball around one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from directed import follow, open_directed

from antdsl.pipeline import open_scene

DOLLY = "{at: [-100, 8, -40], look_at: [100, 0, -40], keys: {20: {at: [-100, 8, -40]}, 80: {at: [END, 8, -40]}}}"


def measure_nearest(folder: Path, *notes: str, end: int = 20) -> np.ndarray:
    """Return how near (mm, seen from above) the nearest agent is to the moving camera in each frame."""
    open_directed(folder, count=120)
    path = folder / "scene.yaml"
    text = path.read_text().replace("[-150, 5, 40]", "[-400, 5, 40]")  # the foot stays away
    text = text.replace("cameras: {", f"cameras: {{dolly: {DOLLY}, ".replace("END", str(end)))
    path.write_text(text + ("notes:\n" if notes else "") + "".join(f"  - {note}\n" for note in notes))
    shot, report = open_scene(path)
    assert shot is not None, [each.message for each in report.errors]
    track = follow(shot, 80)
    camera = np.stack([np.interp(track.frames, [20, 80], [-100, end]), np.full(len(track.frames), -40.0)], axis=1)
    return np.linalg.norm(track.values["position"][:, :, [0, 2]] - camera[:, None], axis=2).min(axis=1)


def test_the_crowd_parts_for_a_camera_that_moves_through_it(tmp_path: Path) -> None:
    usual = measure_nearest(tmp_path / "plain")[20:]
    parted = measure_nearest(tmp_path / "parted", "{part: ant, for: dolly, distance: 40 mm}")[20:]
    assert usual.min() < 1.5 < 8 < parted.mean() and parted.min() > 1.9, (usual, parted)


def test_no_agent_is_in_a_ball_around_a_camera(tmp_path: Path) -> None:
    note = "{forbid: ant, in: {around: dolly, radius: 20 mm}, falloff: 20 mm}"
    usual, noted = (measure_nearest(tmp_path / str(len(notes)), *notes, end=-80)[20:].min() for notes in ((), (note,)))
    assert usual < 10 < 16 < noted, (usual, noted)
