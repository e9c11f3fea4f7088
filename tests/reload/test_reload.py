"""Edited programs that take over from running ones: what continues, under hundreds of random edits; and the words about it."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from edited_programs import Herd, Project, broken, edited, first_project, state_or_start, survivors, value_after_edit

from antdsl.preview import PreviewSession
from antdsl.runtime import World


def herds(world: World) -> dict[str, Herd]:
    """Copies of all that agents are, rows by id."""
    herds_by_name = {}
    for name, population in world.populations.items():
        rows = population.get_rows_by_id()
        machine = population.plan.machines[0]
        states = population.now[f"{machine.name}.state"][rows]
        registers = {
            r: population.now[r][rows] for r, definition in population.plan.registers.items() if definition.role != "temp"
        }
        memories = {
            state: {r: a for r, a in registers.items() if r.startswith(f"{name}.{machine.name}.{state}.wander")}
            for state in machine.states
        }
        herds_by_name[name] = Herd(
            [int(i) for i in population.ids[rows]],
            population.position[rows],
            [machine.states[k] for k in states],
            registers,
            memories,
            population.next_id,
        )
    return herds_by_name


def check_migration(old: Project, new: Project, old_herds: dict[str, Herd], world: World) -> None:
    new_herds = herds(world)
    assert set(new_herds) == set(new.species)
    for name, species in new.species.items():
        now, plan = new_herds[name], world.populations[name].plan
        assert plan.machines[0].states == tuple(species.states)
        assert {a for a in plan.registers if plan.registers[a].language_type and plan.registers[a].role == "attribute"} >= set(
            species.attributes
        )
        if name not in old.species:
            assert now.ids == list(range(species.count))
            assert set(now.state) <= {species.start}
            continue
        was, then = old.species[name], old_herds[name]
        stay = survivors(was, species, then.ids)
        born_count = max(0, species.count - was.count)
        assert now.ids == stay + list(range(then.next_id, then.next_id + born_count))
        rows = np.searchsorted(then.ids, stay)
        first = len(stay)
        if (old.cells, old.height) == (new.cells, new.height):
            assert np.array_equal(now.position[:first], then.position[rows])
        lost = np.array([then.state[k] not in species.states for k in rows], np.bool_)
        assert now.state[:first] == [state_or_start(species, then.state[k]) for k in rows]
        assert now.state[first:] == [species.start] * born_count
        time = f"{plan.machines[0].name}.time_in_state"
        assert np.array_equal(now.values[time][:first], np.where(lost, 0, then.values[time][rows]))
        for attribute in species.attributes:
            known = then.values.get(attribute, np.zeros(len(then.ids), np.float32))[rows]
            assert np.array_equal(now.values[attribute][:first], value_after_edit(was, species, attribute, known)), attribute
            assert (now.values[attribute][first:] == species.attributes[attribute].value).all()
        for register in (r for r in now.values if r.endswith(".held")):
            known = then.values.get(register, np.zeros(len(then.ids), np.float32))[rows]
            assert np.array_equal(now.values[register][:first], known)
        for state, strolls in species.states.items():
            assert bool(now.memories[state]) == strolls
            for register, array in now.memories[state].items():
                is_known_state = was.states.get(state, False)
                assert np.array_equal(
                    array[:first], then.memories[state][register][rows] if is_known_state else np.zeros(first, array.dtype)
                )


def amounts(world: World) -> dict[str, float]:
    food = world.items["food"]
    return dict(zip(food.names, food.amounts["load"].tolist(), strict=True))


def save(folder: Path, name: str, text: str | None) -> None:
    if text is None:
        (folder / name).unlink()
    else:
        (folder / name).write_text(text)


def opened(folder: Path, project: Project) -> PreviewSession:
    project.save(folder)
    session, report = PreviewSession.open(folder / "scene.yaml", checkpoint_interval=16, budget=8_000_000)
    assert session is not None, [d.message for d in report.errors]
    return session


def chaos(folder: Path, edits: int, seed: int) -> Counter[str]:
    """Random edits of a running scene, each checked; counts of what happened."""
    rng, counts = random.Random(seed), Counter[str]()
    project = first_project()
    session = opened(folder, project)
    project_by_stretch = {session.timeline.find_stretch(session.frame): project}  # of each stretch of time
    for _ in range(edits):
        for _ in range(rng.randrange(1, 4)):
            session.step()
        if rng.random() < 0.3:
            wrong = broken(project, rng)
            for name, text in wrong.items():
                save(folder, name, text)
            state, world = session.state_hash, session.world
            outcome = session.reload()
            assert not outcome.is_successful, wrong
            assert outcome.report.errors
            assert session.world is world
            assert session.state_hash == state
            session.step()  # and runs on
            counts["broken"] += 1
            project.save(folder)
            continue
        if rng.random() < 0.2:
            session.seek(rng.randint(session.first_frame, session.last_frame))
            counts["branched"] += 1
        old = project_by_stretch[session.timeline.find_stretch(session.frame)]
        food = session.world.items["food"].amounts["load"]
        food -= np.minimum(food, rng.randrange(3))
        new, old_herds, scent = edited(project, rng), herds(session.world), session.world.fields["trail"].amounts.copy()
        eaten, frame = amounts(session.world), session.frame
        if rng.random() < 0.3:  # a save that another follows before the first has come to rest
            for name, text in (broken(project, rng) if rng.random() < 0.5 else edited(project, rng).texts()).items():
                save(folder, name, text)
            session.precompile()
        new.save(folder)
        if rng.random() < 0.5:
            session.precompile()
            counts["foreseen"] += 1
        outcome = session.reload()
        assert outcome.is_successful, [d.message for d in outcome.report.errors]
        assert session.frame == frame
        check_migration(old, new, old_herds, session.world)
        for name, load in new.items.items():
            assert amounts(session.world)[name] == (eaten[name] if old.items.get(name) == load else load)
        same_cells = (old.cell, old.cells, old.height) == (new.cell, new.cells, new.height)
        trail = session.world.fields["trail"].amounts
        assert np.array_equal(trail, scent) if same_cells else not trail.any()
        counts["taken over" if outcome.line != "nothing has changed" else "the same"] += 1
        project_by_stretch[session.timeline.find_stretch(session.frame)] = project = new
    return counts


@pytest.mark.slow
def test_forty_edits_keep_everything_required(tmp_path: Path) -> None:
    counts = chaos(tmp_path, 40, seed=1)
    assert counts["taken over"] > 10
    assert counts["broken"] > 3 and counts["foreseen"] > 5


@pytest.mark.slow
def test_five_hundred_edits_keep_everything_required(tmp_path: Path) -> None:
    counts = chaos(tmp_path, 500, seed=2)
    assert counts["taken over"] > 200
    assert counts["broken"] > 80 and counts["foreseen"] > 100
