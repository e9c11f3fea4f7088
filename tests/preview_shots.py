"""The pictures of `docs/preview.md`: `python tests/preview_shots.py` drives the page in a Chromium; names choose among them."""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Callable
from math import dist
from pathlib import Path
from typing import TYPE_CHECKING

from browsing import chromium
from PIL import Image
from preview_page import EXAMPLES, PreviewPage, copied, opened, previewed

if TYPE_CHECKING:
    from playwright.sync_api import Browser

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"


def keep(preview: PreviewPage, name: str) -> None:
    """The page as it is, in a file as small as may be."""
    Image.open(io.BytesIO(preview.page.screenshot())).convert("RGB").save(IMAGES / f"{name}.png", optimize=True)


def go(preview: PreviewPage, frame: int) -> None:
    """Simulate to a frame as fast as it goes, and wait until it is shown."""
    preview.find("speed").select_option("0")
    preview.press("play")
    preview.until("a.frame >= it", 300, frame)
    preview.press("play")
    back(preview, frame)


def back(preview: PreviewPage, frame: int) -> None:
    scrub = preview.find("scrub")
    scrub.focus()
    scrub.fill(str(frame))
    scrub.dispatch_event("change")
    preview.until("a.frame === it && a.still && !a.light", 60, frame)


def keys(preview: PreviewPage, *pressed: str) -> None:
    preview.page.locator("#view > canvas").focus()
    for key in pressed:
        preview.page.keyboard.press(key)


def rest(preview: PreviewPage) -> None:
    """Wait until nothing is drawn any more."""
    picture_count = -1
    while picture_count != (picture_count := preview.now("pictures")):
        preview.page.wait_for_timeout(700)


def alone(preview: PreviewPage) -> tuple[float, float]:
    """Where the one is that is farthest from all others, of those near the middle of the view."""
    view = preview.page.locator("#view").bounding_box()
    assert view is not None
    screen_positions = (preview.now("screen", "forager", each) for each in preview.now("ids", "forager"))
    positions = [(at[0], at[1]) for at in screen_positions if at]
    middle = view["width"] / 2, view["height"] / 2
    near = [at for at in positions if dist(at, middle) < 170]
    return max(near, key=lambda at: min(dist(at, other) for other in positions if other != at))


def click(preview: PreviewPage, at: tuple[float, float]) -> None:
    view = preview.page.locator("#view").bounding_box()
    assert view is not None
    preview.page.mouse.click(view["x"] + at[0], view["y"] + at[1])


def why(browser: Browser) -> None:
    """An ant that carries a crumb, from near, and why it goes where it goes."""
    with previewed(EXAMPLES / "foraging" / "scene.yaml") as address, opened(browser, address, color_scheme="dark") as preview:
        go(preview, 260)
        preview.press("legend-forager-main-carry")
        keys(preview, "g", *["ArrowUp"] * 3)
        rest(preview)
        click(preview, alone(preview))
        keys(preview, "g", "+", "+", "+", "+")
        preview.find("budget").wait_for(timeout=20_000)
        rest(preview)
        keep(preview, "preview_why")


def error(browser: Browser) -> None:
    """A mistake is underlined, and the ants go on."""
    with tempfile.TemporaryDirectory() as place:
        folder = copied("foraging", Path(place))
        program = folder / "forager.ant"
        with previewed(folder / "scene.yaml") as address, opened(browser, address, color_scheme="dark") as preview:
            go(preview, 300)
            preview.find("speed").select_option("1")
            preview.press("play")
            program.write_text(program.read_text().replace("when meal           -> approach", "when meal           -> aproach"))
            preview.page.locator(".wrong.error").first.wait_for(timeout=10_000)
            preview.until("a.frame >= it", 60, 340)
            keep(preview, "preview_error")


def states(browser: Browser) -> None:
    """15,000 ants in the light, and the machine with how many are in each state."""
    with previewed(EXAMPLES / "foraging" / "many.yaml") as address, opened(browser, address, color_scheme="light") as preview:
        preview.press("side-tab-machine")
        preview.find("speed").select_option("0")
        preview.press("play")
        preview.until("a.frame >= 150", 300)
        keys(preview, "s")  # the colours of states
        keep(preview, "preview_states")


def digging(browser: Browser) -> None:
    """A tunnel while it is dug, seen from beside the diggers."""
    with previewed(EXAMPLES / "tunnel" / "scene.yaml") as address, opened(browser, address, color_scheme="light") as preview:
        go(preview, 92)
        preview.press("legend-forager-main-dig")
        keys(preview, "x", "g", *["ArrowRight"] * 8, "ArrowDown", "ArrowDown", "+", "+")
        rest(preview)
        keep(preview, "preview_digging")


SHOTS: dict[str, Callable[[Browser], None]] = {each.__name__: each for each in (why, error, states, digging)}

if __name__ == "__main__":
    with chromium() as browser:
        for name in sys.argv[1:] or SHOTS:
            SHOTS[name](browser)
