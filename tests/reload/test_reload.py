"""Edited programs that take over from running ones: what is kept, under hundreds of random edits; and the words about it."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from edited_programs import Herd, Project, broken, edited, first_project, kept_state, kept_value, survivors

from antdsl.preview import Session
from antdsl.runtime import World


def herds(world: World) -> dict[str, Herd]:
    """Copies of all that agents are, rows by id."""
    found = {}
    for name, population in world.populations.items():
        rows = population.in_id_order()
        machine = population.plan.machines[0]
        states = population.now[f"{machine.name}.state"][rows]
        kept = {r: population.now[r][rows] for r, made in population.plan.registers.items() if made.role != "temp"}
        memories = {
            state: {r: a for r, a in kept.items() if r.startswith(f"{name}.{machine.name}.{state}.wander")}
            for state in machine.states
        }
        found[name] = Herd(
            [int(i) for i in population.ids[rows]],
            population.position[rows],
            [machine.states[k] for k in states],
            kept,
            memories,
            population.next_id,
        )
    return found


def check_kept(old: Project, new: Project, before: dict[str, Herd], world: World) -> None:
    after = herds(world)
    assert set(after) == set(new.species)
    for name, species in new.species.items():
        now, plan = after[name], world.populations[name].plan
        assert plan.machines[0].states == tuple(species.states)
        assert {a for a in plan.registers if plan.registers[a].holds and plan.registers[a].role == "attribute"} >= set(
            species.attributes
        )
        if name not in old.species:
            assert now.ids == list(range(species.count))
            assert set(now.state) <= {species.start}
            continue
        was, then = old.species[name], before[name]
        stay = survivors(was, species, then.ids)
        more = max(0, species.count - was.count)
        assert now.ids == stay + list(range(then.next_id, then.next_id + more))
        rows = np.searchsorted(then.ids, stay)
        first = len(stay)
        if (old.cells, old.height) == (new.cells, new.height):
            assert np.array_equal(now.position[:first], then.position[rows])
        lost = np.array([then.state[k] not in species.states for k in rows], np.bool_)
        assert now.state[:first] == [kept_state(species, then.state[k]) for k in rows]
        assert now.state[first:] == [species.start] * more
        time = f"{plan.machines[0].name}.time_in_state"
        assert np.array_equal(now.values[time][:first], np.where(lost, 0, then.values[time][rows]))
        for attribute in species.attributes:
            known = then.values.get(attribute, np.zeros(len(then.ids), np.float32))[rows]
            assert np.array_equal(now.values[attribute][:first], kept_value(was, species, attribute, known)), attribute
            assert (now.values[attribute][first:] == species.attributes[attribute].value).all()
        for register in (r for r in now.values if r.endswith(".held")):
            known = then.values.get(register, np.zeros(len(then.ids), np.float32))[rows]
            assert np.array_equal(now.values[register][:first], known)
        for state, strolls in species.states.items():
            assert bool(now.memories[state]) == strolls
            for register, array in now.memories[state].items():
                kept = was.states.get(state, False)
                assert np.array_equal(
                    array[:first], then.memories[state][register][rows] if kept else np.zeros(first, array.dtype)
                )


def amounts(world: World) -> dict[str, float]:
    food = world.items["food"]
    return dict(zip(food.names, food.amounts["load"].tolist(), strict=True))


def save(folder: Path, name: str, text: str | None) -> None:
    if text is None:
        (folder / name).unlink()
    else:
        (folder / name).write_text(text)


def opened(folder: Path, project: Project) -> Session:
    project.save(folder)
    session, report = Session.open(folder / "scene.yaml", every=16, budget=8_000_000)
    assert session is not None, [d.message for d in report.errors]
    return session


def chaos(folder: Path, edits: int, seed: int) -> Counter[str]:
    """Random edits of a running scene, each checked; counts of what happened."""
    rng, seen = random.Random(seed), Counter[str]()
    project = first_project()
    session = opened(folder, project)
    made = {session.timeline.at(session.frame): project}  # of each stretch of time
    for _ in range(edits):
        for _ in range(rng.randrange(1, 4)):
            session.step()
        if rng.random() < 0.3:
            wrong = broken(project, rng)
            for name, text in wrong.items():
                save(folder, name, text)
            state, world = session.hash, session.world
            outcome = session.reload()
            assert not outcome.ok, wrong
            assert outcome.report.errors
            assert session.world is world
            assert session.hash == state
            session.step()  # and runs on
            seen["broken"] += 1
            project.save(folder)
            continue
        if rng.random() < 0.2:
            session.seek(rng.randint(session.first, session.head))
            seen["branched"] += 1
        old = made[session.timeline.at(session.frame)]
        food = session.world.items["food"].amounts["load"]
        food -= np.minimum(food, rng.randrange(3))
        new, before, scent = edited(project, rng), herds(session.world), session.world.fields["trail"].values.copy()
        eaten, frame = amounts(session.world), session.frame
        if rng.random() < 0.3:  # a save that another follows before the first has come to rest
            for name, text in (broken(project, rng) if rng.random() < 0.5 else edited(project, rng).texts()).items():
                save(folder, name, text)
            session.foresee()
        new.save(folder)
        if rng.random() < 0.5:
            session.foresee()
            seen["foreseen"] += 1
        outcome = session.reload()
        assert outcome.ok, [d.message for d in outcome.report.errors]
        assert session.frame == frame
        check_kept(old, new, before, session.world)
        for name, load in new.items.items():
            assert amounts(session.world)[name] == (eaten[name] if old.items.get(name) == load else load)
        same_cells = (old.cell, old.cells, old.height) == (new.cell, new.cells, new.height)
        trail = session.world.fields["trail"].values
        assert np.array_equal(trail, scent) if same_cells else not trail.any()
        seen["taken over" if outcome.line != "nothing has changed" else "the same"] += 1
        made[session.timeline.at(session.frame)] = project = new
    return seen


@pytest.mark.slow
def test_forty_edits_keep_what_must_be_kept(tmp_path: Path) -> None:
    seen = chaos(tmp_path, 40, seed=1)
    assert seen["taken over"] > 10
    assert seen["broken"] > 3 and seen["foreseen"] > 5


@pytest.mark.slow
def test_five_hundred_edits_keep_what_must_be_kept(tmp_path: Path) -> None:
    seen = chaos(tmp_path, 500, seed=2)
    assert seen["taken over"] > 200
    assert seen["broken"] > 80 and seen["foreseen"] > 100
