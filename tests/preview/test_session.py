"""A scene with its history: going back gives the same bits, edits begin branches, and a clean run is what a fresh run gives."""

from __future__ import annotations

from pathlib import Path

import pytest
from preview_page import few

from antdsl.pipeline import open_scene, simulate
from antdsl.preview import PreviewSession
from antdsl.runtime import state_hash


@pytest.fixture
def shot(tmp_path: Path) -> Path:
    """A copy of the foraging ants, forty of them."""
    return few(tmp_path, 40)


def opened(scene: Path, **how: int) -> PreviewSession:
    session, report = PreviewSession.open(scene, **how)
    assert session is not None, [d.message for d in report.errors]
    return session


def go(session: PreviewSession, frames: int, hashes: dict[int, str] | None = None) -> dict[int, str]:
    """Step, and note the hash of each frame."""
    hashes = {} if hashes is None else hashes
    hashes[session.frame] = session.state_hash
    for _ in range(frames):
        session.step()
        hashes[session.frame] = session.state_hash
    return hashes


def edit(scene: Path, old: str, new: str) -> None:
    program = scene.with_name("forager.ant")
    text = program.read_text()
    assert old in text
    program.write_text(text.replace(old, new))


def fresh(scene: Path, session: PreviewSession) -> str:
    """The hash of the session's frame in a run of the files and choices as they are."""
    shot, report = open_scene(scene, session.choices)
    assert shot is not None, [d.message for d in report.errors]
    return next(state_hash(world) for world in simulate(shot) if world.frame == session.frame)


def test_every_frame_can_be_gone_back_to(shot: Path) -> None:
    session = opened(shot, checkpoint_interval=7)
    hashes = go(session, 20)
    for frame in (3, 20, 8, 1, 21, 14):
        session.seek(frame)
        assert (session.frame, session.state_hash) == (frame, hashes[frame])
    assert not session.is_edited
    with pytest.raises(ValueError, match="frame 22 is not among those stored, 1 to 21"):
        session.seek(22)
    session.seek(5)
    session.step()
    assert session.state_hash == hashes[6]
    assert session.last_frame == 21


def test_going_back_crosses_edits(shot: Path) -> None:
    session = opened(shot, checkpoint_interval=5)
    old_hashes = go(session, 12)
    edit(shot, "30 mm/s", "45 mm/s")
    outcome = session.reload()
    assert outcome.line == "kept 40 agents · `max_speed` has its new value"
    new_hashes = go(session, 10)
    for frame in (22, 4, 13, 12, 17, 2):
        session.seek(frame)
        assert session.state_hash == (new_hashes if frame >= 13 else old_hashes)[frame]
    for frame in range(3, 20):  # and played through
        session.step()
        assert session.state_hash == (new_hashes if frame >= 13 else old_hashes)[frame]


def test_an_edit_at_an_earlier_frame_begins_a_branch(shot: Path) -> None:
    session = opened(shot, checkpoint_interval=5)
    go(session, 15)
    curves = dict(session.timeline.curves)
    session.seek(9)
    edit(shot, "30 mm/s", "45 mm/s")
    assert session.reload().is_successful
    assert (session.frame, session.last_frame, session.is_edited) == (9, 9, True)
    [branch] = session.timeline.branches
    assert branch.first == 9
    assert branch.curves == {frame: values for frame, values in curves.items() if frame > 9}
    assert session.timeline.curves[9]["forager"] == 40


def test_an_error_changes_nothing(shot: Path) -> None:
    session = opened(shot)
    go(session, 5)
    edit(shot, "steer arrive(meal)", "steer arive(meal)")
    world, state = session.world, session.state_hash
    outcome = session.reload()
    assert not outcome.is_successful
    [error] = outcome.report.errors
    assert error.span is not None and error.span.text == "arive"
    assert session.world is world
    assert session.state_hash == state
    edit(shot, "arive(meal)", "arrive(meal)")
    assert session.reload().line == "nothing has changed"


def test_a_param_changes_at_a_frame_and_is_replayed_there(shot: Path) -> None:
    session = opened(shot, checkpoint_interval=6)
    plain = go(session, 20)
    session.seek(8)
    world = session.world
    outcome = session.set_value("forager.swing", "120 deg")
    assert outcome.text == "set: {forager.swing: 120 deg}"
    assert session.world is world  # nothing was compiled, no agent was moved
    changed = go(session, 12)
    assert changed[8] == plain[8]
    assert changed[20] != plain[20]
    for frame in (20, 7, 9, 13):
        session.seek(frame)
        assert session.state_hash == (plain if frame <= 8 else changed)[frame]
    session.seek(7)
    assert "forager.swing" not in session.choices.params
    session.seek(20)
    assert session.choices.params["forager.swing"] == "120 deg"


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [
        ("forager.swing", "900 deg", "out-of-range"),
        ("forager.swing", "3 mm", "wrong-unit"),
        ("forager.swnig", "3 deg", "unknown-thing"),
        ("forager.swing", "much", "wrong-value"),
        ("trail.half_life", "0 s", "out-of-range"),
    ],
)
def test_what_cannot_be_set_is_refused(shot: Path, name: str, value: str, code: str) -> None:
    session = opened(shot)
    outcome = session.set_value(name, value)
    assert [d.code for d in outcome.report.errors] == [code]
    assert not session.is_edited


def test_an_edit_that_was_undone_leaves_a_fresh_run(shot: Path) -> None:
    session = opened(shot, checkpoint_interval=6)
    go(session, 6)
    edit(shot, "30 mm/s", "45 mm/s")
    assert session.reload().description == "forager.ant line 24"
    assert session.is_edited
    edit(shot, "45 mm/s", "30 mm/s")
    session.reload()
    assert not session.is_edited  # at the frame at which it was made
    go(session, 4)
    assert session.state_hash == fresh(shot, session) and not session.is_edited
    session.set_value("forager.swing", "120 deg")
    assert session.is_edited
    session.set_value("forager.swing", "80 deg")
    session.set_value("forager.swing", "50 deg")  # as it was
    assert not session.is_edited
    session.switch_layer("forager", "separate(radius: 1.2 * size, fov: 260 deg)", is_on=False)
    assert session.is_edited
    assert (
        session.switch_layer("forager", "separate(radius: 1.2 * size, fov: 260 deg)", is_on=True).description
        == "layer `separate(radius: 1.2 * size, fov: 260 deg)` is on again"
    )
    go(session, 3)
    assert session.state_hash == fresh(shot, session) and not session.is_edited
    session.seek(8)
    edit(shot, "30 mm/s", "45 mm/s")
    session.reload()
    go(session, 3)
    session.seek(7)
    assert session.is_edited  # the files are not what this frame was made with
    edit(shot, "45 mm/s", "30 mm/s")
    session.reload()  # and now they are again
    go(session, 6)
    assert session.state_hash == fresh(shot, session) and not session.is_edited


def test_what_was_lost_by_an_edit_does_not_come_back_by_undoing_it(shot: Path) -> None:
    session = opened(shot)
    go(session, 6)
    session.switch_field("trail", is_on=False)
    session.switch_field("trail", is_on=True)  # and starts again
    assert session.is_edited
    session.restart()
    go(session, 3)
    edit(shot, "30 mm/s", "45 mm/s")
    session.reload()
    session.step()
    edit(shot, "45 mm/s", "30 mm/s")
    session.reload()  # a frame too late
    assert session.is_edited and session.state_hash != fresh(shot, session)


def test_edits_are_described(shot: Path) -> None:
    session = opened(shot)
    go(session, 2)
    outcome = session.set_value("forager.smell", "60 mm")
    assert (outcome.description, outcome.line) == ("`forager.smell` is 60 mm", "from the next frame on")
    assert session.switch_field("trail", is_on=False).description == "field `trail` is switched off"
    session.restart()
    edit(shot, "  state search ", "  state idle gray { when after 1 s -> search }\n  state search ")
    outcome = session.reload()
    assert outcome.description.startswith("forager.ant line ") and "`idle` is a new state" in outcome.line
    edit(shot, "  state idle gray { when after 1 s -> search }\n", "")
    outcome = session.reload()
    assert (
        outcome.description.startswith("forager.ant: 1 line gone after line ") and "`idle` is no longer a state" in outcome.line
    )
    edit(shot, "ant 2\n", "ant 2\n# a comment\n")
    assert session.reload().description == "forager.ant line 2"
    scene = shot.read_text()
    shot.write_text(scene.replace("frames: 1..960", "frames: 1..30"))
    outcome = session.reload()
    assert (outcome.description, outcome.line) == ("scene.yaml line 6", "the run does not change")
    assert session.shot.frames.last == 30
    assert session.reload().line == "nothing has changed"


def test_a_run_that_is_simulated_again_is_stored_as_a_branch(shot: Path) -> None:
    session = opened(shot)
    go(session, 9)
    curves = dict(session.timeline.curves)
    session.timeline.mark_stop(4, "somebody rests")
    session.restart()
    [branch] = session.timeline.branches
    assert (branch.first, branch.reason, branch.curves) == (1, "simulated again from the first frame", curves)
    assert not session.timeline.stop_reasons


def test_a_clean_run_is_what_a_fresh_run_gives(shot: Path) -> None:
    session = opened(shot)
    go(session, 6)
    edit(shot, "30 mm/s", "45 mm/s")
    session.reload()
    session.set_value("forager.swing", "120 deg")
    session.set_value("trail.half_life", "3 s")
    go(session, 4)
    assert session.is_edited
    assert session.state_hash != fresh(shot, session)
    session.restart()
    assert not session.is_edited
    go(session, 9)
    assert session.state_hash == fresh(shot, session)


def test_the_suggested_text_has_the_same_lasting_effect(shot: Path) -> None:
    session = opened(shot)
    layer = "separate(radius: 1.2 * size, fov: 260 deg)"
    assert session.switch_layer("forager", layer, False).text == f"# {layer}"
    assert len(session.shot.plan.species["forager"].layers) == 3
    suggested_text = session.switch_field("trail", False).text
    assert suggested_text == "set: {trail.limit: 0.000001, trail.keeps: 0 %/step}"
    session.restart()
    go(session, 12)
    assert session.world.fields["trail"].amounts.max() <= 1e-6
    edit(shot, layer, f"# {layer}")
    shot.write_text(shot.read_text() + suggested_text + "\n")
    written = opened(shot)
    go(written, 12)
    assert written.state_hash == session.state_hash
    edit(shot, f"# {layer}", layer)
    session.switch_field("trail", True)
    assert session.switch_layer("forager", layer, True).is_successful
    assert len(session.shot.plan.species["forager"].layers) == 4


def test_what_was_set_by_hand_goes_with_the_param_it_was_for(shot: Path) -> None:
    session = opened(shot)
    session.set_value("forager.track", "0.01 /s")
    session.set_value("forager.swing", "120 deg")
    program = shot.with_name("forager.ant")
    program.write_text(program.read_text().replace("swing", "stray").replace("(stray: ", "(swing: "))
    outcome = session.reload()
    assert outcome.is_successful, [d.message for d in outcome.report.errors]
    assert outcome.line.endswith("`forager.swing: 120 deg` no longer fits")
    assert session.choices.params == {"forager.track": "0.01 /s"}


def test_memory_stays_in_its_budget_and_the_oldest_goes_first(shot: Path) -> None:
    session = opened(shot, checkpoint_interval=4, budget=150_000)
    hashes = go(session, 60)
    timeline = session.timeline
    array_sizes = {
        id(array): array.nbytes
        for lights in timeline.reduced_frames.values()
        for light in lights.values()
        for array in light.values()
    }
    assert timeline.reduced_frames.nbytes == sum(array_sizes.values())
    assert timeline.nbytes <= 150_000 + max(sum(a.nbytes for a in c.values()) for c in timeline.stretches[0].checkpoints.values())
    assert session.read_reduced_frame(1) is None
    assert len(timeline.curves) == 61
    session.seek(30)
    assert session.state_hash == hashes[30]


def test_reduced_frames_show_agents_without_simulating(shot: Path) -> None:
    session = opened(shot)
    go(session, 5)
    reduced_frame = session.read_reduced_frame(3)
    assert reduced_frame is not None
    session.seek(3)
    assert (reduced_frame["forager"]["position"] == session.world.populations["forager"].position.astype("f4")).all()
    assert session.read_reduced_frame(99) is None


def test_files_that_a_scene_is_made_of_are_known(shot: Path) -> None:
    session = opened(shot)
    names = {path.name for path in session.compiler.get_watched_files()}
    assert {"scene.yaml", "forager.ant", "terrain.ply", "boulder.ply", "stones.ply", "steering.ant"} <= names
    assert "many.yaml" not in names
