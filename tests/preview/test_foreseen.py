"""A reload that was compiled ahead of time: taken as it is while nothing has changed since, and never otherwise."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from preview_page import few

from antdsl.preview import PreviewSession, compiling

FORAGING = Path(__file__).parents[2] / "examples" / "foraging"


@pytest.fixture
def session(tmp_path: Path) -> PreviewSession:
    """Forty foraging ants; the scene extends one that has the meshes."""
    scene = few(tmp_path, 40).with_name("shot.yaml")
    scene.write_text("antdsl: 1\nextends: scene.yaml\nseed: 3\n")
    session, report = PreviewSession.open(scene)
    assert session is not None, [d.message for d in report.errors]
    return session


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Grows by one for each time that a scene is compiled."""
    calls: list[int] = []
    opened = compiling.open_scene

    def counted(*words: object, **named: object) -> object:
        calls.append(1)
        return opened(*words, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(compiling, "open_scene", counted)
    return calls


def edit(session: PreviewSession, name: str, old: str, new: str) -> None:
    file = session.compiler.scene.with_name(name)
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def pace(session: PreviewSession) -> float:
    return float(session.world.populations["forager"].now["max_speed"][0])


def test_a_reload_finds_its_shot_made(session: PreviewSession, compiled: list[int]) -> None:
    session.step()
    initial_shot, hash_ = session.shot, session.state_hash
    edit(session, "forager.ant", "30 mm/s", "36 mm/s")
    session.precompile()
    assert session.shot is initial_shot and session.state_hash == hash_ and not session.is_edited
    outcome = session.reload()
    assert outcome.is_successful and len(compiled) == 1 and pace(session) == 36
    session.step()
    assert session.reload().line == "nothing has changed" and len(compiled) == 2, "it is made use of once"


CHANGES: dict[str, Callable[[PreviewSession], None]] = {
    "the program": lambda s: edit(s, "forager.ant", "36 mm/s", "38 mm/s"),
    "the scene": lambda s: edit(s, "shot.yaml", "seed: 3", "seed: 4"),
    "a scene that it extends": lambda s: edit(s, "scene.yaml", "count: 40", "count: 41"),
    "a mesh": lambda s: s.compiler.scene.with_name("stones.ply").write_bytes((FORAGING / "boulder.ply").read_bytes()),
    "a value set by hand": lambda s: s.set_value("forager.smell", "60 mm"),
}


@pytest.mark.parametrize("what", CHANGES)
def test_later_changes_are_compiled_again(session: PreviewSession, compiled: list[int], what: str) -> None:
    edit(session, "forager.ant", "30 mm/s", "36 mm/s")
    session.precompile()
    CHANGES[what](session)
    outcome = session.reload()
    assert outcome.is_successful, [d.message for d in outcome.report.errors]
    assert len(compiled) == 2
    assert pace(session) == (38 if what == "the program" else 36)
    assert session.shot.setting.seed == (4 if what == "the scene" else 3)
    assert len(session.world) == (41 if what == "a scene that it extends" else 40)


def test_a_mesh_that_is_gone_by_then_is_complained_about(session: PreviewSession) -> None:
    edit(session, "forager.ant", "30 mm/s", "36 mm/s")
    session.precompile()
    session.compiler.scene.with_name("stones.ply").unlink()
    assert [d.code for d in session.reload().report.errors] == ["no-such-file"]
    assert pace(session) == 30


def test_a_file_that_is_half_written_is_no_reason_to_do_anything(session: PreviewSession, compiled: list[int]) -> None:
    program = session.compiler.scene.with_name("forager.ant")
    program_text = program.read_text().replace("30 mm/s", "36 mm/s")
    program.write_text(program_text[: len(program_text) // 2])
    initial_hash = session.state_hash
    session.precompile()
    assert session.state_hash == initial_hash
    program.write_text(program_text)
    assert session.reload().is_successful and len(compiled) == 2 and pace(session) == 36


def test_layers_that_are_off_stay_off(session: PreviewSession, compiled: list[int]) -> None:
    layer = session.shot.plan.species["forager"].layers[0].span.text
    assert session.switch_layer("forager", layer, is_on=False).is_successful
    edit(session, "forager.ant", "30 mm/s", "36 mm/s")
    session.precompile()
    assert session.reload().is_successful and len(compiled) == 2
    assert session.shot.plan.species["forager"].layers[0].span.text != layer
    assert pace(session) == 36


def test_the_run_is_the_same_as_without(session: PreviewSession, tmp_path: Path) -> None:
    shutil.copytree(tmp_path / "foraging", tmp_path / "other")
    other, _ = PreviewSession.open(tmp_path / "other" / "shot.yaml")
    assert other is not None
    for each in (session, other):
        for _ in range(3):
            each.step()
        edit(each, "forager.ant", "steer wander(swing: swing)", "steer wander(swing: 0.5 * swing)")
        if each is session:
            each.precompile()
        assert each.reload().is_successful
        for _ in range(3):
            each.step()
    assert session.state_hash == other.state_hash
