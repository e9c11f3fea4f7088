"""A session with a record of every step, while it is edited, to hold explanations against."""

from __future__ import annotations

import random
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from explained import Fact, differences, fact_of

from antdsl.numerics import randomness
from antdsl.preview import PreviewSession
from antdsl.preview.observing.explainer import Explainer
from antdsl.runtime import World, phases

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def session_of(name: str, folder: Path, **how: Any) -> PreviewSession:
    """A session on a copy of an example, so that it can be edited."""
    shutil.copytree(EXAMPLES / name, folder / name)
    session, report = PreviewSession.open(folder / name / "scene.yaml", **how)
    assert session is not None, report.sort_by_place()
    return session


class Notes:
    """Writes down what random agents do in each step of a session, half of them such as change their state."""

    def __init__(self, session: PreviewSession, monkeypatch: pytest.MonkeyPatch, seed: int, each: int) -> None:
        self.session, self.each, self.facts = session, each, list[Fact]()
        self._picks, self._drawn, self._here = random.Random(seed), list[Any](), list[Fact]()
        words = randomness.draw_four_words

        def noted(seed: int, frame: int, species: str, site: str, block: int, ids: Any) -> Any:
            values = words(seed, frame, species, site, block, ids)
            self._drawn.append((species, site, block, np.array(ids), values))
            return values

        monkeypatch.setattr(randomness, "draw_four_words", noted)
        at = [name for name, _ in phases.PHASES].index("effects")
        observed = (*phases.PHASES[:at], ("noted", self._note), *phases.PHASES[at:])
        monkeypatch.setattr(phases, "PHASES", observed)

    def _note(self, world: World) -> None:
        if world is self.session.world:  # and not one in which something is explained
            self._here += [fact_of(world, self._picks, self._drawn) for _ in range(self.each)]

    def go(self, frames: int) -> None:
        """Step, and write down what happens; what was written of these frames before is forgotten."""
        for _ in range(frames):
            self._drawn.clear()
            self._here.clear()
            self.facts = [fact for fact in self.facts if fact.frame <= self.session.frame]
            self.session.step()
            for fact in self._here:
                population = self.session.world.populations[fact.species]
                row = int(population.find_rows(np.array([fact.agent]))[0])
                velocity = None if row < 0 else tuple(population.now[f"velocity.{axis}"][row] for axis in "xyz")
                self.facts.append(replace(fact, next_velocity=velocity, hash=self.session.state_hash))

    def explained_otherwise(self, count: int) -> dict[tuple[str, int, int], list[str]]:
        """In what explanations of so many facts, picked at random, differ from them."""
        explainer, wrong = Explainer(self.session), {}
        for fact in self._picks.sample(self.facts, count):
            [answer] = explainer.explain([(fact.species, fact.agent)], fact.frame)
            assert answer is not None
            shot = self.session.timeline.find_stretch(fact.frame - 1).shot
            differ = differences(shot, fact, answer.explanation)
            if differ:
                wrong[fact.species, fact.agent, fact.frame] = differ
        return wrong
