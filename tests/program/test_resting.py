"""States that steer nothing: who is in one stands still where other states steer, and goes on where it says `coast()`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from explained import cached
from meaning import FAST, OPTION_SETS, RunHistory, crowd, play
from test_program import checked
from test_specs import GROUND

from antdsl.cli.commands.new import TEMPLATE_FILES, build_ground_ply, read_template_file
from antdsl.explain import CacheHistory, StepReplay, explain_agent_in_cache, explain_agents, format_explanation, open_shot
from antdsl.pipeline import open_scene
from antdsl.plan.lowering.source_map import RESTING_TEXT
from antdsl.runtime import bind, step

SET_OUT = "on spawn { velocity = vector(20 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }\n"


def walker(rest: str = "", start: str = "rest", members: str = "", layers: str = "layers { state }") -> str:
    """A species of which one state steers; the other one says `rest`."""
    return f"""use steering
species a {{ {members}
{SET_OUT}start {start}
state go {{ steer vector(0, 0, 1); when after 0.5 s -> rest }}
state rest {{ {rest}; when after 2 s -> go }}
{layers} }}"""


def speeds(history: RunHistory, number: int = 0, species: str = "a") -> list[float]:
    frames = [frame[species] for frame in history.frames]
    return [float(np.sqrt(sum(np.float64(f[f"velocity.{a}"][number]) ** 2 for a in "xyz"))) for f in frames]


@pytest.mark.parametrize("extra", ["", "response 1 step", "max_force 3 uN", "response 0.5 s"])
def test_a_state_that_steers_nothing_stands_still_as_by_halt(extra: str) -> None:
    silent, said = (play(walker(rest, start="go", members=extra), steps=20) for rest in ("", "steer halt()"))
    for name in ("position.x", "position.z", "velocity.x", "velocity.z", "heading.x", "main.state"):
        assert silent.every(name) == said.every(name)
    assert speeds(silent)[5] > 1.0  # it went, and
    if extra != "max_force 3 uN":  # which is too weak to stop in a second and a half
        assert speeds(silent)[-1] < 2.0


def test_who_says_coast_goes_on_and_so_does_a_push_of_nothing() -> None:
    for rest in ("steer coast()", "steer vector(0, 0, 0)", "steer seek(nearest(food))"):
        history = play(walker(rest), steps=15)
        assert speeds(history)[-1] == pytest.approx(20, rel=1e-4), rest
    assert speeds(play(walker(), steps=15))[-1] < 0.2


def test_where_no_state_steers_the_layers_alone_move_it() -> None:
    text = f"species a {{ {SET_OUT}start s\nstate s {{ when after 1 s -> t }}\nstate t {{ when after 1 s -> s }}\n"
    history = play(text + "layers { vector(0, 0, 0.1) } }", steps=8)
    assert history["velocity.x"] == pytest.approx([20], rel=1e-3) and history["velocity.z"][0] > 10
    program, _ = checked("ant 1\n" + text + "}")
    assert program.species["a"].rest is None


def test_a_machine_that_never_steers_has_no_say_and_of_two_that_do_one_is_enough() -> None:
    text = f"""species a {{ {SET_OUT}
machine mood {{ start calm
  state calm {{ when frame == 30 -> upset }}
  state upset {{ when false -> calm }} }}
machine legs {{ start walk
  state walk {{ steer vector(0, 0, 0.02); when frame == 11 -> stand }}
  state stand {{ when false -> walk }} }}
machine fear {{ start brave
  state brave {{ when frame == 21 -> flee }}
  state flee {{ steer vector(0, 0, 1); when false -> brave }} }} }}"""
    history = play(text, steps=34)
    x, z = history.every("velocity.x"), history.every("velocity.z")
    assert x[10] == pytest.approx(20, rel=1e-3) and z[10] > 1  # `brave` does not brake who walks
    assert speeds(history)[20] < 0.3  # neither steers
    assert z[33] > 29.9  # and `stand` does not brake who flees
    program, _ = checked("ant 1\n" + text)
    assert program.species["a"].rest.resting_states == {"legs": (1,), "fear": (0,)}


def test_a_machine_of_which_every_state_steers_keeps_all_moving() -> None:
    legs = "machine legs { start walk\nstate walk { steer vector(0, 0, 0.1) } }\n"
    text = f"ant 1\nspecies a {{ {legs}machine fear {{ start brave\nstate brave {{ when after 1 s -> flee }}\n"
    program, report = checked(text + "state flee { steer vector(0, 0, 1); when after 1 s -> brave } } }")
    assert report.ok and program.species["a"].rest is None


def test_it_is_what_the_layer_of_the_states_asks_for() -> None:
    above = play(walker(layers="layers { vector(0, 0, 0.5); state }"), steps=12)
    assert speeds(above)[-1] > 10  # moved by what stands above, with what that leaves
    off = play(walker(layers="layers { state when state == go }"), steps=12)
    assert speeds(off)[-1] == pytest.approx(20, rel=1e-4)
    added = play(walker(layers="layers sum { vector(0, 0, 0.5); state }"), steps=12)
    assert added["velocity.x"][0] < 1 < added["velocity.z"][0]
    first = play(walker(layers="layers first { state; vector(0, 0, 0.5) }"), steps=1)
    assert first["velocity.z"] == [0] and first["velocity.x"][0] < 20


def test_it_needs_no_library_and_minds_no_behaviour_of_the_same_name() -> None:
    text = walker().replace("use steering\n", 'behaviour halt() -> push { "Sideways."; vector(0, 0, 1) }\n')
    text = text.replace("steer vector(0, 0, 1)", "steer halt()")
    assert speeds(play(text, steps=15))[-1] < 0.2
    assert [len(frame["a"]["id"]) for frame in play(text, crowd(3), steps=1, option_sets=OPTION_SETS).frames] == [3, 3]


@pytest.mark.parametrize("rest, words", [("", RESTING_TEXT), ("steer coast()", "coast()")])
def test_explain_says_why_it_stands_still(tmp_path: Path, rest: str, words: str) -> None:
    text = "ant 1\n" + walker(rest).replace("use steering\n", "use steering\nworld { surface ground }\n")
    scene = "antdsl: 1\nfps: 10\nframes: 1..12\nworld: {ground: {mesh: ground.ply}}\n"
    scene += "crowd: [{species: a, from: a.ant, count: 2, place: {on: ground, radius: 20 mm}}]\n"
    for name, content in (("a.ant", text), ("scene.yaml", scene), ("ground.ply", GROUND)):
        (tmp_path / name).write_text(content)
    cache = cached(tmp_path / "scene.yaml", 12, tmp_path / "out")
    replay = StepReplay(CacheHistory.from_cache(cache, open_shot(cache)))
    (step_report,) = explain_agents(replay, 3, [("a", 0)])
    assert step_report is not None
    words_of_strip = format_explanation(explain_agent_in_cache(cache, 0, 3)).splitlines()[3]
    assert words_of_strip.startswith("  [rest 1..")  # and no name of a state stands before the first one's
    assert [steer.text for steer in step_report.steers] == [words if words == RESTING_TEXT else "steer coast()"]
    assert f"state: {step_report.steers[0].text}" in format_explanation(step_report)
    assert (step_report.steers[0].length > 0.1) is (words == RESTING_TEXT)
    assert step_report.push == pytest.approx(step_report.steers[0].push)


def test_the_ants_of_a_new_project_rest_where_they_are(tmp_path: Path) -> None:
    for name in TEMPLATE_FILES:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(read_template_file(name))
    (tmp_path / "ground.ply").write_bytes(build_ground_ply())
    shot, report = open_scene(tmp_path / "scene.yaml")
    assert shot is not None, report.sort_by_place()
    world = bind(shot.plan, shot.setting)
    for _ in range(72):
        step(world)
    walkers = world.populations["walker"]
    resting = (walkers.now["main.state"] == 1) & (walkers.now["main.time_in_state"] > 0.5)
    speed = np.sqrt(sum(walkers.now[f"velocity.{axis}"].astype(float) ** 2 for axis in "xyz"))
    assert resting.any() and speed[resting].max() < 0.5 and np.median(speed[~resting]) > 15


def test_thousands_rest_alike_whatever_the_order_of_rows() -> None:
    text = walker(start="go").replace("when after 0.5 s -> rest", "when chance 100 %/s -> rest")
    history = play(text, crowd(2000, radius=300), steps=12, option_sets=FAST)
    still = np.array(history["main.state"]) == 1
    speed = np.hypot(history["velocity.x"], history["velocity.z"])
    assert 500 < still.sum() < 1900 and speed[still].mean() < speed[~still].mean() / 2
