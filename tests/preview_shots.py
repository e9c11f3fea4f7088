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
from preview_page import EXAMPLES, Seen, copied, opened, previewed

if TYPE_CHECKING:
    from playwright.sync_api import Browser

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"


def keep(seen: Seen, name: str) -> None:
    """The page as it is, in a file as small as may be."""
    Image.open(io.BytesIO(seen.page.screenshot())).convert("RGB").save(IMAGES / f"{name}.png", optimize=True)


def go(seen: Seen, frame: int) -> None:
    """Simulate to a frame as fast as it goes, and wait until it is shown."""
    seen.find("speed").select_option("0")
    seen.press("play")
    seen.until("a.frame >= it", 300, frame)
    seen.press("play")
    back(seen, frame)


def back(seen: Seen, frame: int) -> None:
    scrub = seen.find("scrub")
    scrub.focus()
    scrub.fill(str(frame))
    scrub.dispatch_event("change")
    seen.until("a.frame === it && a.still && !a.light", 60, frame)


def keys(seen: Seen, *pressed: str) -> None:
    seen.page.locator("#view > canvas").focus()
    for key in pressed:
        seen.page.keyboard.press(key)


def rest(seen: Seen) -> None:
    """Wait until nothing is drawn any more."""
    before = -1
    while before != (before := seen.now("pictures")):
        seen.page.wait_for_timeout(700)


def alone(seen: Seen) -> tuple[float, float]:
    """Where the one is that is farthest from all others, of those near the middle of the view."""
    view = seen.page.locator("#view").bounding_box()
    assert view is not None
    found = (seen.now("screen", "forager", each) for each in seen.now("ids", "forager"))
    places = [(at[0], at[1]) for at in found if at]
    middle = view["width"] / 2, view["height"] / 2
    near = [at for at in places if dist(at, middle) < 170]
    return max(near, key=lambda at: min(dist(at, other) for other in places if other != at))


def click(seen: Seen, at: tuple[float, float]) -> None:
    view = seen.page.locator("#view").bounding_box()
    assert view is not None
    seen.page.mouse.click(view["x"] + at[0], view["y"] + at[1])


def why(browser: Browser) -> None:
    """An ant that carries a crumb, from near, and why it goes where it goes."""
    with previewed(EXAMPLES / "foraging" / "scene.yaml") as address, opened(browser, address, color_scheme="dark") as seen:
        go(seen, 260)
        seen.press("legend-forager-main-carry")
        keys(seen, "g", *["ArrowUp"] * 3)
        rest(seen)
        click(seen, alone(seen))
        keys(seen, "g", "+", "+", "+", "+")
        seen.find("budget").wait_for(timeout=20_000)
        rest(seen)
        keep(seen, "preview_why")


def error(browser: Browser) -> None:
    """A mistake is underlined, and the ants go on."""
    with tempfile.TemporaryDirectory() as place:
        folder = copied("foraging", Path(place))
        program = folder / "forager.ant"
        with previewed(folder / "scene.yaml") as address, opened(browser, address, color_scheme="dark") as seen:
            go(seen, 300)
            seen.find("speed").select_option("1")
            seen.press("play")
            program.write_text(program.read_text().replace("when meal           -> approach", "when meal           -> aproach"))
            seen.page.locator(".wrong.error").first.wait_for(timeout=10_000)
            seen.until("a.frame >= it", 60, 340)
            keep(seen, "preview_error")


def states(browser: Browser) -> None:
    """15,000 ants in the light, and the machine with how many are in each state."""
    with previewed(EXAMPLES / "foraging" / "many.yaml") as address, opened(browser, address, color_scheme="light") as seen:
        seen.press("side-tab-machine")
        seen.find("speed").select_option("0")
        seen.press("play")
        seen.until("a.frame >= 150", 300)
        keep(seen, "preview_states")


def digging(browser: Browser) -> None:
    """A tunnel while it is dug, seen from beside the diggers."""
    with previewed(EXAMPLES / "tunnel" / "scene.yaml") as address, opened(browser, address, color_scheme="light") as seen:
        go(seen, 92)
        seen.press("legend-forager-main-dig")
        keys(seen, "x", "g", *["ArrowRight"] * 8, "ArrowDown", "ArrowDown", "+", "+")
        rest(seen)
        keep(seen, "preview_digging")


SHOTS: dict[str, Callable[[Browser], None]] = {each.__name__: each for each in (why, error, states, digging)}

if __name__ == "__main__":
    with chromium() as browser:
        for name in sys.argv[1:] or SHOTS:
            SHOTS[name](browser)
