"""The example of an alarm, shown: the wave reaches those far off and ends; each ant has only so much alarm in it."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import meshes
import numpy as np
import pytest
from meaning import crowd, play

from antdsl.pipeline import RunChoices, open_scene, simulate
from antdsl.scene.setting import MeshData

SCENE = Path(__file__).resolve().parents[2] / "examples" / "alarm" / "scene.yaml"
CALM, FRIGHT, WARY = range(3)
STAB = 48  # frames


def run(frames: int, **params: str) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """States (frames, ants), the position of each at the stab, and the alarm there is, frame by frame, ants in order of id."""
    shot, report = open_scene(SCENE, RunChoices(params={f"ant.{name}": text for name, text in params.items()}))
    assert shot is not None, report.sort_by_place()
    states, scent, place = [], [], np.zeros(0)
    for k, world in enumerate(islice(simulate(shot), frames)):
        ants = world.populations["ant"]
        rows = ants.get_rows_by_id()
        states.append(ants.now["main.state"][rows].copy())
        scent.append(float(world.fields["alarm"].amounts.sum()))
        place = ants.position[rows, 0].copy() if k == STAB else place
    return np.array(states), place, scent


@pytest.fixture(scope="module")
def wave() -> tuple[np.ndarray, np.ndarray, list[float]]:
    return run(140)


def test_the_wave_reaches_far_ants_one_after_the_other(wave: tuple[np.ndarray, np.ndarray, list[float]]) -> None:
    states, x, _ = wave
    assert (states[: STAB - 1] == CALM).all()
    frightened = (states == FRIGHT).any(axis=0)
    assert frightened[x > 60].mean() > 0.9 and (x > 60).sum() > 30  # the stab was at -100
    when = np.argmax(states == FRIGHT, axis=0)
    near, middle, far = (np.median(when[frightened & (x > low) & (x <= low + 40)]) for low in (-110, -20, 70))
    assert near < middle < far and far - near > 10  # frames


def test_it_passes_and_ends(wave: tuple[np.ndarray, np.ndarray, list[float]]) -> None:
    states, _, scent = wave
    assert (states[-1] == CALM).all() and scent[-1] < 0.02 * max(scent)
    assert ((np.diff((states == FRIGHT).astype(int), axis=0) == 1).sum(axis=0) <= 2).all()  # no ant goes round and round


def test_without_scent_only_those_who_were_stabbed_at_take_fright() -> None:
    states, x, scent = run(90, shout="0 /s")
    frightened = (states == FRIGHT).any(axis=0)
    assert 0 < frightened.sum() < 40 and (x[frightened] < -70).all() and max(scent) == 0


def test_scent_that_is_limited_runs_out_and_recovers() -> None:
    """An ant lays what it lays, no more than it has in it; at rest it fills up again (T40)."""
    text = """species a { x = 0
laid = 0
store = 1 relax to 1 over 2 s
response 1 step
on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s) }
start lay
state lay { deposit mark 10 /s * store; laid += 10 /s * store; store -= 400 %/s * store; x = mark; when after 2 s -> rest }
state rest { x = mark; when after 4 s -> lay } }"""
    world = "ant 1\nworld { surface ground }\nfield mark on ground { cell 10 mm }\n"
    history = play(text, crowd(), steps=60, world=world, surfaces={"ground": MeshData(*meshes.grid(200, 10))})
    store, laid = history.every("store"), history.every("laid")
    assert store[20] < 0.15 and store[-1] > 0.8  # used up in two seconds, back after four
    assert laid[20] == pytest.approx(history.every("x")[22], rel=1e-4) and laid[22] == laid[-1] < 10 * 2 * 0.4
