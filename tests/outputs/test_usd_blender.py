"""Blender opens what is exported: agents in the colours of their states and in their poses, items where they are, a blurred still.

Run by hand or by night: `pip install bpy`, which is no dependency of antdsl."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pxr")

from test_usd_crowds import exported, recorded  # noqa: E402

from antdsl.outputs.pictures.light import decoded  # noqa: E402

pytestmark = pytest.mark.slow
FORAGING = Path(__file__).parents[2] / "examples" / "foraging"
BLENDER = Path(__file__).with_name("blender_still.py")


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A Python that has Blender: this one."""
    pytest.importorskip("bpy")
    return sys.executable


def test_blender_draws_ants_in_their_colours_and_items_in_their_places(python: str, tmp_path: Path) -> None:
    import json
    import shutil

    for path in FORAGING.iterdir():
        shutil.copy(path, tmp_path / path.name)
    cache = recorded(tmp_path, 8)
    exported(cache, tmp_path / "ants.usdc", shutter=(-0.25, 0.25))
    words = [python, str(BLENDER), str(tmp_path / "ants.usdc"), str(tmp_path / "still.png"), "5"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=True)
    told = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    arrays = cache.frame(5)
    # Blender is z up and in metres
    places = arrays["P"].astype(np.float64)[:, [0, 2, 1]] * (1, -1, 1) / 1000
    assert len(told["instances"]) == len(places)
    found = np.array(sorted(told["instances"]))
    assert np.abs(found - np.array(sorted(places.tolist()))).max() < 1e-4
    for group in cache.manifest.items:
        for name, place in zip(group.names, group.position, strict=True):
            assert math.dist(told["items"][name], (place[0] / 1000, -place[2] / 1000, place[1] / 1000)) < 1e-5
    states = cache.manifest.species[0].machines[0].states
    wanted = {tuple(np.round(decoded(np.array(states[k].colour)), 3)) for k in np.unique(arrays["state"])}
    assert {tuple(colour) for colour in told["colours"]} == wanted
    assert told["tinted"] > 20, "pixels as saturated as the states"
