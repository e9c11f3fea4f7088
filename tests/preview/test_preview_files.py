"""What becomes of files in a preview: missing ones that come, edits that are undone, things that go, names that are no text."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from live_client import EXAMPLES, Page

from antdsl.preview import LiveSimulation, PreviewSession
from antdsl.preview.binary_packets import unpack_arrays


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the walkers, with a stone in their way, in a scene that extends another."""
    shutil.copytree(EXAMPLES / "minimal", tmp_path / "walkers")
    shutil.copy(EXAMPLES / "moods" / "stones.ply", tmp_path / "walkers")
    folder = tmp_path / "walkers"
    edit(folder / "walker.ant", "surface ground", "surface ground; obstacle stones")
    edit(folder / "scene.yaml", "{mesh: ground.ply}", "{mesh: ground.ply}\n  stones: {mesh: stones.ply}")
    (folder / "scene.yaml").rename(folder / "base.yaml")
    (folder / "scene.yaml").write_text("antdsl: 1\nextends: base.yaml\n")
    return folder


@pytest.fixture
def open_lives() -> Iterator[list[LiveSimulation]]:
    lives: list[LiveSimulation] = []
    yield lives
    for each in lives:
        each.stop()


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def started(open_lives: list[LiveSimulation], scene: Path) -> Page:
    open_lives.append(LiveSimulation.open_scene(scene))
    open_lives[-1].start()
    return Page(open_lives[-1])


def sparse(path: Path) -> None:
    """A file of 20 GB that takes no room on the disk."""
    with open(path, "wb") as file:
        file.truncate(20 * 10**9)


NO_FILES: dict[str, Callable[[Path], None]] = {
    "pipe": lambda path: os.mkfifo(path),
    "endless device": lambda path: path.symlink_to("/dev/zero"),
    "sparse": sparse,
}


@pytest.mark.skipif(os.name == "nt", reason="no such files there")
@pytest.mark.parametrize("kind", NO_FILES)
@pytest.mark.parametrize("name", ["scene.yaml", "base.yaml", "walker.ant", "ground.ply"])
def test_it_waits_for_a_file_where_something_else_is_and_goes_on_by_itself(
    folder: Path, open_lives: list[LiveSimulation], name: str, kind: str
) -> None:
    good = (folder / name).read_bytes()
    (folder / name).unlink()
    NO_FILES[kind](folder / name)
    page = started(open_lives, folder / "scene.yaml")
    assert page.until(lambda: page.last("problems"))["problems"]
    (folder / name).unlink()
    (folder / name).write_bytes(good)
    page.status(frame=1, agents=50)
    page.ask("step", count=2)
    page.status(frame=3)
    (folder / name).unlink()
    NO_FILES[kind](folder / name)
    assert not page.until(lambda: page.last("outcome"))["ok"]
    page.ask("step", count=2)
    page.status(frame=5)  # the last good program runs on
    (folder / name).unlink()
    (folder / name).write_bytes(good)
    page.until(lambda: page.last("outcome")["ok"])
    page.ask("step", count=1)
    page.status(frame=6)


def test_a_page_is_not_shown_what_a_link_in_the_scenes_folder_leads_to(
    folder: Path, open_lives: list[LiveSimulation], tmp_path: Path
) -> None:
    (tmp_path / "secret.ant").write_text("ant 1 # nobody's business\n")
    (folder / "walker.ant").unlink()
    (folder / "walker.ant").symlink_to(tmp_path / "secret.ant")
    page = started(open_lives, folder / "scene.yaml")
    assert "link" in page.until(lambda: page.last("problems"))["problems"][0]["message"]
    page.until(lambda: page.last("texts"))
    assert "nobody's business" not in str(page.told)


@pytest.mark.parametrize("name", ["base.yaml", "walker.ant", "ground.ply"])
@pytest.mark.parametrize("broken", [False, True])
def test_it_opens_once_a_file_is_mended_or_comes(folder: Path, open_lives: list[LiveSimulation], name: str, broken: bool) -> None:
    good = (folder / name).read_bytes()
    if broken:
        (folder / name).write_text("{")
    else:
        (folder / name).unlink()
    page = started(open_lives, folder / "scene.yaml")
    assert page.until(lambda: page.last("problems"))["problems"]
    (folder / name).write_bytes(good)
    page.status(frame=1, agents=50)


def test_a_file_that_an_edit_names_may_come_later(folder: Path, open_lives: list[LiveSimulation]) -> None:
    page = started(open_lives, folder / "scene.yaml")
    page.status(frame=1)
    edit(folder / "base.yaml", "ground.ply", "soil.ply")
    assert not page.until(lambda: page.last("outcome"))["ok"]
    shutil.copy(folder / "ground.ply", folder / "soil.ply")
    page.until(lambda: page.last("outcome")["ok"])


def test_an_edit_that_is_undone_at_an_earlier_frame_does_not_come_back(folder: Path) -> None:
    session, _ = PreviewSession.open(folder / "scene.yaml")
    assert session is not None
    for _ in range(10):
        session.step()
    edit(folder / "walker.ant", "30 mm/s", "60 mm/s")
    assert session.reload().is_successful
    session.step()
    session.seek(5)
    edit(folder / "walker.ant", "60 mm/s", "30 mm/s")
    assert session.reload().line.startswith("the files are again as they were")
    fresh, _ = PreviewSession.open(folder / "scene.yaml")
    assert fresh is not None
    for _ in range(14):
        fresh.step()
    while session.frame < fresh.frame:
        session.step()
    assert session.state_hash == fresh.state_hash
    assert session.reload().line == "nothing has changed"


def test_what_is_set_by_hand_ahead_is_no_edit_of_files(folder: Path) -> None:
    session, _ = PreviewSession.open(EXAMPLES / "foraging" / "scene.yaml")
    assert session is not None
    session.step()
    assert session.switch_field("trail", is_on=False).is_successful
    session.step()
    session.seek(1)
    assert session.reload().line == "nothing has changed"
    assert session.last_frame == 3


def test_a_mesh_that_is_gone_is_taken_away(folder: Path, open_lives: list[LiveSimulation]) -> None:
    page = started(open_lives, folder / "scene.yaml")
    page.until(lambda: "mesh:stones" in page.make_packets)
    stones = unpack_arrays(page.make_packets["mesh:stones"])[1]
    edit(folder / "walker.ant", "; obstacle stones", "")
    edit(folder / "base.yaml", "\n  stones: {mesh: stones.ply}", "")
    page.until(lambda: not len(unpack_arrays(page.make_packets["mesh:stones"])[1]["face"]))
    later = Page(open_lives[0])
    later.until(lambda: "mesh:ground" in later.make_packets and "frame" in later.make_packets)
    assert "mesh:stones" not in later.make_packets or not len(unpack_arrays(later.make_packets["mesh:stones"])[1]["face"])
    page.ask("seek", frame=1, exact=True)
    edit(folder / "walker.ant", "surface ground", "surface ground; obstacle stones")
    edit(folder / "base.yaml", "{mesh: ground.ply}", "{mesh: ground.ply}\n  stones: {mesh: stones.ply}")
    page.until(lambda: len(unpack_arrays(page.make_packets["mesh:stones"])[1]["face"]))
    again = unpack_arrays(page.make_packets["mesh:stones"])[1]
    assert (again["position"] == stones["position"]).all()


@pytest.mark.skipif(os.name == "nt", reason="names are text there")
def test_a_name_that_is_not_text_is_shown_as_closely_as_possible(folder: Path, open_lives: list[LiveSimulation]) -> None:
    odd = Path(os.fsdecode(os.fsencode(folder) + b"/sc\xffne.yaml"))
    try:
        (folder / "scene.yaml").rename(odd)
    except OSError:
        pytest.skip("this disk has no such names")
    page = started(open_lives, odd)
    page.status(frame=1)
    assert [each["message"] for each in page.told if each["op"] == "refused"] == []
    assert page.last("scene")["name"] == "sc?ne.yaml"
    assert "\\udc" not in ascii(page.told)


def test_a_fault_tells_the_page_no_path_of_this_machine(folder: Path, open_lives: list[LiveSimulation]) -> None:
    edit(folder / "walker.ant", "max_speed 30 mm/s", "max_speed 30 mm/s\n  load = 0")
    edit(folder / "walker.ant", "wander()", "wander() * (1 / load)")
    page = started(open_lives, folder / "scene.yaml")
    page.ask("step", count=3)
    fault = page.until(lambda: (page.last("status") or {}).get("fault"))
    assert fault.startswith("walker.ant:") and "not finite" in fault
    assert str(folder) not in str([each for each in page.told if each["op"] == "status"])


def test_a_missing_scene_is_reported_by_its_name(folder: Path, open_lives: list[LiveSimulation]) -> None:
    page = started(open_lives, folder / "scene.yaml")
    page.status(frame=1)
    (folder / "scene.yaml").unlink()
    [problem] = page.until(lambda: page.last("outcome"))["problems"]
    assert problem["message"] == "there is no file `scene.yaml`"
    page.until(lambda: page.last("problems")["problems"] == [problem])
