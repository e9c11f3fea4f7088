"""Handlers of notes: drafts, notes that are added, and their switches."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from antdsl import limits
from antdsl.preview import requests
from antdsl.preview.directing.hand_notes import HandNote, HandNotes
from antdsl.preview.directing.note_forms import list_problems, make_draft
from antdsl.preview.directing.verb_forms import find_note_form
from antdsl.preview.outcomes import Outcome
from antdsl.preview.requests import RequestRefused
from antdsl.preview.viewing.messages import find_scene_name, make_outcome_message

if TYPE_CHECKING:
    from antdsl.preview.live import Client, Live


def draft_note(live: Live, request: requests.DraftNote, client: Client) -> None:
    """Check a note, and add it to the run if that is requested. Send the line and what is wrong with it to the page."""
    form = find_note_form(request.verb)
    if form is None:
        raise RequestRefused(f"`{request.verb}` is not a verb of notes")
    notes = live.session.notes
    draft = make_draft(live.session.shot, form, request.agents, request.values)
    findings, is_applied = [*draft.report.diagnostics], False
    if request.apply and any(note.text == draft.text for note in notes):
        raise RequestRefused("the run has this note already", "change a value, or switch the note on in the list")
    if request.apply and draft.note is not None:
        if len(notes) >= limits.MAX_PREVIEW_NOTES:
            raise RequestRefused(f"a preview holds at most {len(notes)} notes", "write them into the scene")
        added = HandNote(max((note.key for note in notes), default=-1) + 1, draft.text, draft.note)
        result = _change_notes(live, (*notes, added), f"note `{draft.text}`", draft.text)
        findings, is_applied = [*result.report.diagnostics], result.ok
    problems = [{**each, "message": live.screen.names.shorten_paths(each["message"])} for each in list_problems(draft, findings)]
    client.tell({"op": "directed", "line": draft.text, "ok": draft.note is not None, "applied": is_applied, "problems": problems})


def switch_note(live: Live, request: requests.SwitchNote, client: Client) -> None:
    """Switch a note on or off, or remove it, and send the outcome to all pages."""
    notes = live.session.notes
    note = next((each for each in notes if each.key == request.key), None)
    if note is None:
        raise RequestRefused("this note no longer exists")
    others = tuple(
        replace(each, is_on=request.action == "on", problem="") if each is note else each
        for each in notes
        if each is not note or request.action != "remove"
    )
    words = {"on": "is on again", "off": "is off", "remove": "is removed"}[request.action]
    result = _change_notes(live, others, f"note `{note.text}` {words}")
    if not result.ok:
        errors = result.report.errors
        raise RequestRefused(live.screen.names.shorten_paths(errors[0].message), errors[0].help or "")


def _change_notes(live: Live, notes: HandNotes, description: str, text: str = "") -> Outcome:
    """Replace the notes of the run, and bring it to the displayed frame again."""
    live.show_exact_frame()
    frame = live.session.frame
    result = live.session.direct(notes, description, text)
    if result.ok:
        live.send_to_all(make_outcome_message(live, "note", result, find_scene_name(live) if text else ""))
        live.screen.on_edit(files_changed=False)
        if live.session.frame < frame:
            live.start_steps(frame - live.session.frame)
    return result
