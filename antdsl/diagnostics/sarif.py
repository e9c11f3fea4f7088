"""SARIF 2.1.0 (OASIS standard) for code scanning services."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from typing import Any
from urllib.parse import quote

from antdsl import __version__
from antdsl.diagnostics.codes import CODES
from antdsl.diagnostics.model import Diagnostic
from antdsl.diagnostics.places import line_range
from antdsl.resources import code_page
from antdsl.source import Span

_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"


def sarif(diagnostics: Sequence[Diagnostic], omitted_count: int) -> str:
    codes = sorted({diagnostic.code for diagnostic in diagnostics})
    rules = [_rule(code) for code in codes]
    fingerprint_counts: Counter[str] = Counter()
    results = [_result(diagnostic, codes.index(diagnostic.code), fingerprint_counts) for diagnostic in diagnostics]
    run: dict[str, Any] = {
        "tool": {"driver": {"name": "antdsl", "semanticVersion": __version__, "rules": rules}},
        "columnKind": "unicodeCodePoints",
        "results": results,
    }
    if omitted_count:
        run["properties"] = {"leftOut": omitted_count}
    return json.dumps({"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]}, indent=2, ensure_ascii=True) + "\n"


def _rule(code: str) -> dict[str, Any]:
    """Return what a code scanning service shows about a code: its meaning, and its page if the pages are installed."""
    rule: dict[str, Any] = {"id": code, "shortDescription": {"text": CODES.get(code, code)}}
    page = code_page(code)
    if page is not None:
        text = page.read_text(encoding="utf-8")
        rule["help"] = {"text": text, "markdown": text}
    return rule


def _result(diagnostic: Diagnostic, rule: int, fingerprint_counts: Counter[str]) -> dict[str, Any]:
    text = diagnostic.message + (f"\nhelp: {diagnostic.help}" if diagnostic.help else "")
    result: dict[str, Any] = {
        "ruleId": diagnostic.code,
        "ruleIndex": rule,
        "level": diagnostic.severity,
        "message": {"text": text},
    }
    if diagnostic.span is not None:
        result["locations"] = [_location(diagnostic.span)]
        result["partialFingerprints"] = {"primaryLocationLineHash": _fingerprint(diagnostic, diagnostic.span, fingerprint_counts)}
    if diagnostic.labels:
        result["relatedLocations"] = [{**_location(label.span), "message": {"text": label.text}} for label in diagnostic.labels]
    if diagnostic.fix is not None:
        location = _location(diagnostic.fix.span)["physicalLocation"]
        change = {"deletedRegion": location["region"], "insertedContent": {"text": diagnostic.fix.text}}
        fix = {"artifactChanges": [{"artifactLocation": location["artifactLocation"], "replacements": [change]}]}
        result["fixes"] = [fix]
    return result


def _location(span: Span) -> dict[str, Any]:
    place = line_range(span)
    region = {"startLine": place.line, "startColumn": place.column, "endLine": place.end_line, "endColumn": place.end_column}
    uri = quote(place.path.replace("\\", "/").removeprefix("./"))
    return {"physicalLocation": {"artifactLocation": {"uri": uri}, "region": region}}


def _fingerprint(diagnostic: Diagnostic, span: Span, fingerprint_counts: Counter[str]) -> str:
    """Return a fingerprint that stays equal when lines above are added: from the code and the line's text, with a counter for
    repetitions."""
    line = span.source.line_text(line_range(span).line).strip()
    digest = hashlib.sha256(f"{diagnostic.code}\0{span.source.path}\0{line}".encode("utf-8", "surrogatepass")).hexdigest()[:16]
    fingerprint_counts[digest] += 1
    return f"{digest}:{fingerprint_counts[digest]}"
