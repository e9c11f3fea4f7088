"""`moved`: how far contacts pushed an agent in the step before; the same bits on all backends, after a restart and a reload."""

from __future__ import annotations

import numpy as np
import pytest
from meaning import OPTION_SETS, crowd, play
from plan_text import plan_of, program_of

from antdsl.passes import optimise_plan
from antdsl.plan import lower
from antdsl.reload import migrate_world
from antdsl.runtime import Options, World, bind, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.scene.setting import WorldSetting

EVERY_WAY = (*OPTION_SETS, Options(backend="native", wait_for_code=True, chunk=16, shuffle_rows=5))
# Trunks of balls are as wide as they are long: two of 10 mm touch where their places are 10 mm apart.
BALL = "size 10 mm\nmax_speed 40 mm/s\nresponse 0.01 s\nfar = 0 mm\n"
STILL = "on spawn { velocity = 0 * velocity; heading = vector(1, 0, 0) }\n"
RESTING = f"species prey {{ {BALL} {STILL} start s\nstate s {{ steer 0 * heading; far = far + moved }} }}"


def run(
    points: list[tuple[float, float]], steps: int, text: str = RESTING, contacts: str = "hard", **setting_arguments: object
) -> object:
    return play(
        text,
        crowd(species="prey", at=points),
        steps=steps,
        species="prey",
        option_sets=EVERY_WAY,
        contacts=contacts,
        **setting_arguments,
    )


def test_who_rests_has_moved_as_far_as_others_have_pushed_it() -> None:
    history = run([(-4, 0), (4, 0), (60, 0)], 6)
    place, moved = np.array(history.every("position.x", 0)), np.array(history.every("moved", 0))
    assert np.abs(np.diff(place)) == pytest.approx(moved[1:], abs=1e-5), "to the way it has gone in that step"
    assert moved[0] == 0 and 0.5 < moved[1:].sum() < 1.5 and moved[-1] == 0
    assert history.every("moved", 2) == [0] * 7, "whom nobody pushes"
    assert np.array(history.every("far", 0))[1:] == pytest.approx(np.cumsum(moved)[:-1], abs=1e-6), (
        "a program sees the step before"
    )


def test_pushes_of_substeps_add() -> None:
    history = run([(-4, 0), (4, 0)], 6, substeps=3)
    place, moved = np.array(history.every("position.x", 0)), np.array(history.every("moved", 0))
    assert np.abs(np.diff(place)) == pytest.approx(moved[1:], abs=1e-5) and moved.max() > 0.3


def test_no_agent_is_moved_where_bodies_take_no_room() -> None:
    assert run([(-4, 0), (4, 0)], 4, contacts="off").every("moved", 0) == [0] * 5


WALL = f"""species prey {{ {BALL} mass if id == 0 then 1000 g else 1 g
  on spawn {{ heading = vector(1, 0, 0); velocity = if id == 0 then 0 * velocity else heading * 20 mm/s }}
  start s
  state s {{ steer if id == 0 then 0 * heading else heading; far = far + moved }} }}"""


def test_who_is_only_stopped_is_not_moved() -> None:
    history = run([(0, 0), (-25, 0)], 25, WALL)
    assert history.at("position.x", -1)[1] == pytest.approx(-10, abs=0.6), "it has come up to the other one and stands"
    assert max(history.every("moved", 1)) < 0.02 and max(history.every("moved", 0)) < 1e-3


TURNING = f"""species prey {{ {BALL} mass if id == 0 then 1000 g else 1 g
  on spawn {{
    heading = if id == 0 then vector(1, 0, 0) else vector(0, 0, -1)
    velocity = if id == 0 then heading * 20 mm/s else 0 * velocity
  }}
  on collision(other) {{
    heading = if moved > 0.01 mm then unit(direction(other, to: self)) else heading
    velocity = if moved > 0.01 mm then unit(direction(other, to: self)) * speed else velocity
    far += moved
  }}
  start s
  state s {{ steer match(velocity) }} }}"""


def test_only_who_was_pushed_turns_away_at_once() -> None:
    history = run([(-14, 0), (0, 4)], 12, TURNING)
    heading = [np.array([history.at(f"heading.{axis}", frame) for axis in "xz"]).T for frame in range(13)]
    noticed = next(frame for frame in range(13) if history.at("far", frame)[1] > 0)
    assert history.at("far", noticed)[1] == history.at("moved", noticed - 1)[1], "of the step before"
    assert heading[noticed - 1][1].tolist() == [0, -1], "as it stood"
    displacement = np.array([history.at("position.x", noticed - 1)[1], 0]) - [history.at("position.x", noticed - 1)[0], 0]
    displacement = np.array([displacement[0], 4.0])
    assert heading[noticed][1] == pytest.approx(displacement / np.linalg.norm(displacement), abs=0.1), (
        "away from the other, at once"
    )
    assert np.abs(np.array([h[0] for h in heading]) - [1, 0]).max() < 0.05, "who pushes is not turned"
    assert max(history.every("far", 0)) < 0.01


def pressed(options: Options, text: str = RESTING) -> World:
    setting = WorldSetting(crowds=(crowd(60, "prey", radius=30.0),), seed=3, contacts="hard")
    text = text.replace(
        "steer 0 * heading", "steer rotate(heading, about: up, by: id * 77 deg) * (if far > 1 mm then 0.2 else 1)"
    )
    return bind(optimise_plan(plan_of(text)), setting, options)


def test_a_checkpoint_and_a_reload_know_it() -> None:
    original = pressed(Options(backend="numpy"))
    for _ in range(8):
        step(original)
    moved = original.populations["prey"].now["moved"]
    assert np.count_nonzero(moved) > 10
    saved = take_checkpoint(original)
    assert saved["species.prey.register.moved"].tobytes() == moved.tobytes()
    again = pressed(Options(backend="native", wait_for_code=True, shuffle_rows=2))
    restore_checkpoint(again, saved)
    hashes = []
    for world in (original, again):
        hashes.append([])
        for _ in range(8):
            step(world)
            hashes[-1].append(state_hash(world))
    assert hashes[0] == hashes[1]
    edited = optimise_plan(plan_of(RESTING.replace("far + moved", "far + 2 * moved")))
    reloaded, _ = migrate_world(original, edited, original.setting)
    assert np.array_equal(np.sort(reloaded.populations["prey"].now["moved"]), np.sort(original.populations["prey"].now["moved"]))


def test_only_programs_that_ask_have_it_and_who_asks_of_others_sees_it() -> None:
    plain = plan_of(RESTING.replace("; far = far + moved", "; far = far + 1 mm"))
    assert "moved" not in plain.species["prey"].registers
    other = RESTING.replace("far = far + moved", "far = max(n in neighbours(20 mm): n.moved)")
    history = run([(-4, 0), (4, 0)], 3, other)
    assert history.every("far", 0)[2] == history.every("moved", 1)[1] > 0


def test_it_cannot_be_set() -> None:
    from test_program import checked

    _, report = checked("ant 1\nspecies a { moved 3 mm\nstart s\nstate s { steer heading } }")
    assert report.errors and "moved" in report.errors[0].message
    assert lower(program_of(RESTING))[1].ok
