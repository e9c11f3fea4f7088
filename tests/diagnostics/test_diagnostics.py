"""Complaints in every format: places, escapes, how many are shown."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from antdsl import limits
from antdsl.diagnostics import Diagnostic, Fix, Label, Report, codes
from antdsl.diagnostics.codes import CODE_DESCRIPTIONS
from antdsl.diagnostics.render import FORMATTERS, render
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.source import Source, Span

TEXT = "ant 1\nspecies worker {\n  when hungry -> forage\n  é = 日本 + x\n}\n"
SOURCE = Source("dir/worker.ant", TEXT)


def span(part: str, source: Source = SOURCE) -> Span:
    start = source.text.index(part)
    return Span(source, start, start + len(part))


def one(**fields: object) -> Report:
    place = span("forage")
    parts = {"code": "unknown-state", "message": "no state `forage`", "span": place, "help": "did you mean `foraging`?", **fields}
    return Report([Diagnostic(**parts)])  # type: ignore[arg-type]


def test_the_full_format_equals_the_sample() -> None:
    assert render(one()) == (
        "error[unknown-state]: no state `forage`\n"
        " --> dir/worker.ant:3:18\n"
        "  |\n"
        "3 |   when hungry -> forage\n"
        "  |                  ^^^^^^\n"
        "  = help: did you mean `foraging`?\n"
    )


def test_full_with_a_second_place() -> None:
    text = render(one(labels=(Label(span("worker"), "of this species"),), help=None))
    assert text.endswith(" ::: dir/worker.ant:2:9\n  |\n2 | species worker {\n  |         ------ of this species\n")


def test_full_marks_wide_letters_and_the_first_line_of_many() -> None:
    marks = render(one(span=span("x\n}"))).splitlines()[4]
    assert marks == "  |" + " " * 14 + "^"
    assert render(one(span=span("日本"))).splitlines()[4] == "  |" + " " * 7 + "^^^^"


def test_full_without_a_place_and_at_the_end_of_a_file() -> None:
    assert render(one(span=None, help=None)) == "error[unknown-state]: no state `forage`\n"
    assert render(one(span=Span(SOURCE, len(TEXT), len(TEXT)), help=None)).endswith("--> dir/worker.ant:6:1\n")


def test_full_shows_a_window_of_a_long_line() -> None:
    source = Source("a.ant", "x" * 900 + "HERE" + "y" * 900)
    lines = render(one(span=span("HERE", source))).splitlines()
    assert len(lines[3]) < 140 and "HERE" in lines[3] and lines[3].count("…") == 2
    assert lines[3].index("HERE") == lines[4].index("^^^^")


@pytest.mark.parametrize("format", ["full", "concise", "github"])
def test_messages_contain_no_control_characters(format: str) -> None:
    source = Source("e\x1bvil.ant", "a \x1b[31m \u202e b\x07\n")
    text = render(one(span=Span(source, 2, 3), message="name `\x1b[2J\x85`", help="write `\u2028\x00`"), format)
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e]", text)
    assert "\\x1b" in text


def test_concise() -> None:
    assert render(one(), "concise") == "dir/worker.ant:3:18: error[unknown-state]: no state `forage`\n"


def test_json_has_places_in_characters_and_bytes() -> None:
    report = one(span=span("x\n}"), labels=(Label(span("worker"), "here"),), fix=Fix(span("worker"), "ant"))
    report.warning("bad-name", "second", None)
    document = json.loads(render(report, "json"))
    assert (document["format_version"], document["valid"], document["error_count"], document["warning_count"]) == (
        "1.0",
        False,
        1,
        1,
    )
    first, second = document["diagnostics"]
    assert first["range"]["start"] == {"line": 4, "column": 12, "byte": len(TEXT[: TEXT.index("x\n}")].encode())}
    assert first["range"]["end"]["line"] == 5 and first["snippet"] == {"code": "  é = 日本 + x", "start_line": 4}
    assert first["fix"]["text"] == "ant" and first["labels"][0]["text"] == "here"
    assert "range" not in second and second["severity"] == "warning"
    assert json.loads(render(Report(), "json"))["valid"] is True


def test_github_escapes_what_ends_a_command() -> None:
    source = Source("a,b:c%.ant", "x\n")
    report = Report()
    report.warning("bad-name", "warned", None)
    report.error("bad-name", "100 % ::error::\ninjected", Span(source, 0, 1), "one\r\ntwo")
    first, second = render(report, "github").splitlines()
    assert first == (
        "::error file=a%2Cb%3Ac%25.ant,line=1,col=1,endLine=1,endColumn=2,title=bad-name"
        "::100 %25 ::error::\\x0ainjected%0Ahelp: one\ufffd\\x0atwo"
    )
    assert second == "::warning title=bad-name::warned"


def test_sarif_has_rules_and_fingerprints_that_survive_moved_lines() -> None:
    def results(text: str) -> list[dict]:
        source = Source("my files/a.ant", text)
        positions = [match.start() for match in re.finditer("bad", text)]
        report = Report(
            [Diagnostic("bad-name", "m", Span(source, at, at + 3), fix=Fix(Span(source, at, at + 3), "x")) for at in positions]
        )
        run = json.loads(render(report, "sarif"))["runs"][0]
        (rule,) = run["tool"]["driver"]["rules"]
        assert rule["id"] == "bad-name" and rule["shortDescription"] == {"text": CODE_DESCRIPTIONS["bad-name"]}
        assert "## Right" in rule["help"]["markdown"] == rule["help"]["text"]
        return run["results"]

    old_results, new_results = results("bad\nbad\n"), results("# new\n\nbad\nbad\n")
    prints = [each["partialFingerprints"]["primaryLocationLineHash"] for each in old_results]
    assert prints == [each["partialFingerprints"]["primaryLocationLineHash"] for each in new_results] and len(set(prints)) == 2
    place = new_results[0]["locations"][0]["physicalLocation"]
    assert place == {
        "artifactLocation": {"uri": "my%20files/a.ant"},
        "region": {"startLine": 3, "startColumn": 1, "endLine": 3, "endColumn": 4},
    }
    assert new_results[0]["fixes"][0]["artifactChanges"][0]["replacements"][0]["insertedContent"] == {"text": "x"}


def test_junit_counts_errors_and_is_xml_whatever_the_text() -> None:
    report = one(message="<&\x00\uffff>", span=Span(Source("a.ant", "\x00]]>"), 0, 1))
    report.warning("bad-name", "warned", None)
    suite = ElementTree.fromstring(render(report, "junit").split("\n", 1)[1])[0]
    assert (suite.get("tests"), suite.get("failures"), len(suite.findall("testcase"))) == ("2", "1", 2)
    assert suite[0][0].tag == "failure" and suite[1][0].tag == "system-out"
    empty = ElementTree.fromstring(render(Report(), "junit").split("\n", 1)[1])
    assert empty.get("failures") == "0" and len(empty[0]) == 1


@pytest.mark.parametrize("format", FORMATTERS)
def test_no_more_than_fifty_are_shown_and_errors_first(format: str) -> None:
    source = Source("a.ant", "x\n" * 3000)
    report = Report()
    for at in range(0, 4000, 2):
        (report.warning if at < 3990 else report.error)("bad-name", f"number {at}", Span(source, at, at + 1))
    text = render(report, format)
    assert len(re.findall(r"number \d+", text)) in (
        limits.MAX_SHOWN_DIAGNOSTICS,
        limits.MAX_SHOWN_DIAGNOSTICS + 5,
    )  # junit says errors twice
    assert "number 3998" in text and "number 2000" not in text
    assert re.search(r"1,?950", text)


def test_findings_are_sorted_and_unique() -> None:
    report = Report()
    for part in ("forage", "worker", "forage"):
        report.error("bad-name", part, span(part))
    report.error("cannot-read", "one", None)
    report.error("cannot-read", "two", None)
    assert [d.message for d in report.sort_by_place()] == ["worker", "forage", "one", "two"]
    assert not report.ok and len(report.errors) == 4


def test_codes_are_kebab_case_unique_and_in_order() -> None:
    text = Path(codes.__file__).read_text(encoding="utf-8")
    sections = [re.findall(r'^    "(.*?)":', part, re.MULTILINE) for part in text.split("    # --- ")[1:]]
    every = [code for section in sections for code in section]
    assert len(every) == len(set(every)) == len(CODE_DESCRIPTIONS) > 30
    assert all(section == sorted(section) for section in sections)
    assert all(re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", code) and meaning for code, meaning in CODE_DESCRIPTIONS.items())


@pytest.mark.parametrize(
    ("word", "names", "expected"),
    [
        ("forage", ["foraging", "search"], "foraging"),
        ("stear", ["steer", "state"], "steer"),
        ("maxSpeed", ["max_speed", "max_force"], "max_speed"),
        ("qqq", ["steer", "state"], None),
        ("steer", ["steer"], None),
        ("", ["a"], None),
        ("x" * 100_000, ["steer"], None),
    ],
)
def test_nearest_name(word: str, names: list[str], expected: str | None) -> None:
    assert find_nearest_name(word, names) == expected == find_nearest_name(word, reversed(names))


@pytest.mark.parametrize("text", ["`{}` has an unknown unit", "`{}` and ``", "{} without quotes"])
def test_messages_cut_long_values(text: str) -> None:
    diagnostic = Diagnostic("wrong-value", text.format("m" * 9000), None, help=text.format("k" * 9000))
    assert len(diagnostic.message) <= 1500 and len(diagnostic.help or "") <= 1500 and "…" in diagnostic.message
    assert diagnostic.message.split("…")[-1] == ("" if "without" in text else text.partition("{}")[2])
    short = Diagnostic("wrong-value", text.format("m" * 100), None)
    assert short.message == text.format("m" * 100)
