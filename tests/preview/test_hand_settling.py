"""Settling in the preview: pages show what `antdsl edit --settle` makes of the same edits, and never wait for it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import edit_scenes
import numpy as np
import pytest
import settling_scene
from live_client import Message, Page, agent_positions

from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.edits.edited_cache import open_edited_cache
from antdsl.preview import LiveSimulation
from antdsl.runtime import Options

LAST, COUNT = 30, 24


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, and a cache of its frames next to it."""
    folder = tmp_path_factory.mktemp("settled")
    settling_scene.simulate(folder, count=COUNT, last=LAST)
    return folder


@pytest.fixture
def page(original: Path, tmp_path: Path) -> Iterator[Page]:
    shutil.copytree(original, tmp_path / "shot")
    live = LiveSimulation.open_scene(tmp_path / "shot" / "scene.yaml", None, Options(feet=True), checkpoint_interval=10)
    live.start()
    opened = Page(live)
    opened.ask("step", count=LAST - 1)
    opened.hash_at(LAST)
    yield opened
    live.stop()


def put_onto(original: Path, agent: int, other: int, frame: int) -> dict[str, str]:
    """The keys of a `move` of an agent onto another one, at a frame of the original cache."""
    cache = open_cache(original / "cache")
    at = settling_scene.find_track(cache, other) - settling_scene.find_track(cache, agent)
    x, y, z = at[cache.frames().index(frame)].tolist()
    return {"by": f"[{x:.3f}, {y:.3f}, {z:.3f}]", "frames": f"{frame - 2}..{LAST}"}


def apply(page: Page, verb: str, agents: str, **values: str) -> str:
    """The line of an edit, which is applied."""
    number = len(page.told)
    page.ask("direct", list="edits", verb=verb, agents=agents, values=values, apply=True)
    answer: Message = page.until(lambda: next((m for m in page.told[number:] if m["op"] in ("directed", "refused")), None))
    assert answer["op"] == "directed" and answer["applied"], answer
    return str(answer["line"])


def settling(page: Page) -> Message:
    return (page.last("edits") or {}).get("settling", {})


def settle(page: Page) -> list[str]:
    """The report, once it is complete."""
    page.ask("settle", on=True)
    number = len(page.told)
    page.until(lambda: any(m["op"] == "edits" and not m["settling"]["running"] for m in page.told[number:]))
    return page.until(lambda: not settling(page)["running"] and settling(page)["report"])


def read_frame(page: Page, frame: int) -> dict[str, np.ndarray]:
    for number in (frame - 1, frame):
        page.ask("seek", frame=number, exact=True)
        page.hash_at(number)
    return page.frame_arrays(frame)


def test_frames_are_settled_as_the_command_settles_a_cache(page: Page, original: Path, tmp_path: Path) -> None:
    line = apply(page, "move", "guards.0", **put_onto(original, 0, 5, 26))
    unsettled = agent_positions(read_frame(page, 28), "ant")
    assert settle(page) == ["settled 1 agent in frames 13 to 30, from the checkpoint of frame 10"]
    folder = tmp_path / "shot"
    (folder / "edits.yaml").write_text(f"edits: [{line}]")
    report = edit_scenes.run("edit", folder / "cache", "--edits", folder / "edits.yaml", "--settle")
    assert "settled 1 agent in frames 13 to 30" in report
    cache = open_edited_cache(folder / "cache")
    for frame in (12, 13, 20, 28, LAST):
        arrays, expected = read_frame(page, frame), cache.frame(frame)
        assert np.array_equal(agent_positions(arrays, "ant"), expected["P"]), frame
        assert np.array_equal(arrays["ant/state/main"], expected["state"])
    settled = agent_positions(read_frame(page, 28), "ant")
    assert np.flatnonzero((settled != unsettled).any(axis=1)).tolist() == [5]
    page.ask("settle", on=False)
    page.until(lambda: not settling(page)["settled"])
    assert np.array_equal(agent_positions(read_frame(page, 28), "ant"), unsettled)


def test_pages_go_on_while_frames_are_settled_and_a_change_ends_it(page: Page, original: Path) -> None:
    line = apply(page, "move", "guards.0", **put_onto(original, 0, 5, 26))
    page.ask("settle", on=True)
    page.until(lambda: settling(page).get("running"))
    read_frame(page, 9)  # an answer comes meanwhile
    number = len(page.told)
    page.ask("line", list="edits", key=0, action="off")
    page.until(lambda: not settling(page)["running"])
    assert "settle again" in settling(page)["report"][0] and not settling(page)["settled"]
    page.ask("settle", on=True)
    refused = page.until(lambda: next((m for m in page.told[number:] if m["op"] == "refused"), None))
    assert refused["message"] == "there are no edits to settle" and line.startswith("{move: guards.0")


def test_the_report_says_what_is_left_and_a_later_edit_removes_the_result(page: Page, original: Path) -> None:
    apply(page, "scale", "guards.1", by="101 %")
    assert settle(page) == ["nothing to settle: after the edits, no agents overlap, and none has lost a neighbour"]
    apply(page, "move", "guards.0", **put_onto(original, 0, 5, 26))
    page.until(lambda: "settle again" in settling(page)["report"][0])
    assert "settled 1 agent" in settle(page)[0] and settling(page)["settled"]
    apply(page, "kill", "guards.9")
    page.until(lambda: not settling(page)["settled"])
    assert "settle again" in settling(page)["report"][0]


def test_frames_of_another_program_are_not_settled(page: Page, original: Path) -> None:
    apply(page, "move", "guards.0", **put_onto(original, 0, 5, 20))
    page.ask("seek", frame=26, exact=True)
    page.hash_at(26)
    program = page.live.compiler.scene.with_name("a.ant")
    program.write_text(program.read_text().replace("24 mm/s", "25 mm/s"))
    page.until(lambda: (page.last("outcome") or {}).get("of") in ("saved", "reload"))
    page.ask("step", count=2)
    page.hash_at(28)
    report = settle(page)
    assert report[0].startswith("not settled: edits affect agents from frame") and "first frame" in report[1]
