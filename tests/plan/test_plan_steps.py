"""What a lowered program does to one agent, step by step: changes, durations, claims, memories, layers; optimised plans too."""

from __future__ import annotations

import math

import pytest
from plan_agent import Agent
from plan_text import plan_of

from antdsl.passes import optimise_plan


@pytest.fixture(params=["as lowered", "optimised"])
def agent(request):
    """Makes the agent of a species `a` from the text of its members."""

    def make(members: str, preamble: str = "", **senses) -> Agent:
        plan = plan_of(f"{preamble}\nspecies a {{\n{members}\n}}\n")
        return Agent(plan if request.param == "as lowered" else optimise_plan(plan), "a", **senses)

    return make


# --- birth -----------------------------------------------------------------------------------------------------------


def test_given_properties_follow_from_each_other(agent):
    a = agent("max_speed 60 mm/s\nresponse 0.5 s\nsize 8 mm\nstart s\nstate s { steer heading }")
    assert (a["size"], a["radius"], a["mass"]) == (8, 4, 1)
    assert a["max_force"] == pytest.approx(120)
    assert math.isinf(a["max_turn"])


def test_a_kinematic_animal_can_turn_right_round_in_a_step(agent):
    a = agent("max_speed 60 mm/s\nresponse 1 step\nstart s\nstate s { steer match(heading * -60 mm/s) }")
    a.now["velocity.x"] = 60.0
    a.step()
    change = a.push[0] * a["max_force"] / a["mass"] * a.dt
    assert 60 + change == pytest.approx(-60, rel=1e-5)


def test_defaults_are_made_in_the_order_they_need(agent):
    a = agent("b = c * 2\nc = size / 1 mm\nsize 3 mm\nstart s\nstate s { steer heading * b }")
    assert (a["b"], a["c"]) == (6, 3)


def test_spawn_handlers_and_the_start_state_run_at_birth(agent):
    a = agent(
        "n = 1\non spawn { n += 2 }\nstart s\nstate q { steer heading * n\nwhen after 1 s -> s }\n"
        "state s { enter { n = n * 5 }\nwhen n > 100 -> q }"
    )
    assert a["n"] == 15
    assert a.state == "s"


# --- changes ---------------------------------------------------------------------------------------------------------

PAIR = "start p\nstate p {{ {p} }}\nstate q {{ {q} }}\nn = 0"


def test_the_first_true_change_wins_and_the_body_is_the_new_states(agent):
    a = agent(
        "n = 0\nstart p\nstate p { when n > 5 -> r\nwhen n < 1 -> q { n += 2 }\nwhen true -> r }\n"
        "state q { n += 24 /s\nwhen false -> p }\nstate r { when false -> p }"
    )
    a.step()
    assert a.state == "q"
    assert a["n"] == pytest.approx(3)  # the change's 2, then one step of the new state's lines
    assert (a["main.previous"], a["main.next"]) == (0, 1)


def test_parts_of_a_change_run_in_their_order(agent):
    a = agent(
        "n = 0\nstart p\nstate p { exit { n = n * 10 + 1 }\nwhen true -> q { n = n * 10 + 2 } }\n"
        "state q { enter { n = n * 10 + 3 }\nwhen false -> p }"
    )
    assert a.step()["n"] == 123


@pytest.mark.parametrize("fps", [24, 25, 30, 48])
def test_after_takes_as_many_steps_as_its_time(agent, fps):
    a = agent(PAIR.format(p="when after 0.5 s -> q", q="when n > 0 -> p"), dt=1 / fps)
    steps = math.ceil(0.5 * fps)
    assert a.step(steps).state == "p"
    assert a.step().state == "q"


@pytest.mark.parametrize("fps", [24, 25, 30])
def test_held_counts_whole_steps_without_a_break(agent, fps):
    a = agent("start p\nstate p { when touching(ground) held 0.5 s -> q }\nstate q { when false -> p }", dt=1 / fps)
    steps = math.ceil(0.5 * fps)
    a.senses["surface.touching"] = True
    assert a.step(steps).state == "p"
    a.senses["surface.touching"] = False
    a.step()
    a.senses["surface.touching"] = True
    assert a.step(steps).state == "p"
    assert a.step().state == "q"


def test_held_restarts_when_the_state_is_entered_again(agent):
    a = agent(
        "start p\nstate p { when frame > 9 and frame < 12 -> q\nwhen touching(ground) held 0.5 s -> r }\n"
        "state q { when after 0.1 s -> p }\nstate r { when false -> p }"
    )
    a.senses["surface.touching"] = True
    states = []
    for _ in range(28):
        states.append(a.step().state)
    assert states[9:14] == ["p", "q", "q", "q", "p"]
    assert states[13:26] == ["p"] * 12 + ["p"]
    assert states[26] == "r"


def test_a_state_for_at_least_a_time_is_left_earlier_by_interrupt_only(agent):
    text = "n = 0\nstart p\nstate p for at least 0.5 s {{ {word} when true -> q }}\nstate q {{ when false -> p }}"
    assert agent(text.format(word="")).step(12).state == "p"
    assert agent(text.format(word="")).step(13).state == "q"
    assert agent(text.format(word="interrupt")).step().state == "q"


def test_time_in_a_state_does_not_drift(agent):
    a = agent("n = 0 s\nstart p\nstate p { n = time_in_state }", dt=1 / 24)
    a.step(2401)
    assert a["n"] == pytest.approx(100, abs=1e-4)


def test_previous_and_choose(agent):
    a = agent(
        "start p\nstate p { when true -> choose { q: 1; r: 3 } }\n"
        "state q { when true -> previous }\nstate r { when true -> previous }",
        draw=0.2,
    )
    assert [a.step().state, a.step().state] == ["q", "p"]
    a.senses["draw"] = 0.3
    assert [a.step().state, a.step().state] == ["r", "p"]


@pytest.mark.parametrize("fps", [12, 24, 48])
def test_chance_is_a_rate(agent, fps):
    a = agent("start p\nstate p { when chance 50 %/s -> q }\nstate q { when false -> p }", dt=1 / fps)
    share = 1 - math.exp(-0.5 / fps)
    a.senses["draw"] = share * 1.001
    assert a.step().state == "p"
    a.senses["draw"] = share * 0.999
    assert a.step().state == "q"


# --- claims ----------------------------------------------------------------------------------------------------------

TAKE = """
load = 0
let meal = nearest(food, with: load > 0, within: 40 mm)
start p
state p { when meal take 2 load from meal -> q { load = load * 10 }
  when true -> r }
state q { give 24 /s load to meal
  when false -> p }
state r { when false -> p }
"""


def test_a_winner_has_what_it_took_before_the_actions_run(agent):
    a = agent(TAKE, **{"reduce.item": 0}).step()
    assert a.state == "q"
    assert a.done[0] == ("claim", "food", "load", 0, 2)
    assert a.done[1] == ("give", "food", 0, pytest.approx(1))
    assert a["load"] == pytest.approx(19)


def test_a_loser_stays_and_nothing_happens(agent):
    a = agent(TAKE, **{"reduce.item": 0})
    a.win = False
    a.step()
    assert (a.state, a["load"], len(a.done)) == ("p", 0, 1)


def test_nothing_to_take_from_leaves_the_next_change_its_chance(agent):
    assert agent(TAKE, **{"reduce.item": -1}).step().state == "r"


# --- values over time ------------------------------------------------------------------------------------------------


def test_a_let_shows_the_start_of_the_step_and_lines_see_what_is_above(agent):
    a = agent("n = 1\nm = 0\nk = 0\nlet old = n * 2\nstart p\nstate p { n = n + 4\nm = old\nk = n }").step()
    assert (a["m"], a["k"]) == (2, 5)


def test_keep_takes_first_then_next_and_pauses_where_it_is_not_evaluated(agent):
    a = agent(
        "start p\nstate p { steer up * turn_of()\nwhen frame > 2 and frame < 5 -> q }\nstate q { when frame > 4 -> p }",
        "behaviour turn_of() -> number { keep k = 1 then k * 2\n k / 1000 }",
    )
    pushes = [round(a.step().push[1] * 1000) for _ in range(8)]
    assert pushes == [1, 2, 4, 0, 0, 8, 16, 32]


def test_a_latch_has_two_thresholds(agent):
    a = agent("h = 0\non_now = 0\nlatch hungry = h > 0.6 until h < 0.2\nstart p\nstate p { on_now = if hungry then 1 else 0 }")
    values = []
    for h in (0.5, 0.7, 0.5, 0.3, 0.1, 0.5):
        a.now["h"] = h
        values.append(a.step()["on_now"])
    assert values == [0, 1, 1, 1, 0, 0]


@pytest.mark.parametrize("fps", [12, 24])
def test_relax_is_the_same_in_a_second_at_any_fps(agent, fps):
    a = agent("calm = 0 relax to 1 over 2 s\nstart p\nstate p { steer heading * calm }", dt=1 / fps).step(fps)
    assert a["calm"] == pytest.approx(1 - math.exp(-0.5), rel=1e-4)


def test_rates_are_multiplied_by_the_step_and_amounts_are_not(agent):
    a = agent(
        "n = 0\nstart p\nstate p { deposit trail 24 /s\nwhen true -> q { deposit trail 5\n"
        "n += 3 } }\nstate q { deposit trail 48 /s\nn -= 24 /s\nwhen false -> p }",
        "field trail on ground { cell 4 mm; half_life 8 s }",
    ).step()
    assert [d[2] for d in a.done] == [pytest.approx(5), pytest.approx(2)]
    assert a["n"] == pytest.approx(2)


def test_events_reach_handlers_before_the_changes(agent):
    a = agent(
        "n = 0\non alarm { n += 1 }\nstart p\n"
        "state p { when n > 0 -> q { emit alarm(within: 5 mm) } }\nstate q { when alarm -> p }",
        event=True,
    )
    assert a.step().state == "q"
    assert a.done == [("emit", "alarm", 5, None)]
    assert a.species.event_names == ("alarm",)
    assert a.step().state == "p"


def test_heading_that_is_set_has_length_one_and_nothing_leaves_it(agent):
    a = agent(
        "start p\nstate p { when true -> q }\nstate q { enter { heading = up * 3 }\n"
        "when true -> r }\nstate r { enter { heading = up * 0 }\nwhen false -> p }"
    )
    assert a.step()["heading.y"] == 1
    assert a.step()["heading.y"] == 1


# --- layers ----------------------------------------------------------------------------------------------------------


def layers(mode: str, *lines: str) -> str:
    return f"start p\nstate p {{ steer heading * 0.6 }}\nlayers {mode} {{\n" + "\n".join(lines) + "\n}"


def test_a_budget_is_spent_from_the_top(agent):
    a = agent(layers("", "state", "up * 0.9", "up * -0.5")).step()
    assert a.push == pytest.approx((0.6, 0.4, 0))
    a = agent(layers("", "up * 0.25", "up * 0.25", "state")).step()
    assert a.push == pytest.approx((0.5, 0.5, 0))


def test_a_line_below_a_spent_budget_is_not_looked_at(agent):
    a = agent(layers("", "up * 2", "direction(nearest(food))", "state"))  # no sense is given: asking would fail
    assert a.step().push == pytest.approx((0, 1, 0))


def test_a_condition_leaves_a_line_out(agent):
    a = agent("n = 0\n" + layers("", "up * 0.5 when n > 0", "state when state == p"))
    assert a.step().push == pytest.approx((0.6, 0, 0))
    a.now["n"] = 1.0
    assert a.step().push == pytest.approx((0.5, 0.5, 0))


def test_sum_is_cut_to_one_and_first_takes_all(agent):
    a = agent(layers("sum", "state", "up * 0.8", "heading * 0.2")).step()
    assert a.push == pytest.approx((math.sqrt(0.5), math.sqrt(0.5), 0))
    a = agent(layers("first", "up * 0", "up * 0.25", "state")).step()
    assert a.push == pytest.approx((0, 0.25, 0))


def test_without_layers_the_states_steer(agent):
    assert agent("start p\nstate p { steer heading * 0.6\nsteer up * 0.1 }").step().push == pytest.approx((0.6, 0.1, 0))


def test_machines_steer_together_and_change_on_their_own(agent):
    a = agent(
        "machine legs { start p\nstate p { steer heading * 0.5\nwhen true -> q }\nstate q { steer up * 0.5\nwhen false -> p } }\n"
        "machine mood { start calm\nstate calm { steer heading * 0.25\nwhen after 1 s -> wild }\n"
        "state wild { when false -> calm } }"
    ).step()
    assert a.push == pytest.approx((0.25, 0.5, 0))
    assert (a["legs.state"], a["mood.state"]) == (1, 0)
