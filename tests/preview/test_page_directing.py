"""The panel Direct in a browser: an agent that is selected gets a note, stands, and the copied line does the same in a scene."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from browsing import chromium
from directed import follow, open_directed
from preview_page import opened, previewed

if TYPE_CHECKING:
    from playwright.sync_api import Browser

FRAME, AGENT, LAST = 31, 17, 40


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as chromium_browser:
        yield chromium_browser


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


CLICKED = "[document.querySelector('#view').clientWidth / 2, document.querySelector('#view').clientHeight * 0.6]"
