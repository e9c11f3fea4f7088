"""The preview as a person uses it: a real browser, a real run, a file that is saved."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browsing import chromium
from preview_page import SIZE, PreviewPage, few, opened, previewed

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as chromium_browser:
        yield chromium_browser


def played(preview: PreviewPage, frames: int) -> int:
    """Play so many frames from here, then pause; the frame that is shown."""
    start_frame = preview.now("frame")
    if "play" in (preview.find("play").text_content() or ""):
        preview.press("play")
    preview.until("a.frame >= it", 30, start_frame + frames)
    preview.press("play")
    preview.page.wait_for_timeout(300)
    preview.until("a.still")
    return int(preview.now("frame"))


def test_the_page_comes_up_and_ants_move(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 150)
    with previewed(scene) as address, opened(browser, address) as preview:
        assert preview.now("agents") == 150
        assert "foraging" in (preview.find("scene").text_content() or "") or "scene" in (
            preview.find("scene").text_content() or ""
        )
        start_positions = {each: preview.now("position", "forager", each) for each in range(20)}
        frame = preview.now("frame")
        assert played(preview, 24) >= frame + 24
        end_positions = {each: preview.now("position", "forager", each) for each in range(20)}
        moved = [
            sum((a - b) ** 2 for a, b in zip(end_positions[each], start_positions[each], strict=True)) ** 0.5
            for each in start_positions
        ]
        assert sum(length > 1 for length in moved) > 15  # mm
        assert preview.page.url.endswith("/"), "the token does not stay in the address"


def test_saved_edits_show_while_the_ants_go_on(browser: Browser, tmp_path: Path) -> None:
    """How soon they show is measured by `tests/benchmarks/reload.py`."""
    folder = few(tmp_path, 150).parent
    program = folder / "forager.ant"
    text = program.read_text()
    edits = (
        ("turn_home", text.replace("when time_in_state > patience * zeal ->", "when after 1 step ->")),
        ("search", text.replace("when touching(nest) -> search", "when after 1 step -> search")),
    )
    with previewed(folder / "scene.yaml") as address, opened(browser, address) as preview:
        preview.page.set_viewport_size({"width": 800, "height": 500})
        played(preview, 5)
        assert preview.now("counts()")["forager.main.turn_home"] == 0
        preview.press("play")
        for state, edited in (*edits, edits[0]):
            program.write_text(edited)
            preview.until(f"a.counts()['forager.main.{state}'] > 75")
            preview.page.wait_for_timeout(300)
        assert preview.now("agents") == 150
        assert "150" in (preview.find("outcome").text_content() or "")
        played(preview, 5)
        preview.page.wait_for_timeout(500)
        home_count = preview.now("counts()")["forager.main.turn_home"]
        assert (preview.find("legend-forager-main-turn_home").text_content() or "").endswith(str(home_count))


def test_an_error_is_underlined_and_the_ants_go_on(browser: Browser, tmp_path: Path) -> None:
    folder = few(tmp_path, 150).parent
    program = folder / "forager.ant"
    with previewed(folder / "scene.yaml") as address, opened(browser, address) as preview:
        preview.press("play")
        program.write_text(program.read_text().replace("when meal           -> approach", "when meal           -> aproach"))
        marked = preview.page.locator(".wrong.error")
        marked.first.wait_for(timeout=60_000)
        assert marked.first.text_content() == "aproach"
        assert "approach" in (preview.find("complaint").first.text_content() or "")
        frame = preview.now("frame")
        preview.until("a.frame > it + 10", 10, frame)
        assert preview.now("agents") == 150
        program.write_text(program.read_text().replace("aproach", "approach"))
        marked.first.wait_for(state="detached", timeout=60_000)


@pytest.mark.slow
def test_a_file_that_is_gone_for_a_moment_keeps_its_tab(browser: Browser, tmp_path: Path) -> None:
    folder = few(tmp_path, 150).parent
    program = folder / "forager.ant"
    with previewed(folder / "scene.yaml") as address, opened(browser, address) as preview:
        chosen = preview.page.locator("[role=tab][aria-selected=true][data-test^=file-tab]")
        assert chosen.get_attribute("data-test") == "file-tab-forager.ant"
        program.rename(folder / "away.ant")
        preview.find("errors").get_by_text("1 error").wait_for(timeout=60_000)
        (folder / "away.ant").rename(program)
        preview.find("errors").wait_for(state="hidden", timeout=60_000)
        preview.page.locator("[data-test='file-tab-forager.ant'][aria-selected=true]").wait_for(timeout=60_000)
        row = preview.find("legend-forager-main-search")
        assert row.is_visible()
        preview.page.locator(".sight-legend summary").click()
        assert not row.is_visible(), "the legend can be folded"


@pytest.mark.slow
def test_a_slider_acts_and_shows_its_line(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 150)
    with previewed(scene) as address, opened(browser, address) as preview:
        played(preview, 30)
        initial_count = preview.now("counts()")["forager.main.approach"]
        preview.press("side-tab-sliders")
        slider = preview.find("param-forager.smell")
        slider.focus()
        slider.press("End")
        preview.find("line").first.wait_for(timeout=60_000)
        assert (preview.find("line").first.text_content() or "").startswith("set: {forager.smell: 200")
        played(preview, 12)
        assert preview.now("counts()")["forager.main.approach"] > initial_count
        assert preview.find("edited").is_visible()


@pytest.mark.slow
def test_scrubbing_shows_the_selected_frame(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 150)
    with previewed(scene) as address, opened(browser, address) as preview:
        played(preview, 10)
        target_frame = int(preview.now("frame"))
        then = [preview.now("position", "forager", each) for each in range(50)]
        played(preview, 40)
        assert [preview.now("position", "forager", each) for each in range(50)] != then
        scrub = preview.find("scrub")
        scrub.focus()
        scrub.fill(str(target_frame))
        scrub.dispatch_event("change")
        preview.until("a.frame === it && a.still", 10, target_frame)
        assert [preview.now("position", "forager", each) for each in range(50)] == then
        preview.find("frame").filter(has_text=re.compile(rf"\b{target_frame}\b")).wait_for(timeout=60_000)


def test_clicking_an_agent_explains_it(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 150)
    with previewed(scene) as address, opened(browser, address) as preview:
        played(preview, 20)
        view = preview.page.locator("#view").bounding_box()
        assert view is not None
        screen_positions = {each: preview.now("screen", "forager", each) for each in preview.now("ids", "forager")}
        inside = [each for each, at in screen_positions.items() if at and 60 < at[0] < view["width"] - 60]
        near = sorted(
            (each for each in inside if 150 < screen_positions[each][1] < view["height"] - 150),
            key=lambda each: -screen_positions[each][1],
        )
        for agent in near[:20]:  # a stone may stand before one of them
            x, y = screen_positions[agent]
            preview.page.mouse.click(view["x"] + x, view["y"] + y)
            preview.page.wait_for_timeout(250)
            if preview.find("why-title").text_content():
                break
        preview.find("budget").wait_for(timeout=60_000)
        title = preview.find("why-title").text_content() or ""
        assert re.search(r"forager \d+", title)
        assert "when" in (preview.find("looked").first.text_content() or "")
        assert "separate" in (preview.find("layer-list").text_content() or "")


@pytest.mark.slow
def test_it_can_be_read_in_dark_and_light(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 150)
    with previewed(scene) as address:
        for scheme in ("dark", "light"):
            with opened(browser, address, color_scheme=scheme) as preview:
                sizes = preview.page.evaluate(
                    "() => [document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
                )
                assert sizes[0] <= SIZE["width"] and sizes[1] <= SIZE["height"]
                ground = preview.page.evaluate("() => getComputedStyle(document.body).backgroundColor")
                light = sum(map(int, re.findall(r"\d+", ground)[:3])) / 3
                assert (light > 128) == (scheme == "light")
