"""Values per pair: what each agent keeps about a few others, against a plain reading of the rules; all backends agree."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from meaning import OPTION_SETS, crowd, play
from plan_text import plan_of

from antdsl.passes import optimise_plan
from antdsl.plan.registers import list_slot_register_names
from antdsl.runtime import FaultStop, Options, World, WorldSetting, bind, restore_checkpoint, state_hash, step, take_checkpoint

NATIVE = Options(backend="native", wait_for_code=True, chunk=16, shuffle_rows=5)
EVERY_WAY = (*OPTION_SETS, NATIVE)
STILL = "on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }\n"


def read_pairs(world: World, name: str = "likes", species: str = "a", count: int = 3) -> dict[int, dict[int, float]]:
    """What each agent stores about which other, by id."""
    population = world.populations[species]
    pairs_by_agent: dict[int, dict[int, float]] = {int(agent): {} for agent in population.ids}
    for who, value in list_slot_register_names(name, count):
        for agent, other, held in zip(population.ids, population.now[who], population.now[value], strict=True):
            if other >= 0:
                assert int(other) not in pairs_by_agent[int(agent)], "two slots about one"
                pairs_by_agent[int(agent)][int(other)] = float(held)
    return pairs_by_agent


def test_a_line_writes_about_one_and_reads_it_again() -> None:
    text = f"""species a {{ seen = 0; nobody = 7; same = 0
      likes = 0 for each a, strongest 3
      {STILL}
      start s
      state s {{
        likes[nearest(a)] += 2 /s; same = likes[nearest(a)]; seen = sum(n in a: likes[n] * (n.id + 1))
        nobody = likes[nearest(neighbours(0.001 mm))]
      }} }}"""
    history = play(text, crowd(at=[(0, 0), (1, 0), (5, 0)]), steps=3, option_sets=EVERY_WAY)
    assert history["same"] == [np.float32(0.2) + np.float32(0.2) + np.float32(0.2)] * 3  # written in this step already
    assert [round(v, 5) for v in history["seen"]] == [1.2, 0.6, 1.2]
    assert history["nobody"] == [0, 0, 0]
    assert {a: list(partners) for a, partners in read_pairs(history.world).items()} == {0: [1], 1: [0], 2: [1]}


CROWD = """species a { fears = 0
  likes = 0 relax to 0 over 2 s for each a, strongest 3
  on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }
  start s
  state s {
    likes[n in neighbours(14 mm)] += (n.id - 4.2) * distance(n) / 1 mm * 0.1 /s
    likes[nearest(a)] -= 0.7 /s
    fears = sum(n in a: likes[n] * n.id)
    when time > 0.85 s and time < 0.95 s and id == 2 -> s { spawn a }
    when time > 1.15 s and id == 5 -> gone { die }
  }
  state gone { when false -> s }
}"""
TEN = np.random.default_rng(4).uniform(-12, 12, (10, 2)).round(3)


class Reading:
    """The rules read plainly: the others of each agent by id, each step in the order of the text, one other after the other."""

    def __init__(self, strongest: int) -> None:
        self.strongest, self.kept = strongest, {}

    def step(self, positions: dict[int, np.ndarray], dt: float) -> None:
        for agent, place in positions.items():
            mine = self.kept.setdefault(agent, {})
            mine = {other: value * np.exp(-dt / 2) for other, value in mine.items() if other in positions}
            away = {
                other: float(np.linalg.norm(other_place - place)) for other, other_place in positions.items() if other != agent
            }
            for other, distance in away.items():
                if distance <= 14:
                    mine[other] = mine.get(other, 0) + (other - 4.2) * distance * 0.1 * dt
            mine = self.strong(mine)
            nearest = min(away, key=lambda other: (np.float32(away[other]), other))
            mine[nearest] = mine.get(nearest, 0) - 0.7 * dt
            self.kept[agent] = self.strong(mine)

    def strong(self, mine: dict[int, float]) -> dict[int, float]:
        order = sorted(mine, key=lambda other: (-abs(mine[other]), other))
        return {other: mine[other] for other in order[: self.strongest]}


def test_a_crowd_keeps_the_strongest_and_forgets_the_dead() -> None:
    reading, pairs_by_frame = Reading(3), []

    def compare(world: World) -> None:
        population = world.populations["a"]
        now = read_pairs(world)
        alive = set(population.ids.tolist())
        expected = {a: {o: v for o, v in partners.items() if o in alive} for a, partners in reading.kept.items() if a in alive}
        for agent, partners in expected.items():
            assert now[agent] == pytest.approx(partners, abs=1e-5), f"frame {world.frame}, agent {agent}"
        pairs_by_frame.append(now)

    def first(world: World) -> None:
        positions = dict(zip(starts["ids"].tolist(), starts["places"], strict=True))
        reading.step(positions, 0.1)
        compare(world)
        starts.update(ids=world.populations["a"].ids.copy(), places=world.populations["a"].position.copy())

    starts = {"ids": np.arange(10), "places": np.array([(x, 0.0, z) for x, z in TEN])}
    end = play(CROWD, crowd(at=TEN.tolist()), steps=16, option_sets=EVERY_WAY, each=first)
    assert (
        5 in pairs_by_frame[5]
        and 5 not in pairs_by_frame[-1]
        and 10 in pairs_by_frame[-1]
        and not any(5 in partners for partners in pairs_by_frame[-1].values())
    )
    assert sum(len(partners) == 3 for partners in pairs_by_frame[-1].values()) == 10 and any(
        10 in partners for partners in pairs_by_frame[-1].values()
    )
    assert any(v < 0 for partners in pairs_by_frame[-1].values() for v in partners.values()) and end["fears"] != [0.0] * 10


def test_a_value_begins_and_rests_where_it_says_and_events_add_to_it() -> None:
    text = f"""species a {{ param calm = 0.5 in 0 .. 1
      trusts = calm relax to calm over 1 s for each a, strongest 2
      told = 0; none_of = 0; fell = 0
      {STILL}
      on shout {{ trusts[nearest(a)] -= 0.25 }}
      start s
      state s {{
        told = trusts[nearest(a)]; none_of = trusts[nearest(neighbours(0.01 mm))]; fell = trusts[best(n in a: distance(n))]
        when frame == 2 and id == 0 -> s {{ emit shout to nearest(a); trusts[n in a] = n.id / 2 }}
      }} }}"""
    history = play(text, crowd(at=[(0, 0), (1, 0), (5, 0)]), steps=24, option_sets=EVERY_WAY)
    assert history.at("told", 1) == [0.5] * 3 and history.every("none_of") == [0.0] + [0.5] * 24
    frames = [round(v, 4) for v in (history.at("told", 3)[1], history.at("told", 13)[1])]
    assert frames == [0.25, round(0.5 - 0.25 * np.exp(-1), 4)]
    # 0 has set 0.5 about 1, which is the value of rest, and 1 about 2
    assert read_pairs(
        play(text, crowd(at=[(0, 0), (1, 0), (5, 0)]), steps=3, option_sets=OPTION_SETS[:1]).world, "trusts", count=2
    )[0].keys() == {2}
    assert round(history.at("fell", 13)[0], 4) == round(0.5 + 0.5 * np.exp(-1.1), 4)


def test_what_is_no_number_is_refused_by_its_name() -> None:
    for line in ("likes[nearest(a)] += zero / zero * 1 /s", "likes[n in a] += 1 / zero * 1 /s", "likes[n in a] = zero / zero"):
        text = f"""species a {{ zero = 0
          likes = 0 for each a, strongest 3
          start s
          state s {{ {line}; when zero > 1 -> s {{ zero += 1 }} }} }}"""
        with pytest.raises(FaultStop) as stopped:
            play(text, crowd(at=[(0, 0), (1, 0)]), option_sets=OPTION_SETS[:1])
        assert "`likes`" in str(stopped.value) or "likes" in stopped.value.fault.register, line


def test_a_checkpoint_goes_on_to_the_same_values() -> None:
    plan = optimise_plan(plan_of(CROWD))
    setting = WorldSetting(fps=Fraction(10), crowds=(crowd(at=TEN.tolist()),))
    world, hashes = bind(plan, setting, Options(backend="numpy")), []
    for number in range(14):
        if number == 7:
            saved = take_checkpoint(world)
        step(world)
        hashes.append(state_hash(world))
    again = bind(plan, setting, Options(backend="numpy", shuffle_rows=2))
    restore_checkpoint(again, saved)
    for number in range(7, 14):
        step(again)
        assert state_hash(again) == hashes[number]
    assert read_pairs(again) == read_pairs(world)


DENSE = """species a {
  likes = 0 relax to 0 over 5 s for each a, strongest 8
  hits = 0
  max_speed 100 mm/s
  start s
  on bump { hits += 1; likes[nearest(a)] -= 0.05 }
  state s {
    steer wander()
    likes[n in neighbours(30 mm)] += (distance(n) / 30 mm - 0.4) * 10 %/s
    likes[nearest(neighbours(30 mm, most: 4))] -= 5 %/s
    when chance 30 %/s -> t { emit bump to nearest(a) }
    when chance 2 %/s -> s { spawn a }
    when age > 0.2 s and chance 9 %/s -> s { die }
  }
  state t { steer wander(); when after 0.2 s -> s }
  layers { state; limit(sum(n in neighbours(30 mm, most: 6): direction(n) * likes[n]), 0.3) }
}"""


@pytest.mark.slow
def test_a_dense_crowd_has_the_same_values_in_any_order_of_rows_threads_and_chunks() -> None:
    """More others in reach than are looked at, births and deaths."""
    many = (
        Options(backend="native", wait_for_code=True),
        Options(backend="numpy", threads=2, shuffle_rows=3, chunk=300),
        Options(backend="native", wait_for_code=True, threads=2, shuffle_rows=7, chunk=64),
    )
    history = play(
        DENSE, crowd(400, radius=18), world="ant 1\nuse steering\nworld { surface ground }\n", steps=6, fps=24, option_sets=many
    )
    now = read_pairs(history.world, count=8)
    assert sum(len(partners) == 8 for partners in now.values()) > 350 and sum(history["hits"]) > 5 and len(now) != 400


def test_pairs_across_species_begin_at_birth_and_each_keeps_its_own() -> None:
    text = f"""species b {{ {STILL} start s
      state s {{ when frame == 3 and id == 0 -> s {{ die }} }} }}
    species a {{
      knows = 0 for each b, strongest 2
      kin = 1 for each a, strongest 1
      sum_of = 0
      on spawn {{ velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); knows[nearest(b)] = 3; kin[n in a] += n.id }}
      start s
      state s {{
        sum_of = sum(n in b: knows[n]) + sum(n in a: kin[n])
        when frame == 2 and id == 0 -> s {{ spawn a; knows[n in b] += n.id + 1 }}
      }}
    }}"""
    pairs_by_frame: list[dict[int, dict[int, float]]] = []

    def note(world: World) -> None:
        pairs_by_frame.append(read_pairs(world, "knows", count=2))

    others = crowd(species="b", at=[(1, 0), (8, 0), (30, 0)])
    play(text, crowd(at=[(0, 0), (9, 0)]), others, steps=5, option_sets=EVERY_WAY, each=note)
    assert pairs_by_frame[0] == {0: {0: 3.0}, 1: {1: 3.0}}
    assert pairs_by_frame[1] == {
        0: {0: 4.0, 2: 3.0},
        1: {1: 3.0},
        2: {0: 3.0},
    }  # 3 about b 2, and 2 about b 1, for which there is no room
    assert pairs_by_frame[-1] == {0: {2: 3.0}, 1: {1: 3.0}, 2: {}}
