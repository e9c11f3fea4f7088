"""`0,4` for `0.4`: reported at its place with what to write, wherever a number can stand, and two values stay two values."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from antdsl.diagnostics import Diagnostic, Report
from antdsl.loading import find_library
from antdsl.program import check
from antdsl.scene.load import load_scene_text
from antdsl.scene.paths import Roots
from antdsl.source import Source
from antdsl.syntax import parse
from antdsl.syntax.scan import scan_tokens

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "examples").rglob("*.ant"))
AROUND = (
    "ant 1\nuse steering\nworld {{ surface ground; items food {{ load = 0 }} }}\nspecies bug {{ calm = 0; state go {{ {} }} }}\n"
)


def find_errors(text: str) -> list[Diagnostic]:
    file, report = parse(Source("a.ant", text))
    report.extend(check(file, find_library)[1])
    return report.errors


def numbers(path: Path) -> Iterator[tuple[int, int]]:
    """Places of the numbers of a file without their units, less the edition and seeds, which are whole."""
    text = path.read_text(encoding="utf-8")
    for token in scan_tokens(Source(path.name, text), Report()).tokens:
        line = text[text.rfind("\n", 0, token.start) + 1 : token.start]
        if token.kind == "number" and not re.match(r"ant\b|\s*seeds\b", line):
            digits = re.match(r"[0-9.]+(?![0-9.eE])", text[token.start :])
            if digits is not None:
                yield token.start, token.start + digits.end()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_any_number_written_with_a_comma_is_one_error_there(path: Path) -> None:
    """A handful of each file; whether it can be mended at a stroke depends on whether two arguments could have been meant."""
    text = path.read_text(encoding="utf-8")
    number_spans = list(numbers(path))
    for start, end in number_spans[:: len(number_spans) // 6 + 1]:
        number = text[start:end]
        comma = number.replace(".", ",") if "." in number else f"{number},0"
        errors = find_errors(text[:start] + comma + text[end:])
        assert [error.code for error in errors] == ["bad-number"], (text[start - 30 : end + 9], [e.message for e in errors])
        (error,) = errors
        assert error.span is not None and (error.span.start, error.span.text) == (start, comma)
        assert f"`{comma.replace(',', '.')}`" in (error.help or "")
        if error.fix is not None:
            assert (error.fix.span, error.fix.text) == (error.span, comma.replace(",", "."))


LISTS = [
    "steer vector(1,2,3)",
    "steer vector(0,4,0)",
    "calm = min(0,4)",
    "calm = pick(0,4)",
    "calm = pick(1,2,3,4)",
    "calm = uniform(0,4)",
]
LISTS += [
    "steer vector(0,4,0)",
    "calm = min(0.5,4)",
    "calm = clamp(calm, 0 .. 1)",
    "calm = max(calm,4)",
    "calm = count(n in neighbours(4 mm,4 rad): n.calm > 1)",
]


@pytest.mark.parametrize("line", LISTS)
def test_a_comma_between_two_values_needs_no_blank(line: str) -> None:
    assert find_errors(AROUND.format(f"enter {{ {line} }}" if "steer" not in line else line)) == []


MENDED = {
    "calm = pick(0,5, 1)": None,  # one of three, or of two
    "calm = max(0,5, 1)": "calm = max(0.5, 1)",
    "calm = max(calm, 0,5)": "calm = max(calm, 0.5)",
    "calm = uniform(0,4, 1)": "calm = uniform(0.4, 1)",
    "calm = uniform(0,5,1,5)": "calm = uniform(0.5,1,5)",
    "calm = (0,5) * 2": "calm = (0.5) * 2",
    "calm = max(0,05, 1)": "calm = max(0.05, 1)",
    "calm = ramp(calm, from: 0,1 .. 0,9)": "calm = ramp(calm, from: 0.1 .. 0,9)",
    "emit alarm(within: 0,4 m)": "emit alarm(within: 0.4 m)",
    "emit alarm(0,4 m)": "emit alarm(0.4 m)",
    "calm = 1,000": None,  # a thousand, or one
    "calm = 1,000,000": "calm = 1000000",
    "calm = 1,234.5": "calm = 1234.5",
    "calm = clamp(calm, 0,1, 1)": "calm = clamp(calm, 0.1, 1)",
    "calm = clamp(calm, 0,1, 0,9)": "calm = clamp(calm, 0.1, 0,9)",
    "calm = clamp(calm,0,1,1)": "calm = clamp(calm,0.1,1)",
    "calm = clamp(0,5, 0 .. 1)": "calm = clamp(0.5, 0 .. 1)",
    "calm = mix(calm, 1, 0,5)": "calm = mix(calm, 1, 0.5)",
    "calm = rising(calm, 0,2, 0,8)": "calm = rising(calm, 0.2, 0,8)",
    "calm = count(n in neighbours(0,4 m): n.calm > 1)": None,  # how far, or how far and how wide
}


@pytest.mark.parametrize("line", MENDED)
def test_unambiguous_mistakes_are_corrected(line: str) -> None:
    text = AROUND.format(f"enter {{ {line} }}")
    (error,) = find_errors(text)
    assert error.code == "bad-number" and error.help and error.span is not None and "," in error.span.text
    mended = MENDED[line]
    assert (error.fix is None) == (mended is None)
    if error.fix is not None and mended is not None:
        assert text[: error.fix.span.start] + error.fix.text + text[error.fix.span.end :] == AROUND.format(
            f"enter {{ {mended} }}"
        )


@pytest.mark.parametrize(
    ("line", "instead"), [("clamp(calm, 0, 1)", "0 .. 1"), ("clamp(calm,0,1)", "0 .. 1"), ("rising(calm, 0.1, 1)", "0.1 .. 1")]
)
def test_two_values_for_a_range_are_reported_as_a_range(line: str, instead: str) -> None:
    text = AROUND.format(f"enter {{ calm = {line} }}")
    (error,) = find_errors(text)
    assert error.code == "wrong-arity" and error.fix is not None and f"`{instead}`" in (error.help or "")
    assert find_errors(text[: error.fix.span.start] + error.fix.text + text[error.fix.span.end :]) == []


def test_a_behaviour_keeps_its_arguments() -> None:
    text = "ant 1\nbehaviour f(a: number = 0,4, b: number = 1.5) -> push { heading * a * b }\n"
    assert [(e.code, e.fix.text if e.fix else "") for e in find_errors(text)] == [("bad-number", "0.4")]


@pytest.mark.parametrize(
    ("scene", "help"),
    [
        ("set:\n  bug.smell: 0,4mm", "write `0.4mm`"),
        ("set: {bug.smell: 0,4 mm}", "write a dot: `0.4`"),
        ("camera: {at: [0,5, 1, 2], look_at: [0, 0, 0]}", "write a dot: `0.5`"),
        ("world:\n  food: {apple: {at: [0, 0, 0], radius: 0,4}}", "write a dot: `0.4`"),
        ("set:\n  bug.smell: -1,000 mm", "write `1000`, or `1.000` with a dot"),
        ("frames: 1-480", "write `1..480`"),
        ("frames: [1, 480]", "write `1..480`"),
        ("frames: 480 - 1", "write `1..480`"),
        ("frames: a..b", "write the first and the last frame with two dots between: `1001..1240`"),
    ],
)
def test_scenes_report_decimal_commas(scene: str, help: str) -> None:
    report = load_scene_text(f"antdsl: 1\n{scene}\n".encode(), "scene.yaml", Roots(Path("."), {}))[1]
    assert len(report.errors) == 1 and help in (report.errors[0].help or ""), report.errors


def test_other_mistakes_in_numbers_suggest_a_dot() -> None:
    errors = find_errors(AROUND.format("when chance 0,4 -> go"))
    assert [error.code for error in errors] == ["bad-number", "not-a-rate"] and "`chance 0.4 /s`" in (errors[1].help or "")
