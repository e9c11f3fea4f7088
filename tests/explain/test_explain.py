"""`antdsl explain`: what it tells is what happened, and telling changes nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from explained import cached, differences, explanations, facts, shot_of
from sampling import sampled

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SHORT = {"foraging": 10, "flocking": 14, "moods": 20, "alarm": 54, "tunnel": 10}
LONG = {"foraging": 400, "flocking": 120, "moods": 200, "alarm": 150, "tunnel": 240, "worth": 200, "flow": 240, "anthill": 120}


@pytest.mark.parametrize("name", sampled(SHORT, ("foraging", "flocking", "alarm")))
def test_explanations_agree_with_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Transition, push, velocity and draws of 12 random agents and frames each, read off the run itself."""
    _held_against(name, SHORT[name], 12, tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_explanations_agree_with_runs_a_thousand_times(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _held_against(name, LONG[name], 125, tmp_path, monkeypatch)


def _held_against(name: str, last: int, pairs: int, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = EXAMPLES / name / "scene.yaml"
    cache = cached(scene, last, folder / "cache")
    shot = shot_of(scene, last)
    run_facts = facts(shot, pairs, monkeypatch, seed=len(name))
    wrong = {}
    count = 0
    for fact, explanation in explanations(cache, scene, run_facts):
        count += 1
        differ = differences(shot, fact, explanation)
        if differ:
            wrong[fact.species, fact.agent, fact.frame] = differ
    assert count == pairs
    assert not wrong
    print(name, count, "changes", sum(any(f.pending.values()) for f in run_facts), "draws", sum(len(f.draws) for f in run_facts))
