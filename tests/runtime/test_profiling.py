"""What a run spends its time on: every moment is counted once, for the line and the layer that it belongs to, and watching the
clock changes nothing."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from children import child_environment
from meaning import crowd, play
from sampling import sampled

from antdsl.cli.printing.profile_table import MAX_LISTED_LINES, print_profile
from antdsl.machine_code import llvm_compiler
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.preview import PreviewSession
from antdsl.runtime import Options, World, bind, phases, state_hash, step
from antdsl.runtime.backends import metering, numpy_backend, numpy_calls
from antdsl.runtime.backends.native import block_runner, compile_queue, programs
from antdsl.runtime.backends.native import native_backend as native_backend
from antdsl.runtime.motion_measures import MotionMeasures
from antdsl.runtime.profiling import StepMeter, StepProfile

ROOT = Path(__file__).parents[2]
NUMPY, NATIVE = Options(backend="numpy"), Options(backend="native", wait_for_code=True)
FORAGING = ROOT / "examples" / "foraging" / "scene.yaml"
in_code = pytest.mark.skipif(
    not (llvm_compiler.is_available() and llvm_compiler.find_host_target().is_x86), reason="no machine code whose lines are timed"
)
BLOCKS = ("decide", "act", "blend", "births")
PROGRAM = """ant 1
use steering
use "./mine.ant" as mine
world { surface ground; obstacle stones }
field scent on ground { cell 10 mm }
species ant {
  max_speed 20 mm/s
  size 4 mm
  start stroll
  state stroll amber {
    when scent > 0.5 -> rest
    steer wander()
  }
  state rest grey { when after 1 s -> stroll }
  layers {
    mine.keep_off(stones, reach: 8 mm)
    state  # "what a state wants"
  }
}
"""
MINE = """ant 1
behaviour keep_off(on: obstacle, reach: length) -> push {
  "Away from what a ray meets."
  let seen = feelers(on, count: 1, reach: reach)
  sum(hit in seen: hit.normal)
}
"""
SCENE = """antdsl: 1
frames: 1..40
world: {{ground: {{mesh: {ground}}}, stones: {{mesh: {stones}}}}}
crowd: [{{species: ant, from: life.ant, count: 60, place: {{on: ground, radius: 60 mm}}}}]
"""


@pytest.fixture
def shot(tmp_path: Path) -> Shot:
    for name in ("terrain.ply", "stones.ply"):
        (tmp_path / name).write_bytes((FORAGING.parent / name).read_bytes())
    (tmp_path / "life.ant").write_text(PROGRAM)
    (tmp_path / "mine.ant").write_text(MINE)
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE.format(ground="terrain.ply", stones="stones.ply"))
    return opened(scene)


def opened(scene: Path, count: int | None = None) -> Shot:
    shot, report = open_scene(scene, RunChoices())
    assert shot is not None, [d.message for d in report.errors]
    if count is None:
        return shot
    crowds = tuple(replace(each, count=count) for each in shot.setting.crowds)
    return replace(shot, setting=replace(shot.setting, crowds=crowds))


def measured(world: World, frames: int, meter: StepMeter | None = None) -> StepProfile:
    meter = meter or StepMeter(None)
    for _ in range(frames):
        meter.begin_measuring(world)
        step(world)
        meter.record_steps(world)
    return meter.profile()


class Clock:
    """A clock that stands still but for what is set to take time."""

    now = 0.0

    def __call__(self) -> float:
        return self.now

    def slow(self, call: Callable[..., Any], seconds: float) -> Callable[..., Any]:
        def run(*words: Any, **keywords: Any) -> Any:
            self.now += seconds
            return call(*words, **keywords)

        return run


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    fake_clock = Clock()
    for module in (metering, numpy_backend, phases):
        monkeypatch.setattr(module, "perf_counter", fake_clock)
    return fake_clock


def test_time_of_a_behaviour_counts_for_its_own_line_and_for_the_layer_that_calls_it(
    shot: Shot, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(numpy_calls.SENSE_FUNCTIONS, "ray", clock.slow(numpy_calls.SENSE_FUNCTIONS["ray"], 0.25))
    monkeypatch.setitem(numpy_calls.SENSE_FUNCTIONS, "field.value", clock.slow(numpy_calls.SENSE_FUNCTIONS["field.value"], 0.05))
    profile = measured(bind(shot.plan, shot.setting, NUMPY), 4)
    assert profile.frames == 4
    assert [(each.line, each.text, round(each.ms, 6)) for each in profile.lines] == [
        (4, "let seen = feelers(on, count: 1, reach: reach)", 250.0),
        (11, "when scent > 0.5 -> rest", 50.0),
    ]
    assert [Path(each.file).name for each in profile.lines] == ["mine.ant", "life.ant"]
    assert [(each.species, each.span.text, round(each.ms, 6)) for each in profile.layers] == [
        ("ant", "mine.keep_off(stones, reach: 8 mm)", 250.0),
        ("ant", "state", 0.0),
    ]
    assert round(profile.total_ms, 6) == 300.0
    assert {name: round(ms, 6) for name, ms in profile.phases.items() if ms} == {"decide": 50.0, "blend": 250.0}


def test_where_threads_go_side_by_side_lines_share_the_time_that_passed(
    shot: Shot, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each chunk takes a quarter second of its thread's own time; by the clock of all, they take half a second together."""
    monkeypatch.setattr(numpy_backend, "perf_counter", lambda: 2.0 * clock.now / 4)
    monkeypatch.setitem(numpy_calls.SENSE_FUNCTIONS, "field.value", clock.slow(numpy_calls.SENSE_FUNCTIONS["field.value"], 0.25))
    profile = measured(bind(shot.plan, shot.setting, Options(chunk=15, backend="numpy")), 3)
    assert [round(each.ms, 6) for each in profile.lines] == [500.0]


@pytest.mark.parametrize(
    "options", sampled([Options(backend="numpy"), Options(threads=2, chunk=64, backend="numpy")], [Options(backend="numpy")])
)
def test_the_lines_add_up_to_all_that_senses_of_the_blocks_take(
    options: Options, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only senses take time on this clock, so nothing is left over for setting up a block."""
    for name, sense in list(numpy_calls.SENSE_FUNCTIONS.items()):
        monkeypatch.setitem(numpy_calls.SENSE_FUNCTIONS, name, clock.slow(sense, 0.01))
    shot = opened(FORAGING.with_name("scene.yaml"), 2000)
    world = bind(shot.plan, shot.setting, options)
    step(world)
    profile = measured(world, 6)
    lines, blocks = sum(each.ms for each in profile.lines), sum(profile.phases[name] for name in BLOCKS)
    assert lines > 100 and lines == pytest.approx(blocks)
    assert sum(each.ms for each in profile.layers) <= profile.phases["blend"] * (1 + 1e-9)
    assert profile.total_ms == pytest.approx(sum(profile.phases.values()))
    assert [each.ms for each in profile.lines] == sorted((each.ms for each in profile.lines), reverse=True)


@pytest.mark.parametrize("options", [Options(backend="numpy"), Options(threads=2, chunk=16, backend="numpy")])
def test_a_run_is_the_same_to_the_bit_while_it_is_measured(options: Options) -> None:
    shot = opened(FORAGING, 120)
    plain, watched = (bind(shot.plan, shot.setting, options) for _ in range(2))
    meter = StepMeter()
    for frame in range(16):
        step(plain)
        if frame // 5 % 2:  # on and off again
            meter.begin_measuring(watched)
        else:
            meter.stop_measuring()
        step(watched)
        meter.record_steps(watched)
        assert state_hash(watched) == state_hash(plain)
    assert meter.profile().frames


def test_a_world_that_is_not_measured_any_more_has_its_own_calls_again() -> None:
    shot = opened(FORAGING, 10)
    world = bind(shot.plan, shot.setting)
    compilers = world.backend._blocks.values()
    own_calls = [list(compiler.root_scope.bound_calls) for compiler in compilers]
    meter = StepMeter()
    measured(world, 1, meter)
    assert [list(compiler.root_scope.bound_calls) for compiler in compilers] != own_calls
    meter.stop_measuring()
    assert [list(compiler.root_scope.bound_calls) for compiler in compilers] == own_calls
    assert world.backend.metered_blocks == {}
    assert meter.profile().frames == 1, "what was measured stays"


def test_a_profile_is_of_the_last_second(shot: Shot, clock: Clock) -> None:
    meter = StepMeter(1.0, clock=clock)
    world = bind(shot.plan, shot.setting)
    frames = []
    for _ in range(8):
        meter.begin_measuring(world)
        step(world)
        clock.now += 0.3
        meter.record_steps(world)
        frames.append(meter.profile().frames)
    assert frames == [1, 2, 3, 4, 4, 4, 4, 4]


def test_the_reference_backend_tells_of_phases(shot: Shot) -> None:
    profile = measured(bind(shot.plan, shot.setting, Options(backend="reference")), 1)
    assert profile.total_ms > 0 and profile.phases["act"] > 0 and not profile.lines
    assert [each.ms for each in profile.layers] == [0.0, 0.0]


def test_a_session_is_measured_across_edits_and_back_in_time(shot: Shot) -> None:
    session, _ = PreviewSession.open(Path(shot.scene.source.path))
    plain, _ = PreviewSession.open(Path(shot.scene.source.path))
    assert session is not None and plain is not None
    session.set_measuring(True)
    assert session.meter is not None
    session.meter = StepMeter(None)  # however slow the machine is
    for _ in range(3):
        session.step()
    assert session.meter.profile().frames == 3
    program = Path(shot.scene.source.path).with_name("life.ant")
    program.write_text(PROGRAM.replace("steer wander()", "steer wander() * 0.5"))
    assert session.reload().is_successful
    session.step()
    profile = session.meter.profile()
    assert profile.frames == 1, "what was measured of the old program is forgotten"
    assert any(each.text == "steer wander() * 0.5" for each in profile.lines)
    session.seek(2)
    session.set_measuring(False)
    assert session.meter is None
    for _ in range(2):
        plain.step()
    assert plain.reload().is_successful is True
    plain.seek(2)
    assert plain.state_hash == session.state_hash


@pytest.mark.slow
def test_run_tells_where_the_time_went(shot: Shot, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "antdsl", "run", "scene.yaml", "--frames", "1..6"]
    environment = child_environment(NO_COLOR="1", COLUMNS="120")
    hashes = []
    for flags in ([], ["--profile"]):
        process = subprocess.run(
            [*words, "--out", f"out{len(flags)}", "--quiet", *flags, "--summary", "summary.json"],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert process.returncode == 0, process.stderr
        hashes.append([line for line in (tmp_path / "summary.json").read_text().splitlines() if "state_hash" in line])
    assert hashes[0] == hashes[1] and hashes[0]
    by = r"(4 frames, by (NumPy|machine code)|\d frames?, by machine code; left out: \d by NumPy before)"
    assert re.match(r"[0-9.]+ ms a frame, [0-9.]+ ms of processors, over " + by + "\n", process.stdout)
    parts = process.stdout.split("\n\n")
    headings = [re.split(r"  +", part.splitlines()[0].strip()) for part in parts[1:]]
    assert headings == [["ms", "cpu ms", "%", "phase"], ["ms", "%", "of", "layer"], ["ms", "%", "in", "line"]]
    assert "mine.keep_off(stones, reach: 8 mm)" in parts[2] and "ant" in parts[2]
    assert len(parts[3].strip().splitlines()) == MAX_LISTED_LINES + 1


def test_a_profile_tells_processor_time_and_keeps_its_figures_at_eighty_columns(
    shot: Shot, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    profile = measured(bind(shot.plan, shot.setting), 3)
    assert set(profile.cpu_ms) == set(profile.phases) and sum(profile.cpu_ms.values()) > 0
    print_profile(profile, show_lines=True)
    output_lines = capsys.readouterr().out.splitlines()
    figures = re.compile(r" *\d+\.\d\d( +\d+\.\d\d)? +\d+  ")
    for line in output_lines[1:]:
        assert len(line) <= 80 and (not line.strip() or " ms  " in line or figures.match(line)), line
    assert "cpu ms" in output_lines[2]


def test_measuring_motion_is_no_part_of_births(shot: Shot, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    world = bind(shot.plan, shot.setting)
    monkeypatch.setattr(MotionMeasures, "record_step", clock.slow(MotionMeasures.record_step, 0.5))
    profile = measured(world, 2)
    assert {name: round(ms) for name, ms in profile.phases.items() if ms} == {"motion": 500}


# --- machine code ------------------------------------------------------------------------------------------------------

WEIGHTS = " + ".join(f"sqrt(abs(pace - {k}.5)) / (abs(mood) + {k}.25)" for k in range(7))
WEIGHED = f"""
species a {{
  pace = 1
  mood = 2
  few = 0
  many = 0
  alone = 0
  start only
  state only {{
    few = few + 1
    many = {WEIGHTS}
    alone = sum(n in neighbours(4 mm): n.few)
    pace = pace * 0.9 + id * 0.01
    when id < 0 -> never
  }}
  state never {{
    mood = mood + 3
  }}
}}
"""


def lines_of(world: World, meter: StepMeter) -> dict[str, float]:
    """A step's lines by their text."""
    meter.begin_measuring(world)
    step(world)
    meter.record_steps(world)
    return {each.text: each.ms for each in meter.profile().lines}


@in_code
def test_lines_of_machine_code_have_the_time_that_they_take() -> None:
    world = play(WEIGHED, crowd(2000, radius=300), option_sets=(NATIVE,)).world
    least: dict[str, float] = {}
    for _ in range(12):  # what else the machine does is not in the least of them
        meter = StepMeter(None)
        line_times = lines_of(world, meter)
        least = {name: min(ms, least.get(name, ms)) for name, ms in line_times.items()}
        profile = meter.profile()
        assert profile.frames_by_backend == {"machine code": 1}
        assert 0 < sum(line_times.values()) <= sum(profile.phases[name] for name in BLOCKS) + 1e-9
    few, many, alone = "few = few + 1", f"many = {WEIGHTS}", "alone = sum(n in neighbours(4 mm): n.few)"
    assert {few, many, alone, "pace = pace * 0.9 + id * 0.01", "when id < 0 -> never"} <= set(least)
    assert min(least.values()) > 0
    assert "mood = mood + 3" not in least, "nobody was there"
    assert least[many] > least[few] and least[alone] > least[few]


def roots(count: int, of: str) -> str:
    return " + ".join(f"sqrt({of} + {k}.5)" for k in range(count))


ROOTS = f"""
species a {{
  pace = 1
  sum_of_all = 0
  state only {{
    let few = {roots(3, "pace")}
    let many = {roots(11, "(pace + id)")}
    let some = {roots(6, "(pace + age / 1 s)")}
    pace = pace + 1
    sum_of_all = few + many + some
  }}
}}
"""


def between(lines: list[str], mark: str, word: str) -> list[int]:
    """How often a word stands between two lines with a mark, without those where it does not."""
    counts = [0]
    for line in lines:
        if mark in line:
            counts.append(0)
        counts[-1] += word in line
    return sorted(filter(None, counts))


@in_code
@pytest.mark.parametrize(
    "target", [llvm_compiler.PORTABLE_TARGET, replace(llvm_compiler.PORTABLE_TARGET, cpu="x86-64", features="-avx2,-fma")]
)
def test_what_a_line_works_out_is_worked_out_between_its_marks(target: llvm_compiler.Target) -> None:
    """Though all of it is read in another line, and LLVM would work it out there, or beside what another line works out."""
    world = play(ROOTS, crowd(3, radius=3), option_sets=(NUMPY,)).world
    timed_program = programs.write_program(world.plan, world.backend.blocks, programs.WorldFacts(False, False, True), target)  # type: ignore[union-attr]
    text = timed_program.units["a.act.0"]
    body = text[text.index("@a.act.0.inside(ptr %t, i64 %begin, i64 %end) noinline") :].splitlines()
    assert between(body, "@llvm.readcyclecounter()", "@llvm.sqrt") == [3, 6, 11]
    code = llvm_compiler.compile_assembly(text, target).splitlines()
    registers = 1 if target.has_avx2 else 2  # of eight floats
    assert between(code, "\trdtsc", "sqrtps") == [registers * each for each in (3, 6, 11)]


@in_code
def test_machine_code_is_the_same_to_the_bit_while_it_is_measured_and_has_marks_only_then(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is called between its stages is reported on its own line, and functions share what they take among theirs."""
    clock = Clock()
    monkeypatch.setattr(block_runner, "perf_counter", clock)
    answer, nothing = block_runner.BATCHED_SENSES["ray"]
    monkeypatch.setitem(block_runner.BATCHED_SENSES, "ray", (clock.slow(answer, 0.25), nothing))  # type: ignore[arg-type]
    function = compile_queue.CompiledPlanCode.get_function
    monkeypatch.setattr(compile_queue.CompiledPlanCode, "get_function", lambda self, name: clock.slow(function(self, name), 0.01))
    plain, watched = (bind(shot.plan, shot.setting, options) for options in (Options(backend="numpy"), NATIVE))
    meter = StepMeter(None)
    codes = []
    for frame in range(15):
        step(plain)
        if frame // 5 % 2:
            meter.begin_measuring(watched)
        else:
            meter.stop_measuring()
        step(watched)
        meter.record_steps(watched)
        codes.append(watched.backend.ready_code)  # type: ignore[union-attr]
        assert state_hash(watched) == state_hash(plain)
    usual, timed = codes[0], codes[5]
    assert codes == [usual] * 5 + [timed] * 5 + [usual] * 5
    assert timed.facts.is_timed and not usual.facts.is_timed
    profile = meter.profile()
    assert profile.frames == 5 and profile.frames_by_backend == {"machine code": 5}
    stages = sum(len(code.function_names) for code in timed.block_codes.values())
    spent = sum(each.ms for each in profile.lines)
    assert (
        profile.lines[0].text == "let seen = feelers(on, count: 1, reach: reach)"
        and 250 <= profile.lines[0].ms < 250 + 10 * stages
    )
    assert 250 < spent <= 250 + 10 * stages + 1e-6
    assert {"when scent > 0.5 -> rest", "steer wander()"} <= {each.text for each in profile.lines}
    assert [each.span.text for each in profile.layers if each.ms >= 250] == ["mine.keep_off(stones, reach: 8 mm)"]


@in_code
def test_until_code_with_marks_has_come_numpy_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    world = play(WEIGHED, crowd(20, radius=30), option_sets=(NATIVE,)).world
    usual = world.backend.ready_code  # type: ignore[union-attr]
    world.options = Options(backend="native")
    coming: list[tuple[Future[Any], Future[Any]]] = []

    def later(*what: Any) -> Future[Any]:
        coming.append((Future(), compile_queue.start_code_build(*what)))
        return coming[-1][0]

    monkeypatch.setattr(native_backend, "start_code_build", later)
    monkeypatch.setattr(native_backend, "_MIN_EARLIER_STEP_SECONDS", 0.0)
    monkeypatch.setattr(native_backend, "find_compiled_code", lambda plan, facts: None)
    meter, times_by_frame = StepMeter(None), []
    for frame in range(5):
        if frame == 3:
            coming[0][0].set_result(coming[0][1].result())
        times_by_frame.append(lines_of(world, meter))
    assert len(coming) == 1 and all(f"many = {WEIGHTS}" in lines for lines in times_by_frame)
    assert meter.profile().frames_by_backend == {"NumPy": 3, "machine code": 2} and meter.profile().frames == 2
    meter.stop_measuring()
    step(world)
    assert world.backend.ready_code is usual is not coming[0][0].result()  # type: ignore[union-attr]


@in_code
def test_where_no_counter_can_be_read_numpy_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    world = play(WEIGHED, crowd(20, radius=30), option_sets=(NATIVE,)).world
    monkeypatch.setattr(llvm_compiler.Target, "is_x86", False)
    meter = StepMeter(None)
    assert lines_of(world, meter)[f"many = {WEIGHTS}"] > 0 and meter.profile().frames_by_backend == {"NumPy": 1}
    meter.stop_measuring()
    step(world)
    assert world.backend.backend_name == "machine code"  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("by", "expected"),
    [
        ({"NumPy": 4}, ", by NumPy"),
        ({"machine code": 4}, ", by machine code"),
        ({"NumPy": 1, "machine code": 4}, ", by machine code; left out: 1 by NumPy before"),
        ({}, ""),
    ],
)
def test_a_profile_says_what_ran_the_lines(by: dict[str, int], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    print_profile(StepProfile(frames=4, phases={"act": 1.0}, total_ms=1.0, frames_by_backend=by), show_lines=True)
    assert capsys.readouterr().out.splitlines()[0] == f"1.00 ms a frame, 0.00 ms of processors, over 4 frames{expected}"
