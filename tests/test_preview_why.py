"""Why, in a session under way: what is told is what happened, also across edits, and telling changes nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from explained_live import Notes, session_of

from antdsl.preview import Session


def first_layer(session: Session) -> tuple[str, str]:
    """The species and the text of a layer that can be switched off: a small edit that any example takes."""
    name = next(iter(session.shot.plan.species))
    return name, session.shot.program.species[name].layers.layers[0].span.text


PARAM = {"foraging": ("forager.swing", "120 deg"), "flocking": ("boid.sight", "40 mm"), "alarm": ("ant.shout", "60 /s")}


def watched(name: str, frames: int, each: int, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Notes:
    """Some frames of an example that is edited on the way, gone back in and branched."""
    notes = Notes(session_of(name, folder, every=5), monkeypatch, len(name), each)
    session = notes.session
    part = frames // 5
    notes.go(part)
    layer = first_layer(session)
    assert session.layer(*layer, False).ok
    notes.go(part)
    session.seek(session.frame - part // 2)
    if name in PARAM:
        assert session.set(*PARAM[name]).ok
    notes.go(2 * part)
    session.seek(session.first + part // 2)
    session.seek(session.head)
    assert session.layer(*layer, True).ok
    notes.go(frames - part * 7 // 2)
    return notes


@pytest.mark.parametrize("name", ["foraging", "moods"])
def test_what_is_explained_is_what_happened_however_it_was_edited(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    notes = watched(name, 20, 4, tmp_path, monkeypatch)
    before = notes.session.hash
    assert len(notes.session.timeline.stretches) == 3
    assert notes.explained_otherwise(20) == {}
    assert notes.session.hash == before


@pytest.mark.slow
@pytest.mark.parametrize("name", ["foraging", "flocking", "moods", "alarm"])
def test_what_is_explained_is_what_happened_a_thousand_times(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    notes = watched(name, 100, 5, tmp_path, monkeypatch)
    before = notes.session.hash
    assert notes.explained_otherwise(250) == {}
    assert notes.session.hash == before
