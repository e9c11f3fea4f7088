"""The preview as a person uses it: a real browser, a real run, a file that is saved."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browsing import chromium
from preview_page import SIZE, Seen, few, opened, previewed

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


def played(seen: Seen, frames: int) -> int:
    """Play so many frames from here, then pause; the frame that is shown."""
    here = seen.now("frame")
    if "play" in (seen.find("play").text_content() or ""):
        seen.press("play")
    seen.until("a.frame >= it", 30, here + frames)
    seen.press("play")
    seen.page.wait_for_timeout(300)
    seen.until("a.still")
    return int(seen.now("frame"))


def test_the_page_comes_up_and_ants_move(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 150)
    with previewed(scene) as address, opened(browser, address) as seen:
        assert seen.now("agents") == 150
        assert "foraging" in (seen.find("scene").text_content() or "") or "scene" in (seen.find("scene").text_content() or "")
        before = {each: seen.now("position", "forager", each) for each in range(20)}
        frame = seen.now("frame")
        assert played(seen, 24) >= frame + 24
        after = {each: seen.now("position", "forager", each) for each in range(20)}
        moved = [sum((a - b) ** 2 for a, b in zip(after[each], before[each], strict=True)) ** 0.5 for each in before]
        assert sum(length > 1 for length in moved) > 15  # mm
        assert seen.page.url.endswith("/"), "the token does not stay in the address"


def test_saved_edits_show_while_the_ants_go_on(browser: Browser, tmp_path: Path) -> None:
    """How soon they show is measured by `tests/benchmarks/reload.py`."""
    folder = few(tmp_path, 150).parent
    program = folder / "forager.ant"
    text = program.read_text()
    edits = (
        ("turn_home", text.replace("when time_in_state > patience * zeal ->", "when after 1 step ->")),
        ("search", text.replace("when touching(nest) -> search", "when after 1 step -> search")),
    )
    with previewed(folder / "scene.yaml") as address, opened(browser, address) as seen:
        seen.page.set_viewport_size({"width": 800, "height": 500})
        played(seen, 5)
        assert seen.now("counts()")["forager.main.turn_home"] == 0
        seen.press("play")
        for state, edited in (*edits, edits[0]):
            program.write_text(edited)
            seen.until(f"a.counts()['forager.main.{state}'] > 75")
            seen.page.wait_for_timeout(300)
        assert seen.now("agents") == 150
        assert "150" in (seen.find("outcome").text_content() or "")
        played(seen, 5)
        seen.page.wait_for_timeout(500)
        there = seen.now("counts()")["forager.main.turn_home"]
        assert (seen.find("legend-forager-main-turn_home").text_content() or "").endswith(str(there))


def test_an_error_is_underlined_and_the_ants_go_on(browser: Browser, tmp_path: Path) -> None:
    folder = few(tmp_path, 150).parent
    program = folder / "forager.ant"
    with previewed(folder / "scene.yaml") as address, opened(browser, address) as seen:
        seen.press("play")
        program.write_text(program.read_text().replace("when meal           -> approach", "when meal           -> aproach"))
        marked = seen.page.locator(".wrong.error")
        marked.first.wait_for(timeout=60_000)
        assert marked.first.text_content() == "aproach"
        assert "approach" in (seen.find("complaint").first.text_content() or "")
        frame = seen.now("frame")
        seen.until("a.frame > it + 10", 10, frame)
        assert seen.now("agents") == 150
        program.write_text(program.read_text().replace("aproach", "approach"))
        marked.first.wait_for(state="detached", timeout=60_000)


@pytest.mark.slow
def test_a_file_that_is_gone_for_a_moment_keeps_its_tab(browser: Browser, tmp_path: Path) -> None:
    folder = few(tmp_path, 150).parent
    program = folder / "forager.ant"
    with previewed(folder / "scene.yaml") as address, opened(browser, address) as seen:
        chosen = seen.page.locator("[role=tab][aria-selected=true][data-test^=file-tab]")
        assert chosen.get_attribute("data-test") == "file-tab-forager.ant"
        program.rename(folder / "away.ant")
        seen.find("errors").get_by_text("1 error").wait_for(timeout=60_000)
        (folder / "away.ant").rename(program)
        seen.find("errors").wait_for(state="hidden", timeout=60_000)
        seen.page.locator("[data-test='file-tab-forager.ant'][aria-selected=true]").wait_for(timeout=60_000)
        row = seen.find("legend-forager-main-search")
        assert row.is_visible()
        seen.page.locator(".sight-legend summary").click()
        assert not row.is_visible(), "the legend can be folded"


@pytest.mark.slow
def test_a_slider_acts_and_shows_its_line(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 150)
    with previewed(scene) as address, opened(browser, address) as seen:
        played(seen, 30)
        before = seen.now("counts()")["forager.main.approach"]
        seen.press("side-tab-sliders")
        slider = seen.find("param-forager.smell")
        slider.focus()
        slider.press("End")
        seen.find("line").first.wait_for(timeout=60_000)
        assert (seen.find("line").first.text_content() or "").startswith("set: {forager.smell: 200")
        played(seen, 12)
        assert seen.now("counts()")["forager.main.approach"] > before
        assert seen.find("edited").is_visible()


@pytest.mark.slow
def test_scrubbing_shows_the_frame_asked_for(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 150)
    with previewed(scene) as address, opened(browser, address) as seen:
        played(seen, 10)
        here = int(seen.now("frame"))
        then = [seen.now("position", "forager", each) for each in range(50)]
        played(seen, 40)
        assert [seen.now("position", "forager", each) for each in range(50)] != then
        scrub = seen.find("scrub")
        scrub.focus()
        scrub.fill(str(here))
        scrub.dispatch_event("change")
        seen.until("a.frame === it && a.still", 10, here)
        assert [seen.now("position", "forager", each) for each in range(50)] == then
        seen.find("frame").filter(has_text=re.compile(rf"\b{here}\b")).wait_for(timeout=60_000)


def test_clicking_an_agent_explains_it(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 150)
    with previewed(scene) as address, opened(browser, address) as seen:
        played(seen, 20)
        view = seen.page.locator("#view").bounding_box()
        assert view is not None
        places = {each: seen.now("screen", "forager", each) for each in seen.now("ids", "forager")}
        inside = [each for each, at in places.items() if at and 60 < at[0] < view["width"] - 60]
        near = sorted(
            (each for each in inside if 150 < places[each][1] < view["height"] - 150), key=lambda each: -places[each][1]
        )
        for agent in near[:20]:  # a stone may stand before one of them
            x, y = places[agent]
            seen.page.mouse.click(view["x"] + x, view["y"] + y)
            seen.page.wait_for_timeout(250)
            if seen.find("why-title").text_content():
                break
        seen.find("budget").wait_for(timeout=60_000)
        title = seen.find("why-title").text_content() or ""
        assert re.search(r"forager \d+", title)
        assert "when" in (seen.find("looked").first.text_content() or "")
        assert "separate" in (seen.find("layer-list").text_content() or "")


@pytest.mark.slow
def test_it_can_be_read_in_dark_and_light(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 150)
    with previewed(scene) as address:
        for scheme in ("dark", "light"):
            with opened(browser, address, color_scheme=scheme) as seen:
                sizes = seen.page.evaluate("() => [document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
                assert sizes[0] <= SIZE["width"] and sizes[1] <= SIZE["height"]
                ground = seen.page.evaluate("() => getComputedStyle(document.body).backgroundColor")
                light = sum(map(int, re.findall(r"\d+", ground)[:3])) / 3
                assert (light > 128) == (scheme == "light")
