"""Rewrites a file for a newer edition of the language: changes the first line, and adds the previous defaults that its species
use.

An upgraded program has the same results until its author deletes the added lines."""

from __future__ import annotations

import re
from collections.abc import Iterator

from antdsl.diagnostics import Report
from antdsl.program.tables.editions import EDITION_DEFAULTS, SWITCH_HELP
from antdsl.program.tables.vocabulary import get_builtin_attributes
from antdsl.source import Source
from antdsl.syntax import nodes
from antdsl.syntax.parser import parse

_BLANK_REST_PATTERN = re.compile(r"[ \t;]*(?:#[^\n]*)?(?=\n|$)")  # the rest of a line without anything that the program reads
Insertion = tuple[int, str]  # offset in the text, and the inserted text


def upgrade_source(source: Source, edition: int) -> tuple[Source | None, Report]:
    """Return the source of a file rewritten for `edition`, with the same meaning, and the report of parsing.

    The result is not formatted in the standard layout. It is None if the text has errors or names that the newer edition
    reserves. If the file already has this or a newer edition, it is returned unchanged."""
    file, report = parse(source)
    previous = file.edition_number
    if not report.ok or (file.edition is not None and previous >= edition):
        return (source if report.ok else None), report
    if file.edition is None:
        return Source(source.path, f"ant {previous}\n{source.text}"), report
    insertions = []
    for item in file.items:
        if isinstance(item, nodes.Species):
            _report_reserved(item, previous, edition, report)
            insertions += list(_iterate_default_lines(source, item, previous, edition))
    if not report.ok:
        return None, report
    text = source.text
    for at, added in sorted(insertions, reverse=True):
        text = text[:at] + added + text[at:]
    span = file.edition.span
    return Source(source.path, f"{text[: span.start]}{edition}{text[span.end :]}"), report


def _iterate_default_lines(source: Source, species: nodes.Species, previous_edition: int, edition: int) -> Iterator[Insertion]:
    """Yield insertions that set the defaults of the previous edition explicitly, so that a species behaves the same in the new
    edition.

    Defaults that are equal in both editions, and settings that the species already has, are omitted."""
    properties = [member for member in species.members if isinstance(member, nodes.AnimalProperty)]
    written = {member.name.text for member in properties}
    lines = [
        row.format_setting_line(previous_edition)
        for row in EDITION_DEFAULTS
        if row.setting not in written and row.get_default(previous_edition) != row.get_default(edition)
    ]
    if not lines or not species.members:
        return
    if not properties:
        yield species.members[0].span.start, "".join(f"{line}\n" for line in lines)
        return
    end = properties[-1].span.end
    rest = _BLANK_REST_PATTERN.match(source.text, end)
    if rest is None:
        yield end, "".join(f"; {line}" for line in lines)
    else:
        yield rest.end(), "".join(f"\n{line}" for line in lines)


def _report_reserved(species: nodes.Species, previous_edition: int, edition: int, report: Report) -> None:
    """Report declared names of a species that are built-in names in `edition`, but not in `previous_edition`."""
    reserved = (get_builtin_attributes(edition).keys() - get_builtin_attributes(previous_edition).keys()) | SWITCH_HELP.keys()
    for member in species.members:
        own = member.declaration if isinstance(member, nodes.ParamDecl) else member
        if isinstance(own, nodes.Declaration | nodes.Let | nodes.Latch | nodes.Fuzzy) and own.name.text in reserved:
            message = f"`{own.name.text}` is built in since edition {edition}"
            report.error("reserved-name", message, own.name.span, f"choose another name, such as `my_{own.name.text}`")
