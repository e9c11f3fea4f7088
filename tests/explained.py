"""A run with a record of every step, to hold explanations against: what won, what pushed, what was drawn."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from antdsl.explain import CacheHistory, Explanation, StepReplay, explain_agents, open_shot
from antdsl.numerics import randomness
from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.runtime import Options, World, bind, state_hash
from antdsl.runtime.phases import PHASES
from antdsl.scene.values import FrameRange


@dataclass
class Fact:
    """What one agent did, read off the arrays of the run itself."""

    species: str
    agent: int
    frame: int
    pending: dict[str, int]
    states: dict[str, tuple[str, str]]
    push: tuple[Any, ...]
    previous_velocity: tuple[Any, ...]  # velocity
    draws: dict[tuple[str, int], np.float32]
    next_velocity: tuple[Any, ...] | None = None
    hash: str = ""


def shot_of(scene: Path, last: int, **choices: Any) -> Shot:
    shot, report = open_scene(scene, RunChoices(frames=FrameRange(1, last), **choices))
    assert shot is not None, report.sort_by_place()
    return shot


def cached(scene: Path, last: int, folder: Path, **choices: Any) -> Cache:
    """A cache as `antdsl run` writes it; `choices` are choices of who runs it."""
    for _ in record_frames(begin_recording(shot_of(scene, last, **choices), folder, Options(), resume=False, force=False)):
        pass
    return open_cache(folder)


def facts(shot: Shot, pairs: int, monkeypatch: pytest.MonkeyPatch, seed: int) -> list[Fact]:
    """Facts of some random agents in random frames, as many of those that change their state as of the others."""
    drawn: list[tuple[str, str, int, Any, Any]] = []
    words = randomness.draw_four_words

    def noted(seed: int, frame: int, species: str, site: str, block: int, ids: Any) -> Any:
        results = words(seed, frame, species, site, block, ids)
        drawn.append((species, site, block, np.array(ids), results))
        return results

    monkeypatch.setattr(randomness, "draw_four_words", noted)
    world, picks = bind(shot.plan, shot.setting, Options()), random.Random(seed)
    steps = shot.frames.last - shot.frames.first
    chosen_frames = sorted(picks.choices(range(1, steps + 1), k=pairs))
    results: list[Fact] = []
    for number in range(1, steps + 1):
        drawn.clear()
        frame_facts: list[Fact] = []
        for name, phase in PHASES:
            if name == "effects":
                for _ in range(chosen_frames.count(number)):
                    frame_facts.append(fact_of(world, picks, drawn))
            phase(world)
        value = state_hash(world) if frame_facts else ""
        for fact in frame_facts:
            population = world.populations[fact.species]
            row = int(population.find_rows(np.array([fact.agent]))[0])
            fact.next_velocity = None if row < 0 else tuple(population.now[f"velocity.{axis}"][row] for axis in "xyz")
            fact.hash = value
        results += frame_facts
    monkeypatch.undo()
    return results


def fact_of(world: World, picks: random.Random, drawn: list[tuple[str, str, int, Any, Any]]) -> Fact:
    population = picks.choice([p for p in world.populations.values() if len(p)])
    machines = population.plan.machines
    pending = {m.name: population.now.get(f"~{m.name}.pending") for m in machines}
    changing = [row for p in pending.values() if p is not None for row in np.flatnonzero(p)]
    row = int(picks.choice(changing)) if changing and picks.random() < 0.5 else picks.randrange(len(population))
    agent = int(population.ids[row])
    draws = {}
    for species, site, block, ids, words in drawn:  # four draws of a site come from one run of the generator
        at = np.flatnonzero(ids == agent)
        if species == population.name and len(at):
            for k, word in enumerate(words):
                draws[site, 4 * block + k] = randomness.to_unit_floats(word)[at[0]]
    return Fact(
        population.name,
        agent,
        world.frame + 1,
        {name: 0 if p is None else int(p[row]) for name, p in pending.items()},
        {m.name: tuple(m.states[int(a[f"{m.name}.state"][row])] for a in (population.start, population.now)) for m in machines},
        tuple(population.now[f"push.{axis}"][row] for axis in "xyz"),
        tuple(population.start[f"velocity.{axis}"][row] for axis in "xyz"),
        draws,
    )  # fmt: skip


def explanations(cache: Cache, scene: Path, run_facts: list[Fact]) -> Iterator[tuple[Fact, Explanation]]:
    replay = StepReplay(CacheHistory.from_cache(cache, open_shot(cache, scene)))
    for frame in sorted({fact.frame for fact in run_facts}):
        mine = [fact for fact in run_facts if fact.frame == frame]
        for fact, explanation in zip(mine, explain_agents(replay, frame, [(f.species, f.agent) for f in mine]), strict=True):
            assert explanation is not None, fact
            yield fact, explanation


def differences(shot: Shot, fact: Fact, explanation: Explanation) -> list[str]:
    """In what an explanation differs from what happened."""
    wrong = [] if explanation.hash == fact.hash else ["hash"]
    program = shot.program.species[fact.species]
    for machine, step in zip(program.machines, explanation.machines, strict=True):
        transitions = [t for state in machine.states for t in state.transitions]
        number = fact.pending[machine.name]
        won = [looked for looked in step.looked if looked.wins]
        if number and [(w.place.line, w.fires) for w in won] != [
            (transitions[number - 1].span.source.find_line_column(transitions[number - 1].span.start)[0], True)
        ]:
            wrong.append(f"{machine.name}: transition {number} won, not {won}")
        if not number and (won or any(looked.fires for looked in step.looked)):
            wrong.append(f"{machine.name}: nothing won, not {won}")
        if (step.before, step.after) != fact.states[machine.name]:
            wrong.append(f"{machine.name}: {fact.states[machine.name]}, not {step.before, step.after}")
        if [looked.place.text for looked in step.looked] != [
            " ".join(t.span.text.split()) for t in next(s for s in machine.states if s.name == step.before).transitions
        ]:
            wrong.append(f"{machine.name}: not all its transitions in their order")
    if explanation.push != tuple(float(x) for x in fact.push):
        wrong.append(f"push {fact.push}, not {explanation.push}")
    total = np.zeros(3, np.float32)
    for layer in explanation.layers:
        total = total + np.array(layer.given, np.float32)
    is_complete = explanation.mode != "sum" or np.linalg.norm(total) <= 1  # else the sum is cut to 1
    if is_complete and tuple(float(x) for x in total) != explanation.push:
        wrong.append(f"the layers give {total}, not {explanation.push}")
    if explanation.velocity[0] != tuple(float(x) for x in fact.previous_velocity):
        wrong.append("velocity before")
    if fact.next_velocity is not None and explanation.velocity[1] != tuple(float(x) for x in fact.next_velocity):
        wrong.append("velocity after")
    for draw in explanation.draws:
        site, _, index = draw.site.partition("[")
        recorded_draw = fact.draws.get((site, int(index.rstrip("]") or 0)))
        if recorded_draw is None or float(recorded_draw) != draw.value:
            wrong.append(f"draw {draw.site}: {recorded_draw}, not {draw.value}")
    return wrong
