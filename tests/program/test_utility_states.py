"""A state that is there for a moment and leads back to where one came from (T23): `previous`, `next`, on both backends."""

from __future__ import annotations

from meaning import crowd, item, play

TEXT = """species a {
load = 0
was_next = 0
was_previous = 0
digs = 0
start search
state search { when id > 0 -> carry }
state carry { load = 1; when false -> search }
state dig for at least 0.2 s {
  enter { digs += 1; was_next = if next == dig then 1 else 0; was_previous = if previous == carry then 1 else 0 }
  when true -> previous
}
from any except dig when frame == 5 or frame == 11 -> dig
}"""


def test_a_utility_state_leads_back_to_whatever_was_before() -> None:
    history = play(TEXT, crowd(2), steps=16)
    assert history.states(0) == ["search"] * 5 + ["dig"] * 2 + ["search"] * 4 + ["dig"] * 2 + ["search"] * 4
    assert history.states(1) == ["search"] + ["carry"] * 4 + ["dig"] * 2 + ["carry"] * 4 + ["dig"] * 2 + ["carry"] * 4
    assert history["digs"] == [2, 2] and history["was_next"] == [1, 1] and history["was_previous"] == [0, 1]


def test_loads_remember_their_source() -> None:
    """Sources have a quantity and differ by which ants took from them; the nest counts what came in (T26)."""
    text = """species a { load = 0
source = none of food
from_near = 0
start p
let meal = nearest(food, with: load > 0)
state p { when meal take 1 load from meal -> q { source = meal } }
state q { from_near = if touching(source) then 1 else 0; when after 0.2 s -> r { give all load to nest } }
state r { when false -> p } }"""
    items = {"food": (item("near", 0, 0, 5, load=2), item("far", 30, 0, 5, load=9)), "nest": (item("n", 0, 10),)}
    history = play(text, crowd(5), steps=8, items=items)
    assert sum(history["from_near"]) == 2 and history.amounts("food") == [0, 6] and history.amounts("nest") == [5]
