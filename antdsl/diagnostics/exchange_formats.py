"""Formats of findings for other programs: JSON, GitHub's workflow commands, SARIF and JUnit."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree

from antdsl import __version__
from antdsl.diagnostics.codes import CODE_DESCRIPTIONS
from antdsl.diagnostics.full_format import format_full
from antdsl.diagnostics.model import Diagnostic
from antdsl.diagnostics.text_positions import escape_text, find_line_range, rank_severity
from antdsl.resources import find_code_page
from antdsl.source import Source, Span

FORMAT_VERSION = "1.0"


def format_json(diagnostics: Sequence[Diagnostic], omitted_count: int) -> str:
    """Return findings as one JSON document. `omitted_count`: the number of further findings that are left out."""
    errors = sum(diagnostic.severity == "error" for diagnostic in diagnostics)
    content = {
        "format_version": FORMAT_VERSION,
        "valid": errors == 0,
        "error_count": errors,
        "warning_count": len(diagnostics) - errors,
        "left_out": omitted_count,
        "diagnostics": [_make_json_entry(diagnostic) for diagnostic in diagnostics],
    }
    return json.dumps(content, indent=2, ensure_ascii=True) + "\n"


def _make_json_entry(diagnostic: Diagnostic) -> dict[str, Any]:
    """Return a finding as JSON values."""
    entry: dict[str, Any] = {
        "severity": diagnostic.severity,
        "code": diagnostic.code,
        "summary": diagnostic.message,
        "detail": diagnostic.help or "",
    }
    if diagnostic.span is not None:
        entry["range"] = _make_json_range(diagnostic.span)
        line = entry["range"]["start"]["line"]
        entry["snippet"] = {"code": diagnostic.span.source.line_text(line), "start_line": line}
    if diagnostic.labels:
        entry["labels"] = [{"text": label.text, "range": _make_json_range(label.span)} for label in diagnostic.labels]
    if diagnostic.fix is not None:
        entry["fix"] = {"range": _make_json_range(diagnostic.fix.span), "text": diagnostic.fix.text}
    return entry


def _make_json_range(span: Span) -> dict[str, Any]:
    """Return a span as JSON values: file name, start and end."""
    return {
        "filename": span.source.path,
        "start": _make_json_position(span.source, span.start),
        "end": _make_json_position(span.source, span.end),
    }


def _make_json_position(source: Source, offset: int) -> dict[str, int]:
    """Return the line and column of an offset, counted from 1 in characters, and its position in UTF-8 bytes, counted from 0."""
    line, column = source.find_line_column(offset)
    byte = offset if source.text.isascii() else len(source.text[:offset].encode("utf-8", "surrogatepass"))
    return {"line": line, "column": column, "byte": byte}


def format_github(diagnostics: Sequence[Diagnostic], omitted_count: int) -> str:
    """Return findings as workflow commands of GitHub, errors first."""
    ordered = sorted(diagnostics, key=lambda diagnostic: rank_severity(diagnostic.severity))
    lines = [_format_github_command(diagnostic) for diagnostic in ordered]
    if omitted_count:
        lines.append(f"::notice title=antdsl::{omitted_count} more, see the SARIF output")
    return "".join(f"{line}\n" for line in lines)


def _format_github_command(diagnostic: Diagnostic) -> str:
    text = escape_text(diagnostic.message) + (f"\nhelp: {escape_text(diagnostic.help)}" if diagnostic.help else "")
    properties = {"title": diagnostic.code}
    if diagnostic.span is not None:
        place = find_line_range(diagnostic.span)
        properties = {
            "file": escape_text(place.path),
            "line": str(place.line),
            "col": str(place.column),
            "endLine": str(place.end_line),
        }
        if place.line == place.end_line:
            properties["endColumn"] = str(place.end_column)
        properties["title"] = diagnostic.code
    property_text = ",".join(f"{key}={_escape_github_property(value)}" for key, value in properties.items())
    return f"::{diagnostic.severity} {property_text}::{_escape_github_data(text)}"


def _escape_github_data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _escape_github_property(text: str) -> str:
    return _escape_github_data(text).replace(":", "%3A").replace(",", "%2C")


_SCHEMA_URL = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"


def format_sarif(diagnostics: Sequence[Diagnostic], omitted_count: int) -> str:
    """Return findings as a SARIF 2.1.0 document."""
    codes = sorted({diagnostic.code for diagnostic in diagnostics})
    rules = [_make_sarif_rule(code) for code in codes]
    fingerprint_counts: Counter[str] = Counter()
    results = [_make_sarif_result(diagnostic, codes.index(diagnostic.code), fingerprint_counts) for diagnostic in diagnostics]
    run: dict[str, Any] = {
        "tool": {"driver": {"name": "antdsl", "semanticVersion": __version__, "rules": rules}},
        "columnKind": "unicodeCodePoints",
        "results": results,
    }
    if omitted_count:
        run["properties"] = {"leftOut": omitted_count}
    return json.dumps({"$schema": _SCHEMA_URL, "version": "2.1.0", "runs": [run]}, indent=2, ensure_ascii=True) + "\n"


def _make_sarif_rule(code: str) -> dict[str, Any]:
    """Return what a code scanning service displays about a code: its meaning and, if pages are installed, its documentation
    page."""
    rule: dict[str, Any] = {"id": code, "shortDescription": {"text": CODE_DESCRIPTIONS.get(code, code)}}
    page = find_code_page(code)
    if page is not None:
        text = page.read_text(encoding="utf-8")
        rule["help"] = {"text": text, "markdown": text}
    return rule


def _make_sarif_result(diagnostic: Diagnostic, rule: int, fingerprint_counts: Counter[str]) -> dict[str, Any]:
    text = diagnostic.message + (f"\nhelp: {diagnostic.help}" if diagnostic.help else "")
    result: dict[str, Any] = {
        "ruleId": diagnostic.code,
        "ruleIndex": rule,
        "level": diagnostic.severity,
        "message": {"text": text},
    }
    if diagnostic.span is not None:
        result["locations"] = [_make_sarif_location(diagnostic.span)]
        result["partialFingerprints"] = {
            "primaryLocationLineHash": _compute_fingerprint(diagnostic, diagnostic.span, fingerprint_counts)
        }
    if diagnostic.labels:
        result["relatedLocations"] = [
            {**_make_sarif_location(label.span), "message": {"text": label.text}} for label in diagnostic.labels
        ]
    if diagnostic.fix is not None:
        location = _make_sarif_location(diagnostic.fix.span)["physicalLocation"]
        change = {"deletedRegion": location["region"], "insertedContent": {"text": diagnostic.fix.text}}
        fix = {"artifactChanges": [{"artifactLocation": location["artifactLocation"], "replacements": [change]}]}
        result["fixes"] = [fix]
    return result


def _make_sarif_location(span: Span) -> dict[str, Any]:
    place = find_line_range(span)
    region = {"startLine": place.line, "startColumn": place.column, "endLine": place.end_line, "endColumn": place.end_column}
    uri = quote(place.path.replace("\\", "/").removeprefix("./"))
    return {"physicalLocation": {"artifactLocation": {"uri": uri}, "region": region}}


def _compute_fingerprint(diagnostic: Diagnostic, span: Span, fingerprint_counts: Counter[str]) -> str:
    """Return a fingerprint of a finding that does not change when lines are added above it. `fingerprint_counts`: how often each
    fingerprint has occurred so far, which makes equal findings distinct."""
    line = span.source.line_text(find_line_range(span).line).strip()
    digest = hashlib.sha256(f"{diagnostic.code}\0{span.source.path}\0{line}".encode("utf-8", "surrogatepass")).hexdigest()[:16]
    fingerprint_counts[digest] += 1
    return f"{digest}:{fingerprint_counts[digest]}"


def format_junit(diagnostics: Sequence[Diagnostic], omitted_count: int) -> str:
    """Return findings as JUnit XML."""
    errors = sum(diagnostic.severity == "error" for diagnostic in diagnostics)
    count = str(max(1, len(diagnostics)))
    root = ElementTree.Element("testsuites", tests=count, failures=str(errors))
    suite = ElementTree.SubElement(root, "testsuite", name="antdsl check", tests=count, failures=str(errors), errors="0")
    for diagnostic in diagnostics:
        _add_junit_case(suite, diagnostic)
    if not diagnostics:
        ElementTree.SubElement(suite, "testcase", classname="antdsl", name="check")
    if omitted_count:
        ElementTree.SubElement(suite, "system-out").text = f"{omitted_count} more"
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_junit_case(suite: ElementTree.Element, diagnostic: Diagnostic) -> None:
    where, name = "antdsl", diagnostic.code
    if diagnostic.span is not None:
        place = find_line_range(diagnostic.span)
        where, name = escape_text(place.path), f"{diagnostic.code} {place.line}:{place.column}"
    case = ElementTree.SubElement(suite, "testcase", classname=where, name=name)
    text = format_full([diagnostic], 0)
    if diagnostic.severity == "error":
        ElementTree.SubElement(case, "failure", message=escape_text(diagnostic.message), type=diagnostic.code).text = text
    else:
        ElementTree.SubElement(case, "system-out").text = text
