"""Machine-readable results: JSON, and JUnit XML for build servers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from antdsl.diagnostics import Diagnostic, Report
from antdsl.diagnostics.full_format import format_full
from antdsl.diagnostics.text_positions import escape_text, find_line_range
from antdsl.loading import display_path
from antdsl.source import Span
from antdsl.specs.cases import SavedFrames, SpecCase, SpecFailure
from antdsl.specs.coverage import CoverageEntry, SpecCoverage
from antdsl.specs.golden.golden_runs import GoldenResult
from antdsl.specs.text_report import describe_failure, describe_golden


def format_json_report(
    cases: Sequence[SpecCase], coverage: SpecCoverage, report: Report, goldens: Sequence[GoldenResult] = ()
) -> str:
    """Return a JSON document with all cases and golden runs, the coverage, and the reasons why specs did not run."""
    document = {
        "passed": sum(case.outcome == "passed" for case in cases),
        "failed": sum(case.outcome == "failed" for case in cases),
        "specs": [_make_case_entry(case) for case in cases],
        "golden": [_make_golden_entry(result) for result in goldens],
        "problems": [
            {"code": d.code, "message": d.message, "place": _make_location_entry(d.span), "help": d.help}
            for d in report.sort_by_place()
            if d.severity == "error"
        ],
        "covered": coverage.covered_share,
        "coverage": {
            "states": [_make_coverage_entry(each) for each in coverage.states.values()],
            "changes": [_make_coverage_entry(each) for each in coverage.changes.values()],
        },
    }
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _make_case_entry(case: SpecCase) -> dict[str, Any]:
    return {
        "name": case.name,
        "place": _make_location_entry(case.spec.span),
        "scene": display_path(case.scene),
        "seed": case.seed,
        "set": {change.name: change.value.span.text for change in case.spec.changes},
        "outcome": case.outcome,
        "frames": case.frames,
        "seconds": round(case.seconds, 3),
        "failures": [_make_failure_entry(failure) for failure in case.failures],
        "kept": None if case.saved_frames is None else _make_saved_entry(case.saved_frames),
    }


def _make_saved_entry(saved_frames: SavedFrames) -> dict[str, Any]:
    folder = None if saved_frames.folder is None else display_path(saved_frames.folder)
    return {
        "folder": folder, "note": saved_frames.note, "begins": saved_frames.first_frame,
        "frame": saved_frames.frame, "look": saved_frames.view_command, "again": saved_frames.resume_command,
    }  # fmt: skip


def _make_golden_entry(result: GoldenResult) -> dict[str, Any]:
    return {
        "scene": display_path(result.scene),
        "set": dict(result.changes),
        "seed": result.seed,
        "outcome": result.outcome,
        "frames": result.frames,
        "frame": result.frame,
        "seen": result.detail_frame,
        "words": result.message,
        "made": result.origin,
        "differences": [
            {"who": d.owner, "what": d.attribute, "whom": d.member, "now": d.current_value, "was": d.old_value}
            for d in result.differences
        ],
    }


def _make_failure_entry(failure: SpecFailure) -> dict[str, Any]:
    return {
        "message": failure.message,
        "place": _make_location_entry(failure.span),
        "frame": failure.frame,
        "time": failure.time,
        "agent": None if failure.agent is None else {"species": failure.agent[0], "id": failure.agent[1]},
        "others": failure.other_count,
        "agents": list(failure.agents),
        "since": failure.wait_start_frame,
        "whereabouts": dict(failure.states_and_position),
        "values": [{"text": text, "value": value} for text, value in failure.values],
    }


def _make_coverage_entry(entry: CoverageEntry) -> dict[str, Any]:
    return {"name": entry.name, "place": _make_location_entry(entry.span), "count": entry.count}


def _make_location_entry(span: Span | None) -> dict[str, Any] | None:
    if span is None:
        return None
    place = find_line_range(span)
    return {"file": place.path, "line": place.line, "column": place.column}


# --- JUnit -----------------------------------------------------------------------------------------------------------


def format_junit_report(cases: Sequence[SpecCase], report: Report, goldens: Sequence[GoldenResult] = ()) -> str:
    """Return the results as JUnit XML, with one suite for each program.

    Waiting and allowed cases count as skipped. Golden runs have a separate suite. So do errors in files because of which specs
    could not run."""
    errors = [d for d in report.sort_by_place() if d.severity == "error"]
    differ = [result for result in goldens if result.outcome == "differs"]
    root = ElementTree.Element(
        "testsuites", {"name": "antdsl test"} | _make_junit_counts(cases, len(errors), len(goldens), len(differ))
    )
    if errors:
        suite = ElementTree.SubElement(root, "testsuite", {"name": "files"} | _make_junit_counts((), len(errors)))
        for problem in errors:
            _add_junit_error(suite, problem)
    for path in dict.fromkeys(case.spec.span.source.path for case in cases):
        file_cases = [case for case in cases if case.spec.span.source.path == path]
        suite = ElementTree.SubElement(root, "testsuite", {"name": escape_text(path)} | _make_junit_counts(file_cases))
        for case in file_cases:
            _add_junit_case(suite, case)
    if goldens:
        suite = ElementTree.SubElement(
            root, "testsuite", {"name": "golden runs"} | _make_junit_counts((), 0, len(goldens), len(differ))
        )
        for result in goldens:
            name = escape_text(f"{result.name}, seed {result.seed}")
            testcase = ElementTree.SubElement(suite, "testcase", classname=escape_text(result.scene.stem), name=name)
            if result.outcome == "differs":
                message = f"differs from frame {result.frame} on"
                ElementTree.SubElement(testcase, "failure", message=message, type="golden").text = describe_golden(result)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _make_junit_counts(cases: Sequence[SpecCase], errors: int = 0, goldens: int = 0, golden_failures: int = 0) -> dict[str, str]:
    numbers = {
        "tests": len(cases) + errors + goldens,
        "failures": sum(case.outcome == "failed" for case in cases) + golden_failures,
        "errors": errors,
        "skipped": sum(case.outcome in ("waiting", "allowed") for case in cases),
    }
    return {name: str(number) for name, number in numbers.items()} | {"time": f"{sum(case.seconds for case in cases):.3f}"}


def _add_junit_error(suite: ElementTree.Element, problem: Diagnostic) -> None:
    where = "antdsl" if problem.span is None else find_line_range(problem.span).path
    case = ElementTree.SubElement(suite, "testcase", classname=escape_text(where), name=problem.code)
    ElementTree.SubElement(case, "error", message=escape_text(problem.message), type=problem.code).text = format_full(
        [problem], 0
    )


def _add_junit_case(suite: ElementTree.Element, case: SpecCase) -> None:
    place = find_line_range(case.spec.span)
    name = f"{case.name} [{Path(case.scene).name}, seed {case.seed}]"
    testcase = ElementTree.SubElement(
        suite, "testcase", classname=escape_text(Path(place.path).stem), name=escape_text(name), file=escape_text(place.path),
        line=str(place.line),
        time=f"{case.seconds:.3f}",
    )  # fmt: skip
    if case.outcome == "waiting":
        ElementTree.SubElement(testcase, "skipped", message="stopped before it was finished")
    elif case.outcome == "allowed":
        ElementTree.SubElement(testcase, "skipped", message="failed, but enough other seeds passed")
    elif case.failures:
        text = "\n".join(line for failure in case.failures for line in describe_failure(failure))
        if case.saved_frames is not None and case.saved_frames.folder is not None:
            text += f"\nsee it: {escape_text(case.saved_frames.view_command)}"
            text += f"\ncontinue it: {escape_text(case.saved_frames.resume_command)}"
        message = escape_text(case.failures[0].message)
        ElementTree.SubElement(testcase, "failure", message=message, type="spec").text = text
