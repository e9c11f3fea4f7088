"""What agents ask of other agents: their age, the nearest few of a set, an event for one of them. All backends agree to the bit."""

from __future__ import annotations

from meaning import WAYS, crowd, play

from antdsl.runtime import Options

NATIVE = Options(backend="native", wait_for_code=True, chunk=16, shuffle_rows=5)
EVERY_WAY = (*WAYS, NATIVE)
STILL = "on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }\n"


def test_the_age_of_others_is_counted_from_their_birth_and_0_for_none() -> None:
    text = f"""species a {{ eldest = 0 s; friend = 0 s; near_by = 1 s; mine = 0 s
      {STILL}
      state s {{
        eldest = max(0 s, max(n in a: n.age)); friend = nearest(a).age; near_by = nearest(neighbours(0.001 mm)).age; mine = age
        when time > 0.25 s and time < 0.35 s and id < 1 -> s {{ spawn a }}
      }}
      start s }}"""
    seen = play(text, crowd(at=[(0, 0), (1, 0), (5, 0)]), steps=8, ways=EVERY_WAY)
    assert seen["id"] == [0, 1, 2, 3]
    assert [round(v, 4) for v in seen["mine"]] == [0.7, 0.7, 0.7, 0.4]
    assert [round(v, 4) for v in seen["eldest"]] == [0.7] * 4
    assert [round(v, 4) for v in seen["friend"]] == [0.4, 0.7, 0.7, 0.7]
    assert [round(v, 4) for v in seen["near_by"]] == [0.4, 0, 0, 0.7]  # the child stands where its parent does; nobody near is 0
