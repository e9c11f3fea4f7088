"""States, changes and time: small programs on the real runtime, on both backends, against what their text says."""

from __future__ import annotations

import math

import pytest
from meaning import FAST, crowd, item, play
from sampling import sampled


def test_interrupt_before_from_any_before_the_others_and_never_into_the_own_state():
    text = """species a {{
n = 0
start p
from any except r when frame == 2 -> q {{ n += 100 }}
state p {{
  when frame == 2 -> r {{ n += 1 }}
  {line}
}}
state q {{ when frame == 4 -> r {{ n += 10 }} }}
state r {{ enter {{ n += 1000 }}; when frame == 6 -> previous; when false -> p }}
}}"""
    plain = play(text.format(line=""), steps=7)
    assert plain.states() == ["p", "p", "q", "q", "r", "r", "q", "q"]
    assert plain["n"] == [1110]
    sudden = play(text.format(line="interrupt when frame == 2 -> r { n += 7 }"), steps=7)
    assert sudden.states() == ["p", "p", "r", "r", "r", "r", "p", "p"]
    assert sudden["n"] == [1007]


@pytest.mark.parametrize("target", ["previous", "choose { p: 1; q: 0 }"])
def test_from_any_does_not_enter_the_own_state_by_a_target_that_only_the_run_knows(target):
    history = play(
        f"species a {{ n = 0\nstart p\nfrom any when frame == 2 or frame == 5 -> {target} {{ n += 1 }}\n"
        "state p { when frame == 3 -> q }\nstate q { when false -> p } }",
        steps=6,
    )
    assert history.states() == ["p", "p", "p", "q", "q", "p", "p"]
    assert history["n"] == [1]


def test_parts_of_a_step_run_in_their_order_and_each_line_sees_the_one_above():
    history = play(
        """species a {
n = 1
log = 0
let before = n
on ping { n += 1 }
start p
state p {
  exit { log = log * 10 + n }
  when frame == 1 -> p2
  when ping -> q { n = n * 2; log = log * 10 + n }
}
state p2 { enter { emit ping }; when false -> q }
state q {
  enter { n += 1; log = log * 10 + n }
  n += 10 /s
  log = log * 10 + n
  when false -> p
}
from any except p, q when ping -> q { n = n * 2; log = log * 10 + before }
}""",
        steps=2,
    )
    # frame 0: exit of p logs 1. frame 1: handler 2, action 4 (logs the start's 1), enter 5, body 6
    assert history.every("log") == [0, 1, 1 * 1000 + 156]
    assert history.every("n") == [1, 1, 6]


@pytest.mark.parametrize("fps", sampled([10, 24, 25, 30, 48, 60], [24, 30]))
@pytest.mark.parametrize("seconds", [0.1, 0.5, 0.7, 1.0])
def test_durations_are_whole_steps_rounded_up(fps, seconds):
    history = play(
        f"""species a {{
machine one {{ start p
  state p {{ when after {seconds} s -> q }}
  state q {{ when false -> p }} }}
machine two {{ start p2
  state p2 {{ when frame >= 3 held {seconds} s -> q2 }}
  state q2 {{ when false -> p2 }} }}
machine three {{ start p3
  state p3 for at least {seconds} s {{ when true -> q3 }}
  state q3 {{ when false -> p3 }} }}
}}""",
        steps=math.ceil(1.0 * fps) + 4, fps=fps,
    )  # fmt: skip
    steps = math.ceil(round(seconds * fps, 9))
    assert history.states(machine="one").index("q") == steps + 1
    assert history.states(machine="two").index("q2") == steps + 3
    assert history.states(machine="three").index("q3") == steps + 1


def test_a_break_starts_held_again_and_at_least_is_left_by_interrupt_only():
    history = play(
        """species a {
start p
state p { when frame != 4 held 0.3 s -> q }
state q for at least 0.4 s { when true -> r; interrupt when frame == 10 -> s }
state r { when false -> s }
state s { when false -> p } }""",
        steps=12,
    )
    assert history.states() == ["p"] * 4 + ["p"] * 4 + ["q"] * 2 + ["s"] * 3


def test_machines_look_at_each_other_as_they_were_and_steer_together():
    history = play(
        """species a {
x = 0
y = 0
response 1 step
max_speed 10 mm/s
machine one { start p
  state p { x += 10 /s; when two.state == r -> q }
  state q { y += 10 /s; steer vector(0.25, 0, 0); when false -> p } }
machine two { start s
  state s { when frame == 3 -> r }
  state r { when one.state == q -> s2 }
  state s2 { steer vector(0, 0, 0.25); when false -> s } }
on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s) }
}""",
        steps=7,
    )
    assert history.states(machine="two") == ["s"] * 3 + ["r"] * 2 + ["s2"] * 3
    assert history.states(machine="one") == ["p"] * 4 + ["q"] * 4
    assert (history.every("x")[-1], history.every("y")[-1]) == (3, 4)
    # a kinematic push of 1 is twice the full speed: 0.25 twice over is 5 mm/s a step, 4 steps of q, 3 of s2, cut to 10 mm/s
    assert history.every("velocity.x")[4:6] == pytest.approx([5, 10 / math.hypot(10, 5) * 10])


def test_latch_relax_and_events_come_once_a_step_later():
    history = play(
        """species a {
n = 0
heard = 0
told = 0
calm = 0 relax to 1 over 1 s
latch high = n > 2.5 until n < 0.5
on ping { heard += 1 }
start up
state up { n += 10 /s; when high -> down; when frame == 2 -> up2 { emit ping(within: 5 mm) } }
state up2 { n += 10 /s; when high -> down }
state down { n -= 10 /s; when not high -> up }
from any except up, up2, down when ping -> up
}
species b { heard = 0
on ping { heard += 1 }
start s
state s { when ping -> t }
state t { when false -> s } }""",
        crowd(2, at=[(0, 0), (3, 0)]), crowd(species="b", at=[(4, 0), (20, 0), (-4.9, 0)]), steps=10,
    )  # fmt: skip
    # A latch is set before the lines of its step: above 2.5 after three steps, seen in the fourth
    assert history.every("n") == [0, 1, 2, 3, 2, 1, 0, 1, 2, 3, 2]
    assert history.every("heard")[:4] == [0, 0, 0, 1] and history["heard"] == [1, 1]  # two called, it is noticed once
    assert history.at("main.state", -1, "b") == [1, 0, 1] and history.at("heard", -1, "b") == [1, 0, 1]
    assert history["calm"][0] == pytest.approx(1 - math.exp(-1), rel=1e-5)


def test_choose_and_chance_have_their_shares_and_a_share_needs_no_rate():
    text = "start p\nstate p { when true -> choose { q: 3; r: 1 } }\nstate q { when false -> p }\nstate r { when false -> p }"
    states = play(f"species a {{ {text} }}", crowd(400), steps=1, option_sets=FAST)["main.state"]
    assert states.count(1) == pytest.approx(300, abs=40) and states.count(0) == 0
    rate = "species a {{ start p\nstate p {{ when chance 50 %/s -> q }}\nstate q {{ when false -> p }} }}"
    for fps in (5, 30):
        changed_count = play(rate.format(), crowd(400), steps=2 * fps, fps=fps, option_sets=FAST)["main.state"].count(1)
        assert changed_count == pytest.approx(400 * (1 - math.exp(-1)), abs=45)
    share = (
        "species a { on spawn { emit ping }\non ping { n += 1 }\nn = 0\n"
        "start p\nstate p { when ping and chance 30 % -> q }\nstate q { when false -> p } }"
    )
    assert play(share, crowd(400), steps=9, option_sets=FAST)["main.state"].count(1) == pytest.approx(120, abs=40)


def test_keep_is_memory_of_one_call_that_rests_where_it_is_not_called():
    history = play(
        """behaviour tally() -> number { keep n = 1 then n + 1
n }
species a {
x = 0
y = 0
start p
state p { x = tally(); when frame == 4 -> q }
state q { y = tally() + tally(); when frame == 6 -> p } }""",
        steps=8,
    )
    assert history.every("x") == [0, 1, 2, 3, 3, 3, 4, 5, 6]
    assert history.every("y") == [0, 0, 0, 0, 2, 4, 4, 4, 4]


# --- taking and giving ------------------------------------------------------------------------------------------------

FEAST = """species a {
load = 0
start p
state p { when nearest(food) take 1 load from nearest(food) -> q }
state q { when after 0.2 s -> r { give all load to nest } }
state r { when false -> p }
}"""


def test_crumbs_are_conserved_and_each_has_one_winner():
    totals = []

    def each(world):
        items = sum(float(i.amounts["load"].sum()) for i in world.items.values())
        totals.append(items + float(world.populations["a"].now["load"].astype(float).sum()))

    items = {"food": (item("f", 0, 0, 5, load=3), item("g", 50, 0, 5, load=2.5)), "nest": (item("n", 0, 10),)}
    history = play(FEAST, crowd(10, radius=3), steps=6, items=items, each=each)
    assert history["main.state"].count(2) == 3 and history["main.state"].count(0) == 7
    assert (history.amounts("food"), history.amounts("nest"), set(totals)) == ([0, 2.5], [3], {5.5})


def test_who_loses_does_nothing_of_the_change():
    text = """species a {
load = 0
n = 0
start p
state p { exit { n += 1 }; when true take 1 load from nearest(food) -> q { n += 1 } }
state q { enter { n += 1; load = load + 10 }; when false -> p } }"""
    history = play(text, crowd(5), steps=4, items={"food": (item("f", 0, 0, load=2),)})
    assert sorted(history["n"]) == [0, 0, 0, 3, 3] and sorted(history["load"]) == [0, 0, 0, 11, 11]
    assert history.amounts("food") == [0]


def test_machines_that_take_in_the_same_step_win_apart():
    text = """species a {
load = 0
k = 0
m = 0
machine one { start p
  state p { when true take 1 load from nearest(food) -> q { k += 1 } }
  state q { when false -> p } }
machine two { start u
  state u { when true take 2 load from nearest(food) -> v { m += 1 } }
  state v { when false -> u } } }"""
    for load in (3, 4, 9):
        history = play(text, crowd(2), steps=3, items={"food": (item("f", 0, 0, load=load),)})
        assert history["load"] == [k + 2 * m for k, m in zip(history["k"], history["m"], strict=True)]
        assert sum(history["load"]) + history.amounts("food")[0] == load and sum(history["load"]) >= min(load, 6) - 1


def test_giving_is_a_rate_in_a_body_and_never_more_than_there_is():
    text = "species a { load = 1\nstart p\nstate p { give 4 /s load to nest; when false -> q }\nstate q { when false -> p } }"
    history = play(text, crowd(3), steps=4, items={"nest": (item("n", 0, 9), item("far", 90, 0))})
    assert history["load"] == [0, 0, 0] and history.amounts("nest") == [3, 0]
    assert history.every("load")[1:3] == pytest.approx([0.6, 0.2])


def test_two_lines_that_look_alike_have_draws_and_memories_of_their_own():
    text = """species a {
x = 0
y = 0
n = 0
on ping { x += uniform(0, 1) }
on ping { y += uniform(0, 1) }
start p
from any except q when chance 500 %/s -> any { n += 1 }
from any except any when chance 500 %/s -> any { n += 10 }
from any except q, any when frame < 6 held 0.2 s -> q { n += 100 }
from any except p, any when frame > 100 held 0.2 s -> q
state p { emit ping; when false -> q }
state q { when false -> p }
state any { when false -> previous }
}"""
    history = play(text, crowd(60), steps=2, option_sets=FAST)
    drawn = [(x, y) for x, y in zip(history["x"], history["y"], strict=True) if x > 0]
    assert len(drawn) > 10 and all(x != y for x, y in drawn)
    assert {n % 100 for n in history["n"]} == {0, 1, 10} and history.states(0)[0] == "p"
    late = play(text.replace("500 %/s", "0 %/s"), steps=4)
    assert late.states() == ["p", "p", "p", "q", "q"] and late["n"] == [100]


def test_a_change_into_a_state_that_kills_is_counted():
    text = "species a { start s\nstate s { when after 2 step -> gone }\nstate gone { enter { die }; when false -> s } }"
    history = play(text, crowd(at=[(0, 0), (9, 0), (18, 0)]), steps=4)
    assert len(history.world.populations["a"]) == 0 and history.world.transitions == {"a.s->gone": 3}
