"""Checks of notes that pages have composed, with the same rules as notes in scene files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from antdsl.diagnostics import Report
from antdsl.pipeline import Shot
from antdsl.preview.directing.line_drafts import LineDraft, write_draft
from antdsl.preview.directing.verb_forms import VerbForm
from antdsl.program.model import Program
from antdsl.scene.checks.scene_checks import list_selector_names
from antdsl.scene.document import MappingNode, SequenceNode, to_plain_tree
from antdsl.scene.load import Scene, drop_cascading_errors, report_model_error
from antdsl.scene.notes.note_checks import check_note
from antdsl.scene.notes.note_lines import NOTES_KEY, read_note_line
from antdsl.scene.notes.note_programs import remove_note_machines
from antdsl.scene.notes.notes_model import AnyNote, Note

_KEY_DEPTH = 2  # parts of the location of a key of a note: the verb's tag and the key


def draft_note(shot: Shot, form: VerbForm, agents: str, values: Mapping[str, str]) -> tuple[LineDraft, Note | None]:
    """Return the draft of a note, and the note as checked against a shot. The note is None if there are errors."""
    draft = write_draft(form, agents, values)
    node, report = read_note_line(draft.text)
    draft.report.extend(report)
    note = None if node is None else _read_note(node, draft.report)
    draft.report_unknown_keys(form, values)
    if node is not None and note is not None:
        draft.report_nested_keys(node)
        _check_names(shot.scene, remove_note_machines(shot.program), note, node, draft.report)
    return draft, note if draft.report.ok and not draft.missing else None


def _read_note(node: MappingNode, report: Report) -> Note | None:
    try:
        note: Note = _find_note_adapter().validate_python(to_plain_tree(node))
        return note
    except ValidationError as problem:
        for error in drop_cascading_errors(problem.errors(include_url=False, include_input=False)):
            if error["type"] != "missing" or len(error["loc"]) > _KEY_DEPTH:
                error["loc"] = (NOTES_KEY, 0, *error["loc"])
                report_model_error(report, _wrap_node(node), error)
        return None


@cache
def _find_note_adapter() -> TypeAdapter[Any]:
    return TypeAdapter(AnyNote)


def _wrap_node(node: MappingNode) -> MappingNode:
    """Return the syntax tree of a scene that contains only this note."""
    return MappingNode({NOTES_KEY: SequenceNode((node,), node.span)}, {NOTES_KEY: node.span}, node.span)


def _check_names(scene: Scene, program: Program, note: Note, node: MappingNode, report: Report) -> None:
    """Report the unknown names and the wrong values in one note. Other notes of the scene are ignored."""
    alone = replace(scene, model=scene.model.model_copy(update={"notes": (note,)}), document=_wrap_node(node), added_notes=1)
    check_note(alone, program, report, list_selector_names(scene, program), 0)
