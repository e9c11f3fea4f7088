"""Breakpoints and specs in a session under way: they stop where they say, and looking on changes nothing."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from live_client import Page
from preview_page import few

from antdsl.preview import LiveSimulation, PreviewSession
from antdsl.preview.breaking import BreakpointObserver
from antdsl.preview.breaking.conditions import compile_break_condition
from antdsl.preview.breaking.model import BreakpointError
from antdsl.preview.observing import spec_judgement
from antdsl.preview.observing.explainer import Explainer
from antdsl.preview.observing.observer import PauseReason
from antdsl.preview.observing.spec_judgement import SpecObserver
from antdsl.preview.requests import AnyBreak, ConditionBreak, FaultBreak, SpecBreak, StateBreak
from antdsl.runtime import Options
from antdsl.specs.cases import collect_cases
from antdsl.specs.running import RunContext, run_cases

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
WALKERS = """ant 1
use steering
world { surface ground }
species walker {
  param brisk = 1 in 0 .. 2
  max_speed 30 mm/s
  load = 0
  start stroll
  state stroll { steer wander() * brisk; when after 0.25 s -> rest { load += 1 } }
  state rest { when after 0.5 s -> stroll }
  layers { state }
}
spec "nobody rests" { never: count(state == rest) > 0 }
spec "they are three" on "scene.yaml" { always: count(walker) == 3 }
spec "elsewhere" on "other.yaml" { always: count(walker) == 3 }
spec "brisker" { set walker.brisk = 2; always: count(walker) == 3 }
spec "soon" {
  for 1 s
  each walker { within 0.5 s: load > 0 }
}
"""
SCENE = """antdsl: 1
units: mm
up: y
fps: 24
frames: 1..60
world:
  ground: {mesh: ground.ply}
crowd:
  - {species: walker, from: walker.ant, count: 3, place: {on: ground, radius: 60 mm}}
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Three walkers that rest now and then, all at the same time."""
    (tmp_path / "walker.ant").write_text(WALKERS)
    (tmp_path / "scene.yaml").write_text(SCENE)
    shutil.copy(EXAMPLES / "minimal" / "ground.ply", tmp_path)
    return tmp_path / "scene.yaml"


def edit(scene: Path, old: str, new: str) -> None:
    text = scene.with_name("walker.ant").read_text()
    assert old in text
    scene.with_name("walker.ant").write_text(text.replace(old, new))


class Driver:
    """Plays a session as the preview does, with all that looks on."""

    def __init__(self, scene: Path, *breaks: AnyBreak, **how: Any) -> None:
        session, report = PreviewSession.open(scene, **how)
        assert session is not None, [each.message for each in report.errors]
        self.session = session
        self.messages: list[dict[str, Any]] = []
        self.told: list[dict[str, Any]] = []
        self.specs = SpecObserver(self.messages.append)
        self.breaks = BreakpointObserver(self.specs, self.told.append)
        self.set(*breaks)

    @property
    def misfits(self) -> list[tuple[str, str]]:
        return [(each["message"], each["help"]) for each in self.told if each["op"] == "refused"]

    def set(self, *breaks: AnyBreak) -> None:
        self.breaks.set_breakpoints(self.session, breaks)

    def step(self) -> PauseReason | None:
        stop = None
        for each in (self.specs, self.breaks):
            each.before_step(self.session)
        self.session.step()
        for each in (self.specs, self.breaks):
            stop = each.after_step(self.session) or stop
        return stop

    def play(self, frames: int) -> dict[int, PauseReason]:
        stops = {}
        for _ in range(frames):
            stop = self.step()
            if stop is not None:
                stops[self.session.frame] = stop
        return stops

    def spec(self, name: str) -> dict[str, Any]:
        return next(each for each in self.specs.make_message()["specs"] if each["name"] == name)


def state(name: str) -> StateBreak:
    return StateBreak(kind="state", species="walker", machine="main", state=name)


def condition(text: str) -> ConditionBreak:
    return ConditionBreak(kind="condition", text=text)


def spec(name: str) -> SpecBreak:
    return SpecBreak(kind="spec", spec=name)


def test_it_stops_where_agents_enter_a_state(scene: Path) -> None:
    driver = Driver(scene, state("rest"))
    stops = driver.play(40)
    light = driver.session.timeline.reduced_frames
    for frame in range(2, 42):  # in these frames and no others, as the frames themselves have it
        previous_states, now = (light[each]["walker"]["state/main"] for each in (frame - 1, frame))
        assert (frame in stops) == bool(((now == 1) & (previous_states == 0)).any()), frame
    first = min(stops)
    assert stops[first] == PauseReason(f"walker 0, 1, 2 entered rest at frame {first}", "walker", (0, 1, 2))
    assert len(stops) == 2


def test_it_stops_where_a_condition_comes_true_and_not_where_it_stays_so(scene: Path) -> None:
    driver = Driver(scene, condition("count(state == rest) > 1"))
    [first, second] = (stops := driver.play(40))
    assert stops[first].line == f"count(state == rest) > 1: true at frame {first} (count(state == rest) is 3)"
    curves = driver.session.timeline.curves
    assert [frame for frame in range(2, 41) if curves[frame]["walker.main.rest"] > curves[frame - 1]["walker.main.rest"]] == [
        first,
        second,
    ]


def test_a_condition_may_be_checked_for_each_agent(scene: Path) -> None:
    driver = Driver(scene, condition("each walker: load > 1"))
    [(frame, stop)] = driver.play(40).items()
    assert stop == PauseReason(f"walker 0, 1, 2: load > 1 at frame {frame}", "walker", (0, 1, 2))
    assert driver.session.world.populations["walker"].now["load"].min() == 2


def test_simultaneous_stops_are_reported_together(scene: Path) -> None:
    driver = Driver(scene, condition("count(state == rest) > 1"), state("rest"))
    stop = next(iter(driver.play(12).values()))
    assert stop.line.count(" · ") == 1
    assert stop.agents == (0, 1, 2)


@pytest.mark.parametrize(
    ("text", "message", "help"),
    [
        (
            "load > 0",
            "no `load` is known here",
            "write `each walker: load > 0` to test every agent, or use `count` to test all agents together",
        ),
        ("coun(walker) > 1", "no behaviour `coun`", "did you mean `count`?"),
        ("each waker: load > 0", "no species `waker`", "did you mean `walker`?"),
        ("each walker: speed > 1 kg", "`speed` is a speed and `1 kg` is a mass", "write"),
        ("count(walker) >", "line ends after `>`, expected a value", "write the line like `share(state == carry) > 0.9`"),
        ('true\n}\nspecies moth { start go; state go { } }\nspec "x" { never: true', "is not one condition", "write one"),
        ("true\n never: true", "is not one condition", "write one"),
        ("count(walker) > 1 held 2 s", "is not one condition", "write one"),
        ("each walker: chance 3 /s", "draws a random number, but a spec must not change the run", "leave it out"),
    ],
)
def test_a_condition_that_is_none_is_refused_in_words(scene: Path, text: str, message: str, help: str) -> None:
    session, _ = PreviewSession.open(scene)
    assert session is not None
    with pytest.raises(BreakpointError) as error_info:
        compile_break_condition(session.shot, text)
    assert message in error_info.value.message
    assert error_info.value.help.startswith(help)


@pytest.mark.parametrize(
    ("ask", "message", "help"),
    [
        (state("rust"), "there is no state of `walker` `rust`", "did you mean `rest`?"),
        (StateBreak(kind="state", species="walker", machine="mood", state="x"), "there is no machine of `walker` `mood`", ""),
        (StateBreak(kind="state", species="moth", machine="main", state="x"), "there is no species `moth`", "there is `walker`"),
        (spec("nobody restes"), "there is no spec `nobody restes`", "did you mean `nobody rests`?"),
        (spec("elsewhere"), "`elsewhere` is not judged here: its scene is `other.yaml`", "`antdsl test`"),
        (spec("brisker"), "`brisker` is not judged here: it sets `walker.brisk`", "`antdsl test`"),
    ],
)
def test_a_breakpoint_that_does_not_fit_is_reported(scene: Path, ask: AnyBreak, message: str, help: str) -> None:
    driver = Driver(scene, ask)
    [(words, help_text)] = driver.misfits
    assert words.partition(": ")[2].startswith(message)
    assert help_text.startswith(help)
    assert driver.play(10) == {}
    [entry] = driver.breaks.make_message()["breaks"]
    assert entry["made"] == ask.model_dump()
    assert entry["why"].startswith(message)


def test_a_breakpoint_fits_again_when_the_program_does(scene: Path) -> None:
    driver = Driver(scene, state("rest"))
    assert len(driver.play(10)) == 1
    edit(scene, "rest", "pause")
    assert driver.session.reload().is_successful
    assert driver.play(20) == {}
    assert driver.misfits == [("walker enters rest: there is no state of `walker` `rest`", "there is `stroll`, `pause`")]
    edit(scene, "pause", "rest")
    assert driver.session.reload().is_successful
    stops = driver.play(20)
    assert len(stops) == 1
    assert len(driver.misfits) == 1
    assert driver.told[-1] == {"op": "breaks", "breaks": [{"made": state("rest").model_dump(), "why": ""}]}


def test_nothing_stops_while_frames_are_simulated_again_for_a_seek(scene: Path) -> None:
    driver = Driver(scene, state("rest"), condition("count(state == rest) > 1"), checkpoint_interval=4)
    [first, second] = driver.play(40)
    session = driver.session
    session.seek(first + 2)
    assert driver.play(second - first - 3) == {}  # up to the frame before, and what is met at the frame itself is not met there
    assert list(driver.play(1)) == [second]  # it stops there again when it is played again
    session.seek(first - 1)
    session.seek(first)
    assert driver.play(3) == {}


def test_a_spec_is_judged_as_the_tests_judge_it_and_stops_where_it_fails(scene: Path) -> None:
    driver = Driver(scene, spec("nobody rests"), spec("soon"))
    [frame] = (stops := driver.play(40))
    line = "never: count(state == rest) > 0"
    assert stops[frame].line == f"`nobody rests` fails at frame {frame}: {line} (count(state == rest) is 3)"
    assert driver.spec("nobody rests") == {
        "name": "nobody rests", "holds": False, "since": 1, "frame": frame, "species": "", "agents": [],
        "message": f"{line} (count(state == rest) is 3)",
    }  # fmt: skip
    curves = driver.session.timeline.curves
    assert [curves[each]["spec: nobody rests"] for each in (1, frame - 1, frame, 41)] == [1, 1, 0, 0]
    assert [curves[each]["spec: they are three"] for each in (1, 41)] == [1, 1]
    assert driver.spec("elsewhere")["holds"] is None
    assert "spec: elsewhere" not in curves[41]


def test_after_an_edit_a_spec_counts_from_that_frame_on(scene: Path) -> None:
    driver = Driver(scene)
    driver.play(20)
    assert driver.spec("nobody rests")["holds"] is False
    driver.session.seek(4)
    edit(scene, "after 0.25 s", "after 5 s")
    assert driver.session.reload().is_successful
    driver.play(10)
    judged = driver.spec("nobody rests")
    assert (judged["holds"], judged["since"]) == (True, 4)
    driver.session.seek(2)
    driver.play(12)  # through what was simulated, which is not judged again
    assert driver.spec("nobody rests") == judged
    driver.play(3)
    assert driver.session.timeline.curves[17]["spec: nobody rests"] == 1
    driver.session.restart()
    driver.play(3)
    assert driver.spec("nobody rests")["since"] == 1


def test_an_agent_that_fails_a_spec_is_named(scene: Path) -> None:
    edit(scene, "within 0.5 s", "within 0.1 s")
    driver = Driver(scene, spec("soon"))
    [stop] = driver.play(10).values()
    assert (stop.species, stop.agents) == ("walker", (0, 1, 2))
    assert "walker 0 and 2 more" in stop.line


@pytest.mark.parametrize("on_fault", ["stop", "quarantine"])
def test_it_stops_at_a_fault(scene: Path, on_fault: Any) -> None:
    edit(scene, "load += 1", "load += 1 / (load * 0)")
    driver = Driver(scene, FaultBreak(kind="fault"), options=Options(on_fault=on_fault))
    [stop] = driver.play(10).values()
    assert "`load` is not finite" in stop.line
    assert (stop.species, stop.agents) == ("walker", (0,))


@pytest.mark.parametrize("name", ["foraging", "moods", pytest.param("anthill", marks=pytest.mark.slow)])
def test_looking_on_changes_nothing(name: str, tmp_path: Path) -> None:
    """Breakpoints, specs, explanations and the profiler on, and gone back and forth: the hashes are those of a run without."""
    scene = few(tmp_path, 60) if name == "foraging" else EXAMPLES / name / "scene.yaml"
    plain, _ = PreviewSession.open(scene)
    assert plain is not None
    species = next(iter(plain.shot.plan.species))
    machine = plain.shot.plan.species[species].machines[0]
    breaks = [StateBreak(kind="state", species=species, machine=machine.name, state=each) for each in machine.states]
    conditions = [condition(f"count({species}) > 10"), condition(f"each {species}: speed > 5 mm/s and overlap > 1 %")]
    specs = [spec(each.name) for each in plain.shot.program.specs if each.reference_run is None and not each.changes]
    driver = Driver(scene, *breaks, *conditions, *specs, FaultBreak(kind="fault"), checkpoint_interval=6)
    assert driver.misfits == []
    explainer = Explainer(driver.session)
    driver.session.set_measuring(True)
    for _ in range(14):
        plain.step()
        driver.step()
        explainer.make_message(species, 3, driver.session.frame)
        assert driver.session.state_hash == plain.state_hash
    driver.session.seek(5)
    driver.play(12)
    plain.step()
    plain.step()
    assert driver.session.state_hash == plain.state_hash


def test_a_breakpoint_that_is_wrong_is_not_added(scene: Path) -> None:
    driver = Driver(scene, state("rest"), condition("count(state == rest) > 1"))
    initial_message = driver.breaks.make_message()
    wrong = ConditionBreak(kind="condition", text="count(state == rset) > 1")
    with pytest.raises(BreakpointError, match="rset"):
        driver.breaks.set_breakpoints(driver.session, [each.request for each in driver.breaks.breakpoints], wrong)
    assert driver.breaks.make_message() == initial_message
    good = ConditionBreak(kind="condition", text="count(state == rest) > 2")
    driver.breaks.set_breakpoints(driver.session, [each.request for each in driver.breaks.breakpoints], good)
    assert [each.request for each in driver.breaks.breakpoints][-1] == good
    edit(scene, "rest", "sleep")
    driver.session.reload()
    driver.step()
    misfits = len(driver.misfits)
    assert misfits == 3
    driver.breaks.set_breakpoints(driver.session, [each.request for each in driver.breaks.breakpoints], state("sleep"))
    assert len(driver.misfits) == misfits, "what waits is not told of again"


def test_play_stops_at_the_scenes_last_frame_and_is_marked_for_all(scene: Path) -> None:
    scene.write_text(scene.read_text().replace("frames: 1..60", "frames: 1..9"))
    live = LiveSimulation.open_scene(scene)
    live.start()
    try:
        page = Page(live)
        page.ask("speed", times=0)
        page.ask("play")
        assert page.until(lambda: page.last("scene"))["last"] == 9
        status = page.status(playing=False, frame=9)
        assert status["paused_by"] == "frame 9 is the scene's last frame: play continues beyond it"
        marks = [{"frame": 9, "line": status["paused_by"]}]
        page.until(lambda: page.last("stops")["stops"] == marks)
        other = Page(live)
        assert other.until(lambda: other.last("stops"))["stops"] == marks
        page.ask("play")
        page.until(lambda: page.last("status")["frame"] > 12)
        page.ask("pause")
        page.ask("seek", frame=5, exact=True)
        page.ask_and_wait("set", name="walker.brisk", value="0.5")
        page.until(lambda: page.last("stops")["stops"] == [])
    finally:
        live.stop()


def test_a_page_sets_breakpoints_and_hears_of_them(scene: Path) -> None:
    live = LiveSimulation.open_scene(scene)
    live.start()
    try:
        page = Page(live)
        page.ask("breaks", breaks=(state("rest").model_dump(), {"kind": "condition", "text": "count(walkr) > 1"}))
        refused = page.until(lambda: page.last("refused"))
        assert refused == {
            "op": "refused", "of": "breaks", "help": "did you mean `walker`?", "message": refused["message"],
        }  # fmt: skip
        assert refused["message"].startswith("count(walkr) > 1: ")
        other = Page(live)
        entries = other.until(lambda: other.last("breaks"))["breaks"]
        assert [each["why"].startswith("no `walkr`") for each in entries] == [False, True]
        page.ask("speed", times=0)
        page.ask("play")
        status = page.status(playing=False, paused_agents={"species": "walker", "agents": [0, 1, 2]})
        assert status["paused_by"] == f"walker 0, 1, 2 entered rest at frame {status['frame']}"
        specs = page.until(lambda: page.last("specs"))["specs"]
        assert next(each for each in specs if each["name"] == "nobody rests")["frame"] == status["frame"]
        curves = page.until(lambda: page.last("curves"))
        assert curves["values"]["spec: nobody rests"][-1] == 0
        assert page.last("specs")["specs"] == specs
    finally:
        live.stop()


def test_a_spec_that_takes_long_is_let_go_of_unless_it_is_waited_for(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spec_judgement, "_MAX_JUDGING_SECONDS", 0.0)
    monkeypatch.setattr(spec_judgement, "_MAX_JUDGING_SHARE", 0.0)
    driver = Driver(scene, spec("they are three"))
    driver.play(30)
    assert driver.spec("they are three")["holds"] is True
    let_go = driver.spec("soon")
    assert let_go["holds"] is None
    assert let_go["message"].endswith("ms per frame; set a breakpoint on it to judge it anyway")
    assert "spec: soon" not in driver.session.timeline.curves[31]
    driver.set(spec("soon"), spec("they are three"))
    driver.play(1)
    assert driver.spec("soon")["since"] == 31
    assert driver.spec("they are three")["since"] == 1  # goes on as it was


def test_specs_stand_as_the_tests_find_them(scene: Path) -> None:
    edit(scene, "within 0.5 s", "within 0.1 s")
    runs, report = collect_cases([scene])
    assert [each.code for each in report.errors] == ["no-such-file"]  # the other scene of one of them
    run_cases(runs, RunContext(Options()))
    failure_frames = {case.name: case.failures[0].frame if case.failures else None for run in runs for case in run.cases}
    driver = Driver(scene)
    driver.play(59)  # the whole scene
    stand = {each["name"]: each["frame"] for each in driver.specs.make_message()["specs"] if each["holds"] is not None}
    assert stand == {name: failure_frames[name] for name in ("nobody rests", "they are three", "soon")}
    assert stand["soon"] is not None and stand["they are three"] is None


def test_steps_on_end_stop_as_well(scene: Path) -> None:
    live = LiveSimulation.open_scene(scene)
    live.start()
    try:
        page = Page(live)
        page.ask("breaks", breaks=(condition("count(state == rest) > 1").model_dump(),))
        page.ask("step", count=30)
        status = page.until(lambda: (message := page.last("status")) and message["paused_by"] and message)
        assert status["paused_by"].startswith(f"count(state == rest) > 1: true at frame {status['frame']}")
        assert status["frame"] < 15
        page.ask("step", count=2)
        assert page.status(frame=status["frame"] + 2, playing=False)["paused_by"] is None
    finally:
        live.stop()


@pytest.mark.parametrize("on_fault", ["stop", "quarantine"])
def test_behind_a_fault_it_is_explained_as_it_went_on(scene: Path, on_fault: Any) -> None:
    """A session that stops at faults goes on when it is requested to, and no agent is set aside in it."""
    edit(scene, "load += 1", "load += 1 / (load * 0)")
    driver = Driver(scene, checkpoint_interval=50, options=Options(on_fault=on_fault))
    driver.play(30)
    assert driver.session.world.faults.fault_count > 0
    message = Explainer(driver.session).make_message("walker", 1, driver.session.frame)
    if on_fault == "stop":
        assert (message["message"], message["explanation"]["hash"]) == ("", driver.session.state_hash)
    else:
        assert message["message"].startswith("walker 1 is quarantined after a fault")
