"""`on collision`: noticed once on both sides, about one other a step; the same bits on all backends and after a restart."""

from __future__ import annotations

import numpy as np
import pytest
from meaning import OPTION_SETS, crowd, play
from plan_text import plan_of, program_of

from antdsl.passes import optimise_plan
from antdsl.runtime import Options, World, bind, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.scene.setting import WorldSetting

EVERY_WAY = (*OPTION_SETS, Options(backend="native", wait_for_code=True, chunk=16, shuffle_rows=5))
# Trunks of balls are as wide as they are long: two of 10 mm touch where their places are 10 mm apart.
BALLS = "size 10 mm\nmax_speed 40 mm/s\nresponse 0.01 s\nhits = 0\nwhom = none of prey\n"
STILL = "on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }\n"
MEETING = f"""species prey {{ {BALLS}
  way = vector(1, 0, 0)
  on spawn {{
    way = if dot(position, vector(1, 0, 0)) < 0 mm then vector(1, 0, 0) else vector(-1, 0, 0)
    velocity = way * 20 mm/s; heading = way
  }}
  on collision(other) {{ hits += 1; whom = other }}
  start s
  state s {{ steer match(way * 20 mm/s) }}
}}"""


def play_meeting(points: list[tuple[float, float]], steps: int, text: str = MEETING, **setting_arguments: object) -> object:
    return play(text, crowd(species="prey", at=points), steps=steps, species="prey", option_sets=EVERY_WAY, **setting_arguments)


def test_a_contact_is_noticed_once_by_both_in_the_step_after_it_began() -> None:
    history = play_meeting([(-15, 0), (15, 0)], 14, contacts="off")
    # 30 mm apart, nearer by 4 mm a step: 10 mm apart after the fifth, which the sixth begins with.
    assert history.every("hits", 0) == [0] * 6 + [1] * 9 == history.every("hits", 1)
    assert history["whom"] == [1, 0]


def test_bodies_that_press_against_each_other_collide_once() -> None:
    assert play_meeting([(-8, 0), (8, 0)], 40, contacts="hard")["hits"] == [1, 1]


def test_of_several_the_deepest_comes_first_and_each_is_noticed() -> None:
    text = f"""species prey {{ {BALLS} seen = 0
      {STILL}
      likes = 0 for each prey, strongest 4
      on collision(other) {{ hits += 1; whom = other; likes[other] += 1; seen += other.id * 10 }}
      start s
      state s {{ steer 0 * heading }}
    }}"""
    # All begin in one step: number 0 has 2 at 7 mm, 1 at 8 mm, 3 at 9 mm, and 4 stands apart.
    history = play_meeting([(0, 0), (8, 0), (-7, 0), (0, 9), (0, 30)], 5, text, contacts="off")
    assert history.every("whom", 0) == [-1, 2, 1, 3, 3, 3]
    assert history["hits"] == [3, 1, 1, 1, 0]
    assert history.every("seen", 0) == [0, 20, 30, 60, 60, 60]
    assert [history[f"likes|{k}"][0] for k in range(4)] == [1, 1, 1, 0]


def test_who_parts_and_comes_back_collides_again() -> None:
    text = f"""species prey {{ {BALLS}
      on spawn {{ heading = vector(1, 0, 0); velocity = 0 * velocity }}
      on collision(other) {{ hits += 1 }}
      start s
      state s {{ steer match(vector(1, 0, 0) * (if id == 0 then 0 mm/s else if frame % 20 < 10 then -20 mm/s else 20 mm/s)) }}
    }}"""
    text = text.replace("frame % 20 < 10", "sin(frame * 18 deg) > 0")
    hits = play_meeting([(0, 0), (14, 0)], 60, text, contacts="off")["hits"]
    assert hits == [3, 3]


KINDS = f"""species prey {{ {BALLS}
  {STILL}
  on collision(other: hunter) {{ hits += 1 }}
  start s
  state s {{ steer 0 * heading; when hits > 0 -> eaten {{ die }} }}
  state eaten {{ when false -> s }}
}}
species hunter {{ {BALLS} own = 0
  on spawn {{ velocity = vector(20 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }}
  on collision(other) {{ own += 1 }}
  on collision(meal: prey) {{ hits += 1; whom = meal }}
  start s
  state s {{ steer match(vector(20 mm/s, 0 mm/s, 0 mm/s)) }}
}}"""


def test_kinds_are_distinguished_and_the_dead_are_forgotten() -> None:
    crowds = (
        crowd(species="prey", at=[(0, 0), (20, 0), (0, 40)]),
        crowd(species="hunter", at=[(-16, 0), (-20, 40), (-20, 45)], group=1),
    )
    history = play(KINDS, *crowds, steps=25, species="hunter", option_sets=EVERY_WAY, contacts="off")
    assert history["hits"] == [2, 1, 0]  # the third comes too late
    assert history["own"] == [0, 1, 1]
    assert len(history.world.populations["prey"]) == 0
    touched = [name for name in history.world.populations["hunter"].now if ".touched.prey#" in name]
    assert len(touched) == 8 and all((history.world.populations["hunter"].now[name] == -1).all() for name in touched)


def crowded(options: Options) -> World:
    text = MEETING.replace("steer match(way * 20 mm/s)", "steer match(rotate(way, about: up, by: id * 77 deg) * 20 mm/s)")
    return bind(
        optimise_plan(plan_of(text)), WorldSetting(crowds=(crowd(60, "prey", radius=45.0),), seed=3, contacts="hard"), options
    )


def test_a_checkpoint_goes_on_with_the_contacts_that_it_has() -> None:
    original = crowded(Options(backend="numpy"))
    for _ in range(8):
        step(original)
    saved = take_checkpoint(original)
    again = crowded(Options(backend="native", wait_for_code=True, shuffle_rows=2))
    restore_checkpoint(again, saved)
    hashes = []
    for world in (original, again):
        hashes.append([])
        for _ in range(8):
            step(world)
            hashes[-1].append(state_hash(world))
    assert hashes[0] == hashes[1]
    assert original.populations["prey"].now["hits"].sum() > 20


def test_more_than_it_can_know_wait_until_one_is_gone() -> None:
    text = f"""species prey {{ {BALLS.replace("10 mm", "if id == 0 then 60 mm else 6 mm", 1)}
      {STILL}
      on collision(other) {{ hits += 1 }}
      start s
      state s {{ steer 0 * heading; when id == 1 and hits > 0 and time > 1.4 s -> gone {{ die }} }}
      state gone {{ when false -> s }}
    }}"""
    angle = 2 * np.pi * np.arange(11) / 11
    ring = [(float(x), float(z)) for x, z in zip(18 * np.cos(angle), 18 * np.sin(angle), strict=True)]
    history = play_meeting([(0, 0), *ring], 20, text, contacts="off")
    assert history.every("hits", 0)[:13] == [0, 1, 2, 3, 4, 5, 6, 7, 8, 8, 8, 8, 8]
    assert history["hits"][0] == 9  # one has died, and makes room for another


@pytest.mark.parametrize(
    ("line", "code", "help"),
    [
        ("on collision(other: food) { x += 1 }", "wrong-kind", "touching(food)"),
        ("on collision(other: rabit) { x += 1 }", "unknown-species", "rabbit"),
        ("on collision(other: wolf) { x += 1 }", "unknown-species", "world { species wolf }"),
        ("on collision(rabbit) { x += 1 }", "wrong-argument", "on collision(other: rabbit)"),
        ("on collision(self) { x += 1 }", "wrong-argument", "on collision(other)"),
        ("on spawn { emit collision(within: 9 mm); x += 1 }", "wrong-argument", "emit bump"),
        ("on alarm(other) { x += 1 }", "wrong-argument", "on alarm { … }"),
        ("on collision(other) { x = 1 }", "not-commuting", "+="),
    ],
)
def test_mistakes_are_reported_with_a_correction(line: str, code: str, help: str) -> None:
    from test_program import checked

    text = f"""ant 1
world {{ surface ground; items food }}
species rabbit {{ start s; state s {{ steer heading }} }}
species hunter {{ x = 0; {line}
  start s; state s {{ steer heading * x; when x > 2 -> s {{ emit alarm(within: 10 mm) }} }} }}
"""
    _, report = checked(text)
    errors = [d for d in report.errors]
    assert errors and errors[0].span is not None
    assert (errors[0].code, help in (errors[0].help or "")) == (code, True), [(d.code, d.message, d.help) for d in errors]


def test_a_handler_without_a_name_in_brackets_is_about_its_own_kind() -> None:
    program = program_of(f"species prey {{ {BALLS} on collision {{ hits += 1 }}\nstart s\nstate s {{ steer heading * hits }} }}")
    assert [(h.event, h.other_species, h.other) for h in program.species["prey"].handlers] == [("collision", "prey", None)]
