"""Machine formats as others read them: SARIF by the rules of the standard for the parts that are used, JUnit by junitparser."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest

from antdsl.diagnostics import Report
from antdsl.diagnostics.render import render
from antdsl.pipeline import check_path

jsonschema = pytest.importorskip("jsonschema", reason="needs the extra [test]")
ROOT = Path(__file__).resolve().parents[2]
TEXT = """ant 1
use stearing
species walker {
  hunger = 0
  load = 0
  load = 1
  state stroll { steer wander(); hunger += 10 %/s; when uniform(0, 1) < 0.1 -> strol }
}
"""

# Warnings of a program that is sound: beside errors, unused names are not reported.
IDLE = """ant 1
use steering
species walker {
  hunger = 0
  state stroll { steer wander() }
}
"""


def message(required: str = "text") -> dict[str, Any]:
    text = {"text": {"type": "string"}, "markdown": {"type": "string"}, "id": {"type": "string"}}
    return {"type": "object", "properties": text, "required": [required], "additionalProperties": False}


def strict(required: list[str], **properties: Any) -> dict[str, Any]:
    """An object of SARIF 2.1.0, section 3: what it must have, and of what it may have the parts that are used here."""
    return {"type": "object", "properties": properties, "required": required, "additionalProperties": False}


def rows(of: dict[str, Any], **extra: Any) -> dict[str, Any]:
    return {"type": "array", "items": of, **extra}


POSITIVE_INTEGER = {"type": "integer", "minimum": 1}
URI = {"type": "string", "pattern": r"^[^\\ ]*$"}
REGION = strict(
    ["startLine"], startLine=POSITIVE_INTEGER, startColumn=POSITIVE_INTEGER, endLine=POSITIVE_INTEGER, endColumn=POSITIVE_INTEGER
)
FILE = strict([], uri=URI)
PLACE = strict(["artifactLocation"], artifactLocation=FILE, region=REGION)
REPLACEMENT = strict(["deletedRegion"], deletedRegion=REGION, insertedContent=strict([], text={"type": "string"}))
CHANGE = strict(["artifactLocation", "replacements"], artifactLocation=FILE, replacements=rows(REPLACEMENT, minItems=1))
RESULT = strict(
    ["message"],
    ruleId={"type": "string"},
    ruleIndex={"type": "integer", "minimum": -1},
    level={"enum": ["none", "note", "warning", "error"]},
    message=message(),
    locations=rows(strict([], physicalLocation=PLACE)),
    relatedLocations=rows(strict([], physicalLocation=PLACE, message=message()), uniqueItems=True),
    partialFingerprints={"type": "object", "additionalProperties": {"type": "string"}},
    fixes=rows(strict(["artifactChanges"], artifactChanges=rows(CHANGE, minItems=1, uniqueItems=True)), uniqueItems=True),
)
RULE = strict(
    ["id"],
    id={"type": "string"},
    name={"type": "string"},
    shortDescription=message(),
    fullDescription=message(),
    helpUri={"type": "string", "format": "uri"},
    help=message(),
)
DRIVER = strict(
    ["name"],
    name={"type": "string"},
    version={"type": "string"},
    semanticVersion={"type": "string"},
    informationUri={"type": "string", "format": "uri"},
    rules=rows(RULE, uniqueItems=True),
)
RUN = strict(
    ["tool"],
    tool=strict(["driver"], driver=DRIVER),
    columnKind={"enum": ["utf16CodeUnits", "unicodeCodePoints"]},
    results=rows(RESULT),
    properties={"type": "object"},
)
LOG = {
    "type": "object",
    "properties": {"$schema": {"type": "string", "format": "uri"}, "version": {"const": "2.1.0"}, "runs": rows(RUN)},
    "required": ["version", "runs"],
    "additionalProperties": False,
}


@pytest.fixture
def findings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Report:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my walker.ant").write_text(TEXT, encoding="utf-8")
    report = check_path(Path("my walker.ant"))[1]
    (tmp_path / "idle.ant").write_text(IDLE, encoding="utf-8")
    report.extend(check_path(Path("idle.ant"))[1])
    report.error("no-such-file", "a finding without a place", None, "name a file")
    assert len(report.errors) == 4 and len(report.diagnostics) > 4
    assert any(d.fix for d in report.diagnostics) and any(d.labels for d in report.diagnostics)
    return report


def test_sarif_follows_the_standard(findings: Report) -> None:
    for report in (findings, Report()):
        log = json.loads(render(report, "sarif"))
        jsonschema.validate(log, LOG)
        (run,) = log["runs"]
        ids = [rule["id"] for rule in run["tool"]["driver"]["rules"]]
        assert len(set(ids)) == len(ids) and all(ids[each["ruleIndex"]] == each["ruleId"] for each in run["results"])
        assert all(each["level"] in ("error", "warning") for each in run["results"])


@pytest.mark.skipif("SARIF_SCHEMA" not in os.environ, reason="SARIF_SCHEMA does not name a file with the schema of SARIF 2.1.0")
def test_sarif_is_valid_by_the_whole_schema(findings: Report) -> None:
    schema = json.loads(Path(os.environ["SARIF_SCHEMA"]).read_text(encoding="utf-8-sig"))
    for report in (findings, Report()):
        jsonschema.validate(json.loads(render(report, "sarif")), schema)


def test_sarif_fixes_can_be_applied(findings: Report) -> None:
    """Taken as a service takes them: by line and column of the file as it lies there."""
    lines = TEXT.split("\n")
    fix_count = 0
    for result in json.loads(render(findings, "sarif"))["runs"][0]["results"]:
        for fix in result.get("fixes", ()):
            (change,) = fix["artifactChanges"]
            (replacement,) = change["replacements"]
            region = replacement["deletedRegion"]
            assert region["startLine"] == region["endLine"] and change["artifactLocation"]["uri"] == "my%20walker.ant"
            line = lines[region["startLine"] - 1]
            mended = line[: region["startColumn"] - 1] + replacement["insertedContent"]["text"] + line[region["endColumn"] - 1 :]
            report = check_path_of(lines, region["startLine"], mended)
            assert result["message"]["text"] not in {f"{d.message}\nhelp: {d.help}" for d in report.diagnostics}
            fix_count += 1
    assert fix_count >= 2


def check_path_of(lines: list[str], number: int, line: str) -> Report:
    path = Path("mended.ant")
    path.write_text("\n".join([*lines[: number - 1], line, *lines[number:]]), encoding="utf-8")
    return check_path(path)[1]


def test_other_programs_read_junit(findings: Report, tmp_path: Path) -> None:
    junitparser = pytest.importorskip("junitparser", reason="needs the extra [test]")
    for report in (findings, Report()):
        path = tmp_path / "report.xml"
        path.write_text(render(report, "junit"), encoding="utf-8")
        suites = list(junitparser.JUnitXml.fromfile(str(path)))
        assert [suite.name for suite in suites] == ["antdsl check"]
        cases = [case for suite in suites for case in suite]
        assert suites[0].tests == len(cases) == max(1, len(report.diagnostics))
        failed = [case for case in cases if case.result]
        assert suites[0].failures == len(failed) == len(report.errors)
        assert {case.result[0].type for case in failed} == {d.code for d in report.errors}
        for case in failed:
            assert isinstance(case.result[0], junitparser.Failure) and case.result[0].message
            assert re.match(r"error\[", case.result[0].text)
