"""`wear`, `channel` and `look`: what states show, the same bits everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from meaning import OPTION_SETS, RunHistory, crowd, item, play
from plan_text import plan_of

from antdsl.passes import optimise_plan
from antdsl.plan import format_plan
from antdsl.runtime import Options, bind, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.scene.setting import WorldSetting

EVERY_WAY = (*OPTION_SETS, Options(backend="native", wait_for_code=True, chunk=16, shuffle_rows=5))
WORLD = "world { surface ground; items food }\n"
HEAD = """species a { size 10 mm
  max_speed 20 mm/s
  load = 0
  on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }
"""


def play_states(states: str, steps: int, **setting_arguments: object) -> RunHistory:
    return play(f"{HEAD}{states} }}", crowd(1), world=WORLD, steps=steps, option_sets=EVERY_WAY, **setting_arguments)  # type: ignore[arg-type]


def test_a_layer_is_worn_as_long_as_the_state_lasts_and_the_condition_holds() -> None:
    states = """start one
      state one { wear hat; when after 0.3 s -> two { load = 1 } }
      state two { wear crumb when load > 0; when after 0.3 s -> three }
      state three { wear crumb when load > 0; load -= 5 /s }"""
    history = play_states(states, 9)
    assert history.states() == ["one"] * 4 + ["two"] * 3 + ["three"] * 3
    assert history.every("wear#hat") == [True] * 4 + [False] * 6, "worn from birth on"
    assert history.every("wear#crumb") == [False] * 4 + [True] * 5 + [False], "what stands above the load's line sees it before"


def test_machines_wear_together() -> None:
    states = """machine m { start one; state one { wear hat; when after 0.2 s -> two }; state two { } }
      machine n { start one; state one { wear bag; when after 0.4 s -> two }; state two { wear hat } }"""
    history = play_states(states, 6)
    assert history.every("wear#hat") == [True, True, True, False, False, True, True]
    assert history.every("wear#bag") == [True] * 5 + [False] * 2


def test_a_channel_has_the_value_of_the_state_and_none_without_one() -> None:
    states = """start one
      state one { channel jaw = load * 0.5 + 0.25; load += 1 /s; when after 0.3 s -> two }
      state two { load = 0; when after 0.2 s -> one }"""
    history = play_states(states, 5)
    assert history.every("channel#jaw.said") == [True] * 4 + [False] * 2
    assert history.every("channel#jaw") == pytest.approx([0.25, 0.25, 0.3, 0.35, 0, 0], abs=1e-6)


def looking(states: str, x: float, z: float, steps: int = 30) -> np.ndarray:
    items = {"food": (item("crumb", x, z),)}
    history = play_states(states, steps, items=items)
    return np.stack([history.every(f"look#head.{axis}") for axis in "xyz"], axis=1)


def test_a_head_turns_to_what_it_looks_at_no_farther_than_it_may_and_back() -> None:
    states = """start one
      state one { look head(at: nearest(food), within: 60 deg, over: 0.2 s); when after 2 s -> two }
      state two { }"""
    # +x is ahead and +y up, so +z is to the right
    directions = looking(states, 10, 10)
    assert directions[0].tolist() == [1, 0, 0] and np.linalg.norm(directions, axis=1) == pytest.approx(1, abs=1e-6)
    angle = np.degrees(np.arctan2(directions[:, 2], directions[:, 0]))
    assert (np.diff(angle[:20]) > 0).all() and angle[20] == pytest.approx(45, abs=0.2)
    assert np.diff(angle[:20]).max() < 45 * (1 - np.exp(-0.1 / 0.2)) + 1, "a share of the way in a step"
    assert (np.diff(angle[21:]) < 0).all() and angle[-1] < 1
    aside = looking(states, -10, 0.5)
    assert np.degrees(np.arctan2(aside[20, 2], aside[20, 0])) == pytest.approx(60, abs=0.3)
    left = looking(states, 5, -5)
    assert left[20, 2] < -0.7
    behind = looking(states, -10, 0)
    assert behind[:, 0] == pytest.approx(1), "what is straight behind has no side to turn to"


def test_who_looks_at_nothing_looks_ahead() -> None:
    states = "start one\nstate one { look head(at: nearest(food, within: 5 mm)) }"
    assert looking(states, 30, 30, 5)[:, 0] == pytest.approx(1)


def test_it_is_in_checkpoints_and_plans() -> None:
    text = f"{HEAD}start one\nstate one {{ wear hat when chance 30 %/s; channel jaw = uniform(0, 1); steer wander() }} }}"
    plan = optimise_plan(plan_of(text, f"use steering\n{WORLD}"))
    assert (
        "wear#hat" in format_plan(plan) and plan.species["a"].worn_layers == ("hat",) and plan.species["a"].channels == ("jaw",)
    )
    setting = WorldSetting(crowds=(crowd(20, radius=40.0),), seed=2)
    original, again = (bind(plan, setting, Options(backend=name)) for name in ("numpy", "reference"))
    for _ in range(10):
        step(original)
    restore_checkpoint(again, take_checkpoint(original))
    for world in (original, again):
        step(world)
    assert state_hash(original) == state_hash(again)
    assert len({float(x) for x in original.populations["a"].now["channel#jaw"]}) == 20


@pytest.mark.parametrize(
    ("line", "code", "help"),
    [
        ("enter { wear hat }", "misplaced", "write `wear hat` as a line of the state itself"),
        ("enter { channel jaw = 1 }", "misplaced", "write `channel jaw = 1` as a line of the state itself"),
        ("when after 1 s -> s { look head(at: position) }", "misplaced", None),
        ("wear hat when 3", "wrong-kind", None),
        ("channel jaw = 3 mm", "wrong-unit", None),
        ("look head(at: 3)", "wrong-kind", None),
        ("look head(within: 30 deg)", "missing-argument", None),
        ("look head(at: position, within: 3)", "missing-unit", None),
        ("look head(at: position, within: 200 deg)", "out-of-range", "write an angle above `0 deg`, `180 deg` at most"),
        ("look head(at: position, over: 3 mm)", "wrong-unit", None),
    ],
)
def test_mistakes_are_reported_with_a_correction(line: str, code: str, help: str | None) -> None:
    from test_program import checked

    _, report = checked(f"ant 1\nspecies a {{\n  start s\n  state s {{\n    steer heading\n    {line}\n  }}\n}}\n")
    assert [d.code for d in report.errors] == [code], [(d.code, d.message, d.help) for d in report.errors]
    assert report.errors[0].span is not None and help in (None, report.errors[0].help)
