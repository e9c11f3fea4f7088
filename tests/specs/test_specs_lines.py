"""Lines of specs that look over time and at other runs: `for`, `held`, `when`, `finally`, `pass`, `against`; bodies and cells."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from test_specs import BLOCK, FLIES, GROUND, MORTAL, OPTION_SETS, SCENE, WALKER, collect_runs, failure_text, folder, judged, spec  # noqa: F401

from antdsl.plan.lowering.spec_plans import JudgementPlan
from antdsl.source import Source, Span
from antdsl.specs.cases import resolve_verdicts
from antdsl.specs.lines import FrameObservation, JudgementLine

# In the scene of `WALKER`, `tick` is 0 at frame 1, grows by 0.2 a frame and reaches 2 at frame 11; ten frames a second.
LINES = [
    ("for 0.5 s: max(walker.tick) < 1.1", None),  # frames 1 to 6
    ("for 0.6 s: max(walker.tick) < 1.1", 7),
    ("for 2 s; for 0.6 s: max(walker.tick) < 1.3", None),
    ("never: any(tick > 0.3) held 0.4 s", 7),  # since frame 3, and the four steps before this one
    ("never: any(tick > 0.3) held 5 s", None),
    ("within 0.6 s: any(tick > 0.3) held 0.4 s", None),
    ("within 0.5 s: any(tick > 0.3) held 0.4 s", 6),
    ("until: any(tick > 0.3) held 0.4 s; eventually: any(tick > 1.3)", 7),
    ("for 1 s; finally: max(tick) >= 2", None),
    ("for 1 s; finally: max(tick) < 1.9", 11),
    ("finally: motion.standing <= 100 %", None),
    ("when any(tick > 0.3) within 0.4 s: any(tick > 1.1)", None),  # from frame 3 to frame 7
    ("when any(tick > 0.3) within 0.3 s: any(tick > 1.1)", 6),
    ("when any(tick > 0.3) eventually: any(tick > 1.9)", None),
    ("for 0.7 s; when any(tick > 0.3) eventually: any(tick > 1.9)", 8),
    ("when any(tick > 9) within 0.3 s: any(tick > 99)", None),
    ("when any(tick > 0.3) for 0.4 s: all_below(1.3)", None),
    ("when any(tick > 0.3) for 0.4 s: all_below(1.1)", 7),
    ("each walker { for 0.6 s: tick < 1.1 }", 7),
    ("each walker { never: tick > 0.3 held 0.4 s }", 7),
    ("each walker { when tick > 0.3 within 0.3 s: tick > 1.1 }", 6),
    ("each walker { when tick > 0.3 within 0.3 s: tick > 1.1; until: tick > 0.3 held 0.1 s }", None),
    ("each walker { finally: state == go or tick >= 2 }", None),
]


def test_when_each_line_fails(folder: Path) -> None:  # noqa: F811
    lines = [
        (line.replace("all_below(1.3)", "max(tick) < 1.3").replace("all_below(1.1)", "max(tick) < 1.1"), f) for line, f in LINES
    ]
    specs = "".join(spec(line) for line, _ in lines)
    first = judged(folder, specs)
    for case, (line, frame) in zip(first, lines, strict=True):
        assert [f.frame for f in case.failures] == ([] if frame is None else [frame]), (line, case.failures)
    for options in OPTION_SETS[1:]:
        assert [failure_text(case) for case in judged(folder, specs, **options)] == [failure_text(case) for case in first]  # type: ignore[arg-type]


def walk(kind: str, steps: int | None, since: str, holds: str) -> int | None:
    """The frame in which an agent fails, given its condition frame by frame: true (`#`) or false (`.`)."""
    plan = JudgementPlan(kind, 1, "a", "x", None, (), False, Span(Source("x", ""), 0, 0), None, "y")
    judged, one = JudgementLine(plan, steps, None), np.zeros(1, np.int64)
    for frame, (s, h) in enumerate(zip(since, holds, strict=True)):
        observation = FrameObservation(
            frame, frame + 1 == len(since), one, one, np.array([h == "#"]), np.array([s == "#"]), np.zeros(1, np.bool_)
        )
        if len(judged.find_failed(observation)):
            return frame
    return None


@pytest.mark.parametrize(
    ("kind", "steps", "since", "holds", "frame"),
    [
        ("within", 2, "#....", "..#..", None),  # the last moment counts
        ("within", 2, "#....", "...#.", 2),
        ("within", 2, "#.#..", "...#.", 2),  # coming again gives no more time
        ("within", 2, "####.", "#....", None),  # it comes only where it was not before
        ("within", 2, ".#.#....", ".#......", 5),  # it came again after the first was over
        ("within", 2, "....#", ".....", None),  # its time is not over when the run is
        ("eventually", None, "#.....", ".....#", None),
        ("eventually", None, "#.....", "......", 5),
        ("for", 2, "#....", "###..", None),
        ("for", 2, "#....", "##...", 2),
        ("for", 2, "#.#..", "####.", 4),  # coming again means longer
        ("for", 2, "...#.", "...##", None),
    ],
)
def test_a_time_begins_when_a_condition_becomes_true(
    kind: str, steps: int | None, since: str, holds: str, frame: int | None
) -> None:
    assert walk(kind, steps, since, holds) == frame


def test_agents_that_disappear_while_waiting_fail(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(FLIES)
    lines = ("when tick > 0.45 eventually: tick > 1.5", "when tick > 0.45 and id < 3 within 0.2 s: tick > 0.6")
    first, second = judged(tmp_path, "".join(spec(f"each fly {{ {line} }}") for line in lines), MORTAL)
    (failure,) = first.failures
    assert (
        failure.frame == 12 and failure.agents == (0, 1) and failure.wait_start_frame == 6 and "it left before" in failure.message
    )
    assert not second.failures


def test_a_share_of_the_seeds_is_enough(folder: Path) -> None:  # noqa: F811
    """Whether a random number lies above a bound differs from seed to seed: how often is counted, and required exactly."""
    program = WALKER.replace("born_at = 0", "luck = uniform(0, 1)")
    line = "seeds 1 .. 8; for 0.1 s; always: max(walker.luck) < 0.85"
    plain = judged(folder, spec(line), program)
    passed = sum(case.outcome == "passed" for case in plain)
    assert 0 < passed < 8 and not resolve_verdicts(plain)
    for share, holds in ((passed / 8, True), ((passed + 0.5) / 8, False)):
        cases = judged(folder, spec(f"{line}; pass {share * 100} %"), program)
        (verdict,) = resolve_verdicts(cases)
        assert (verdict.passed_count, verdict.case_count, verdict.has_passed) == (passed, 8, holds)
        outcomes = {case.outcome for case in cases}
        assert outcomes == ({"passed", "allowed"} if holds else {"passed", "failed"})


def test_two_variants_are_compared_seed_by_seed(folder: Path) -> None:  # noqa: F811
    slow = "against { set walker.pace = 1 /s }"
    lines = [
        (f"{slow}; sooner: max(tick) > 1", None),
        ("set walker.pace = 1 /s; against { set walker.pace = 2 /s }; sooner: max(tick) > 1", 7),  # there at frame 7
        ("against \"scene.yaml\"; sooner: max(tick) > 1", 7),  # not sooner than itself
        (f"{slow}; for 0.5 s; sooner: max(tick) > 9", 6),
        (f"{slow}; for 0.5 s; always: total(walker.tick) >= other", None),
        (f"{slow}; for 0.5 s; finally: total(walker.tick) > 1.9 * other and other(count(walker)) == 5", None),
        (f"{slow}; for 0.5 s; always: max(tick) < other + 0.35", 5),  # 0.8 against 0.4
        (f"{slow}; for 0.5 s; finally: motion.standing <= other", None),
        ("against \"slow.yaml\"; sooner: max(tick) > 1", None),
        (f"{slow}; sooner: max(tick) > 1 held 0.2 s", None),
    ]  # fmt: skip
    (folder / "slow.yaml").write_text(SCENE.replace("frames: 1..31", "frames: 101..131") + "set: {walker.pace: 1 /s}\n")
    cases = sorted(judged(folder, "".join(spec(line) for line, _ in lines)), key=lambda case: case.spec.span.start)
    for case, (line, frame) in zip(cases, lines, strict=True):
        assert [f.frame for f in case.failures] == ([] if frame is None else [frame]), (line, case.failures)


def test_the_other_run_has_the_same_seed(folder: Path) -> None:  # noqa: F811
    program = WALKER.replace("born_at = 0", "luck = uniform(0, 1)")
    lines = "seeds 1 .. 3; for 0.2 s; against { set walker.pace = 1 /s }; always: total(walker.luck) == other"
    cases = judged(folder, spec(lines), program)
    assert [case.outcome for case in cases] == ["passed"] * 3
    assert len({case.plan.spec.seeds for case in cases}) == 1


def test_a_fault_in_the_other_run_fails_those_that_compare(folder: Path) -> None:  # noqa: F811
    program = WALKER.replace("tick += pace", "tick += pace; load = 1 / (pace * 1 s - 1)")
    text = spec("for 0.3 s; against { set walker.pace = 1 /s }; sooner: max(tick) > 1") + spec("for 0.3 s; always: any(tick < 9)")
    first, second = judged(folder, text, program)
    assert second.outcome == "passed" and first.outcome == "failed"
    (failure,) = first.failures
    assert failure.message == "in the run that is compared with, `load` is not finite" and failure.frame is not None


PAIR = """antdsl: 1
fps: 10
frames: 1..4
world: {ground: {mesh: ground.ply}, block: {mesh: block.ply}}
crowd:
  - {species: walker, from: walker.ant, count: 2, place: {points: points.json}}
"""
STILL = """ant 1
world { surface ground; obstacle block }
species walker { size 4 mm; max_speed 0.001 mm/s; start sit; state sit { } }
"""


def test_how_bodies_stand_is_bounded(tmp_path: Path) -> None:
    """Two that overlap, as their distance and their radii of 2 mm say; both stand beside a block of 16 mm."""
    (tmp_path / "ground.ply").write_text(GROUND)
    (tmp_path / "block.ply").write_text(BLOCK)
    (tmp_path / "points.json").write_text("[[20, 0, 0], [23, 0, 0]]")
    (tmp_path / "scene.yaml").write_text(PAIR)
    overlap_formula = "1 - distance(nearest(walker)) / (2 * radius)"
    close = f"each walker {{ always: abs(overlap - ({overlap_formula})) < 0.001; "
    close += "always: off_surface < 0.001 mm and penetration == 0 mm }"
    crowd_lines = "always: max(overlap) < 0.3 and max(walker.overlap) > 0.02 and max(penetration) == 0 mm"
    cases = judged(tmp_path, spec(close) + spec(crowd_lines) + spec("each walker { always: overlap < 2 % }"), STILL)
    assert [f.values for c in cases[:2] for f in c.failures] == []
    (failure,) = cases[2].failures
    assert failure.agents == (0, 1) and failure.values[0][1].endswith(" %")


def test_how_deep_a_place_is_in_a_closed_mesh() -> None:
    """In a cube from -8 to 8 the way out is to the nearest side; outside it is none, also where a ray would meet the cube."""
    from antdsl.casting.rays import RayScene

    corners = np.array([[x, y, z] for x, y, z in itertools.product((-8.0, 8.0), repeat=3)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))], np.int32)
    points = np.array([[7.0, 0.3, 0.1], [0.2, -7.5, 0.4], [0.0, 0.1, 0.2], [8.5, 0.0, 0.0], [0.0, -30.0, 0.0], [0.0, 7.9, 20.0]])
    for shift in (0.0, 5000.0):
        depths = RayScene(corners + shift, faces).measure_depth_inside(points + shift)
        assert np.allclose(depths, [1.0, 0.5, 7.8, 0.0, 0.0, 0.0], atol=1e-3), depths


def test_names_of_the_program_override_measures(folder: Path) -> None:  # noqa: F811
    program = WALKER.replace("born_at = 0", "overlap = 7; pass = 1; finally = 2; other = 3")
    text = "each walker { always: overlap == 7 and pass == 1 and finally == 2 and other == 3 }; always: min(walker.overlap) == 7"
    assert not judged(folder, spec(text), program)[0].failures


def test_cells_of_a_field_are_counted(folder: Path) -> None:  # noqa: F811
    program = WALKER.replace("tick += pace", "tick += pace; deposit scent 10 /s").replace(
        "species walker", "field scent on ground { cell 4 mm; half_life 8 s }\nspecies walker"
    ).replace("world {", "world { surface ground;")  # fmt: skip
    (folder / "ground.ply").write_text(GROUND)
    (folder / "scene.yaml").write_text(SCENE.replace("world:", "world:\n  ground: {mesh: ground.ply}"))
    lines = "for 0.4 s; always: count(scent) == at_start and total(scent.value) == total(scent)"
    lines += "; always: count(scent.value > 0) <= 20 and share(scent.value > 0) == count(scent.value > 0) / count(scent)"
    lines += "; finally: count(scent.value > 0.5) > 0 and any(scent.value > 3) and every(scent.value < 99)"
    for options in OPTION_SETS:
        assert not judged(folder, spec(lines), program, **options)[0].failures  # type: ignore[arg-type]
    (case,) = judged(folder, spec("for 0.4 s; never: any(scent.value > 3)"), program)
    assert case.failures[0].values == (("any(scent.value > 3)", "yes"),)


@pytest.mark.parametrize(
    ("line", "code", "help"),
    [
        ("always: count(walker) > 0 held 1 s", "wrong-argument", "delete `held`"),
        ("sooner: count(walker) > 0", "misplaced-line", "add a line such as `against"),
        ("pass 0 %; always: count(walker) > 0", "out-of-range", "`pass 80 %`"),
        ("pass 120 %; always: count(walker) > 0", "out-of-range", "`pass 80 %`"),
        ("pass 50 %; pass 60 %; always: count(walker) > 0", "duplicate-name", "keep one"),
        ("against { }; sooner: count(walker) > 0", "wrong-argument", "write `against { set"),
        ("against { for 2 s }; sooner: count(walker) > 0", "misplaced-line", "outside of `against"),
        ('against "x.json"; sooner: count(walker) > 0', "not-a-scene", "write `against"),
        ('against "x.yaml"; sooner: count(walker) > 0', "no-such-file", ""),
        ("against { set walker.pace = 99 /s }; sooner: count(walker) > 0", "out-of-range", "inside the range"),
        ("against { set walker.pace = 1 /s }; always: other", "at-start-alone", "`other(total(food.load))`"),
        ("against { set walker.pace = 1 /s }; each walker { always: tick > other }", "wrong-rate", "line of the spec itself"),
        ("always: count(walker) >= other", "unknown-name", ""),
        ("each walker { sooner: tick > 1 }", "misplaced-line", "outside of `each"),
        ("when tick > 1 within 1 s: any(tick > 2)", "unknown-name", ""),
        ("when any(tick > 1) within 0 s: any(tick > 2)", "out-of-range", "a time above 0"),
        ("never: any(tick > 1) held 3 mm", "wrong-unit", ""),
        ("always: walker.penetration < 1 mm", "wrong-rate", "`share(walker.penetration"),
        ("eventually: motion.standing > 0 held 1 s", "wrong-argument", "always: motion"),
    ],
)
def test_mistakes_in_lines_are_reported_at_their_place(folder: Path, line: str, code: str, help: str) -> None:  # noqa: F811
    runs, report = collect_runs(folder, spec(line))
    assert [d.code for d in report.errors] == [code], [(d.code, d.message) for d in report.errors]
    assert not runs and report.errors[0].span is not None and help in (report.errors[0].help or "")
