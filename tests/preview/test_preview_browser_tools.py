"""What else the page has, in a real browser: stops, states, costs, branches, keys, and words with markup."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browsing import chromium
from preview_page import few, opened, previewed

if TYPE_CHECKING:
    from playwright.sync_api import Browser, WebSocketRoute


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as chromium_browser:
        yield chromium_browser


@pytest.mark.slow
def test_it_stops_where_an_agent_enters_a_state(browser: Browser, tmp_path: Path) -> None:
    with previewed(few(tmp_path, 100)) as address, opened(browser, address) as preview:
        preview.press("side-tab-breaks")
        preview.find("break-state").select_option(label="approach")
        preview.find("break-state-form").get_by_role("button").click()
        preview.find("speed").select_option(index=preview.find("speed").locator("option").count() - 1)
        preview.press("play")
        # Where it was one agent that stopped it, the panel that explains it is in front.
        preview.find("fired").filter(has_text="stopped").wait_for(state="attached", timeout=60_000)
        assert re.search(r"forager \d+.* approach", preview.find("fired").text_content() or "")
        preview.until("a.counts()['forager.main.approach'] > 0")
        frame = preview.now("frame")
        preview.page.wait_for_timeout(500)
        assert preview.now("frame") == frame
        assert re.search(r"forager \d+", preview.find("why-title").text_content() or ""), (
            "who stopped it is selected and explained"
        )


@pytest.mark.slow
def test_a_state_of_the_graph_selects_its_agents(browser: Browser, tmp_path: Path) -> None:
    with previewed(few(tmp_path, 100)) as address, opened(browser, address) as preview:
        preview.press("side-tab-machine")
        assert (preview.find("count-search").text_content() or "") == "100"
        preview.find("state-search").focus()
        preview.find("state-search").press("Enter")
        preview.page.get_by_text("100 selected", exact=True).first.wait_for(state="attached", timeout=60_000)


@pytest.mark.slow
def test_an_edit_at_an_earlier_frame_begins_a_branch(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 100)
    scene.write_text(scene.read_text().replace("frames: 1..960", "frames: 1..40"))
    program = scene.parent / "forager.ant"
    branch = "() => document.querySelector('[data-test=branches]').textContent.includes({words!r})"
    with previewed(scene) as address, opened(browser, address) as preview:
        preview.press("play")
        preview.find("paused-by").filter(has_text="frame 40 is the scene's last").wait_for(timeout=60_000)
        assert preview.now("frame") == 40
        preview.find("scrub").focus()
        preview.find("scrub").fill("20")
        preview.find("scrub").dispatch_event("change")
        preview.until("a.frame === 20 && a.still")
        assert not preview.find("edited").is_visible()
        text = program.read_text()
        program.write_text(text.replace("max_speed 30 mm/s", "max_speed 12 mm/s"))
        preview.find("edited").wait_for(timeout=60_000)
        preview.find("outcome").filter(has_text="saved: forager.ant line 24 · kept 100 agents").wait_for(timeout=60_000)
        program.write_text(text)
        preview.find("edited").wait_for(state="hidden", timeout=60_000)  # it is what a fresh run gives again
        program.write_text(text.replace("max_speed 30 mm/s", "max_speed 12 mm/s"))
        preview.find("edited").wait_for(timeout=60_000)
        assert preview.now("frame") == 20 and preview.find("scrub").get_attribute("max") == "20"
        preview.page.wait_for_function(branch.format(words="before: forager.ant line 24, at frame 20"), polling=50)
        preview.press("restart")
        preview.find("edited").wait_for(state="hidden", timeout=60_000)
        preview.until("a.frame === 1")
        preview.page.wait_for_function(
            branch.format(words="before: simulated again from the first frame, at frame 1"), polling=50
        )


@pytest.mark.slow
def test_costs_are_shown_by_phase_and_line(browser: Browser, tmp_path: Path) -> None:
    with previewed(few(tmp_path, 100)) as address, opened(browser, address) as preview:
        preview.press("side-tab-profile")
        preview.find("profile-on").check()
        preview.press("play")
        preview.page.get_by_test_id("profile").get_by_text("separate(").first.wait_for(timeout=60_000)
        words = preview.find("profile").text_content() or ""
        assert "move" in words and "decide" in words


@pytest.mark.slow
def test_keys_reach_everything(browser: Browser, tmp_path: Path) -> None:
    with previewed(few(tmp_path, 100)) as address, opened(browser, address) as preview:
        preview.press("play")
        preview.until("a.frame > 10")
        preview.press("play")
        reached = set()
        for _ in range(60):
            preview.page.keyboard.press("Tab")
            reached.add(
                preview.page.evaluate(
                    "() => { const e = document.activeElement;"
                    " return e.dataset.test || e.closest('[data-test]')?.dataset.test || e.closest('[id]')?.id || e.tagName }"
                )
            )
        assert {"play", "speed", "scrub"} <= reached
        assert any(name.startswith("side-tab-") for name in reached) and any(name.startswith("file-tab-") for name in reached)
        frame = preview.now("frame")
        preview.page.locator("#view canvas, #view [tabindex]").first.focus()
        preview.page.keyboard.press("Space")
        preview.until("a.frame > it", 10, frame)
        preview.page.keyboard.press("Space")
        preview.page.keyboard.press("n")
        preview.page.wait_for_function(
            "() => /forager/.test(document.querySelector('[data-test=why-title]').textContent)", timeout=60_000
        )


@pytest.mark.slow
def test_markup_in_words_of_users_is_shown_as_words(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 100)
    program = scene.parent / "forager.ant"
    bad = "<img src=x onerror=window.hacked=1>"
    text = program.read_text().replace("How far an ant smells food", bad).replace("Looking for anything", bad)
    program.write_text(text.replace("no crumb is lost or invented", bad))
    with previewed(scene) as address, opened(browser, address) as preview:
        preview.press("side-tab-sliders")
        preview.find("params").get_by_text(bad).first.wait_for(timeout=60_000)
        preview.press("side-tab-machine")
        preview.find("state-search").hover()
        preview.press("side-tab-breaks")
        assert bad in (preview.find("break-spec").text_content() or "")
        assert preview.page.evaluate("() => window.hacked === undefined && document.querySelectorAll('img').length === 0")


@pytest.mark.slow
def test_a_name_with_markup_is_shown_as_words(browser: Browser, tmp_path: Path) -> None:
    """The language has no such names; a page does not rely on it."""
    bad = "<img src=x onerror=window.hacked=1>"

    def other_names(socket: WebSocketRoute) -> None:
        server = socket.connect_to_server()
        server.on_message(lambda said: socket.send(said.replace("turn_home", bad) if isinstance(said, str) else said))

    with previewed(few(tmp_path, 100)) as address:
        page = browser.new_page()
        page.route_web_socket("**/ws", other_names)
        page.goto(address)
        page.wait_for_function("() => window.antdsl && window.antdsl.agents > 0", timeout=60_000)
        assert bad in (page.locator(".sight-legend").text_content() or "")
        page.get_by_test_id("side-tab-machine").click()
        assert bad in (page.get_by_test_id("chart").text_content() or "")
        assert page.evaluate("() => window.hacked === undefined && document.querySelectorAll('img').length === 0")
        page.close()


def test_a_page_that_lost_its_preview_says_so_and_comes_back(browser: Browser, tmp_path: Path) -> None:
    scene = few(tmp_path, 100)
    with previewed(scene) as address:
        port = re.search(r":(\d+)/", address)
        assert port is not None
        context = browser.new_context()
        page = context.new_page()
        page.goto(address)
        page.wait_for_function("() => window.antdsl && window.antdsl.agents > 0", timeout=60_000)
    stale = page.locator("#stale")
    stale.wait_for(timeout=60_000)
    assert "preview" in (stale.text_content() or "")
    context.close()
