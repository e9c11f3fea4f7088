"""The example of a battle, shown: strength goes by strikes alone, who strikes has its enemy before it, and the fallen leave."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from antdsl.pipeline import open_scene
from antdsl.runtime import bind, step

SCENE = Path(__file__).resolve().parents[2] / "examples" / "battle" / "scene.yaml"
EACH, FRAMES = 40, 165
REACH, LIE = 7.0, 120  # of the params: mm, and 5 s in frames
Array = NDArray[np.float64]


@dataclass
class Fight:
    """By frame and id, NaN for agents that left: strength, the chosen opponent, number of its state, place and heading."""

    group: Array
    states: tuple[str, ...]
    strength: Array = field(default_factory=lambda: np.full((FRAMES, 2 * EACH), np.nan))
    enemy: Array = field(default_factory=lambda: np.full((FRAMES, 2 * EACH), np.nan))
    state: Array = field(default_factory=lambda: np.full((FRAMES, 2 * EACH), np.nan))
    place: Array = field(default_factory=lambda: np.full((FRAMES, 2 * EACH, 3), np.nan))
    heading: Array = field(default_factory=lambda: np.full((FRAMES, 2 * EACH, 3), np.nan))

    def strikes(self, frame: int) -> NDArray[np.intp]:
        """Who struck in the step to that frame."""
        strike = self.states.index("strike")
        return np.flatnonzero((self.state[frame] == strike) & (self.state[frame - 1] != strike))


@pytest.fixture(scope="module")
def fight() -> Fight:
    """Two sides of 40, with their middles 90 mm apart."""
    shot, report = open_scene(SCENE)
    assert shot is not None, report.sort_by_place()
    crowds = [
        replace(crowd, count=EACH, place=replace(crowd.place, disc_centre=(x, 0.0, 0.0), radius=25.0))
        for x, crowd in zip((-45.0, 45.0), shot.setting.crowds, strict=True)
    ]
    world = bind(shot.plan, replace(shot.setting, crowds=tuple(crowds)))
    ants = world.populations["soldier"]
    fight_record = Fight(
        ants.now["group"][ants.get_rows_by_id()].copy(), next(m.states for m in ants.plan.machines if m.name == "deeds")
    )
    for frame in range(FRAMES):
        step(world)
        rows = ants.get_rows_by_id()
        ids = ants.ids[rows]
        fight_record.strength[frame, ids] = ants.now["strength"][rows]
        fight_record.enemy[frame, ids] = ants.now["enemy"][rows]
        fight_record.state[frame, ids] = ants.now["deeds.state"][rows]
        for name, into in (("position", fight_record.place), ("heading", fight_record.heading)):
            into[frame, ids] = np.stack([ants.now[f"{name}.{part}"][rows] for part in "xyz"], axis=1)
    return fight_record


def test_who_strikes_has_an_enemy_before_it_and_within_reach(fight: Fight) -> None:
    struck = 0
    for frame in range(1, FRAMES):
        who = fight.strikes(frame)
        targets = fight.enemy[frame, who].astype(int)
        displacement = fight.place[frame - 1, targets] - fight.place[frame - 1, who]
        far = np.linalg.norm(displacement, axis=1)
        ahead = np.einsum("nc,nc->n", displacement, fight.heading[frame - 1, who]) / far
        assert (fight.group[targets] != fight.group[who]).all()
        assert (far < REACH * 1.0001).all() and (ahead > 0.7).all()
        struck += len(who)
    assert struck > 60


def test_strength_goes_by_strikes_alone_and_once_a_step(fight: Fight) -> None:
    for frame in range(1, FRAMES - 1):
        lost = fight.strength[frame] - fight.strength[frame + 1]  # NaN for who has left
        struck = np.unique(fight.enemy[frame, fight.strikes(frame)])
        survivors = struck[~np.isnan(lost[struck.astype(int)])] if len(struck) else struck
        assert np.flatnonzero(lost > 0).tolist() == survivors.tolist()
        assert np.allclose(lost[lost > 0], 1, atol=1e-5) and not (lost < 0).any()


def test_who_has_no_strength_falls_lies_there_and_leaves(fight: Fight) -> None:
    fallen = fight.state == fight.states.index("fallen")
    alive = (fight.strength > 0).sum(axis=1)
    assert (np.diff(alive) <= 0).all() and alive[0] == 2 * EACH and alive[-1] < EACH + EACH // 2
    assert ((fight.strength <= 0) == fallen)[1:].mean() > 0.99  # it falls in the step after the strike at the latest
    left = np.isnan(fight.strength[-1])
    assert 0 < left.sum() < 2 * EACH
    assert set(fallen[:, left].sum(axis=0)) <= {LIE, LIE + 1}
    # They lie where they fell, but for coming to a stand.
    for one in np.flatnonzero(left):
        frames = np.flatnonzero(fallen[:, one])
        assert np.linalg.norm(fight.place[frames[-1], one] - fight.place[frames[0], one]) < 4
