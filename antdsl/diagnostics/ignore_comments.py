"""Comments that ignore a warning for a stated reason: `# antdsl: ignore[flicker] it is meant to be nervous`.

Such a comment is at the end of the line with the warning, or on a separate line above it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from antdsl.diagnostics.codes import CODE_DESCRIPTIONS, MESH_CODES, RUN_CODES, STRICT_CODES
from antdsl.diagnostics.model import Diagnostic, Fix, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.source import Source, Span

_IGNORE_COMMENT = re.compile(r"(?:^|[ \t;{}])(#[ \t]*antdsl:[ \t]*ignore\[([^\]\n]*)\][ \t]*((?:.*\S)?))[ \t\r]*$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class IgnoreComment:
    """A comment that ignores warnings.

    `span`: its location. `line`: the number of the line with the ignored warnings, counted from 1. `codes`: the ignored codes,
    each with its location in the comment. `reason`: the text after the bracket."""

    span: Span
    line: int
    codes: tuple[tuple[str, Span], ...]
    reason: str


def find_ignore_comments(source: Source) -> Iterator[IgnoreComment]:
    """Return the comments that ignore warnings in a program or a scene. A `#` inside quotes does not start a comment."""
    for match in _IGNORE_COMMENT.finditer(source.text):
        number = source.find_line_column(match.start(1))[0]
        prefix = source.text[: match.start(1)].rpartition("\n")[2]
        if prefix.count('"') % 2:
            continue
        offset = match.start(2)
        codes = [
            (part.group().strip(), Span(source, offset + part.start(), offset + part.end()))
            for part in re.finditer(r"[^\s,](?:[^,]*[^\s,])?", match[2])
        ]
        line = number if prefix.strip() else _find_next_code_line(source, number)
        yield IgnoreComment(Span(source, match.start(1), match.end(1)), line, tuple(codes), match[3].strip())


def _find_next_code_line(source: Source, number: int) -> int:
    """Return the number of the first line after line `number` that is neither empty nor only a comment."""
    last = source.find_line_column(len(source.text))[0]
    while number < last:
        number += 1
        text = source.line_text(number).strip()
        if text and not text.startswith("#"):
            break
    return number


def remove_ignored(report: Report) -> Report:
    """Return the report without the warnings that a comment ignores."""
    warned_sources = {d.span.source for d in report.diagnostics if d.span is not None and d.severity == "warning"}
    ignored_places = {
        (source.path, ignore.line, code)
        for source in warned_sources
        for ignore in find_ignore_comments(source)
        for code, _ in ignore.codes
    }
    return Report([d for d in report.diagnostics if not _is_ignored(d, ignored_places)]) if ignored_places else report


def _is_ignored(diagnostic: Diagnostic, ignored_places: set[tuple[str, int, str]]) -> bool:
    if diagnostic.span is None or diagnostic.severity != "warning":
        return False
    return (
        diagnostic.span.source.path,
        diagnostic.span.source.find_line_column(diagnostic.span.start)[0],
        diagnostic.code,
    ) in ignored_places


def apply_ignore_comments(
    report: Report,
    sources: Iterable[Source],
    *,
    strict: bool = False,
    has_no_errors: bool | None = None,
    meshes_checked: bool = True,
) -> Report:
    """Return the report without ignored warnings, and with new warnings about comments that give no reason or ignore nothing.

    `sources`: all checked texts.
    `strict`, `meshes_checked`: whether the checks of STRICT_CODES and MESH_CODES have run. A comment for a check that has not
    run is not reported as unused. Neither is a comment for one of RUN_CODES.
    `has_no_errors`: whether no stage found errors, because errors suppress most warnings. None: whether this report has none."""
    has_no_errors = report.ok if has_no_errors is None else has_no_errors
    unknown = RUN_CODES | (frozenset() if strict else STRICT_CODES) | (frozenset() if meshes_checked else MESH_CODES)
    all_diagnostics = [*report.diagnostics, *report.dropped_warnings]
    warned_places = {
        (d.span.source.path, d.span.source.find_line_column(d.span.start)[0], d.code) for d in all_diagnostics if d.span
    }
    result = remove_ignored(report)
    for source in sources:
        for ignore in find_ignore_comments(source):
            if len(ignore.reason) < 3:
                result.warning(
                    "ignore-without-reason", "this comment gives no reason", ignore.span, "write the reason after the bracket"
                )
            for code, span in ignore.codes:
                is_checked = code not in CODE_DESCRIPTIONS or (has_no_errors and code not in unknown)
                if is_checked and (source.path, ignore.line, code) not in warned_places:
                    _warn_unused_ignore(result, ignore, code, span)
            if not ignore.codes:
                result.warning("ignored-nothing", "this comment has no code", ignore.span, "write `ignore[CODE] why`")
    return result


def _warn_unused_ignore(report: Report, ignore: IgnoreComment, code: str, span: Span) -> None:
    near = find_nearest_name(code, CODE_DESCRIPTIONS)
    if code not in CODE_DESCRIPTIONS:
        report.warning("ignored-nothing", f"no code `{code}`", span, f"did you mean `{near}`?" if near else "delete it")
        return
    fix = Fix(ignore.span, "") if len(ignore.codes) == 1 else None
    report.warning("ignored-nothing", f"there is no `{code}` to ignore here", span, "delete the comment", fix=fix)
