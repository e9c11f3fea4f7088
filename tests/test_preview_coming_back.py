"""A page and its server part and meet again: an old page loads itself anew, a server that is gone is told of, an old token is
not let in, and a connection that breaks is made again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browsing import chromium
from preview_page import SIZE, copied, previewed

pytest.importorskip("websockets")

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

STALE = "() => !document.getElementById('stale').hidden && document.getElementById('stale').textContent"
FRESH = "() => document.getElementById('stale').hidden && window.antdsl && window.antdsl.agents > 0"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    context = browser.new_context(viewport=SIZE)
    try:
        yield context.new_page()
    finally:
        context.close()


@pytest.mark.parametrize("always", [False, True])
def test_a_page_of_another_build_loads_itself_again_and_only_once(page: Page, tmp_path: Path, always: bool) -> None:
    """`always`: a cache holds on to the old page, which is then better than none."""
    page.add_init_script(
        """document.addEventListener('readystatechange', () => {
          if (document.readyState !== 'interactive') return;
          const loads = Number(sessionStorage.getItem('loads')) + 1, meta = document.querySelector('meta[name=build]');
          sessionStorage.setItem('loads', loads);
          if (!/^[0-9a-f]{16}$/.test(meta.content)) throw new Error('no build');
          if (ALWAYS || loads === 1) meta.content = '0000000000000000';
        });""".replace("ALWAYS", str(always).lower())
    )
    with previewed(copied("minimal", tmp_path) / "scene.yaml") as whole:
        page.goto(whole)
        page.wait_for_function("() => sessionStorage.getItem('loads') === '2'", timeout=20_000)
        page.wait_for_function(FRESH, timeout=20_000)  # it still has its token
        page.wait_for_timeout(1000)
        assert page.evaluate("[sessionStorage.getItem('loads'), location.hash]") == ["2", ""]


def test_a_server_that_is_gone_is_told_of_and_its_token_is_of_no_use_later(page: Page, tmp_path: Path) -> None:
    scene = copied("minimal", tmp_path) / "scene.yaml"
    with previewed(scene) as whole:
        page.goto(whole)
        page.wait_for_function(FRESH, timeout=20_000)
    said = page.wait_for_function(STALE, timeout=5000).json_value()
    assert "does not answer" in said
    port = whole.split(":")[2].split("/")[0]
    with previewed(scene, "--port", port) as again:  # the last `--port` counts
        assert again.split("#")[0] == whole.split("#")[0] and again != whole
        page.wait_for_function(f"() => String(({STALE})()).includes('terminal')", timeout=15_000)
        page.goto("about:blank")
        page.goto(again)
        page.wait_for_function(FRESH, timeout=20_000)


def test_a_connection_that_breaks_is_made_again(page: Page, tmp_path: Path) -> None:
    page.add_init_script(
        """window.sockets = [];
        window.WebSocket = class extends WebSocket { constructor(...all) { super(...all); window.sockets.push(this); } };"""
    )
    with previewed(copied("minimal", tmp_path) / "scene.yaml") as whole:
        page.goto(whole)
        page.wait_for_function(FRESH, timeout=20_000)
        page.evaluate("() => window.sockets[0].send('x'.repeat(70000))")  # more than is read: the server hangs up
        page.wait_for_function("() => window.sockets.length === 2 && window.sockets[1].readyState === 1", timeout=10_000)
        page.wait_for_function(FRESH, timeout=10_000)
