"""Notes by hand: from the message of a page to the state of the world and the line to write."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from directed import Track, follow, open_directed
from empty_scenes import CASES
from empty_scenes import scene as empty_scene
from live_client import Message, Page
from sampling import sampled

from antdsl.outputs.edits.verb_table import VERB_BY_WORD
from antdsl.pipeline import open_scene
from antdsl.preview import LiveSimulation, PreviewSession
from antdsl.preview.directing.hand_notes import HandNote
from antdsl.preview.directing.note_forms import draft_note
from antdsl.preview.directing.verb_forms import find_form, list_edit_forms, list_note_forms
from antdsl.scene.notes.notes_model import NOTE_MODELS

LAST = 36


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Track:
    """What the ants do without notes."""
    return follow(open_directed(tmp_path_factory.mktemp("plain"), count=30), LAST)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    open_directed(tmp_path, count=30)
    return tmp_path / "scene.yaml"


@pytest.fixture
def page(scene: Path) -> Iterator[Page]:
    live = LiveSimulation.open_scene(scene)
    live.start()
    opened = Page(live)
    opened.ask("step", count=LAST - 1)
    opened.hash_at(LAST)
    yield opened
    live.stop()


def directed(page: Page, verb: str, agents: str, apply: bool = False, **values: str) -> Message:
    """The answer of the server about a note."""
    number = len(page.told)
    page.ask("direct", list="notes", verb=verb, agents=agents, values=values, apply=apply)
    return page.until(lambda: next((m for m in page.told[number:] if m["op"] in ("directed", "refused")), None))


def listed(page: Page) -> list[tuple[str, bool]]:
    message = page.last("notes")
    return [(note["line"], note["on"]) for note in message["lines"]] if message else []


def opened(scene: Path, frames: int = LAST) -> PreviewSession:
    session, report = PreviewSession.open(scene, checkpoint_interval=10)
    assert session is not None, [d.message for d in report.errors]
    while session.frame < frames:
        session.step()
    return session


def note(session: PreviewSession, verb: str, agents: str, values: dict[str, str], key: int = 0) -> HandNote:
    form = find_form("notes", verb)
    assert form is not None
    draft, read = draft_note(session.shot, form, agents, values)
    assert read is not None, [d.message for d in draft.report.errors]
    return HandNote(key, draft.text, read)


def direct(session: PreviewSession, *notes: HandNote) -> int:
    """Apply these notes, and return to the frame. The result is the frame from which the run was simulated again."""
    frame = session.frame
    outcome = session.replace_notes(notes, "notes")
    assert outcome.is_successful, [d.message for d in outcome.report.errors]
    first = session.frame
    while session.frame < frame:
        session.step()
    return first


# --- the table ---------------------------------------------------------------------------------------------------------


def test_the_table_has_all_verbs_and_keys_of_the_models() -> None:
    forms = list_note_forms()
    assert [form.verb for form in forms] == list(NOTE_MODELS)
    edit_models = {verb: row.line for verb, row in VERB_BY_WORD.items()}
    assert [form.verb for form in list_edit_forms()] == list(edit_models)
    for models, form in [(NOTE_MODELS, form) for form in forms] + [(edit_models, form) for form in list_edit_forms()]:
        own = models[form.verb].model_fields
        fields = {f.alias or name: f for name, f in own.items() if name != "off" and f.alias != form.verb}
        assert form.value.name == ("cache" if form.verb == "merge" else "agents")
        assert {key.name for key in form.keys} == {*fields} and form.help
        assert {key.name for key in form.keys if key.is_required} == {n for n, f in fields.items() if f.is_required()}
        assert all(key.help and key.kind.example for key in form.keys), [form.verb, *form.keys]


# --- values ------------------------------------------------------------------------------------------------------------


def test_a_value_that_is_wrong_is_reported_at_its_key_and_changes_nothing(page: Page, plain: Track) -> None:
    cases: list[tuple[str, str, dict[str, str], str, str]] = [
        ("hold", "", {}, "agents", "the value is missing"),
        ("hold", "gards", {}, "agents", "no crowd line or species is named `gards`"),
        ("hold", "guards.30", {}, "agents", "`guards` has 30 agents"),
        ("hold", "guards", {"frames": "20..4"}, "frames", "ends before it begins"),
        ("hold", "guards", {"ease": "x"}, "ease", "is not a whole number"),
        ("hold", "guards", {"look_at": "{head: leef}"}, "look_at", "`leef`"),
        ("hold", "guards", {"frames": "1..3, off: yes"}, "frames", "another key, `off`"),
        ("hold", "guards", {"frames": "1..3}, {a: b"}, "frames", ""),
        ("hold", "guards", {"near": "leaf"}, "", "no effect without `within` or `most`"),
        ("reach", "guards.1", {"target": "leaf"}, "frame", "missing"),
        ("reach", "guards.1", {"frame": "40"}, "", "`reach` needs either `target` or `along`"),
        ("set", "guards", {"to": "{max_speed: 3 kg}"}, "to", "is a speed, not a mass"),
        ("attract", "guards", {"to": "leaf", "radius": "-4 mm"}, "radius", "is not above zero"),
        ("lane", "guards", {"along": "wey", "width": "4 mm"}, "along", "`wey`"),
        ("hold", "guards", {"speed": "3"}, "", "has no key `speed`"),
    ]
    for verb, agents, values, key, words in cases:
        answer = directed(page, verb, agents, apply=True, **values)
        assert not answer["ok"] and not answer["applied"]
        assert any(words in each["message"] for each in answer["problems"] if each["key"] == key), answer
    answer = directed(page, "hold", "guards.1", apply=True, play="danse")  # only the bodies know this
    assert not answer["applied"] and "no clip `danse`" in answer["problems"][0]["message"]
    assert directed(page, "dance", "guards")["op"] == "refused"
    page.ask("line", list="notes", key=3, action="off")
    page.until(lambda: page.told[-1].get("of") == "line")
    assert listed(page) == [] and page.hash_at(LAST) == plain.hashes[-1] and not page.last("status")["edited"]


def test_defaults_are_left_out_of_the_line(page: Page) -> None:
    answer = directed(page, "hold", " guards.3 ", ease="6", frames="4..9", look_at="{head:\n leaf}")
    assert (answer["line"], answer["ok"]) == ("{hold: guards.3, frames: 4..9, look_at: {head: leaf}}", True)
    assert directed(page, "hold", "guards.3", ease="2")["line"] == "{hold: guards.3, ease: 2}"
    assert page.last("status")["frame"] == LAST and listed(page) == []


# --- the run -----------------------------------------------------------------------------------------------------------


def test_an_applied_note_is_in_the_world_at_once_and_its_line_does_the_same_in_a_scene(
    page: Page, plain: Track, tmp_path: Path
) -> None:
    answer = directed(page, "hold", "guards.7", apply=True, frames="30..50")
    assert answer["applied"]
    track = follow(open_directed(tmp_path / "written", answer["line"], count=30), LAST)
    held = track.hashes[-1]
    page.until(lambda: (m := page.last("status")) and (m["frame"], m["hash"]) == (LAST, held))
    assert page.last("outcome")["text"] == answer["line"] and listed(page) == [(answer["line"], True)]
    assert np.abs(track.of("velocity", 7)[-1]).max() == 0 and np.abs(plain.of("velocity", 7)[-1]).max() > 1
    assert directed(page, "hold", "guards.7", apply=True, frames="30..50")["op"] == "refused"  # it is there already
    for action, expected in (("off", plain.hashes[-1]), ("on", held), ("remove", plain.hashes[-1])):
        page.ask("line", list="notes", key=0, action=action)
        page.until(lambda expected=expected: (m := page.last("status")) and (m["frame"], m["hash"]) == (LAST, expected))
    assert listed(page) == [] and not page.last("status")["edited"]


@pytest.mark.parametrize(
    "case",
    sampled(
        [
            ("look", "guards.4", {"at": "{head: leaf}", "frames": "28..40"}),
            ("play", "guards.4", {"clip": "run", "frames": "28..40"}),
            ("change", "guards.8", {"to": "rest", "frame": "30"}),
            ("set", "guards.7", {"to": "{max_speed: 12 mm/s}", "frames": "28..34"}),
            ("retime", "guards", {"near": "leaf", "within": "80 mm", "frames": "28..34", "speed": "30 %"}),
            ("reach", "guards.3", {"target": "leaf", "frame": "34"}),
            ("without", "guards.3..9", {}),
            ("part", "guards", {"for": "foot", "distance": "20 mm", "frames": "28..34"}),
            ("repel", "guards", {"from": "stone", "radius": "60 mm", "frames": "28..34"}),
        ],
        [("look", "guards.4", {"at": "{head: leaf}", "frames": "28..40"})],
    ),
)
def test_removing_a_note_restores_the_bits_of_the_run(scene: Path, plain: Track, case: tuple[str, str, dict[str, str]]) -> None:
    verb, agents, values = case
    session = opened(scene)
    added = note(session, verb, agents, values)
    first = direct(session, added)
    assert first == (1 if verb in ("reach", "without") else 29 if verb == "change" else 21)
    assert session.state_hash != plain.hashes[-1]
    direct(session)
    assert session.state_hash == plain.hashes[-1] and not session.is_edited


def test_several_notes_go_on_and_off_in_any_order(scene: Path, plain: Track, tmp_path: Path) -> None:
    session = opened(scene)
    one = note(session, "hold", "guards.7", {"frames": "14..22"})
    other = note(session, "retime", "guards", {"frames": "30..40", "speed": "50 %"}, 1)
    absence = note(session, "without", "guards.20..24", {}, 2)
    future = note(session, "hold", "guards.1", {"frames": "60..70"}, 3)
    assert direct(session, one) == 7
    assert direct(session, one, other) == 23
    assert direct(session, one, other, future) == LAST
    assert direct(session, one, other, future, absence) == 1
    all_hash = session.state_hash
    written = open_directed(tmp_path / "written", one.text, other.text, future.text, absence.text, count=30)
    assert all_hash == follow(written, LAST).hashes[-1]
    assert len(session.world) == 25
    direct(session, other, absence)
    direct(session, other)
    direct(session, one, other, future, absence)
    assert session.state_hash == all_hash
    session.seek(10)  # before the later ones begin
    assert session.set_value("ant.nothing", "1").report.errors
    assert [each.text for each in session.notes] == [one.text, other.text, future.text, absence.text]
    direct(session)
    while session.frame < LAST:
        session.step()
    assert session.state_hash == plain.hashes[-1]


def test_an_edit_before_a_note_does_not_lose_it(scene: Path) -> None:
    session = opened(scene)
    held = note(session, "hold", "guards.7", {"frames": "30..50"})
    direct(session, held)
    session.seek(12)
    assert session.reload().line == "nothing has changed" and session.last_frame == LAST
    program = scene.with_name("a.ant")
    program.write_text(program.read_text().replace("max_speed 30 mm/s", "max_speed 40 mm/s"))
    assert session.reload().is_successful
    while session.frame < LAST:
        session.step()
    population = session.world.populations["ant"]
    row = population.find_rows(np.array([7]))[0]
    assert np.abs(population.read_vector("velocity")[row]).max() == 0
    assert session.restart().is_successful and not session.is_edited
    shot, _ = open_scene(scene, session.choices)
    assert shot is not None and shot.scene.model.notes == (held.note,)


def test_a_note_that_is_written_into_the_scene_is_no_longer_added(scene: Path) -> None:
    session = opened(scene)
    slow, held = (
        note(session, "retime", "guards", {"speed": "50 %", "frames": "20..30"}),
        note(session, "hold", "guards.7", {}, 1),
    )
    direct(session, slow, held)
    first_hash = session.state_hash
    scene.write_text(f"{scene.read_text()}notes:\n  - {slow.text}\n")
    outcome = session.reload()
    assert outcome.is_successful and f"`{slow.text}` is now in the scene" in outcome.line
    assert session.notes == (held,) and session.state_hash == first_hash


def test_a_note_that_no_longer_fits_is_switched_off(scene: Path) -> None:
    session = opened(scene, 20)
    held = note(session, "hold", "guards.7", {"frames": "10..50"})
    at_leaf = note(session, "attract", "guards", {"to": "leaf", "radius": "50 mm", "frames": "10..50"}, 1)
    direct(session, held, at_leaf)
    scene.write_text(scene.read_text().replace("leaf:", "blade:"))
    outcome = session.reload()
    assert outcome.is_successful and f"`{at_leaf.text}` no longer fits" in outcome.line
    assert [each.is_on for each in session.notes] == [True, False] and "leaf" in session.notes[1].problem


@pytest.mark.parametrize("case", sampled(list(CASES), list(CASES)[:1]))
def test_notes_are_possible_where_no_agent_is_there(tmp_path: Path, case: str) -> None:
    live = LiveSimulation.open_scene(empty_scene(tmp_path / "scene", case))
    live.start()
    try:
        page = Page(live)
        page.ask("step", count=6)
        page.until(lambda: (status := page.last("status")) and status["hash"] and status["head"] >= 6)
        for verb, values in (("hold", {}), ("retime", {"speed": "50 %"}), ("look", {"at": "{head: [0, 0, 0]}"}), ("without", {})):
            answer = directed(page, verb, "person", apply=True, **values)
            assert answer["op"] == "directed" and (answer["applied"] or answer["problems"]), answer
            page.until(lambda: (status := page.last("status")) and status["hash"])
        assert not [message for message in page.told if message["op"] == "refused"]
    finally:
        live.stop()
