"""Notes as pages write them: a verb and the texts of its keys become a line, which is checked like a line of a scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from antdsl.diagnostics import Diagnostic, Report
from antdsl.pipeline import Shot
from antdsl.preview.directing.verb_forms import VerbForm, VerbKey
from antdsl.program.model import Program
from antdsl.scene.checks.scene_checks import list_selector_names
from antdsl.scene.document import MappingNode, SequenceNode, to_plain_tree
from antdsl.scene.load import Scene, drop_consequent_errors, report_model_error
from antdsl.scene.notes.note_checks import check_note
from antdsl.scene.notes.note_lines import NOTES_KEY, is_note_source, read_note_line
from antdsl.scene.notes.note_programs import remove_note_machines
from antdsl.scene.notes.notes_model import AnyNote, Note

AGENTS_KEY = "agents"  # of the verb's value
_KEY_DEPTH = 2  # parts of the location of a key of a note: the verb's tag and the key


@dataclass(frozen=True, slots=True, eq=False)
class NoteDraft:
    """A note as a page wrote it.

    `text`: its line. `ends`: the start and the end of each value in it. `missing`: required keys without a value. `note`: None
    after errors."""

    text: str
    ends: Mapping[str, tuple[int, int]]
    missing: tuple[VerbKey, ...]
    note: Note | None
    report: Report

    def find_key(self, diagnostic: Diagnostic) -> str:
        """Return the key that a finding is about; empty if it is about the line as a whole, or about something else."""
        span = diagnostic.span
        if span is None or not is_note_source(span.source.path) or span.source.text != self.text:
            return ""
        inside = (key for key, (start, end) in self.ends.items() if start <= span.start <= end and span.end <= end + 1)
        return next(inside, "")


def make_draft(shot: Shot, form: VerbForm, agents: str, values: Mapping[str, str]) -> NoteDraft:
    """Return a note with these texts, checked against a shot."""
    text, ends = _write_line(form, agents, values)
    node, report = read_note_line(text)
    note = None if node is None else _read_note(node, report)
    missing = tuple(key for key in form.keys if key.is_required and key.name not in ends)
    draft = NoteDraft(text, ends, missing, note, report)
    for name in values:
        if form.find_key(name) is None:
            report.error("unknown-key", f"`{form.verb}` has no key `{name}`", None)
    if node is not None and note is not None:
        _check_keys(draft, node)
        _check_names(shot.scene, remove_note_machines(shot.program), note, node, report)
    return draft if report.ok and not missing else replace(draft, note=None)


def _write_line(form: VerbForm, agents: str, values: Mapping[str, str]) -> tuple[str, dict[str, tuple[int, int]]]:
    """Return a line on one line of text, and the start and the end of each value in it. Defaults are left out."""
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
    return f"{text}}}", ends


def _read_note(node: MappingNode, report: Report) -> Note | None:
    try:
        note: Note = _find_note_adapter().validate_python(to_plain_tree(node))
        return note
    except ValidationError as problem:
        for error in drop_consequent_errors(problem.errors(include_url=False, include_input=False)):
            if error["type"] != "missing" or len(error["loc"]) > _KEY_DEPTH:
                error["loc"] = (NOTES_KEY, 0, *error["loc"])
                report_model_error(report, _wrap_node(node), error)
        return None


@cache
def _find_note_adapter() -> TypeAdapter[Any]:
    return TypeAdapter(AnyNote)


def _wrap_node(node: MappingNode) -> MappingNode:
    """Return the tree of a scene that has only this note."""
    return MappingNode({NOTES_KEY: SequenceNode((node,), node.span)}, {NOTES_KEY: node.span}, node.span)


def _check_keys(draft: NoteDraft, node: MappingNode) -> None:
    """Report values that contain further keys, such as `10, off: yes`."""
    starts = [start for start, _ in draft.ends.values()]
    for key, span in list(node.keys.items())[1:]:
        if key not in draft.ends or draft.ends[key][0] < span.start:
            at = max(start for start in starts if start <= span.start)
            place = replace(span, start=at)
            draft.report.error("wrong-value", f"the value contains another key, `{key}`", place, f"give `{key}` its own field")


def _check_names(scene: Scene, program: Program, note: Note, node: MappingNode, report: Report) -> None:
    """Report what is wrong with a note in a scene, without the notes of the scene."""
    alone = replace(scene, model=scene.model.model_copy(update={"notes": (note,)}), document=_wrap_node(node), added_notes=1)
    check_note(alone, program, report, list_selector_names(scene, program), 0)


def list_problems(draft: NoteDraft, findings: Iterable[Diagnostic]) -> list[dict[str, str]]:
    """Return for a page what is missing, and the findings that are errors or about the note, each with its key."""
    problems = [
        {"key": key.name, "severity": "error", "message": "a value is missing here", "help": f"such as `{key.kind.example}`"}
        for key in draft.missing
    ]
    return problems + [
        {"key": draft.find_key(each), "severity": each.severity, "message": each.message, "help": each.help or ""}
        for each in findings
        if each.severity == "error" or (each.span is not None and is_note_source(each.span.source.path))
    ]
