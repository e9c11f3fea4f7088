"""Changes during a fade: no pose jumps, whatever comes when; and clips that are played again."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from meaning import RunHistory, crowd, play
from test_clips import EVERY_WAY, HEAD

from antdsl.bodies.agents.blending import blend_poses
from antdsl.bodies.agents.definition import Clip, Definition, Rig
from antdsl.bodies.agents.machine_clips import MachineClips, build_machine_playback
from antdsl.bodies.agents.poses import build_clip_table
from antdsl.scene.setting import ClipData

HEIGHTS = {"low": 0.0, "mid": 40.0, "high": 100.0, "top": 250.0}
CLIPS = {"a": {name: ClipData(0.5, 0.0, name != "top") for name in HEIGHTS}}
STEP = 0.1  # s


def body() -> Definition:
    """A joint that stands still at a height in each clip."""
    still = [
        Clip(name, 24.0, ("hand",), np.array([[[0, y, 0]]], np.float32), np.array([[[0, 0, 0, 1]]], np.float32),
             np.ones((1, 1, 3), np.float32), None, (), np.zeros((1, 0), np.float32))
        for name, y in HEIGHTS.items()
    ]  # fmt: skip
    rig = Rig(("hand",), np.array([-1], np.int32), np.eye(4)[None], ())
    return Definition("hand", rig, clips={clip.name: clip for clip in still})


def play_states(states: str, steps: int) -> RunHistory:
    return play(f"{HEAD}start one\n{states} }}", crowd(1), steps=steps, option_sets=EVERY_WAY, clips=CLIPS)


def heights(history: RunHistory) -> list[float]:
    """Where the hand is in each frame."""
    table = build_clip_table(body())
    clips = tuple((clip.name, clip.on) for clip in history.world.plan.species["a"].clips)
    hand_heights = []
    registers = (
        "clip", "clip_turns", "clip_weight", "clip_before", "clip_before_turns", "clip_before_weight", "clip_fade",
        "clip_earlier", "clip_earlier_turns", "clip_earlier_weight", "clip_earlier_fade",
    )  # fmt: skip
    for frame in history.frames:
        clips_of_machine = MachineClips(*(frame["a"][f"main.{name}"] for name in registers))
        hand_heights.append(
            float(
                blend_poses(table, {}, build_machine_playback(table, clips, [clips_of_machine], 1)).world_transforms[0, 0, 1, 3]
            )
        )
    return hand_heights


def chain(names: tuple[str, ...], stays: tuple[float, ...], over: float) -> str:
    """States that play clips one after the other; `stays`: seconds in each."""
    words = ("one", "two", "three", "four", "five", "six")
    lines = [
        f"state {words[k]} {{ play {name}; when after {stay} s -> {words[k + 1]} over {over} s }}"
        for k, (name, stay) in enumerate(zip(names, stays, strict=True))
    ]
    return "\n".join(lines) + f"\nstate {words[len(names)]} {{ }}"


@pytest.mark.parametrize("stays", [(0.1,) * 5, (0.2, 0.1, 0.1, 0.3, 0.1), (0.3, 0.1, 0.2, 0.1, 0.1)])
def test_no_pose_jumps_however_often_states_change(stays: tuple[float, ...]) -> None:
    for over, names in ((0.5, ("low", "top", "mid", "high", "low")), (0.3, ("top", "low", "top", "mid", "high"))):
        history = play_states(chain(names, stays, over), 20)
        hand_heights = heights(history)
        assert history.states()[-1] == "six" and hand_heights[-1] == pytest.approx(0, abs=1e-3)
        most = max(abs(b - a) for a, b in itertools.pairwise(hand_heights))
        # Two clips give way at once at most, each by STEP / over of what lies between any two.
        assert most <= 250 * (1 - (1 - STEP / over) ** 2) + 1e-3
        assert len(set(np.round(hand_heights, 3))) >= 5


def test_a_third_clip_gives_way_on_and_a_fourth_waits() -> None:
    history = play_states(chain(("low", "top", "mid", "high"), (0.2, 0.1, 0.1, 0.9), 0.4), 14)
    names = [clip.name for clip in history.world.plan.species["a"].clips]
    assert names == ["low", "top", "mid", "high"]
    assert history.states() == ["one"] * 3 + ["two", "three"] + ["four"] * 9 + ["five"]
    assert history.every("main.clip")[:9] == [0, 0, 0, 1, 2, 2, 2, 3, 3]
    assert history.every("main.clip_waits") == [False] * 5 + [True] * 2 + [False] * 8
    assert history.every("main.clip_earlier")[4:8] == [0, 0, 0, 1]
    assert history.every("main.clip_earlier_fade")[4:8] == pytest.approx([0.5, 0.25, 0, 0.0], abs=1e-6)


def test_done_is_of_the_clip_of_the_state_and_not_of_one_that_it_waits_for() -> None:
    states = """state one { play low; when after 0.2 s -> two over 0.4 s }
      state two { play top; when after 0.1 s -> three over 0.4 s }
      state three { play mid; when after 0.1 s -> four over 0.4 s }
      state four { play top; when clip done -> five }
      state five { play low }"""
    history = play_states(states, 16)
    waits, four = history.every("main.clip_waits"), history.states().index("four")
    assert waits[four] and history.states().index("five") == waits.index(False, four) + 6, "0.5 s after it has begun"


def test_the_same_clip_goes_on_or_begins_again() -> None:
    lines = """state one {{ play mid; when after 0.3 s -> two }}
      state two {{ play mid{}; when after 0.3 s -> one }}"""
    on, again = (np.array(play_states(lines.format(option), 8).every("main.clip_turns")) for option in ("", "(again: true)"))
    assert np.diff(on) == pytest.approx(0.2, abs=1e-5)
    assert np.diff(again)[:3] == pytest.approx(0.2, abs=1e-5)
    assert again[4:7] == pytest.approx([0.0, 0.2, 0.4], abs=1e-5) and again[7] == pytest.approx(0.6, abs=1e-5)
    fades = play_states(lines.format("(again: age < 0.1 s)"), 8).every("main.clip_fade")
    assert not any(fades), "a condition, asked as one comes into the state"


def test_again_is_a_yes_or_no() -> None:
    from test_program import checked

    _, report = checked("ant 1\nspecies a {\n  start s\n  state s {\n    steer heading\n    play low(again: 3)\n  }\n}\n")
    assert [d.code for d in report.errors] == ["wrong-kind"]
