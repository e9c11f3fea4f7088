"""The panel Direct in a browser: an agent that is selected gets a note, stands, and the copied line does the same in a scene."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import meshes
import numpy as np
import pytest
from browsing import chromium
from commands import run
from directed import follow, open_directed, write_mesh
from page_messages import directed, frame, notes, scene, status, texts, verbs
from page_stage import stage
from preview_page import opened, previewed

from antdsl.outputs.edits.edited_cache import open_edited_cache

if TYPE_CHECKING:
    from playwright.sync_api import Browser

FRAME, AGENT, LAST = 31, 17, 40


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as chromium_browser:
        yield chromium_browser


@pytest.mark.slow
def test_a_selected_agent_is_held_and_the_copied_lines_work_in_a_scene(browser: Browser, tmp_path: Path) -> None:
    open_directed(tmp_path / "shown", count=30)
    permissions = ["clipboard-read", "clipboard-write"]
    with previewed(tmp_path / "shown" / "scene.yaml") as address, opened(browser, address, permissions=permissions) as preview:
        page = preview.page
        for frame in range(11, FRAME + 1, 10):
            page.keyboard.press("Shift+ArrowRight")
            preview.until("a.frame >= it", 30, frame)
        preview.press("side-tab-direct")
        assert preview.find("direct-hint").is_visible() and preview.find("direct-apply").is_disabled()
        x, y = preview.now("screen", "ant", AGENT)
        box = page.locator("#view canvas").bounding_box()
        page.mouse.click(box["x"] + x, box["y"] + y)
        agents = preview.find("direct-agents")
        agents.wait_for()
        assert preview.find("panel-direct").is_visible(), "the selection keeps the panel"
        selected = agents.input_value()
        assert selected.startswith("guards.")
        assert preview.find("direct-key-frames").input_value() == f"{FRAME}..80"  # from the current frame onwards
        preview.find("direct-key-ease").fill("six")
        preview.find("direct-wrong-ease").get_by_text("is not a whole number").wait_for(timeout=60_000)
        assert preview.find("direct-apply").is_disabled()
        preview.find("direct-key-ease").fill("4")
        preview.press("direct-pick-look_at")
        x, y = page.evaluate(f"() => {CLICKED}")
        page.mouse.click(box["x"] + x, box["y"] + y)
        preview.page.wait_for_function(
            "() => document.querySelector('[data-test=direct-key-look_at]').value.startsWith('{head: ')"
        )
        page.wait_for_function("() => !document.querySelector('[data-test=direct-copy]').disabled", timeout=60_000)
        preview.press("direct-apply")
        preview.find("note-line").wait_for(timeout=60_000)
        preview.until("a.frame === it && a.still", 30, FRAME)
        line = preview.find("note-line").text_content() or ""
        assert line.startswith(f"{{hold: {selected}, frames: {FRAME}..80, look_at: {{head: ")
        number = int(selected.removeprefix("guards."))
        place = preview.now("position", "ant", number)
        for _ in range(LAST - FRAME):
            page.keyboard.press("ArrowRight")
            page.wait_for_timeout(60)
        preview.until("a.frame >= it && a.still", 30, FRAME + 2)
        assert preview.now("position", "ant", number) == place, "it stands"
        preview.press("notes-copy")
        copied = page.evaluate("navigator.clipboard.readText()")
        assert copied == f"notes:\n  - {line}\n"
        preview.press("note-on")
        page.wait_for_function(
            "() => document.querySelector('[data-test=outcome]').textContent.includes('is off')", timeout=60_000
        )
        preview.press("note-remove")
        preview.find("notes").wait_for(state="hidden", timeout=60_000)
    shot = open_directed(tmp_path / "written", copied.removeprefix("notes:\n  - ").strip(), count=30)
    track = follow(shot, LAST)
    frames = np.array(track.frames)
    assert np.abs(track.of("velocity", number)[frames >= FRAME]).max() == 0
    assert np.allclose(track.of("position", number)[frames == FRAME][0], place, atol=1e-3)


def test_edits_are_shown_at_once_and_the_copied_lines_work_with_a_cache(browser: Browser, tmp_path: Path) -> None:
    open_directed(tmp_path, count=30, last=12)
    permissions = ["clipboard-read", "clipboard-write"]
    with previewed(tmp_path / "scene.yaml") as address, opened(browser, address, permissions=permissions) as preview:
        page = preview.page
        page.set_viewport_size({"width": 1280, "height": 720})
        page.keyboard.press("Shift+ArrowRight")
        preview.until("a.frame === it && a.still", 30, 11)
        place = preview.now("position", "ant", 3)
        preview.press("side-tab-direct")
        preview.find("direct-list-edits").check()
        preview.find("direct-agents").fill("guards.3")
        for verb, key, value in (("move", "by", "[0, 0, 30 mm]"), ("duplicate", "by", "[0, 0, 20 mm]")):
            preview.find("direct-verb").select_option(verb)
            preview.find(f"direct-key-{key}").fill(value)
            page.locator("[data-test=direct-apply]:enabled").click()
            page.get_by_text(f"edit `{{{verb}: guards.3, {key}: {value}}}`").wait_for(timeout=60_000)
        page.wait_for_timeout(500)
        preview.until("a.frame === it && a.still", 30, 11)
        moved, copied_agent = (preview.now("position", "ant", agent) for agent in (3, 33))
        assert abs(moved[2] - place[2]) > 20 and abs(copied_agent[2] - moved[2]) > 10
        assert preview.now("frame") == 11 and preview.find("direct-key-frames").input_value() == ""
        preview.press("edits-copy")
        copied = page.evaluate("navigator.clipboard.readText()")
        preview.find("edits").get_by_test_id("note-on").first.uncheck()
        page.get_by_text("is off").first.wait_for(timeout=60_000)
        page.wait_for_timeout(500)
        preview.until("a.frame === it && a.still", 30, 11)
        assert preview.now("position", "ant", 3) == place
        for _ in range(2):
            preview.find("edits").get_by_test_id("note-remove").first.click()
            page.wait_for_timeout(500)
        assert preview.find("edits").is_hidden()
    (tmp_path / "edits.yaml").write_text(copied)
    assert run("run", "scene.yaml", "--out", "cache", "--quiet", cwd=tmp_path).returncode == 0
    assert run("edit", "cache", "--edits", "edits.yaml", cwd=tmp_path).returncode == 0
    arrays = open_edited_cache(tmp_path / "cache").frame(11)
    assert arrays["id"][-1] == 33 and np.allclose(arrays["P"][3], moved, atol=1e-3)
    assert np.allclose(arrays["P"][-1], copied_agent, atol=1e-3)


@pytest.mark.slow
def test_caches_are_merged_agents_stand_on_a_drawn_mesh_and_frames_are_settled(browser: Browser, tmp_path: Path) -> None:
    open_directed(tmp_path, count=30, last=12)
    vertices, faces = meshes.terrain(300.0, 24)
    write_mesh(tmp_path / "high.obj", np.add(vertices, [0, 40, 0]), faces)
    assert run("run", "scene.yaml", "--out", "cache", "--quiet", cwd=tmp_path).returncode == 0
    with previewed(tmp_path / "scene.yaml") as address, opened(browser, address) as preview:
        page = preview.page
        page.keyboard.press("Shift+ArrowRight")
        preview.until("a.frame === it && a.still", 30, 11)
        preview.press("side-tab-direct")
        preview.find("direct-list-edits").check()
        preview.find("direct-verb").select_option("merge")
        preview.find("direct-agents").fill("cache")
        page.locator("[data-test=direct-apply]:enabled").click()
        page.get_by_text("edit `{merge: cache}`").wait_for(timeout=60_000)
        preview.find("direct-verb").select_option("drop")
        preview.find("direct-agents").fill("ant.0..9")
        preview.find("direct-key-onto").fill("high.obj")
        page.locator("[data-test=direct-apply]:enabled").click()
        page.get_by_text("edit `{drop: ant.0..9, onto: high.obj}`").wait_for(timeout=60_000)
        page.wait_for_timeout(500)
        preview.until("a.frame === it && a.still", 30, 11)
        assert preview.now("position", "ant", 3)[1] > 25 and len(preview.now("position", "ant", 33)) == 3
        preview.press("settle")
        page.locator("[data-test=settle-report]", has_text="settled").wait_for(timeout=60_000)
        report = preview.find("settle-report").inner_text()
        assert report.startswith("settled ") and "from the checkpoint of frame 1" in report
        page.screenshot(path=tmp_path / "settled.png")


def test_an_edit_is_written_checked_and_listed(browser: Browser) -> None:
    with stage(browser) as page:
        page.tell(scene(), texts(), status(), verbs(), notes(), notes(op="edits"), frame([0, 1, 0]))
        page.find("side-tab-direct").click()
        page.find("direct-agents").fill("guards")
        page.find("direct-list-edits").check()
        page.find("direct-verb").select_option("kill")
        page.page.wait_for_timeout(400)
        draft = {"op": "direct", "list": "edits", "verb": "kill", "agents": "guards", "values": {}, "apply": False}
        assert page.requests_of("direct")[-1] == draft
        page.tell(directed("{hold: guards}"))  # of a note, which comes late
        assert page.find("direct-line").inner_text() == ""
        page.tell(directed("{kill: guards}", listed="edits"))
        page.find("direct-apply").click()
        assert page.requests_of("direct")[-1] == {**draft, "apply": True}
        page.tell(notes("{kill: guards}", "{move: guards}", op="edits", problem="no `guards`"))
        assert page.find("side-tab-direct").inner_text() == "Direct2"
        assert page.find("panel-direct").get_by_text("switched off: no `guards`").is_visible()
        page.find("edits-copy").click()
        page.find("edits-copy").get_by_text("Copied").wait_for()
        assert page.page.evaluate("navigator.clipboard.readText()") == "edits:\n  - {kill: guards}\n"
        page.find("note-on").first.uncheck()
        page.find("note-remove").last.click()
        answers = [(each["list"], each["key"], each["action"]) for each in page.requests_of("line")]
        assert answers == [("edits", 0, "off"), ("edits", 1, "remove")]
        page.find("direct-verb").select_option("offset")
        page.tell(directed("{offset: guards}", ("joint", "missing"), listed="edits", joint=["neck", "head"]))
        page.find("direct-choices-joint").locator("option").nth(1).wait_for(state="attached")
        choices = page.find("direct-choices-joint").locator("option").evaluate_all("all => all.map((each) => each.value)")
        assert choices == ["neck", "head"] and page.find("direct-key-joint").get_attribute("list")


def test_a_cache_is_named_for_a_merge_and_settling_is_started_stopped_and_reported(browser: Browser) -> None:
    with stage(browser) as page:
        page.tell(scene(), texts(), status(), verbs(), notes(op="edits"), frame([0, 1, 0]))
        page.find("side-tab-direct").click()
        page.find("direct-list-edits").check()
        page.find("direct-agents").fill("guards")
        page.find("direct-verb").select_option("merge")
        field = page.find("direct-agents")
        assert field.input_value() == "" and field.get_attribute("placeholder") == "other_cache"
        assert page.find("panel-direct").get_by_text("Cache", exact=True).is_visible()
        choices = page.find("direct-choices-agents").locator("option").evaluate_all("all => all.map((each) => each.value)")
        assert choices == ["other_cache"]
        field.fill("other_cache")
        page.page.wait_for_timeout(400)
        draft = {"op": "direct", "list": "edits", "verb": "merge", "agents": "other_cache", "values": {}, "apply": False}
        assert page.requests_of("direct")[-1] == draft
        page.find("direct-verb").select_option("kill")
        assert field.input_value() == "guards"
        page.tell(notes("{kill: guards}", op="edits", settling={"running": False, "settled": False, "report": []}))
        assert page.find("settle").inner_text() == "Settle" and page.find("settle-report").is_hidden()
        page.find("settle").click()
        page.tell(
            notes("{kill: guards}", op="edits", settling={"running": True, "settled": False, "report": ["settling: frame 3"]})
        )
        assert page.find("settle-report").inner_text() == "settling: frame 3"
        page.find("settle").get_by_text("Stop settling").click()
        report = ["settled 2 agents", "warning: 1 pair of agents overlaps"]
        page.tell(notes("{kill: guards}", op="edits", settling={"running": False, "settled": True, "report": report}))
        assert page.find("settle-report").inner_text() == "\n".join(report)
        page.find("settle").get_by_text("Remove settling").click()
        page.tell(notes("{kill: guards}", op="edits", problem="off", settling={"running": False, "settled": False, "report": []}))
        assert page.find("settle").is_disabled()
        assert [each["on"] for each in page.requests_of("settle")] == [True, False, False]


def test_what_is_written_is_checked_applied_and_listed(browser: Browser) -> None:
    with stage(browser) as page:
        page.tell(scene(), texts(), status(), verbs(), notes(), frame([0, 1, 0]))
        page.find("side-tab-direct").click()
        page.find("direct-agents").fill("guards")
        page.find("direct-verb").select_option("attract")
        page.find("direct-key-to").fill("leaf")
        page.page.wait_for_timeout(400)
        values = {"to": "leaf", "frames": "20..240"}
        draft = {"op": "direct", "list": "notes", "verb": "attract", "agents": "guards", "values": values, "apply": False}
        assert page.requests_of("direct")[-1] == draft
        page.tell(directed("{attract: guards, to: leaf}", ("to", "no leaf"), ("", "not this one")))
        assert page.find("direct-wrong-to").inner_text() == "no leaf" and page.find("direct-wrong").inner_text() == "not this one"
        assert page.find("direct-apply").is_disabled() and page.find("direct-copy").is_disabled()
        page.tell(directed("{attract: guards, to: leaf}"))
        assert page.find("direct-wrong-to").is_hidden() and page.find("direct-line").inner_text() == "{attract: guards, to: leaf}"
        page.find("direct-apply").click()
        assert {**draft, "apply": True} in page.requests_of("direct"), page.requests_of("direct")
        page.tell(status(21))  # frames follow the current one until one writes them
        assert page.find("direct-key-frames").input_value() == "21..240"
        page.find("direct-key-frames").fill("5..9")
        page.tell(status(22), notes("{hold: guards}", "{look: guards}", problem="no `leaf`"))
        assert page.find("direct-key-frames").input_value() == "5..9"
        assert page.find("panel-direct").get_by_text("switched off: no `leaf`").is_visible()
        page.find("notes-copy").click()
        page.find("notes-copy").get_by_text("Copied").wait_for()
        assert page.page.evaluate("navigator.clipboard.readText()") == "notes:\n  - {hold: guards}\n"
        page.find("note-on").first.uncheck()
        page.find("note-remove").last.click()
        assert [(each["key"], each["action"]) for each in page.requests_of("line")] == [(0, "off"), (1, "remove")]


CLICKED = "[document.querySelector('#view').clientWidth / 2, document.querySelector('#view').clientHeight * 0.6]"
