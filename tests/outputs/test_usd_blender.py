"""Blender opens what is exported: agents in the colours of their states and in their poses, items in place, a blurred still.

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

import numpy as np
import pytest

pytest.importorskip("pxr")

from test_usd_crowds import exported, recorded

from antdsl.outputs.pictures.light import decode_srgb

pytestmark = pytest.mark.slow
FORAGING = Path(__file__).parents[2] / "examples" / "foraging"
BLENDER = Path(__file__).with_name("blender_still.py")


@pytest.fixture(scope="module")
def python() -> str:
    """A Python that has Blender. It is a separate process, since Blender has another USD in it."""
    if find_spec("bpy") is not None:
        return sys.executable
    return os.environ.get("BLENDER_PYTHON") or pytest.skip("there is no Blender (bpy)")


def _alone() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def test_blender_draws_ants_in_their_colours_and_items_in_their_places(python: str, tmp_path: Path) -> None:
    for path in FORAGING.iterdir():
        shutil.copy(path, tmp_path / path.name)
    cache = recorded(tmp_path, 8)
    exported(cache, tmp_path / "ants.usdc", shutter=(-0.25, 0.25))
    words = [python, str(BLENDER), str(tmp_path / "ants.usdc"), str(tmp_path / "still.png"), "5"]
    process = subprocess.run(words, capture_output=True, text=True, timeout=900, env=_alone())
    assert process.returncode == 0, process.stderr[-2000:]
    report = json.loads(next(line for line in process.stdout.splitlines() if line.startswith("{")))
    arrays = cache.frame(5)
    # Blender is z up and in metres
    positions = arrays["P"].astype(np.float64)[:, [0, 2, 1]] * (1, -1, 1) / 1000
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
