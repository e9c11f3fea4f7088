"""Why, in a session under way: reports say what happened, also across edits, and change nothing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from explained_live import Notes, session_of
from live_client import Page
from preview_page import few

from antdsl.preview import LiveSimulation, PreviewSession


def first_layer(session: PreviewSession) -> tuple[str, str]:
    """The species and the text of a layer that can be switched off: a small edit that any example takes."""
    name = next(iter(session.shot.plan.species))
    return name, session.shot.program.species[name].layers.layers[0].span.text


PARAM = {"foraging": ("forager.swing", "120 deg"), "flocking": ("boid.sight", "40 mm"), "alarm": ("ant.shout", "60 /s")}


def watched(name: str, frames: int, each: int, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Notes:
    """Some frames of an example that is edited on the way, gone back in and branched."""
    notes = Notes(session_of(name, folder, checkpoint_interval=5), monkeypatch, len(name), each)
    session = notes.session
    part = frames // 5
    notes.go(part)
    layer = first_layer(session)
    assert session.switch_layer(*layer, False).is_successful
    notes.go(part)
    session.seek(session.frame - part // 2)
    if name in PARAM:
        assert session.set_value(*PARAM[name]).is_successful
    notes.go(2 * part)
    session.seek(session.first_frame + part // 2)
    session.seek(session.last_frame)
    assert session.switch_layer(*layer, True).is_successful
    notes.go(frames - part * 7 // 2)
    return notes


@pytest.mark.parametrize("name", [pytest.param("foraging", marks=pytest.mark.slow), "moods"])
def test_what_is_explained_is_what_happened_however_it_was_edited(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    notes = watched(name, 20, 4, tmp_path, monkeypatch)
    initial_hash = notes.session.state_hash
    assert len(notes.session.timeline.stretches) == 3
    assert notes.explained_otherwise(20) == {}
    assert notes.session.state_hash == initial_hash


@pytest.mark.slow
@pytest.mark.parametrize("name", ["foraging", "flocking", "moods", "alarm"])
def test_explanations_agree_with_runs_a_thousand_times(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notes = watched(name, 100, 5, tmp_path, monkeypatch)
    initial_hash = notes.session.state_hash
    assert notes.explained_otherwise(250) == {}
    assert notes.session.state_hash == initial_hash


@pytest.fixture
def live(tmp_path: Path) -> Iterator[LiveSimulation]:
    live = LiveSimulation.open_scene(few(tmp_path, 40))
    live.start()
    yield live
    live.stop()


def test_a_page_that_asks_receives_the_reason(live: LiveSimulation, tmp_path: Path) -> None:
    page = Page(live)
    page.ask("step", count=8)
    hash = page.status(frame=9, playing=False)["hash"]
    page.ask("explain", species="forager", agent=3, frame=9)
    answer = page.until(lambda: page.last("explained"))
    assert (answer["agent"], answer["frame"], answer["message"]) == (3, 9, "")
    explanation = answer["explanation"]
    assert explanation["hash"] == hash
    assert explanation["strip"] == [{"machine": "main", "state": "search", "first": 1, "last": 9}]
    assert explanation["layers"][0]["place"]["file"] == "forager.ant"
    assert str(tmp_path) not in json.dumps(answer)  # a page never hears of this machine's folders
    assert answer["told"].startswith("forager 3, the step to frame 9 of scene.yaml\n")
    assert len(answer["place"]) == 3
    assert page.status(frame=9)["hash"] == hash


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        ({"species": "forager", "agent": 3, "frame": 1}, "frame 1 is the first: no step led to it: choose frame 2 or later"),
        (
            {"species": "forager", "agent": 3, "frame": 99},
            "frame 99 was not simulated, or is no longer stored: frames 2 to 4 can be explained",
        ),
        ({"species": "foragr", "agent": 3, "frame": 3}, "no species `foragr`: did you mean `forager`?"),
        ({"species": "forager", "agent": 500, "frame": 3}, "no forager 500 at frame 2: there are 40, from 0 to 39"),
    ],
)
def test_unexplainable_requests_are_errors(live: LiveSimulation, ask: dict[str, Any], message: str) -> None:
    page = Page(live)
    page.ask("step", count=3)
    page.status(frame=4, playing=False)
    page.ask("explain", **ask)
    answer = page.until(lambda: page.last("explained"))
    assert answer["message"].startswith(message)
    assert (answer["explanation"], answer["place"]) == (None, None)
