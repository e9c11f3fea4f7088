"""Blender opens what is exported: agents in their poses and colours, items in place, a blurred still.

Skipped without Blender, which is no dependency of antdsl: `pip install bpy` (Python 3.11), or say in the environment variable
BLENDER_PYTHON which Python has it."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

pytest.importorskip("pxr")

from test_usd_crowds import exported, recorded

from antdsl.bodies.body import build_rotation_matrices
from antdsl.outputs.cache.cache_reader import Cache
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.light import decode_srgb

pytestmark = pytest.mark.slow
FORAGING = Path(__file__).parents[2] / "examples" / "foraging"
FRAMES, FEW = (1, 4, 8), 12


def _run_blender(script: str, *words: str) -> Any:
    """Run a script beside this file in a Python that has Blender, and return the JSON that it prints.

    It is a separate process, since Blender has another USD in it."""
    path = os.environ.get("BLENDER_PYTHON") or (sys.executable if find_spec("bpy") is not None else None)
    python = path or pytest.skip("there is no Blender (bpy)")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [python, str(Path(__file__).with_name(script)), *words]
    process = subprocess.run(command, capture_output=True, text=True, timeout=900, env=environment)
    assert process.returncode == 0, process.stderr[-2000:]
    return json.loads(next(line for line in process.stdout.splitlines() if line.startswith("{")))


@pytest.fixture(scope="module")
def foragers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the foraging example."""
    return Path(shutil.copytree(FORAGING, tmp_path_factory.mktemp("foraging") / "scene"))


@pytest.fixture(scope="module")
def few(foragers: Path, tmp_path_factory: pytest.TempPathFactory) -> Cache:
    """A few ants, on their feet."""
    folder = Path(shutil.copytree(foragers, tmp_path_factory.mktemp("few") / "scene"))
    text = (folder / "scene.yaml").read_text()
    (folder / "scene.yaml").write_text(text.replace("count: 500", f"count: {FEW}"))
    return recorded(folder, max(FRAMES))


def _to_blender(points: np.ndarray) -> np.ndarray:
    """Return points of a scene (y up, mm) in the axes of Blender (z up, metres)."""
    return points[:, [0, 2, 1]] * (1, -1, 1) / 1000


@pytest.mark.parametrize("shows_states", [False, True], ids=["natural", "states"])
def test_blender_poses_and_colours_agents_without_any_option(few: Cache, tmp_path: Path, shows_states: bool) -> None:
    exported(few, tmp_path / "ants.usdc", states=shows_states)
    report = _run_blender("blender_crowd.py", str(tmp_path / "ants.usdc"), *map(str, FRAMES))
    assert len(report) == FEW
    poses: dict[int, list[np.ndarray]] = {}
    first = Gallery(few, shows_states=shows_states).make_picture(FRAMES[0]).crowds[0]
    colours = dict(zip(np.asarray(first.ids).tolist(), first.colour, strict=True))
    for frame in FRAMES:
        crowd = Gallery(few, shows_states=shows_states).make_picture(frame).crowds[0]
        assert crowd.body is not None and crowd.ids is not None
        posed = crowd.body.compute_shape_points(crowd.compute_poses())[0]
        for k, name in enumerate(crowd.ids.tolist()):
            agent = report[f"agent_{name}"]
            assert {each.partition(".")[0] for each in agent["materials"]} == {"head", "jaw", "leg", "state", "thorax"}
            own, turn = posed[k] * crowd.scale[k], build_rotation_matrices(crowd.orient[k : k + 1])[0]
            seen_points, points = np.array(agent["points"][str(frame)]), _to_blender(own @ turn.T + crowd.position[k])
            assert len(seen_points) == len(points)
            assert np.abs(np.ptp(seen_points, axis=0) - np.ptp(points, axis=0)).max() < 0.002 * crowd.scale[k] / 1000
            assert cKDTree(seen_points).query(points)[0].max() < 0.002 * crowd.scale[k] / 1000
            assert np.allclose(agent["colours"], decode_srgb(np.asarray(colours[name])), atol=0.01)
            poses.setdefault(name, []).append(posed[k])
    assert all(np.abs(one[k] - one[0]).max() > 0.05 for one in poses.values() for k in (1, 2)), "legs move"


def test_blender_draws_ants_in_their_colours_and_items_in_their_places(foragers: Path, tmp_path: Path) -> None:
    cache = recorded(foragers, 8)
    exported(cache, tmp_path / "ants.usdc", states=True, shutter=(-0.25, 0.25))
    report = _run_blender("blender_still.py", str(tmp_path / "ants.usdc"), str(tmp_path / "still.png"), "5")
    arrays = cache.frame(5)
    positions = _to_blender(arrays["P"].astype(np.float64))
    assert len(report["instances"]) == len(positions)
    instances = np.array(sorted(report["instances"]))
    assert np.abs(instances - np.array(sorted(positions.tolist()))).max() < 1e-4
    for group in cache.manifest.items:
        for name, place in zip(group.names, group.position, strict=True):
            assert math.dist(report["items"][name], (place[0] / 1000, -place[2] / 1000, place[1] / 1000)) < 1e-5
    states = cache.manifest.species[0].machines[0].states
    expected = sorted(decode_srgb(np.array(states[k].colour)).tolist() for k in np.unique(arrays["state"]).tolist())
    assert np.allclose(sorted(report["colours"]), expected, atol=2e-3)
    assert report["tinted"] > 20, "pixels as saturated as the states"
