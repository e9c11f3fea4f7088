"""The ants in space, in a real browser: who is drawn, selected, hidden and followed, by pointer and by keys."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from browsing import chromium
from preview_page import PreviewPage, few, opened, previewed

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as chromium_browser:
        yield chromium_browser


@pytest.fixture(scope="module")
def foraging(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with previewed(few(tmp_path_factory.mktemp("foraging"), 500)) as address:
        yield address


def keys(preview: PreviewPage, *pressed: str) -> None:
    preview.page.locator("#view > canvas").focus()
    for key in pressed:
        preview.page.keyboard.press(key)


def said(preview: PreviewPage) -> str:
    return preview.page.locator("#view .sight-said").text_content() or ""


def settled(preview: PreviewPage) -> None:
    """Wait until nothing is drawn any more: the camera has come to rest."""
    previous_count, still = -1, 0
    for _ in range(240):
        preview.page.wait_for_timeout(250)
        preview.page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        now = preview.now("pictures")
        still = still + 1 if now == previous_count else 0
        if still == 3:  # on a busy machine two pictures may be that far apart
            return
        previous_count = now
    raise AssertionError("it is drawn on and on")


def seen_at(preview: PreviewPage, place: list[float], reach: int = 12) -> Any:
    """The picture around a place of the view, as an array of colours."""
    import numpy as np
    from PIL import Image

    box = preview.page.locator("#view > canvas").bounding_box()
    assert box is not None
    clip = {"x": box["x"] + place[0] - reach, "y": box["y"] + place[1] - reach, "width": 2 * reach, "height": 2 * reach}
    picture = preview.page.screenshot(clip=clip)
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(float)


def test_an_ant_is_where_it_is_said_to_be_in_the_colour_of_its_state(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging, color_scheme="dark") as preview:
        keys(preview, "n", "g", "s")  # `s`: the colours of states
        settled(preview)
        where = preview.now("screen", "forager", preview.now("ids", "forager")[0])
        around = seen_at(preview, where, 20)
        red, green, blue = around[..., 0], around[..., 1], around[..., 2]
        amber = (red > 1.4 * green) & (green > 1.6 * blue) & (red > 110)  # `search` is amber
        assert amber.mean() > 0.02
        keys(preview, "Escape")
        assert said(preview) == "no agent is selected"


def test_keys_go_from_ant_to_ant(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging) as preview:
        keys(preview, "n")
        assert said(preview) == "forager 0, search"
        keys(preview, "n", "n")
        assert said(preview) == "forager 2, search"
        keys(preview, "p", "p", "p")
        assert said(preview) == "forager 499, search"


@pytest.mark.slow
def test_arrows_turn_the_view_and_leave_time_alone(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging) as preview:
        settled(preview)
        frame, initial_position = preview.now("frame"), preview.now("screen", "forager", 7)
        keys(preview, "ArrowLeft", "ArrowLeft")
        settled(preview)
        turned = preview.now("screen", "forager", 7)
        assert abs(turned[0] - initial_position[0]) + abs(turned[1] - initial_position[1]) > 5
        keys(preview, "ArrowRight", "ArrowRight")
        settled(preview)
        assert preview.now("screen", "forager", 7) == pytest.approx(initial_position, abs=1.5)
        assert preview.now("frame") == frame


@pytest.mark.slow
def test_a_click_selects_the_agent_there_and_beside_it_none(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging) as preview:
        keys(preview, "n", "g", "Escape", *["ArrowUp"] * 12)  # from straight above no agent hides another
        settled(preview)
        box = preview.page.locator("#view > canvas").bounding_box()
        assert box is not None
        x, y = preview.now("screen", "forager", 0)
        preview.page.mouse.click(box["x"] + x, box["y"] + y)
        assert said(preview) == "forager 0, search"
        screen_positions = {each: preview.now("screen", "forager", each) for each in preview.now("ids", "forager")[1:]}
        inside = {each: at for each, at in screen_positions.items() if at and 200 < at[0] < 500 and 60 < at[1] < 440}
        near = next(each for each, at in inside.items() if abs(at[0] - x) + abs(at[1] - y) > 60)
        other = preview.now("screen", "forager", near)
        preview.page.keyboard.down("Shift")
        preview.page.mouse.click(box["x"] + other[0], box["y"] + other[1])
        assert said(preview) == "2 selected"
        preview.page.mouse.click(box["x"] + other[0], box["y"] + other[1])
        preview.page.keyboard.up("Shift")
        assert said(preview) == "forager 0, search"
        keys(preview, "f")
        settled(preview)
        preview.page.mouse.click(box["x"] + box["width"] - 40, box["y"] + 40)  # no agent is in the sky
        assert said(preview) == "no agent is selected"


@pytest.mark.slow
def test_a_row_of_the_legend_selects_all_in_the_state(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging) as preview:
        count = preview.now("counts()")["forager.main.search"]
        row = preview.find("legend-forager-main-search")
        assert f"search{count}" == (row.text_content() or "")
        row.click()
        assert said(preview) == f"{count} selected"


@pytest.mark.slow
def test_who_is_followed_stays_in_the_middle(browser: Browser, tmp_path: Path) -> None:
    with previewed(few(tmp_path, 500)) as address, opened(browser, address) as preview:
        keys(preview, "n", "2", "g")
        start_position = preview.now("position", "forager", 0)
        preview.press("play")
        preview.until("a.frame > it + 24", 30, preview.now("frame"))
        preview.press("play")
        settled(preview)
        end_position = preview.now("position", "forager", 0)
        assert sum((a - b) ** 2 for a, b in zip(end_position, start_position, strict=True)) ** 0.5 > 1
        box = preview.page.locator("#view > canvas").bounding_box()
        assert box is not None
        x, y = preview.now("screen", "forager", 0)
        assert abs(x - box["width"] / 2) < 12 and abs(y - box["height"] / 2) < 12
        keys(preview, "3")
        settled(preview)
        x, y = preview.now("screen", "forager", 0)
        assert 0 < x < box["width"] and box["height"] / 2 < y < 1.3 * box["height"]  # below the eye of who rides


@pytest.mark.slow
def test_light_and_dark_are_both_drawn(browser: Browser, foraging: str) -> None:
    sky = {}
    for theme in ("light", "dark"):
        with opened(browser, foraging, color_scheme=theme) as preview:
            keys(preview, "f")
            settled(preview)
            box = preview.page.locator("#view > canvas").bounding_box()
            assert box is not None
            sky[theme] = seen_at(preview, [box["width"] - 10, 10], 5).mean()
    assert sky["light"] > 200 > 60 > sky["dark"]


def test_one_looks_first_as_the_camera_of_the_scene_does(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging) as preview:
        settled(preview)
        first = preview.now("screen", "forager", 7)
        labels = preview.page.locator(".sight-labels > div")
        assert labels.count() == 3
        assert all(each.evaluate("it => it.style.visibility === 'hidden' || it.style.transform !== ''") for each in labels.all())
        keys(preview, "f")
        settled(preview)
        assert preview.now("screen", "forager", 7) != pytest.approx(first, abs=3)
        keys(preview, "c")
        settled(preview)
        assert preview.now("screen", "forager", 7) == pytest.approx(first, abs=2)
