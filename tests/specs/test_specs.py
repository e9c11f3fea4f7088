"""Specs run: what each line means, when it fails and its messages; the same on both backends, and nothing of a run is changed."""

from __future__ import annotations

import itertools
import shutil
from pathlib import Path

import pytest

from antdsl.diagnostics import Report
from antdsl.pipeline import RunChoices, check_path, open_scene
from antdsl.runtime import Options, bind, state_hash, step
from antdsl.specs import RunContext, SpecCase, SpecRun, collect_cases, run_cases
from antdsl.specs.coverage import SpecCoverage
from antdsl.specs.judge import SpecJudge

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
WALKER = """ant 1
world { items food { load = 0 }; items nest { load = 0 } }
species walker {
  param pace = 2 /s in 0 /s .. 9 /s
  max_speed 30 mm/s
  tick = 0
  load = 0
  born_at = 0
  start go
  state go {
    tick += pace
    when tick >= 2 -> rest
  }
  state rest {
    when time_in_state >= 0.5 s and chance 100 %/s take 0.1 load from nearest(food) -> rest
    when previous == rest -> go
  }
}
"""
SCENE = """antdsl: 1
fps: 10
frames: 1..31
seed: 4
world:
  food: {apple: {at: [0, 0, 0], load: 3.3}, donut: {at: [9, 0, 0], load: 0.7}}
  nest: {home: {at: [0, 0, 0]}}
crowd: [{species: walker, from: walker.ant, count: 5, place: {radius: 20 mm}}]
"""


GROUND = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    "-60 0 -60\n-60 0 60\n60 0 60\n60 0 -60\n3 0 1 2\n3 0 2 3\n"
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "scene.yaml").write_text(SCENE)
    return tmp_path


def collect_runs(folder: Path, specs: str, program: str = WALKER, **choices: object) -> tuple[list[SpecRun], Report]:
    (folder / "walker.ant").write_text(program + specs)
    return collect_cases([folder / "walker.ant"], **choices)  # type: ignore[arg-type]


def judged(folder: Path, specs: str, program: str = WALKER, backend: str = "numpy", **options: object) -> list[SpecCase]:
    runs, report = collect_runs(folder, specs, program)
    assert report.ok, [(d.code, d.message, str(d.span)) for d in report.sort_by_place()]
    run_cases(runs, RunContext(Options(backend=backend, **options)))  # type: ignore[arg-type]
    return [case for run in runs for case in run.cases]


def spec(line: str, name: str = "") -> str:
    """A spec of one line, called by that line where it has no name."""
    name = name or line.replace('"', "'")
    return f'spec "{name}" on "scene.yaml" {{ {line} }}\n'


# `tick` is 0 at frame 1 and grows by 0.2 a frame until it reaches 2 at frame 11.
LINES = [
    ("always: max(walker.tick) < 1.1", 7),
    ("never: max(walker.tick) > 1.1", 7),
    ("always: tick < 1.1", "each"),
    ("always: total(walker.tick) <= 10.5", 30),
    ("for 1.5 s; always: min(walker.tick) == max(walker.tick) and count(walker) == 5", None),
    ("always: mean(walker.tick) <= 0.1", 2),
    ("eventually: share(state == rest) > 90 %", None),
    ("eventually: share(state == rest) > 1", 31),
    ("within 1.2 s: share(walker.state == rest) == 1", None),
    ("within 0.9 s: share(state == rest) == 1", 10),
    ("for 0.5 s; eventually: share(state == rest) == 1", 6),
    ("for 4 s; within 4.5 s: any(walker.tick > 99)", 41),
    ("until: any(tick > 1); always: every(tick < 1.3)", None),
    ("until: any(tick > 1); eventually: any(tick > 1.3)", 7),
    ("always: count(n in walker: n.tick > 1.1) == 0", 7),
    ("always: sum(n in all(walker, with: tick < 1.1): n.tick) == total(walker.tick)", 7),
    ("always: total(walker.tick) <= at_start + 5", 7),
    ("for 1.5 s; always: at_start(count(food)) + total(food.load) == 6", None),
    ("always: count(f in all(food, with: load > 1): true) == 1 and min(food.radius) == 10 mm", None),
    ("always: mean(walker.speed) <= 30.001 mm/s and time < 3.15 s", None),
    ("always: motion.standing <= 100 % and motion.overlap_p99 <= 1 and motion.turn_p99 <= 180 deg", None),
    ("each walker { always: tick <= 2 * mean(walker.tick) + share(load > 9) }", None),
    ("each walker { always: tick <= 0.5 * max(walker.tick) or tick < at_start(total(food.load)) / 4 }", 6),
    ("always: motion.straightness > 0.9 and motion.circling < 5 %", None),
    ("for 1 s; never: motion.straightness <= 1", None),  # no agent has walked for two seconds: there is no such number
    ("for 1 s; always: motion.straightness <= 1", 11),
]


OPTION_SETS = (
    {"backend": "numpy"},
    {"backend": "native", "wait_for_code": True},
    {"backend": "numpy", "chunk": 2, "threads": 2, "shuffle_rows": 3},
    {"backend": "reference"},
)


def failure_text(case: SpecCase) -> str:
    return str([(f.message, f.frame, f.time, f.values, f.agent) for f in case.failures])


def test_when_each_line_fails(folder: Path) -> None:
    """All lines as specs of their own, judged in one simulation, on both backends and with rows in another order."""
    specs = [spec(f"each walker {{ {line} }}" if frame == "each" else line) for line, frame in LINES]
    first = judged(folder, "".join(specs))
    assert len(first) == len(LINES)
    for case, (line, frame) in zip(first, LINES, strict=True):
        expected = [] if frame is None else [7 if frame == "each" else frame]
        assert [f.frame for f in case.failures] == expected, (line, case.failures)
        assert case.outcome == ("failed" if expected else "passed")
    for options in OPTION_SETS:
        assert [failure_text(case) for case in judged(folder, "".join(specs), **options)] == [
            failure_text(case) for case in first
        ]  # type: ignore[arg-type]


def test_values_are_reported_with_the_authors_units(folder: Path) -> None:
    program = WALKER.replace("max_speed 30 mm/s", "max_speed 30 mm/s\n  size 4 mm").replace(
        "tick += pace", "tick += pace; size += 1 mm/s"
    )
    lines = (
        "always: max(walker.size) <= 0.45 cm and share(state == rest) < 20 %; each walker { never: state == rest or size > 1 m }"
    )
    crowd_failure, each = judged(folder, spec(lines), program)[0].failures
    assert (
        crowd_failure.message.startswith("always: max(walker.size)")
        and crowd_failure.span is not None
        and crowd_failure.frame == 7
    )
    assert crowd_failure.values == (("max(walker.size)", "0.46 cm"), ("share(state == rest)", "0 %"))
    assert each.agent == ("walker", 0) and each.values == (("state", "rest"), ("size", "0.005 m"))
    assert crowd_failure.time == pytest.approx(0.6)


def test_nearly_equal_values_are_printed_differently(folder: Path) -> None:
    case = judged(
        folder,
        spec("each walker { always: load == at_start }"),
        WALKER.replace("load = 0\n", "load = 1 relax to 1.00001 over 9 s\n"),
    )[0]
    ((_, now), (_, first)) = case.failures[0].values
    assert first == "1" and now == "1.0000001"
    (case,) = judged(folder, spec("set walker.pace = 1 /s; always: max(walker.tick) <= 0.7"))
    assert case.failures[0].values == (("max(walker.tick)", "0.70000005"),)  # seven times 0.1 is a little more in float32


def test_fractions_of_crumbs_are_counted_exactly(folder: Path) -> None:
    """0.1 is no float32 and 3.3 no float64: what the food loses is what the walkers get, and one lost bit is found."""
    conservation = "always: total(food.load) + total(walker.load) + total(nest.load) == at_start"
    (case,) = judged(folder, spec(f"for 6 s; {conservation}; eventually: total(walker.load) > 1"))
    assert not case.failures
    leak = WALKER.replace("when previous == rest -> go", "when previous == rest and load > 0 -> go { load -= 0.00000001 }")
    (case,) = judged(folder, spec(f"for 6 s; {conservation}"), leak)
    assert len(case.failures) == 1 and case.failures[0].values[0][1] != case.failures[0].values[1][1]


MORTAL = """ant 1
species fly {
  tick = 0
  weight = uniform(1, 2)
  start go
  state go {
    tick += 1 /s
    when id < 2 and tick >= 0.95 -> go { die }
    when id == 3 and tick >= 0.45 -> go { spawn fly; tick = -100 }
    when id == 9 -> go
  }
}
"""
FLIES = "antdsl: 1\nfps: 10\nframes: 1..21\ncrowd: [{species: fly, from: walker.ant, count: 4, place: {radius: 9 mm}}]\n"


SOLID = """ant 1
world { surface ground; solid block }
species mole {
  start dig
  on spawn { heading = vector(1, 0, 0) }
  state dig { carve block(radius: 3 mm) }
}
"""
BLOCK = """ply
format ascii 1.0
element vertex 8
property float x
property float y
property float z
element face 12
property list uchar int vertex_indices
end_header
-8 -8 -8
8 -8 -8
8 8 -8
-8 8 -8
-8 -8 8
8 -8 8
8 8 8
-8 8 8
3 0 2 1
3 0 3 2
3 4 5 6
3 4 6 7
3 0 1 5
3 0 5 4
3 3 6 2
3 3 7 6
3 0 4 7
3 0 7 3
3 1 2 6
3 1 6 5
"""


def test_specs_read_the_volume_of_a_solid(tmp_path: Path) -> None:
    (tmp_path / "block.ply").write_text(BLOCK)
    (tmp_path / "scene.yaml").write_text(
        "antdsl: 1\nfps: 10\nframes: 1..6\nworld: {ground: {mesh: ground.ply}, block: {mesh: block.ply, voxel: 1 mm}}\n"
        "crowd: [{species: mole, from: walker.ant, count: 3, place: {around: [-13, 0, 0], radius: 1 mm}}]\n"
    )
    (tmp_path / "ground.ply").write_text(GROUND)
    specs = spec("always: total(block) <= at_start and total(block) > 3000 mm^3; eventually: total(block) < at_start - 20 mm^3")
    specs += spec("always: total(block) == at_start")
    sound, dug = judged(tmp_path, specs, SOLID)
    assert not sound.failures
    (failure,) = dug.failures
    assert failure.frame == 2 and failure.values[1][1].startswith("4099.6") and failure.values[1][1].endswith(" mm^3")


EACH = [
    ("within 0.5 s: tick >= 0.45", None, None, ""),
    ("within 0.3 s: tick >= 0.45", 4, 0, "the time is over"),
    ("eventually: tick > 1.5", 12, 0, "it left before"),
    ("eventually: tick > 1.5; until: tick > 0.9", 21, 3, "the run is over"),
    ("within 1.9 s: tick < 0", 12, 0, "it left before"),
    ("always: weight == at_start", None, None, ""),
    ("always: tick < 0.6", 7, 0, ""),
    ("always: tick < 0.6; until: tick >= 0.5", None, None, ""),
    ("always: id < 4 or tick < 0.75", 15, 4, ""),
    ("always: age <= time", None, None, ""),
    ("never: count(n in fly: n.tick < -1) == 1 and id != 3 and tick > 0.75", 9, 0, ""),
]


def test_each_agent_has_a_separate_time(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(FLIES)
    specs = "".join(spec(f"each fly {{ {lines} }}") for lines, *_ in EACH)
    for options in OPTION_SETS:
        for case, (lines, frame, agent, why) in zip(judged(tmp_path, specs, MORTAL, **options), EACH, strict=True):  # type: ignore[arg-type]
            failures = [(f.frame, f.agent) for f in case.failures]
            assert failures == ([] if frame is None else [(frame, ("fly", agent))]), (lines, case.failures)
            assert all(why in f.message for f in case.failures)


def test_seeds_params_and_fields_are_set(folder: Path) -> None:
    program = WALKER.replace("tick += pace", "tick += pace; deposit scent 10 /s").replace(
        "species walker", "field scent on ground { cell 4 mm; half_life 8 s }\nspecies walker"
    ).replace("world {", "world { surface ground;")  # fmt: skip
    (folder / "ground.ply").write_text(GROUND)
    (folder / "scene.yaml").write_text(SCENE.replace("world:", "world:\n  ground: {mesh: ground.ply}"))
    specs = [
        'spec "quick" on "scene.yaml" { seeds 1 .. 2; seeds 7; set walker.pace = 4 /s; for 0.6 s; '
        "always: share(state == go) == 1 }",
        'spec "gone" on "scene.yaml" { set scent.keeps = 0 %/step; for 0.6 s; '
        "always: total(scent) <= 5.001; eventually: max(scent) > 0 }",
        'spec "stays" on "scene.yaml" { for 0.6 s; eventually: total(scent) > 5.001; each walker { eventually: scent > 0 } }',
    ]
    case_list = judged(folder, "\n".join(specs) + "\n", program)
    assert [(c.name, c.seed, c.failures[0].frame if c.failures else None) for c in case_list] == [
        ("quick", 1, 7), ("quick", 2, 7), ("quick", 7, 7), ("gone", 4, None), ("stays", 4, None),
    ]  # fmt: skip


def test_one_simulation_serves_all_specs_of_a_scene(folder: Path) -> None:
    text = spec("always: count(walker) == 5", "a") + spec("set walker.pace = 3 /s; always: count(walker) == 5", "b")
    runs, _ = collect_runs(folder, text + spec("seeds 3 .. 4; always: count(walker) == 5", "c"))
    assert [[(c.name, c.seed) for c in run.cases] for run in runs] == [[("a", 4), ("c", 4)], [("b", 4)], [("c", 3)]]
    runs, _ = collect_runs(folder, text + spec("seeds 3 .. 4; always: count(walker) == 5", "c"), seeds=2)
    assert [[(c.name, c.seed) for c in run.cases] for run in runs] == [
        [("a", 1), ("c", 1)], [("a", 2), ("c", 2)], [("b", 1)], [("b", 2)],
    ]  # fmt: skip
    runs, _ = collect_runs(folder, text, name_filter="B")
    assert [c.name for run in runs for c in run.cases] == ["b"]


def test_judging_does_not_change_the_run(folder: Path) -> None:
    lines = "always: total(food.load) <= at_start; each walker { always: tick == at_start or distance(nearest(food)) < 1 m }"
    runs, report = collect_runs(folder, spec(lines))
    assert report.ok
    (run,) = runs
    watched, alone = (bind(run.shot.plan, run.shot.setting) for _ in range(2))
    SpecCoverage().watch_world(watched, run.shot.program)
    judge = SpecJudge(run.cases[0].plan, watched, 31)
    while not judge.is_over:
        judge.judge_frame(watched)
        assert state_hash(watched) == state_hash(alone)
        step(watched)
        step(alone)
    assert alone.frame > 30


def test_a_fault_fails_the_case_at_its_place(folder: Path) -> None:
    program = WALKER.replace("tick += pace", "tick += pace; load = 1 / (tick - 1)")
    runs, _ = collect_runs(folder, spec("always: count(walker) == 5") + spec("seeds 1; always: count(walker) == 5", "y"), program)
    coverage = SpecCoverage()
    run_cases(runs, RunContext(Options(), coverage))
    for case in (case for run in runs for case in run.cases):
        (failure,) = case.failures
        assert case.outcome == "failed" and failure.message == "`load` is not finite" and failure.agent == ("walker", 0)
        assert failure.span is not None and "load = 1 / (tick - 1)" in program[failure.span.start - 2 : failure.span.end + 20]
        assert failure.frame is not None and failure.frame <= 7 and ("(tick - 1)", "0") in failure.values


def test_states_and_changes_that_no_agent_reached_are_known(folder: Path) -> None:
    program = WALKER.replace("  }\n}\n", "    when tick > 99 -> far\n  }\n  state far { when after 1 s -> go }\n}\n")
    runs, _ = collect_runs(folder, spec("for 3 s; always: count(walker) == 5"), program)
    coverage = SpecCoverage()
    run_cases(runs, RunContext(Options(), coverage))
    visit_counts = {each.name: each.count for each in (*coverage.states.values(), *coverage.changes.values())}
    assert (
        visit_counts["walker.main.far"] == visit_counts["walker.main.rest->far#1"] == visit_counts["walker.main.far->go#1"] == 0
    )
    assert (
        visit_counts["walker.main.go->rest#1"] >= 5
        and visit_counts["walker.main.rest"] > 5
        and visit_counts["walker.main.go"] >= 5 * 10
    )
    food = runs[0].shot.setting.items["food"]
    assert 0 < visit_counts["walker.main.rest->rest#1"] <= round(sum(i.attributes["load"] for i in food) / 0.1)


def test_transitions_of_dying_agents_are_counted(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(FLIES)
    runs, _ = collect_runs(tmp_path, spec("always: count(fly) >= 0"), MORTAL)
    coverage = SpecCoverage()
    run_cases(runs, RunContext(Options(), coverage))
    assert [each.count for each in coverage.changes.values()] == [2, 1, 0]


@pytest.mark.parametrize(
    ("specs", "code"),
    [
        ('spec "x" on "none.yaml" { always: count(walker) > 0 }', "no-such-file"),
        ('spec "x" on "../scene.yaml" { always: count(walker) > 0 }', "bad-path"),
        ('spec "x" on "other.yaml" { always: count(walker) > 0 }', "other-scene"),
        ('spec "x" on "broken.yaml" { always: count(walker) > 0 }', "unknown-key"),
        ('spec "x" on "scene.yaml" { always: total(ghost.load) > 0 }\nworld { species ghost { load = 0 } }', "not-yet"),
        ('spec "x" on "scene.yaml" { always: min(food.load * slope) > 0 deg }', "not-yet"),
        ('spec "x" on "scene.yaml" { always: any(food.load > 3 and touching(nest)) }', "not-yet"),
    ],
)
def test_a_spec_that_cannot_run_is_reported_at_its_place(folder: Path, specs: str, code: str) -> None:
    (folder / "other.ant").write_text("ant 1\nspecies b { state s { steer heading }; layers { state } }\n")
    (folder / "other.yaml").write_text("antdsl: 1\nframes: 1..2\ncrowd: [{species: b, from: other.ant, count: 1}]\n")
    (folder / "broken.yaml").write_text("antdsl: 1\nfrmes: 1..2\n")
    runs, report = collect_runs(folder, specs + "\n")
    assert [d.code for d in report.errors] == [code], report.errors
    assert not runs and report.errors[0].span is not None and report.errors[0].help


def test_specs_without_a_scene_use_the_named_or_adjacent_one(folder: Path) -> None:
    line = 'spec "x" { always: count(walker) > 0 }\n'
    runs, report = collect_runs(folder, line)
    assert report.ok and [c.scene.name for run in runs for c in run.cases] == ["scene.yaml"]
    (folder / "scene.yaml").rename(folder / "shot.yaml")
    runs, report = collect_runs(folder, line)
    assert not runs and [d.code for d in report.errors] == ["no-scene"]
    runs, report = collect_cases([folder / "shot.yaml"])
    assert report.ok and [c.scene.name for run in runs for c in run.cases] == ["shot.yaml"]


def test_a_param_of_a_spec_changes_only_that_run(folder: Path) -> None:
    (folder / "walker.ant").write_text(WALKER + spec("set walker.pace = 3 /s; always: count(walker) == 5"))
    shot, _ = open_scene(folder / "scene.yaml", RunChoices())
    assert shot is not None and shot.setting.params == {}
    (changes,) = (s.changes for s in shot.program.specs)
    changed, _ = open_scene(folder / "scene.yaml", RunChoices(changes=changes))
    assert changed is not None and changed.setting.params == {"walker.pace": 3.0}
    assert changed.inputs != shot.inputs


def test_specs_on_an_empty_crowd_and_preroll(folder: Path) -> None:
    (folder / "scene.yaml").write_text(SCENE.replace("count: 5", "count: 0").replace("seed: 4", "seed: 4\npreroll: 4"))
    lines = "always: count(walker) == 0 and share(state == go) == 0 and total(walker.load) == 0"
    lines += "; always: min(walker.tick) > 1; always: frame >= 1"
    (case,) = judged(folder, spec(lines + "; each walker { always: load == at_start; eventually: load > 9 }"))
    assert not case.failures and case.frames == 31


def test_runs_give_the_same_results_in_any_order_of_lines(folder: Path) -> None:
    """The first failure of each line, and no line hides another."""
    lines = ["always: max(tick) < 1.1", "never: any(tick > 0.5)", "within 0.2 s: any(tick > 0.5)", "eventually: any(tick > 9)"]
    for order in itertools.islice(itertools.permutations(lines), 0, 24, 5):
        (case,) = judged(folder, spec("; ".join(order)))
        frame_by_message = {f.message.split(" (")[0]: f.frame for f in case.failures}
        assert frame_by_message == {lines[0]: 7, lines[1]: 4, lines[2]: 3, lines[3]: 31}


SPEC = 'spec "{}" on "{}" {{ {}; for 1 s; always: count(walker) > 0 }}\n'


def test_check_finds_scenes_of_specs_that_are_not_there(tmp_path: Path) -> None:
    """In the program that names them and in a scene that brings the program; running another spec is not held up by it."""
    for file in ("walker.ant", "ground.ply", "scene.yaml"):
        shutil.copy(EXAMPLES / "minimal" / file, tmp_path)
    program = tmp_path / "walker.ant"
    text = program.read_text() + SPEC.format("a", "scene.yaml", "seeds 1") + SPEC.format("b", "scen.yaml", "seeds 1")
    text += SPEC.format("c", "scene.yaml", 'against "other.yaml"') + SPEC.format("d", "../scene.yaml", "seeds 1")
    program.write_text(text)
    for path in (program, tmp_path / "scene.yaml"):
        errors = check_path(path)[1].errors
        error_places = [(e.code, e.span.text) for e in errors if e.span is not None]
        assert error_places == [
            ("no-such-file", '"scen.yaml"'),
            ("no-such-file", '"other.yaml"'),
            ("bad-path", '"../scene.yaml"'),
        ]
        assert all(e.help for e in errors) and errors[0].fix is not None and errors[0].fix.text == '"scene.yaml"'
    runs, report = collect_cases([program], name_filter="a")
    assert report.ok and len(runs) == 1


def test_a_missing_scene_is_reported_once_with_all_places(tmp_path: Path) -> None:
    for file in ("walker.ant", "ground.ply", "scene.yaml"):
        shutil.copy(EXAMPLES / "minimal" / file, tmp_path)
    program = tmp_path / "walker.ant"
    text = program.read_text() + SPEC.format("a", "none.yaml", "seeds 1") + SPEC.format("b", "none.yaml", "seeds 1")
    text += SPEC.format("c", "scene.yaml", 'against "none.yaml"') + SPEC.format("d", "other.yaml", "seeds 1")
    program.write_text(text)
    for report in (check_path(program)[1], check_path(tmp_path / "scene.yaml")[1], collect_cases([program])[1]):
        first, other = report.errors
        assert [first.span and first.span.text, other.span and other.span.text] == ['"none.yaml"', '"other.yaml"']
        assert [label.text for label in first.labels] == ["and here", "and here"] and not other.labels
        assert [label.span.text for label in first.labels] == ['"none.yaml"'] * 2


def test_two_specs_of_one_file_have_two_names(tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "minimal", tmp_path, dirs_exist_ok=True)
    program = tmp_path / "walker.ant"
    program.write_text(program.read_text() + 3 * SPEC.format("a", "scene.yaml", "seeds 1"))
    errors = check_path(program)[1].errors
    assert [(e.code, len(e.labels)) for e in errors] == [("duplicate-name", 1)] * 2
    assert {e.labels[0].span.start for e in errors} == {program.read_text().index('"a"')}
