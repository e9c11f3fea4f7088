"""`frame` and `time` are those of the frame that a step makes: in states, at birth, in specs, in what `explain` tells, and after
a checkpoint."""

from __future__ import annotations

from pathlib import Path

import pytest
from explained import cached
from meaning import play
from test_specs import GROUND

from antdsl.explain import CacheHistory, StepReplay, explain_agents, format_explanation, open_shot
from antdsl.pipeline import open_scene
from antdsl.runtime import FaultStop, Options, bind, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.specs import RunContext, collect_cases, run_cases

PROGRAM = """ant 1
world { surface ground }
species walker {
  seen = frame
  clock = time
  born_at = frame
  late = 0
  start wait
  state wait { seen = frame; clock = time; when frame == 12 -> go { spawn walker } }
  state go "Goes" amber { seen = frame; clock = time; when time >= 1.4 s -> late_one }
  state late_one { seen = frame; clock = time; late = late + (if late < 1 then frame else 0); when after 9 s -> go }
}
spec "what an animal has noted is the frame it is looked at in" on "scene.yaml" {
  each walker { always: seen == frame; always: abs(clock - time) < 0.0001 s; always: born_at == 5 or born_at == 12 }
  each walker { always: age <= time }
  always: frame != 12 or any(w in walker: w.state == go)
  always: frame >= 12 or every(w in walker: w.state == wait)
  always: every(w in walker: w.late == 0 or w.late == 14)
}
"""
SCENE = """antdsl: 1
fps: 10
frames: 5..20
world: { ground: {mesh: ground.ply} }
crowd: [{species: walker, from: walker.ant, count: 2, place: {radius: 20 mm}}]
output: {checkpoint: 4}
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    for name, text in (("walker.ant", PROGRAM), ("scene.yaml", SCENE), ("ground.ply", GROUND)):
        (tmp_path / name).write_text(text)
    return tmp_path / "scene.yaml"


def test_a_change_at_a_frame_shows_at_that_frame_and_at_a_time_at_that_time() -> None:
    text = """species a { n = 0
start p
state p { when frame == 3 -> q }
state q { n = frame; when time >= 0.5 s -> r }
state r { when false -> p } }"""
    history = play(text, steps=6)  # ten frames a second, from frame 0 on
    assert history.states() == ["p", "p", "p", "q", "q", "r", "r"]
    assert history.every("n") == [0, 0, 0, 3, 4, 4, 4]


def test_at_birth_it_is_the_first_frame_of_the_newborn() -> None:
    text = """species a { mine = frame
since = time / 1 s
heard = -1
on spawn { emit ping }
on ping { heard += frame + 1 }
start p
state p { when frame == 9 and previous == p -> q { spawn a } }
state q { when false -> p } }"""
    history = play(text, steps=4, first_frame=7)
    assert history.at("mine", 0) == [7] and history.at("mine", 2) == [7, 9] and history["since"] == pytest.approx([0.7, 0.9])
    assert history["heard"] == [8, 10]  # in the first step of each


def test_a_fault_is_reported_at_the_frame_that_failed() -> None:
    text = "species a { x = 1\nstart p\nstate p { x = 1 / (frame - 3); when false -> q }\nstate q { when false -> p } }"
    with pytest.raises(FaultStop) as stop:
        play(text, steps=6)
    assert stop.value.fault.frame == 3 and ("(frame - 3)", "0") in stop.value.fault.operands


@pytest.mark.parametrize("backend", ["numpy", "reference"])
def test_a_spec_sees_the_same_frame_and_time_as_the_animals(scene: Path, backend: str) -> None:
    shot, report = open_scene(scene)
    assert shot is not None, report.sort_by_place()
    runs, report = collect_cases([scene.parent / "walker.ant"])
    assert report.ok and runs
    run_cases(runs, RunContext(Options(backend=backend)))
    assert [failure.message for run in runs for case in run.cases for failure in case.failures] == []


def test_explain_describes_the_requested_frame(scene: Path) -> None:
    cache = cached(scene, 20, scene.parent / "out")
    replay = StepReplay(CacheHistory.from_cache(cache, open_shot(cache)))
    for frame, fires in ((11, False), (12, True)):
        (step_report,) = explain_agents(replay, frame, [("walker", 0)])
        assert step_report is not None
        (looked,) = step_report.machines[0].looked
        assert looked.fires is fires and step_report.machines[0].after == ("go" if fires else "wait")
        assert f"frame = {frame}" in format_explanation(step_report)


def test_a_run_goes_on_from_a_checkpoint_with_the_same_frames(scene: Path) -> None:
    shot, _ = open_scene(scene)
    assert shot is not None
    unbroken_world, again = bind(shot.plan, shot.setting), bind(shot.plan, shot.setting)
    for _ in range(5):
        step(unbroken_world)
    restore_checkpoint(again, take_checkpoint(unbroken_world))
    for _ in range(6):
        step(unbroken_world)
        step(again)
        assert state_hash(unbroken_world) == state_hash(again)
    assert set(again.populations["walker"].now["seen"]) == {16.0}
