"""What a preview that runs for hours, or is edited again and again, keeps and forgets; and what it tells of it."""

from __future__ import annotations

import json
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from live_client import Page, agent_positions
from preview_page import few

from antdsl.preview import LiveSimulation, PreviewSession, timeline
from antdsl.preview.binary_packets import unpack_arrays
from antdsl.preview.observing.spec_judgement import SpecObserver
from antdsl.preview.viewing.action_arrays import read_stored_poses, store_poses
from antdsl.preview.viewing.curves import SentCurveTracker
from antdsl.preview.viewing.scene_message import BoundingBox


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A copy of the foraging ants, forty of them."""
    return few(tmp_path, 40)


def opened(scene: Path, **how: int) -> PreviewSession:
    session, report = PreviewSession.open(scene, **how)
    assert session is not None, [d.message for d in report.errors]
    return session


def test_full_memory_keeps_the_latest_reduced_frames_and_checkpoints_of_all_times(scene: Path) -> None:
    session = opened(scene, checkpoint_interval=2)
    one = session.timeline.nbytes
    session = opened(scene, checkpoint_interval=2, budget=10 * one)
    hashes = {}
    for _ in range(120):
        session.step()
        hashes[session.frame] = session.state_hash
    history = session.timeline
    assert history.nbytes <= history.max_bytes
    assert list(history.reduced_frames)[-20:] == list(range(102, 122))
    points = sorted(history.stretches[0].checkpoints)
    gaps = [b - a for a, b in pairwise(points)]
    assert points[0] == 1 and points[-1] >= 118 and len(points) > 5
    assert max(gaps[:-1]) <= 4 * min(gaps[:-1])
    for frame in (60, 3, 121):
        session.seek(frame)
        assert session.state_hash == hashes[frame]


def test_poses_are_stored_for_the_latest_frames_only(scene: Path) -> None:
    bare = opened(scene, checkpoint_interval=2)
    session = opened(scene, checkpoint_interval=2, budget=20 * bare.timeline.nbytes)
    for _ in range(120):
        session.step()
        store_poses(session)
    session.step()
    history = session.timeline
    assert history.nbytes <= history.max_bytes and 0 < history.poses.nbytes <= history.max_bytes / 4
    assert history.poses.nbytes == sum(
        a.nbytes for each in history.poses.values() for one in each.values() for a in one.arrays.values()
    )
    assert 5 < len(history.poses) < len(history.reduced_frames)
    assert list(history.poses) == list(range(122 - len(history.poses), 122))
    assert {"forager/plays/main", "forager/wears"} <= read_stored_poses(session, 121)["forager"].keys()


def test_curves_and_branches_do_not_grow_for_ever(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timeline, "_MAX_CURVE_FRAMES", 30)
    session, sent_curves = opened(scene, checkpoint_interval=4), SentCurveTracker()
    for number in range(12):
        for _ in range(4):
            session.step()
        session.seek(session.frame - 1)
        assert session.set_value("forager.smell", f"{50 + number} mm").is_successful
        message = sent_curves.pop_new_values(session.timeline)
        assert message is not None and message["branches"][-1]["line"] == f"set: {{forager.smell: {50 + number} mm}}"
    assert [each.reason[-7:-4] for each in session.timeline.branches] == [f" {50 + k}" for k in range(4, 12)]
    assert len(session.timeline.curves) <= 30 and session.last_frame == session.frame
    session.step()
    session.seek(session.last_frame - 5)
    initial_curves = list(session.timeline.curves)
    for _ in range(5):
        session.step()
    assert list(session.timeline.curves) == initial_curves
    for _ in range(60):
        session.step()
    session.seek(20)  # of which there is no curve any more
    assert session.set_value("forager.smell", "40 mm").is_successful and (session.frame, session.last_frame) == (20, 20)


def test_a_long_history_is_sent_in_few_points(scene: Path) -> None:
    session = opened(scene)
    one = session.timeline.curves[1]
    session.timeline.curves = {frame: one for frame in range(1, 20_001)}
    session.timeline.branches = [timeline.TimelineBranch(1, "before", dict(session.timeline.curves)) for _ in range(8)]
    assert len(json.dumps(SentCurveTracker().take_full_history(session.timeline))) < 2_000_000


def test_what_was_judged_at_an_edit_is_still_known_when_one_plays_through_it_again(scene: Path) -> None:
    session, specs = opened(scene), SpecObserver()

    def go(frames: int) -> None:
        for _ in range(frames):
            specs.before_step(session)
            session.step()
            specs.after_step(session)

    go(5)
    program = scene.with_name("forager.ant")
    program.write_text(program.read_text().replace("36 s", "35 s"))
    assert session.reload().is_successful
    go(3)
    initial_curves = {frame: dict(values) for frame, values in session.timeline.curves.items()}
    assert any(name.startswith("spec: ") for name in initial_curves[6])
    session.seek(3)
    go(6)
    assert session.timeline.curves == initial_curves


def test_a_layer_of_several_lines_becomes_as_many_comments(scene: Path) -> None:
    program = scene.with_name("forager.ant")
    program.write_text(program.read_text().replace("give_way(radius: 2.2 * size)", "give_way(\n      radius: 2.2 * size)"))
    outcome = opened(scene).switch_layer("forager", "give_way(\n      radius: 2.2 * size)", is_on=False)
    assert outcome.is_successful and outcome.text == "# give_way(\n# radius: 2.2 * size)"


def test_a_field_that_is_set_to_other_values_is_not_off(scene: Path) -> None:
    live = LiveSimulation.open_scene(scene, watch=False)
    live.start()
    page = Page(live)
    assert (
        page.ask_and_wait("set", name="trail.limit", value="0.5")["ok"]
        and page.ask_and_wait("set", name="trail.keeps", value="90 %/step")["ok"]
    )
    page.ask("step", count=1)
    page.status(frame=2)
    assert [each["on"] for each in page.last("scene")["fields"]] == [True]
    assert page.ask_and_wait("field", name="trail", on=False)["ok"]
    page.until(lambda: [each["on"] for each in page.last("scene")["fields"]] == [False])
    assert page.ask_and_wait("field", name="trail", on=True)["ok"]
    live.stop()
    assert live.session.choices.params == {"trail.limit": "0.5", "trail.keeps": "90 %/step"}, "it is as it was before"


def test_another_pace_holds_at_once(scene: Path) -> None:
    live = LiveSimulation.open_scene(scene, watch=False)
    live.start()
    page = Page(live)
    page.ask("speed", times=1e-6)
    page.status(speed=1e-6)
    page.ask("play")
    page.status(playing=True, frame=2)
    time.sleep(0.1)
    page.ask("speed", times=0)
    page.until(lambda: page.last("status")["frame"] > 5)
    live.stop()


def test_frames_of_before_an_edit_are_shown_with_the_words_of_then(scene: Path) -> None:
    """Where an edit put a state before the others, their numbers are other ones."""
    live = LiveSimulation.open_scene(scene, watch=False)
    live.start()
    page = Page(live)

    def read_states(frame: int, *, light: bool) -> tuple[list[str], set[str]]:
        """The states that the page knows, and those that it sees ants in."""
        states = page.frame_arrays(frame, light=light)["forager/state/main"]
        known = next(each for each in page.last("scene")["species"] if each["name"] == "forager")["machines"][0]["states"]
        return known, {known[state] if state < len(known) else "" for state in set(states.tolist())}

    try:
        page.ask("step", count=10)
        page.hash_at(11)
        old_states, occupied_states = read_states(11, light=False)
        program = scene.with_name("forager.ant")
        head, sign, rest = program.read_text().partition("  state ")
        program.write_text(f"{head}  state dance {{ steer wander() }}\n{sign}{rest}")
        assert page.ask_and_wait("reload")["ok"]
        page.ask("step", count=5)
        page.hash_at(16)
        assert read_states(16, light=False)[0] == ["dance", *old_states]
        page.ask("seek", frame=5, exact=False)
        assert read_states(5, light=True) == (["dance", *old_states], occupied_states)
        page.ask("seek", frame=5, exact=True)
        page.hash_at(5)
        assert read_states(5, light=False) == (old_states, occupied_states)
        page.ask("seek", frame=14, exact=False)
        assert read_states(14, light=True) == (old_states, occupied_states)
        page.ask("step", count=1)
        page.hash_at(15)
        assert read_states(15, light=False) == (["dance", *old_states], occupied_states)
    finally:
        live.stop()


def test_sliders_return_to_their_values_at_the_selected_frame(scene: Path) -> None:
    live = LiveSimulation.open_scene(scene, watch=False)
    live.start()
    page = Page(live)

    def smell() -> str:
        return next(each["value"] for each in page.last("scene")["params"] if each["name"] == "forager.smell")

    page.ask("step", count=3)
    page.hash_at(4)
    assert page.ask_and_wait("set", name="forager.smell", value="55 mm")["ok"]
    page.ask("step", count=3)
    page.hash_at(7)
    assert smell() == "55 mm"
    page.ask("seek", frame=2, exact=True)
    page.until(lambda: smell() == "40 mm")
    page.ask("seek", frame=6, exact=True)
    page.until(lambda: smell() == "55 mm")
    live.stop()


def test_the_box_about_all_stays_while_agents_fly_out_of_it(scene: Path) -> None:
    """The page looks at the whole again where the box is another one: not each time that a slider is moved."""
    session, box = opened(scene), BoundingBox()
    first = box.find_corners(session)
    ants = session.world.populations["forager"]
    ants.position[0] = 1e5
    assert box.find_corners(session) == first and BoundingBox().find_corners(session)[1] == pytest.approx([1e5] * 3)
    scene.write_text(scene.read_text().replace("mesh: boulder.ply", "mesh: boulder.ply, at: [0, 900, 0]"))
    assert session.reload().is_successful
    assert box.find_corners(session) != first


def test_each_page_learns_which_agent_each_feeler_belongs_to(scene: Path) -> None:
    live = LiveSimulation.open_scene(scene, watch=False)
    live.start()
    pages = [Page(live), Page(live)]
    for page, agent in zip(pages, (3, 7), strict=True):
        page.ask("look", columns=(), fields=(), flows=(), solids=True, follow={"species": "forager", "agent": agent})
    pages[0].ask("step", count=2)
    arrays = pages[0].frame_arrays(3)
    live.stop()
    header, _ = unpack_arrays(pages[0].make_packets["frame"])
    assert [each[:2] for each in header["felt"]] == [["forager", 3], ["forager", 7]]
    lines, at = arrays["feelers"].reshape(-1, 2, 3), 0
    for _, agent, count in header["felt"]:
        place = agent_positions(arrays, "forager")[list(arrays["forager/id"]).index(agent)]
        assert count > 0 and np.allclose(lines[at : at + count, 0], place, atol=1e-3)
        at += count
    assert at == len(lines) == len(arrays["feelers/hit"])
