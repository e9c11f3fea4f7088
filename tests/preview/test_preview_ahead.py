"""Planned paths: what a session will do without edits, to the bit, with no change of the session."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from live_client import Page, hashes
from preview_page import few

from antdsl.preview import LiveSimulation, PreviewSession
from antdsl.preview import look_ahead as ahead_module
from antdsl.preview.binary_packets import unpack_arrays
from antdsl.preview.look_ahead import LookAheadSimulation
from antdsl.preview.requests import MAX_PLANNED_AGENTS, SetDisplay
from antdsl.runtime import World
from antdsl.runtime.faults import Fault, LimitStop


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return few(tmp_path, 40)


@pytest.fixture
def session(scene: Path) -> PreviewSession:
    session, report = PreviewSession.open(scene, checkpoint_interval=8)
    assert session is not None, report.errors
    return session


@pytest.fixture
def live(scene: Path) -> Iterator[LiveSimulation]:
    live = LiveSimulation.open_scene(scene)
    live.start()
    yield live
    live.stop()


def filled(ahead: LookAheadSimulation, session: PreviewSession) -> LookAheadSimulation:
    while ahead.needs_simulation(session):
        ahead.simulate_next_frame(session)
    return ahead


def positions_by_id(session: PreviewSession) -> np.ndarray:
    population = session.world.populations["forager"]
    return population.position[population.get_rows_by_id()].astype(np.float32)


def test_paths_are_where_the_agents_will_be_and_the_session_is_as_it_was(session: PreviewSession) -> None:
    for _ in range(3):
        session.step()
    initial_hash, initial_curves = session.state_hash, dict(session.timeline.curves)
    ahead = filled(LookAheadSimulation(), session)
    assert list(ahead.frames) == list(range(4, 4 + 48 + 1)), "2 seconds at 24 frames"
    assert session.state_hash == initial_hash and session.timeline.curves == initial_curves and session.frame == 4
    for frame in range(4, 20):
        assert ahead.frames[frame]["forager"]["position"].tobytes() == positions_by_id(session).tobytes()
        session.step()
    displacement = ahead.frames[12]["forager"]["position"] - ahead.frames[4]["forager"]["position"]
    straight = (ahead.frames[5]["forager"]["position"] - ahead.frames[4]["forager"]["position"]) * 8
    assert np.abs(displacement - straight).max() > 2, "no straight extrapolation"


def test_who_goes_on_simulates_only_what_is_new(session: PreviewSession, monkeypatch: pytest.MonkeyPatch) -> None:
    ahead = filled(LookAheadSimulation(), session)
    simulated_frames = []
    monkeypatch.setattr(
        ahead_module, "step", lambda world, step=ahead_module.step: (simulated_frames.append(world.frame), step(world))
    )
    for _ in range(5):
        session.step()
    filled(ahead, session)
    assert simulated_frames == [49, 50, 51, 52, 53] and list(ahead.frames) == list(range(6, 55))
    session.seek(2)
    filled(ahead, session)
    assert simulated_frames[5:] == list(range(2, 50)), "gone back to what is not kept any more"


def test_an_edit_makes_other_paths(session: PreviewSession) -> None:
    for _ in range(6):
        session.step()
    ahead = filled(LookAheadSimulation(), session)
    initial_positions = ahead.frames[40]["forager"]["position"]
    assert session.set_value("forager.smell", "200 mm").is_successful
    assert ahead.needs_simulation(session) and not ahead.frames
    filled(ahead, session)
    assert not np.array_equal(ahead.frames[40]["forager"]["position"], initial_positions)
    for _ in range(3):
        session.step()
    assert session.switch_layer("forager", "give_way(radius: 2.2 * size)", is_on=False).is_successful
    edit_frame, later = session.frame, filled(ahead, session).frames[session.frame + 12]["forager"]["position"]
    session.seek(edit_frame - 5)
    filled(ahead, session)
    assert max(ahead.frames) == edit_frame, "history was otherwise from the edit on: paths end there"
    session.seek(edit_frame)
    for _ in range(12):
        session.step()
    assert later.tobytes() == positions_by_id(session).tobytes()


def test_stored_paths_are_bounded(session: PreviewSession, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead_module, "_MAX_POSITION_BYTES", 12 * 40 * 7)
    assert len(filled(LookAheadSimulation(), session).frames) == 7 + 1


def paths(page: Page) -> tuple[dict, dict]:
    return unpack_arrays(page.make_packets["paths"])


def test_a_page_is_shown_the_paths_it_asks_for(live: LiveSimulation, scene: Path) -> None:
    expected = hashes(scene, 12)
    page = Page(live)
    page.frame_arrays(1)
    assert "paths" not in page.make_packets
    page.ask(
        "look", columns=(), fields=(), flows=(), planned=({"species": "forager", "agent": 3}, {"species": "forager", "agent": 77})
    )
    page.until(lambda: "paths" in page.make_packets and paths(page)[0]["count"] == 49)
    header, arrays = paths(page)
    assert header["frame"] == 1 and arrays["forager/id"].tolist() == [3], "whom there is not has no path"
    path = arrays["forager/path"].reshape(1, 49, 3)
    page.ask("step", count=10)
    assert page.hash_at(11) == expected[11], "a run is what it is without them"
    page.until(lambda: paths(page)[0]["frame"] == 11 and paths(page)[0]["count"] == 49)
    assert np.array_equal(paths(page)[1]["forager/path"].reshape(1, 49, 3)[:, :39], path[:, 10:])
    page.ask("look", columns=(), fields=(), flows=(), planned=())
    page.until(lambda: len(paths(page)[1].get("forager/id", ())) == 40)
    page.ask("look", columns=(), fields=(), flows=())
    page.until(lambda: paths(page)[0]["count"] == 0)
    assert not live.look_ahead.frames


def test_who_plays_comes_upon_what_was_planned(live: LiveSimulation) -> None:
    page = Page(live)
    page.ask("look", columns=(), fields=(), flows=(), planned=({"species": "forager", "agent": 0},))
    page.until(lambda: "paths" in page.make_packets and paths(page)[0]["count"] == 49)
    planned = paths(page)[1]["forager/path"].reshape(49, 3)
    page.ask("speed", times=0.0)
    page.ask("play")
    page.until(lambda: page.frames[-1][0] > 30)
    page.ask("pause")
    page.until(lambda: paths(page)[0]["frame"] > 30 and paths(page)[0]["count"] == 49)
    header, arrays = paths(page)
    assert np.array_equal(arrays["forager/path"].reshape(49, 3)[: 50 - header["frame"]], planned[header["frame"] - 1 :])


def test_of_too_many_at_once_nothing_is_simulated(live: LiveSimulation, monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.preview.viewing import page_screen
    from antdsl.preview.viewing import path_packets as viewing

    monkeypatch.setattr(viewing, "MAX_PLANNED_AGENTS", 39)
    monkeypatch.setattr(page_screen, "MAX_PLANNED_AGENTS", 39)
    page = Page(live)
    page.ask("look", columns=(), fields=(), flows=(), planned=())
    page.ask("step", count=2)
    page.frame_arrays(3)
    assert paths(page)[0]["count"] == 0 and not live.look_ahead.frames


def test_the_page_has_the_same_bounds() -> None:
    protocol = (Path(ahead_module.__file__).parent / "web" / "src" / "protocol.ts").read_text()
    assert f"MOST_PLANNED = {{ chosen: 60, all: {MAX_PLANNED_AGENTS} }}" in protocol
    assert SetDisplay.model_fields["planned"].metadata[0].max_length >= 60


def test_asks_are_heard_between_two_frames(live: LiveSimulation, monkeypatch: pytest.MonkeyPatch) -> None:
    waiting = []
    page = Page(live)
    page.frame_arrays(1)

    def slowly(world: World, step: Callable[[World], None] = ahead_module.step) -> None:
        if len(waiting) < 5:
            page.ask("speed", times=1.0 + len(waiting))
        waiting.append(len(live._queue))
        step(world)

    monkeypatch.setattr(ahead_module, "step", slowly)
    page.ask("look", columns=(), fields=(), flows=(), planned=({"species": "forager", "agent": 3},))
    page.until(lambda: "paths" in page.make_packets and paths(page)[0]["count"] == 49)
    assert max(waiting) == 1, "never is a second one waiting: the first was heard before the next frame"
    assert page.last("status")["speed"] == 5.0


def test_paths_end_where_a_step_cannot_be_made(session: PreviewSession, monkeypatch: pytest.MonkeyPatch) -> None:
    def stops(world: World, step: Callable[[World], None] = ahead_module.step) -> None:
        if world.frame >= 5:
            raise LimitStop(Fault(world.frame, "forager", -1, "neighbours", None, (), "too many"))
        step(world)

    monkeypatch.setattr(ahead_module, "step", stops)
    ahead = LookAheadSimulation()
    for _ in range(20):
        if ahead.needs_simulation(session):
            ahead.simulate_next_frame(session)
    assert list(ahead.frames) == [1, 2, 3, 4, 5] and not ahead.needs_simulation(session)
