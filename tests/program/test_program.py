"""The checker on whole programs: the four programs and mistakes put into them, what the checked tree says, and hostile texts."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_program_cases import check_text, find_library

from antdsl.diagnostics import Report
from antdsl.program import check, model
from antdsl.program.traverse import iterate_parts
from antdsl.source import Source
from antdsl.syntax import nodes, parse

TESTS_FOLDER = Path(__file__).parents[1]
PROGRAMS = sorted((TESTS_FOLDER / "programs").glob("*.ant"))
MINIMAL = "ant 1\nuse steering\nspecies a {{\n{}\n}}\n"


def checked(*texts: str, modules: dict[str, nodes.File] | None = None, strict: bool = False) -> tuple[model.Program, Report]:
    report = Report()
    files = []
    for number, text in enumerate(texts):
        file, part_report = parse(Source(f"{number}.ant", text))
        report.extend(part_report)
        files.append(file)
    program, part_report = check(files, find_library, modules, strict=strict)
    report.extend(part_report)
    return program, report


def complaints(report: Report) -> list[str]:
    return [f"{d.span}: {d.code}: {d.message}" for d in report.sort_by_place()]


# --- the programs ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda p: p.stem)
def test_the_programs_have_nothing_to_complain_about(path: Path) -> None:
    assert complaints(check_text(path.read_text(encoding="utf-8"), path.name)) == []


def test_species_of_two_files_meet() -> None:
    program, report = checked(*(path.read_text(encoding="utf-8") for path in PROGRAMS if path.stem in ("hunters", "rabbits")))
    assert complaints(report) == []
    assert sorted(program.species) == ["hunter", "rabbit"]
    prey = next(a for a in program.species["hunter"].attributes if a.name == "prey")
    assert prey.type == model.ValueType(model.TypeKind.AGENT, referent="rabbit")


EDITS = [
    # program, written, instead, code, what is underlined, words of the message or help
    ("forager", "steer arrive(meal)", "steer arive(meal)", "unknown-behaviour", "arive", "`arrive`"),
    ("forager", "within: smell)", "within: 40)", "missing-unit", "40", "`40 mm`"),
    ("forager", "half_life 8 s", "half_life 8 mm", "wrong-unit", "8 mm", "a time"),
    ("forager", "-> follow_trail", "-> follow_trial", "unknown-state", "follow_trial", "`follow_trail`"),
    ("forager", "1 load from meal", "1 load from nest", None, "", ""),
    ("forager", "take 1 load from meal", "take 1 lod from meal", "unknown-name", "lod", "`load`"),
    ("forager", "{ source = meal }", "{ source = nearest(nest) }", "wrong-kind", "nearest(nest)", "an item of `food`"),
    ("forager", "deposit trail reward *", "deposit trail 20 *", "not-a-rate", "20 * falloff(source, floor: size)", "* 1 /s"),
    ("forager", "give all load to nest", "give all load to trail", "wrong-kind", "trail", "a place"),
    ("forager", "spread: 35 deg", "spred: 35 deg", "unknown-argument", "spred", "`spread`"),
    ("forager", "obstacle stones ", "surface  stones ", None, "", ""),
    ("forager", "chance 20 %/s", "chance 20 %", "not-a-rate", "20 %", "%/s"),
    ("forager", "when scent > faint", "when scent > smell", "units-differ", "scent > smell", "a length"),
    ("forager", "when after 0.5 s -> previous", "", "trap", "dig", "leaves state"),
    ("forager", "start search", "start serch", "unknown-state", "serch", "`search`"),
    ("forager", "use steering", "", "unknown-behaviour", "wander", "`use steering`"),
    ("hunters", "none of rabbit", "none of rabit", "unknown-name", "rabit", "`rabbit`"),
    ("hunters", "to: 0.01 .. 1", "to: 0.01 u .. 1 u", "wrong-unit", "direction(prey) * max_speed * ramp", "a velocity"),
    ("hunters", "keep_within: 0.75", "keep_within: 0.75 u", "wrong-unit", "0.75 u", "without a unit"),
    ("hunters", "direction(prey) * max_speed", "direction(prey) * size", "wrong-unit", "direction(prey) * size", "velocity"),
    ("rabbits", "of: hunter)", "of: huntr)", "unknown-name", "huntr", "`hunter`"),
    ("rabbits", "vector(uniform(-1, 1), 0,", "vector(uniform(-1, 1), 0 mm,", "units-differ", "0 mm", "a length"),
    ("roaches", "mood.state == easy ", "mood.state == eazy ", "unknown-state", "eazy", "`easy`"),
    ("roaches", "likes[buddy] +=", "likes +=", "wrong-kind", "likes", "likes[other]"),
    ("roaches", "machine mood", "machine moood", "unknown-name", "mood", "`moood`"),
    ("roaches", "calm -= 0.3", "calm -= 30 %/s", "not-an-amount", "30 %/s", "30 %"),
    ("evacuation", "when scream and chance", "when screem and chance", "unknown-name", "screem", "`scream`"),
    ("evacuation", "on scream { fear += 0.25 }", "on scream { fear = 1 }", "not-commuting", "fear = 1", "fear += 1"),
    ("evacuation", "with: state == fallen", "with: state == falen", "unknown-state", "falen", "`fallen`"),
    ("evacuation", "exit { max_speed = walking }", "exit { max_speed = 0 }", "missing-unit", "0", "0 mm/s"),
]  # fmt: skip


@pytest.mark.parametrize(("program", "old", "new", "code", "underlined", "words"), EDITS, ids=lambda v: str(v)[:20])
def test_a_mistake_is_reported_in_the_artists_words(
    program: str, old: str, new: str, code: str | None, underlined: str, words: str
) -> None:
    text = (TESTS_FOLDER / "programs" / f"{program}.ant").read_text(encoding="utf-8")
    assert text.count(old) >= 1
    place = text.index(old)
    diagnostics = check_text(text[:place] + new + text[place + len(old) :], f"{program}.ant").sort_by_place()
    if code is None:  # the same program in other words
        assert not [d for d in diagnostics if d.severity == "error"]
        return
    first = next((d for d in diagnostics if d.severity == "error"), diagnostics[0])
    assert first.span is not None
    assert first.code == code, diagnostics
    assert first.span.text.startswith(underlined)
    assert words in f"{first.message} {first.help}"
    assert len({d.span.start for d in diagnostics if d.span is not None and d.severity == "error"}) <= 2, diagnostics


def test_nine_mistakes_are_seven_errors_and_then_two_warnings() -> None:
    """What seems idle is reported once the rest is right: until then it may be what was meant where something is wrong."""
    text = (TESTS_FOLDER / "cases" / "nine_mistakes.ant").read_text(encoding="utf-8")
    diagnostics = check_text(text).sort_by_place()
    assert [(d.code, d.span.source.find_line_column(d.span.start)) for d in diagnostics if d.span is not None] == [
        ("missing-unit", (8, 13)),
        ("wrong-unit", (9, 13)),
        ("unknown-behaviour", (13, 11)),
        ("unknown-state", (14, 22)),
        ("unknown-argument", (18, 33)),
        ("not-a-rate", (19, 19)),
        ("two-writers", (20, 42)),
    ]
    for wrong, right in (
        ("max_speed 30", "max_speed 30 mm/s"), ("4 s", "4 mm"), ("wandr", "wander"), ("cary", "carry"), ("slowin:", "slowing:"),
        ("trail 2 }", "trail 2 /s }"), ("deposit trail 2\n", "deposit trail 2 /s\n"), ("; load = 1", ""),
    ):  # fmt: skip
        text = text.replace(wrong, right)
    diagnostics += check_text(text).sort_by_place()
    positions = [(d.code, d.span.source.find_line_column(d.span.start)) for d in diagnostics[7:] if d.span is not None]
    assert {("unused-param", (7, 9)), ("unreachable-state", (22, 9))} <= set(positions)
    assert all(d.severity == "warning" for d in diagnostics[7:])
    helps = " ".join(d.help or "" for d in diagnostics)
    for text in ("`30 mm/s`", "`4 mm`", "`wander`", "`carry`", "`slowing`", "`deposit trail 2 /s`", "`when … -> dig`"):
        assert text in helps


def test_a_let_that_a_state_declares_twice_is_reported() -> None:
    report = check_text(MINIMAL.format("  state s { let a = 1; let a = 2; steer heading * a }"))
    assert [d.code for d in report.errors] == ["duplicate-name"]


def test_a_fix_can_be_put_in_place() -> None:
    text = MINIMAL.format("  max_speed 30\n  state s { steer wander() }")
    fix = check_text(text).errors[0].fix
    assert fix is not None
    mended = text[: fix.span.start] + fix.text + text[fix.span.end :]
    assert complaints(check_text(mended)) == []


def test_a_check_calls_few_functions_and_needs_no_heavy_library() -> None:
    code = """
import sys
from test_program_cases import told
from pathlib import Path
calls = 0
def count(frame, event, argument):
    global calls
    calls += event == "call"
sys.setprofile(count)
report = told(Path(sys.argv[1]).read_text(encoding="utf-8"))
sys.setprofile(None)
assert not report.diagnostics
heavy = {"open3d", "scipy", "trimesh", "numpy", "pydantic"} & set(sys.modules)
print(calls, *heavy)
"""
    code = code.replace("from test_program_cases import told", CHECK_SCRIPT)
    process = subprocess.run(
        [sys.executable, "-c", code, str(TESTS_FOLDER / "programs" / "forager.ant")],
        capture_output=True,
        text=True,
        cwd=TESTS_FOLDER.parent,
        timeout=60,
    )
    calls, *heavy = process.stdout.split()
    assert not heavy and not process.stderr
    assert int(calls) < 400_000


CHECK_SCRIPT = """
from antdsl.program import check
from antdsl.resources import find_library_file
from antdsl.source import Source
from antdsl.syntax import parse
def told(text):
    def library(name):
        return parse(Source(name, find_library_file(name).read_text(encoding="utf-8")))[0]
    file, report = parse(Source("x.ant", text))
    report.extend(check(file, library)[1])
    return report
"""


# --- what the checked tree says --------------------------------------------------------------------------------------


def test_rates_and_amounts() -> None:
    program, report = checked(
        "ant 1\nworld { surface g }\nfield t on g { cell 4 mm; keeps 90 %/step }\n"
        "species a {\n  x = 0\n  start s\n"
        "  state s { deposit t 2 /s; x += 10 %/s; when after 0.5 s -> r { deposit t 3; x -= 1 } }\n"
        "  state r { x = 4; when t > x -> s; when after 1 s -> s }\n}\n"
    )
    assert complaints(report) == []
    s, r = program.species["a"].machines[0].states
    lay, add = s.body
    assert isinstance(lay, model.EffectRequest) and lay.op == "deposit" and lay.per_second
    assert isinstance(lay.args[0], model.Constant) and lay.args[0].number == 2
    assert (
        isinstance(add, model.Assign)
        and add.per_second
        and isinstance(add.value, model.Constant)
        and add.value.number == pytest.approx(0.1)
    )
    deposit, decrease = s.transitions[0].actions
    assert isinstance(deposit, model.EffectRequest) and not deposit.per_second
    assert isinstance(decrease, model.Assign) and not decrease.per_second and decrease.op == "-="
    assert isinstance(r.body[0], model.Assign) and not r.body[0].per_second
    keeps = program.fields["t"].keeps
    assert isinstance(keeps, model.Constant) and (keeps.number, keeps.step) == (0.9, 0)


def test_units_are_worked_out() -> None:
    program, report = checked(
        "ant 1\nspecies a {\n  speedy = 1.5 * 40 mm / 2 min\n  far = 3 u\n  turn = 1 turn / 1 s\n  n = 2 ^ 3\n"
        "  state s { when speedy > 1 mm/s and far > 1 mm and turn > 1 deg/s and n > 1 -> s }\n}\n"
    )
    assert {d.code for d in report.diagnostics} == {"constant-attribute"}
    values = {a.name: a.default for a in program.species["a"].attributes if not a.is_builtin}
    got = {name: (v.number, v.unit_power, tuple(v.type.dimension)) for name, v in values.items() if isinstance(v, model.Constant)}
    assert got["speedy"] == (pytest.approx(0.5), 0, (1, -1, 0, 0))
    assert got["far"] == (3, 1, (1, 0, 0, 0))
    assert got["turn"] == (pytest.approx(6.283185307179586), 0, (0, -1, 0, 1))
    assert got["n"][0] == 8


def test_changes_are_in_the_order_in_which_they_are_looked_at() -> None:
    program, report = checked(
        "ant 1\nspecies a {\n  start s\n  state s { when age > 1 s -> r; interrupt when speed > 2 mm/s -> q }\n"
        "  state r { when after 1 s -> previous }\n  state q { when after 1 s -> choose { s: 2; r: 1 } }\n"
        "  from any except q when age > 9 s held 0.5 s -> r\n}\n"
    )
    assert complaints(report) == []
    s, r, q = program.species["a"].machines[0].states
    assert [c.key for c in s.transitions] == ["a.main.s->q#1", "a.main.from any->r#1", "a.main.s->r#1"]
    assert [c.key for c in r.transitions] == ["a.main.r->previous#1"]  # never into the state one is in
    assert q.transitions[0].choices[0][0] == 0
    assert len(q.transitions) == 1


def keys_of(text: str) -> set[str]:
    program, report = checked(text)
    assert complaints(report) == []
    keys = {b.key for b in iterate_parts(program) if isinstance(b, model.Binding) and b.role == "keep"}
    return keys | {o.site for o in iterate_parts(program) if isinstance(o, model.OperationExpr) and o.site}


def test_moving_lines_changes_no_key() -> None:
    first = "  state s { steer wander(); when chance 1 %/s -> r }\n  state r { when after 1 s -> s }\n"
    other = "  state r { when after 1 s -> s }\n  state s { when chance 1 %/s -> r; steer wander() }\n"
    start, layers = "  start s\n", "  layers { state; wander() * 0.1 }\n"
    a = keys_of(MINIMAL.format(start + first + layers))
    b = keys_of(MINIMAL.format(layers + other + start))
    assert a == b
    assert {"a.main.s.wander#1.turning", "a.layers.wander#1.turning", "a.main.s->r#1.chance#1"} <= a


def test_a_behaviour_takes_the_types_of_its_call() -> None:
    program, report = checked(
        "ant 1\nuse steering\nworld { curve road; items food; species b }\n"
        "species a { state s { steer seek(nearest(food)) + seek(road) + seek(b) + seek(position) } }\n"
    )
    assert complaints(report) == []
    kinds = [
        part.args[0].type.kind
        for part in iterate_parts(program)
        if isinstance(part, model.OperationExpr) and part.name == "direction" and part.args[0] is not None
    ]
    assert set(kinds) == {model.TypeKind.ITEM, model.TypeKind.CURVE, model.TypeKind.AGENT, model.TypeKind.VECTOR}


def test_no_place_is_left_open_in_a_checked_program() -> None:
    for path in PROGRAMS:
        program, _ = checked(path.read_text(encoding="utf-8"))
        for part in iterate_parts(program):
            if isinstance(part, model.Expr):
                assert part.type.kind not in (model.TypeKind.PLACE, model.TypeKind.BAD), (path.stem, part)


def test_attributes_come_after_those_they_start_from() -> None:
    program, report = checked(
        MINIMAL.format("  b = c + size\n  c = d\n  d = radius\n  radius 3 mm\n  state s { when b > c and c > d -> s }")
    )
    assert complaints(report) == []
    order = [a.name for a in program.species["a"].attributes]
    assert order.index("radius") < order.index("d") < order.index("c") < order.index("b")
    assert order.index("size") < order.index("b")


# --- files that use files --------------------------------------------------------------------------------------------


def test_a_module_is_called_by_its_name() -> None:
    module, _ = parse(Source("mine.ant", "ant 1\nbehaviour go() -> push { heading }\nbehaviour bad() -> push { 3 }\n"))
    text = 'ant 1\nuse "./mine.ant" as mine\nspecies a { state s { steer mine.go() + mine.gone() } }\n'
    _, report = checked(text, modules={"./mine.ant": module})
    assert [(d.code, d.span.source.path) for d in report.sort_by_place() if d.span] == [
        ("unknown-behaviour", "0.ant"),
        ("wrong-kind", "mine.ant"),
    ]


def test_files_in_a_circle() -> None:
    a, _ = parse(Source("a.ant", 'ant 1\nuse "./b.ant" as b\nbehaviour go() -> push { b.go() }\n'))
    b, _ = parse(Source("b.ant", 'ant 1\nuse "./a.ant" as a\nbehaviour go() -> push { heading }\n'))
    _, report = check(a, find_library, {"a.ant": a, "b.ant": b})
    assert [d.code for d in report.errors] == ["circle"]


def test_strict_tells_what_depends_on_the_frames_per_second() -> None:
    text = (
        "ant 1\nworld { surface g }\nfield t on g { cell 4 mm; keeps 90 %/step }\n"
        "species a { state s { deposit t 2 /step; when t > 1 -> s } }\n"
    )
    assert complaints(checked(text)[1]) == []
    assert [d.code for d in checked(text, strict=True)[1].sort_by_place()] == ["per-step", "per-step"]


# --- hostile texts ---------------------------------------------------------------------------------------------------


def test_doubling_behaviours_are_counted_before_they_are_put_in_place() -> None:
    lines = ["behaviour b0() -> push { heading }"] + [
        f"behaviour b{n}() -> push {{ b{n - 1}() + b{n - 1}() }}" for n in range(1, 31)
    ]
    started = time.process_time()
    report = check_text("ant 1\n" + "\n".join(lines) + "\nspecies a { state s { steer b30() } }\n")
    assert [d.code for d in report.errors] == ["too-large"]
    assert time.process_time() - started < 2


def test_lets_made_of_each_other_twice_are_looked_at_once() -> None:
    """Put in place of each other they would be 2^60 operations."""
    twice = "".join(f"  let x{n} = x{n + 1} + x{n + 1}\n  let y{n} = y{n + 1} and y{n + 1}\n" for n in range(60))
    ends = "  let x60 = age / 1 s\n  let y60 = uniform(0, 1) > 0.5\n"
    assert check_text(MINIMAL.format(twice + ends + "  state s { when x0 > 1 and y0 -> s }")).ok


def test_long_chains_do_not_break_the_checker() -> None:
    chain = [f"  let x{n} = x{n + 1} + 1" for n in range(200)] + ["  let x200 = age / 1 s"]
    assert check_text(MINIMAL.format("\n".join(chain) + "\n  state s { when x0 > 1 -> s }")).ok
    calls = ["behaviour b0() -> push { heading }"] + [f"behaviour b{n}() -> push {{ b{n - 1}() }}" for n in range(1, 400)]
    report = check_text("ant 1\n" + "\n".join(calls) + "\nspecies a { state s { steer b399() } }\n")
    assert {d.code for d in report.errors} == {"too-deep"}
    nested = "max(" * 60 + "age" + ", 1 s)" * 60
    assert check_text(MINIMAL.format(f"  state s {{ when {nested} > 1 s -> s }}")).ok
    flat = " + ".join(["1"] * 150)
    behaviour_chain = ["behaviour c0(x: number) -> number { x }"] + [
        f"behaviour c{n}(x: number) -> number {{ c{n - 1}(x + {flat}) }}" for n in range(1, 30)
    ]
    assert {
        d.code
        for d in check_text("ant 1\n" + "\n".join(behaviour_chain) + "\nspecies a { state s { when c29(1) > 2 -> s } }\n").errors
    } <= {"too-deep"}


def test_caps_on_what_a_species_declares() -> None:
    states = "".join(f"  state s{n} {{ when after 1 s -> s{(n + 1) % 300} }}\n" for n in range(300))
    assert [d.code for d in check_text(MINIMAL.format("  start s0\n" + states)).errors] == ["too-many"]
    layers = "\n".join(["    heading"] * 40)
    assert [
        d.code
        for d in check_text(MINIMAL.format("  state s { steer heading }\n  layers {\n    state\n" + layers + "\n  }")).errors
    ] == ["too-many"]


def test_one_unknown_name_is_one_complaint() -> None:
    report = check_text(
        MINIMAL.format(
            "  let a = nowhere + 1 mm\n  let b = a * 2\n  state s { steer heading * b; when b > 1 -> s; when no a -> s }"
        )
    )
    assert [d.code for d in report.errors] == ["unknown-name"]
