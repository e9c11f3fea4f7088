"""JUnit XML for build servers: one test case for each finding; warnings pass with a note, errors fail."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from antdsl.diagnostics.full import full
from antdsl.diagnostics.model import Diagnostic
from antdsl.diagnostics.places import escape_text, line_range


def junit(diagnostics: Sequence[Diagnostic], omitted_count: int) -> str:
    errors = sum(diagnostic.severity == "error" for diagnostic in diagnostics)
    count = str(max(1, len(diagnostics)))
    root = ElementTree.Element("testsuites", tests=count, failures=str(errors))
    suite = ElementTree.SubElement(root, "testsuite", name="antdsl check", tests=count, failures=str(errors), errors="0")
    for diagnostic in diagnostics:
        _case(suite, diagnostic)
    if not diagnostics:
        ElementTree.SubElement(suite, "testcase", classname="antdsl", name="check")
    if omitted_count:
        ElementTree.SubElement(suite, "system-out").text = f"{omitted_count} more"
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _case(suite: ElementTree.Element, diagnostic: Diagnostic) -> None:
    where, name = "antdsl", diagnostic.code
    if diagnostic.span is not None:
        place = line_range(diagnostic.span)
        where, name = escape_text(place.path), f"{diagnostic.code} {place.line}:{place.column}"
    case = ElementTree.SubElement(suite, "testcase", classname=where, name=name)
    text = full([diagnostic], 0)
    if diagnostic.severity == "error":
        ElementTree.SubElement(case, "failure", message=escape_text(diagnostic.message), type=diagnostic.code).text = text
    else:
        ElementTree.SubElement(case, "system-out").text = text
