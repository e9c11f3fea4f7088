"""The example of moods, shown: rules with shades of truth hide a crowd from the light and let it out in the dark."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from antdsl.pipeline import RunChoices, open_scene, simulate
from antdsl.runtime import Options, bind, state_hash, step

SCENE = Path(__file__).resolve().parents[2] / "examples" / "moods" / "scene.yaml"
FORAGE, HIDE, LURK = range(3)


@pytest.fixture(scope="module")
def states() -> np.ndarray:
    """(frames, agents): the state of each roach in 8 s, of which 4 are lit."""
    shot, report = open_scene(SCENE, RunChoices(params={"roach.cycle": "8 s"}))
    assert shot is not None, report.sort_by_place()
    snapshots = [world.populations["roach"].now["main.state"].copy() for world in islice(simulate(shot), 193)]
    return np.array(snapshots)


def test_light_hides_them_and_dark_lets_them_out(states: np.ndarray) -> None:
    lit, dark = states[85:93], states[184:192]
    assert (lit == LURK).mean() > 0.6 and (lit == FORAGE).mean() < 0.2
    assert (dark == FORAGE).mean() > 0.6


def test_roaches_do_not_all_react_at_one_threshold(states: np.ndarray) -> None:
    """The light is on within a fifth of a second; the moments at which roaches run from it are spread over more than that."""
    left = [int(np.flatnonzero(own != FORAGE)[0]) for own in states.T if (own != FORAGE).any()]
    early, late = np.percentile(left, (10, 90)) / 24
    assert len(left) > 150 and late - early > 0.5
    changes = (np.diff(states, axis=0) != 0).sum(axis=0)
    assert np.percentile(changes, 90) <= 12  # in eight seconds: rates do not flicker


def test_both_backends_agree() -> None:
    shot, _ = open_scene(SCENE)
    assert shot is not None
    setting = replace(shot.setting, crowds=tuple(replace(crowd, count=10) for crowd in shot.setting.crowds))
    hashes = []
    for options in (Options(chunk=3), Options(backend="reference", shuffle_rows=1)):
        world = bind(shot.plan, setting, options)
        hashes.append([])
        for _ in range(15):
            step(world)
            hashes[-1].append(state_hash(world))
    assert hashes[0] == hashes[1]
