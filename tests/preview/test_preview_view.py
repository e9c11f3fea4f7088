"""The ants in space, in a real browser: who is drawn, selected, hidden and followed, by pointer and by keys."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from browsing import chromium
from preview_page import Seen, few, opened, previewed

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def foraging(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with previewed(few(tmp_path_factory.mktemp("foraging"), 500)) as address:
        yield address


def keys(seen: Seen, *pressed: str) -> None:
    seen.page.locator("#view > canvas").focus()
    for key in pressed:
        seen.page.keyboard.press(key)


def said(seen: Seen) -> str:
    return seen.page.locator("#view .sight-said").text_content() or ""


def settled(seen: Seen) -> None:
    """Wait until nothing is drawn any more: the camera has come to rest."""
    before, still = -1, 0
    for _ in range(240):
        seen.page.wait_for_timeout(250)
        now = seen.now("pictures")
        still = still + 1 if now == before else 0
        if still == 3:  # on a busy machine two pictures may be that far apart
            return
        before = now
    raise AssertionError("it is drawn on and on")


def seen_at(seen: Seen, place: list[float], reach: int = 12) -> Any:
    """The picture around a place of the view, as an array of colours."""
    import numpy as np
    from PIL import Image

    box = seen.page.locator("#view > canvas").bounding_box()
    assert box is not None
    clip = {"x": box["x"] + place[0] - reach, "y": box["y"] + place[1] - reach, "width": 2 * reach, "height": 2 * reach}
    picture = seen.page.screenshot(clip=clip)
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(float)


def test_an_ant_is_where_it_is_said_to_be_in_the_colour_of_its_state(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging, color_scheme="dark") as seen:
        keys(seen, "n", "g")
        settled(seen)
        where = seen.now("screen", "forager", seen.now("ids", "forager")[0])
        around = seen_at(seen, where, 20)
        red, green, blue = around[..., 0], around[..., 1], around[..., 2]
        amber = (red > 1.4 * green) & (green > 1.6 * blue) & (red > 110)  # `search` is amber
        assert amber.mean() > 0.02
        keys(seen, "Escape")
        assert said(seen) == "nobody is selected"


def test_keys_go_from_ant_to_ant(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging) as seen:
        keys(seen, "n")
        assert said(seen) == "forager 0, search"
        keys(seen, "n", "n")
        assert said(seen) == "forager 2, search"
        keys(seen, "p", "p", "p")
        assert said(seen) == "forager 499, search"


@pytest.mark.slow
def test_arrows_turn_the_view_and_leave_time_alone(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging) as seen:
        settled(seen)
        frame, before = seen.now("frame"), seen.now("screen", "forager", 7)
        keys(seen, "ArrowLeft", "ArrowLeft")
        settled(seen)
        turned = seen.now("screen", "forager", 7)
        assert abs(turned[0] - before[0]) + abs(turned[1] - before[1]) > 5
        keys(seen, "ArrowRight", "ArrowRight")
        settled(seen)
        assert seen.now("screen", "forager", 7) == pytest.approx(before, abs=1.5)
        assert seen.now("frame") == frame


@pytest.mark.slow
def test_a_click_selects_who_is_there_and_beside_them_nobody(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging) as seen:
        keys(seen, "n", "g", "Escape", *["ArrowUp"] * 12)  # from straight above nobody hides another
        settled(seen)
        box = seen.page.locator("#view > canvas").bounding_box()
        assert box is not None
        x, y = seen.now("screen", "forager", 0)
        seen.page.mouse.click(box["x"] + x, box["y"] + y)
        assert said(seen) == "forager 0, search"
        places = {each: seen.now("screen", "forager", each) for each in seen.now("ids", "forager")[1:]}
        inside = {each: at for each, at in places.items() if at and 200 < at[0] < 500 and 60 < at[1] < 440}
        near = next(each for each, at in inside.items() if abs(at[0] - x) + abs(at[1] - y) > 60)
        other = seen.now("screen", "forager", near)
        seen.page.keyboard.down("Shift")
        seen.page.mouse.click(box["x"] + other[0], box["y"] + other[1])
        assert said(seen) == "2 selected"
        seen.page.mouse.click(box["x"] + other[0], box["y"] + other[1])
        seen.page.keyboard.up("Shift")
        assert said(seen) == "forager 0, search"
        keys(seen, "f")
        settled(seen)
        seen.page.mouse.click(box["x"] + box["width"] - 40, box["y"] + 40)  # nobody stands in the sky
        assert said(seen) == "nobody is selected"


@pytest.mark.slow
def test_a_row_of_the_legend_selects_all_in_the_state(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging) as seen:
        count = seen.now("counts()")["forager.main.search"]
        row = seen.find("legend-forager-main-search")
        assert f"search{count}" == (row.text_content() or "")
        row.click()
        assert said(seen) == f"{count} selected"


@pytest.mark.slow
def test_who_is_followed_stays_in_the_middle(browser: Browser, tmp_path: Path) -> None:
    with previewed(few(tmp_path, 500)) as address, opened(browser, address) as seen:
        keys(seen, "n", "2", "g")
        before = seen.now("position", "forager", 0)
        seen.press("play")
        seen.until("a.frame > it + 24", 30, seen.now("frame"))
        seen.press("play")
        settled(seen)
        after = seen.now("position", "forager", 0)
        assert sum((a - b) ** 2 for a, b in zip(after, before, strict=True)) ** 0.5 > 1
        box = seen.page.locator("#view > canvas").bounding_box()
        assert box is not None
        x, y = seen.now("screen", "forager", 0)
        assert abs(x - box["width"] / 2) < 12 and abs(y - box["height"] / 2) < 12
        keys(seen, "3")
        settled(seen)
        x, y = seen.now("screen", "forager", 0)
        assert 0 < x < box["width"] and box["height"] / 2 < y < 1.3 * box["height"]  # below the eye of who rides


@pytest.mark.slow
def test_light_and_dark_are_both_drawn(browser: Browser, foraging: str) -> None:
    sky = {}
    for theme in ("light", "dark"):
        with opened(browser, foraging, color_scheme=theme) as seen:
            keys(seen, "f")
            settled(seen)
            box = seen.page.locator("#view > canvas").bounding_box()
            assert box is not None
            sky[theme] = seen_at(seen, [box["width"] - 10, 10], 5).mean()
    assert sky["light"] > 200 > 60 > sky["dark"]


def test_one_looks_first_as_the_camera_of_the_scene_does(browser: Browser, foraging: str) -> None:
    with opened(browser, foraging) as seen:
        settled(seen)
        first = seen.now("screen", "forager", 7)
        labels = seen.page.locator(".sight-labels > div")
        assert labels.count() == 3
        assert all(each.evaluate("it => it.style.visibility === 'hidden' || it.style.transform !== ''") for each in labels.all())
        keys(seen, "f")
        settled(seen)
        assert seen.now("screen", "forager", 7) != pytest.approx(first, abs=3)
        keys(seen, "c")
        settled(seen)
        assert seen.now("screen", "forager", 7) == pytest.approx(first, abs=2)
