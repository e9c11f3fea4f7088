"""The ant of the thesis, whole: its panel as params, its five states in one shot, soil and crumbs counted, the can climbed."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from antdsl.pipeline import compile_files, open_scene, simulate

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "thesis"
# A group of the panel, and the params that stand for it.
PANEL = {
    "initial velocity": ("start_speed",),
    "max speed": ("top_speed",),
    "max force": ("strength",),
    "wander": ("swing", "stroll", "lasting"),
    "seek food": ("smell", "slowing"),
    "digger": ("digs", "pace", "width", "mark"),
    "seek home": ("reward", "plain", "fading", "faint"),
    "home exit field": ("exit_field",),
    "use vector fields": ("fields",),
    "avoidance and separation": ("feeling", "spread", "room", "view"),
}
STATES = ("wandering", "seek_food", "seek_home", "digger", "seek_pheromones")


def test_every_number_of_the_panel_is_a_param_with_range_and_help() -> None:
    program, report = compile_files([FOLDER / "ant.ant"])
    assert program is not None and not report.diagnostics  # a param that nothing uses would be reported here
    params = {name.removeprefix("ant."): param for name, param in program.params.items()}
    assert sorted(params) == sorted(name for names in PANEL.values() for name in names)
    for name, param in params.items():
        assert len(param.help) >= 14, name
        assert name in ("digs", "fields") or (param.low is not None and param.high is not None), name


def shot_of_finders(frames: int, count: int) -> tuple[np.ndarray, np.ndarray, list[tuple[int, float, float]]]:
    """(frames, agents) states, (frames, agents) heights, and per frame crumbs in all, soil carried, voxels' volume gone."""
    shot, report = open_scene(FOLDER / "tunnel_and_can.yaml")
    assert shot is not None, report.sort_by_place()
    crowds = tuple(replace(crowd, count=count) for crowd in shot.setting.crowds)
    shot = replace(shot, setting=replace(shot.setting, crowds=crowds))
    states, heights, counted = [], [], []
    for world in islice(simulate(shot), frames):
        now = world.populations["ant"].now
        states.append(now["main.state"].copy())
        heights.append(world.populations["ant"].position[:, 1].copy())
        crumbs = sum(items.amounts["load"].sum() for items in world.items.values()) + now["load"].sum()
        counted.append((round(float(crumbs)), float(now["soil"].sum()), float(world.solids["hill"].removed_volume)))
    return np.array(states), np.array(heights), counted


@pytest.mark.slow
def test_all_five_states_are_lived_through_and_the_can_is_climbed_for_its_sugar() -> None:
    states, heights, counted = shot_of_finders(360, 40)
    assert set(np.unique(states)) == set(range(len(STATES)))
    on_the_lid = heights > 27  # nothing but the lid and the top of the hill is so high
    assert (on_the_lid & (states == STATES.index("seek_home"))).any()
    assert (heights.max(axis=0) > 27).sum() >= 5
    are_counted(counted, 100)


def test_crumbs_and_soil_are_counted() -> None:
    states, _, counted = shot_of_finders(100, 12)
    assert {STATES.index("wandering"), STATES.index("digger")} <= set(np.unique(states))
    are_counted(counted, 1)


def are_counted(counted: list[tuple[int, float, float]], least: float) -> None:
    assert {crumbs for crumbs, _, _ in counted} == {4000}
    _, soil, removed_soil = counted[-1]
    assert soil > least and soil == pytest.approx(removed_soil, rel=1e-6)
