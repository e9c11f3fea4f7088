"""Values that change by so much a frame are reported, with the rate to write; and `--strict` reports every use of `step`."""

from __future__ import annotations

from pathlib import Path

import pytest
from meaning import FAST, play
from test_program import checked, complaints

from antdsl.diagnostics import Diagnostic
from antdsl.loading import ParsedFileCache
from antdsl.pipeline import check_path
from antdsl.source import Source
from antdsl.syntax.formatting.layout import format

AGENT = """use steering
species a {{
  param gain = 0.5 in 0 .. 2
  size 4 mm
  x = 0.5
  y = 3
  far = 5 mm
  room = 5 mm^2
  seen = true
  way = vector(0, 0, 1)
  meal = none of food
  let more = x + 1
  on ping {{ y += 1 }}
  start go
  state go {{ steer heading; {line}; when after 5 s -> rest }}
  state rest {{ when after 1 s -> go {{ x = x + 1; emit ping }} }}
  layers {{ state }}
}}
"""
WORLD = "ant 1\nworld { surface ground; items food { load = 0 } }\n"

# What is written, and what to write instead; None where the message has no text to put there.
PER_FRAME_CASES = [
    ("x = x + 1", "x += 24 /s"),
    ("x = 1 + x", "x += 24 /s"),
    ("x = x - 0.25", "x -= 6 /s"),
    ("x = x + 5 %", "x += 120 %/s"),
    ("x = x + gain", "x += gain * 24 /s"),
    ("room = room + 1 mm^2", "room += 24 mm^2/s"),
    ("x = x + gain * 2 - 0.7", "x += (gain * 2 - 0.7) * 24 /s"),
    ("x = x - gain + 1", None),
    ("far = far + 2 mm", "far += 48 mm/s"),
    ("way = way + heading * 0.1", "way += (heading * 0.1) * 24 /s"),
    ("x = x * 0.9", "x = x * exp(-dt / 0.395 s)"),
    ("x = 0.9 * x", "x = x * exp(-dt / 0.395 s)"),
    ("x = x / 2", "x = x * exp(-dt / 0.0601 s)"),
    ("x = x * 1.1", "x = x * exp(dt / 0.437 s)"),
    ("x = x * gain", None),
    ("x = -x", None),
    ("x = (x + y) / 2", None),
    ("x = mix(x, y, 0.1)", "x = mix(x, y, 1 - exp(-dt / 0.395 s))"),
    ("x = mix(y, x, 0.9)", "x = mix(y, x, exp(-dt / 0.395 s))"),
    ("x = clamp(x + 0.1, 0 .. 4)", "x = clamp(x + 2.4 /s * dt, 0 .. 4)"),
    ("x = min(x * 0.9, 10)", "x = min(x * exp(-dt / 0.395 s), 10)"),
    ("x = if y > 2 then x + 1 else 0", "x = if y > 2 then x + 24 /s * dt else 0"),
    ("x = if y > 2 then x + 1 else x - 1", None),
    ("x = if x < 9 then x + 1 else x", "x = if x < 9 then x + 24 /s * dt else x"),
    ("x = more", None),
    ("seen = not seen", None),
    ("x = grow(x)", None),
    ("x = x + sum(n in neighbours(9 mm): 1)", "x += (sum(n in neighbours(9 mm): 1)) * 24 /s"),
    # `dt` beside it changes nothing about what is done in every step
    ("x = x * 0.9 + 1 /s * dt", "x = x * exp(-dt / 0.395 s) + 1 /s * dt"),
    ("far = far * 0.9 + 1 mm/s * dt", "far = far * exp(-dt / 0.395 s) + 1 mm/s * dt"),
    ("x = x + 1 + 2 /s * dt", "x = x + 24 /s * dt + 2 /s * dt"),
    ("x = x - 2 /s * dt + 1", None),
    ("x = if dt > 0 s then x + 1 else x", "x = if dt > 0 s then x + 24 /s * dt else x"),
    ("x = x * (0.9 + dt / 1 s)", None),
    ("x = x + 0.1 * exp(-dt / 1 s)", None),
    ("x = x + (y - x) * 0.1 * exp(-dt / 1 s)", None),
    ("x = mix(x, y, 0.1 + dt / 1 s)", None),
    ("x = x + 3 mm / (far + 1 mm/s * dt)", None),
    ("x = x + min(1, 2 + dt / 1 s)", None),
    ("x = x * dt * 24 /s", None),
    ("x = x * 0.9 * (dt / 1 s)", None),
    ("x = if y > 2 then x * (dt / 1 s) else x", None),
    ("x = x + sqrt(dt / 1 s)", None),
    ("x = x + (dt / 1 s) ^ 2", None),
    ("way = rotate(way, about: up, by: 5 deg + 1 deg/s * dt)", None),
    ("x += 1 / dt", "x += 24 /s"),
    ("x -= gain / dt", "x -= gain * 24 /s"),
    ("far += 2 mm / dt", "far += 48 mm/s"),
    ("x += x * 0.1 / dt", "x += (x * 0.1) * 24 /s"),
    ("x += 2 /s^2 * dt", None),
    ("x -= 1 /s + gain / dt", None),
    ("max_speed = max_speed * 0.99", "max_speed = max_speed * exp(-dt / 4.15 s)"),
]
FINE = [
    "x += 1 /s",
    "x = 4",
    "x = y + 1",
    "x = max(x, y)",
    "x = clamp(x, 0 .. 1)",
    "x = abs(x)",
    "x = if y > 2 then x else 0",
    "x = if x > 1 then 0 else 1",
    "x = x + 2 /s * dt",
    "x = x * exp(-dt / 1 s)",
    "x = x * (1 - dt / 2 s)",
    "x = x / (1 + dt / 2 s)",
    "x = (x + y * dt / 2 s) / (1 + dt / 2 s)",
    "x = x * 0.9 ^ (dt / 1 s)",
    "x = x + (y - x) * dt / 2 s",
    "x = x + (y - x) * (1 - exp(-dt / 2 s))",
    "x = x + (y - x) * min(1, dt * 2 /s)",
    "x = x + (y - x) * clamp(dt * 2 /s, 0 .. 1)",
    "x = mix(x, y, 1 - exp(-dt / 2 s))",
    "x = mix(y, x, exp(-dt / 2 s))",
    "x = max(0, x - 2 /s * dt)",
    "x = if dt > 0 s then x + 2 /s * dt else x",
    "x = if y > 2 then x + 2 /s * dt else x * exp(-dt / 1 s)",
    "x = x + 2 /s * dt + gain * dt * dt * 1 /s^2",
    "x = x + normal(0, gain) * sqrt(dt / 1 s)",
    "x = x * exp(-dt / 1 s) + normal(0, 1) * sqrt(1 - exp(-dt / 1 s) * exp(-dt / 1 s))",
    "x = x + sum(n in neighbours(9 mm): n.x - x) * dt / 1 s",
    "x = x + sum(n in neighbours(9 mm): (n.x - x) * dt) / 1 s",
    "way = rotate(way, about: up, by: 30 deg/s * dt)",
    "way = unit(way + heading * dt / 1 s)",
    "x = x + distance(position + velocity * dt) / 1 m",
    "x = x + 0.5 /step * dt",
    "x = x + 1 step * 2 /s",
    "x += y * 1 /s",
    "x += x * 1 /s",
    "x += 0.5 /step",
    "x += (y - x) * (1 - exp(-dt / 2 s)) / dt",
    "x += normal(0, 1) / sqrt(dt * 1 s)",
    "x += 1 /s; x = if x > 1 then x - 1 else x",
    "x += 1 /s; x = x - floor(x)",
    "x = if chance 20 %/s then x + 1 else x",
    "x = if ping then x + 1 else x",
    "x = mean(n in neighbours(9 mm): n.x)",
    "seen = seen or y > 2",
    "meal = first(meal, nearest(food))",
    "way = unit(way)",
    "y = remembered()",
]
BEHAVIOURS = """behaviour grow(by: number) -> number { by * 2 }
behaviour remembered() -> number { keep n = 1 then max(n, speed / max_speed); n }
"""


def find_frame_warnings(line: str) -> list[Diagnostic]:
    program, report = checked(WORLD + BEHAVIOURS + AGENT.format(line=line))
    assert report.ok and program is not None, complaints(report)
    return [diagnostic for diagnostic in report.sort_by_place() if diagnostic.code == "per-frame"]


@pytest.mark.parametrize(("line", "instead"), PER_FRAME_CASES)
def test_a_change_by_frame_is_reported_with_its_rate(line: str, instead: str | None) -> None:
    (diagnostic,) = find_frame_warnings(line)
    assert diagnostic.severity == "warning" and diagnostic.span is not None and diagnostic.span.text == line
    if instead is None:
        assert diagnostic.fix is None and "24 frames" not in (diagnostic.help or "")
        return
    assert f"write `{instead}`" in (diagnostic.help or "") and diagnostic.fix is not None
    source = diagnostic.span.source
    mended = source.text[: diagnostic.fix.span.start] + diagnostic.fix.text + source.text[diagnostic.fix.span.end :]
    assert instead in mended
    _, report = checked(mended)
    assert report.ok and "per-frame" not in complaints(report), complaints(report)


@pytest.mark.parametrize("line", FINE)
def test_lines_that_may_run_at_any_rate_are_not_reported(line: str) -> None:
    assert find_frame_warnings(line) == []


RATE_CASES = [
    pair
    for pair in PER_FRAME_CASES[::2]
    if pair[1] and pair[0][0] in "xf" and "neighbours" not in pair[0] and "x < 9" not in pair[0]
]


@pytest.mark.parametrize(("line", "instead"), RATE_CASES)
def test_what_is_written_instead_does_the_same_at_24_frames_a_second_and_at_any_other(line: str, instead: str) -> None:
    name = line.split()[0]

    def final_value(text: str, fps: int) -> float:
        world = WORLD.replace("items food", "items nest { load = 0 }; items food")
        return float(
            play(BEHAVIOURS + AGENT.format(line=text), steps=fps // 2, fps=fps, option_sets=FAST[:1], world=world)[name][0]
        )

    expected = final_value(line, 24)
    assert final_value(instead, 24) == pytest.approx(expected, rel=0.02)
    assert final_value(instead, 96) == pytest.approx(expected, rel=0.05)
    assert final_value(line, 96) != pytest.approx(expected, rel=0.05) or "0 .. 4" in line or ", 10)" in line


def test_a_memory_of_a_behaviour_is_reported_too() -> None:
    text = WORLD + "behaviour ticks() -> number {\n  keep n = 0 then n + 1\n  n\n}\n"
    text += "species a { state s { steer heading * ticks() * 0.01; steer heading * ticks() } }\n"
    _, report = checked(text)
    (diagnostic,) = [each for each in report.sort_by_place() if each.code == "per-frame"]
    assert diagnostic.span is not None and diagnostic.span.text == "n + 1" and diagnostic.help is not None
    assert "`then n + 24 /s * dt`" in diagnostic.help and diagnostic.fix is not None and diagnostic.fix.text == "n + 24 /s * dt"


def test_the_library_and_the_samples_have_none() -> None:
    parsed = ParsedFileCache()
    root = Path(__file__).resolve().parents[2]
    paths = [
        root / "behaviours" / "steering.ant",
        *sorted((root / "examples").rglob("*.ant")),
        *(root / "tests" / "programs").glob("*.ant"),
    ]
    for path in paths:
        _, report = check_path(path, parsed=parsed)
        assert "per-frame" not in [diagnostic.code for diagnostic in report.sort_by_place()], path


# --- the unit `step` --------------------------------------------------------------------------------------------------

STEPS = """ant 1
world {{ surface g }}
field t on g {{ cell 4 mm; {field} }}
behaviour later(by: time = {argument}) -> push {{ heading * (by / 1 s) }}
species a {{
  param wait = {param} in 0 s .. 5 s
  size 4 mm
  response {response}
  x = 0
  start p
  state p {{ steer later(); x += {rate}; deposit t {laid}; when after {after} -> q; when x > 9 held wait -> q }}
  state q {{ steer heading * t; when time_in_state > {time} -> p }}
}}
"""
PER_STEP = {
    "field": "keeps 90 %/step", "argument": "2 step", "param": "12 step", "response": "1 step", "rate": "0.5 /step",
    "laid": "2 /step", "after": "3 step", "time": "6 step",
}  # fmt: skip
PER_SECOND = {
    "field": "half_life 0.274 s", "argument": "0.0833 s", "param": "0.5 s", "response": "0.001 s", "rate": "12 /s",
    "laid": "48 /s", "after": "0.125 s", "time": "0.25 s",
}  # fmt: skip


def test_strict_tells_every_use_of_step_and_what_to_write() -> None:
    text = STEPS.format(**PER_STEP)
    diagnostics = [each for each in checked(text, strict=True)[1].sort_by_place() if each.code == "per-step"]
    step_texts = [value.removeprefix("keeps ") for value in PER_STEP.values()]
    assert sorted(each.span.text for each in diagnostics if each.span) == sorted(step_texts)
    for each in sorted(diagnostics, key=lambda one: -(one.fix.span.start if one.fix else 0)):
        assert each.fix is not None
        text = text[: each.fix.span.start] + each.fix.text + text[each.fix.span.end :]
    assert text == STEPS.format(**PER_SECOND)
    _, report = checked(text, strict=True)
    assert "per-step" not in complaints(report) and report.ok
    assert "per-step" not in complaints(checked(STEPS.format(**PER_STEP))[1])


def test_strict_looks_into_the_files_that_are_used_too(tmp_path: Path) -> None:
    (tmp_path / "mine.ant").write_text("ant 1\nbehaviour slow(by: time = 2 step) -> push { heading * (by / 1 s) }\n")
    main = tmp_path / "a.ant"
    main.write_text('ant 1\nuse "./mine.ant" as mine\nspecies a { state s { steer mine.slow() } }\n')
    _, report = check_path(main, strict=True)
    assert [(each.code, each.span.text) for each in report.sort_by_place() if each.span] == [("per-step", "2 step")]


def test_what_is_written_instead_keeps_the_layout() -> None:
    text = "ant 1\nspecies a {\n  x = 0\n  state s {\n    x = x + 1\n    when x > 2 -> s\n  }\n}\n"
    (diagnostic,) = [each for each in checked(text)[1].sort_by_place() if each.code == "per-frame"]
    assert diagnostic.fix is not None
    mended = text[: diagnostic.fix.span.start] + diagnostic.fix.text + text[diagnostic.fix.span.end :]
    assert format(Source("a.ant", mended))[0] == mended
