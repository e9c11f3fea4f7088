"""Drafts of notes and edits: a verb and the texts of its keys become one line of YAML with the location of each value."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from antdsl.diagnostics import Diagnostic, Report
from antdsl.preview.directing.verb_forms import VerbForm, VerbKey
from antdsl.scene.document import MappingNode
from antdsl.scene.notes.note_lines import is_note_source
from antdsl.source import Span

AGENTS_KEY = "agents"  # of the verb's value
EDIT_SOURCE = "<edit>"  # the name of the source of a draft of an edit


@dataclass(frozen=True, slots=True, eq=False)
class LineDraft:
    """A line that a page has composed. `text`: its text. `ends`: by key, the start and end offsets of the value in the text.
    `missing`: the required keys without a value."""

    text: str
    ends: Mapping[str, tuple[int, int]]
    missing: tuple[VerbKey, ...]
    report: Report

    def find_key(self, diagnostic: Diagnostic) -> str:
        """Return the key of the value that a finding is about; "" if it is about the complete line or about another file."""
        span = diagnostic.span
        if span is None or not _is_draft_source(span) or not span.source.text.endswith(self.text):
            return ""
        first = len(span.source.text) - len(self.text)
        start, end = span.start - first, span.end - first
        inside = (key for key, (low, high) in self.ends.items() if low <= start <= high and end <= high + 1)
        return next(inside, "")

    def report_unknown_keys(self, form: VerbForm, values: Iterable[str]) -> None:
        """Report keys that the verb does not have."""
        for name in values:
            if form.find_key(name) is None:
                self.report.error("unknown-key", f"`{form.verb}` has no key `{name}`", None)

    def report_nested_keys(self, node: MappingNode) -> None:
        """Report each value that contains further keys, such as `10, off: yes`. `node`: the syntax tree of the line."""
        first = len(node.span.source.text) - len(self.text)
        ends = {key: (start + first, end + first) for key, (start, end) in self.ends.items()}
        for key, span in list(node.keys.items())[1:]:
            if key not in ends or ends[key][0] < span.start:
                at = max(start for start, _ in ends.values() if start <= span.start)
                place = replace(span, start=at)
                self.report.error("wrong-value", f"the value contains another key, `{key}`", place, f"give `{key}` its own field")

    def list_problems(self, findings: Iterable[Diagnostic]) -> list[dict[str, str]]:
        """Return the problems to show on a page, each with the key that it concerns. They are the missing values, and those
        findings that are errors or are about this line."""
        problems = [
            {"key": key.name, "severity": "error", "message": "a value is missing here", "help": f"such as `{key.kind.example}`"}
            for key in self.missing
        ]
        return problems + [
            {"key": self.find_key(each), "severity": each.severity, "message": each.message, "help": each.help or ""}
            for each in findings
            if each.severity == "error" or (each.span is not None and _is_draft_source(each.span))
        ]


def _is_draft_source(span: Span) -> bool:
    return is_note_source(span.source.path) or span.source.path == EDIT_SOURCE


def write_draft(form: VerbForm, agents: str, values: Mapping[str, str]) -> LineDraft:
    """Return the draft of a line, without findings. Values equal to the default are left out."""
    filled = [(key.name, key.name, values.get(key.name, ""), key.default) for key in form.keys]
    text = "{"
    ends: dict[str, tuple[int, int]] = {}
    for name, key, value, default in [(AGENTS_KEY, form.verb, agents, None), *filled]:
        value = " ".join(value.split())
        if name != AGENTS_KEY and value in ("", default):
            continue
        text += f"{', ' if ends else ''}{key}: "
        ends[name] = len(text), len(text) + len(value)
        text += value
    missing = tuple(key for key in form.keys if key.is_required and key.name not in ends)
    return LineDraft(f"{text}}}", ends, missing, Report())
