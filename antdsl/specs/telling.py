"""Results in words, as JSON and as JUnit XML: a case for each spec and seed, with place, frame and values of what went wrong."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from antdsl.diagnostics import Diagnostic, Report
from antdsl.diagnostics.full import full
from antdsl.diagnostics.places import area, safe
from antdsl.loading import shown
from antdsl.source import Span
from antdsl.specs.cases import Case, Failure
from antdsl.specs.coverage import Counted, Coverage

_MOST_TOLD = 20  # states and changes that nobody met, in words


def one_line(case: Case) -> str:
    """`passed  "no crumb is lost", seed 3: 240 frames, 1.2 s`."""
    return f'{case.outcome:<7} "{safe(case.name)}", seed {case.seed}: {case.frames} frames, {case.seconds:.1f} s'


def failed(case: Case) -> str:
    """The case's line, then each failure with its place, when, who, and the values."""
    return "\n".join([one_line(case), *(f"  {line}" for failure in case.failures for line in _lines(failure))])


def _lines(failure: Failure) -> list[str]:
    where = f"{failure.span}: " if failure.span is not None else ""
    lines = [f"{safe(where)}{safe(failure.message)}"]
    if failure.frame is not None:
        when = f"  first at frame {failure.frame}"
        when += f", {failure.time:.6g} s from the start" if failure.time is not None else ""
        more = f" and {failure.others} more" if failure.others else ""
        lines.append(when + (f", by {failure.agent[0]} {failure.agent[1]}{more}" if failure.agent else ""))
    return lines + [f"    {safe(text)} is {safe(value)}" for text, value in failure.values]


def counted(cases: Sequence[Case], mistakes: int) -> str:
    """`5 passed, 1 failed, 2 mistakes in files`."""
    numbers = {word: sum(case.outcome == word for case in cases) for word in ("passed", "failed", "waiting")}
    told = [f"{numbers['passed']} passed"]
    told += [f"{numbers['failed']} failed"] if numbers["failed"] else []
    told += [f"{numbers['waiting']} not finished"] if numbers["waiting"] else []
    told += [f"{mistakes} mistake{'s' if mistakes > 1 else ''} in files"] if mistakes else []
    return ", ".join(told)


def uncovered(coverage: Coverage) -> str:
    """How many states were entered and changes made, and those that never were."""
    lines = []
    for what, verb, table in (("states", "entered", coverage.states), ("changes", "made", coverage.changes)):
        if table:
            met = sum(each.count > 0 for each in table.values())
            lines.append(f"{what} {verb}: {met} of {len(table)}")
    never = _never(coverage)
    lines += [f"  {each.span}: `{_short(each.name)}` was never {verb}" for each, verb in never[:_MOST_TOLD]]
    if len(never) > _MOST_TOLD:
        lines.append(f"  and {len(never) - _MOST_TOLD} more")
    return "\n".join(lines)


def _short(name: str) -> str:
    """Without what is there for us only: the machine `main`, and the number of a change where it is the first."""
    return name.replace(".main.", ".").removesuffix("#1").replace("->", " -> ")


def _never(coverage: Coverage) -> list[tuple[Counted, str]]:
    found = [(each, "entered") for each in coverage.states.values() if not each.count]
    found += [(each, "made") for each in coverage.changes.values() if not each.count]
    return sorted(found, key=lambda pair: (pair[0].span.source.path, pair[0].span.start))


# --- JSON ------------------------------------------------------------------------------------------------------------


def as_json(cases: Sequence[Case], coverage: Coverage, report: Report) -> str:
    """All cases, the coverage, and what kept others from being run, one document."""
    document = {
        "passed": sum(case.outcome == "passed" for case in cases),
        "failed": sum(case.outcome == "failed" for case in cases),
        "specs": [_case(case) for case in cases],
        "problems": [
            {"code": d.code, "message": d.message, "place": _place(d.span), "help": d.help}
            for d in report.sorted()
            if d.severity == "error"
        ],
        "coverage": {
            "states": [_met(each) for each in coverage.states.values()],
            "changes": [_met(each) for each in coverage.changes.values()],
        },
    }
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _case(case: Case) -> dict[str, Any]:
    return {
        "name": case.name,
        "place": _place(case.spec.span),
        "scene": shown(case.scene),
        "seed": case.seed,
        "set": {change.name: change.value.span.text for change in case.spec.changes},
        "outcome": case.outcome,
        "frames": case.frames,
        "seconds": round(case.seconds, 3),
        "failures": [_failure(failure) for failure in case.failures],
    }


def _failure(failure: Failure) -> dict[str, Any]:
    return {
        "message": failure.message,
        "place": _place(failure.span),
        "frame": failure.frame,
        "time": failure.time,
        "agent": None if failure.agent is None else {"species": failure.agent[0], "id": failure.agent[1]},
        "others": failure.others,
        "values": [{"text": text, "value": value} for text, value in failure.values],
    }


def _met(each: Counted) -> dict[str, Any]:
    return {"name": each.name, "place": _place(each.span), "count": each.count}


def _place(span: Span | None) -> dict[str, Any] | None:
    if span is None:
        return None
    place = area(span)
    return {"file": place.path, "line": place.line, "column": place.column}


# --- JUnit -----------------------------------------------------------------------------------------------------------


def as_junit(cases: Sequence[Case], report: Report) -> str:
    """A suite for each program, as build servers read it. What was not finished counts as skipped; mistakes in files, which kept
    specs from being run, stand in a suite of their own as errors."""
    errors = [d for d in report.sorted() if d.severity == "error"]
    root = ElementTree.Element("testsuites", {"name": "antdsl test"} | _counts(cases, len(errors)))
    if errors:
        suite = ElementTree.SubElement(root, "testsuite", {"name": "files"} | _counts((), len(errors)))
        for problem in errors:
            _junit_error(suite, problem)
    for path in dict.fromkeys(case.spec.span.source.path for case in cases):
        mine = [case for case in cases if case.spec.span.source.path == path]
        suite = ElementTree.SubElement(root, "testsuite", {"name": safe(path)} | _counts(mine))
        for case in mine:
            _junit_case(suite, case)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _counts(cases: Sequence[Case], errors: int = 0) -> dict[str, str]:
    numbers = {
        "tests": len(cases) + errors,
        "failures": sum(case.outcome == "failed" for case in cases),
        "errors": errors,
        "skipped": sum(case.outcome == "waiting" for case in cases),
    }
    return {name: str(number) for name, number in numbers.items()} | {"time": f"{sum(case.seconds for case in cases):.3f}"}


def _junit_error(suite: ElementTree.Element, problem: Diagnostic) -> None:
    where = "antdsl" if problem.span is None else area(problem.span).path
    case = ElementTree.SubElement(suite, "testcase", classname=safe(where), name=problem.code)
    ElementTree.SubElement(case, "error", message=safe(problem.message), type=problem.code).text = full([problem], 0)


def _junit_case(suite: ElementTree.Element, case: Case) -> None:
    place = area(case.spec.span)
    name = f"{case.name} [{Path(case.scene).name}, seed {case.seed}]"
    made = ElementTree.SubElement(
        suite, "testcase", classname=safe(Path(place.path).stem), name=safe(name), file=safe(place.path), line=str(place.line),
        time=f"{case.seconds:.3f}",
    )  # fmt: skip
    if case.outcome == "waiting":
        ElementTree.SubElement(made, "skipped", message="stopped before it was finished")
    elif case.failures:
        text = "\n".join(line for failure in case.failures for line in _lines(failure))
        message = safe(case.failures[0].message)
        ElementTree.SubElement(made, "failure", message=message, type="spec").text = text
