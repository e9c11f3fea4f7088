"""What agents ask of other agents: their age, the nearest few of a set, an event for one of them."""

from __future__ import annotations

from meaning import OPTION_SETS, crowd, item, play

from antdsl.runtime import Options

NATIVE = Options(backend="native", wait_for_code=True, chunk=16, shuffle_rows=5)
EVERY_WAY = (*OPTION_SETS, NATIVE)
STILL = "on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }\n"


def test_the_age_of_others_is_counted_from_their_birth_and_0_for_none() -> None:
    text = f"""species a {{ eldest = 0 s; friend = 0 s; near_by = 1 s; mine = 0 s
      {STILL}
      state s {{
        eldest = max(0 s, max(n in a: n.age)); friend = nearest(a).age; near_by = nearest(neighbours(0.001 mm)).age; mine = age
        when time > 0.25 s and time < 0.35 s and id < 1 -> s {{ spawn a }}
      }}
      start s }}"""
    history = play(text, crowd(at=[(0, 0), (1, 0), (5, 0)]), steps=8, option_sets=EVERY_WAY)
    assert history["id"] == [0, 1, 2, 3]
    assert [round(v, 4) for v in history["mine"]] == [0.7, 0.7, 0.7, 0.4]
    assert [round(v, 4) for v in history["eldest"]] == [0.7] * 4
    assert [round(v, 4) for v in history["friend"]] == [0.4, 0.7, 0.7, 0.7]
    assert [round(v, 4) for v in history["near_by"]] == [
        0.4,
        0,
        0,
        0.7,
    ]  # the child stands where its parent does; no agent near is 0


WORLD = "ant 1\nworld { surface ground }\n"
FIGHT = f"""
species b {{ hp = 5
  {STILL}
  on hit {{ hp -= 1 }}
  start s
  state s {{ when hp < 3 -> gone {{ die }} }}
  state gone {{ when false -> s }}
}}
species a {{ hurt = 0
  {STILL}
  start s
  state s {{
    when true -> s {{ emit hit(within: 6 mm) to nearest(b) }}
    when false -> t
  }}
  state t {{ when false -> s }}
  on hit {{ hurt += 1 }}
}}"""


def test_an_event_for_one_reaches_that_one_alone_and_none_beyond_reach() -> None:
    history = play(
        FIGHT, crowd(at=[(0, 0), (1, 0), (5, 0), (40, 0)]), crowd(species="b", at=[(0, 3), (0, -2.5), (50, 0)]),
        world=WORLD, steps=4, option_sets=EVERY_WAY,
    )  # fmt: skip
    # 0 and 1 hit b 1; 2 (5.59 mm from b 1, 5.83 from b 0) too; 3 stands 10 mm from b 2, out of its reach
    assert [history.at("hp", k, "b") for k in range(5)] == [[5, 5, 5], [5, 5, 5], [5, 4, 5], [5, 3, 5], [5, 5]]
    assert history["hurt"] == [0, 0, 0, 0]


def test_an_event_for_none_or_for_the_dead_reaches_no_agent_and_for_oneself_only_oneself() -> None:
    text = f"""species a {{ hits = 0; woken = 0
      {STILL}
      on hit {{ hits += 1 }}
      on wake {{ woken += 1 }}
      start s
      state s {{
        emit hit to nearest(neighbours(2 mm))
        when id > 1.5 -> s {{ emit wake to self }}
        when id < 0.5 and time > 0.25 s -> t {{ die }}
      }}
      state t {{ when false -> s }} }}"""
    history = play(text, crowd(at=[(0, 0), (1, 0), (9, 0)]), steps=4, option_sets=EVERY_WAY)
    assert history["id"] == [1, 2] and history["hits"] == [2, 0] and history["woken"] == [0, 3]


def test_most_takes_the_nearest_and_at_a_tie_the_lesser_id() -> None:
    points = [(0, 0), (3, 0), (-3, 0), (0, 3), (0, 5), (8, 0)]
    text = f"""species a {{ param few = 2 in 0 .. 9
      two = 0; ids = 0; three = 0; ahead = 0; odd = 0; many = 0; none_of = 0; meals = 0; own = 0; part = 1
      {STILL}
      start s
      let near = neighbours(20 mm, most: few)
      state s {{
        two = count(near); ids = sum(n in near: n.id); three = sum(n in neighbours(20 mm, most: 3): n.id)
        ahead = sum(n in neighbours(20 mm, 100 deg, most: 1): n.id)
        odd = sum(n in all(a, with: id == 1 or id == 3 or id == 5, most: 2): n.id)
        many = count(neighbours(20 mm, most: 100)); none_of = count(all(a, most: part - 1))
        meals = sum(f in all(food, with: load > 0, most: 2): f.load); own = count(all(a, within: 4 mm, most: id))
      }}
    }}"""
    food = (
        item("f", 1, 0, load=8),
        item("g", 2, 0, load=0),
        item("h", 9, 0, load=4),
        item("i", -9, 0, load=2),
        item("j", 0, 9, load=1),
    )
    history = play(text, crowd(at=points), option_sets=EVERY_WAY, items={"food": food, "nest": ()})
    assert history["two"] == [2] * 6 and history["many"] == [5] * 6 and history["none_of"] == [0] * 6
    assert history["ids"] == [1 + 2, 0 + 3, 0 + 3, 4 + 0, 3 + 0, 1 + 0]  # 1 2 3 are all 3 mm from 0
    assert history["three"] == [6, 0 + 3 + 5, 0 + 3 + 4, 4 + 0 + 1, 3 + 0 + 1, 1 + 0 + 3]
    assert history["ahead"] == [1, 5, 0, 1, 5, 0]
    assert history["odd"] == [1 + 3, 3 + 5, 3 + 1, 1 + 5, 3 + 1, 1 + 3]
    assert history["own"] == [0, 1, 1, 2, 1, 0]
    assert history["meals"][0] == 12 and history["meals"][5] == 12


def test_the_nearest_few_are_the_same_where_several_regions_ask_for_them() -> None:
    text = f"""species a {{ x = 0; y = 0
      {STILL}
      start s
      state s {{
        when id > 3 -> s {{ x = count(n in neighbours(40 mm, most: 3): n.id > 3) }}
        when true -> s {{ y = sum(n in neighbours(40 mm, most: 3): n.id) }}
      }} }}"""
    history = play(text, crowd(9, radius=40), option_sets=(OPTION_SETS[0], NATIVE, OPTION_SETS[2]))
    assert any(history["x"]) and all(x == 0 for x in history["x"][:4]) and sum(y > 0 for y in history["y"]) >= 3
