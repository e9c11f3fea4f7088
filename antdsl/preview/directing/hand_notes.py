"""The notes that users added to a running scene on pages, and the frames that a change of these notes affects."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import inf

from antdsl.diagnostics import Report
from antdsl.scene.load import Scene
from antdsl.scene.notes.note_lines import format_note_source
from antdsl.scene.notes.notes_model import Note


@dataclass(frozen=True, slots=True, eq=False)
class HandNote:
    """A note that a user added on a page and that is not in the scene file.

    `key`: identifies the note for pages. `text`: its line. `is_on`: whether it applies to the run. `problem`: why it was
    switched off automatically."""

    key: int
    text: str
    note: Note
    is_on: bool = True
    problem: str = ""


HandNotes = tuple[HandNote, ...]


def list_active_lines(notes: Iterable[HandNote]) -> tuple[str, ...]:
    """Return the lines of those notes that are active."""
    return tuple(note.text for note in notes if note.is_on)


def find_last_unaffected_frame(old: HandNotes, new: HandNotes) -> float:
    """Return the last frame that is the same with the old and the new notes. Return -inf if no frame is the same, and inf if all
    are."""
    keys = [{note.key for note in notes if note.is_on} for notes in (old, new)]
    changed = [note.note for note in (*old, *new) if note.key in keys[0] ^ keys[1]]
    return min((note.first_frame - note.ease_frames - 1 for note in changed), default=inf)


def drop_written_notes(notes: HandNotes, scene: Scene) -> HandNotes:
    """Return the notes without those that the scene file now contains."""
    written = scene.model.notes[: len(scene.model.notes) - scene.added_notes]
    return tuple(each for each in notes if each.note not in written)


def switch_off_failed_notes(notes: HandNotes, report: Report) -> HandNotes:
    """Return the notes, with those that have errors switched off. `report`: the findings about all active notes."""
    problems = {d.span.source.path: d.message for d in reversed(report.errors) if d.span is not None}
    active = [note for note in notes if note.is_on]
    failed = {note.key: problems[path] for k, note in enumerate(active) if (path := format_note_source(k)) in problems}
    return tuple(replace(each, is_on=False, problem=failed[each.key]) if each.key in failed else each for each in notes)


def describe_switched_notes(old: Sequence[HandNote], new: Sequence[HandNote]) -> list[str]:
    """Return a text for each note that is active in `old` but inactive or missing in `new`."""
    later = {note.key: note for note in new}
    texts = []
    for note in old:
        other = later.get(note.key)
        if other is None:
            texts.append(f"`{note.text}` is now in the scene")
        elif note.is_on and not other.is_on:
            texts.append(f"`{note.text}` no longer fits")
    return texts
