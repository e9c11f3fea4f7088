"""`play`: clips go by the ground covered or the clock, give way to each other, and can be queried; the same bits everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from meaning import OPTION_SETS, RunHistory, crowd, play
from plan_text import plan_of

from antdsl.passes import optimise_plan
from antdsl.reload import migrate_world
from antdsl.runtime import Options, bind, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.scene.setting import ClipData, WorldSetting

EVERY_WAY = (*OPTION_SETS, Options(backend="native", wait_for_code=True, chunk=16, shuffle_rows=5))
CLIPS = {
    "a": {
        "walk": ClipData(1.0, 0.5, True, {"foot": 0.5}),
        "run": ClipData(0.5, 1.0, True),
        "wave": ClipData(0.8, 0.0, False, {"top": 0.5}),
        "breathe": ClipData(2.0, 0.0, True),
    }
}
GOES = "match(vector(10 mm/s, 0 mm/s, 0 mm/s))"
HEAD = """species a { size 10 mm
  max_speed 20 mm/s
  response 0.001 s
  on spawn { velocity = vector(10 mm/s, 0 mm/s, 0 mm/s); heading = vector(1, 0, 0) }
"""


def play_states(states: str, steps: int, count: int = 1, start: str = "one", **setting_arguments: object) -> RunHistory:
    return play(
        f"{HEAD}start {start}\n{states} }}",
        crowd(count, radius=20.0),
        steps=steps,
        option_sets=EVERY_WAY,
        clips=CLIPS,
        **setting_arguments,
    )  # type: ignore[arg-type]


def turns(history: RunHistory, number: int = 0, name: str = "clip_turns") -> np.ndarray:
    return np.array(history.every(f"main.{name}", number))


def test_a_clip_that_covers_ground_goes_by_the_ground_and_others_by_the_clock() -> None:
    # 10 mm/s over half a body length of 10 mm a turn: two turns a second.
    walked = turns(play_states(f"state one {{ play walk; steer {GOES} }}", 10))[1:]
    assert np.diff(walked) == pytest.approx(np.full(9, 0.2), abs=1e-5)
    waited = turns(play_states(f"state one {{ play breathe; steer {GOES} }}", 10))[1:]
    assert np.diff(waited) == pytest.approx(np.full(9, 0.05), abs=1e-5)
    hurried = turns(play_states(f"state one {{ play breathe(speed: 3); steer {GOES} }}", 10))[1:]
    assert np.diff(hurried) == pytest.approx(np.full(9, 0.15), abs=1e-5)
    stands = turns(play_states("state one { play walk; steer match(vector(0 mm/s, 0 mm/s, 0 mm/s)) }", 10))[3:]
    assert np.abs(np.diff(stands)).max() < 1e-3


def test_loops_begin_anywhere_and_others_at_their_start() -> None:
    history = play_states(f"state one {{ play walk; steer {GOES} }}", 1, count=40)
    start_turns = [turns(history, k)[0] for k in range(40)]
    assert history.world.faults.fault_count == 0 and min(start_turns) < 0.2 and max(start_turns) > 0.8 and max(start_turns) < 1
    assert turns(play_states(f"state one {{ play wave; steer {GOES} }}", 1))[0] == 0


def test_one_that_does_not_loop_stays_at_its_end_and_is_done() -> None:
    states = f"state one {{ play wave; steer {GOES}; when clip done -> two }}; state two {{ play breathe; steer {GOES} }}"
    history = play_states(states, 14)
    assert history.states() == ["one"] * 9 + ["two"] * 6
    assert turns(history)[:9] == pytest.approx(np.minimum(np.arange(9) * 0.125, 1), abs=1e-5)


def test_a_mark_is_passed_once_a_turn() -> None:
    states = f"state one {{ play walk; steer {GOES}; when clip at foot -> one {{ steps += 1 }} }}; steps = 0"
    history = play_states(states, 41)
    passed = np.diff(np.floor(turns(history)[1:] - 0.5)).sum()
    assert 7 <= history["steps"][0] <= 8 and abs(history["steps"][0] - passed) <= 1
    states = f"state one {{ play wave; steer {GOES}; when clip at top -> two }}; state two {{ play wave; steer {GOES} }}"
    assert play_states(states, 10).states().index("two") == 5
    never = f"state one {{ play walk; steer {GOES}; when clip at nowhere -> two }}; state two {{ play wave; steer {GOES} }}"
    assert set(play_states(never, 20).states()) == {"one"}


def test_the_clip_before_gives_way_in_the_time_that_is_said() -> None:
    states = f"""state one {{ play walk; steer {GOES}; when after 0.5 s -> two over 0.4 s }}
      state two {{ play wave; steer {GOES}; when after 0.6 s -> three }}
      state three {{ steer {GOES} }}"""
    history = play_states(states, 16)
    assert history.states().index("two") == 6 and history.states().index("three") == 12
    fade = turns(history, name="clip_fade")
    assert fade[:6] == pytest.approx(0) and fade[6:11] == pytest.approx([0.75, 0.5, 0.25, 0, 0], abs=1e-6)
    assert fade[12] == pytest.approx(1 / 3, abs=1e-5) and fade[13] == 0  # 0.15 s where nothing is said
    assert history.every("main.clip") == [0] * 6 + [1] * 6 + [-1] * 5
    before_turns = turns(history, name="clip_before_turns")
    assert np.diff(before_turns[6:9]) == pytest.approx(0.2, abs=1e-5)  # it goes on meanwhile


def test_two_that_cover_ground_keep_step() -> None:
    states = f"state one {{ play walk; steer {GOES}; when after 0.5 s -> two }}; state two {{ play run; steer {GOES} }}"
    history = play_states(states, 8)
    last = turns(history)[5]
    assert turns(history)[6] == pytest.approx(last % 1 + 0.1, abs=1e-5)


def test_weights_and_groups() -> None:
    states = f"state one {{ play walk(weight: 0.25); steer {GOES}; when after 0.3 s -> two }}"
    history = play_states(states + f"\nstate two {{ play walk(on: arms, weight: size / 1 mm); steer {GOES} }}", 6)
    assert history.every("main.clip_weight") == [1] + [0.25] * 3 + [1] * 3
    assert [(clip.name, clip.on) for clip in history.world.plan.species["a"].clips] == [("walk", ""), ("walk", "arms")]


def test_machines_play_beside_each_other() -> None:
    text = f"""{HEAD}
      machine legs {{ start one; state one {{ play walk; steer {GOES} }} }}
      machine arms {{ start rest; state rest {{ when after 0.3 s -> wave }}; state wave {{ play wave(on: arms) }} }}
    }}"""
    history = play(text, crowd(1), steps=6, option_sets=EVERY_WAY, clips=CLIPS)
    assert history.every("legs.clip") == [0] * 7 and history.every("arms.clip") == [-1] * 4 + [1] * 3
    assert history.every("arms.clip_fade")[3:6] == pytest.approx([0, 1 / 3, 0], abs=1e-5), "none gives way as well"


def test_a_checkpoint_goes_on_where_clips_are() -> None:
    text = f"{HEAD}start one\nstate one {{ play walk; steer {GOES}; when chance 50 %/s -> two over 0.5 s }}"
    text += f"\nstate two {{ play wave; steer {GOES}; when clip done -> one }} }}"
    setting = WorldSetting(crowds=(crowd(30, radius=40.0),), seed=2, clips=CLIPS)
    original, again = (bind(optimise_plan(plan_of(text)), setting, Options(backend=name)) for name in ("numpy", "reference"))
    for _ in range(20):
        step(original)
    restore_checkpoint(again, take_checkpoint(original))
    hashes = []
    for world in (original, again):
        hashes.append([])
        for _ in range(5):
            step(world)
            hashes[-1].append(state_hash(world))
    assert hashes[0] == hashes[1]


def test_a_mark_at_the_start_is_passed_as_the_clip_begins_and_not_as_it_ends() -> None:
    states = f"state one {{ play wave; steer {GOES}; when clip at start -> one {{ steps += 1 }} }}; steps = 0"
    clips = {"a": {"wave": ClipData(0.8, 0.0, False, {"start": 0.0})}}
    history = play(f"{HEAD}start one\n{states} }}", crowd(1), steps=14, option_sets=EVERY_WAY, clips=clips)
    assert history.every("steps") == [0] + [1] * 14


def test_an_edit_that_renumbers_clips_lets_them_go_on() -> None:
    begin = "species a { size 10 mm\nstart one\n"
    wave = f"state one {{ play wave; steer {GOES}; when after 100 s -> two }}\n"
    rest = f"state two {{ play breathe; steer {GOES} }}\n}}"
    first = f"state nul {{ play breathe; steer {GOES}; when after 1 s -> one }}\n"
    setting = WorldSetting(crowds=(crowd(2, radius=20.0),), seed=2, clips={"a": {"wave": ClipData(5.0, 0.0, False)}})
    world = bind(optimise_plan(plan_of(begin + wave + rest)), setting, Options(backend="numpy"))
    for _ in range(20):
        step(world)
    turns = world.populations["a"].now["main.clip_turns"].copy()
    edited, _ = migrate_world(world, optimise_plan(plan_of(begin + first + wave + rest)), setting)
    ants = edited.populations["a"]
    assert [ants.plan.clips[k].name for k in ants.now["main.clip"]] == ["wave", "wave"]
    step(edited)
    assert ants.now["main.clip_turns"] == pytest.approx(turns + 1 / 24 / 5, abs=1e-6) and not ants.now["main.clip_fade"].any()


@pytest.mark.parametrize(
    ("line", "code", "help"),
    [
        ("play wave; play walk", "two-writers", "play it in a separate machine, `machine arms { … }`"),
        ("channel jaw = 1; channel jaw = age / 1 s", "two-writers", "keep one of them; choose with `if … then … else …`"),
        ("look head(at: self); look head(at: self, over: 0 s)", "two-writers", None),
        ("play wave(on: arms, on: legs)", "duplicate-argument", "delete one of them"),
        ("wear load when", "unfinished-line", "write the line like `wear load when load > 0`"),
        ("enter { play wave }", "misplaced", "write `play wave` as a line of the state itself"),
        ("play wave(on: 3)", "wrong-argument", "write `play wave(on: arms)`"),
        ("play wave(left: 3)", "wrong-argument", "write `play wave(left: wave_left)`"),
        ("play wave(speed: 2 mm)", "wrong-unit", None),
        ("play wave(speed: -3)", "out-of-range", "write `play wave(speed: 1.5)`"),
        ("play wave(weight: 7)", "out-of-range", "write `play wave(weight: 0.5)`"),
        ("play wave(add: age > 1 s)", "wrong-argument", "write `play wave(add: true)`"),
        ("play wave(loud: 2)", "unknown-argument", None),
        ("when clip over -> s", "unknown-name", "write `clip done`, or for a mark `clip at over`"),
        ("when after 1 s -> s over 3 mm", "wrong-unit", None),
    ],
)
def test_mistakes_are_reported_with_a_correction(line: str, code: str, help: str | None) -> None:
    from test_program import checked

    _, report = checked(f"ant 1\nspecies a {{\n  start s\n  state s {{\n    steer heading\n    {line}\n  }}\n}}\n")
    assert [d.code for d in report.errors] == [code], [(d.code, d.message, d.help) for d in report.errors]
    assert report.errors[0].span is not None and help in (None, report.errors[0].help)


def test_how_much_an_agent_turns_and_climbs() -> None:
    # 45 degrees a second to the left; left of +x is -z where +y is up
    steer = "face rotate(heading, about: up, by: 4.5 deg)"
    line = "play walk(left: lean_left, right: lean_right, up: climb, down: descend)"
    turning = f"max_turn 45 deg/s\nstate one {{ {line}; {steer}; steer {GOES} }}"
    history = play_states(turning, 20, start="one")
    turned = np.array(history.every("lean#turn"))
    headings = np.array([history.every(f"heading.{axis}") for axis in "xz"]).T
    rate = np.degrees(np.arctan2(headings[1:-1, 1] * headings[2:, 0] - headings[1:-1, 0] * headings[2:, 1],
                                 (headings[1:-1] * headings[2:]).sum(axis=1))) * 10  # fmt: skip
    assert turned[0] == 0 and turned[-1] == pytest.approx(rate[-2] / 90, abs=0.05) and turned[-1] > 0.2
    assert history.every("lean#slope") == pytest.approx([0] * 21, abs=1e-6), "the ground is level"
    (clip,) = history.world.plan.species["a"].clips
    assert (clip.left_turn_clip, clip.right_turn_clip, clip.climbing_clip, clip.descending_clip) == (
        "lean_left",
        "lean_right",
        "climb",
        "descend",
    ) and clip.has_lean_clips
    straight = play_states(f"state one {{ {line}; steer {GOES} }}", 6)
    assert straight.every("lean#turn") == pytest.approx([0] * 7, abs=1e-6)


def test_who_waits_for_a_clip_where_none_plays_is_warned() -> None:
    from test_program import checked

    def diagnose(first: str, second: str, anywhere: str = "") -> list[tuple[str, str | None]]:
        states = f"  state s {{ steer heading; {first} }}\n  state t {{ steer heading; {second} }}\n"
        text = f"ant 1\nspecies a {{\n  start s\n  {anywhere}\n{states}}}\n"
        return [(each.code, each.help) for each in checked(text)[1].sort_by_place()]

    waits = "when clip done and age > 1 s -> s"
    assert diagnose("play wave; when after 1 s -> t", waits) == [
        ("never-fires", "write `play walk` or another clip as a line of `t`")
    ]
    assert diagnose("play wave; when after 1 s -> t", "play walk; " + waits) == []
    assert diagnose("play wave; when after 1 s -> t", waits.replace(" and ", " or ")) == []
    assert diagnose("play wave; when after 1 s -> t", "when after 1 s -> s", "from any when clip at foot -> t") == []
