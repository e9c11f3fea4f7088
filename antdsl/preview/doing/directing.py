"""Handlers of requests about notes and edits: check a draft, add a line, switch it on or off, remove it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from antdsl import limits
from antdsl.diagnostics import Diagnostic, Report
from antdsl.preview import requests
from antdsl.preview.directing.hand_edits import EDITS_FILE, HandEdit, HandEdits
from antdsl.preview.directing.hand_notes import HandNote, HandNotes
from antdsl.preview.directing.line_drafts import LineDraft
from antdsl.preview.directing.note_forms import draft_note
from antdsl.preview.directing.verb_forms import VerbForm, find_form
from antdsl.preview.outcomes import EditOutcome
from antdsl.preview.requests import RequestRefusedError
from antdsl.preview.viewing.messages import find_scene_name, make_outcome_message

if TYPE_CHECKING:
    from antdsl.preview.live import Client, LiveSimulation

_RESULT_PHRASE_BY_ACTION = {"on": "is on again", "off": "is off", "remove": "is removed"}
_WORD_BY_LIST = {"notes": "note", "edits": "edit"}
Line = TypeVar("Line", HandNote, HandEdit)


def handle_draft_line(live: LiveSimulation, request: requests.DraftLine, client: Client) -> None:
    """Check a line, and add it to the run if `request.apply` is set. Send the line and its problems to the page."""
    form = find_form(request.list, request.verb)
    if form is None:
        raise RequestRefusedError(f"`{request.verb}` is not a verb of {request.list}")
    draft, is_valid, findings, is_applied = (_draft_note if request.list == "notes" else _draft_edit)(live, request, form)
    problems = [{**each, "message": live.screen.names.shorten_paths(each["message"])} for each in draft.list_problems(findings)]
    choices = {"joint": live.screen.edited.list_joints(request.agents)} if form.find_key("joint") and request.agents else {}
    answer = {"line": draft.text, "ok": is_valid, "applied": is_applied, "problems": problems, "choices": choices}
    client.send_message({"op": "directed", "list": request.list, **answer})


_DraftResult = tuple[LineDraft, bool, list[Diagnostic], bool]  # the line, whether it is valid, findings, whether it was added


def _draft_note(live: LiveSimulation, request: requests.DraftLine, form: VerbForm) -> _DraftResult:
    """Check a note, and add it if requested. Return the draft, whether it is valid, the findings, and whether it was added."""
    notes = live.session.notes
    draft, note = draft_note(live.session.shot, form, request.agents, request.values)
    if not request.apply or note is None:
        return draft, note is not None, draft.report.diagnostics, False
    _check_new_line(notes, draft.text, "note")
    added = HandNote(_find_free_key(notes), draft.text, note)
    result = _change_notes(live, (*notes, added), f"note `{draft.text}`", draft.text)
    return draft, True, result.report.diagnostics, result.is_successful


def _draft_edit(live: LiveSimulation, request: requests.DraftLine, form: VerbForm) -> _DraftResult:
    """Check an edit, and add it if requested. Return the draft, whether it is valid, the findings, and whether it was added."""
    edits = live.screen.edited.edits
    draft, is_valid = live.screen.edited.check_line(form, request.agents, request.values)
    if not request.apply or not is_valid:
        return draft, is_valid, draft.report.diagnostics, False
    _check_new_line(edits, draft.text, "edit")
    problem = _change_edits(live, (*edits, HandEdit(_find_free_key(edits), draft.text)), f"edit `{draft.text}`", draft.text)
    if problem:
        draft.report.error("wrong-value", problem, None)
    return draft, True, draft.report.diagnostics, not problem


def _check_new_line(lines: Iterable[HandNote] | Iterable[HandEdit], text: str, what: str) -> None:
    """Raise RequestRefusedError if the new line exists already, or if there are too many lines. `what`: the kind of line, for the
    message."""
    texts = [line.text for line in lines]
    if text in texts:
        raise RequestRefusedError(f"the run has this {what} already", f"change a value, or switch the {what} on in the list")
    if len(texts) >= limits.MAX_PREVIEW_LINES:
        raise RequestRefusedError(f"a preview holds at most {len(texts)} {what}s", "write them into a file")


def _find_free_key(lines: Iterable[HandNote] | Iterable[HandEdit]) -> int:
    return max((line.key for line in lines), default=-1) + 1


def handle_switch_line(live: LiveSimulation, request: requests.SwitchLine, client: Client) -> None:
    """Switch a line on or off, or remove it, and send the outcome to all pages."""
    if request.list == "notes":
        notes, did = _switch_line(live.session.notes, request)
        result = _change_notes(live, notes, did)
        problem, help = (
            ("", "") if result.is_successful else (result.report.errors[0].message, result.report.errors[0].help or "")
        )
    else:
        edits, did = _switch_line(live.screen.edited.edits, request)
        problem, help = _change_edits(live, edits, did), ""
    if problem:
        raise RequestRefusedError(live.screen.names.shorten_paths(problem), help)


def handle_settle(live: LiveSimulation, request: requests.Settle, client: Client) -> None:
    """Start to settle the simulated frames with edits, or stop and remove the settled agents."""
    if request.on and not any(edit.is_on for edit in live.screen.edited.edits):
        raise RequestRefusedError("there are no edits to settle", "add an edit, or switch one on")
    if request.on:
        live.show_exact_frame()
        live.screen.settling.start()
    else:
        live.screen.settling.stop()


def _switch_line(lines: tuple[Line, ...], request: requests.SwitchLine) -> tuple[tuple[Line, ...], str]:
    """Return the lines after a request to switch or remove one, and a description of this change."""
    what = _WORD_BY_LIST[request.list]
    line = next((each for each in lines if each.key == request.key), None)
    if line is None:
        raise RequestRefusedError(f"this {what} no longer exists")
    switched = tuple(
        replace(each, is_on=request.action == "on", problem="") if each is line else each
        for each in lines
        if each is not line or request.action != "remove"
    )
    return switched, f"{what} `{line.text}` {_RESULT_PHRASE_BY_ACTION[request.action]}"


def _change_notes(live: LiveSimulation, notes: HandNotes, description: str, text: str = "") -> EditOutcome:
    """Replace the notes of the run, and simulate up to the displayed frame again."""
    live.show_exact_frame()
    frame = live.session.frame
    result = live.session.replace_notes(notes, description, text)
    if result.is_successful:
        live.send_to_all(make_outcome_message(live, "note", result, find_scene_name(live) if text else ""))
        live.screen.on_edit(files_changed=False)
        if live.session.frame < frame:
            live.start_steps(frame - live.session.frame)
    return result


def _change_edits(live: LiveSimulation, edits: HandEdits, description: str, text: str = "") -> str:
    """Replace the edits that are applied to displayed frames. Return "" on success, or the reason why the new edits cannot be
    applied."""
    live.show_exact_frame()
    problem = live.screen.edited.replace_edits(edits, live.session.frame)
    if not problem:
        outcome = EditOutcome(Report(), "the simulated frames are shown with it" if text else "", text, description)
        live.send_to_all(make_outcome_message(live, "edit", outcome, EDITS_FILE if text else ""))
        live.screen.on_edit(files_changed=False)
    return problem
